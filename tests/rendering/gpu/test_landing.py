"""Tiles that threads bring to the GPU and frames have copied into their atlases."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from orograph.gpu import recording
from orograph.gpu.device import Device
from orograph.rendering.gpu.stream import landing as landing_module
from orograph.rendering.gpu.stream.atlas import PER_SIDE, TileAtlas
from orograph.rendering.gpu.stream.landing import Landed, Landing


def tile(key: int, side: int, channels: int, dtype: type) -> np.ndarray:
    return np.random.default_rng(key).uniform(0, 99, (side, side, channels)).astype(dtype)


@pytest.mark.parametrize("native", [True, False])
def test_tiles_arrive_whole_whoever_brings_them_and_however_many(
    device: Device, monkeypatch: pytest.MonkeyPatch, native: bool
) -> None:
    """Of two atlases with one landing, by several threads, more than there are places for."""
    if not native:
        monkeypatch.setattr(recording, "_FOUND", [None])
    monkeypatch.setattr(landing_module, "PLACES", 8)
    kinds = {37: ("r32float", 4, 1, np.float32), 38: ("rg16float", 4, 2, np.float16)}
    landing = Landing(device, 38, 4)
    atlases = {
        side: TileAtlas(device, side, format, size, 1 << 22, 60, "tiles", landing)
        for side, (format, size, _, _) in kinds.items()
    }
    slots: dict[tuple[int, int], int] = {}
    for first in range(0, 40, 10):
        found, landed = {}, 0

        def bring(side: int, keys: range, found: dict = found) -> None:
            for key in keys:
                found[side, key] = landing.land(tile(key, side, *kinds[side][2:]))

        threads = [threading.Thread(target=bring, args=(side, range(first, first + 10))) for side in kinds]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for (side, key), data in found.items():
            landed += isinstance(data, Landed)
            slots[side, key] = atlases[side].put(key, data, first)[0]
        landing.settle()
        assert landed == 8  # the others are written by the frame
    for (side, key), slot in slots.items():
        _, _, channels, dtype = kinds[side]
        layer, place = divmod(slot, PER_SIDE**2)
        y, x = (side * n for n in divmod(place, PER_SIDE))
        whole = device.read_texture(atlases[side].texture, dtype, channels, layer=layer)
        np.testing.assert_array_equal(whole[y : y + side, x : x + side], tile(key, side, channels, dtype))


def test_a_tile_that_is_given_back_leaves_its_place(device: Device) -> None:
    landing = Landing(device, 16, 4)
    for _ in range(2 * landing_module.PLACES):
        data = landing.land(np.zeros((16, 16), np.float32))
        assert isinstance(data, Landed)
        landing.give_back(data)
