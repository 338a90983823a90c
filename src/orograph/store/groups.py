"""Heights in larger tasks: one task makes a whole subtree of the pyramid and passes little on.

A group is a square of 2^s × 2^s shards of level 0, with all coarser shards that depend on nothing else: those of the
levels up to s. (A group at the raster's end also includes the part beyond the last whole shard.) The levels above need
only its samples of level s, which are in its shards, the sums of its means, and its tile tables. These are stored as
one object, some 12 bytes for 4^(s+1) samples. Sums are added in the same order as in one process, so the bytes do not
depend on groups. An interrupted group resumes shard by shard.
"""

from __future__ import annotations

import json
import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import DamagedChunkError
from orograph.parallel import for_each
from orograph.store.array_spec import ArraySpec
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.digests import SIZE, Spot
from orograph.store.executing import ShardStage
from orograph.store.layout import heights_spec, mean_spec
from orograph.store.levels import F64, BoxMeans, Counts
from orograph.store.parts import pack, unpack
from orograph.store.places import PARTS
from orograph.store.pyramid import Above, Facts, Finest, Pyramid, tasks
from orograph.store.terrain import Heights, Shape, level_count, mean_shape
from orograph.store.writer import ShardWriter

MOST = 4
"""Maximum levels of a group: 256 shards."""


def group_levels(shape: Shape, shard: int, wanted: int) -> int:
    """The largest number of levels s that gives at least ``wanted`` groups; 0 if there are not enough shards."""
    most = min(MOST, shard.bit_length() - 1, level_count(shape) - 1)
    return next((s for s in range(most, 0, -1) if len(tasks(shape, shard << s)) >= wanted), 0)


class Handed(NamedTuple):
    """The result of a group.

    Attributes:
        nested: its samples of level s. total, number: sums for the means that come next (of level s + 1; of s itself
            where no task makes more levels). facts: those of each of its shards of level 0.
    """

    nested: Heights
    total: F64
    number: Counts
    facts: dict[Spot, Facts]


class Groups(ShardStage[Handed]):
    """The heights of a store, group by group.

    Args:
        finest: makes the shards of level 0.
        levels: s, at least 1.
        pyramid: receives the groups; None if they are only made.
        jobs: threads within a group.
    """

    name = "heights"

    def __init__(self, finest: Finest, levels: int, pyramid: Pyramid | None = None, jobs: int = 1) -> None:
        self.finest, self.levels, self.pyramid, self.jobs = finest, levels, pyramid, jobs
        self.writer = finest.writer
        self.label = "" if pyramid is None else pyramid.label
        self.shape, self.shard = self.finest.shape, self.finest.shard
        self.summed = min(levels + 1, self.finest.direct)

    def tasks(self) -> list[Spot]:
        return tasks(self.shape, self.shard << self.levels)

    def make(self, spot: Spot) -> Handed:
        noting = _Noting(self.writer)
        finest = Finest(self.finest.source, noting, self.shard, self.finest.chunk, self.finest.coding)
        above = Above(finest, range(1, self.levels + 1))
        row, col, shape = self._area(spot, self.summed)
        total, count = np.zeros(shape), np.zeros(shape, np.int32)
        facts: dict[Spot, Facts] = {}
        spans = self._spans(spot)
        whole: Heights | None = None
        if self.finest.spec_of(heights_spec, self.levels).coarser is not None:  # it cannot be read back yet
            whole = np.full((spans[1] - spans[0], spans[3] - spans[2]), np.nan, np.float32)

        def one(shard: Spot) -> None:
            own, facts[shard] = finest.found(shard) or finest.make(shard)
            top, left = shard[0] * self.shard, shard[1] * self.shard
            means = BoxMeans(own)
            end = top + self.shard >= self.shape[0], left + self.shard >= self.shape[1]
            nested = above.add(top, left, end, own, means, 0)
            if whole is not None:
                r, c = (top >> self.levels) - spans[0], (left >> self.levels) - spans[2]
                whole[r : r + nested.shape[0], c : c + nested.shape[1]] = nested
            if self.summed > self.levels:
                means.ahead()
            r, c = (top >> self.summed) - row, (left >> self.summed) - col
            area = slice(r, r + means.total.shape[0]), slice(c, c + means.total.shape[1])
            total[area], count[area] = means.total, means.count

        for_each(one, self._shards(spot), self.jobs)
        kept: Facts = {"total": total, "count": count, **noting.packed()}
        kept.update({f"facts.{i}.{j}": np.frombuffer(pack(each), np.uint8) for (i, j), each in sorted(facts.items())})
        if whole is not None:
            kept["nested"] = whole
        self.writer.keep(self.key(spot), pack(kept))
        return Handed(self._nested(spot, kept), total, count, facts)

    def found(self, spot: Spot, proof: bool = True) -> Handed | None:
        data = self.writer.storage.get(self.key(spot))
        if data is None:
            return None
        try:
            kept = unpack(data)
            for spec, shard, digest in _noted(kept, self._specs()):
                self.writer.take(spec, shard, digest)
                self._array(spec).prove(shard, proof)
            facts = {}
            for name in kept:
                if name.startswith("facts."):
                    _, i, j = name.split(".")
                    facts[int(i), int(j)] = unpack(kept[name].tobytes())
            return Handed(self._nested(spot, kept), kept["total"], kept["count"], facts)
        except (DamagedChunkError, ValueError, KeyError):
            return None

    def add(self, spot: Spot, found: Handed) -> None:
        assert self.pyramid is not None
        self.pyramid.rise(spot, found.nested, BoxMeans.of_sums(found.total, found.number), self.levels)
        for shard, facts in found.facts.items():
            self.pyramid.combine(shard, facts)

    def finish(self) -> None:
        assert self.pyramid is not None
        self.pyramid.finish()

    def key(self, spot: Spot) -> str:
        return f"{PARTS}/groups/{self.levels}.{spot[0]}.{spot[1]}.part"

    def _shards(self, spot: Spot) -> list[Spot]:
        """Its shards of level 0, in Morton order."""
        side = 1 << self.levels
        inner = tasks((side * self.shard, side * self.shard), self.shard)
        rows, cols = (-(-size // self.shard) for size in self.shape)
        shards = [(spot[0] * side + i, spot[1] * side + j) for i, j in inner]
        return [(i, j) for i, j in shards if i < rows and j < cols]

    def _area(self, spot: Spot, level: int) -> tuple[int, int, Shape]:
        """The start of its blocks of a level, and how many there are along each axis."""
        size = self.shard << self.levels >> level
        rows, cols = mean_shape(self.shape, level)
        row, col = spot[0] * size, spot[1] * size
        return row, col, (min(size, rows - row), min(size, cols - col))

    def _spans(self, spot: Spot) -> tuple[int, int, int, int]:
        """Its samples of level s, including the raster's last ones if it reaches the end: row0, row1, col0, col1."""
        spans, whole = [], self.finest.spec_of(heights_spec, self.levels).shape
        for at, side, samples in zip(spot, self.shape, whole, strict=True):
            last = (at + 1) * self.shard << self.levels >= side
            spans += [at * self.shard, samples if last else (at + 1) * self.shard]
        return spans[0], spans[1], spans[2], spans[3]

    def _nested(self, spot: Spot, kept: Facts) -> Heights:
        """Those samples, read from its shards."""
        if "nested" in kept:
            return kept["nested"]
        nested: Heights = self._array(self.finest.spec_of(heights_spec, self.levels)).read(*self._spans(spot))
        return nested

    def _array(self, spec: ArraySpec) -> ShardedArray:
        return ShardedArray(spec, self.writer.storage, self.writer.digests, ChunkCache(0), 1)

    def _specs(self) -> dict[str, ArraySpec]:
        """Its arrays by their paths."""
        specs = [self.finest.spec_of(heights_spec, k) for k in range(self.levels + 1)]
        specs += [self.finest.spec_of(mean_spec, k) for k in range(1, self.levels + 1)]
        return {spec.path: spec for spec in specs}


class _Noting(ShardWriter):
    """A writer that records which shards it wrote."""

    def __init__(self, writer: ShardWriter) -> None:
        self.storage, self.digests = writer.storage, writer.digests
        self._noted: dict[tuple[str, Spot], bytes] = {}
        self._lock = threading.Lock()

    def take(self, spec: ArraySpec, spot: Spot, digest: bytes) -> None:
        super().take(spec, spot, digest)
        with self._lock:
            self._noted[spec.path, spot] = digest

    def packed(self) -> dict[str, NDArray[np.uint8]]:
        """The records, as arrays."""
        noted = sorted(self._noted.items())
        names = json.dumps([[path, *spot] for (path, spot), _ in noted]).encode()
        digests = b"".join(digest for _, digest in noted)
        return {"shards": np.frombuffer(names, np.uint8), "digests": np.frombuffer(digests, np.uint8)}


def _noted(kept: Facts, specs: dict[str, ArraySpec]) -> list[tuple[ArraySpec, Spot, bytes]]:
    """The recorded shards, with their digests."""
    names = json.loads(kept["shards"].tobytes())
    digests = kept["digests"].tobytes()
    return [(specs[path], (i, j), digests[SIZE * at : SIZE * (at + 1)]) for at, (path, i, j) in enumerate(names)]
