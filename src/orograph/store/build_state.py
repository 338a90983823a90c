"""What a worker of a cluster needs for a build (``worker_state``): the store, the plan, and the source.

It opens those files itself, and does nothing if they differ from those of the plan, or if the build was abandoned or
restarted meanwhile: it checks the plan before every write. Results of earlier stages that later ones need (the digests
of shards, needed to read them) are in ``parts/`` of the store.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, NamedTuple

from orograph.errors import StoreError, UsageError
from orograph.store.addresses import storage_at
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.coding import Coding
from orograph.store.digests import Digests
from orograph.store.executing import KNOWN, Stage
from orograph.store.handing import Again, Kinds, again_of, leave, take
from orograph.store.layout import TABLES_AND_VALID, table_spec
from orograph.store.places import UPDATE
from orograph.store.source import HeightSource
from orograph.store.storage import Storage
from orograph.store.terrain import TileTable
from orograph.store.worker_state import guarded
from orograph.store.writer import ShardWriter


class BuildRecipe(NamedTuple):
    """What workers receive once.

    Attributes:
        url: where the store is made. storage_options: for the bucket (obstore's), in addition to the environment.
        plan: of the build. coding: how heights are encoded. begun: the plan, as stored at the key ``at``.
        keyed: as for ``Digests``: of updates in buckets.
        source: opens the source, with arrays of these kinds (``handing``).
        levels: of the groups of heights and errors; 0: none.
        memory: bytes that a task may take, in addition to ``base`` of the process.
    """

    url: str
    storage_options: dict[str, Any] | None
    plan: dict[str, Any]
    coding: Coding | None
    begun: bytes
    at: str
    keyed: bool
    source: Again
    kinds: Kinds
    levels: int
    memory: int
    base: int

    def open(self) -> BuildState:
        return BuildState(self)


def check_shareable(raster: HeightSource, storage: Storage) -> None:
    """Raise UsageError if the heights are not in files, or the store would be in this process's memory."""
    if getattr(raster, "again", None) is None and getattr(raster, "recipe", lambda: None)() is None:
        raise UsageError(
            "Workers of a cluster open the files of a terrain themselves, but these heights are not in files.",
            remedy="Write them to a file (`orograph.export`), or build without a cluster.",
        )
    if storage.url.startswith("memory:"):
        raise UsageError("Workers of a cluster cannot write to the memory of this process.", remedy="Give a folder.")


def recipe_of(
    raster: HeightSource, storage: Storage, storage_options: dict[str, Any] | None, plan: dict[str, Any],
    coding: Coding | None, at: str, memory: int, base: int,
) -> BuildRecipe:  # fmt: skip
    """The recipe of a build without groups, whose plan is stored at the key ``at``.

    Also stores there what workers take over of the source, which must be in files (``check_shareable``).
    """
    found = again_of(raster)
    assert found is not None
    source, made = found
    url, _ = storage.named()
    begun, keyed = storage.get(at) or b"", at == UPDATE
    return BuildRecipe(
        url, storage_options, plan, coding, begun, at, keyed, source, leave(storage, made), 0, memory, base
    )


class BuildState:
    """What one process of a cluster needs for a build.

    Attributes:
        making: the QuadTIN being built (``quadtin_grow.Making``), if any.
    """

    def __init__(self, recipe: BuildRecipe) -> None:
        self.recipe, self.plan = recipe, recipe.plan
        self.storage = guarded(storage_at(recipe.url, recipe.storage_options), recipe.at, recipe.begun)
        self.storage.get(recipe.at)  # which tells a bucket where in ``parts/`` to read
        if recipe.keyed:
            from orograph.store.bucket_updates import go_on

            go_on(self.storage)
        self._raster: HeightSource | None = None
        self.making: Any = None
        self._stages: dict[tuple[str, int], Stage[Any]] = {}

    def stage(self, name: str, number: int) -> Stage[Any]:
        """Return a stage."""
        if (name, number) not in self._stages:
            writer, keyed = ShardWriter(self.storage), self.recipe.keyed
            writer.digests = Digests.from_json(json.loads(self.storage.get(KNOWN) or b"{}"), keyed)
            self._stages[name, number] = _STAGES[name](self, writer, number)
        return self._stages[name, number]

    @property
    def sizes(self) -> tuple[int, int]:
        """Samples along the sides of shards and chunks."""
        return self.plan["shard"], self.plan["chunk"]

    def raster(self) -> HeightSource:
        """The source, opened here.

        Raises:
            StoreError: its files are not those with which the build began.
        """
        if self._raster is None:
            raster = self.recipe.source.open(take(self.storage, self.recipe.kinds))
            if raster.fingerprint() != self.plan["source"]:
                raise StoreError(
                    "A worker finds different files under the names of the sources than the building process.",
                    path=self.recipe.url, remedy="Make sure that all of them see the same file system, and that the "
                                                 "files do not change.",
                )  # fmt: skip
            self._raster = raster
        return self._raster


def _heights(state: BuildState, writer: ShardWriter, number: int) -> Stage[Any]:
    from orograph.store.groups import Groups
    from orograph.store.pyramid import Finest, Pyramid

    finest = Finest(state.raster(), writer, *state.sizes, state.recipe.coding)
    if state.recipe.levels:
        return Groups(finest, state.recipe.levels)
    return Pyramid(finest)


def _source(state: BuildState, writer: ShardWriter, number: int) -> Stage[Any]:
    from orograph.store.resampling import Look

    raster: Any = state.raster()
    keep, coding = state.plan["keep_source"], state.recipe.coding
    return Look(number, raster.resampled_from, raster.grid, writer, state.sizes, keep, coding)


def _errors(state: BuildState, writer: ShardWriter, number: int) -> Stage[Any]:
    from orograph.store.survey import Errors
    from orograph.store.survey_groups import ErrorGroups

    grid = state.raster().grid
    specs = {name: table_spec(grid.shape, 0, name, *state.sizes) for name in TABLES_AND_VALID}
    tables = {
        name: ShardedArray(spec, state.storage, writer.digests, ChunkCache(0), 1).read(
            0, spec.shape[0], 0, spec.shape[1]
        )
        for name, spec in specs.items()
    }
    first, kinds, levels = TileTable(**tables), tuple(state.plan["errors"]), state.recipe.levels
    errors = Errors(grid, writer, *state.sizes, first, kinds, state.recipe.coding)
    return ErrorGroups(errors, levels) if levels else errors


def _patches(state: BuildState, writer: ShardWriter, number: int) -> Stage[Any]:
    from orograph.error import KINDS
    from orograph.store.derived_stages import PatchStage, known

    return PatchStage(known(state.storage, state.recipe.keyed), writer, KINDS[number])


def _chunks(state: BuildState, writer: ShardWriter, number: int) -> Stage[Any]:
    from orograph.store.chunked import Kind
    from orograph.store.derived_stages import ChunkStage, known

    return ChunkStage(known(state.storage, state.recipe.keyed), writer, Kind(*state.plan["chunked"]))


def _tins(state: BuildState, writer: ShardWriter, number: int) -> Stage[Any]:
    from orograph.store.derived_stages import known
    from orograph.store.tin_stage import TinStage

    return TinStage(known(state.storage, state.recipe.keyed), writer, state.plan["tins"], number)


def _quadtin(state: BuildState, writer: ShardWriter, number: int) -> Stage[Any]:
    from orograph.store.derived_stages import known
    from orograph.store.quadtin_grow import Making
    from orograph.store.quadtin_stage import QuadTinStage

    terrain, (finest, split) = known(state.storage, state.recipe.keyed), state.plan["quadtin"]
    if state.making is None:
        state.making = Making(terrain, finest, split == "deviation")
    return QuadTinStage(terrain, writer, state.making, number)


_STAGES: dict[str, Callable[[BuildState, ShardWriter, int], Stage[Any]]] = {
    "heights": _heights, "source": _source, "errors": _errors, "patches": _patches, "chunks": _chunks, "tins": _tins,
    "quadtin": _quadtin,
}  # fmt: skip
