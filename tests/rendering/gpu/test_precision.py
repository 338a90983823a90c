"""Far and near at once: two metres above the ground at UTM coordinates, and mountains two hundred kilometres away."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.rendering.gpu.renderer import Renderer
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

SIZE = (200, 140)
EAST, NORTH = 700_000.0, 5_300_000.0
FAR = 200_000.0


def make(heights: NDArray[np.float32], metres: float) -> Terrain:
    grid = Grid(heights.shape, Affine(metres, 0, EAST, 0, -metres, NORTH), CRS.from_epsg(32632))
    return in_memory(Dem(heights.astype(np.float32), grid))


class Eye:
    """Draws a terrain and reads it back."""

    def __init__(self, device: Device, terrain: Terrain) -> None:
        self.device, self.terrain, self.renderer = device, terrain, Renderer(device, terrain, gpu_memory=1 << 28)
        self.texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
        self.target = self.texture.create_view()

    def look(self, view: View, tolerance: float = 1.0) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
        """Depths and colours."""
        scene = Scene.of(self.terrain, view, tolerance=tolerance, water=None, colormap="grey", shadows=False)
        self.renderer.draw(self.target, "rgba8unorm", scene, wait=True, samples=1)
        return self.renderer.depth(), self.device.read_texture(self.texture, np.uint8, 4)[..., :3].astype(np.int16)


@pytest.fixture
def eye(device: Device) -> Iterator[object]:
    made: list[Eye] = []

    def start(terrain: Terrain) -> Eye:
        made.append(Eye(device, terrain))
        return made[-1]

    yield start
    for each in made:
        each.renderer.close()


def mountains(rows: int, cols: int) -> NDArray[np.float32]:
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    z = (
        900
        + 500 * np.sin(x / 31) * np.cos(y / 23)
        + 200 * np.sin(x / 7 + y / 5)
        + 60 * np.sin(x * 1.9) * np.sin(y * 1.7)
    )
    return z.astype(np.float32)


def test_two_walls_ten_metres_apart_keep_their_order_at_two_hundred_kilometres(eye) -> None:
    """The nearer, 300 m high, hides the farther, 310 m high, up to its top, and shows it above."""
    heights = np.zeros((40, 20_100), np.float32)
    front = round(FAR / 10)
    heights[:, front:] = 300.0
    heights[:, front + 1 :] = 310.0
    terrain = make(heights, 10.0)
    x, y = (float(v) for v in terrain.grid.xy(0, 20))
    view = View((x, y, 305.0), (x + FAR, y, 305.0), fov_y=0.008, width=SIZE[0], height=SIZE[1], near=1.0)
    assert view.pixel_slope * FAR < 0.25  # metres a pixel
    depth, _ = eye(terrain).look(view, tolerance=0.5)
    up = 305.0 + (SIZE[1] / 2 - np.arange(SIZE[1]) - 0.5) * view.pixel_slope * FAR
    middle = depth[:, 60:140]
    lower, upper = middle[(up < 299)], middle[(up > 301) & (up < 309)]
    assert lower.size and upper.size
    # From the foot of the front wall, ten metres before it, to its top; from there to the back wall's.
    assert np.isfinite(lower).all() and lower.max() < FAR + 0.1
    assert np.isfinite(upper).all() and (upper > FAR + 0.5).all() and (upper < FAR + 10.1).all()
    assert (np.diff(np.nanmean(middle[up < 309.5], axis=1)) <= 0.05).all()  # nearer and nearer downwards


@pytest.mark.stress
def test_mountains_two_hundred_kilometres_away_do_not_flicker(eye) -> None:
    """The eye moves by a millimetre: no more than one pixel in a thousand may change by more than 3 of 255."""
    terrain = make(mountains(160, 5300), 40.0)
    x, y = (float(v) for v in terrain.grid.xy(5, 80))
    here = eye(terrain)
    seen, depths = [], []
    for k in range(5):
        at = (x + 0.001 * k, y + 0.001 * k, 3500.0)
        depth, color = here.look(View(at, (x + FAR, y, 900.0), fov_y=1.0, width=SIZE[0], height=SIZE[1]))
        depths.append(depth)
        seen.append(color)
    assert np.isfinite(depths[0]).mean() > 0.1 and np.nanmax(depths[0]) > 195_000
    for before, after in pairwise(seen):
        assert float((np.abs(before - after).max(-1) > 3).mean()) < 1e-3
    for before, after in pairwise(depths):
        both = np.isfinite(before) & np.isfinite(after)
        # Edges aside: as much as the rounding of depths at 200 km, 0.03 m, and the step itself.
        assert float(np.quantile(np.abs(before - after)[both], 0.995)) < 0.1


@pytest.mark.parametrize("shift", [(0.001, 0.0, 0.0), (0.0, 0.001, 0.0), (0.0, 0.0, 0.001)])
def test_steps_of_a_millimetre_are_all_alike_two_metres_up(eye, shift: tuple[float, float, float]) -> None:
    """A slope at UTM coordinates, 700 km and 5300 km from their origin: every step moves the picture by the same."""
    rows, cols = np.mgrid[:500, :500]
    terrain = make((7.5 * (rows + cols)).astype(np.float32), 30.0)  # 0.25 each way
    x, y = (float(v) for v in terrain.grid.xy(300.3, 300.7))
    ground = 7.5 * (300.3 + 300.7)
    here = eye(terrain)
    depths = []
    for k in range(6):
        east, north, up = (k * s for s in shift)
        view = View((x + east, y + north, ground + 2.0 + up), (x + east, y + north - 4.0, ground + up), fov_y=40.0)
        depths.append(here.look(view.resized(*SIZE))[0][-50:])
    steps = np.diff(np.stack(depths).astype(np.float64), axis=0)
    assert np.isfinite(steps).all()
    # What rasterising large triangles rounds; a hundredth of a pixel, and a quarter of a step.
    assert float(np.abs(np.diff(steps, axis=0)).max()) < 2.5e-4
    assert float(np.abs(steps).min()) > 1e-4 and float(np.abs(steps).max()) < 5e-3  # and they do move, everywhere
