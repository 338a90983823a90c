"""What a worker of a cluster does of a build: tasks of which it is told the stage and the place.

All else a worker knows from a *recipe*, which each process gets once: where the store is made, by which plan, of which
files. It opens those files itself, and does nothing if they are others than those the plan was made of, or if the build
was given up or begun anew meanwhile: its plan is looked at before every write. What stages need of earlier ones (the
digests of shards, by which these are read) lies in ``parts/`` of the store.

Kernels are compiled once on a host: the first task of a kind that a host does is done alone there, and what it compiled
is found in Numba's cache by the others. Tasks at once are as many as the worker's memory allows, if it has a limit.
"""

from __future__ import annotations

import contextlib
import functools
import json
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from orograph.errors import StoreError, UsageError
from orograph.folders import cache_folder
from orograph.processes import host
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.coding import Coding
from orograph.store.digests import Digests, Spot
from orograph.store.executing import Stage
from orograph.store.layout import PARTS, TABLES_AND_VALID, table_spec
from orograph.store.places import PLAN
from orograph.store.source import HeightSource
from orograph.store.storage import FolderStorage, Storage, storage_at
from orograph.store.terrain import TileTable
from orograph.store.writer import ShardWriter


class Recipe(NamedTuple):
    """All that workers are told once.

    Attributes:
        url: where the store is made. storage_options: for the fsspec file system.
        plan: of the build. coding: how heights are kept. begun: the plan, as it lies in the storage.
        files, options: of the source (``Mosaic.open``).
        levels: of the groups of heights; 0: none. memory: bytes a task may take, besides ``base`` of the process.
    """

    url: str
    storage_options: dict[str, Any] | None
    plan: dict[str, Any]
    coding: Coding | None
    begun: bytes
    files: list[str]
    options: dict[str, Any]
    levels: int
    memory: int
    base: int


def recipe_of(
    raster: HeightSource, storage: Storage, storage_options: dict[str, Any] | None, plan: dict[str, Any],
    coding: Coding | None, begun: bytes, memory: int, base: int,
) -> Recipe:  # fmt: skip
    """The recipe of a build without groups.

    Raises:
        UsageError: the heights are not in files, or the store would be in this process's memory.
    """
    said = getattr(raster, "recipe", lambda: None)()
    if said is None:
        raise UsageError(
            "Workers of a cluster open the files of a terrain themselves, and these heights are in no files.",
            remedy="Write them to a file (orograph.write), or build without a cluster.",
        )
    if storage.url.startswith("memory:"):
        raise UsageError("Workers of a cluster cannot write to the memory of this process.", remedy="Name a folder.")
    files, options = said
    here = [str(Path(path).absolute()) if Path(path).exists() else path for path in files]
    url = str(storage.path.absolute()) if isinstance(storage, FolderStorage) else storage.url
    return Recipe(url, storage_options, plan, coding, begun, here, options, 0, memory, base)


KNOWN = f"{PARTS}/digests.json"
"""The digests by which workers read what earlier stages wrote."""


class Shop:
    """What one process of a cluster needs for a build."""

    def __init__(self, recipe: Recipe, limit: int) -> None:
        self.recipe, self.plan = recipe, recipe.plan
        self.storage = _guarded(storage_at(recipe.url, recipe.storage_options), recipe.begun)
        free = (limit - recipe.base) // recipe.memory if limit else None
        self.room = contextlib.nullcontext() if free is None else threading.BoundedSemaphore(max(1, free))
        self._lock = threading.Lock()
        self._raster: HeightSource | None = None
        self._stages: dict[tuple[str, int], Stage[Any]] = {}

    def stage(self, name: str, number: int) -> Stage[Any]:
        """A stage."""
        with self._lock:
            if (name, number) not in self._stages:
                writer = ShardWriter(self.storage)
                writer.digests = Digests.from_json(json.loads(self.storage.get(KNOWN) or b"{}"))
                self._stages[name, number] = _STAGES[name](self, writer, number)
            return self._stages[name, number]

    @property
    def sizes(self) -> tuple[int, int]:
        """Samples along the sides of shards and chunks."""
        return self.plan["shard"], self.plan["chunk"]

    def raster(self) -> HeightSource:
        """The source, opened here.

        Raises:
            StoreError: its files are not those that the build was begun with.
        """
        if self._raster is None:
            from orograph.dem.mosaic import Mosaic

            raster = Mosaic.open(self.recipe.files, **self.recipe.options)
            if raster.fingerprint() != self.plan["source"]:
                raise StoreError(
                    "A worker finds other files under the names of the sources than the process that builds.",
                    path=self.recipe.url, remedy="See that all of them have the same file system, and files at rest.",
                )  # fmt: skip
            self._raster = raster
        return self._raster


def _heights(shop: Shop, writer: ShardWriter, number: int) -> Stage[Any]:
    from orograph.store.groups import Groups
    from orograph.store.pyramid import Finest, Pyramid

    finest = Finest(shop.raster(), writer, *shop.sizes, shop.recipe.coding)
    if shop.recipe.levels:
        return Groups(finest, shop.recipe.levels)
    return Pyramid(finest)


def _source(shop: Shop, writer: ShardWriter, number: int) -> Stage[Any]:
    from orograph.store.resampling import Look

    raster: Any = shop.raster()
    keep, coding = shop.plan["keep_source"], shop.recipe.coding
    return Look(number, raster.resampled_from, raster.grid, writer, shop.sizes, keep, coding)


def _errors(shop: Shop, writer: ShardWriter, number: int) -> Stage[Any]:
    from orograph.store.survey import Errors

    grid = shop.raster().grid
    specs = {name: table_spec(grid.shape, 0, name, *shop.sizes) for name in TABLES_AND_VALID}
    tables = {
        name: ShardedArray(spec, shop.storage, writer.digests, ChunkCache(0), 1).read(
            0, spec.shape[0], 0, spec.shape[1]
        )
        for name, spec in specs.items()
    }
    return Errors(grid, writer, *shop.sizes, TileTable(**tables), tuple(shop.plan["errors"]), shop.recipe.coding)


_STAGES: dict[str, Callable[[Shop, ShardWriter, int], Stage[Any]]] = {
    "heights": _heights, "source": _source, "errors": _errors,
}  # fmt: skip

_recipes: dict[str, tuple[Recipe, int]] = {}
_shops: dict[str, Shop] = {}
_opening = threading.Lock()


def learn(ident: str, recipe: Recipe, limit: int = 0) -> None:
    """Let this process know a recipe.

    Args:
        ident: what tasks call it. limit: bytes of memory that the process may take; 0: any.
    """
    _recipes[ident] = recipe, limit


def forget(ident: str) -> None:
    """A build is over."""
    _recipes.pop(ident, None)
    _shops.pop(ident, None)


def do(ident: str, name: str, number: int, spot: Spot) -> None:
    """Do a task of a stage, unless it is done.

    Args:
        ident: of the recipe. name, number: of the stage. spot: of the task.

    Raises:
        StoreError: the build is not what it was, or it cannot be written. ReadError: a source cannot be read.
    """
    with _opening:
        if ident not in _shops:
            _shops[ident] = Shop(*_recipes[ident])
        shop = _shops[ident]
    with shop.room, _first_alone(name):
        stage = shop.stage(name, number)
        if stage.found(spot) is None:
            stage.make(spot)


def _guarded(storage: Storage, plan: bytes) -> Storage:
    """A storage that is only written to while it has this plan."""
    put = storage.put
    if isinstance(storage, FolderStorage):
        storage.many = True

    def guarded(key: str, parts: Sequence[bytes]) -> None:
        if storage.get(PLAN) != plan:
            raise StoreError("The build that this task belongs to has ended, or another was begun.", path=storage.url)
        put(key, parts)

    storage.put = guarded  # type: ignore[method-assign]
    return storage


@contextlib.contextmanager
def _first_alone(name: str) -> Iterator[None]:
    """Keep other processes of this machine from the first task of a kind until one of them has done one."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    if name in _compiled:
        yield
        return
    kernels = _kernels()
    done = cache_folder() / f".compiled.{host()}.{name}"
    try:
        done.parent.mkdir(parents=True, exist_ok=True)
        file = done.open("a+b")
    except OSError:  # each process compiles for itself, then
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.seek(0)
        if file.read() == kernels:
            fcntl.flock(file, fcntl.LOCK_UN)
            yield
        else:
            yield
            file.truncate(0)
            file.write(kernels)
    _compiled.add(name)


_compiled: set[str] = set()
"""The stages of which this process has done a task."""


@functools.cache
def _kernels() -> bytes:
    """Differs when kernels have to be compiled anew, or lie elsewhere."""
    package = Path(__file__).parent.parent
    newest = max(path.stat().st_mtime_ns for path in package.rglob("*.py"))
    return f"{package} {newest}".encode()
