"""A product of light in the shards of a store: encoded, and averaged level by level (see ``bake``).

A task makes a shard of level 0 with its part of the coarser levels. The combining process makes the levels above, and
coarse shards that several tasks share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import DamagedChunkError
from orograph.gpu.device import has_adapter
from orograph.lighting.context import Values
from orograph.lighting.gather import Window
from orograph.lighting.occlusion import ELSEWHERE
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.digests import SIZE, Spot
from orograph.store.executing import Stage
from orograph.store.layers import Codes, LayerBand, LayerRecord, layer_spec
from orograph.store.layout import Record
from orograph.store.levels import F64, BoxMeans, Counts, divide, halve_sums
from orograph.store.parts import pack, unpack
from orograph.store.pyramid import spans, tasks
from orograph.store.terrain import level_count, mean_shape
from orograph.store.writer import Canvas, ShardWriter

_STRIP = 64
"""Rows of a shard that are made at a time: an even number, so that blocks of 2 × 2 lie in one strip."""


SAID = {
    "mean": "mean of the valid samples of each block",
    "cap": "caps of each block's mean area, towards the mean of sin^2(radius) times their directions",
}
"""The averaging in a layer's record."""


def is_cap(layer: LayerRecord) -> bool:
    """Whether a layer is averaged as caps are."""
    return layer.averaging == SAID["cap"]


class Handed(NamedTuple):
    """The result of a task.

    Attributes:
        digests: of the shards of its bands. coarse: codes of each level from 1 on, of each band, as far as tasks make
            them. total, number: sums of each band, from which the levels above follow.
    """

    digests: list[bytes]
    coarse: list[list[Codes]]
    total: list[F64]
    number: list[Counts]


class LayerStage(Stage[Handed]):
    """Makes a layer's shards.

    Args:
        writer: of its shards. record: of the store. layer: what is made, averaged as "cap" or as means.
        reader: a shard → a function that returns the product's values (bands, rows, cols) in any window of it.
        keeps: whether tasks store their results for other processes. number: of the layer.
    """

    name = "layer"

    def __init__(
        self, writer: ShardWriter, record: Record, layer: LayerRecord, cap: bool,
        reader: Callable[[Spot], Callable[[Window], Values]], keeps: bool = False, number: int = 0,
    ) -> None:  # fmt: skip
        self.writer, self.layer, self.cap, self.reader, self.keeps, self.number = (
            writer, layer, cap, reader, keeps, number,
        )  # fmt: skip
        self.label = f"Baking {layer.name}"
        if layer.options.get("method") in ELSEWHERE:
            self.able = has_adapter
        self.shape, self.shard = record.grid.shape, record.shard
        levels = level_count(self.shape)
        self.direct = min(self.shard.bit_length() - 1, levels - 1)  # the coarsest level that tasks make themselves
        self.specs = [
            [layer_spec(self.shape, layer.name, k, b, record.shard, record.chunk) for b in layer.bands]
            for k in range(levels)
        ]
        self._coarse = [
            [Canvas(spec, writer, spans(self.shape, self.shard, k, spec.shape)) for spec in self.specs[k]]
            for k in range(1, self.direct + 1)
        ]
        above = self.direct < levels - 1
        self._rest = [_Rest(mean_shape(self.shape, self.direct)) for _ in layer.bands] if above else []

    @property
    def place(self) -> str:
        return self.writer.storage.url

    def memory(self) -> int:
        """Bytes that a task takes besides its input."""
        # Codes, sums and counts of 2 × 2, means, a shard as bytes; the values of a strip with intermediate results.
        size, n = self.layer.bands[0].bits // 8, len(self.layer.bands)
        return self.shard * self.shard * (n * (size + 4) + size) + self.shard * _STRIP * 4 * n * (12 if self.cap else 6)

    def tasks(self) -> list[Spot]:
        return tasks(self.shape, self.shard)

    def key(self, spot: Spot) -> str:
        return f"parts/{self.layer.name}.{spot[0]}.{spot[1]}.part"

    def kept(self, spot: Spot) -> bool:
        return self.writer.storage.exists(self.key(spot))

    def window(self, spot: Spot) -> Window:
        """Rows and columns of a shard of level 0."""
        row, col = spot[0] * self.shard, spot[1] * self.shard
        return row, min(row + self.shard, self.shape[0]), col, min(col + self.shard, self.shape[1])

    def make(self, spot: Spot) -> Handed:
        row, last, col, right = self.window(spot)
        bands, read = self.layer.bands, self.reader(spot)
        sums = [BoxMeans((last - row, right - col)) for _ in bands]

        def strips() -> Iterator[Values]:
            for top in range(row, last, _STRIP):
                values = read((top, min(top + _STRIP, last), col, right))
                for s, plane in zip(sums, _linear(values) if self.cap else values, strict=True):
                    s.add(top - row, np.ascontiguousarray(plane, np.float32))
                yield values

        codes = _coded(bands, (last - row, right - col), strips())
        digests = [self.writer.shard(spec, spot, codes.pop(0)) for spec in self.specs[0]]
        coarse = []
        for _ in range(1, self.direct + 1):
            means = [s.next() for s in sums]
            parts = (np.stack([m[top : top + _STRIP] for m in means]) for top in range(0, len(means[0]), _STRIP))
            coarse.append(_coded(bands, means[0].shape, map(_caps, parts) if self.cap else parts))
        made = Handed(digests, coarse, [s.total for s in sums], [s.count for s in sums])
        if self.keeps:
            self.writer.keep(self.key(spot), _packed(made))
        return made

    def found(self, spot: Spot, proof: bool = True) -> Handed | None:
        data = self.writer.storage.get(self.key(spot)) if self.keeps else None
        if data is None:
            return None
        try:
            made = _unpacked(data, len(self.layer.bands), self.direct)
            for spec, digest in zip(self.specs[0], made.digests, strict=True):
                self.writer.take(spec, spot, digest)
                ShardedArray(spec, self.writer.storage, self.writer.digests, ChunkCache(0), 1).prove(spot, proof)
        except (DamagedChunkError, ValueError, KeyError):
            return None
        return made

    def add(self, spot: Spot, found: Handed) -> None:
        row, _, col, _ = self.window(spot)
        for k, codes in enumerate(found.coarse, 1):
            for canvas, code in zip(self._coarse[k - 1], codes, strict=True):
                canvas.add(row >> k, col >> k, code)
        for part, total, number in zip(self._rest, found.total, found.number):
            part.add(row >> self.direct, col >> self.direct, total, number)

    def finish(self) -> None:
        for k in range(self.direct + 1, len(self.specs)):
            means = np.stack([part.next(mean_shape(self.shape, k)) for part in self._rest])
            planes = _caps(means) if self.cap else means
            for band, spec, plane in zip(self.layer.bands, self.specs[k], planes, strict=True):
                self.writer.array(spec, band.encode(plane))


def layer_stages(writer: ShardWriter, record: Record, layers: list[LayerRecord]) -> list[LayerStage]:
    """The stages of layers whose shards other processes make, for the combining process."""
    return [LayerStage(writer, record, layer, is_cap(layer), _nothing, True, k) for k, layer in enumerate(layers)]


def _nothing(spot: Spot) -> Callable[[Window], Values]:
    raise AssertionError("others make shards")


def _packed(made: Handed) -> bytes:
    named: dict[str, NDArray[np.generic]] = {"digests": np.frombuffer(b"".join(made.digests), np.uint8)}
    for b in range(len(made.digests)):
        named |= {f"total.{b}": made.total[b], f"number.{b}": made.number[b]}
        named |= {f"code.{k}.{b}": codes[b] for k, codes in enumerate(made.coarse)}
    return pack(named)


def _unpacked(data: bytes, bands: int, levels: int) -> Handed:
    named, each = unpack(data), range(bands)
    digests = named["digests"].tobytes()
    coarse: list[list[Codes]] = [[named[f"code.{k}.{b}"] for b in each] for k in range(levels)]
    return Handed(
        [digests[SIZE * b : SIZE * (b + 1)] for b in each], coarse,
        [named[f"total.{b}"] for b in each], [named[f"number.{b}"] for b in each],
    )  # fmt: skip


def _coded(bands: Sequence[LayerBand], shape: tuple[int, ...], strips: Iterable[Values]) -> list[Codes]:
    """Codes (rows, cols) of each band, from values that come in strips (bands, rows, cols) from the top.

    The values of a whole shard, with intermediate results, take many times the memory of its codes.
    """
    codes: list[Codes] = [np.empty(shape, band.dtype) for band in bands]
    row = 0
    for values in strips:
        for out, band, plane in zip(codes, bands, values, strict=True):
            out[row : row + len(plane)] = band.encode(plane)
        row += values.shape[1]
    return codes


class _Rest:
    """Sums of the coarsest level that tasks make, from which the levels above follow."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.total = np.zeros(shape)
        self.count = np.zeros(shape, np.int64)

    def add(self, row: int, col: int, total: F64, count: Counts) -> None:
        area = np.s_[row : row + total.shape[0], col : col + total.shape[1]]
        self.total[area], self.count[area] = total, count

    def next(self, shape: tuple[int, int]) -> Values:
        total, count = np.empty(shape), np.empty(shape, np.int64)
        halve_sums(self.total, self.count, total, count)
        self.total, self.count = total, count
        mean = np.empty(shape, np.float32)
        divide(total, count, mean)
        return mean


def _linear(caps: Values) -> NDArray[np.float32]:
    """Caps (4, rows, cols) (direction, radius in degrees) → their additive form: sin² r · direction, 1 − cos r."""
    radius = np.radians(caps[3])
    square = np.sin(radius) ** 2
    # 1 − cos r = 2 sin² (r / 2), without cancellation.
    return np.stack([*(square * caps[:3]), 2.0 * np.sin(radius / 2) ** 2]).astype(np.float32)


def _caps(means: Values) -> Values:
    """The inverse of ``_linear`` for means; if nothing is visible, the radius is 0 and the direction up."""
    length = np.sqrt((means[:3].astype(np.float64) ** 2).sum(0))
    seen = length > 1e-12
    with np.errstate(invalid="ignore", divide="ignore"):
        direction = np.where(seen, means[:3] / length, np.array([0.0, 0.0, 1.0])[:, None, None])
    radius = np.degrees(2.0 * np.arcsin(np.sqrt(np.clip(means[3].astype(np.float64) / 2, 0.0, 0.5))))
    out = np.concatenate([direction, radius[None]]).astype(np.float32)
    out[:, np.isnan(means[3])] = np.nan
    return out
