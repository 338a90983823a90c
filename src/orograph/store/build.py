"""Building a store: choose the size of its shards from the memory allowed, do its tasks, and only then let it be seen.

A store in a folder is built beside its place, in ``STORE.partial``, which becomes ``STORE`` by a rename when everything
is written; an old store is replaced only then. At a URL there is no rename: the store is built in place, and it is the
root's ``zarr.json``, written last, that makes it one (with ``overwrite`` the old store is gone from the beginning).
Either way a build that is killed leaves nothing that opens, and ``resume`` finishes it to the same bytes. In a folder
all of this is done alone (``lock``), from the first look at what is there to the last rename.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orograph.error import KINDS, ErrorKind
from orograph.errors import StoreError, UsageError
from orograph.geo.grid import wkt_of
from orograph.parallel import cpu_count, map_ordered
from orograph.progress import SILENT, Progress
from orograph.reporting import reporting
from orograph.store.chunked import checked_sizes
from orograph.store.chunked_kind import CHUNKED
from orograph.store.coding import CODECS, Coding, coding_of
from orograph.store.diamond_table import DIAMONDS
from orograph.store.given import source_of
from orograph.store.inputs import inputs_of
from orograph.store.lattices import LatticeRecord
from orograph.store.layout import CHUNK, FORMAT, PARTS, Record, dumps
from orograph.store.layout import publish as publish_record
from orograph.store.lock import alone
from orograph.store.memory import MemoryTerrain, check_metric
from orograph.store.places import PLAN, ROOT, begun, is_store, left_over, missing, occupied, partial, publish
from orograph.store.shards import go_through
from orograph.store.source import ArraySource, HeightSource
from orograph.store.storage import FolderStorage, Storage, storage_at
from orograph.store.stored import CACHE_BYTES, StoredTerrain, open, read_record
from orograph.store.terrain import Samples, Shape, level_count, level_shape
from orograph.store.tin_kind import TINS
from orograph.store.tins import ALL_LEGS as TIN_LEGS
from orograph.store.writer import ShardWriter

if TYPE_CHECKING:
    from orograph.dem.lattice import SourceLattice

MEMORY = 1 << 30
SHARDS = (2048, 1024, 512)
BASE = 280 << 20  # the interpreter, its libraries and their caches
READER = 160 << 20  # what a mosaic may hold while it reads one window

Path_ = str | os.PathLike[str]


def build(
    source: Any,
    url: Path_,
    *,
    overwrite: bool = False,
    resume: bool = False,
    max_memory: int = MEMORY,
    jobs: int | None = None,
    errors: Sequence[ErrorKind] = ("exact",),
    tins: int | None = None,
    chunked: tuple[int, float] | None = None,
    keep_source: bool = True,
    codec: str = CODECS[0],
    max_error: str | float = "lossless",
    progress: Progress | bool | None = None,
    storage_options: dict[str, Any] | None = None,
    shard: int | None = None,
    chunk: int = CHUNK,
    **options: Any,
) -> StoredTerrain:
    """Build a store and open it.

    Args:
        source: DEM files, or whatever else heights come as (``store.terrain``), such as what reads windows of them
            (``HeightSource``).
        url: the store's folder, or a URL fsspec can write to.
        overwrite: replace a store (or an unfinished build) that is there.
        resume: finish an interrupted build of the same sources and options; begins one if there is none.
        max_memory: bytes the process should stay within; decides the size of shards and how many tasks run at once.
        jobs: threads (default: all processors). The store's bytes do not depend on it.
        errors: of which kinds the errors of all diamonds are stored (with their spheres), for methods that refine by
            them; none for ().
        tins: segments along a leg of the finest patches above which TINs are stored (16 for ``bdam``), which holds some
            four bytes for each sample in memory besides; None: no TINs.
        chunked: cells along a side of the finest chunks whose meshes are stored, and their error in metres, 0: found
            from the terrain ((32, 0) for ``chunked-lod``); None: no such meshes.
        keep_source: of sources that have to be resampled, keep the samples as they are, so that places have their
            heights (``measuring.pick``); without them heights are those of the surface, and it is known how far off.
        codec: how heights are packed: "portable", which every reader of Zarr v3 understands.
        max_error: how far heights may be from those that are read, metres: they are kept as whole numbers of steps of
            twice that, and whatever follows is made of these; "auto": in the steps that the data have (whole metres,
            feet, centimetres…; of what is resampled a tenth of the source's); "lossless": as float32, as they are.
        progress: hears of it; None: bars in terminals and notebooks, and Python's warnings; False: nothing is said.
        storage_options: for the fsspec file system.
        shard, chunk: samples along their sides, powers of two (default: chosen from ``max_memory``; 256).
        options: how the source is read, as for ``store.terrain``: ``crs``, ``resolution``, ``nodata``…

    Raises:
        StoreError: something is there already, what was begun differs, the sources were changed meanwhile, or it cannot
            be written (disk full).
        ReadError, UsageError: a source cannot be read or is not metric.
    """
    progress = reporting(progress)
    if overwrite and resume:
        raise UsageError("A build either resumes or overwrites, not both.")
    kinds = tuple(kind for kind in KINDS if kind in errors)
    if len(kinds) != len(set(errors)):
        raise UsageError(f"Errors are of the kinds {', '.join(KINDS)}, not {', '.join(map(str, errors))}.")
    if tins is not None and tins not in TIN_LEGS:
        raise UsageError(f"`tins` is one of {', '.join(map(str, TIN_LEGS))}, not {tins!r}.")
    if chunked is not None:
        chunked = checked_sizes(chunked)
    raster = source_of(source, progress, called="build", **options)
    check_metric(raster.grid, raster.name)
    final = storage_at(url, storage_options)
    if isinstance(final, FolderStorage) and final.path.is_symlink():
        final = FolderStorage(os.path.realpath(final.path))  # what the link means is replaced, not the link
    shard, jobs = sizes(raster.grid.shape, max_memory, jobs, shard, len(kinds))
    keep = keep_source and bool(_lattices(raster))
    coding = coding_of(raster, codec, max_error)
    needed = _memory(raster.grid.shape, shard, jobs, len(kinds))
    if needed > max_memory:
        progress.warn(
            f"{max_memory >> 20} MiB is less than a build needs; it goes on, one task at a time, and may take "
            f"{needed >> 20} MiB."
        )
    plan = _plan(raster, shard, chunk, kinds, tins, chunked, keep, coding)
    with alone(final, "building this store"):
        storage = final if final.remote else FolderStorage(partial(final.url))
        if overwrite:
            _may_replace(final, storage)
        else:
            plan, complete = _compared(final, storage, plan, resume)
            if complete:
                return open(url, storage_options=storage_options)
        going_on = resume and begun(storage)
        if not going_on:
            if not final.remote or begun(storage) or is_store(final):
                storage.remove(ROOT)  # first, lest what is left look complete
                storage.remove()
            storage.put(PLAN, [dumps(plan)])
        if not storage.exists(ROOT):
            _fill(raster, storage, plan, coding, jobs, going_on, progress)
        storage.remove(PARTS)
        storage.remove(PLAN)
        storage.close()
        if isinstance(final, FolderStorage):
            publish(Path(storage.url), final.path)
        return open(url, storage_options=storage_options, cache_bytes=min(CACHE_BYTES, max_memory // 4))


def in_memory(source: HeightSource, progress: Progress = SILENT) -> MemoryTerrain:
    """A terrain in memory of what reads windows, read as a whole; heights that are an array are shared.

    Raises:
        UsageError: it is in no metric CRS.
    """
    if isinstance(source, ArraySource):
        return MemoryTerrain(source.heights, source.grid, source.name, source.vertical, source.attribution)
    rows, cols = source.grid.shape
    check_metric(source.grid, source.name)
    heights = np.empty((rows, cols), np.float32)
    strips = range(0, rows, 512)

    def load(row: int) -> None:
        end = min(row + 512, rows)
        heights[row:end] = source.read(row, end, 0, cols)

    with progress.task("Reading heights", total=len(strips)) as task:
        for _ in map_ordered(load, strips):
            task.advance()
    made = MemoryTerrain(heights, source.grid, source.name, source.vertical, getattr(source, "attribution", ()))
    if isinstance(source, Samples):
        made.samples = source
    return made


def sizes(shape: Shape, max_memory: int, jobs: int | None, shard: int | None, kinds: int) -> tuple[int, int]:
    """Side of the shards and number of tasks at once that fit the memory allowed."""
    wanted = jobs or cpu_count()
    for side in SHARDS if shard is None else (shard,):
        for at_once in range(wanted, 0, -1):
            if _memory(shape, side, at_once, kinds) <= max_memory:
                return side, at_once
    return shard or SHARDS[-1], 1


def _memory(shape: Shape, shard: int, jobs: int, kinds: int) -> int:
    """About what a build holds at once: its tasks, and the coarse shards that are open (two at level 1)."""
    from orograph.store.survey import memory

    unit = 4 * shard * shard
    coarse = 0
    for level in range(1, level_count(shape)):
        rows, cols = level_shape(shape, level)
        coarse += 2 * (2 if level == 1 else 1) * min(unit, 4 * rows * cols)
    heights = jobs * (4 * unit + READER) + coarse
    return BASE + max(heights, READER + memory(shape, shard, jobs, kinds) if kinds else 0)


def _lattices(raster: HeightSource) -> Sequence[SourceLattice]:
    """What a source was resampled from (``Mosaic.resampled_from``); nothing if its samples are its own."""
    return getattr(raster, "resampled_from", ())


def _plan(
    raster: HeightSource,
    shard: int,
    chunk: int,
    kinds: tuple[ErrorKind, ...],
    tins: int | None,
    chunked: tuple[int, float] | None,
    keep_source: bool,
    coding: Coding | None,
) -> dict[str, Any]:
    grid = raster.grid
    return {
        "format": FORMAT,
        "source": raster.fingerprint(),
        "name": raster.name,
        "vertical": raster.vertical,
        "shape": list(grid.shape),
        "transform": list(grid.transform[:6]),
        "crs": wkt_of(grid.crs),
        "shard": shard,
        "chunk": chunk,
        "errors": list(kinds),
        "tins": tins,
        "chunked": None if chunked is None else list(chunked),
        "keep_source": keep_source,
        "codec": None if coding is None else coding.asked(),
    }


def _plan_of(record: Record) -> dict[str, Any]:
    """The plan of a complete store."""
    grid = record.grid
    return {
        "format": FORMAT,
        "source": record.source,
        "name": record.name,
        "vertical": record.vertical,
        "shape": list(grid.shape),
        "transform": list(grid.transform[:6]),
        "crs": wkt_of(grid.crs),
        "shard": record.shard,
        "chunk": record.chunk,
        "errors": list(DIAMONDS.of(record).errors),
        "tins": TINS.of(record).get("legs"),
        "chunked": [of[name] for name in ("cells", "finest")] if (of := CHUNKED.of(record)) else None,
        "keep_source": bool(record.lattices),
        "codec": None if record.coding is None else record.coding.asked(),
    }


def _may_replace(final: Storage, storage: Storage) -> None:
    """Raise StoreError if what is there is no store, and was not to become one."""
    known = is_store(final) or begun(storage) or final.exists(f"heights/0/height/{ROOT}")  # its root may be damaged
    if occupied(final) and not known:
        raise StoreError(
            "Something is there that is not an Orograph store, and will not be overwritten.",
            path=final.url,
            remedy="Remove it, or choose another place.",
        )


def _compared(final: Storage, storage: Storage, plan: dict[str, Any], resume: bool) -> tuple[dict[str, Any], bool]:
    """The plan to go on by, and whether there is nothing left to do.

    Raises:
        StoreError: something is there that this build does not go on from.
    """
    if resume and begun(storage):
        data = storage.get(PLAN)
        if data is None:  # complete but for its last rename
            before = _plan_of(read_record(storage))
        else:
            try:
                before = json.loads(data)
            except ValueError:
                before = {}
        # The shards' size follows from --max-memory, which may differ: the build goes on as it was begun.
        plan = {**plan, "shard": before.get("shard"), "chunk": before.get("chunk")}
        differing = _differing(plan, before)
        if differing:
            raise StoreError(
                f"The interrupted build cannot be resumed: its {differing} differ from these.",
                path=storage.url,
                remedy="Run it with the same files and options, or start anew with `overwrite=True`.",
            )
        return plan, False
    if is_store(final):
        if not resume:
            if begun(storage) and not final.remote:
                raise _interrupted(final)
            raise StoreError("A store is there already.", path=final.url, remedy="Use `overwrite=True` to replace it.")
        before = _plan_of(read_record(final))
        differing = _differing({**plan, "shard": before["shard"], "chunk": before["chunk"]}, before)
        if differing:
            raise StoreError(
                f"A complete store of other sources or options is there: its {differing} differ from these.",
                path=final.url,
                remedy="Use `overwrite=True` to replace it.",
            )
        return plan, True
    if isinstance(final, FolderStorage) and left_over(final.path):
        complete = is_store(storage) or not begun(storage)
        raise missing(final) if complete else _interrupted(final)
    if begun(storage):
        raise _interrupted(final)
    if occupied(final):
        raise StoreError(
            "Something is there that is not an Orograph store.", path=final.url, remedy="Choose another place."
        )
    return plan, False


def _differing(plan: dict[str, Any], before: dict[str, Any]) -> str:
    """What of a plan is not as before, in words; empty if all is."""
    names = {
        "source": "sources or options", "format": "store format", "errors": "kinds of errors", "tins": "TINs",
        "chunked": "chunks", "keep_source": "source samples to keep",
        "codec": "codec or largest error",
    }  # fmt: skip
    return ", ".join(names.get(key, key) for key in plan if plan[key] != before.get(key))


def _interrupted(final: Storage) -> StoreError:
    return StoreError(
        "An interrupted build of this store is there.",
        path=final.url,
        remedy="Finish it with `resume=True`, or start anew with `overwrite=True`.",
    )


def _fill(
    raster: HeightSource, storage: Storage, plan: dict[str, Any], coding: Coding | None, jobs: int, resume: bool,
    progress: Progress,
) -> None:  # fmt: skip
    """Do all tasks and write all metadata, the root's last."""
    from orograph.store.makers import MAKERS, Work
    from orograph.store.pyramid import Pyramid, tasks
    from orograph.store.resampling import look_back

    kinds = tuple(plan["errors"])
    writer = ShardWriter(storage)
    pyramid = Pyramid(raster, writer, plan["shard"], plan["chunk"], resume, coding)
    spots = tasks(raster.grid.shape, plan["shard"])
    go_through("Resuming the store" if resume else "Building the store", spots, pyramid.run, jobs, progress)
    first = pyramid.finish()
    valid_samples = pyramid.valid_samples
    coding = None if coding is None else coding.measured(pyramid.lost, valid_samples)
    del pyramid
    lattices = _lattices(raster)
    sizes, keep = (plan["shard"], plan["chunk"]), plan["keep_source"]
    how = jobs, resume, progress, coding
    lost = look_back(lattices, raster.grid, writer, sizes, keep, *how) if lattices else None
    seen = bool(first.valid.any())
    record = Record(
        grid=raster.grid,
        name=raster.name,
        vertical=raster.vertical,
        shard=plan["shard"],
        chunk=plan["chunk"],
        height_range=(float(np.nanmin(first.minimum)), float(np.nanmax(first.maximum))) if seen else (np.nan, np.nan),
        valid_fraction=valid_samples / (raster.grid.rows * raster.grid.cols),
        source=plan["source"],
        resampled=lost,
        lattices=tuple(LatticeRecord.of(lattice) for lattice in lattices) if keep else (),
        inputs=inputs_of(raster),
        attribution=tuple(getattr(raster, "attribution", ())),
        digests=writer.digests,
        coding=coding,
    )
    for make in MAKERS.values():
        record = make(record, Work(kinds, writer, jobs, resume, progress, plan.get("tins"), plan.get("chunked")))
    if coding is not None and (told := coding.surprise(record.height_range, bool(lattices))):
        progress.warn(told)
    if raster.fingerprint() != plan["source"]:
        storage.remove()
        raise StoreError(
            "Its sources were changed while it was built; what was built of them is removed.",
            path=storage.url, remedy="Build it again when they are complete.",
        )  # fmt: skip
    publish_record(storage, record)
