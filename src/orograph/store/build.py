"""Building a store: choose the shard size from the allowed memory, do all tasks, and only then make the store visible.

A store in a folder is built beside its place, in ``STORE.partial``, which is renamed to ``STORE`` when everything
is written; only then is an old store replaced. At a URL there is no rename: the store is built in place, and the
root's ``zarr.json``, written last, makes it a store (with ``overwrite`` the old store is gone from the beginning).
Either way a build that is killed leaves nothing that opens, and ``resume`` finishes it to the same bytes. All of this
happens under a lock (``lock``), from the first look at what is there to the last rename.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack, overload

import numpy as np

from orograph._named import answering
from orograph.compiling import expect
from orograph.error import KINDS, ErrorKind
from orograph.errors import StoreError, UsageError
from orograph.folders import Amount, bytes_of
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress
from orograph.reporting import reporting
from orograph.several import words
from orograph.store.addresses import storage_at
from orograph.store.bucket import BucketStorage
from orograph.store.chunked import Kind, checked_kind
from orograph.store.coding import CODECS, Coding, coding_of
from orograph.store.doubts import warn_of_files, warn_of_heights
from orograph.store.executing import Executor
from orograph.store.given import source_of, stores_in
from orograph.store.inputs import inputs_of
from orograph.store.lattices import LatticeRecord
from orograph.store.layout import CHUNK, Record, dumps
from orograph.store.layout import publish as publish_record
from orograph.store.lock import alone
from orograph.store.memory import MemoryTerrain, check_metric
from orograph.store.places import PARTS, PLAN, ROOT, begun, is_store, partial, publish
from orograph.store.plan import check_replaceable, compared, plan_for
from orograph.store.quadtin_kind import checked_quadtin
from orograph.store.source import ArraySource, HeightSource
from orograph.store.storage import FolderStorage, Storage
from orograph.store.stored import CACHE_BYTES, StoredTerrain, open, read_record
from orograph.store.terrain import Samples
from orograph.store.tins import ALL_LEGS as TIN_LEGS
from orograph.store.typed import Building
from orograph.store.versions import check_keep, prune, settle
from orograph.store.versions import publish as publish_version
from orograph.store.ways import BASE, READER, AtOnce, check_sides, check_ways, executor_of, memory_of, sizes
from orograph.store.writer import ShardWriter

if TYPE_CHECKING:
    from orograph.dem.lattice import SourceLattice

MEMORY = 1 << 30

Path_ = str | os.PathLike[str]


@overload
def build(source: Any, url: Path_, *, part: str | tuple[int, int], **options: Any) -> None: ...


@overload
def build(source: Any, url: Path_, *, part: None = None, **options: Unpack[Building]) -> StoredTerrain: ...


@overload
def build(source: Any, url: Path_, *, part: str | tuple[int, int] | None, **options: Any) -> StoredTerrain | None: ...


@answering
def build(
    source: Any,
    url: Path_,
    *,
    overwrite: bool = False,
    resume: bool = False,
    update: bool = False,
    keep: int | None = None,
    max_memory: Amount = MEMORY,
    jobs: int | None = None,
    errors: Sequence[ErrorKind] | str = ("exact",),
    tins: int | None = None,
    chunked: tuple[int, float] | tuple[int, float, bool] | None = None,
    quadtin: tuple[float, str] | None = None,
    keep_source: bool = True,
    codec: str = CODECS[0],
    max_error: str | float = "lossless",
    progress: Progress | bool | None = None,
    storage_options: dict[str, Any] | None = None,
    shard: int | None = None,
    chunk: int = CHUNK,
    part: str | tuple[int, int] | None = None,
    finish: bool = False,
    workers: int | None = None,
    dask: Any = None,
    **options: Any,
) -> StoredTerrain | None:
    """Build a store and open it.

    Args:
        source: DEM files, or heights in any other form that ``store.terrain`` takes, such as a reader of windows
            (``HeightSource``). If it is the store at ``url`` itself, what that lacks is added to it.
        url: the store's folder or URL (``s3://``, ``gs://``, ``az://``…).
        overwrite: replace a store (or an unfinished build) that is there.
        resume: finish an interrupted build of the same sources and options; begins one if there is none.
        update: rebuild only what depends on files that were added, changed or removed since (``updating``); begins a
            build if there is none. The store keeps what that takes. In a folder or a bucket.
        keep: how many versions of an updated store stay, counting the new one (default: 2); older ones are removed.
        max_memory: bytes the process should stay within; decides the size of shards and how many tasks run at once.
        jobs: threads (default: all processors). The store's bytes do not depend on it.
        errors: the kinds of errors to store for all diamonds (with their spheres), for methods that refine by them:
            a sequence, or a text ("exact,midpoint"); none for ().
        tins: segments along a leg of the finest patches above which TINs are stored (16 for ``bdam``); None: no TINs.
        chunked: cells along a side of the finest chunks whose meshes are stored; their error in metres, or 0 to derive
            it from the terrain ((32, 0) for ``chunked-lod``); and whether they are compressed ((32, 0, True)); None: no
            such meshes. They depend on ``midpoint`` errors, which are stored, too.
        quadtin: the error bound in metres of the finest triangles of a stored QuadTIN, or 0 for a sixteenth of the
            sample spacing, and which points split triangles ((0, "nearest") for ``quadtin``); None: none is stored.
        keep_source: keep the original samples of sources that have to be resampled, so that places have their exact
            heights (``measuring.pick``); otherwise heights are those of the surface, with a known error.
        codec: how heights are encoded: "portable", which every reader of Zarr v3 understands; "compact"
            (docs/codec.md), smaller; "smallest", which decodes more slowly; or "progressive", which stores no sample
            twice: each level is stored as differences from a prediction by the level above.
        max_error: the largest allowed error of stored heights, metres: they are rounded to steps of twice that, and
            everything else is computed from the rounded heights; "auto": the data's own steps (whole metres,
            feet, centimetres…; for resampled data a tenth of the source's); "lossless": float32, unchanged.
        progress: receives progress; None: bars in terminals and notebooks, and Python's warnings; False: silent.
        storage_options: for the bucket, in addition to the environment (obstore's: ``endpoint``, ``skip_signature``…).
        shard, chunk: samples along their sides, powers of two (default: chosen from ``max_memory``; 256).
        part: build only this part of the heights, "3/64" or (3, 64), and return nothing: for job arrays (``in_parts``).
        finish: build the rest of a store whose parts are all complete.
        workers: build in this many processes of ``jobs`` threads each (default: 1), which share ``max_memory`` (Dask).
        dask: build on the workers of a cluster: a ``distributed.Client``, or its scheduler's address.
        options: how the source is read, as for ``store.terrain``: ``crs``, ``resolution``, ``nodata``…

    Raises:
        StoreError: something already exists there, an interrupted build differs, sources changed meanwhile, parts are
            missing, or the store cannot be written (disk full).
        ReadError, UsageError: a source cannot be read or is not metric.
    """
    # (One function, though long: most of it is its options and what they mean.)
    from orograph.store import handing
    from orograph.store.adding import Needs, add, is_itself
    from orograph.store.build_state import check_shareable
    from orograph.store.in_parts import Gathering, build_part, part_of, parts_begun

    progress, max_memory = reporting(progress), bytes_of(max_memory)
    check_ways(overwrite, resume, part, finish, workers, dask)
    wanted = words(errors)
    kinds = tuple(kind for kind in KINDS if kind in wanted)
    if len(kinds) != len(set(wanted)):
        raise UsageError(f"Errors must be of the kinds {', '.join(KINDS)}, not {', '.join(map(str, wanted))}.")
    if tins is not None and tins not in TIN_LEGS:
        raise UsageError(f"`tins` must be one of {', '.join(map(str, TIN_LEGS))}, not {tins!r}.")
    if chunked is not None:
        chunked = checked_kind(chunked)
        kinds = tuple(kind for kind in KINDS if kind in (*kinds, "midpoint"))  # chunks depend on it
    if quadtin is not None:
        quadtin = checked_quadtin(quadtin)
    final = storage_at(url, storage_options)
    if isinstance(final, FolderStorage) and final.path.is_symlink():
        final = FolderStorage(os.path.realpath(final.path))  # replace the link's target, not the link
    storage = final if final.remote else FolderStorage(partial(final.url))
    left = handing.left_by_parts(storage, source, options, progress) if part is not None or finish else None
    raster = left or source_of(source, progress, called="build", **options)
    check_metric(raster.grid, raster.name)
    warn_of_files(raster, progress)
    if (check_void := getattr(raster, "check_void", None)) is not None:
        check_void()
    versions = check_keep(keep, update, final)
    itself = is_itself(raster, final) and not (overwrite or update or finish or part)
    if itself and coding_of(raster, codec, max_error) is None:
        if workers is not None or dask is not None:
            raise UsageError("A cluster cannot add to a store.", remedy="Leave it out: threads do it.")
        jobs = sizes(raster.grid.shape, max_memory, jobs, read_record(final).shard, len(kinds))[1]
        add(final, Needs(kinds, tins, chunked, quadtin), jobs, progress)
        return open(url, storage_options=storage_options)
    for store in stores_in(raster):
        if store.samples is not None:
            progress.warn(
                f"{store.name}: the samples or points from which it was built are not copied, only the heights of its "
                "surface. To keep those, build from the files."
            )
    if update:
        from orograph.store.bucket_updates import BucketUpdate
        from orograph.store.updating import ALL_AGAIN, begin, check_updatable

        excluded = {"overwrite": overwrite, "resume": resume, "part": part is not None, "finish": finish}
        check_updatable(final, excluded)
    if workers is not None or dask is not None:
        check_shareable(raster, final)  # before anything is removed
        jobs = jobs or (1 if dask is None else None)
    shard, jobs = sizes(raster.grid.shape, max_memory, jobs, shard, len(kinds))
    check_sides(shard, chunk)
    keep_lattices = keep_source and bool(lattices_of(raster))
    coding = coding_of(raster, codec, max_error)
    needed = memory_of(raster.grid.shape, shard, jobs, len(kinds))
    if needed > max_memory:
        progress.warn(
            f"{max_memory >> 20} MiB is less than a build needs; it runs one task at a time, and may take "
            f"{needed >> 20} MiB."
        )
    plan = plan_for(raster, shard, chunk, kinds, tins, chunked, quadtin, keep_lattices, coding)
    if part is not None:
        leave = functools.partial(handing.leave_for_parts, given=source, options=options, raster=raster)
        build_part(raster, final, storage, plan, coding, part_of(part), jobs, overwrite, progress, leave)
        return None
    with alone(final, "building this store"):
        if isinstance(final, FolderStorage):
            settle(final)
        count = parts_begun(final, storage) if finish else 0
        resume = resume or finish
        in_bucket = BucketUpdate(final, versions, progress) if update and isinstance(final, BucketStorage) else None
        if in_bucket is not None:
            plan, continued, complete = in_bucket.begin(plan, raster, coding)
        elif update:
            assert isinstance(final, FolderStorage) and isinstance(storage, FolderStorage)
            plan, continued, complete = begin(final, storage, plan, raster, coding, progress)
        elif overwrite and not finish:
            check_replaceable(final, storage)
            complete = continued = False
        else:
            plan, complete = compared(final, storage, plan, resume)
            continued = resume and begun(storage)
        if complete:
            if in_bucket is not None:
                in_bucket.prune()
            elif update:
                prune(Path(final.url), versions, progress)
            return _opened(raster, url, storage_options, max_memory, progress)
        if not continued and not update:
            if not final.remote or begun(storage) or is_store(final):
                storage.remove(ROOT)  # first, so that a half-removed store does not look complete
                storage.remove()
            storage.put(PLAN, [dumps(plan)])
        if in_bucket is not None or not storage.exists(ROOT):
            label = "Building the store" if not continued else "Updating the store" if update else "Resuming the store"
            at_once = AtOnce(jobs, max_memory, BASE, 4 * 4 * plan["shard"] ** 2 + READER)
            how = continued, update, workers, dask
            with executor_of(raster, storage, storage_options, plan, coding, at_once, *how) as does:
                executor = Gathering(final.url, count, does) if count else does
                expect("build")
                record = _fill(raster, storage, plan, coding, jobs, label, executor, progress, in_bucket is not None)
            if in_bucket is not None:
                in_bucket.publish(record)
                return _opened(raster, url, storage_options, max_memory, progress)
            publish_record(storage, record)
        if isinstance(storage, FolderStorage) and (continued or workers is not None or dask is not None):
            storage.sweep()
        for each in [f"{PARTS}/{name}" for name in ALL_AGAIN] if update else [PARTS]:
            storage.remove(each)
        storage.remove(PLAN)
        storage.close()
        if isinstance(final, FolderStorage) and update:
            publish_version(Path(storage.url), final.path, versions, progress)
        elif isinstance(final, FolderStorage):
            publish(Path(storage.url), final.path)
        return _opened(raster, url, storage_options, max_memory, progress)


def _opened(
    raster: HeightSource, url: Path_, storage_options: dict[str, Any] | None, max_memory: int, progress: Progress
) -> StoredTerrain:
    """The store that was built, after warning of doubtful heights."""
    terrain = open(url, storage_options=storage_options, cache_bytes=min(CACHE_BYTES, max_memory // 4))
    warn_of_heights(raster, terrain.height_range, progress)
    return terrain


def in_memory(source: HeightSource, progress: Progress = SILENT) -> MemoryTerrain:
    """Read a source as a whole into a terrain in memory; heights that are already an array are shared.

    Raises:
        UsageError: its CRS is not metric.
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


def lattices_of(raster: HeightSource) -> Sequence[SourceLattice]:
    """Return what a source was resampled from (``Mosaic.resampled_from``); empty if its samples are original."""
    return getattr(raster, "resampled_from", ())


def _fill(
    raster: HeightSource, storage: Storage, plan: dict[str, Any], coding: Coding | None, jobs: int, label: str,
    executor: Executor, progress: Progress, keyed: bool,
) -> Record:  # fmt: skip
    """Do all tasks; return the store's record. Args: keyed: see ``ShardWriter``."""
    from orograph.store.groups import Groups
    from orograph.store.makers import MAKERS, Work
    from orograph.store.points import put_points
    from orograph.store.pyramid import Finest, Pyramid
    from orograph.store.resampling import look_back

    kinds = tuple(plan["errors"])
    writer = ShardWriter(storage, keyed)
    levels = executor.groups(Pyramid.name, raster.grid.shape, plan["shard"])
    finest = Finest(raster, writer, plan["shard"], plan["chunk"], coding)
    pyramid = Pyramid(finest, label, levels)
    executor.run(Groups(finest, levels, pyramid) if levels else pyramid, progress)
    first = pyramid.first()
    valid_samples = pyramid.valid_samples
    coding = None if coding is None else coding.measured(pyramid.lost, valid_samples)
    del pyramid
    lattices = lattices_of(raster)
    sizes, keep = (plan["shard"], plan["chunk"]), plan["keep_source"]
    lost = look_back(lattices, raster.grid, writer, sizes, keep, executor, progress, coding) if lattices else None
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
    if (surface := getattr(raster, "surface", None)) is not None:
        record = put_points(record, surface, writer)
    for make in MAKERS.values():
        kind = None if plan.get("chunked") is None else Kind(*plan["chunked"])
        wanted = plan.get("tins"), kind, plan.get("quadtin")
        record = make(record, Work(kinds, writer, jobs, executor, progress, *wanted))
    if coding is not None and (warning := coding.surprise(record.height_range, bool(lattices))):
        progress.warn(warning)
    if raster.fingerprint() != plan["source"]:
        if not keyed:
            storage.remove()
        raise StoreError(
            f"Its sources changed while it was built; what was built is {'not used' if keyed else 'removed'}.",
            path=storage.url, remedy="Build it again when they are complete.",
        )  # fmt: skip
    return record
