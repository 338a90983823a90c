"""Color errors kept with the terrain: made once, out of core, and used for the same colours only.

What ``color_errors`` computes in memory, a byte for each diamond, is put into a store beside the errors of heights, as
``colors/{k}/color``: one task per shard, which keeps what it found until all is complete, so that an interrupted run
goes on. The bytes are those of the computation in memory, whatever the shards and threads.

Color errors hold for one image, one light and one tint. The store says which (``made_with``): of an image a digest of
all its files (the raster, its world file, the parts of a mosaic), so that an image that was changed, or another one of
the same name, is never taken for it. An image whose files cannot be read as a whole (a URL) has no digest: its errors
are computed when they are wanted.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.diamonds import BLOCK
from orograph.errors import UsageError
from orograph.geovis.color_errors import Colors, decoded
from orograph.geovis.color_stage import PARTIAL, SAMPLE, ColorStage, made_with
from orograph.geovis.color_state import recipe_of
from orograph.parallel import threads_for
from orograph.progress import SILENT, Progress
from orograph.store.addresses import storage_at
from orograph.store.clusters import check_workers, on_workers
from orograph.store.colors import COLORS
from orograph.store.executing import Executor, Threads
from orograph.store.layout import dumps, publish
from orograph.store.lock import alone
from orograph.store.storage import Storage
from orograph.store.stored import StoredTerrain, open, read_record
from orograph.store.terrain import Terrain
from orograph.store.writer import ShardWriter


def same(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two ``made_with`` mean the same colours (an image may have been moved or renamed)."""

    def of(told: Mapping[str, Any]) -> dict[str, Any]:
        image = told["drape"]
        return {**told, "drape": None if image is None else image["digest"]}

    return of(one) == of(other)


class StoredColorErrors:
    """Color errors of a store, called as methods want them: ``(level, row0, row1, col0, col1) → float32``, ΔE."""

    def __init__(self, terrain: StoredTerrain) -> None:
        self.terrain, self.codes = terrain, terrain.derived("colors")

    def __call__(self, level: int, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
        return decoded(self.codes.read(level, row0, row1, col0, col1))


def stored(
    terrain: Terrain, drape: str | os.PathLike[str] | None = None, *, progress: Progress = SILENT, **options: Any
) -> StoredColorErrors | None:
    """The color errors a terrain's store has of these colours; None if it has none, or of other colours only.

    Args:
        terrain: any.
        drape, options: as for ``made_with``.
        progress: is told if there are some of other colours.
    """
    if not isinstance(terrain, StoredTerrain) or not COLORS.of(terrain.record):
        return None
    wanted = made_with(drape, **options)
    if wanted is not None and same(wanted, COLORS.of(terrain.record)):
        return StoredColorErrors(terrain)
    progress.note("The store's color errors are of other colours; new ones are computed.")
    return None


def store_colors(
    store: str | Path,
    drape: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
    max_memory: int = 1 << 30,
    jobs: int | None = None,
    progress: Progress = SILENT,
    storage_options: dict[str, Any] | None = None,
    workers: int | None = None,
    dask: Any = None,
    **options: Any,
) -> StoredTerrain:
    """Put color errors into a store, and open it again.

    Those of other colours are replaced; where the same are there already nothing is done. An interrupted run goes on
    when it is asked for again.

    Args:
        store: a folder, or a URL (``s3://``, ``gs://``, ``az://``…).
        drape: an image laid over the terrain; None: the tint of heights.
        overwrite: make them anew.
        max_memory: bytes the process should stay within.
        jobs: threads (default: all processors). The store's bytes do not depend on it.
        workers: this many processes of ``jobs`` threads each (default: 1), which share ``max_memory`` (Dask).
        dask: on the workers of a cluster: a ``distributed.Client``, or its scheduler's address. The image is opened by
            each of them, under the same path.
        options: ``colormap``, ``sun``, ``relief``, as for ``Colors``.

    Raises:
        UsageError: the image cannot be told from others later.
        StoreError: there is no store, another process is at work there, or it cannot be written.
        ReadError: the image cannot be read, or lies elsewhere.
    """
    wanted = made_with(drape, **options)
    if wanted is None:
        raise UsageError(
            f"{os.fspath(drape or '')} is not a file, so a changed image could not be detected later.",
            remedy="Fetch the image, and name the copy.",
        )
    check_workers(workers, dask, "A store's color errors")
    storage = storage_at(store, storage_options)
    read_record(storage)  # a store that is not there is said before anything is written beside it
    with alone(storage, "putting color errors into this store"):
        before = read_record(storage)
        if overwrite or not COLORS.of(before) or not same(wanted, COLORS.of(before)):
            with open(store, jobs=1, storage_options=storage_options) as terrain:
                if COLORS.of(before):
                    publish(storage, COLORS.put(before, {}))
                    before = read_record(storage)
                colors = Colors(terrain, drape=drape, max_memory=max_memory, progress=progress, **options)
                plan = dumps({**wanted, "step": colors.step, "source": before.source, "shard": before.shard})
                if overwrite or storage.get(f"{PARTIAL}/plan.json") != plan:
                    storage.remove(PARTIAL)
                    storage.put(f"{PARTIAL}/plan.json", [plan])
                at_once = max(1, min(threads_for(jobs), max_memory // 2 // (SAMPLE * min(BLOCK, before.shard) ** 2)))
                writer = ShardWriter(storage, before.digests.keyed)
                stage = ColorStage(colors, writer, before)
                with _executor(storage, drape, options, plan, at_once, (workers, dask, jobs, max_memory)) as executor:
                    executor.run(stage, progress)
                after = replace(COLORS.put(before, wanted), digests=before.digests.joined(writer.digests))
                publish(storage, after)
                storage.remove(PARTIAL)
        storage.close()
        return open(store, storage_options=storage_options)


@contextmanager
def _executor(
    storage: Storage, drape: str | os.PathLike[str] | None, options: dict[str, Any], plan: bytes, at_once: int,
    how: tuple[int | None, Any, int | None, int],
) -> Iterator[Executor]:  # fmt: skip
    """What does the tasks. Args: how: workers, dask, threads, bytes."""
    workers, dask, jobs, max_memory = how
    if workers is None and dask is None:
        yield Threads(at_once, True)
        return
    recipe = recipe_of(storage, drape, options, plan, max_memory)
    with on_workers(recipe, workers, dask, jobs or 1, max_memory, "A store's color errors") as cluster:
        yield cluster


__all__ = ["StoredColorErrors", "made_with", "store_colors", "stored"]
