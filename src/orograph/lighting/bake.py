"""Baked light: products put into a store as layers, at all its levels, so that renderers find them tile by tile.

What depends on the ground alone and takes long is worth keeping: skies, occlusion, apertures, horizons. Products are
made as for a map (``products``), several of the same horizons in one sweep, then cut into the store's shards and
averaged over blocks of 2 × 2, 4 × 4… samples, always out of the exact values of the full resolution, and quantised
last, each level by itself. How a product is averaged:

- *mean*: of the valid samples, for what adds up as light does (sky-view factors, occlusion, insolation) and for angles
  that are near one another (horizons, openness);
- *cap*, for apertures: the area of a block's cap is the mean of its samples' areas, 1 − cos r = mean(1 − cos rᵢ), and
  its direction that of the mean of what the caps would give of a uniform sky, ∑ sin² rᵢ cᵢ (the first moment of a cap
  of direction c and radius r is π sin² r c): a light seen by half of the samples is seen by half of the cap.

A bake into a folder is made in ``layers/.partial``, keeps what has been swept there, and takes its place when all of it
is complete; the store stays readable, with the layers it had, until then. At a URL there is no renaming: layers are
taken out of the store's record first, and are in it again when they are complete.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OutputError, StoreError, UsageError
from orograph.lighting.context import MEMORY, Context, Options, Values
from orograph.lighting.gather import Window, readers
from orograph.lighting.products import Product, product
from orograph.lighting.raster import trim
from orograph.lighting.raster_resume import Checkpoint
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.store.digests import Digests
from orograph.store.layers import GROUP, LAYERS, Bits, Codes, LayerBand, LayerRecord, layer_spec
from orograph.store.layout import Record, publish
from orograph.store.levels import BoxMeans, divide, halve_sums
from orograph.store.lock import alone
from orograph.store.pyramid import spans, tasks
from orograph.store.shards import go_through
from orograph.store.storage import FolderStorage, Storage, storage_at
from orograph.store.stored import StoredTerrain, open, read_record
from orograph.store.terrain import level_count, mean_shape
from orograph.store.writer import Canvas, ShardWriter

Averaging = Literal["mean", "cap"]

PARTIAL = f"{GROUP}/.partial"
"""Where a bake is made until it is complete."""

_STRIP = 64
"""Rows of a shard that are made at a time: an even number, so that blocks of 2 × 2 lie in one strip."""

_SAID = {
    "mean": "mean of the valid samples of each block",
    "cap": "caps of each block's mean area, towards the mean of sin^2(radius) times their directions",
}


@dataclass(frozen=True, slots=True)
class Baked:
    """How a product is put into a store.

    Attributes:
        averaging: see the module.
        bits: of a code, unless others are asked for.
        more: which of ``Options.more`` it has, and what they are if nothing is said.
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
}
"""Products that can be baked. The others follow from heights at once, or hold for one sun only."""


def bake(
    store: StoredTerrain | str | Path,
    names: Sequence[str] | str,
    options: Options | None = None,
    *,
    bits: Bits | None = None,
    overwrite: bool = False,
    max_memory: int = MEMORY,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    storage_options: dict[str, Any] | None = None,
    **more: Any,
) -> StoredTerrain:
    """Put products of light into a store, as layers of their names, and open it again.

    A layer of the same name is replaced, unless it was made with the same options; then it is left as it is. An
    interrupted bake into a folder goes on when it is asked for again.

    Args:
        store: a folder, a URL that fsspec can write to, or an opened store of these.
        names: of products, those in ``BAKED``.
        options: of the products.
        bits: of a code: 8 or 16; None: what the product needs (16 for apertures and insolation, else 8).
        overwrite: bake also what is there already, and begin anew what was interrupted.
        max_memory: bytes the process should stay within.
        jobs: threads; None: all processors. The store's bytes do not depend on either.
        progress: hears of it; None: bars in terminals and notebooks, and Python's warnings; False: nothing is said.
        storage_options: for the fsspec file system.
        more: the products' options by name, instead of ``options``: ``radius=600``, ``rho="linear"``…

    Raises:
        UsageError: there is no such product, it cannot be baked, or its options make no sense.
        StoreError: there is no store, another bake is at work or was interrupted, or it cannot be written.
    """
    progress = reporting(progress)
    if options is not None and more:
        raise UsageError("Give the products' options as Options, or by their names, not both.")
    names = [names] if isinstance(names, str) else names
    chosen, wanted = options or Options.of(**more), list(dict.fromkeys(names))
    products = [_bakeable(name) for name in wanted]
    for each in products:
        each.check(chosen)
    if bits is not None and bits not in get_args(Bits):
        raise UsageError(f"Layers have 8 or 16 bits, not {bits}.")
    store = store.url if isinstance(store, StoredTerrain) else store
    storage = storage_at(store, storage_options)
    read_record(storage)  # a store that is not there is said before anything is written beside it
    cache = min(64 << 20, max_memory // 16)
    with alone(storage, "baking into this store"):
        before = read_record(storage)
        made = [_record(p, chosen, bits, before) for p in products]
        if not overwrite:
            there = [layer for layer in made if LAYERS.of(before).get(layer.name) == layer]
            for layer in there:
                progress.note(f"{layer.name} is in {storage.url} already, made with the same options.")
            made = [layer for layer in made if layer not in there]
        if made:
            trim()  # what building the store has left
            with open(store, cache_bytes=cache, jobs=jobs, storage_options=storage_options) as terrain:
                context = Context(terrain, chosen, jobs=jobs, max_memory=max_memory, progress=progress)
                _make(context, storage, before, made, overwrite)
        storage.close()
        return open(store, cache_bytes=cache, jobs=jobs, storage_options=storage_options)


def _make(context: Context, storage: Storage, before: Record, made: list[LayerRecord], overwrite: bool) -> None:
    """Bake layers, and let them take their places."""
    writer = ShardWriter(storage)
    if isinstance(storage, FolderStorage):
        context.kept = _kept(storage, before, made, overwrite)
        writer = ShardWriter(FolderStorage(storage.path / PARTIAL))
    else:
        before = _publish(storage, before, [], {layer.name for layer in made}, writer.digests)
    products = [product(layer.name) for layer in made]
    for layer, read in zip(made, readers(context, products), strict=True):
        _write(context, writer, before, layer, read)
    _publish(storage, before, made, {layer.name for layer in made}, writer.digests)
    if context.kept is not None:
        context.kept.remove()


def check(names: Sequence[str]) -> None:
    """Raise UsageError unless all products can be baked, with nothing but their defaults.

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
            f"{name} is not baked: it follows from the heights at once, or holds for one sun only.",
            remedy=f"What can be baked is {', '.join(BAKED)}; for a map of {name} use orograph light.",
        )
    return found


def _record(of: Product, options: Options, bits: Bits | None, store: Record) -> LayerRecord:
    """What the store will say of a layer."""
    how = BAKED[of.name]
    made_with: dict[str, Any] = {
        "azimuths": options.azimuths, "radius": options.radius, "curvature": options.curvature,
        "refraction": options.bending(store.grid.crs) if options.curvature else None,
        **{key: options.more.get(key, default) for key, default in how.more},
    }  # fmt: skip
    if made_with.get("method") == "rays":
        made_with["rays"] = options.rays
    if callable(made_with.get("rho")):
        raise UsageError("A function cannot be told in a store: bake with rho 'step' or 'linear'.")
    bands = tuple(
        LayerBand(band.name.replace(" ", "-"), band.unit, float(band.byte[0]), float(band.byte[1]), bits or how.bits)
        for band in of.described(options)
    )
    return LayerRecord(of.name, of.doc, bands, _SAID[how.averaging], made_with, store.source)


def _kept(storage: FolderStorage, record: Record, made: list[LayerRecord], overwrite: bool) -> Checkpoint:
    """The folder of the bake under way: that of the same bake, interrupted, or a new one."""
    plan = {layer.name: layer.to_json() for layer in made}
    if overwrite or _finished(storage, record):
        storage.remove(PARTIAL)
    try:
        (storage.path / GROUP).mkdir(exist_ok=True)
    except OSError as error:
        raise StoreError(f"Nothing can be written there: {error.strerror}.", path=storage.url) from error
    try:
        return Checkpoint(storage.path / PARTIAL, plan)
    except OutputError as error:
        if storage.get(f"{PARTIAL}/plan.json") is None:
            raise
        raise StoreError(
            "Another bake into this store was interrupted.",
            path=storage.url,
            remedy="Run it again with the same products and options to finish it, or begin anew with `overwrite=True`.",
        ) from error


def _finished(storage: FolderStorage, record: Record) -> bool:
    """Whether all that was begun is in the store: a bake was cut off just before its very end."""
    try:
        plan: dict[str, Any] = json.loads(storage.get(f"{PARTIAL}/plan.json") or b"")
    except ValueError:
        return False
    there = LAYERS.of(record)
    return all(name in there and there[name].to_json() == layer for name, layer in plan.items())


def _write(
    context: Context, writer: ShardWriter, record: Record, layer: LayerRecord, read: Callable[[Window], Values]
) -> None:
    """Cut a product into shards, and average it level by level."""
    shape, shard, chunk = record.grid.shape, record.shard, record.chunk
    levels = level_count(shape)
    direct = min(shard.bit_length() - 1, levels - 1)  # the coarsest level that shards make themselves
    cap = BAKED[layer.name].averaging == "cap"

    specs = [[layer_spec(shape, layer.name, k, b, shard, chunk) for b in layer.bands] for k in range(levels)]
    coarse = [
        [Canvas(spec, writer, spans(shape, shard, k, spec.shape)) for spec in specs[k]] for k in range(1, direct + 1)
    ]
    rest = [_Rest(mean_shape(shape, direct)) for _ in layer.bands] if direct < levels - 1 else []
    spots = tasks(shape, shard)

    def run(spot: tuple[int, int]) -> None:
        row, col = spot[0] * shard, spot[1] * shard
        last, right = min(row + shard, shape[0]), min(col + shard, shape[1])
        sums = [BoxMeans((last - row, right - col)) for _ in layer.bands]

        def strips() -> Iterator[Values]:
            for top in range(row, last, _STRIP):
                values = read((top, min(top + _STRIP, last), col, right))
                for s, plane in zip(sums, _linear(values) if cap else values, strict=True):
                    s.add(top - row, np.ascontiguousarray(plane, np.float32))
                yield values

        codes = _coded(layer.bands, (last - row, right - col), strips())
        for spec in specs[0]:
            writer.shard(spec, spot, codes.pop(0))
        for k in range(1, direct + 1):
            means = [s.next() for s in sums]
            parts = (np.stack([m[top : top + _STRIP] for m in means]) for top in range(0, len(means[0]), _STRIP))
            codes = _coded(layer.bands, means[0].shape, map(_caps, parts) if cap else parts)
            for canvas in coarse[k - 1]:
                canvas.add(row >> k, col >> k, codes.pop(0))
        for part, s in zip(rest, sums):
            part.add(row >> direct, col >> direct, s)

    def coarsest() -> None:
        for k in range(direct + 1, levels):
            means = np.stack([part.next(mean_shape(shape, k)) for part in rest])
            for band, spec, plane in zip(layer.bands, specs[k], _caps(means) if cap else means, strict=True):
                writer.array(spec, band.encode(plane))

    # Codes, sums and counts of 2 × 2, means, a shard as bytes; the values of a strip and what comes up with them.
    size, n = layer.bands[0].bits // 8, len(layer.bands)
    need = shard * shard * (n * (size + 4) + size) + shard * _STRIP * 4 * n * (12 if cap else 6)
    at_once = max(1, min(context.jobs, context.budget // need))
    go_through(f"Baking {layer.name}", spots, run, at_once, context.progress, coarsest)


def _coded(bands: Sequence[LayerBand], shape: tuple[int, ...], strips: Iterable[Values]) -> list[Codes]:
    """Codes (rows, cols) of each band, of values that come in strips (bands, rows, cols) from the top.

    The values of a whole shard, and what comes up on the way to them, are many times its codes.
    """
    codes: list[Codes] = [np.empty(shape, band.dtype) for band in bands]
    row = 0
    for values in strips:
        for out, band, plane in zip(codes, bands, values, strict=True):
            out[row : row + len(plane)] = band.encode(plane)
        row += values.shape[1]
    return codes


class _Rest:
    """Sums of the coarsest level that shards make, from which the levels above it follow."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.total = np.zeros(shape)
        self.count = np.zeros(shape, np.int64)

    def add(self, row: int, col: int, sums: BoxMeans) -> None:
        area = np.s_[row : row + sums.total.shape[0], col : col + sums.total.shape[1]]
        self.total[area], self.count[area] = sums.total, sums.count

    def next(self, shape: tuple[int, int]) -> Values:
        total, count = np.empty(shape), np.empty(shape, np.int64)
        halve_sums(self.total, self.count, total, count)
        self.total, self.count = total, count
        mean = np.empty(shape, np.float32)
        divide(total, count, mean)
        return mean


def _linear(caps: Values) -> NDArray[np.float32]:
    """Caps (4, rows, cols) (direction, radius in degrees) → what of them adds up: sin² r · direction, 1 − cos r."""
    radius = np.radians(caps[3])
    square = np.sin(radius) ** 2
    # 1 − cos r = 2 sin² (r / 2), without cancellation.
    return np.stack([*(square * caps[:3]), 2.0 * np.sin(radius / 2) ** 2]).astype(np.float32)


def _caps(means: Values) -> Values:
    """The inverse of ``_linear``, of means; where nothing is seen the radius is 0 and the direction up."""
    length = np.sqrt((means[:3].astype(np.float64) ** 2).sum(0))
    seen = length > 1e-12
    with np.errstate(invalid="ignore", divide="ignore"):
        direction = np.where(seen, means[:3] / length, np.array([0.0, 0.0, 1.0])[:, None, None])
    radius = np.degrees(2.0 * np.arcsin(np.sqrt(np.clip(means[3].astype(np.float64) / 2, 0.0, 0.5))))
    out = np.concatenate([direction, radius[None]]).astype(np.float32)
    out[:, np.isnan(means[3])] = np.nan
    return out


def _publish(storage: Storage, before: Record, made: list[LayerRecord], gone: set[str], digests: Digests) -> Record:
    """Let layers take their place: the old ones go first, the record that names the new ones is written last."""
    left = {name: layer for name, layer in LAYERS.of(before).items() if name not in gone}
    record = LAYERS.put(before, left)
    if gone & set(LAYERS.of(before)):
        publish(storage, record)
        for name in gone & set(LAYERS.of(before)):
            storage.remove(f"{GROUP}/{name}")
        record = read_record(storage)
    if isinstance(storage, FolderStorage):
        for layer in made:
            storage.remove(f"{GROUP}/{layer.name}")
            storage.rename(f"{PARTIAL}/{GROUP}/{layer.name}", f"{GROUP}/{layer.name}")
    if made:
        layers = dict(sorted({**left, **{layer.name: layer for layer in made}}.items()))
        record = replace(LAYERS.put(record, layers), digests=record.digests.joined(digests))
        publish(storage, record)
    return record


__all__ = ["BAKED", "Baked", "bake"]
