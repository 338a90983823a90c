"""Windows for a view: nested, and as fine as the tolerance asks, judged by every full-resolution sample in view."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from affine import Affine

from orograph.geo.grid import Grid
from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.raycast.caster import Caster
from orograph.raycast.select import distances, in_frustum, load, moved, rectangles, tile_boxes
from orograph.store.memory import MemoryTerrain
from orograph.store.prepare import prepare
from orograph.store.terrain import TILE, Terrain
from orograph.viewpoint import View

ROWS, COLS, SPACING = 1100, 1500, 10.0


@pytest.fixture(scope="module")
def terrain() -> MemoryTerrain:
    """Rough fractal ground, four levels."""
    rng = np.random.default_rng(7)
    k = np.hypot(np.fft.fftfreq(ROWS)[:, None], np.fft.rfftfreq(COLS)[None])
    k[0, 0] = 1
    z = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(ROWS, COLS))) / k**1.7, s=(ROWS, COLS))
    z = (z - z.min()) / np.ptp(z) * 1500
    grid = Grid((ROWS, COLS), Affine(SPACING, 0, 500000, 0, -SPACING, 4500000))
    return MemoryTerrain(z.astype(np.float32), grid, "rough")


VIEWS = {
    "oblique": ((5000, -16000, 9000), (7500, 5500, 500), 30),
    "close": ((3000, 2500, 2200), (9000, 8000, 300), 60),
    "low and wide": ((6000, 3000, 1300), (14000, 9000, 900), 100),
    "straight down": ((7000, 5000, 9000), (7000, 5001, 0), 40),
    "a corner": ((-2000, -1500, 3000), (500, 500, 400), 35),
}


def view_of(name: str, terrain: MemoryTerrain, **more: object) -> View:
    eye, target, fov = VIEWS[name]
    west, south = 500000, 4500000 - ROWS * SPACING
    move = np.array([west, south, 0])
    return View(tuple(move + eye), tuple(move + target), fov_y=fov, width=640, height=360, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("tolerance, exaggeration", [(1.0, 1.0), (8.0, 2.0)])
def test_the_tolerance_is_kept(terrain: MemoryTerrain, name: str, tolerance: float, exaggeration: float) -> None:
    view = view_of(name, terrain)
    found = rectangles(terrain, view, exaggeration, tolerance)
    for outer, inner in pairwise(found):
        assert inner.level < outer.level
        scale = 2 ** (outer.level - inner.level)
        assert inner.row0 >= outer.row0 * scale and inner.col0 >= outer.col0 * scale
        assert inner.row1 - 1 <= (outer.row1 - 1) * scale and inner.col1 - 1 <= (outer.col1 - 1) * scale
    stack = Caster(load(terrain, found), (ROWS, COLS), 2)
    row, col = np.mgrid[0:ROWS:3, 0:COLS:3]
    col, row = col.ravel().astype(float), row.ravel().astype(float)
    x, y = terrain.grid.xy(col, row)
    true = terrain.heights[row.astype(int), col.astype(int)].astype(float)
    t, _ = stack.cast(np.column_stack([col, row, np.full(len(col), 5000.0)]), np.tile([0.0, 0.0, -1.0], (len(col), 1)))
    drawn = 5000.0 - t
    assert np.isfinite(drawn).all()
    at, depth = view.project(np.column_stack([x, y, true]), exaggeration)
    moved, _ = view.project(np.column_stack([x, y, drawn]), exaggeration)
    seen = (depth > 0) & (at >= 0).all(1) & (at[:, 0] <= view.width) & (at[:, 1] <= view.height)
    assert seen.sum() > 1000
    off = np.hypot(*(at - moved)[seen].T)
    assert np.nanmax(off) <= tolerance * (1 + 1e-6)
    if tolerance == 8.0 and name == "oblique":
        assert len(found) >= 1 and found[-1].level > 0  # coarse windows were used, so the test could have failed
        assert np.nanmax(off) > 0.05


def test_finer_tolerance_never_takes_coarser_windows(terrain: MemoryTerrain) -> None:
    for name in VIEWS:
        view = view_of(name, terrain)
        finest = [rectangles(terrain, view, 1.0, tolerance)[-1].level for tolerance in (0.1, 1.0, 10.0, 1000.0)]
        assert finest == sorted(finest)


def test_the_picture_by_windows_is_the_picture(terrain: MemoryTerrain) -> None:
    """Depths by the windows chosen for a fine tolerance against the full resolution's: the same but at silhouettes."""
    view = view_of("close", terrain)
    o0, _, _, d0, du, dv = view.ray_basis()
    col, row = terrain.grid.index(o0[0], o0[1])
    linear = np.array([1 / SPACING, -1 / SPACING, 1.0])
    eye = np.array([float(col), float(row), o0[2]])
    start = (d0 + 0.5 * du + 0.5 * dv) * linear
    full, _ = Caster.of(terrain.heights, 1).cast_pinhole(eye, start, du * linear, dv * linear, (360, 640))
    found = rectangles(terrain, view, 1.0, 0.5)
    results = []
    for jobs in (1, 2):
        stack = Caster(load(terrain, found), (ROWS, COLS), jobs)
        results.append(stack.cast_pinhole(eye, start, du * linear, dv * linear, (360, 640)))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])
    t = results[0][0]
    assert (np.isfinite(t) == np.isfinite(full)).mean() > 0.997
    both = np.isfinite(t) & np.isfinite(full)
    assert (np.abs(t - full)[both] < 0.01 * full[both]).mean() > 0.98


def plain_rectangles(terrain: Terrain, view: View, exaggeration: float, tolerance: float, by: str) -> ClipStack:
    """What ``rectangles`` finds, level by level in NumPy."""
    found = [Rectangle.whole(terrain.levels - 1, terrain.shape(terrain.levels - 1))]
    for level in range(terrain.levels - 1, 0, -1):
        table, boxes = terrain.tiles(level), tile_boxes(terrain, level)
        spacing = max(terrain.grid.spacing) * 2.0**level
        if view.projection == "plan":
            size = np.full(boxes.low.shape, spacing / view.pixel_metres)
            rim = size
        else:
            far = np.maximum(distances(terrain, view, exaggeration, boxes), max(view.near, 1e-9))
            size = spacing / view.pixel_slope / far
            rim = size * 0.5
        off = size
        if by == "error":
            error = moved(terrain, view, exaggeration, table.error.astype(np.float64), boxes)
            off = np.maximum(error, np.where(table.valid == 1, rim, 0.0))
        need, outer = np.zeros(off.shape, bool), found[-1]
        part = tuple(
            slice(first // TILE, -(-(end - 1) // TILE))
            for first, end in ((outer.row0, outer.row1), (outer.col0, outer.col1))
        )
        need[part] = (in_frustum(terrain, view, exaggeration, boxes) & (off > tolerance))[part]
        if not need.any():
            break
        rows, cols = np.flatnonzero(need.any(1)), np.flatnonzero(need.any(0))
        sides = [2 * TILE * int(n) for n in (rows[0], rows[-1] + 1, cols[0], cols[-1] + 1)]
        found.append(Rectangle(level - 1, sides[0], sides[1] + 1, sides[2], sides[3] + 1).cut(terrain.shape(level - 1)))
    return ClipStack(found).visible(terrain.shape)


def one_row() -> Terrain:
    heights = np.random.default_rng(1).normal(size=(1, 6000)).cumsum(1).astype(np.float32)
    return MemoryTerrain(heights, Grid((1, 6000), Affine(10, 0, 5e5, 0, -10, 4e6)), "row")


def turned() -> Terrain:
    rng = np.random.default_rng(2)
    heights = rng.normal(size=(700, 1900)).cumsum(0).cumsum(1).astype(np.float32)
    heights[200:320, 500:1300] = np.nan
    transform = Affine.translation(5e5, 4e6) @ Affine.rotation(25) @ Affine.scale(40, -10)
    return MemoryTerrain(heights, Grid(heights.shape, transform), "turned, with a hole")


GROUNDS = {
    "oblong": "bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif",
    "voids": "osgearth-srtm90m-volcano-voids/mt_everest_90m.tif",
    "one row": one_row,
    "turned": turned,
}


@pytest.mark.parametrize("name", GROUNDS)
def test_windows_are_those_found_in_numpy(name: str, shared_data: Path) -> None:
    given = GROUNDS[name]
    terrain = prepare([shared_data / given]) if isinstance(given, str) else given()
    rng, (rows, cols) = np.random.default_rng(5), terrain.grid.shape
    low, high = terrain.height_range
    many = 0
    for k in range(120):
        (x, u), (y, v) = terrain.grid.xy(rng.uniform(-0.2, 1.2, 2) * cols, rng.uniform(-0.2, 1.2, 2) * rows)
        above = float(rng.uniform(low, high)) + (high - low) * float(rng.exponential())
        view = View(
            (float(x), float(y), above), (float(u), float(v), low), fov_y=float(rng.uniform(5, 100)),
            width=int(rng.integers(1, 2000)), height=int(rng.integers(1, 1200)), near=float(rng.choice([0.0, 700.0])),
            far=float(rng.choice([np.inf, 2e4])), projection="plan" if k % 6 == 0 else "perspective",
        )  # fmt: skip
        what = float(rng.choice([1.0, 3.0])), float(10 ** rng.uniform(-1.5, 1.5)), "spacing" if k % 3 == 0 else "error"
        found = rectangles(terrain, view, what[0], what[1], by=what[2])
        assert found == plain_rectangles(terrain, view, *what)
        many += found[-1].level < terrain.levels - 1
    assert (many > 12) == (rows > 1)  # (one row has no surface)
