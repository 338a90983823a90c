"""An atlas of tiles: one texture array of a fixed size, in which new tiles replace those no longer wanted.

A layer of the array holds 4 × 4 tiles. The frame uploads tiles (``put``) and marks the wanted ones with ``touch``.
Tiles that are *pinned* never leave, so that something can always be drawn.
"""

from __future__ import annotations

import contextlib
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.rendering.gpu.stream.landing import Landed, Landing, Tile
from orograph.slots import HELD, Slots

PER_SIDE = 4
"""Tiles along the side of an atlas's layer."""


class TileAtlas:
    """Slots for tiles of one size in one texture array; the least recently wanted tiles make room for new ones.

    Args:
        side: of a tile, texels. format, size: of a texel, and its bytes.
        budget: bytes of the texture. most: how many tiles there are in all; no more places are made.
        landing: where tiles land, if any do.

    Attributes:
        texture: layers of 4 × 4 tiles. capacity: how many tiles fit. bytes: of the texture.
    """

    def __init__(
        self, device: Device, side: int, format: str, size: int, budget: int, most: int, label: str,
        landing: Landing | None = None,
    ) -> None:  # fmt: skip
        self.device, self.side, self.landing = device, side, landing
        self._row = side * size
        layer = (PER_SIDE * side) ** 2 * size
        layers = int(max(1, min(budget // layer, 256, -(-most // PER_SIDE**2))))
        self.capacity = layers * PER_SIDE**2
        self.bytes = layers * layer
        self.texture = device.texture(
            (PER_SIDE * side, PER_SIDE * side, layers), format, "TEXTURE_BINDING|COPY_DST|COPY_SRC", label=label
        )
        # In a thread, because software drivers clear at once; whoever comes first has a layer cleared. Never
        # both at once: within wgpu, a submission and a write that need the same texture cleared wait for each other.
        self._clearing = threading.Lock()
        threading.Thread(target=self._clear, args=(layers,), name="clear", daemon=True).start()
        self._slots: Slots[Any] = Slots(self.capacity)

    def _clear(self, layers: int) -> None:
        """Let the device clear the memory now, in the background: a first frame would wait for it.

        wgpu clears a layer before its first use, such as copying a texel out of it.
        """
        with contextlib.suppress(Exception):  # the next use of the device reports what is wrong
            out = self.device.buffer(256, "COPY_SRC", "cleared")
            encoder = self.device.handle.create_command_encoder()
            for layer in range(layers):
                encoder.copy_texture_to_buffer(
                    {"texture": self.texture, "origin": (0, 0, layer)},
                    {"buffer": out, "offset": 0, "bytes_per_row": 256, "rows_per_image": 1}, (1, 1, 1),
                )  # fmt: skip
            commands = encoder.finish()
            with self._clearing:
                self.device.queue.submit([commands])

    def slot(self, key: Any) -> int:
        """The slot of a tile, −1 if it is absent."""
        return self._slots.find(key)

    def touch(self, slots: NDArray[np.int32], frame: int) -> None:
        """Mark the tiles in slots as wanted in a frame, so that they stay; −1 is no tile."""
        self._slots.touch(slots[slots >= 0], frame)

    @property
    def count(self) -> int:
        """The number of tiles held."""
        return len(self._slots)

    @property
    def room(self) -> int:
        """The number of slots for tiles that are not pinned."""
        return self._slots.room(HELD)

    def put(self, key: Any, data: Tile, frame: int, *, pin: bool = False) -> tuple[int, Any]:
        """Upload an absent tile (one that landed is there after ``Landing.settle``); return its slot and the key of the
        tile that it replaced, or None.

        The slot is −1 if all slots hold tiles that this frame wants.
        """
        slot, before = self._slots.take(key, frame)
        if slot >= 0:
            self._write(slot, data)
            self._slots.last[slot] = HELD if pin else frame
        return slot, before

    def replace(self, key: Any, data: Tile) -> None:
        """Upload a tile again under the same key."""
        self._write(self._slots.find(key), data)

    def _write(self, slot: int, data: Tile) -> None:
        layer, place = divmod(slot, PER_SIDE**2)
        y, x = divmod(place, PER_SIDE)
        origin = x * self.side, y * self.side, layer
        if isinstance(data, Landed):
            assert self.landing is not None
            self.landing.copy(data, self.texture, origin, self.side, self._clearing)
            return
        with self._clearing:
            self.device.queue.write_texture(
                {"texture": self.texture, "origin": origin},
                np.ascontiguousarray(data),
                {"bytes_per_row": self._row, "rows_per_image": self.side},
                (self.side, self.side, 1),
            )

    def free(self, key: Any) -> None:
        """Release a tile."""
        self._slots.release(key)
