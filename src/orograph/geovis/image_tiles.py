"""The finer levels of an image as tiles that are read when a picture looks them up, within a fixed memory.

An image of 100,000 pixels a side takes 40 GB; a picture of a million pixels shows about as many of its texels, fine
ones near by and coarse ones far away. So footprints are visited twice: once for the tiles that they need
(``tile_kernels.collect``), which are read, and once for their means. What was used longest ago makes room. The texels
are those of ``Texels``, whatever the memory and the order, so pictures are too. Units: pixels.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from orograph.geovis import mipmap, tile_kernels
from orograph.geovis.texels import Texels
from orograph.geovis.tile_kernels import EDGE, SIDE
from orograph.slots import HELD, Slots

Floats = NDArray[np.float64]
Places = NDArray[np.int64]
Colors = NDArray[np.float32]

LEAST = 2 * mipmap.TAPS
"""The most tiles that one footprint may take."""

MOST = 1 << 12
"""The most tiles looked up at a time."""

FULL = 1 << 16
"""The most tiles that are counted."""

BYTES = 4 * EDGE * EDGE
"""Of a tile."""


class ImageTiles:
    """Tiles of an image's levels below ``Texels.base``; safe from any thread.

    Args:
        texels: the image.
        memory: bytes for tiles; room for ``LEAST`` is taken in any case.

    Attributes:
        read: how many tiles were read.
    """

    def __init__(self, texels: Texels, memory: int) -> None:
        self.texels = texels
        self.capacity = max(LEAST, memory // BYTES)
        self.read = 0
        threads = max(1, min(os.cpu_count() or 1, self.capacity // (4 * LEAST)))
        self._share = min(self.capacity // threads, MOST)
        self._turn = threading.BoundedSemaphore(threads)
        rows, cols = texels.shape(0)
        self._levels = mipmap.layout(rows, cols)
        self._pool = np.empty((self.capacity * EDGE * EDGE, 4), np.uint8)
        self._slots: Slots[int] = Slots(self.capacity)
        self._uses = 0
        self._reading: set[int] = set()  # slots
        self._users = np.zeros(self.capacity, np.int64)
        self._ready = np.zeros(self.capacity, bool)
        self._changed = threading.Condition()

    def look_along(self, u: Floats, v: Floats, axes: Floats, floor: Floats, inside: Floats, out: Colors) -> None:
        """As ``mipmap.look_along``, positions and axes in pixels from the window's corner.

        Raises:
            ReadError: a tile cannot be read.
        """
        texels, decode = self.texels, mipmap.curves()[0]
        keys = np.empty(1 << (2 * self._share - 1).bit_length(), np.int64)
        slots, found = np.empty(len(keys), np.int64), np.empty(self._share, np.int64)
        first = 0
        with self._turn:
            while first < len(u):
                keys[:] = tile_kernels.EMPTY
                count, last, coarse = tile_kernels.collect(
                    self._levels, texels.base, u, v, axes, floor, inside, first, keys, found
                )
                if coarse:
                    texels.hold()
                with self._held(found[:count]) as given:
                    tile_kernels.assign(keys, found[:count], given, slots)
                    tile_kernels.look(
                        self._pool, keys, slots, texels.pool, texels.table, self._levels, texels.base, decode,
                        u, v, axes, floor, inside, first, last, out,
                    )  # fmt: skip
                first = last

    def wanted(
        self, u: Floats, v: Floats, axes: Floats, floor: Floats, inside: Floats
    ) -> tuple[Places, bool]:  # fmt: skip
        """The tiles that footprints look up: their keys, ``FULL`` at most; whether they want levels that are held."""
        keys = np.full(4 * FULL, tile_kernels.EMPTY, np.int64)
        found = np.empty(FULL + LEAST, np.int64)
        count, _, coarse = tile_kernels.collect(
            self._levels, self.texels.base, u, v, axes, floor, inside, 0, keys, found
        )  # fmt: skip
        return found[: min(count, FULL)], coarse

    def window(self, key: int) -> tuple[int, int, int, int, int]:
        """Of a tile: its level, and its texels [r0, r1) × [c0, c1) counted from the file's corner, border included."""
        texels, k = self.texels, key >> 56
        row, col = ((key >> 28) & ((1 << 28) - 1)) * SIDE - 1, (key & ((1 << 28) - 1)) * SIDE - 1
        rows, cols = texels.shape(k)
        top, left = texels.window.row0 >> k, texels.window.col0 >> k
        return (
            k, top + max(row, 0), top + min(row + EDGE, rows), left + max(col, 0), left + min(col + EDGE, cols),
        )  # fmt: skip

    @contextmanager
    def _held(self, keys: Places) -> Iterator[Places]:
        """The slots (n,) of tiles, which stay meanwhile; reads those that are absent."""
        given, own, awaited = np.empty(len(keys), np.int64), [], []
        with self._changed:
            for n, key in enumerate(keys.tolist()):
                slot = self._slots.find(key)
                if slot < 0:
                    slot, _ = self._slots.take(key, HELD)
                    assert slot >= 0, "the tiles of all threads together exceed the available memory"
                    self._ready[slot] = False
                    self._reading.add(slot)
                    own.append((key, slot))
                else:
                    self._slots.last[slot] = HELD
                    awaited.append((key, slot))
                self._users[slot] += 1
                given[n] = slot
        try:
            try:
                for key, slot in sorted(own):
                    self._read(key, slot)
            except BaseException:
                with self._changed:
                    self._reading.difference_update(slot for _, slot in own)
                    self._changed.notify_all()
                raise
            for key, slot in awaited:
                with self._changed:
                    while slot in self._reading:
                        self._changed.wait()
                if not self._ready[slot]:  # the thread that was to read it failed: here it does too, or it has passed
                    self._read(key, slot)
            yield given
        finally:
            with self._changed:
                self._uses += 1
                np.subtract.at(self._users, given, 1)
                for key, slot in (*own, *awaited):
                    if not self._users[slot]:
                        self._slots.last[slot] = self._uses
                        if not self._ready[slot]:
                            self._slots.release(key)

    def _read(self, key: int, slot: int) -> None:
        """Load a tile into its slot, with its border from adjacent tiles, or extrapolated where there are none."""
        texels, (k, r0, r1, c0, c1) = self.texels, self.window(key)
        block = texels.read(k, r0, r1, c0, c1)
        # From the tile's first texel, border included, to the first that there is.
        top = r0 - (texels.window.row0 >> k) - ((key >> 28) & ((1 << 28) - 1)) * SIDE + 1
        left = c0 - (texels.window.col0 >> k) - (key & ((1 << 28) - 1)) * SIDE + 1
        around = ((top, EDGE - top - block.shape[0]), (left, EDGE - left - block.shape[1]), (0, 0))
        place = slice(slot * EDGE * EDGE, (slot + 1) * EDGE * EDGE)
        self._pool[place] = np.pad(block, around, "edge").reshape(-1, 4)
        with self._changed:
            self._ready[slot] = True
            self._reading.discard(slot)
            self.read += 1
            self._changed.notify_all()
