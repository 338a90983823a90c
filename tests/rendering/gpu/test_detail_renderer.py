"""Detail beyond the data in a window: frames come to have it, others have none, and what cannot be made is told."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

import orograph
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.rendering.gpu.detail_renderer import DetailRenderer
from orograph.rendering.gpu.renderer import Renderer
from orograph.scene.scene import Scene
from orograph.viewpoint import View


@pytest.fixture(scope="module")
def hills() -> orograph.Terrain:
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:60, :47]
    heights = (300 + 60 * np.sin(x / 7) * np.cos(y / 9) + rng.normal(0, 4, x.shape)).astype(np.float32)
    grid = Grid(heights.shape, Affine(30, 0, 500_000, 0, -30, 5_000_000), CRS.from_epsg(32632))
    return orograph.terrain(orograph.Dem(heights, grid, None, "hills"), progress=False)


@pytest.mark.stress
def test_frames_come_to_have_detail(hills: orograph.Terrain, device) -> None:
    x, y = (float(v) for v in hills.grid.xy(20, 40))
    view = View((x, y, 480.0), (x + 300, y + 400, 250.0), width=80, height=60)
    renderer = DetailRenderer(device, hills, lambda ground: Renderer(device, ground, gpu_memory=1 << 25))
    target = device.texture((80, 60), "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC").create_view()

    def rests(scene: Scene) -> np.ndarray:
        end = time.monotonic() + 120
        while True:
            stats = renderer.draw(target, "rgba8unorm", scene)
            if (renderer.resting and stats.current) or time.monotonic() > end:
                assert stats.failed == "" and renderer.resting
                return renderer.depth()

    try:
        plain = Scene.of(hills, view, tolerance=1.0)
        fine = Scene.of(hills, view, tolerance=1.0, detail="fractal,seed=3")
        without = rests(plain)
        shown = rests(fine)
        assert renderer.windows is not None and renderer.windows.windows[-1].level >= 0
        seen = np.isfinite(shown) & np.isfinite(without)
        assert seen.mean() > 0.5 and np.median(np.abs(shown - without)[seen]) > 0.05
        picture = orograph.render(hills, view, tolerance=1.0, detail="fractal,seed=3", progress=False)
        both = seen & np.isfinite(picture.depth)
        # (The last frame at rest is drawn with samples elsewhere in the pixels.)
        off, was = (np.median(np.abs(one - picture.depth)[both]) for one in (shown, without))
        assert off < 0.4 * was
        np.testing.assert_array_equal(rests(plain), without)
        wrong = replace(fine, surface=replace(fine.surface, detail=orograph.scene.detail.Detail(hills)))
        with pytest.raises(UsageError, match="finer than the terrain"):
            renderer.draw(target, "rgba8unorm", wrong, wait=True)
    finally:
        renderer.close()
