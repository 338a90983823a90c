"""The chunks of a store, read one by one."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.store.chunk_code import mesh_of
from orograph.store.chunked import Chunk, Layout, Words, lengths_spec, words_spec

if TYPE_CHECKING:
    from orograph.store.stored import StoredTerrain


class StoredChunks:
    """The chunks of a store. Thread-safe.

    Attributes:
        layout: of the chunks. error: metres, of level 0. compressed: whether words are encoded by ``chunk_code``.
    """

    def __init__(self, terrain: StoredTerrain, what: dict[str, Any]) -> None:
        self.compressed = bool(what["compressed"])
        self.terrain, self.layout, self.error = terrain, Layout(terrain.grid.shape, what["cells"]), float(what["error"])
        self._rows = what["rows"]
        self._sizes = terrain.record.shard, terrain.record.chunk
        self._starts: dict[int, NDArray[np.int64]] = {}
        self._lock = threading.Lock()

    def chunk(self, level: int, i: int, j: int) -> Chunk:
        """Return the mesh of chunk (i, j) of a level.

        Raises:
            DamagedChunkError: as ``terrain.read``.
        """
        return mesh_of(self.words(level, i, j), self.layout, self.compressed, level, i, j)

    def words(self, level: int, i: int, j: int) -> Words:
        """Return the stored words of a chunk.

        Raises:
            DamagedChunkError: as ``terrain.read``.
        """
        _, cols = self.layout.chunks(level)
        starts = self._of(level)
        begin, end = int(starts[i * cols + j]), int(starts[i * cols + j + 1])
        wide = self._sizes[1]
        first = begin // wide
        array = self.terrain.opened(
            "chunked/words", level, lambda: words_spec(level, self._rows[level], *self._sizes)
        )  # fmt: skip
        read: Words = array.read(first, -(-end // wide), 0, wide).reshape(-1)
        return read[begin - first * wide : end - first * wide]

    def _of(self, level: int) -> NDArray[np.int64]:
        """Return the offset of each chunk of a level, and the end of the last."""
        with self._lock:
            if level not in self._starts:
                rows, cols = self.layout.chunks(level)
                spec = lengths_spec(self.layout, level, *self._sizes)
                lengths = self.terrain.opened("chunked/lengths", level, lambda: spec).read(0, rows, 0, cols)
                self._starts[level] = np.append(0, np.cumsum(lengths.reshape(-1), dtype=np.int64))
            return self._starts[level]
