"""The heights of a build: one task per full-resolution shard, from which every coarser level follows.

A task reads its square of 2^m samples and the row and column beyond it that its tiles share with their neighbours,
writes the shard, and computes its complete contribution: its samples of every nested level, its box means, its tile
tables, and the errors of the levels up to m. Samples and means go directly into the coarse shards that hold them; a
coarse shard is written once its last part is in. Tasks run in quadtree post-order (Morton order), so only a few coarse
shards per level are open at once: memory grows with the depth of the pyramid, not with the raster.

A task's result is stored in ``parts/`` until the build is complete. A resumed build reads finished shards back, which
verifies their checksums and gives the same samples, hence the same bytes, as the first time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.diamonds import halve
from orograph.errors import DamagedChunkError
from orograph.store.array_spec import ArraySpec
from orograph.store.arrays import ShardedArray, Window
from orograph.store.cache import ChunkCache
from orograph.store.coding import Coding
from orograph.store.digests import Spot
from orograph.store.executing import ShardStage
from orograph.store.layout import TABLES_AND_VALID, heights_spec, mean_spec, table_spec
from orograph.store.levels import (
    BoxMeans,
    divide,
    extrema,
    halve_sums,
    magnitude,
    quarter,
    reduce_tiles,
    round_up,
    tile_errors,
)
from orograph.store.parts import pack, unpack
from orograph.store.places import PARTS
from orograph.store.progressive import closed, coarse_of, known
from orograph.store.source import HeightSource
from orograph.store.terrain import TILE, Heights, Shape, TileTable, level_count, level_shape, mean_shape, tile_shape
from orograph.store.writer import Canvas, ShardWriter

Facts = dict[str, NDArray[Any]]
Kind = Callable[[Shape, int, int, int, Coding | None], ArraySpec]


def tasks(shape: Shape, shard: int) -> list[Spot]:
    """The full-resolution shards (row, col) in Morton order."""
    rows, cols = -(-shape[0] // shard), -(-shape[1] // shard)
    spots = [(i, j) for i in range(rows) for j in range(cols)]
    return sorted(spots, key=lambda spot: _spread(spot[0]) << 1 | _spread(spot[1]))


def _spread(value: int) -> int:
    return sum((value >> bit & 1) << (2 * bit) for bit in range(value.bit_length()))


def part_key(spot: Spot) -> str:
    """The key of the result of a shard of level 0."""
    return f"{PARTS}/{spot[0]}.{spot[1]}.part"


class Finest:
    """The first part of tasks: shards of level 0, and what follows from them and a row and a column beyond.

    Args:
        source: the heights.
        writer: of shards.
        shard, chunk: samples along their sides; powers of two.
        coding: how heights are encoded.
    """

    def __init__(
        self, source: HeightSource, writer: ShardWriter, shard: int, chunk: int, coding: Coding | None = None
    ) -> None:
        self.source, self.writer, self.shard, self.chunk, self.coding = source, writer, shard, chunk, coding
        self.shape = source.grid.shape
        self.direct = min(shard.bit_length(), level_count(self.shape)) - 1
        self.spec = self.spec_of(heights_spec, 0)

    def make(self, spot: Spot) -> tuple[Heights, Facts]:
        """Read the heights, write the shard, compute its tiles, and store the result.

        Returns the shard's samples and the result.
        """
        size = self.shard
        row, col = spot[0] * size, spot[1] * size
        heights, facts = self.read(spot)
        own = heights[:size, :size]
        digest = self.writer.shard(self.spec, spot, own)
        low, high, valid = extrema(heights)
        facts |= {"low": low, "high": high, "valid": valid, "digest": np.frombuffer(digest, np.uint8)}
        if self.spec.coarser is not None:  # without it the shard cannot be read back
            facts["coarse"] = self._coarse(spot, own)
        facts["samples"] = np.array(own.size - np.count_nonzero(np.isnan(own)))
        empty = not valid.any()
        for level in range(1, self.direct + 1):
            if empty:
                facts[f"worst{level}"] = np.zeros((1, 1))
            else:
                facts[f"worst{level}"] = tile_errors(heights, level, (row, col))
        self.writer.keep(self.key(spot), pack(facts))
        return own, facts

    def read(self, spot: Spot) -> tuple[Heights, Facts]:
        """A shard's encoded samples, with the row and column that follow, and the loss."""
        (rows, cols), size = self.shape, self.shard
        row, col = spot[0] * size, spot[1] * size
        heights = self.source.read(row, min(row + size + 1, rows), col, min(col + size + 1, cols))
        heights = np.ascontiguousarray(heights, np.float32)
        if self.coding is None:
            return heights, {}
        kept = None
        if self.coding.codec == "progressive":
            self.coding.bounded(float(np.nanmax(np.abs(heights), initial=0.0)))
            levels = min((size // self.chunk).bit_length(), level_count(self.shape) - 1)
            kept = closed(heights, self.coding.step, levels, self.chunk, self.coding.factor)
        heights, lost = self.coding.rounded(heights, size, kept)
        return heights, {"lost": lost}

    def key(self, spot: Spot) -> str:
        """The key of the result."""
        return f"{PARTS}/{spot[0]}.{spot[1]}.part"

    def _coarse(self, spot: Spot, own: Heights) -> NDArray[np.uint8]:
        """A shard's samples of level 1, packed."""
        from orograph._blosc import blosc

        assert self.spec.packing is not None
        numbers = coarse_of(self.spec.packing.numbers(own), self._last(spot))
        packed = blosc.compress(numbers, b"zstd", 1, blosc.SHUFFLE)
        return np.frombuffer(packed, np.uint8)

    def _kept(self, spot: Spot, packed: bytes) -> Window:
        """As an array that reads these samples."""
        from orograph._blosc import blosc

        assert self.spec.packing is not None
        row0, row1, col0, col1 = self.spec.window(spot)
        last = self._last(spot)
        shape = (row1 - row0 + 1) // 2 + last[0], (col1 - col0 + 1) // 2 + last[1]
        numbers = np.frombuffer(blosc.decompress(packed), np.int32).reshape(shape)
        return Window((row0 // 2, col0 // 2), self.spec.packing.heights(numbers))

    def _last(self, spot: Spot) -> tuple[int, int]:
        row0, row1, col0, col1 = self.spec.window(spot)
        return known(self.shape, (row0, col0), (row1 - row0, col1 - col0))

    def spec_of(self, kind: Kind, level: int) -> ArraySpec:
        """The array of the heights or means of a level."""
        return kind(self.shape, level, self.shard, self.chunk, self.coding)

    def found(self, spot: Spot) -> tuple[Heights, Facts] | None:
        """The result of a shard that was finished before; None if it was not, or is damaged."""
        data = self.writer.storage.get(self.key(spot))
        if data is None:
            return None
        array = ShardedArray(self.spec, self.writer.storage, self.writer.digests, ChunkCache(0), 1)
        try:
            facts = unpack(data)
            self.writer.take(self.spec, spot, facts["digest"].tobytes())
            if array.coarser is not None:
                array.coarser = self._kept(spot, facts["coarse"].tobytes())
            return array.read(*self.spec.window(spot)), facts
        except (DamagedChunkError, RuntimeError, ValueError):
            return None


class Above:
    """The heights and means of some levels, assembled from those below them.

    Args:
        finest: the level at the bottom.
        levels: the levels to assemble; they are consecutive.
        below: the level whose shards are as large as the areas added.
    """

    def __init__(self, finest: Finest, levels: range, below: int = 0) -> None:
        self.levels, self.area = levels, finest.shard << below
        self.heights = {k: self._canvas(finest, heights_spec, k) for k in levels}
        self.means = {k: self._canvas(finest, mean_spec, k) for k in levels}

    def _canvas(self, finest: Finest, kind: Kind, level: int) -> Canvas:
        spec = finest.spec_of(kind, level)
        return Canvas(spec, finest.writer, spans(finest.shape, self.area, level, spec.shape))

    def add(self, row: int, col: int, end: tuple[bool, bool], nested: Heights, means: BoxMeans, level: int) -> Heights:
        """Put an area's data into the levels above ``level``; returns its samples of the last of them.

        Args:
            row, col: the area's first sample of level 0.
            end: whether it reaches the raster's last row and column.
            nested, means: of the area, at ``level``.
        """
        for above in range(level + 1, self.levels.stop):
            nested = halve(nested, end)
            self.heights[above].add(row >> above, col >> above, nested)
            self.means[above].add(row >> above, col >> above, means.next())
        return nested


class Pyramid(ShardStage[tuple[Heights, Facts]]):
    """All height arrays of a store under construction.

    Args:
        source: the heights.
        writer: of its shards.
        shard, chunk: samples along their sides; powers of two.
        finest: makes the shards of level 0.
        label: for progress reports.
        groups: levels of the groups that are added (``groups``); 0: shards are added.

    Attributes:
        lost: the coding losses that each task found.
    """

    name = "heights"

    def __init__(self, finest: Finest, label: str = "", groups: int = 0) -> None:
        self.finest, self.label, self.writer = finest, label, finest.writer
        self.shard, self.chunk = finest.shard, finest.chunk
        self.lost: list[NDArray[np.float64]] = []
        self.shape = shape = finest.shape
        self.levels = level_count(shape)
        self.direct = self.finest.direct  # the coarsest level that tasks make themselves
        self.above = Above(self.finest, range(groups + 1, self.direct + 1), groups)
        tiles = tile_shape(shape, 0)
        self.low, self.high = np.full(tiles, np.nan, np.float32), np.full(tiles, np.nan, np.float32)
        self.least, self.most = np.full(tiles, 2, np.uint8), np.zeros(tiles, np.uint8)
        self.worst = {k: np.zeros(tile_shape(shape, k)) for k in range(1, self.levels)}
        self.valid_samples = 0
        self._lock = threading.Lock()
        # Levels beyond ``direct`` are small: make them at the end, from the last one that tasks made.
        self.last = np.full(level_shape(shape, self.direct), np.nan, np.float32)
        self.last_total = np.zeros(mean_shape(shape, self.direct))
        self.last_count = np.zeros(mean_shape(shape, self.direct), np.int64)

    def tasks(self) -> list[Spot]:
        return tasks(self.shape, self.shard)

    def key(self, spot: Spot) -> str:
        return self.finest.key(spot)

    def make(self, spot: Spot) -> tuple[Heights, Facts]:
        return self.finest.make(spot)

    def found(self, spot: Spot, proof: bool = True) -> tuple[Heights, Facts] | None:
        return self.finest.found(spot)

    def add(self, spot: Spot, found: tuple[Heights, Facts]) -> None:
        own, facts = found
        self.rise(spot, own, BoxMeans(own), 0)
        self.combine(spot, facts)

    def rise(self, spot: Spot, nested: Heights, means: BoxMeans, level: int) -> None:
        """Put an area into the levels above ``level``.

        Args:
            spot: its (row, col) among the areas of one shard of ``level``.
            nested, means: of the area, at ``level``.
        """
        row, col = (at * self.shard << level for at in spot)
        end = row + (self.shard << level) >= self.shape[0], col + (self.shard << level) >= self.shape[1]
        nested = self.above.add(row, col, end, nested, means, level)
        if self.direct < self.levels - 1:
            r, c = row >> self.direct, col >> self.direct
            self.last[r : r + nested.shape[0], c : c + nested.shape[1]] = nested
            area = slice(r, r + means.total.shape[0]), slice(c, c + means.total.shape[1])
            self.last_total[area], self.last_count[area] = means.total, means.count

    def combine(self, spot: Spot, facts: Facts) -> None:
        """Add a shard's results to the tables of the whole raster."""
        with self._lock:
            self._combine(spot[0] * self.shard, spot[1] * self.shard, facts)

    def _combine(self, row: int, col: int, facts: Facts) -> None:
        self.valid_samples += int(facts["samples"])
        if "lost" in facts:
            self.lost.append(facts["lost"])
        at = row // TILE, col // TILE
        low = facts["low"]
        if at[0] >= self.low.shape[0] or at[1] >= self.low.shape[1]:
            return  # the raster's last row or column alone: it is the border of the tiles before it
        area = slice(at[0], at[0] + low.shape[0]), slice(at[1], at[1] + low.shape[1])
        self.low[area] = np.fmin(self.low[area], low)
        self.high[area] = np.fmax(self.high[area], facts["high"])
        self.least[area] = np.minimum(self.least[area], facts["valid"])
        self.most[area] = np.maximum(self.most[area], facts["valid"])
        for level in range(1, self.direct + 1):
            worst, table = facts[f"worst{level}"], self.worst[level]
            r, c = at[0] >> level, at[1] >> level
            area = slice(r, r + worst.shape[0]), slice(c, c + worst.shape[1])
            table[area] = np.maximum(table[area], worst)

    def first(self) -> TileTable:
        """The tile table of level 0, once everything is added."""
        valid = np.where(self.least == 2, 2, np.minimum(self.most, 1)).astype(np.uint8)
        return TileTable(self.low, self.high, np.zeros(self.low.shape, np.float32), valid)

    def finish(self) -> None:
        """Write the levels that no task could make, and all tile tables."""
        first = self.first()
        low, high, valid = first.minimum, first.maximum, first.valid
        self._write_tables(0, first)
        nested, total, count = self.last, self.last_total, self.last_count
        for level in range(1, self.levels):
            low, high, valid = reduce_tiles(low, high, valid)
            if level > self.direct:
                self._sum_of_errors(level, nested, low, high, valid)
                nested = halve(nested)
                self._write_whole(heights_spec, level, nested)
                fine_total, fine_count = total, count
                total = np.empty(mean_shape(self.shape, level))
                count = np.empty(total.shape, np.int64)
                halve_sums(fine_total, fine_count, total, count)
                mean = np.empty(total.shape, np.float32)
                divide(total, count, mean)
                self._write_whole(mean_spec, level, mean)
            error = round_up(self.worst[level], magnitude(low, high))
            self._write_tables(level, TileTable(low, high, error, valid))

    def _sum_of_errors(self, level: int, finer: Heights, low: Heights, high: Heights, valid: NDArray[np.uint8]) -> None:
        """The error of a level from that of the level below; where samples are missing, the height range."""
        between = tile_errors(finer, 1)
        summed = quarter(self.worst[level - 1], np.maximum) + between
        spread = np.nan_to_num(high.astype(np.float64) - low)
        self.worst[level] = np.where(valid == 2, np.minimum(summed, spread), spread)

    def _write_tables(self, level: int, table: TileTable) -> None:
        for name in TABLES_AND_VALID:
            spec = table_spec(self.shape, level, name, self.shard, self.chunk)
            self.writer.array(spec, getattr(table, name))

    def _write_whole(self, kind: Kind, level: int, values: Heights) -> None:
        self.writer.array(self.finest.spec_of(kind, level), values)


def spans(shape: Shape, area: int, level: int, samples: Shape) -> tuple[list[Spot], list[Spot]]:
    """For each axis the extents, in samples of a level, of what tasks over areas of ``area`` samples make.

    Args:
        samples: of the level.
    """
    rows, cols = (
        list(zip(starts, [*starts[1:], last], strict=True))
        for starts, last in (([b * area >> level for b in range(-(-s // area))], n) for s, n in zip(shape, samples))
    )
    return rows, cols
