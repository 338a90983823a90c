"""Baked light: products stored as layers of a store, at all its levels, so that renderers read them tile by tile.

Products worth baking depend only on the ground and take long: skies, occlusion, apertures, horizons. They are made as
for a map (``products``), those with the same horizons in one sweep. Then they are cut into the store's shards and
averaged over blocks of 2 × 2, 4 × 4… samples, always from the exact values of the full resolution; each level is
quantised last, by itself. There are two ways to average:

- *mean*: of the valid samples, for additive quantities (sky-view factors, occlusion, insolation, sunshine) and for
  angles that are close to each other (horizons, openness);
- *cap*, for apertures: the area of a block's cap is the mean of its samples' areas, 1 − cos r = mean(1 − cos rᵢ), and
  its direction is that of the mean light that the caps would receive from a uniform sky, ∑ sin² rᵢ cᵢ (the first moment
  of a cap of direction c and radius r is π sin² r c): a light that half of the samples see is seen by half of the cap.

A bake into a folder is made in ``layers/.partial``, which also keeps what has been swept, and is moved into place when
it is complete (``bake_folder``); until then the store stays readable with its old layers. Parts make it there together
(``bake_parts``). At a URL nothing can be renamed: layers are first removed from the store's record, and listed again
when they are complete. Workers of this machine make them in a folder and then send them; workers of a cluster exchange
data through the bucket.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args, overload

from orograph._named import answering
from orograph.errors import UsageError
from orograph.folders import Amount, bytes_of
from orograph.lighting.bake_folder import (
    KEY,
    Place,
    begin,
    kept,
    partial_of,
    plan_text,
    publish,
    removed,
    scratch,
    send,
    take_place,
)
from orograph.lighting.bake_layers import SAID, LayerStage, is_cap
from orograph.lighting.context import MEMORY, Context, Options, Values
from orograph.lighting.gather import Window, readers
from orograph.lighting.products import Product, product
from orograph.lighting.raster import trim
from orograph.parallel import threads_for
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.several import words
from orograph.store.addresses import storage_at
from orograph.store.bucket import BucketStorage
from orograph.store.clusters import check_workers, on_workers
from orograph.store.digests import Spot
from orograph.store.executing import Threads
from orograph.store.in_parts import part_of
from orograph.store.layers import LAYERS, PARTIAL, Bits, LayerBand, LayerRecord
from orograph.store.layout import Record
from orograph.store.lock import alone
from orograph.store.storage import FolderStorage, Storage
from orograph.store.stored import StoredTerrain, open, read_record
from orograph.store.writer import ShardWriter

Averaging = Literal["mean", "cap"]


@dataclass(frozen=True, slots=True)
class Baked:
    """How a product is put into a store.

    Attributes:
        averaging: see the module.
        bits: the default bits of a code.
        more: the options of ``Options.more`` that it has, with their defaults.
    """

    averaging: Averaging = "mean"
    bits: Bits = 8
    more: tuple[tuple[str, Any], ...] = ()


BAKED: dict[str, Baked] = {
    "sky-view-factor": Baked(),
    "sky-view-horizontal": Baked(),
    "visible-sky": Baked(),
    "openness": Baked(),
    "openness-negative": Baked(),
    "ambient-occlusion": Baked(more=(("rho", "step"), ("method", "horizon"))),
    "aperture": Baked("cap", 16, (("method", "horizon"),)),
    "horizon": Baked(),
    "insolation": Baked(bits=16, more=(("date", None), ("step", 10.0), ("turbidity", 3.0))),
    "sunshine": Baked(bits=16, more=(("date", None), ("step", 10.0))),
}
"""Products that can be baked. The others follow quickly from heights, or hold for only one sun."""


Store = StoredTerrain | str | Path


@overload
def bake(
    store: Store, products: Sequence[str] | str = "", options: Options | None = None, *, part: str | tuple[int, int],
    **more: Any,
) -> None: ...  # fmt: skip


@overload
def bake(
    store: Store,
    products: Sequence[str] | str = "",
    options: Options | None = None,
    *,
    bits: Bits | None = None,
    overwrite: bool = False,
    max_memory: Amount = MEMORY,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    storage_options: dict[str, Any] | None = None,
    workers: int | None = None,
    dask: Any = None,
    part: None = None,
    finish: bool = False,
    **more: Any,
) -> StoredTerrain: ...


@overload
def bake(
    store: Store, products: Sequence[str] | str = "", options: Options | None = None, *,
    part: str | tuple[int, int] | None, **more: Any,
) -> StoredTerrain | None: ...  # fmt: skip


@answering
def bake(
    store: Store,
    products: Sequence[str] | str = "",
    options: Options | None = None,
    *,
    bits: Bits | None = None,
    overwrite: bool = False,
    max_memory: Amount = MEMORY,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    storage_options: dict[str, Any] | None = None,
    workers: int | None = None,
    dask: Any = None,
    part: str | tuple[int, int] | None = None,
    finish: bool = False,
    **more: Any,
) -> StoredTerrain | None:
    """Store products of light as layers of their names, and reopen the store.

    A layer of the same name is replaced, unless it was made with the same options; then it is kept. An interrupted bake
    into a folder resumes when it is repeated.

    Args:
        store: a folder, a URL (``s3://``, ``gs://``, ``az://``…), or an opened store of these.
        products: those in ``BAKED``: one, several, or a text ("openness,sky-view-factor"); one must be given.
        options: of the products.
        bits: of a code: 8 or 16; None: what the product needs (16 for apertures, insolation and sunshine, else 8).
        overwrite: also bake existing layers again, and restart an interrupted bake.
        max_memory: bytes the process should stay within.
        jobs: threads; None: all processors. The store's bytes do not depend on either.
        progress: gets the progress; None: bars in terminals and notebooks, and Python's warnings; False: silent.
        storage_options: for the bucket, besides the environment (obstore's: ``endpoint``, ``skip_signature``…).
        workers: bake in this many processes of ``jobs`` threads each (default: 1), which share ``max_memory`` (Dask).
        dask: bake on the workers of a cluster: a ``distributed.Client``, or its scheduler's address.
        part: bake only this part, "3/64" or (3, 64), and return nothing: for job arrays (``bake_parts``).
        finish: make the rest of a bake whose parts are all complete.
        more: the products' options by name, instead of ``options``: ``radius=600``, ``rho="linear"``…

    Raises:
        UsageError: there is no such product, it cannot be baked, or its options make no sense.
        StoreError: there is no store, another bake is at work or was interrupted, parts are missing, or it cannot be
            written.
    """
    # (One long function: two thirds of it are its options and their descriptions.)
    from orograph.lighting import bake_parts

    progress, max_memory = reporting(progress), bytes_of(max_memory)
    if options is not None and more:
        raise UsageError("Give the products' options as Options, or by their names, not both.")
    chosen = options or Options.of(**more)
    asked = [_bakeable(name) for name in dict.fromkeys(words(products) or ("",))]
    for each in asked:
        each.check(chosen)
    if bits is not None and bits not in get_args(Bits):
        raise UsageError(f"Layers must have 8 or 16 bits, not {bits}.")
    check_workers(workers, dask, "A bake", part, finish)
    share = None if part is None else part_of(part)
    store = store.url if isinstance(store, StoredTerrain) else store
    storage = storage_at(store, storage_options)
    if dask is not None and not isinstance(storage, Place):
        raise UsageError(
            "The workers of a remote cluster exchange what they make in the store: they bake into folders and buckets.",
            remedy="Use `workers` of this machine.",
        )
    if workers is not None and storage.url.startswith("memory:"):
        raise UsageError("Workers bake into stores in folders or buckets.", remedy="Omit `workers`.")
    before = read_record(storage)  # report a missing store before anything is written beside it
    folder, shared = None, None
    if share is not None or finish:
        with open(store, storage_options=storage_options) as terrain:
            folder = bake_parts.check(storage, terrain, asked, chosen)
    if share is not None:  # parts with the same layers and number may run at once
        records = [_record(p, chosen, bits, before).to_json() for p in asked]
        shared = hashlib.blake2b(json.dumps([records, overwrite, share[1]]).encode(), digest_size=16).hexdigest()
    cache = min(64 << 20, max_memory // 16)
    with alone(storage, "baking into this store", shared):
        before = read_record(storage)
        made = [_record(p, chosen, bits, before) for p in asked]
        if not overwrite:
            there = [layer for layer in made if LAYERS.of(before).get(layer.name) == layer]
            for layer in there:
                progress.note(f"{layer.name} is already in {storage.url}, made with the same options.")
            made = [layer for layer in made if layer not in there]
        if folder is None:
            bake_parts.check_none(storage, before, overwrite, None if dask is None else plan_text(made))
        if folder is not None and share is None:
            bake_parts.finish(folder, before, made, progress)
        elif made and folder is not None and share is not None:
            bake_parts.make(folder, made, chosen, before.shard, share, threads_for(jobs), max_memory, progress)
        elif made and (workers is not None or dask is not None):
            _on_cluster(storage, before, made, chosen, overwrite, (workers, dask, jobs or 1, max_memory), progress)
        elif made:
            trim()  # left over from building the store
            with open(store, cache_bytes=cache, jobs=jobs, storage_options=storage_options) as terrain:
                context = Context(terrain, chosen, jobs=jobs, max_memory=max_memory, progress=progress)
                _make(context, storage, before, made, overwrite)
        storage.close()
        if share is not None:
            return None
        return open(store, cache_bytes=cache, jobs=jobs, storage_options=storage_options)


def _make(context: Context, storage: Storage, before: Record, made: list[LayerRecord], overwrite: bool) -> None:
    """Bake layers and move them into place."""
    writer = ShardWriter(storage, before.digests.keyed)
    if isinstance(storage, FolderStorage):
        context.kept = kept(storage, before, made, overwrite)
        writer = ShardWriter(FolderStorage(storage.path / PARTIAL))
    else:
        before = removed(storage, before, {layer.name for layer in made})
    products = [product(layer.name) for layer in made]
    for layer, read in zip(made, readers(context, products), strict=True):
        stage = LayerStage(writer, before, layer, is_cap(layer), _of_all(read))
        Threads(max(1, min(context.jobs, context.budget // stage.memory())), False).run(stage, context.progress)
    publish(storage, before, made, {layer.name for layer in made}, writer.digests)
    if context.kept is not None:
        context.kept.remove()


def _of_all(read: Callable[[Window], Values]) -> Callable[[Spot], Callable[[Window], Values]]:
    """Turn a function from shards to values into one from shards to readers of windows."""
    return lambda spot: read


def _on_cluster(
    storage: Storage, before: Record, made: list[LayerRecord], options: Options, overwrite: bool,
    how: tuple[int | None, Any, int, int], progress: Progress,
) -> None:  # fmt: skip
    """Let workers bake layers, and move these into place.

    For a store in a bucket, workers of this machine make them in the cache folder, and they are sent when they are
    complete; other workers make them in the bucket.

    Args:
        how: workers, dask, threads of each worker, bytes.
    """
    from orograph.lighting.bake_state import on_cluster, recipe_of

    workers, dask, jobs, max_memory = how
    each = max_memory // ((workers or 1) * jobs)
    if dask is not None and isinstance(storage, BucketStorage):
        plan = plan_text(made)
        recipe = recipe_of(None, storage.named(), options, made, plan, before.shard, each)
        begin(storage, plan, "begin anew with `overwrite=True`")
        writer = ShardWriter(partial_of(storage))
        with on_workers(recipe, workers, dask, jobs, max_memory, "A bake") as cluster:
            on_cluster(cluster, recipe.open(), writer, progress)
        take_place(storage, before, made, writer.digests, progress)
        return
    folder = storage if isinstance(storage, FolderStorage) else scratch(storage)
    checkpoint = kept(folder, before, made, overwrite)
    recipe = recipe_of(folder, storage.named(), options, made, folder.get(KEY) or b"", before.shard, each)
    partial = FolderStorage(folder.path / PARTIAL, many=True)
    writer = ShardWriter(partial)
    with on_workers(recipe, workers, dask, jobs, max_memory, "A bake") as cluster:
        on_cluster(cluster, recipe.open(), writer, progress)
    partial.sweep()
    names = {layer.name for layer in made}
    if folder is not storage:
        before = removed(storage, before, names)
        send(partial, storage, LAYERS.put(before, {layer.name: layer for layer in made}), writer.digests, progress)
    publish(storage, before, made, names, writer.digests)
    checkpoint.remove()


def check(names: Sequence[str]) -> None:
    """Raise UsageError unless all products can be baked, with all other options at their defaults.

    Raises:
        UsageError: there is no such product, it cannot be baked, or it needs an option.
    """
    for name in names:
        _bakeable(name)
        if any(default is None for _, default in BAKED[name].more):
            raise UsageError(
                f"{name} needs options.", remedy=f"Build first, then `orograph.bake(store, [{name!r}], ...)` with them."
            )


def _bakeable(name: str) -> Product:
    found = product(name)
    if name not in BAKED:
        raise UsageError(
            f"{name} is not baked: it follows directly from the heights, or holds for one sun only.",
            remedy=f"What can be baked is {', '.join(BAKED)}; for a map of {name} use orograph light.",
        )
    return found


def _record(of: Product, options: Options, bits: Bits | None, store: Record) -> LayerRecord:
    """The store's record of a layer."""
    how = BAKED[of.name]
    made_with: dict[str, Any] = {
        "azimuths": options.azimuths, "radius": options.radius, "curvature": options.curvature,
        "refraction": options.bending(store.grid.crs) if options.curvature else None,
        **{key: options.more.get(key, default) for key, default in how.more},
    }  # fmt: skip
    made_with |= {
        "rays": {"rays": options.rays, "seed": options.more.get("seed", 0)},
        "shadow-maps": {"rays": options.rays},
        "cone-tracing": {"cones": options.more.get("cones", 64)},
    }.get(str(made_with.get("method")), {})
    if callable(made_with.get("rho")):
        raise UsageError("A store cannot hold a function: bake with rho 'step' or 'linear'.")
    bands = tuple(
        LayerBand(band.name.replace(" ", "-"), band.unit, float(band.byte[0]), float(band.byte[1]), bits or how.bits)
        for band in of.described(options)
    )
    return LayerRecord(of.name, of.doc, bands, SAID[how.averaging], made_with, store.source)


__all__ = ["BAKED", "Baked", "bake"]
