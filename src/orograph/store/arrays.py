"""A two-dimensional Zarr v3 array in shards (``array_spec``), read by windows: one ``pread`` per chunk.

Chunks are named by their key: ``heights/0/height/c/3/4[1,7]`` is the inner chunk (1, 7) of that shard.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import DamagedChunkError
from orograph.parallel import map_ordered, threads_for
from orograph.store.array_spec import ArraySpec
from orograph.store.cache import ChunkCache
from orograph.store.digests import Digests, Spot, crc32c, tail_length, unsealed
from orograph.store.storage import Storage

if TYPE_CHECKING:
    from orograph.store.watch import Watch

Array = NDArray[Any]
Place = tuple[int, int, int]
"""A chunk in its shard: offset, length and crc32c."""

BULK = 16  # windows of more chunks than this are decoded by all processors, and mostly do not enter the cache
BATCH = 64  # chunks fetched together from remote storage
INDICES = 4096  # shard indices kept


class Window:
    """A part of an array in memory.

    Args:
        first: its first sample (row, column). samples: its samples.
    """

    def __init__(self, first: Spot, samples: Array) -> None:
        self.first, self.samples = first, samples

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Return samples ``[row0, row1) × [col0, col1)``."""
        row, col = self.first
        return self.samples[row0 - row : row1 - row, col0 - col : col1 - col]


class ShardedArray:
    """An array of a store, open for reading. Thread-safe.

    Args:
        spec: the array's description.
        storage: where it is stored.
        digests: the expected digests of its shards.
        cache: for decoded chunks, shared with the store's other arrays.
        jobs: threads for large windows.
        kept: windows of more chunks than this do not enter the cache.
        watch: notices when the store is replaced; None: it never is.
    """

    def __init__(
        self,
        spec: ArraySpec,
        storage: Storage,
        digests: Digests,
        cache: ChunkCache,
        jobs: int | None = None,
        watch: Watch | None = None,
        kept: int = BULK,
    ) -> None:
        self.spec, self.storage, self.digests, self.cache = spec, storage, digests, cache
        self.jobs, self.watch, self.kept = threads_for(jobs), watch, kept
        self.blank = np.full((spec.chunk, spec.chunk), spec.fill, spec.dtype)
        self.blank.flags.writeable = False
        self.coarser: ShardedArray | Window | None = None
        if spec.coarser is not None:
            self.coarser = ShardedArray(spec.coarser, storage, digests, cache, jobs, kept=kept)
        self._indices: OrderedDict[Spot, list[Place]] = OrderedDict()
        self._lock = threading.Lock()

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Return samples ``[row0, row1) × [col0, col1)``, which must lie inside the array, as a new array.

        Raises:
            DamagedChunkError: a chunk or its shard's index fails its checksum, is truncated, missing or from elsewhere.
            StoreReplacedError: the store has been replaced.
        """
        if self.watch is None:
            return self.window(row0, row1, col0, col1)
        self.watch()
        try:
            return self.window(row0, row1, col0, col1)
        except DamagedChunkError:
            self.watch.explain(self.spec.path)
            if not self.watch.replaced:
                raise
        return self.window(row0, row1, col0, col1)  # from where the opened version is kept now

    def prove(self, shard: Spot, whole: bool) -> None:
        """Read a shard: all of it, or only its end, which lists what the rest must be.

        Raises:
            DamagedChunkError: as ``read``.
        """
        self._index(shard)
        if whole and self.coarser is None:
            self.read(*self.spec.window(shard))
        elif whole:  # the coarser array may not be written yet
            row0, row1, col0, col1 = self.spec.window(shard)
            rows, cols = (
                range(a // self.spec.chunk, -(-b // self.spec.chunk)) for a, b in ((row0, row1), (col0, col1))
            )
            spots = [(i, j) for i in rows for j in cols]
            for (i, j), (data, check) in zip(spots, self._fetch(spots), strict=True):
                self._decode(i, j, data, check, None)

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Like ``read``, but without checking whether the store has been replaced."""
        out = np.empty((row1 - row0, col1 - col0), self.spec.dtype)
        if out.size == 0:
            return out
        size, path, cache = self.spec.chunk, self.spec.path, self.cache
        missing: list[Spot] = []
        for i in range(row0 // size, (row1 - 1) // size + 1):
            for j in range(col0 // size, (col1 - 1) // size + 1):
                chunk = cache.get((path, i, j))
                if chunk is None:
                    missing.append((i, j))
                else:
                    self._place(out, chunk, i, j, row0, col0)
        if not missing:
            return out
        bulk = len(missing) > BULK
        early: list[tuple[bytes | None, int]] | None = None
        if self.coarser is not None and self.storage.remote and not bulk:
            # Fetch all levels at once: one after the other, each would add its latency.
            with ThreadPoolExecutor(1) as pool:
                waiting = pool.submit(self._above, missing)
                early, above = self._fetch(missing), waiting.result()
        else:
            above = self._above(missing)

        def load(spots: Sequence[Spot]) -> None:
            for (i, j), (data, check) in zip(spots, early or self._fetch(spots), strict=True):
                chunk = self._decode(i, j, data, check, above)
                if len(missing) <= self.kept:
                    cache.put((path, i, j), chunk)
                self._place(out, chunk, i, j, row0, col0)

        if bulk:
            step = BATCH if self.storage.remote else 4
            for _ in map_ordered(load, _batches(missing, step), self.jobs):
                pass
        else:
            load(missing)
        return out

    def _above(self, spots: Sequence[Spot]) -> Window | None:
        """Return the part of the coarser array that these chunks need; None if they need none."""
        if self.coarser is None:
            return None
        spans = []
        for axis in (0, 1):
            first, end = min(spot[axis] for spot in spots), max(spot[axis] for spot in spots) + 1
            size, side = self.spec.chunk, self.spec.shape[axis]
            # (of an even number of samples, the last has an odd index; the last one of the coarser array covers it)
            spans += [first * size // 2, end * size // 2 if end * size < side else side // 2 + 1]
        return Window((spans[0], spans[2]), self.coarser.window(*spans))

    def _place(self, out: Array, chunk: Array, i: int, j: int, row0: int, col0: int) -> None:
        """Copy the part of chunk (i, j) that lies in the window at (row0, col0)."""
        size = self.spec.chunk
        top, left = i * size - row0, j * size - col0
        r, c = max(top, 0), max(left, 0)
        out[r : top + size, c : left + size] = chunk[r - top : out.shape[0] - top, c - left : out.shape[1] - left]

    def _fetch(self, spots: Sequence[Spot]) -> list[tuple[bytes | None, int]]:
        """Return the encoded chunks (None for those of fill values only), and their expected checksums."""
        side = self.spec.shard // self.spec.chunk
        shards = [s for s in {(i // side, j // side) for i, j in spots} if s not in self._indices]
        if self.storage.remote and len(shards) > 1:  # concurrently, because of the latency
            with ThreadPoolExecutor(min(len(shards), BULK)) as pool:
                list(pool.map(self._index, sorted(shards)))
        places = []
        for i, j in spots:
            index = self._index((i // side, j // side))
            places.append(index[i % side * side + j % side])
        wanted = [
            (self.spec.place((i // side, j // side), self.digests), start, start + length)
            for (i, j), (start, length, _) in zip(spots, places, strict=True)
            if length
        ]
        found = iter(self.storage.ranges(wanted))
        return [(next(found) if length else None, check) for _, length, check in places]

    def _index(self, shard: Spot) -> list[Place]:
        """Return the places of the chunks of a shard; length 0 for those that are not written."""
        with self._lock:
            index = self._indices.get(shard)
            if index is not None:
                self._indices.move_to_end(shard)
                return index
        key = self.spec.key(shard)
        tail = self.storage.tail(self.spec.place(shard, self.digests), tail_length(key, self.spec.chunks))
        if tail is None:
            raise DamagedChunkError(key, path=self.storage.url, cause="the file is not there")
        try:
            index = unsealed(tail, key, self.spec.chunks, self.digests.get(self.spec.path, self.spec.shards, shard))
        except ValueError as error:
            raise DamagedChunkError(key, path=self.storage.url, cause=str(error)) from None
        with self._lock:
            self._indices[shard] = index
            if len(self._indices) > INDICES:
                self._indices.popitem(last=False)
        return index

    def _decode(self, i: int, j: int, data: bytes | None, check: int, above: Window | None) -> Array:
        if data is None:
            return self.blank
        expected = int.from_bytes(data[-4:], "little")
        if len(data) < 4 or crc32c(data[:-4]) != expected:
            raise self._damaged(i, j, "it fails its checksum")
        if expected != check:
            raise self._damaged(i, j, "it belongs to another shard")
        try:
            if above is None:
                chunk = self.spec.decompressed(data[:-4])
            else:
                row, col = i * self.spec.chunk // 2, j * self.spec.chunk // 2
                side = self.spec.chunk // 2 + 1
                chunk = self.spec.heights_of(data[:-4], i, j, above.window(row, row + side, col, col + side))
        except (RuntimeError, ValueError) as error:
            raise self._damaged(i, j, "it cannot be decompressed") from error
        chunk.flags.writeable = False
        return chunk

    def _damaged(self, i: int, j: int, cause: str) -> DamagedChunkError:
        side = self.spec.shard // self.spec.chunk
        key = f"{self.spec.key((i // side, j // side))}[{i % side},{j % side}]"
        return DamagedChunkError(key, path=self.storage.url, cause=cause)


def _batches(spots: Sequence[Spot], size: int) -> Iterator[Sequence[Spot]]:
    for start in range(0, len(spots), size):
        yield spots[start : start + size]
