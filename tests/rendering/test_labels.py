"""Labels of index contours: on their lines, upright, apart, seen; still while the camera moves; the same in tiles."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.memo import Memo
from orograph.rendering.cpu.draw import draw
from orograph.rendering.lines.label_spots import POINTS, coarsest, read, spots
from orograph.rendering.lines.label_type import Labels, Lettering, measured
from orograph.rendering.lines.labels import Placer
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

METRES = 20.0
EAST, NORTH = 500_000.0, 5_000_000.0


def height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Hills, x east of the corner, y south of it."""
    return 500 + 300 * np.sin(x / 1900) * np.cos(y / 1700) + 60 * np.sin(x / 670 + y / 830)


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    y, x = np.mgrid[:601, :620] * METRES
    grid = Grid(y.shape, Affine(METRES, 0, EAST, 0, -METRES, NORTH), CRS.from_epsg(32632))
    return in_memory(Dem(height(x, y).astype(np.float32), grid))


def scenes(terrain: Terrain) -> dict[str, Scene]:
    middle = (EAST + 6200.0, NORTH - 6000.0, 500.0)
    views = {
        "slanted": View((EAST + 6000.0, NORTH - 15_000.0, 5000.0), middle, width=640, height=400),
        "plan": View((middle[0], middle[1], 12_000.0), middle, projection="plan", width=640, height=400),
        "near": View((EAST + 6000.0, NORTH - 9500.0, 1100.0), middle, width=640, height=400),
    }
    return {k: Scene.of(terrain, v, contours=Contours(20.0), samples=1) for k, v in views.items()}


def labelled(scene: Scene, placer: Placer | None = None) -> tuple[Labels, Contours]:
    assert scene.annotations.contours is not None
    contours = scene.annotations.contours.fitted(scene.terrain, scene.view, Memo())
    return (placer or Placer(scene.terrain)).place(scene, contours), contours


@pytest.mark.parametrize("name", ["slanted", "plan", "near"])
def test_labels_lie_on_their_lines_upright_apart_and_inside(terrain: Terrain, name: str) -> None:
    scene = scenes(terrain)[name]
    labels, contours = labelled(scene)
    assert len(labels) >= 4
    set_ = Lettering.of(labels, scene.view, 1.0, contours.type_size)
    assert len(set_.words) == len(labels) and (labels.opacity == 1).all()
    widths, tall = measured(labels.heights, contours.type_size)
    # The formula's height at the middle of each label, where its ground is, is the label's: within a pixel or two.
    middle = labels.lines[:, POINTS // 2]
    step = 1.0
    x, y = middle[:, 0] - EAST - METRES / 2, NORTH - middle[:, 1] - METRES / 2
    slope = np.hypot(*((height(x + a, y + b) - height(x - a, y - b)) / (2 * step) for a, b in ((step, 0), (0, step))))
    off = np.abs(height(x, y) - labels.heights) / slope
    depth = scene.view.project(middle)[1]
    pixel = scene.view.pixel_metres if name == "plan" else scene.view.pixel_slope * depth
    assert (off < 1.5 * pixel).all(), (off / pixel).max()
    assert (labels.heights % 100 == 0).all() and [float(w) for w in set_.words] == labels.heights.tolist()
    angle = set_.places[:, 2]
    assert ((angle > -math.pi / 2 - 1e-9) & (angle <= math.pi / 2)).all()
    # Turned along the line: the projected line's direction, whichever way it runs.
    ends = scene.view.project(labels.lines[:, [POINTS // 2 - 1, POINTS // 2 + 1]])[0]
    along = np.arctan2(*(ends[:, 1] - ends[:, 0]).T[::-1])
    turn = np.abs((along - angle + math.pi / 2) % math.pi - math.pi / 2)
    assert turn.max() < math.radians(25)
    reach = np.abs(np.cos(angle)) * widths / 2, np.abs(np.sin(angle)) * widths / 2
    for k, size in enumerate((640, 400)):
        assert (set_.places[:, k] - reach[k] > 0).all() and (set_.places[:, k] + reach[k] < size).all()
    for i, j in combinations(range(len(labels)), 2):
        away = np.linalg.norm(set_.places[i, :2] - set_.places[j, :2])
        assert away > (widths[i] + widths[j]) / 2 + tall
        assert labels.heights[i] != labels.heights[j] or away > 200


def test_heads_point_uphill_where_there_is_a_choice(terrain: Terrain) -> None:
    scene = scenes(terrain)["slanted"]
    labels, contours = labelled(scene)
    set_ = Lettering.of(labels, scene.view, 1.0, contours.type_size)
    middle = labels.lines[:, POINTS // 2]
    x, y = middle[:, 0] - EAST, NORTH - middle[:, 1]
    up = np.stack([height(x + 1, y) - height(x - 1, y), height(x, y - 1) - height(x, y + 1)], -1)
    there = scene.view.project(middle + np.pad(50 * up / np.linalg.norm(up, axis=1)[:, None], ((0, 0), (0, 1))))[0]
    here = scene.view.project(middle)[0]
    head = np.stack([np.sin(set_.places[:, 2]), -np.cos(set_.places[:, 2])], -1)
    assert (((there - here) * head).sum(-1) > 0).mean() > 0.6


def test_hidden_ground_has_no_labels() -> None:
    """Behind a high wall a slope has lines, and none of its labels is shown; from above all are."""
    y = np.mgrid[:401, :401][0] * METRES
    z = 0.1 * (8000 - y) + np.where(np.abs(y - 5000) < 60, 1500.0, 0.0)
    grid = Grid(y.shape, Affine(METRES, 0, EAST, 0, -METRES, NORTH), CRS.from_epsg(32632))
    terrain = in_memory(Dem(z.astype(np.float32), grid))
    target = (EAST + 4000.0, NORTH - 3000.0, 300.0)
    low = View((EAST + 4000.0, NORTH - 14_000.0, 1200.0), target, width=640, height=400)
    high = replace(low, eye=(EAST + 4000.0, NORTH - 7000.0, 12_000.0))
    rows = []
    for view in (low, high):
        labels, _ = labelled(Scene.of(terrain, view, contours=Contours(20.0)))
        rows.append(NORTH - labels.lines[:, POINTS // 2, 1])
    assert not (rows[0] < 4800).any() and (rows[1] < 4800).any()


def test_spots_do_not_depend_on_the_view_and_are_straight(terrain: Terrain) -> None:
    one, two = spots(terrain, 1, 2, 2, 100.0), spots(terrain, 1, 2, 2, 100.0)
    assert len(one) and np.array_equal(one.lines, two.lines)
    col, row = terrain.grid.index(one.lines[:, POINTS // 2, 0], one.lines[:, POINTS // 2, 1])
    assert ((col / 2 > 126) & (col / 2 < 194) & (row / 2 > 126) & (row / 2 < 194)).all()


def test_fading_is_continuous_and_labels_stay_where_they_are(terrain: Terrain) -> None:
    """Along a slow flight the opacity of no label jumps, and each label's place in the terrain never moves."""
    scene = scenes(terrain)["slanted"].but(contours=Contours(20.0, fading=True))
    placer, before, jumps, memo = Placer(terrain), {}, [], 0
    for k in range(40):
        eye = (scene.view.eye[0] + 12.0 * k, scene.view.eye[1] + 20.0 * k, scene.view.eye[2] - 6.0 * k)
        labels, _ = labelled(scene.but(view=replace(scene.view, eye=eye)), placer)
        now = {tuple(line): o for line, o in zip(labels.lines[:, POINTS // 2].tolist(), labels.opacity, strict=True)}
        if before:
            jumps += [abs(now.get(at, 0.0) - before.get(at, 0.0)) for at in {*now, *before}]
            memo += sum(at in now for at in before)
        before = now
    assert max(jumps) < 0.75 and np.mean(np.array(jumps) > 0.35) < 0.02, sorted(jumps)[-5:]
    assert memo > 150


@pytest.mark.stress
def test_a_tile_has_the_labels_of_its_picture(terrain: Terrain) -> None:
    scene = scenes(terrain)["slanted"]
    whole = draw(scene).pixels
    tile = draw(scene.but(view=scene.view.tile(192, 96, 256, 192))).pixels
    assert np.array_equal(tile, whole[96:288, 192:448])


def test_odd_terrain_is_no_trouble() -> None:
    """A plain, a hole, two rows, contours of a kilometre: no labels, no fault."""
    for z in (np.zeros((80, 80)), np.full((2, 70), 3.0), np.where(np.indices((90, 90))[1] > 40, np.nan, 7.0)):
        grid = Grid(z.shape, Affine(METRES, 0, EAST, 0, -METRES, NORTH), CRS.from_epsg(32632))
        terrain = in_memory(Dem(z.astype(np.float32), grid))
        view = View((EAST + 300, NORTH - 2000, 900.0), (EAST + 300, NORTH - 10, 0.0), width=200, height=160)
        for interval in (None, 0.5, 1000.0):
            labels, _ = labelled(Scene.of(terrain, view, contours=Contours(interval)))
            assert len(labels) == 0


def test_small_rasters_seen_small_have_labels_too() -> None:
    """Where pixels are larger than samples of the coarsest level: every second, fourth… of those."""
    y, x = np.mgrid[:240, :250] * METRES
    grid = Grid(y.shape, Affine(METRES, 0, EAST, 0, -METRES, NORTH), CRS.from_epsg(32632))
    small = in_memory(Dem(height(x, y).astype(np.float32), grid))
    assert small.levels == 1 and coarsest(small) >= 3
    assert np.array_equal(read(small, 2, 3, 9, 5, 8), small.read(0, 12, 36, 20, 32)[::4, ::4])
    middle = (EAST + 2500.0, NORTH - 2400.0, 500.0)
    view = View((middle[0], middle[1], 8500.0), middle, projection="plan", width=220, height=200)
    assert len(labelled(Scene.of(small, view, contours=Contours(20.0)))[0]) >= 2


def zoomed(terrain: Terrain, pixels: float) -> Scene:
    """A plan in which a sample is so many pixels large, index contours some hundred pixels apart."""
    x, y = EAST + 5150.0, NORTH - 4800.0
    away = METRES / pixels * 400 / (2 * math.tan(math.radians(20.0)))
    view = View((x, y, 1000.0 + away), (x, y, 1000.0), projection="plan", fov_y=40, width=640, height=400)
    interval = 60.0 / pixels
    return Scene.of(terrain, view, contours=Contours(interval), samples=1)


@pytest.mark.parametrize("pixels", [5.0, 50.0, 300.0])
def test_lines_have_as_many_labels_however_near_one_comes(terrain: Terrain, pixels: float) -> None:
    """Far beyond a sample, too: labels stand as densely, on the surface between samples."""
    scene = zoomed(terrain, pixels)
    assert METRES / scene.view.pixel_metres == pytest.approx(pixels)
    labels, _ = labelled(scene)
    assert 6 <= len(labels) <= 40, len(labels)
    middle = labels.lines[:, POINTS // 2]
    # Each on the surface that is drawn, within a pixel: heights across there change by so much from pixel to pixel.
    shown = draw(scene.but(contours=None, tolerance=0.0, light="none"))
    px = scene.view.project(middle)[0]
    j, i = np.clip(np.floor(px).astype(int), 2, [637, 397]).T
    ground = scene.view.eye[2] - shown.depth.astype(np.float64)
    rate = np.hypot(ground[i, j + 1] - ground[i, j - 1], ground[i + 1, j] - ground[i - 1, j]) / 2
    assert (np.abs(ground[i, j] - labels.heights) < 1.5 * rate + 1e-3).all()


def test_labels_come_by_degrees_as_one_zooms_in_beyond_samples(terrain: Terrain) -> None:
    """An eighth of a percent a frame, while spots of one level take the place of another's."""
    placer, before = Placer(terrain), {}
    jumps = []
    for pixels in np.geomspace(20.5, 25.0, 166):
        scene = zoomed(terrain, float(pixels)).but(contours=Contours(2.5, fading=True))
        labels, _ = labelled(scene, placer)
        found = zip(labels.lines[:, POINTS // 2].round(3).tolist(), labels.opacity, strict=True)
        now = {tuple(at): o for at, o in found}
        jumps += [abs(before.get(at, 0.0) - now.get(at, 0.0)) for at in ({*now, *before} if before else ())]
        before = now
    assert len(before) >= 4 and len(jumps) > 800
    assert max(jumps) < 0.75 and np.mean(np.array(jumps) > 0.35) < 0.02, sorted(jumps)[-5:]


def test_where_water_is_drawn_the_edge_of_the_sea_is_no_contour() -> None:
    """Corners of a coast, where the shore is smoother than the samples, would have bits of the line of 0 m."""
    y, x = np.mgrid[:40, :44]
    z = np.where((abs(x - 20) < 8) & (abs(y - 18) < 7) & (x + y < 40), 60.0, 0.0)
    z[15:18, 15:18] = -9.0  # a hollow, whose line of 0 m is one
    grid = Grid(z.shape, Affine(METRES, 0, EAST, 0, -METRES, NORTH), CRS.from_epsg(32632))
    land = in_memory(Dem(z.astype(np.float32), grid))
    middle = EAST + 20 * METRES, NORTH - 18 * METRES, 0.0
    view = View((*middle[:2], 900.0), middle, projection="plan", width=400, height=320)
    dry = Scene.of(land, view, contours=Contours(100.0), samples=1, water=None, light="none")
    inked = []
    for scene in (dry, dry.but(water="auto")):
        picture, bare = draw(scene), draw(scene.but(contours=None))
        inked.append((picture.pixels != bare.pixels).any(-1))
        assert (picture.facts["shader"]["contours"]["labels"] > 0) == (scene is dry)
    hollow = np.zeros_like(inked[0])
    rows, cols = np.nonzero(inked[1])
    col, row = land.grid.index(*picture.grid.xy(cols, rows))
    hollow[rows, cols] = (abs(col - 16) < 2.5) & (abs(row - 16) < 2.5)
    assert 50 < hollow.sum() == inked[1].sum() < 0.3 * inked[0].sum()
