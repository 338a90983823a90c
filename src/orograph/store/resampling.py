"""The stage of a build that keeps source lattices and measures the loss from resampling.

One task per shard of a lattice: it writes the shard (unless the source is not to be kept) and compares its samples with
the finished level 0. A sample counts if no finer lattice has a height for it and the terrain has a surface there (it
has none beyond its outermost samples and beside missing ones). *Deviation* is the drawn surface minus the sample. A
*summit* is a sample that none of its eight neighbours exceeds; its *loss* is how much it exceeds the highest of the
four samples of the terrain around it, at least 0. None of these is lower than the surface, so no loss is larger than
the largest deviation. The place of a sample on the terrain's grid is known to ``EXACT`` of a sample. A task's result is
stored in ``parts/`` until the build is complete. Squares are summed in blocks of the lattice, and those sums exactly,
so that the division into shards makes no difference. Units: metres; samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import DamagedChunkError
from orograph.geo.grid import Grid
from orograph.progress import Progress
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.coding import Coding
from orograph.store.digests import Spot
from orograph.store.executing import Executor, ShardStage
from orograph.store.lattices import LatticeRecord, StoredLattice
from orograph.store.layout import heights_spec
from orograph.store.parts import pack, unpack
from orograph.store.places import PARTS
from orograph.store.pyramid import tasks
from orograph.store.terrain import Heights, Resampled
from orograph.store.writer import ShardWriter

if TYPE_CHECKING:
    from orograph.dem.lattice import SourceLattice

EXACT = 1e-3
STRIP = 256  # rows compared at once
BLOCK = 64  # samples along the sides of blocks whose squares are summed; it divides STRIP and the sides of shards

Facts = dict[str, NDArray[Any]]


def look_back(
    lattices: Sequence[SourceLattice], grid: Grid, writer: ShardWriter, sizes: tuple[int, int], keep: bool,
    executor: Executor, progress: Progress, coding: Coding | None = None,
) -> Resampled:  # fmt: skip
    """Keep the lattices that a terrain was resampled from, and compare it with them.

    Args:
        lattices: the source lattices, finest first.
        grid: the terrain's; its level 0 is complete.
        writer: writes its shards.
        sizes: samples along the sides of shards and chunks.
        keep: whether the samples are written.
        executor: runs the tasks.
        coding: how level 0 is encoded.
    """
    total = _Total()
    for number in range(len(lattices)):
        look = Look(number, lattices, grid, writer, sizes, keep, coding)
        executor.run(look, progress)
        for spot in sorted(look.tasks()):
            total.add(look.facts[spot])
    return total.result()


class _Total:
    """The combined results of all tasks."""

    def __init__(self) -> None:
        self.count = 0
        self.squares: list[float] = []
        self.largest = self.summit_loss = self.highest_loss = 0.0
        self.highest = -math.inf

    def add(self, facts: Facts) -> None:
        count, largest, summit_loss, highest, highest_loss = facts["found"].tolist()
        self.count += int(count)
        self.squares += facts["squares"].tolist()
        self.largest, self.summit_loss = max(self.largest, largest), max(self.summit_loss, summit_loss)
        if highest > self.highest:
            self.highest, self.highest_loss = highest, highest_loss

    def result(self) -> Resampled:
        if not self.count:
            return Resampled(math.nan, math.nan, math.nan, math.nan, math.nan)
        rms = math.sqrt(math.fsum(self.squares) / self.count)
        return Resampled(rms, self.largest, self.summit_loss, self.highest, self.highest_loss)


def look_key(number: int, spot: Spot) -> str:
    """The key of the result of a shard of a lattice."""
    return f"{PARTS}/source/{number}.{spot[0]}.{spot[1]}.part"


class Look(ShardStage[Facts]):
    """The tasks of one lattice; ``facts`` has their results.

    Args:
        number: the number of the lattice. The others are as for ``look_back``.
    """

    name = "source"

    def __init__(
        self, number: int, lattices: Sequence[SourceLattice], grid: Grid, writer: ShardWriter, sizes: tuple[int, int],
        keep: bool, coding: Coding | None = None,
    ) -> None:  # fmt: skip
        from orograph.dem.coordinates import Coordinates
        from orograph.dem.layers import LatticeMap, layer_of

        self.label = "Keeping the source's samples" if keep else "Comparing with the source"
        self.number, self.lattice, self.writer, self.keep = number, lattices[number], writer, keep
        self.record = LatticeRecord.of(self.lattice)
        self.spec = self.record.spec(number, *sizes)
        here = self.lattice.grid
        self.finer = [layer_of(each, here, "nearest") for each in lattices[:number]]
        level = heights_spec(grid.shape, 0, *sizes, coding)
        surface = StoredLattice(grid, ShardedArray(level, writer.storage, writer.digests, ChunkCache(0), 1))
        exact = Coordinates(here, grid, EXACT)
        self.surface = LatticeMap(surface, None, exact, (1, 1), (0, here.rows, 0, here.cols))
        self.facts: dict[Spot, Facts] = {}

    def tasks(self) -> list[Spot]:
        return tasks(self.lattice.grid.shape, self.spec.shard)

    def add(self, spot: Spot, found: Facts) -> None:
        self.facts[spot] = found

    def make(self, spot: Spot) -> Facts:
        from orograph.dem.layers import fill

        row0, row1, col0, col1 = self.spec.window(spot)
        around = self.lattice.read(row0 - 1, row1 + 1, col0 - 1, col1 + 1)
        own = around[1:-1, 1:-1]
        facts: Facts = {}
        if self.keep:
            digest = self.writer.shard(self.spec, spot, self.record.encode(own))
            facts["digest"] = np.frombuffer(digest, np.uint8)
        covered, ground = (np.full(shape, np.nan, np.float32) for shape in (own.shape, (*own.shape, 2)))
        for layer in self.finer:
            fill("nearest", layer, row0, row1, col0, col1, covered)
        if not np.isnan(own).all():
            fill("ground", self.surface, row0, row1, col0, col1, ground)
        facts["found"], facts["squares"] = _compared(around, np.isnan(covered), ground[..., 0], ground[..., 1])
        self.writer.keep(self.key(spot), pack(facts))
        return facts

    def found(self, spot: Spot, proof: bool = True) -> Facts | None:
        data = self.writer.storage.get(self.key(spot))
        if data is None:
            return None
        try:
            facts = unpack(data)
            if self.keep:
                self.writer.take(self.spec, spot, facts["digest"].tobytes())
                array = ShardedArray(self.spec, self.writer.storage, self.writer.digests, ChunkCache(0), 1)
                array.prove(spot, proof)
        except (DamagedChunkError, ValueError):
            return None
        return facts

    def key(self, spot: Spot) -> str:
        return look_key(self.number, spot)


def _compared(
    around: Heights, counts: NDArray[np.bool_], drawn: Heights, highest: Heights
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The result for the samples that count, and the sums of the squares of the deviations in each block.

    The result is: their number, the largest deviation, the largest loss of a summit, the highest sample, its loss.

    Args:
        around: (rows + 2, cols + 2) samples, with their neighbours.
        counts: (rows, cols) which of them no finer lattice covers.
        drawn, highest: (rows, cols) the surface, and the highest of the four samples of the terrain around.
    """
    count, largest, summit_loss, top, top_loss = 0, 0.0, 0.0, -math.inf, 0.0
    squares = [np.empty(0)]
    for r in range(0, len(drawn), STRIP):
        strip = slice(r, min(r + STRIP, len(drawn)))
        part = around[r : strip.stop + 2]
        own = part[1:-1, 1:-1].astype(np.float64)
        off = np.abs(drawn[strip] - own)
        known = counts[strip] & ~np.isnan(off)
        if not known.any():
            continue
        count += int(np.count_nonzero(known))
        off[~known] = 0.0
        largest = max(largest, float(off.max()))
        squares.append(_block_sums(np.multiply(off, off, out=off)))
        summits = known & (own >= _neighbours(part))
        lost = own[summits] - highest[strip][summits]
        summit_loss = max(summit_loss, float(lost.max(initial=0.0)))
        at = np.unravel_index(int(np.argmax(np.where(known, own, -np.inf))), own.shape)
        if own[at] > top:
            top, top_loss = float(own[at]), max(float(own[at] - highest[strip][at]), 0.0)
    return np.array([count, largest, summit_loss, top, top_loss]), np.concatenate(squares)


def _block_sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sums of blocks of ``BLOCK`` samples a side, each summed in the same order whatever lies beside it."""
    rows, cols = values.shape
    padded = np.pad(values, ((0, -rows % BLOCK), (0, -cols % BLOCK)))
    blocks = padded.reshape(len(padded) // BLOCK, BLOCK, -1, BLOCK).swapaxes(1, 2)
    return np.asarray(blocks.reshape(-1, BLOCK * BLOCK).sum(axis=1))


def _neighbours(heights: Heights) -> Heights:
    """(rows − 2, cols − 2): the highest of each sample's eight neighbours, −inf where there is none."""
    filled = np.where(np.isnan(heights), np.float32(-np.inf), heights)
    across = np.maximum(np.maximum(filled[:, :-2], filled[:, 2:]), filled[:, 1:-1])
    beside = np.maximum(filled[1:-1, :-2], filled[1:-1, 2:])
    return np.maximum(np.maximum(across[:-2], across[2:]), beside)
