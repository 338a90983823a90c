"""A two-dimensional Zarr v3 array in shards, read by windows and written shard by shard.

Zarr's ``sharding_indexed`` layout is simple enough to keep in one file, and doing so buys what a general library does
not give: a reader that starts in milliseconds and fetches one chunk with one ``pread``, bytes that depend on nothing
but the samples, and a checksum failure that knows the name of its chunk. A shard is the chunks that hold anything, one
after the other in C order, each ``bytes`` (little endian) → ``blosc``, or one of ``OWN``, → ``crc32c``; then its label
(``digests``); then the index, an (offset, length) pair of uint64 per chunk, all ones for a chunk that is all fill
value, and the index's own crc32c (Zarr v3, sharding-indexed codec v1.0). Every shard of an array is written, even an
empty one, so that a lost file is noticed.

Chunks are named by their key: ``heights/0/height/c/3/4[1,7]`` is the inner chunk (1, 7) of that shard.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import DamagedChunkError
from orograph.parallel import map_ordered, threads_for
from orograph.store import compact, smallest
from orograph.store.cache import ChunkCache
from orograph.store.coding import MISSING, Packing
from orograph.store.digests import ABSENT, Digests, Spot, crc32c, sealed, tail_length, unsealed
from orograph.store.progressive import Scheme, known, rebuilt, residuals
from orograph.store.storage import Storage

if TYPE_CHECKING:
    from orograph.store.watch import Watch

Array = NDArray[Any]
Place = tuple[int, int, int]
"""Of a chunk in its shard: offset, length and crc32c."""

BULK = 16  # windows of more chunks than this are decoded by all processors, and do not push others out of the cache
BATCH = 64  # chunks fetched together from remote storage
INDICES = 4096  # shard indices kept

OWN = {"compact": compact, "smallest": smallest, "progressive": smallest}
"""The project's own codecs, of chunks of int32 (docs/codec.md), by profile."""

CODEC = {"cname": "zstd", "clevel": 1, "blocksize": 1 << 18}
"""One blosc block per 256² chunk of float32. Warped SRTM packs 1.8:1 so (integers 5:1) and decodes at 2 GB/s a core.
lz4 decodes at 4 GB/s but packs 1.6:1 (3:1); smaller blosc blocks lose both ways (docs/store.md has the table)."""


@dataclass(frozen=True, slots=True)
class ArraySpec:
    """What an array is, and its Zarr metadata.

    Attributes:
        path: within the store.
        shape: samples.
        shard: samples along a shard's side, a multiple of ``chunk``.
        chunk: samples along a chunk's side.
        dtype: NumPy's name.
        fill: the value of chunks that are not written.
        dimensions: their names.
        packing: how the samples lie in it as int32; None: as they are.
        scheme, coarser: how, and from which array, they follow (``progressive``); None: they stand for themselves.
    """

    path: str
    shape: Spot
    shard: int
    chunk: int
    dtype: str = "float32"
    fill: float = float("nan")
    dimensions: tuple[str, str] = ("y", "x")
    packing: Packing | None = None
    scheme: Scheme | None = None
    coarser: ArraySpec | None = None

    @property
    def shards(self) -> Spot:
        """How many shards there are each way."""
        return -(-self.shape[0] // self.shard), -(-self.shape[1] // self.shard)

    def key(self, shard: Spot) -> str:
        return f"{self.path}/c/{shard[0]}/{shard[1]}"

    def window(self, shard: Spot) -> tuple[int, int, int, int]:
        """The samples of a shard: row0, row1, col0, col1."""
        row, col = shard[0] * self.shard, shard[1] * self.shard
        return row, min(row + self.shard, self.shape[0]), col, min(col + self.shard, self.shape[1])

    def metadata(self, attributes: dict[str, Any]) -> dict[str, Any]:
        """The array's ``zarr.json``."""
        little = {"name": "bytes", "configuration": {"endian": "little"}}
        dtype, fill = (self.dtype, self.fill) if self.packing is None else ("int32", MISSING)
        size = np.dtype(dtype).itemsize
        shuffle = "shuffle" if size > 1 else "noshuffle"
        blosc = {"name": "blosc", "configuration": {**CODEC, "shuffle": shuffle, "typesize": size}}
        coded: list[dict[str, Any]] = [little if size > 1 else {"name": "bytes"}, blosc]
        if self._own is not None:
            coded = [{"name": self._own.NAME, "configuration": {}}]
        sharding = {
            "chunk_shape": [self.chunk, self.chunk],
            "codecs": [*coded, {"name": "crc32c"}],
            "index_codecs": [little, {"name": "crc32c"}],
            "index_location": "end",
        }
        return {
            "zarr_format": 3,
            "node_type": "array",
            "shape": list(self.shape),
            "data_type": dtype,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [self.shard, self.shard]}},
            "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
            "fill_value": "NaN" if np.isnan(fill) else np.dtype(dtype).type(fill).item(),
            "codecs": [{"name": "sharding_indexed", "configuration": sharding}],
            "dimension_names": list(self.dimensions),
            "attributes": self._attributes(attributes),
        }

    def _attributes(self, attributes: dict[str, Any]) -> dict[str, Any]:
        if self.packing is None:
            return attributes
        if self.scheme is None or self.coarser is None:
            return {**attributes, **self.packing.attributes()}
        return {
            "long_name": "differences of heights from their predictions (orograph: docs/codec.md, progressive)",
            "grid_mapping": "spatial_ref", "_FillValue": MISSING,
            "prediction": {"from": self.coarser.path, "step": self.packing.step, **asdict(self.scheme)},
        }  # fmt: skip

    @property
    def chunks(self) -> int:
        """Chunks of a shard."""
        return (self.shard // self.chunk) ** 2

    def encode(self, spot: Spot, block: Array) -> tuple[list[bytes], bytes]:
        """The bytes of a shard, and its digest.

        Args:
            spot: which shard.
            block: its samples (smaller than a shard at the array's end).
        """
        rows, cols = block.shape
        side = self.shard // self.chunk
        index, sums = np.full((side * side, 2), ABSENT), np.zeros(side * side, np.uint32)
        parts: list[bytes] = []
        offset = 0
        for i in range(-(-rows // self.chunk)):
            for j in range(-(-cols // self.chunk)):
                view = block[i * self.chunk : (i + 1) * self.chunk, j * self.chunk : (j + 1) * self.chunk]
                if self._is_fill(view):
                    continue
                if self.scheme is not None:
                    view = self._stored(view, self._last(spot, (i, j)), self.scheme)
                if view.shape != (self.chunk, self.chunk):
                    fill, dtype = (self.fill, self.dtype) if self.scheme is None else (MISSING, "int32")
                    whole = np.full((self.chunk, self.chunk), fill, dtype)
                    whole[: view.shape[0], : view.shape[1]] = view
                    view = whole
                data = self._compressed(view)
                check = crc32c(data)
                parts += [data, check.to_bytes(4, "little")]
                index[i * side + j] = offset, len(data) + 4
                sums[i * side + j] = check
                offset += len(data) + 4
        end, digest = sealed(self.key(spot), index, sums)
        return [*parts, end], digest

    def _stored(self, view: Array, last: Spot, scheme: Scheme) -> Array:
        """The differences that are stored of a chunk."""
        assert self.packing is not None
        return residuals(self.packing.numbers(view), last, scheme)

    def _size(self, spot: Spot, chunk: Spot) -> tuple[Spot, Spot]:
        """(The first sample of a chunk of a shard, how many it has each way)."""
        row, col = (a * self.shard + b * self.chunk for a, b in zip(spot, chunk, strict=True))
        return (row, col), (min(self.chunk, self.shape[0] - row), min(self.chunk, self.shape[1] - col))

    def _last(self, spot: Spot, chunk: Spot) -> Spot:
        return known(self.shape, *self._size(spot, chunk))

    def heights_of(self, data: bytes, i: int, j: int, coarse: Array) -> Array:
        """The samples of a chunk (i, j) of the array, of those of the array above it.

        Args:
            coarse: from every second of its rows and columns on.

        Raises:
            ValueError: it is damaged.
        """
        assert self.packing is not None and self.scheme is not None
        _, size = self._size((0, 0), (i, j))
        last = self._last((0, 0), (i, j))
        stored = smallest.decompressed(data, (self.chunk, self.chunk))[: size[0], : size[1]]
        above = self.packing.numbers(coarse[: (size[0] + 1) // 2 + last[0], : (size[1] + 1) // 2 + last[1]])
        found = np.full((self.chunk, self.chunk), np.nan, np.float32)
        found[: size[0], : size[1]] = self.packing.heights(rebuilt(stored, above, last, self.scheme))
        return found

    @property
    def _own(self) -> ModuleType | None:
        return None if self.packing is None else OWN.get(self.packing.codec)

    def _compressed(self, chunk: Array) -> bytes:
        if self.scheme is not None:
            return smallest.compressed(chunk, nested=True)
        if self.packing is not None and self._own is not None:
            coded: bytes = self._own.compressed(self.packing.numbers(chunk))
            return coded
        from orograph._blosc import blosc

        shuffle = blosc.SHUFFLE if chunk.itemsize > 1 else blosc.NOSHUFFLE
        values = chunk if self.packing is None else self.packing.numbers(chunk)
        samples = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        data: bytes = blosc.compress(samples, b"zstd", CODEC["clevel"], shuffle, CODEC["blocksize"])
        return data

    def decompressed(self, data: bytes) -> Array:
        """The samples of a chunk.

        Raises:
            RuntimeError, ValueError: it is damaged.
        """
        if self.packing is not None and self._own is not None:
            return self.packing.heights(self._own.decompressed(data, (self.chunk, self.chunk)))
        from orograph._blosc import blosc

        dtype = np.dtype(self.dtype if self.packing is None else "int32").newbyteorder("<")
        chunk = np.empty((self.chunk, self.chunk), dtype)
        blosc.decompress(data, chunk)
        return chunk if self.packing is None else self.packing.heights(chunk)

    def _is_fill(self, view: Array) -> bool:
        if np.isnan(self.fill):
            # Nearly every chunk of real terrain is told by its first sample; only the others are looked through.
            return bool(np.isnan(view[0, 0])) and bool(np.isnan(view).all())
        return bool((view == self.fill).all())


class Window:
    """A part of an array that is in memory.

    Args:
        first: its first sample. samples: it.
    """

    def __init__(self, first: Spot, samples: Array) -> None:
        self.first, self.samples = first, samples

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Samples ``[row0, row1) × [col0, col1)``."""
        row, col = self.first
        return self.samples[row0 - row : row1 - row, col0 - col : col1 - col]


class ShardedArray:
    """An array of a store, opened for reading. Safe from any number of threads.

    Args:
        spec: what it is.
        storage: where it lies.
        digests: what its shards must be.
        cache: for decoded chunks, shared with the store's other arrays.
        jobs: threads for large windows.
        watch: whether the store is still the same; None: nobody replaces it.
    """

    def __init__(
        self,
        spec: ArraySpec,
        storage: Storage,
        digests: Digests,
        cache: ChunkCache,
        jobs: int | None = None,
        watch: Watch | None = None,
    ) -> None:
        self.spec, self.storage, self.digests, self.cache = spec, storage, digests, cache
        self.jobs, self.watch = threads_for(jobs), watch
        self.blank = np.full((spec.chunk, spec.chunk), spec.fill, spec.dtype)
        self.blank.flags.writeable = False
        self.coarser: ShardedArray | Window | None = None
        if spec.coarser is not None:
            self.coarser = ShardedArray(spec.coarser, storage, digests, cache, jobs)
        self._indices: OrderedDict[Spot, list[Place]] = OrderedDict()
        self._lock = threading.Lock()

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Samples ``[row0, row1) × [col0, col1)``, which must lie inside the array. A new array.

        Raises:
            DamagedChunkError: a chunk, or its shard's index, fails its checksum, is cut off, gone or from elsewhere.
            StoreReplacedError: the store is another by now.
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
        return self.window(row0, row1, col0, col1)  # where the version that was opened is kept now

    def prove(self, shard: Spot, whole: bool) -> None:
        """Read a shard, whole or its end alone, which says what all of it must be.

        Raises:
            DamagedChunkError: as ``read``.
        """
        self._index(shard)
        if whole and self.coarser is None:
            self.read(*self.spec.window(shard))
        elif whole:  # what lies above may not be there yet
            row0, row1, col0, col1 = self.spec.window(shard)
            rows, cols = (
                range(a // self.spec.chunk, -(-b // self.spec.chunk)) for a, b in ((row0, row1), (col0, col1))
            )
            spots = [(i, j) for i in rows for j in cols]
            for (i, j), (data, check) in zip(spots, self._fetch(spots), strict=True):
                self._decode(i, j, data, check, None)

    def window(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """As ``read``, without asking whether the store is the same."""
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
            # All levels at once: one after the other their answers would be waited for as many times.
            with ThreadPoolExecutor(1) as pool:
                waiting = pool.submit(self._above, missing)
                early, above = self._fetch(missing), waiting.result()
        else:
            above = self._above(missing)

        def load(spots: Sequence[Spot]) -> None:
            for (i, j), (data, check) in zip(spots, early or self._fetch(spots), strict=True):
                chunk = self._decode(i, j, data, check, above)
                if not bulk:
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
        """What these chunks need of the array above; None: nothing."""
        if self.coarser is None:
            return None
        spans = []
        for axis in (0, 1):
            first, end = min(spot[axis] for spot in spots), max(spot[axis] for spot in spots) + 1
            size, side = self.spec.chunk, self.spec.shape[axis]
            # (the last sample of an even number of them has an odd number, and is the last one above, too)
            spans += [first * size // 2, end * size // 2 if end * size < side else side // 2 + 1]
        return Window((spans[0], spans[2]), self.coarser.window(*spans))

    def _place(self, out: Array, chunk: Array, i: int, j: int, row0: int, col0: int) -> None:
        """Copy what of chunk (i, j) lies in the window at (row0, col0)."""
        size = self.spec.chunk
        top, left = i * size - row0, j * size - col0
        r, c = max(top, 0), max(left, 0)
        out[r : top + size, c : left + size] = chunk[r - top : out.shape[0] - top, c - left : out.shape[1] - left]

    def _fetch(self, spots: Sequence[Spot]) -> list[tuple[bytes | None, int]]:
        """The encoded chunks, None for those that are all fill value, and what their checksums must be."""
        side = self.spec.shard // self.spec.chunk
        places = []
        for i, j in spots:
            index = self._index((i // side, j // side))
            places.append(index[i % side * side + j % side])
        wanted = [
            (self.spec.key((i // side, j // side)), start, start + length)
            for (i, j), (start, length, _) in zip(spots, places, strict=True)
            if length
        ]
        found = iter(self.storage.ranges(wanted))
        return [(next(found) if length else None, check) for _, length, check in places]

    def _index(self, shard: Spot) -> list[Place]:
        """Where the chunks of a shard lie; length 0 for those that are not written."""
        with self._lock:
            index = self._indices.get(shard)
            if index is not None:
                self._indices.move_to_end(shard)
                return index
        key = self.spec.key(shard)
        tail = self.storage.tail(key, tail_length(key, self.spec.chunks))
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
        said = int.from_bytes(data[-4:], "little")
        if len(data) < 4 or crc32c(data[:-4]) != said:
            raise self._damaged(i, j, "it fails its checksum")
        if said != check:
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
