"""The renderer frame by frame: it never waits, never shows a hole, keeps within its memory, and moves smoothly."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.errors import ReadError
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.rendering.gpu.frame import FrameStats, Overlay
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.shade import following
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

SIZE = (200, 140)
FAR_EAST, FAR_NORTH = 700_000.0, 5_300_000.0


def hills(rows: int, cols: int, metres: float = 20.0) -> NDArray[np.float32]:
    y, x = np.mgrid[:rows, :cols] * metres
    z = (
        300
        + 200 * np.sin(x / 900) * np.cos(y / 700)
        + 60 * np.sin(x / 170 + y / 230)
        + 8 * np.sin(x / 31) * np.sin(y / 37)
    )
    return z.astype(np.float32)


def make(heights: NDArray[np.float32], metres: float = 20.0) -> Terrain:
    transform = Affine(metres, 0, FAR_EAST, 0, -metres, FAR_NORTH)
    return in_memory(Dem(heights, Grid(heights.shape, transform, CRS.from_epsg(32632))))


class Slow:
    """A terrain whose finer levels are read when a test says so; the rest is the terrain's own."""

    def __init__(self, terrain: Terrain) -> None:
        self._terrain = terrain
        self.open = threading.Event()
        self.fail = False

    def __getattr__(self, name: str) -> object:
        return getattr(self._terrain, name)

    def _wait(self, level: int) -> None:
        if level < self._terrain.levels - 1 and threading.current_thread().name.startswith("tiles"):
            if self.fail:
                raise ReadError("The file vanished.")
            self.open.wait(30)

    def read(self, level: int, *window: int) -> NDArray[np.float32]:
        self._wait(level)
        return self._terrain.read(level, *window)

    def read_mean(self, level: int, *window: int) -> NDArray[np.float32]:
        self._wait(level)
        return self._terrain.read_mean(level, *window)


class Bench:
    """A renderer with a texture to draw into."""

    def __init__(self, device: Device, terrain: Terrain, **options: int) -> None:
        self.device, self.renderer = device, Renderer(device, terrain, **options)
        self.texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
        self.view = self.texture.create_view()

    def draw(self, scene: Scene, **options: object) -> FrameStats:
        return self.renderer.draw(self.view, "rgba8unorm", scene, **options)  # type: ignore[arg-type]

    def pixels(self) -> NDArray[np.int16]:
        return self.device.read_texture(self.texture, np.uint8, 4)[..., :3].astype(np.int16)


@pytest.fixture
def bench(device: Device) -> Iterator[object]:
    made: list[Bench] = []

    def start(terrain: Terrain, **options: int) -> Bench:
        made.append(Bench(device, terrain, **options))
        return made[-1]

    yield start
    for b in made:
        b.renderer.close()


def above(terrain: Terrain) -> View:
    """Straight down onto the terrain's middle, ground in every pixel."""
    x, y = (float(v) for v in terrain.grid.xy(terrain.grid.cols / 2, terrain.grid.rows / 2))
    high = 0.8 * min(terrain.grid.shape) * terrain.grid.spacing[0]
    return View((x, y - 1.0, high), (x, y, 300.0), width=SIZE[0], height=SIZE[1])


@pytest.mark.stress
def test_frames_never_wait_for_tiles_and_never_show_a_hole(bench) -> None:
    terrain = Slow(make(hills(1500, 1800)))
    b = bench(terrain)
    scene = Scene.of(terrain, above(terrain), tolerance=0.1)
    b.draw(scene)  # compiles
    begun = time.perf_counter()
    stats = b.draw(scene)
    assert time.perf_counter() - begun < 5.0  # the tiles' threads wait for up to 30 s
    assert stats.tiles_wanted > 0 and b.renderer.busy
    assert np.isfinite(b.renderer.depth()).all()
    coarse = stats.triangles
    terrain.open.set()
    end = time.perf_counter() + 60
    while b.renderer.busy and time.perf_counter() < end:
        stats = b.draw(scene)
        assert np.isfinite(b.renderer.depth()).all()
    assert stats.tiles_wanted == 0 and stats.triangles > coarse and stats.error_px <= 0.1


def test_a_file_that_vanishes_leaves_what_there_is(bench) -> None:
    terrain = Slow(make(hills(1500, 1800)))
    terrain.fail = True
    b = bench(terrain)
    scene = Scene.of(terrain, above(terrain), tolerance=1.0)
    end = time.perf_counter() + 60
    stats = b.draw(scene)
    while not stats.failed and time.perf_counter() < end:
        stats = b.draw(scene)
    assert "vanished" in stats.failed
    assert np.isfinite(b.renderer.depth()).all()


@pytest.mark.stress
def test_the_atlas_stays_within_its_memory_and_drops_what_was_seen_longest_ago(bench) -> None:
    terrain = make(hills(2100, 2100))
    b = bench(terrain, gpu_memory=2 * 16 * 258 * 258 * 4)  # one layer of 16 tiles of each kind
    assert b.renderer.heights.capacity == 16
    here = above(terrain)
    for k in range(6):
        shift = 3000.0 * (k - 3)
        view = replace(
            here, eye=(here.eye[0] + shift, here.eye[1], 3000.0), target=(here.eye[0] + shift, here.target[1], 300.0)
        )
        b.draw(Scene.of(terrain, view, tolerance=0.5))
        for _ in range(10):
            b.draw(Scene.of(terrain, view, tolerance=0.5))
            time.sleep(0.02)
        assert b.renderer.heights.count <= 16 and b.renderer.slopes.count <= 16
        assert np.isfinite(b.renderer.depth()).all()
    top = terrain.levels - 1
    assert b.renderer.heights.slot((top, 0, 0)) >= 0


def test_a_step_of_a_millimetre_moves_the_picture_smoothly(bench) -> None:
    """Two metres above the ground, seven hundred kilometres from the grid's origin."""
    terrain = make(hills(600, 600))
    x, y = (float(v) for v in terrain.grid.xy(300.3, 300.7))
    ground = float(terrain.read(0, 300, 302, 300, 302).max())
    b = bench(terrain)
    depths = []
    for k in range(6):
        eye = (x + 0.001 * k, y, ground + 2.0)
        view = View(eye, (x + 0.001 * k, y + 4.0, ground + 0.5), width=SIZE[0], height=SIZE[1])
        b.draw(Scene.of(terrain, view, tolerance=1.0, shadows=False), wait=True, samples=1)
        depths.append(b.renderer.depth()[-40:])
    stack = np.stack(depths)
    assert np.isfinite(stack).all()
    steps = np.diff(stack, axis=0)
    # The ground is a plane over such a distance: every step changes a pixel's depth by as much as the one before.
    assert float(np.abs(np.diff(steps, axis=0)).max()) < 2e-4
    assert float(np.abs(steps).max()) < 5e-3


@pytest.mark.stress
def test_mountains_far_away_do_not_flicker(bench) -> None:
    """The picture of ground 100 km away hardly changes while the eye moves by a millimetre."""
    heights = hills(300, 6000)
    terrain = make(heights)
    x, y = (float(v) for v in terrain.grid.xy(10, 150))
    b = bench(terrain)
    seen = []
    for k in range(4):
        eye = (x + 0.001 * k, y, 3000.0)
        view = View(eye, (x + 110_000.0, y, 300.0), fov_y=2.0, width=SIZE[0], height=SIZE[1])
        b.draw(Scene.of(terrain, view, tolerance=1.0), wait=True, samples=1)
        seen.append(b.pixels())
    for before, after in pairwise(seen):
        assert float((np.abs(before - after).max(-1) > 3).mean()) < 1e-3


@pytest.mark.stress
def test_the_picture_at_rest_is_smooth_and_stops(bench) -> None:
    terrain = make(hills(700, 700))
    b = bench(terrain)
    scene = Scene.of(
        terrain, replace(above(terrain), eye=(FAR_EAST - 500, FAR_NORTH - 15000, 2500.0)), sky=True, tolerance=1.0
    )
    first = b.draw(scene, wait=True)
    one = b.pixels()
    end = time.perf_counter() + 60
    while not b.renderer.resting and time.perf_counter() < end:
        last = b.draw(scene)
    assert first.samples == 1 and last.samples == 16
    many = b.pixels()
    rough, smooth = (float(np.abs(np.diff(p, 2, axis=0)).mean()) for p in (one, many))
    assert smooth < rough


def test_overlays_show_the_patches(bench) -> None:
    terrain = make(hills(400, 400))
    b = bench(terrain)
    scene = Scene.of(terrain, above(terrain), tolerance=2.0, colormap="grey", water=None)
    b.draw(scene, wait=True, samples=1)
    plain = b.pixels()
    for overlay in (Overlay(wireframe=True), Overlay(levels=True)):
        b.draw(scene, wait=True, samples=1, overlay=overlay)
        changed = (np.abs(b.pixels() - plain).max(-1) > 8).mean()
        assert changed > 0.01, overlay


def test_what_was_prepared_compiles_nothing_in_its_first_frame(bench, monkeypatch: pytest.MonkeyPatch) -> None:
    terrain = make(hills(300, 300))
    b = bench(terrain)
    scene = Scene.of(terrain, above(terrain), tolerance=1.0)
    b.renderer.prepare("rgba8unorm", scene)
    compiled = []
    create = b.device.handle.create_render_pipeline
    frame = threading.current_thread()

    def noted(**options: object) -> object:
        if threading.current_thread() is frame:
            compiled.append(options.get("label"))
        return create(**options)

    monkeypatch.setattr(b.device.handle, "create_render_pipeline", noted)
    assert b.draw(scene).patches > 0
    assert compiled == []


@pytest.mark.parametrize("light", ["ao", "aperture"])
def test_the_first_frame_has_an_open_sky(bench, light: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before maps of light are made nothing is hidden, and no frame is dark or late."""
    drawn, quick = threading.Event(), following.quick_maps

    def held_back(*args: object, **how: object) -> object:
        drawn.wait(60)
        return quick(*args, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(following, "quick_maps", held_back)
    terrain = make(np.zeros((300, 300), np.float32))
    b = bench(terrain)
    scene = Scene.of(terrain, above(terrain), tolerance=1.0, colormap="grey", water=None, light=light)  # type: ignore[arg-type]
    try:
        b.draw(scene)
        first = b.pixels()
    finally:
        drawn.set()
    b.draw(scene, wait=True, samples=1)
    assert first[30:-30, 30:-30].min() > 50
    assert np.abs(first - b.pixels())[30:-30, 30:-30].max() < 12


def test_lakes_and_voids_are_unknown_until_they_are_known(bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """At first sight they are hatched, and no plain ground."""
    drawn, quick = threading.Event(), following.quick_maps

    def held_back(*args: object, **how: object) -> object:
        drawn.wait(60)
        return quick(*args, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(following, "quick_maps", held_back)
    row, col = np.mgrid[:400, :400]
    heights = (300 + 0.002 * ((row - 200.0) ** 2 + (col - 120.0) ** 2)).astype(np.float32)
    heights[np.hypot(row - 200, col - 120) < 60] = heights[200, 60]  # a lake
    heights[170:230, 250:310] = np.nan
    terrain = make(heights)
    b = bench(terrain)
    scene = Scene.of(terrain, above(terrain), tolerance=1.0)

    def lines(col: int) -> float:
        """By how much pixels around a sample differ where hatching has lines."""
        x, y = scene.view.project((*(float(v) for v in terrain.grid.xy(col, 200)), 330.0))[0].round().astype(int)
        seen = b.pixels().astype(float).mean(-1)[y - 8 : y + 9, x - 8 : x + 9]
        return float(seen.max() - seen.min())

    try:
        for _ in range(200):  # tiles come
            b.draw(scene)
            if not b.renderer.tiles.waiting:
                break
            time.sleep(0.02)
        lake, void, land = lines(120), lines(280), lines(210)
    finally:
        drawn.set()
    assert lake > 50 and void > 50 and land < 20
    for _ in range(500):
        b.draw(scene)
        if not b.renderer.busy:
            break
        time.sleep(0.02)
    assert lines(120) < 20 and lines(280) > 50


def test_lakes_beyond_the_last_map_are_unknown(bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A camera that jumps sees hatching on lakes for which water was not looked for yet."""
    row, col = np.mgrid[:300, :3000]
    heights = (300 + 0.002 * ((row - 150.0) ** 2 + ((col % 1000) - 500.0) ** 2)).astype(np.float32)
    for centre in (500, 2500):
        heights[np.hypot(row - 150, col - centre) < 60] = heights[150, centre - 60]  # a lake
    terrain = make(heights)
    b = bench(terrain)
    east, north = (float(v) for v in terrain.grid.xy(500, 150))
    here = View((east, north - 50.0, 4300.0), (east, north, 300.0), width=SIZE[0], height=SIZE[1])
    jump = 2000 * 20.0
    there = replace(here, eye=(east + jump, north - 50.0, 4300.0), target=(east + jump, north, 300.0))

    def settled(view: View) -> float:
        scene = Scene.of(terrain, view, tolerance=1.0)
        for _ in range(500):
            b.draw(scene)
            if not b.renderer.busy:
                break
            time.sleep(0.02)
        return lines()

    def lines() -> float:
        middle = (
            b.pixels().astype(float).mean(-1)[SIZE[1] // 2 - 8 : SIZE[1] // 2 + 9, SIZE[0] // 2 - 8 : SIZE[0] // 2 + 9]
        )
        return float(middle.max() - middle.min())

    assert settled(here) < 20
    drawn, made = threading.Event(), following.light_maps

    def held_back(*args: object, **how: object) -> object:
        drawn.wait(60)
        return made(*args, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(following, "light_maps", held_back)
    try:
        for _ in range(200):  # tiles come
            b.draw(Scene.of(terrain, there, tolerance=1.0))
            if not b.renderer.tiles.waiting:
                break
            time.sleep(0.02)
        assert lines() > 50
    finally:
        drawn.set()
    assert settled(there) < 20


def test_ground_below_a_level_is_water_before_any_map_of_it(bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Water up to a height needs no search: it is there in the first frame, and beyond the last map, with its shore."""
    drawn, quick = threading.Event(), following.quick_maps

    def held_back(*args: object, **how: object) -> object:
        drawn.wait(60)
        return quick(*args, **how)  # type: ignore[arg-type]

    row, col = np.mgrid[:400, :400]
    terrain = make((0.002 * ((row - 200.0) ** 2 + (col - 200.0) ** 2)).astype(np.float32))
    b = bench(terrain)
    scene = Scene.of(terrain, above(terrain), tolerance=1.0, water=20.0, light="none")
    monkeypatch.setattr(following, "quick_maps", held_back)
    try:
        for _ in range(200):  # tiles come
            b.draw(scene)
            if not b.renderer.tiles.waiting:
                break
            time.sleep(0.02)
        first = b.pixels().astype(int)
    finally:
        drawn.set()
    b.draw(scene, wait=True, samples=1)
    known = b.pixels().astype(int)
    assert np.abs(first - known).max(-1)[SIZE[1] // 2, SIZE[0] // 2] < 4
    assert (np.abs(first - known).max(-1) > 24).mean() < 0.01  # the shore is a map's there


def test_screen_space_occlusion_darkens_hollows_and_not_plains(bench) -> None:
    heights = np.zeros((400, 400), np.float32)
    heights[150:250, 150:250] = -400.0  # a shaft of two kilometres
    terrain = make(heights)
    b = bench(terrain)
    scene = Scene.of(terrain, above(terrain), tolerance=1.0, colormap="grey", water=None, light="none")
    b.draw(scene, wait=True, samples=1)
    plain = b.pixels().sum(-1)
    b.draw(scene, wait=True, samples=1, overlay=Overlay(occlusion=1.0, reach=500.0))
    darker = (plain - b.pixels().sum(-1)).astype(float)
    x, y = (float(v) for v in terrain.grid.xy(156, 200))
    foot, middle, far = (
        scene.view.project([east, y, z])[0] for east, z in ((x, -400.0), (x + 44 * 20.0, -400.0), (x - 100 * 20.0, 0.0))
    )
    at = [darker[round(float(p[1])), round(float(p[0]))] for p in (foot, middle, far)]
    assert at[0] > 40 and at[1] < 25 and at[2] < 5, at


def test_contours_lie_where_heights_are_multiples(bench) -> None:
    """A plane that rises by 100 m in a kilometre: lines every 20 m are 200 m apart."""
    col = np.mgrid[:512, :512][1]
    heights = (col * 2.0).astype(np.float32)
    terrain = make(heights)
    x, y = (float(v) for v in terrain.grid.xy(256, 256))
    view = View((x, y, 5000.0), (x, y, 512.0), up=(0, 1, 0), projection="plan", fov_y=40, width=SIZE[0], height=SIZE[1])
    b = bench(terrain)
    scene = Scene.of(terrain, view, tolerance=1.0, shadows=False, water=None, colormap="grey")
    b.draw(scene, wait=True, samples=1)
    plain = b.pixels().sum(-1)
    b.draw(scene.but(contours=Contours(20.0, 1000, labels=False)), wait=True, samples=1)
    darker = (plain - b.pixels().sum(-1)).mean(0)
    px = np.arange(SIZE[0]) + 0.5
    east = x + (px - SIZE[0] / 2) * view.pixel_metres
    height = (east - float(terrain.grid.xy(0, 0)[0])) / 20.0 * 2.0
    away = np.abs(height - 20 * np.round(height / 20)) * 10 / view.pixel_metres
    inside = (height > 20) & (height < 1000)
    assert darker[inside & (away < 0.3)].min() > 40
    assert darker[inside & (away > 1.7)].max() < 8
