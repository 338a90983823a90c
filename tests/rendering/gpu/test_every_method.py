"""Pictures of one view by every method lie as close to each other as the manual says those of both backends do."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from affine import Affine
from cielab import lab

from orograph.dem.synth import Synth
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.lod.registry import METHODS
from orograph.rendering.cpu.draw import draw as draw_cpu
from orograph.rendering.gpu.draw import draw as draw_gpu
from orograph.scene.camera import around
from orograph.scene.scene import Scene
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import View

SIZE = (160, 100)


@pytest.fixture(scope="module")
def terrain() -> MemoryTerrain:
    """150 × 201 samples of 30 × 30 m."""
    heights = np.array(Synth((150, 201), 7).read(0, 150, 0, 201))
    heights[40:44, 90:99] = np.nan
    return MemoryTerrain(heights, Grid(heights.shape, Affine(30.0, 0, 0, 0, -30.0, 0), None), "synthetic")


def views(terrain: MemoryTerrain) -> dict[str, View]:
    x, y = (float(v) for v in terrain.grid.xy(20.0, 130.0))
    high = terrain.height_range[1]
    return {
        "slant": around(terrain, SIZE, azimuth=215, pitch=30, distance=None),
        "low": View((x, y, high + 100.0), (x + 3000.0, y + 2500.0, high - 300.0), width=SIZE[0], height=SIZE[1]),
    }


@pytest.mark.stress
@pytest.mark.parametrize("name", ["slant", "low"])
def test_pictures_of_all_methods_are_alike_in_the_light_of_the_ground(
    device: Device, terrain: MemoryTerrain, name: str
) -> None:
    view = views(terrain)[name]
    pictures = {"the CPU": lab(draw_cpu(Scene.of(terrain, view, samples=4)).pixels)}
    for method in METHODS:
        scene = Scene.of(terrain, view, samples=4, method=method, tolerance=0.5, normals="computed")
        pictures[method] = lab(draw_gpu(scene, device=device).pixels)
    assert len(pictures) == len(METHODS) + 1 and pictures["the CPU"].std() > 5
    for a, b in itertools.combinations(pictures, 2):
        off = np.linalg.norm(pictures[a] - pictures[b], axis=-1)
        assert off.mean() < 1 and np.quantile(off, 0.95) < 3, (a, b, off.mean(), np.quantile(off, 0.95))
