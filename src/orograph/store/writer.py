"""Writing the shards of a store: they are encoded and stored, and their digests kept for the root."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError
from orograph.store.array_spec import ArraySpec
from orograph.store.digests import Digests, Spot
from orograph.store.storage import Storage


class ShardWriter:
    """Writes shards, from any number of threads.

    Args:
        storage: where they are stored.
        keyed: whether their keys end with their digests (``Digests.place``).

    Attributes:
        digests: of all shards that were written, or reused from an interrupted build (``take``).
    """

    def __init__(self, storage: Storage, keyed: bool = False) -> None:
        self.storage, self.digests = storage, Digests(keyed=keyed)

    def shard(self, spec: ArraySpec, spot: Spot, block: NDArray[Any]) -> bytes:
        """Write a shard of these samples; return its digest."""
        parts, digest = spec.encode(spot, block)
        self.storage.put(self.digests.place(spec.key(spot), digest), parts)
        self.take(spec, spot, digest)
        return digest

    def take(self, spec: ArraySpec, spot: Spot, digest: bytes) -> None:
        """Record the digest of an existing shard."""
        self.digests.put(spec.path, spec.shards, spot, digest)

    def array(self, spec: ArraySpec, values: NDArray[Any]) -> None:
        """Write a whole array."""
        if values.shape != spec.shape:
            raise OrographError(f"{spec.path} should be {spec.shape}, not {values.shape}.")
        size = spec.shard
        for i in range(spec.shards[0]):
            for j in range(spec.shards[1]):
                self.shard(spec, (i, j), values[i * size : (i + 1) * size, j * size : (j + 1) * size])

    def keep(self, key: str, data: bytes) -> None:
        """Keep a task's result until the store is complete."""
        self.storage.put(key, [data])


class Canvas:
    """A coarse array that is assembled from parts; each shard is written when it is complete.

    Args:
        spec: the array.
        writer: writes its shards.
        spans: for each axis the half-open extents, in its samples, of the parts that will come.
    """

    def __init__(self, spec: ArraySpec, writer: ShardWriter, spans: tuple[list[Spot], list[Spot]]) -> None:
        self.spec, self.writer = spec, writer
        self._lock = threading.Lock()
        self._open: dict[Spot, NDArray[Any]] = {}
        self._spans = spans
        self._awaited: dict[Spot, int] = {}

    def add(self, row: int, col: int, part: NDArray[Any]) -> None:
        """Add a part, and write the shards it completes."""
        size, shape = self.spec.shard, self.spec.shape
        for i in range(row // size, (row + part.shape[0] - 1) // size + 1):
            for j in range(col // size, (col + part.shape[1] - 1) // size + 1):
                with self._lock:
                    block = self._open.get((i, j))
                    if block is None:
                        side = min(size, shape[0] - i * size), min(size, shape[1] - j * size)
                        block = self._open[i, j] = np.full(side, self.spec.fill, self.spec.dtype)
                        self._awaited[i, j] = self._parts_of((i, j))
                top, left = row - i * size, col - j * size
                r, c = max(top, 0), max(left, 0)
                piece = part[r - top : block.shape[0] - top, c - left : block.shape[1] - left]
                block[r : r + piece.shape[0], c : c + piece.shape[1]] = piece
                with self._lock:
                    self._awaited[i, j] -= 1
                    done = self._awaited[i, j] == 0
                    if done:
                        del self._open[i, j], self._awaited[i, j]
                if done:
                    self.writer.shard(self.spec, (i, j), block)

    def _parts_of(self, spot: Spot) -> int:
        """The number of parts of a shard."""
        size = self.spec.shard
        rows, cols = (
            sum(a < (at + 1) * size and b > at * size for a, b in axis)
            for axis, at in zip(self._spans, spot, strict=True)
        )
        return rows * cols
