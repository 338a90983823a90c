"""The second stage of a build: errors and spheres of all diamonds, once the heights of every level are complete.

One task per shard (or a few small ones): it reads the shard's heights and some around it back from the store, surveys
its blocks (``error.diamonds``), writes its codes of octave 0, and passes those of octaves 1 to 4 on to the coarse
shards that hold them, as the first stage does with heights. What larger diamonds need from it is stored in ``parts/``
with its codes until the build is complete, so that a resumed build does not repeat it. The larger octaves come at the
end.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error import ErrorKind
from orograph.error.diamonds import ALIGNED, BLOCK, REACH, SMALL, Part, Rest, Survey
from orograph.error.encode import Encoder
from orograph.error.quantise import EMPTY, ErrorCode, RadiusCode
from orograph.errors import DamagedChunkError
from orograph.geo.grid import Grid
from orograph.store.array_spec import ArraySpec
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.coding import Coding
from orograph.store.diamond_table import diamond_spec
from orograph.store.diamonds import NESTED, blank_top, metric, place, surface
from orograph.store.digests import Spot
from orograph.store.executing import ShardStage
from orograph.store.layout import heights_spec
from orograph.store.levels import subsample
from orograph.store.parts import pack, unpack
from orograph.store.places import PARTS
from orograph.store.pyramid import spans, tasks
from orograph.store.terrain import Heights, Shape, TileTable, diamond_shape, exponent, level_count, level_shape
from orograph.store.writer import Canvas, ShardWriter

Codes = dict[tuple[int, str], NDArray[np.uint8]]
"""Codes by octave and name (a kind of errors, or "radius")."""


CACHE = 64 << 20
"""Bytes of decoded chunks that tasks share: areas overlap, and in *progressive* stores a chunk needs coarser ones."""

Surveyed = tuple[Codes, list[Rest]]


def errors_key(spot: Spot) -> str:
    """The key of the result of an area."""
    return f"{PARTS}/errors/{spot[0]}.{spot[1]}.part"


def area_of(shard: int) -> int:
    """Samples along the side of a task's area."""
    return max(shard, 32)


class Errors(ShardStage[Surveyed]):
    """The diamonds' arrays of a store under construction.

    Args:
        grid: of the heights.
        writer: of its shards; all heights are written.
        shard, chunk: samples along their sides; powers of two.
        first: the tile table of level 0.
        kinds: the kinds of errors.
        coding: how the heights are encoded.
    """

    name, label = "errors", "Finding errors"

    def __init__(
        self,
        grid: Grid,
        writer: ShardWriter,
        shard: int,
        chunk: int,
        first: TileTable,
        kinds: tuple[ErrorKind, ...],
        coding: Coding | None = None,
    ) -> None:
        self.coding = coding
        self.shape, self.writer, self.sizes, self.cache = grid.shape, writer, (shard, chunk), ChunkCache(CACHE)
        self.top, n = level_count(grid.shape) - 1, exponent(grid.shape)
        self.area = area_of(shard)
        low, high = _range(first)
        self.codes = {kind: ErrorCode.of(high - low, kind, n) for kind in kinds}
        self.radius = RadiusCode.of(high - low, metric(grid), n)
        self.encoder = Encoder(self.codes, self.radius)
        self.names = [*kinds, "radius"]
        self.coded = np.frombuffer(repr((self.codes, self.radius, low)).encode(), np.uint8)
        self.survey = Survey(
            self._nested(),
            surface(grid, first.minimum, low),
            kinds,
            rounding=self.encoder,
            block=min(BLOCK, self.area),
        )
        self.tops = {name: blank_top(grid.shape, np.uint8, EMPTY if name == "radius" else 0) for name in self.names}
        self.canvases = {
            (level, name): Canvas(
                self.spec(level, name),
                writer,
                spans(grid.shape, self.area, level, diamond_shape(grid.shape, level)),
            )
            for level in range(1, min(SMALL, self.top))
            for name in self.names
        }

    def tasks(self) -> list[Spot]:
        """The areas (row, col) in Morton order."""
        return tasks(self.shape, self.area)

    def add(self, spot: Spot, found: Surveyed) -> None:
        codes, rests = found
        row, col = spot[0] * self.area, spot[1] * self.area
        for (octave, name), values in codes.items():
            if octave == 0 and self.top:
                continue  # already written
            if octave < self.top:
                self.canvases[octave, name].add(row >> octave, col >> octave, values)
            else:
                place(self.tops[name], values, octave, row >> octave, col >> octave, self.top)
        for rest in rests:
            self.survey.add(rest)

    def key(self, spot: Spot) -> str:
        return errors_key(spot)

    def make(self, spot: Spot) -> Surveyed:
        """Survey an area, write its shards of octave 0, and store the rest."""
        rows, cols = self.shape
        row, col = spot[0] * self.area, spot[1] * self.area
        row0, col0 = (max((at - REACH) // ALIGNED * ALIGNED, 0) for at in (row, col))
        row1, col1 = min(row + self.area + REACH + 1, rows), min(col + self.area + REACH + 1, cols)
        heights = self._heights(0, row0, row1, col0, col1)

        def read(a: int, b: int, c: int, d: int) -> Heights:
            return heights[a - row0 : b - row0, c - col0 : d - col0]

        codes: Codes = {}
        rests = []
        step = self.survey.size
        for i in range(row // step, -(-min(row + self.area, rows) // step)):
            for j in range(col // step, -(-min(col + self.area, cols) // step)):
                parts, rest = self.survey.block((i, j), read)
                for part in parts:
                    self._encode(part, row, col, codes)
                if rest is not None:
                    rests.append(rest)
        kept: dict[str, NDArray[Any]] = {"coded.0.": self.coded} | {
            f"codes.{octave}.{name}": values for (octave, name), values in codes.items() if octave or not self.top
        }
        if self.top:
            for name in self.names:
                spec = self.spec(0, name)
                for number, shard in enumerate(self._shards(spot, spec)):
                    row0, row1, col0, col1 = spec.window(shard)
                    own = codes[0, name][row0 - row : row1 - row, col0 - col : col1 - col]
                    digest = self.writer.shard(spec, shard, own)
                    kept[f"digest.{number}.{name}"] = np.frombuffer(digest, np.uint8)
        for index, rest in enumerate(rests):
            kept.update({f"rest.{index}.{name}": array for name, array in rest.to_arrays().items()})
        self.writer.keep(self.key(spot), pack(kept))
        return codes, rests

    def _encode(self, part: Part, row: int, col: int, codes: Codes) -> None:
        """Put the codes of a block's part into those of its area, which begins at sample (row, col)."""
        k = part.octave
        first, area = self.window((row // self.area, col // self.area), self.area, k)
        for name, array in self._coded(part).items():
            if (k, name) not in codes:
                codes[k, name] = np.zeros(area, np.uint8)
            i, j = part.i - first[0], part.j - first[1]
            codes[k, name][i : i + array.shape[0], j : j + array.shape[1]] = array

    def window(self, spot: Spot, side: int, octave: int) -> tuple[Shape, Shape]:
        """The first entry of an octave in the square ``spot`` of ``side`` samples, and the number of entries.

        Squares at the raster's end have all entries up to there.
        """
        first, sizes = [], []
        for at, samples, whole in zip(spot, self.shape, level_shape(self.shape, octave), strict=True):
            first.append(at * side >> octave)
            sizes.append((whole if (at + 1) * side >= samples else (at + 1) * side >> octave) - first[-1])
        return (first[0], first[1]), (sizes[0], sizes[1])

    def _coded(self, part: Part) -> dict[str, NDArray[np.uint8]]:
        """A part's codes by name."""
        coded: dict[str, NDArray[np.uint8]] = {k: self.encoder.errors(k, e) for k, e in part.errors.items()}
        if part.radii is not None:
            coded["radius"] = self.encoder.radii(part.radii, part.i, part.j, part.octave)
        return coded

    def found(self, spot: Spot, proof: bool = True) -> Surveyed | None:
        data = self.writer.storage.get(self.key(spot))
        if data is None:
            return None
        codes: Codes = {}
        kept: dict[int, dict[str, NDArray[Any]]] = {}
        digests: dict[str, list[bytes]] = {name: [] for name in self.names}
        try:
            for key, array in unpack(data).items():
                what, number, name = key.split(".", 2)
                if what == "coded":
                    if array.tobytes() != self.coded.tobytes():
                        return None  # the heights had a different range
                elif what == "codes":
                    codes[int(number), name] = array
                elif what == "digest":
                    digests[name].append(array.tobytes())
                else:
                    kept.setdefault(int(number), {})[name] = array
            rests = [Rest.from_arrays(arrays) for _, arrays in sorted(kept.items())]
            if self.top:
                self._prove(spot, digests, proof)
        except (DamagedChunkError, ValueError):
            return None
        return codes, rests

    def _prove(self, spot: Spot, digests: dict[str, list[bytes]], whole: bool) -> None:
        """Read an area's shards of octave 0, or their ends, which checks them."""
        for name in self.names:
            spec = self.spec(0, name)
            array = ShardedArray(spec, self.writer.storage, self.writer.digests, ChunkCache(0), 1)
            for shard, digest in zip(self._shards(spot, spec), digests[name], strict=True):
                self.writer.take(spec, shard, digest)
                array.prove(shard, whole)

    def _shards(self, spot: Spot, spec: ArraySpec) -> list[Spot]:
        """The shards of octave 0 in an area."""
        rows, cols = (
            range(at * self.area // spec.shard, min((at + 1) * self.area // spec.shard, count))
            for at, count in zip(spot, spec.shards, strict=True)
        )
        return [(i, j) for i in rows for j in cols]

    def finish(self) -> None:
        """Write what no task could make."""
        for part in self.survey.finish():
            for name, values in self._coded(part).items():
                if part.octave < self.top:
                    self.writer.array(self.spec(part.octave, name), values)
                else:
                    place(self.tops[name], values, part.octave, 0, 0, self.top)
        for name, values in self.tops.items():
            self.writer.array(self.spec(self.top, name), values)

    def spec(self, level: int, name: str) -> ArraySpec:
        """The array of an octave's codes."""
        return diamond_spec(self.shape, level, name, *self.sizes)

    def _heights(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        spec = heights_spec(self.shape, level, *self.sizes, self.coding)
        most = CACHE // (4 * spec.chunk * spec.chunk)
        array = ShardedArray(spec, self.writer.storage, self.writer.digests, self.cache, 1, kept=most)
        heights: Heights = array.read(row0, row1, col0, col1)
        return heights

    def _nested(self) -> Heights:
        """Every 16th sample."""
        level = min(NESTED, self.top)
        rows, cols = level_shape(self.shape, level)
        return subsample(self._heights(level, 0, rows, 0, cols), NESTED - level)


def _range(first: TileTable) -> tuple[float, float]:
    """Lowest and highest height, NaN if nothing is valid."""
    if not first.valid.any():
        return float("nan"), float("nan")
    return float(np.nanmin(first.minimum)), float(np.nanmax(first.maximum))


def memory(shape: Shape, shard: int, jobs: int, kinds: int) -> int:
    """Approximate memory of this stage: its tasks, open coarse shards, and the octaves made at the end."""
    area = area_of(shard)
    window = min(area, shape[0]) * min(area, shape[1])
    block = min(BLOCK + 2 * ALIGNED, shape[0]) * min(BLOCK + 2 * ALIGNED, shape[1])
    task = window * (5 + 2 * (kinds + 1)) + block * (24 + 14 * kinds)
    shards = sum(min(4 * shard * shard, shape[0] * shape[1] >> 2 * level) for level in range(1, SMALL))
    kept = min(CACHE, 6 * shape[0] * shape[1])
    return jobs * task + kept + shards * (kinds + 1) + (shape[0] * shape[1] >> 2 * NESTED) * (16 + 8 * kinds)
