"""Windows for a view: nested, and as fine as the tolerance asks, judged by every full-resolution sample in view."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from affine import Affine

from orograph.geo.grid import Grid
from orograph.raycast.caster import Caster
from orograph.raycast.select import load, rectangles
from orograph.store.memory import MemoryTerrain
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
