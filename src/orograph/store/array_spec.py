"""Two-dimensional Zarr v3 arrays in shards: what they are, and how shards are encoded. ``arrays`` reads them.

Zarr's ``sharding_indexed`` layout is simple enough to implement in two files. This gives what a general library does
not: bytes that depend on nothing but the samples, a reader that starts in milliseconds, and checksum errors that name
the chunk. A shard consists of its non-empty chunks, one
after the other in C order, each ``bytes`` (little endian) → ``blosc``, or one of ``OWN``, → ``crc32c``; then its label
(``digests``); then the index, an (offset, length) pair of uint64 per chunk, all ones for a chunk of fill values only,
and the index's own crc32c (Zarr v3, sharding-indexed codec v1.0). Every shard of an array is written, even an
empty one, so that a lost file is noticed.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.store import compact, smallest
from orograph.store.coding import MISSING, Packing
from orograph.store.digests import ABSENT, Digests, Spot, crc32c, sealed
from orograph.store.progressive import Scheme, known, rebuilt, residuals

Array = NDArray[Any]

OWN = {"compact": compact, "smallest": smallest, "progressive": smallest}
"""The project's own codecs for chunks of int32 (docs/codec.md), by profile."""

CODEC = {"cname": "zstd", "clevel": 1, "blocksize": 1 << 18}
"""One blosc block per 256² chunk of float32. Warped SRTM compresses 1.8:1 (integers 5:1) and decodes at 2 GB/s a core.
lz4 decodes at 4 GB/s but compresses 1.6:1 (3:1); smaller blosc blocks do worse in both (table in docs/store.md)."""


@dataclass(frozen=True, slots=True)
class ArraySpec:
    """The shape, encoding and Zarr metadata of an array.

    Attributes:
        path: within the store.
        shape: in samples.
        shard: samples along a shard's side, a multiple of ``chunk``.
        chunk: samples along a chunk's side.
        dtype: NumPy's name.
        fill: the value of chunks that are not written.
        dimensions: their names.
        packing: how samples are encoded as int32; None: they are stored unchanged.
        scheme, coarser: how samples are predicted, and from which array (``progressive``); None: no prediction.
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
        """The number of shards along each axis."""
        return -(-self.shape[0] // self.shard), -(-self.shape[1] // self.shard)

    def key(self, shard: Spot) -> str:
        """Return the name of a shard, which its label contains too."""
        return f"{self.path}/c/{shard[0]}/{shard[1]}"

    def place(self, shard: Spot, digests: Digests) -> str:
        """Return the key under which a shard is stored."""
        return digests.place(self.key(shard), digests.get(self.path, self.shards, shard))

    def window(self, shard: Spot) -> tuple[int, int, int, int]:
        """Return the bounds of a shard in samples: row0, row1, col0, col1."""
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
        """The number of chunks in a shard."""
        return (self.shard // self.chunk) ** 2

    def encode(self, spot: Spot, block: Array) -> tuple[list[bytes], bytes]:
        """Return the bytes of a shard, and its digest.

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
        """Return the differences that are stored for a chunk."""
        assert self.packing is not None
        return residuals(self.packing.numbers(view), last, scheme)

    def _size(self, spot: Spot, chunk: Spot) -> tuple[Spot, Spot]:
        """Return the first sample of a chunk of a shard, and its size along each axis."""
        row, col = (a * self.shard + b * self.chunk for a, b in zip(spot, chunk, strict=True))
        return (row, col), (min(self.chunk, self.shape[0] - row), min(self.chunk, self.shape[1] - col))

    def _last(self, spot: Spot, chunk: Spot) -> Spot:
        return known(self.shape, *self._size(spot, chunk))

    def heights_of(self, data: bytes, i: int, j: int, coarse: Array) -> Array:
        """Return the samples of chunk (i, j) of the array, from the coarser array's samples.

        Args:
            coarse: the coarser samples, from half the chunk's first row and column on.

        Raises:
            ValueError: the chunk is damaged.
        """
        assert self.packing is not None and self.scheme is not None
        _, size = self._size((0, 0), (i, j))
        last = self._last((0, 0), (i, j))
        stored = smallest.decompressed(data, (self.chunk, self.chunk))[: size[0], : size[1]]
        above = self.packing.numbers(coarse[: (size[0] + 1) // 2 + last[0], : (size[1] + 1) // 2 + last[1]])
        heights = self.packing.heights(rebuilt(stored, above, last, self.scheme))
        if heights.shape == (self.chunk, self.chunk):
            return heights
        found = np.full((self.chunk, self.chunk), np.nan, np.float32)
        found[: size[0], : size[1]] = heights
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
        """Return the samples of a chunk.

        Raises:
            RuntimeError, ValueError: the chunk is damaged.
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
            # The first sample decides for nearly every chunk of real terrain; only the others are scanned.
            return bool(np.isnan(view[0, 0])) and bool(np.isnan(view).all())
        return bool((view == self.fill).all())
