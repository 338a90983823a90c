"""Where tiles land on the GPU: the threads that read them write them into a buffer, frames only have them copied.

A write to a texture costs a frame a tenth of a millisecond, most of it for memory that the driver takes for the data,
and the copy into it. So threads do that, into places of a buffer; a frame records for each tile a copy from there into
its atlas, and hands them over together. A thread that finds no place leaves its tile in memory, and the frame writes
it to the texture.
"""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.recording import copy_to_texture

ROW = 256
"""WebGPU copies rows that begin at multiples of so many bytes."""

PLACES = 32
"""Tiles that may be on their way; readers are at most twice as many ahead of the frames."""


@dataclass(frozen=True, slots=True)
class Landed:
    """A tile on the GPU, to be copied.

    Attributes:
        place: in the buffer. nbytes: of the tile. row: bytes from one row in the buffer to the next.
    """

    place: int
    nbytes: int
    row: int


Tile = NDArray[Any] | Landed
"""A tile of an atlas: its texels, or where they are on the GPU."""


class Landing:
    """Places for tiles of square atlases.

    Args:
        side: of the largest tile, texels. size: bytes of one of its texels.
    """

    def __init__(self, device: Device, side: int, size: int) -> None:
        self.device = device
        self._bytes = side * _padded(side * size)
        self._buffer = device.buffer(PLACES * self._bytes, "COPY_SRC", "tiles that land")
        self._free, self._lock = list(range(PLACES)), threading.Lock()
        self._due: list[tuple[Landed, Any, tuple[int, int, int], int]] = []
        self._locks: list[threading.Lock] = []

    def land(self, tile: NDArray[Any]) -> Tile:
        """Bring a tile (rows, columns, …) to the GPU, from any thread; itself if there is no place for it."""
        with self._lock:
            if not self._free:
                return tile
            place = self._free.pop()
        rows = len(tile)
        flat = np.ascontiguousarray(tile).view(np.uint8).reshape(rows, -1)
        padded = np.zeros((rows, _padded(flat.shape[1])), np.uint8)
        padded[:, : flat.shape[1]] = flat
        self.device.queue.write_buffer(self._buffer, place * self._bytes, padded)
        return Landed(place, tile.nbytes, padded.shape[1])

    def copy(self, tile: Landed, texture: Any, origin: tuple[int, int, int], side: int, lock: threading.Lock) -> None:
        """Note that a tile is to be copied. ``lock``: held while the copies of this texture are submitted."""
        self._due.append((tile, texture, origin, side))
        if lock not in self._locks:
            self._locks.append(lock)

    def give_back(self, tile: Tile) -> None:
        """A tile is not wanted any more."""
        if isinstance(tile, Landed):
            self._release([tile])

    def settle(self) -> None:
        """Have all copied that are to be."""
        if not self._due:
            return
        encoder = self.device.handle.create_command_encoder()
        for tile, texture, origin, side in self._due:
            offset = tile.place * self._bytes
            copy_to_texture(encoder, self._buffer, offset, tile.row, texture, origin, (side, side))
        commands = encoder.finish()
        with contextlib.ExitStack() as held:
            for lock in self._locks:
                held.enter_context(lock)
            self.device.queue.submit([commands])
        # What is written to the places from now on is written after the copies.
        self._release([tile for tile, *_ in self._due])
        self._due.clear()
        self._locks.clear()

    def _release(self, tiles: list[Landed]) -> None:
        with self._lock:
            self._free += [tile.place for tile in tiles]


def _padded(row: int) -> int:
    return -(-row // ROW) * ROW
