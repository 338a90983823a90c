"""From paths to a terrain: opened, read into memory, or built once into a store in the cache.

A raster that is small enough is read into memory. A larger one is built into a store in the user's cache folder
(``$OROGRAPH_CACHE``, or the platform's own place), under a name derived from its files, their sizes and times, the
reading options and its errors: the next picture of it opens that store at once. One process builds it, and others that
need it wait. The folder stays within a size limit (``store.kept``).
"""

from __future__ import annotations

import hashlib
import shutil
import time
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

from orograph.errors import OrographError, StoreBusyError, StoreError, UsageError
from orograph.folders import cache_folder, cache_limit
from orograph.progress import SILENT, Progress
from orograph.store.build import build, in_memory
from orograph.store.doubts import warn_of_files, warn_of_heights
from orograph.store.given import OF_AREAS, options_of_rasters, points_of, source_of
from orograph.store.stored import StoredTerrain, open
from orograph.store.terrain import EXACT_SAMPLES, Terrain

if TYPE_CHECKING:
    from pathlib import Path

    from orograph.dem.mosaic import Mosaic
    from orograph.error import ErrorKind

PAUSE = 0.3
"""Seconds between checks whether another process has finished the store."""

BASE = 240 << 20
"""Bytes that the interpreter and its libraries take."""

PER_SAMPLE = 20
"""Bytes per sample of a raster in memory while it is drawn: heights, coarser levels, pyramids, light (measured: 4097²
samples)."""


def _fits(samples: int, max_memory: int) -> bool:
    """Whether to read a raster into memory: it leaves room for everything else, or is small compared with the limit."""
    return samples * PER_SAMPLE <= max(max_memory - BASE, max_memory // 4)


def cache_bytes(max_memory: int | None) -> int:
    """The cache of a store while a picture is drawn from it: a picture reads each tile once or twice."""
    return (64 << 20) if max_memory is None else min(64 << 20, max_memory // 16)


def prepare(
    paths: list[str],
    *,
    max_memory: int | None = None,
    jobs: int | None = None,
    progress: Progress = SILENT,
    errors: Collection[ErrorKind] = (),
    **options: Any,
) -> Terrain:
    """The terrain of a store, of one DEM or of many.

    Args:
        paths: one store, or DEM files.
        errors: kinds of diamond errors that a newly kept store gets, besides exact ones.
        options: for ``Mosaic.open``.

    Raises:
        ReadError, StoreError, UsageError: as ``store.open``, ``Mosaic.open`` and ``store.build``.
    """
    from orograph.store.detect import is_store

    reading = {k: v for k, v in options.items() if v is not None}
    if len(paths) == 1 and is_store(paths[0]):
        area = {name: reading.pop(name) for name in OF_AREAS if name in reading}
        if reading:
            names = ", ".join(f"`{k}`" for k in sorted(reading))
            raise UsageError(
                f"{names} cannot be used: a store is already built, and describes itself.",
                path=paths[0],
                remedy="Give such options to `orograph.build`, or render the DEM files.",
            )
        terrain = open(paths[0], cache_bytes=cache_bytes(max_memory), jobs=jobs)
        if not area:
            return terrain
        return part_of(terrain, area, max_memory=max_memory, jobs=jobs, progress=progress, errors=errors)
    from orograph.dem.mosaic import Mosaic

    if (points := points_of(paths, progress, reading)) is not None:
        warn_of_files(points, progress)
        return in_memory(points, progress)
    mosaic = Mosaic.open(paths, progress=progress, **options_of_rasters(reading))
    return of_mosaic(mosaic, max_memory=max_memory, jobs=jobs, progress=progress, errors=errors)


def part_of(terrain: Terrain, area: dict[str, Any], **how: Any) -> Terrain:
    """The part of a terrain that lies in an area (``bbox``, ``clip``), as a terrain of its own.

    Args:
        how: as for ``of_mosaic``.
    """
    from orograph.dem.mosaic import Mosaic

    return of_mosaic(Mosaic([source_of(terrain)], **area), **how)


def of_mosaic(
    mosaic: Mosaic, *, max_memory: int | None = None, jobs: int | None = None, progress: Progress = SILENT,
    errors: Collection[ErrorKind] = (),
) -> Terrain:  # fmt: skip
    """The terrain of a mosaic: in memory if it is small enough, else a store that is kept (see ``prepare``)."""
    from orograph.store.kept import Use, make_room
    from orograph.store.layout import FORMAT

    rows, cols = mosaic.grid.shape
    if rows * cols <= EXACT_SAMPLES and (max_memory is None or _fits(rows * cols, max_memory)):
        return _checked(mosaic, in_memory(mosaic, progress), progress)
    cache_limit()  # reports a bad size before anything is built
    # Other store formats have other names, so their unfinished builds are not in the way.
    name = hashlib.sha256(f"{mosaic.fingerprint()} {FORMAT}".encode()).hexdigest()[:20]
    more: list[ErrorKind] = sorted(kind for kind in errors if kind != "exact")
    kept = cache_folder() / f"{'-'.join([name, *more])}.oro"
    use = Use(kept)
    if kept.exists():
        try:
            terrain = open(kept, cache_bytes=cache_bytes(max_memory))
        except OrographError as error:
            # Only complete stores have this name: this one has been damaged since, and can be rebuilt.
            progress.warn(f"the kept store cannot be used and is built again ({error})")
            shutil.rmtree(kept, ignore_errors=True)
        else:
            progress.note(f"drawn from the store kept at {kept}")
            terrain.use = use
            return _checked(mosaic, terrain, progress, kept)
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            f"The cache folder cannot be made: {error.strerror}.", path=kept.parent,
            remedy="Set OROGRAPH_CACHE to a folder with room, or use `orograph.build` and render the store.",
        ) from error  # fmt: skip
    terrain = _built(mosaic, kept, ("exact", *more), max_memory, jobs, progress)
    terrain.use = Use(kept)
    make_room(progress)
    size = sum(f.stat().st_size for f in kept.rglob("*") if f.is_file())
    progress.note(f"the store made of it is kept at {kept} ({size / 1e6:.0f} MB); the next picture starts from there")
    terrain.samples = mosaic
    return terrain


def _built(
    mosaic: Mosaic, kept: Path, errors: tuple[ErrorKind, ...], max_memory: int | None, jobs: int | None,
    progress: Progress,
) -> StoredTerrain:  # fmt: skip
    """The store of a mosaic, built here, or by another process that is already building it."""
    memory: dict[str, Any] = {} if max_memory is None else {"max_memory": max_memory}
    waits = False
    while True:
        try:
            made: StoredTerrain = build(
                mosaic, kept, resume=True, errors=errors, keep_source=False, jobs=jobs, progress=progress, **memory
            )
            return made
        except StoreBusyError as error:
            if not waits:
                progress.note(f"{error.what} Waiting for it.")
            waits = True
            time.sleep(PAUSE)


def _checked(mosaic: Mosaic, terrain: Terrain, progress: Progress, kept: Path | None = None) -> Terrain:
    """The terrain with its files' samples, after warning of what is doubtful in them."""
    terrain.samples = mosaic
    warn_of_files(mosaic, progress)
    warn_of_heights(mosaic, terrain.height_range, progress, kept)
    return terrain
