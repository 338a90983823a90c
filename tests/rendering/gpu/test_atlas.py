"""Places for tiles in a texture: clearing it in a thread and writing into it do not wait for each other."""

from __future__ import annotations

import threading

import numpy as np

from orograph.gpu.device import Device
from orograph.rendering.gpu.stream.atlas import TileAtlas


def test_tiles_are_put_while_the_texture_is_cleared(device: Device) -> None:
    """Within wgpu a submission and a write that both want a layer cleared lock each other out for good."""
    tile = np.zeros((257, 257), np.float32)

    def work() -> None:
        for _ in range(40):
            slots = TileAtlas(device, 257, "r32float", 4, 48 << 20, 1000, "tiles")
            for key in range(12):
                slots.put(key, tile, key)
            device.wait()

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    worker.join(120)
    assert not worker.is_alive()
