"""Bakes in parts, for job arrays: independent processes, as in ``store.in_parts``.

Part I of N makes its share of the shards of level 0 of all layers, and stores what the coarser levels need from them;
``finish`` makes those and moves the layers into place. This works for products whose shards follow from heights alone:
rays, walks, and horizons within a radius. Horizons without a radius are swept across the whole terrain, row of shards
by row, so no part could do its own without waiting for others.

The sweeps of a shard are kept until its layers are made; a killed part resumes there. For a store in a bucket, sweeps
are in the cache folder of the machine, while shards and the input for coarser levels are in the bucket, where
``finish`` has them copied to their places.
"""

from __future__ import annotations

from collections.abc import Sequence

from orograph.errors import StoreError, UsageError
from orograph.lighting.bake_folder import (
    KEY,
    Place,
    another,
    begin,
    discard,
    finished,
    group,
    partial_of,
    plan_text,
    scratch,
    take_place,
)
from orograph.lighting.bake_layers import layer_stages
from orograph.lighting.bake_state import SweepStage, recipe_of
from orograph.lighting.context import BASE, Context, Options
from orograph.lighting.gather import Sweep
from orograph.lighting.products import Product
from orograph.lighting.raster_resume import PLAN
from orograph.progress import Progress
from orograph.store.bucket import BucketStorage
from orograph.store.digests import Spot
from orograph.store.in_parts import Part, count_of, gather, share
from orograph.store.layers import PARTIAL, LayerRecord
from orograph.store.layout import Record
from orograph.store.shards import go_through
from orograph.store.storage import FolderStorage, Storage
from orograph.store.terrain import Terrain
from orograph.store.worker_state import guarded
from orograph.store.writer import ShardWriter


def check(storage: Storage, terrain: Terrain, products: Sequence[Product], options: Options) -> Place:
    """The store, if these products can be baked into it in parts.

    Raises:
        UsageError: they cannot.
    """
    if not isinstance(storage, Place):
        raise UsageError(
            "Parts bake into stores in folders or buckets, where what they leave for one another lies beside the "
            "layers.", remedy="Use one process, or bake a copy in a folder and publish that.",
        )  # fmt: skip
    unlimited = [
        each.name for each in products
        if options.radius is None and isinstance(each.make(Context(terrain, options)), Sweep)
    ]  # fmt: skip
    if unlimited:
        raise UsageError(
            f"Horizons without a radius reach across the whole terrain, so no part can sweep its own alone: "
            f"{', '.join(unlimited)}.", remedy="Give a `radius`, or use `workers` or `dask`.",
        )  # fmt: skip
    return storage


def make(
    storage: Place, made: list[LayerRecord], options: Options, shard: int, part: Part, jobs: int,
    max_memory: int, progress: Progress,
) -> None:  # fmt: skip
    """Make a part of layers.

    Args:
        made: the layers. options: of the products. shard: samples along the sides of the store's shards.
        jobs: threads. max_memory: bytes the process should stay within.

    Raises:
        StoreError: another bake was begun, or it cannot be written.
    """
    index, count = part
    room = max_memory - BASE
    plan = plan_text(made, count)
    # (In its own folder: another part on this machine may end first, and remove its sweeps.)
    here = storage if isinstance(storage, FolderStorage) else scratch(storage, plan, str(index).encode())
    recipe = recipe_of(here, storage.named(), options, made, plan, shard, BASE + room // jobs)
    begin(storage, plan, _restart_remedy(storage))
    group(here)
    state = recipe.open()
    if here is not storage:
        state.made = guarded(partial_of(storage), PLAN, plan)
    layers = [state.layer(k) for k in range(len(made))]
    sweeps = [SweepStage(state, n) for n in range(len(state.numbers))]

    def do(spot: Spot) -> None:
        left = {layer.number: layer for layer in layers if layer.found(spot) is None}
        for sweep in sweeps:
            wanted = [left.pop(number) for number in sweep.products if number in left]
            if wanted and sweep.found(spot) is None:
                sweep.make(spot)
            for layer in wanted:
                layer.make(spot)
            sweep.forget(spot)
        for layer in left.values():
            layer.make(spot)

    with state.terrain:
        threads = max(1, min(jobs, room // recipe.memory))
        go_through(f"Baking part {index} of {count}", share(layers[0].tasks(), part), do, threads, progress)
    if here is not storage:
        here.remove()


def check_none(storage: Storage, before: Record, overwrite: bool, own: bytes | None) -> None:
    """Refuse a bake without parts if parts have begun one in a bucket (``kept`` checks folders).

    Args:
        before: the store's record. overwrite: remove such a bake. own: the plan to resume, if any.

    Raises:
        StoreError: another was begun.
    """
    if not isinstance(storage, BucketStorage) or (there := storage.get(KEY)) is None:
        return
    if overwrite or finished(storage, before):
        discard(storage)
    elif there != own:
        raise another(storage, there, "begin anew with `overwrite=True`")


def _restart_remedy(storage: Place) -> str:
    if isinstance(storage, FolderStorage):
        return f"remove {storage.path / PARTIAL} to begin anew"
    return "bake in one process with `overwrite=True`, which removes it"


def finish(storage: Place, before: Record, made: list[LayerRecord], progress: Progress) -> None:
    """Make the rest of layers whose parts are all complete, and move them into place.

    Args:
        before: the store's record. made: the layers that do not exist yet.

    Raises:
        StoreError: parts are missing, none was made, or another bake was begun.
    """
    if not made:  # everything may already be in the store, if an earlier ``finish`` was killed at its very end
        if finished(storage, before):
            discard(storage)
        return
    there = storage.get(KEY)
    if there is None:
        raise StoreError("No part of it was baked.", path=storage.url, remedy="Bake its parts first: `part=(1, N)`.")
    count = count_of(there)
    if count is None:
        raise StoreError(
            "A bake was begun there that is not in parts.", path=storage.url,
            remedy="Run it again with the same products and options, and without `finish`.",
        )  # fmt: skip
    if there != plan_text(made, count):
        raise another(storage, there, _restart_remedy(storage))
    writer = ShardWriter(partial_of(storage))
    gather(layer_stages(writer, before, made), count, storage.url, progress)
    take_place(storage, before, made, writer.digests, progress)
