"""What rays meet between samples: bilinear or constant heights, where that keeps the tolerance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from test_surface_rays import GROUNDS, SETS, SIZE, Both, over, rough, views

from orograph.errors import UsageError
from orograph.gpu.device import Device
from orograph.lod.method import Resources
from orograph.lod.raycast import RayCast, RayCastOptions
from orograph.rendering.projection import Projection
from orograph.scene.methods import mesh_choice
from orograph.store.prepare import prepare
from orograph.store.terrain import Terrain
from orograph.verify.depth import judge_depth
from orograph.viewpoint import Camera, View

OTHERS = ("bilinear", "constant")


def casting(device: Device, terrain: Terrain, surface: str) -> Both:
    found = Both(device, terrain)
    found.method = RayCast(terrain, RayCastOptions(surface=surface), Resources())
    return found


def judge(device: Device, terrain: Terrain, surface: str, count: int, seed: int) -> None:
    """The referee's verdict on so many views; and that it is another surface than the exact one."""
    own, exact, other = casting(device, terrain, surface), casting(device, terrain, "exact"), 0
    for name, view, tolerance, exaggeration in views(terrain, count, seed):
        windows = own.selected(view, tolerance, exaggeration)
        assert windows.surface == surface and windows.bound == pytest.approx(tolerance)
        depth = own.on_gpu(view, windows, exaggeration)
        report = judge_depth(depth, terrain, view, exaggeration=exaggeration)
        assert report.largest <= tolerance, (name, view, tolerance, exaggeration, report)
        true = exact.on_gpu(view, exact.selected(view, tolerance, exaggeration), exaggeration)
        usual = judge_depth(true, terrain, view, exaggeration=exaggeration)
        assert report.farthest <= max(usual.farthest, tolerance, 1.5), (name, view, report, usual)
        both = np.isfinite(depth) & np.isfinite(true)
        other += int((np.abs(depth - true)[both] > 1e-5 * true[both]).sum())
    assert other > 1000


@pytest.mark.cases(1)
@pytest.mark.parametrize("surface", OTHERS)
@pytest.mark.parametrize("name", ["holes", "oblong cells, rows northwards", "nested windows"])
def test_the_promise_is_kept(device: Device, name: str, surface: str) -> None:
    judge(device, GROUNDS[name](), surface, 8, seed=7)


@pytest.mark.stress
@pytest.mark.parametrize("surface", OTHERS)
@pytest.mark.parametrize("name", SETS)
def test_the_promise_is_kept_on_real_ground(device: Device, shared_data: Path, name: str, surface: str) -> None:
    judge(device, prepare([str(shared_data / SETS[name])]), surface, 32, seed=8)


def places(device: Device, terrain: Terrain, view: View, surface: str, tolerance: float) -> NDArray[np.float64]:
    """Column, row and height of what is hit, by pixel."""
    both = casting(device, terrain, surface)
    depth = both.on_gpu(view, both.selected(view, tolerance))
    y, x = np.nonzero(np.isfinite(depth))
    return Projection.of(Camera.over(terrain.grid, view)).place(x + 0.5, y + 0.5, depth[y, x].astype(np.float64))


def test_bilinear_cells_are_bilinear(device: Device) -> None:
    """Saddles, steep enough that both triangles are elsewhere; with a tolerance that allows all."""
    z = rough(9, 11, 60.0)
    terrain = over(z, Affine(10.0, 0, 7e5, 0, -12.0, 5.3e6))
    x, y = (float(v) for v in terrain.grid.xy(5.0, 4.0))
    view = View((x - 30.0, y - 160.0, 130.0), (x, y, 30.0), width=SIZE[0], height=SIZE[1])
    col, row, height = places(device, terrain, view, "bilinear", 500.0).T
    j, i = np.minimum(col.astype(int), 9), np.minimum(row.astype(int), 7)
    u, v, zz = col - j, row - i, z.astype(np.float64)
    a, b, c, d = zz[i, j], zz[i, j + 1], zz[i + 1, j], zz[i + 1, j + 1]
    true = a + u * (b - a) + v * (c - a) + u * v * (a - b - c + d)
    assert len(col) > 3000 and np.abs(a - b - c + d).max() > 15
    inside = (u > 1e-3) & (u < 1 - 1e-3) & (v > 1e-3) & (v < 1 - 1e-3)
    np.testing.assert_allclose(height[inside], true[inside], atol=2e-3)


def test_constant_cells_are_steps_of_the_middle_height(device: Device) -> None:
    """Upon a step the height is the middle one of the cell, or of a square of 4 × 4 and more; else it is at a wall."""
    z = rough(65, 65, 80.0)
    terrain = over(z, Affine(10.0, 0, 7e5, 0, -10.0, 5.3e6))
    x, y = (float(v) for v in terrain.grid.xy(32.0, 32.0))
    view = View((x - 100.0, y - 700.0, 500.0), (x, y, 30.0), width=SIZE[0], height=SIZE[1])
    for tolerance, levels in ((6.0, (0, 2, 3, 4, 5, 6)), (500.0, (2, 3, 4, 5, 6))):  # (pairs have no minima)
        col, row, height = places(device, terrain, view, "constant", tolerance).T
        upon = np.zeros(len(col), bool)
        for level in levels:
            side = 1 << level
            tops = np.array([[
                np.ptp(part := z[i : i + side + 1, j : j + side + 1]) / 2 + part.min() for j in range(0, 64, side)
            ] for i in range(0, 64, side)])  # fmt: skip
            at = tops[np.minimum(row.astype(int), 63) >> level, np.minimum(col.astype(int), 63) >> level]
            upon |= np.abs(height - at) < 5e-3
        walls = np.minimum(np.abs(col - np.rint(col)), np.abs(row - np.rint(row))) < 1e-3
        assert len(col) > 5000 and (upon | walls).all() and upon.mean() > 0.2, (tolerance, upon.mean(), walls.mean())


def test_steep_ground_nearby_is_exact(device: Device) -> None:
    """Where a cell is many pixels high, what is asked for would break the promise."""
    terrain = over(rough(65, 65, 800.0), Affine(10.0, 0, 7e5, 0, -10.0, 5.3e6))
    x, y = (float(v) for v in terrain.grid.xy(32.0, 32.0))
    view = View((x - 50.0, y - 300.0, 1000.0), (x, y, 400.0), width=SIZE[0], height=SIZE[1])
    depths = []
    for surface in ("exact", "constant"):
        both = casting(device, terrain, surface)
        depths.append(both.on_gpu(view, both.selected(view, 0.02)))
    np.testing.assert_array_equal(*depths)
    assert np.isfinite(depths[0]).mean() > 0.5


def test_plans_are_exact(device: Device) -> None:
    terrain = over(rough(65, 65, 80.0), Affine(10.0, 0, 7e5, 0, -10.0, 5.3e6))
    x, y = (float(v) for v in terrain.grid.xy(32.0, 32.0))
    view = View((x, y, 900.0), (x, y, 0.0), projection="plan", width=SIZE[0], height=SIZE[1])
    depths = []
    for surface in ("exact", *OTHERS):
        both = casting(device, terrain, surface)
        depths.append(both.on_gpu(view, both.selected(view, 2.0)))
    for depth in depths[1:]:
        np.testing.assert_array_equal(depth, depths[0])
    assert np.isfinite(depths[0]).mean() > 0.5


def test_the_cpu_draws_the_exact_surface_only() -> None:
    assert mesh_choice("raycast", "cpu") is None and mesh_choice("raycast,surface=exact", "cpu") is None
    with pytest.raises(UsageError, match=r"raycast,surface=constant cannot.*exact surface"):
        mesh_choice("raycast,surface=constant", "cpu")
    with pytest.raises(UsageError, match="surface"):
        RayCastOptions(surface="smooth")
