"""More rays where depth breaks off: there as good as more rays everywhere, one elsewhere; brute force is the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import plain
import pytest

from orograph.dem.raster import Dem
from orograph.gpu.device import Device
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.renderer import Renderer
from orograph.scene.camera import whole
from orograph.scene.scene import Scene
from orograph.scene.silhouettes import Silhouettes
from orograph.store import terrain as in_memory
from orograph.viewpoint import View

SIZE = (240, 150)


def ridges() -> Any:
    """Ridges behind ridges, and a hole."""
    t = plain.terrain(np.zeros((200, 220), np.float32), cell=30.0)
    y, x = np.mgrid[:200, :220] * 30.0
    z = 250 * np.abs(np.sin(x / 900) * np.cos(y / 700)) + 80 * np.sin(x / 260 + y / 330)
    z[60:75, 100:130] = np.nan
    return in_memory(Dem(z.astype(np.float32), t.grid))


def low(t: Any) -> View:
    (x, y), (u, v) = t.grid.xy(110, 195), t.grid.xy(100, 60)
    return View((x, y, 420.0), (u, v, 150.0), width=SIZE[0], height=SIZE[1])


def drawn(renderer: Renderer, scene: Scene) -> Any:
    return draw(scene, device=renderer.device, renderer=renderer)


@pytest.mark.stress
@pytest.mark.parametrize("light", ["shaded", "shadows"])
def test_breaks_are_as_smooth_as_by_brute_force_and_the_rest_has_one_ray(device: Device, light: str) -> None:
    t = ridges()
    renderer = Renderer(device, t)
    scene = Scene.of(t, low(t), method="raycast", tolerance=1.0, shadows=light == "shadows")
    truth = drawn(renderer, scene.but(samples=64)).pixels.astype(float)
    one, every = (drawn(renderer, scene.but(samples=n)).pixels.astype(float) for n in (1, 12))
    picture = drawn(renderer, scene.but(samples=12, method="raycast,antialias=breaks"))
    few = picture.pixels.astype(float)
    found = device.read_buffer(renderer._ground._rays._breaks.found, np.uint32).reshape(SIZE[::-1]) == 1
    assert 0.01 < found.mean() < 0.25

    def off(pixels: Any, where: Any) -> float:
        return float(np.sqrt(((pixels - truth)[where] ** 2).mean()))

    np.testing.assert_array_equal(few[~found], one[~found])
    assert off(few, found) < 1.25 * off(every, found) + 0.3 < 0.5 * off(one, found)
    # Nothing that brute force has else is far off elsewhere: what is missed is no silhouette.
    assert (np.abs(few - truth).max(-1) > 24).mean() < 0.001 < (np.abs(one - truth).max(-1) > 24).mean()
    # What others read of the frame is at the pixels' centres, of all of them.
    whole_depth = drawn(renderer, scene.but(samples=1)).depth
    np.testing.assert_array_equal(picture.depth, whole_depth)
    renderer.close()


def test_depths_of_the_targets_are_whole_afterwards(device: Device) -> None:
    t = ridges()
    renderer = Renderer(device, t)
    target = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC").create_view()
    scene = Scene.of(t, low(t), method="raycast,antialias=breaks", tolerance=1.0)
    renderer.draw(target, "rgba8unorm", scene, wait=True, samples=1)
    before = renderer.depth()
    renderer.draw(target, "rgba8unorm", scene, wait=True, samples=4)
    np.testing.assert_array_equal(renderer.depth(), before)
    renderer.close()


def test_a_plan_breaks_off_where_ground_ends(device: Device) -> None:
    t = ridges()
    renderer = Renderer(device, t)
    x, y = t.grid.xy(110, 100)
    view = View((x, y, 9000.0), (x, y, 0.0), projection="plan", width=SIZE[0], height=SIZE[1])
    drawn(renderer, Scene.of(t, view, method="raycast,antialias=breaks", tolerance=1.0, samples=4))
    found = device.read_buffer(renderer._ground._rays._breaks.found, np.uint32).reshape(SIZE[::-1]) == 1
    ground = np.isfinite(renderer.depth())
    beside = np.zeros_like(ground)
    padded = np.pad(ground, 1, mode="edge")
    for r in range(3):
        for c in range(3):
            beside |= padded[r : r + SIZE[1], c : c + SIZE[0]] != ground
    assert found[beside].all() and found.mean() < 0.3  # (light breaks off, too)
    renderer.close()


@pytest.mark.stress
def test_what_needs_all_pixels_has_them(device: Device) -> None:
    """Silhouettes are found in whole pictures, and rays of light are gathered by all samples."""
    t = ridges()
    for how in ({"silhouettes": Silhouettes()}, {"light": "raytraced", "rays": 2}):
        scene = Scene.of(t, whole(t, (80, 50)), tolerance=1.0, samples=2, **how)
        a, b = (draw(scene.but(method=m), device=device).pixels for m in ("raycast", "raycast,antialias=breaks"))
        np.testing.assert_array_equal(a, b)
