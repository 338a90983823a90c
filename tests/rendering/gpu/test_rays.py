"""Rays against the terrain on the GPU: truth by Embree, the caster's nested windows, holes, and a shader's hash."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.hierarchy.clip_stack import Rectangle
from orograph.raycast.caster import Caster
from orograph.raycast.stack import HeightWindow
from orograph.rendering.gpu.shade.ray_field import MARGIN, RayField, blocked, choose, field_of, turned
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View


def rough(rows: int, cols: int, relief: float = 900.0, seed: int = 3) -> np.ndarray:
    """Ground with detail at all scales."""
    rng = np.random.default_rng(seed)
    n = max(rows, cols)
    k = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None])
    k[0, 0] = np.inf
    z = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(n, n))) / k**1.7, s=(n, n))[:rows, :cols]
    return ((z - z.min()) / np.ptp(z) * relief).astype(np.float32)


def ways(n: int, seed: int = 1) -> np.ndarray:
    """Directions all around, most of them not far from level."""
    w = np.random.default_rng(seed).normal(size=(n, 3)) * [1, 1, 0.4]
    return w / np.linalg.norm(w, axis=1, keepdims=True)


def on_ground(caster: Caster, n: int, rows: int, cols: int, above: float) -> np.ndarray:
    """Places anywhere on the ground, ``above`` metres over it."""
    rng = np.random.default_rng(2)
    at = np.column_stack([rng.uniform(0, cols - 1, n), rng.uniform(0, rows - 1, n), np.full(n, 1e5)])
    t, _ = caster.cast(at, np.tile([0.0, 0.0, -1.0], (n, 1)))
    at[:, 2] -= t - above
    return at[np.isfinite(t)]


@pytest.mark.parametrize("linear", [np.diag([30.0, -30.0]), np.array([[18.0, 24.0], [24.0, -18.0]])])
def test_visibility_is_embrees(device: Device, linear: np.ndarray) -> None:
    """The same triangles in another's ray tracer: no ray of 20,000 is answered otherwise."""
    embree = pytest.importorskip("embreex.rtcore_scene", reason="embreex is not installed")
    from embreex.mesh_construction import TriangleMesh

    h = rough(97, 133)
    rows, cols = h.shape
    row, col = np.mgrid[:rows, :cols]
    xy = np.stack([col, row], -1) @ linear.T
    k = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = (v.ravel() for v in (k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]))
    even = ((row + col)[:-1, :-1] % 2 == 0).ravel()[:, None]
    first = np.where(even, np.stack([a, b, d], 1), np.stack([a, b, c], 1))
    second = np.where(even, np.stack([a, d, c], 1), np.stack([b, d, c], 1))
    scene = embree.EmbreeScene()
    mesh = TriangleMesh(
        scene, np.concatenate([xy, h[..., None]], -1).reshape(-1, 3).astype(np.float32),
        np.concatenate([first, second]).astype(np.int32),
    )  # fmt: skip
    at = on_ground(Caster.of(h), 20_000, rows, cols, 0.1)
    way = ways(len(at))
    origin = np.column_stack([at[:, :2] @ linear.T, at[:, 2]]).astype(np.float32)
    truth = scene.run(origin, way.astype(np.float32), query="OCCLUDED") != -1
    got = blocked(RayField.of([HeightWindow(0, 0, 0, h)], h.shape, linear), at, way, device=device)
    assert mesh is not None and 0.3 < truth.mean() < 0.9
    assert (got != truth).mean() <= 1e-4  # a ray through an edge may be told otherwise by either


@pytest.mark.parametrize("shape", [(2, 2), (2, 40), (33, 3), (65, 64)])
def test_small_and_narrow_rasters(device: Device, shape: tuple[int, int]) -> None:
    h = rough(*shape, relief=60.0)
    caster = Caster.of(h)
    at = on_ground(caster, 2000, *shape, 0.05)
    way = ways(len(at))
    got = blocked(RayField.of([HeightWindow(0, 0, 0, h)], shape, np.diag([10.0, -10.0])), at, way, device=device)
    t, _ = caster.cast(at, way * [0.1, -0.1, 1.0])
    assert (got != np.isfinite(t)).sum() <= 2


def test_nested_windows_are_the_casters(device: Device) -> None:
    """Three windows: what stands in the way is what the caster meets in the same ones, exaggerated or not."""
    h = rough(257, 257)
    windows = [
        HeightWindow(2, 0, 0, h[::4, ::4].copy()), HeightWindow(1, 30, 40, h[80:201:2, 60:181:2].copy()),
        HeightWindow(0, 100, 120, h[120:161, 100:141].copy()),
    ]  # fmt: skip
    caster = Caster(windows, h.shape)
    at = on_ground(caster, 20_000, 257, 257, 0.05)
    way = ways(len(at))
    for x in (1.0, 2.5):
        field = RayField.of(windows, h.shape, np.diag([30.0, -30.0]), x)
        got = blocked(field, at, way, device=device)
        t, _ = caster.cast(at, way * [1 / 30, -1 / 30, 1 / x])
        # A ray that comes into a window under its ground is stopped there; the caster lets it out within the cell.
        assert (got != np.isfinite(t)).mean() < 1e-3 and not (~got & np.isfinite(t)).any()
    near = blocked(field, at, way, far=100.0, device=device)
    assert (near != (t <= 100.0)).mean() < 1e-3 and near.mean() < 0.8 * got.mean()
    later = blocked(field, at, [0.0, 0.0, 1.0] + 0 * at, device=device)
    assert not later.any()


def test_holes_stand_in_nobodys_way(device: Device) -> None:
    h = np.zeros((40, 60), np.float32)
    h[:, 30:34] = 200.0
    at = np.column_stack([np.full(40, 5.0), np.arange(40.0), np.full(40, 1.0)])
    way = np.tile([math.cos(0.1), 0.0, math.sin(0.1)], (40, 1))
    lin = np.diag([10.0, -10.0])
    assert blocked(RayField.of([HeightWindow(0, 0, 0, h)], h.shape, lin), at, way, device=device).all()
    h[10:20] = np.nan
    got = blocked(RayField.of([HeightWindow(0, 0, 0, h)], h.shape, lin), at, way, device=device)
    assert got[:9].all() and got[20:].all() and not got[10:19].any()  # row 9 is the hole's rim
    gone = np.full((9, 9), np.nan, np.float32)
    assert not blocked(
        RayField.of([HeightWindow(0, 0, 0, gone)], gone.shape, lin), [[4, 4, 0]], [[1, 0, 0]], device=device
    ).any()


def test_far_from_the_rasters_corner_no_digit_is_lost(device: Device) -> None:
    """A window of 1 m samples in a raster of 65,537²: the same answers as at the corner."""
    h = rough(129, 129, relief=60.0)
    coarse = np.zeros((257, 257), np.float32)
    far = 65_536 - 256
    at = on_ground(Caster.of(h), 5000, 129, 129, 0.02)
    way = ways(len(at))
    way[:, 2] = np.abs(way[:, 2])
    here = blocked(RayField.of([HeightWindow(0, 0, 0, h)], h.shape, np.diag([1.0, -1.0])), at, way, device=device)
    field = RayField.of(
        [HeightWindow(8, 0, 0, coarse), HeightWindow(0, far, far, h)], (65_537, 65_537), np.diag([1.0, -1.0])
    )
    there = blocked(field, at + np.array([far, far, 0.0]), way, far=150.0, device=device)
    assert (here != there).mean() < 2e-3


def make(heights: np.ndarray, metres: float = 20.0) -> Terrain:
    grid = Grid(heights.shape, Affine(metres, 0, 7e5, 0, -metres, 5.3e6), CRS.from_epsg(32632))
    return in_memory(Dem(heights, grid))


def test_windows_reach_beyond_what_is_in_view() -> None:
    terrain = make(rough(2049, 2049), 10.0)
    x, y = (float(v) for v in terrain.grid.xy(300, 1700))
    view = View((x, y, 1500.0), (x + 800, y + 300, 400.0), width=320, height=200)
    whole = choose(terrain, view, 1.0, 1.0, 1 << 24)
    assert whole == (Rectangle(0, 0, 2049, 0, 2049),)
    found = choose(terrain, view, 1.0, 1.0, 1 << 21)
    assert sum(r.samples for r in found) <= 1 << 21 and len(found) == 3
    assert found[0].row0 == found[0].col0 == 0 and (found[0].row1, found[0].col1) == terrain.shape(found[0].level)
    for outer, inner in pairwise(found):
        assert outer.level == inner.level + 1 and outer.row0 % 2 == outer.col0 % 2 == 0
        rows, _ = terrain.shape(outer.level)
        assert outer.col0 == 0 or 2 * outer.col0 <= inner.col0 - 2 * MARGIN + 2
        assert outer.row1 == rows or 2 * (outer.row1 - 1) >= inner.row1 - 1 + 2 * MARGIN
    assert 0 < turned(terrain, found) < math.radians(0.53 / 2)
    # However little there is room for, there is a window, and it holds the whole terrain.
    least = choose(terrain, view, 1.0, 1.0, 9)
    assert len(least) == 1 and (least[0].row1, least[0].col1) == terrain.shape(least[0].level)


def test_fields_of_views(device: Device) -> None:
    terrain = make(rough(300, 200))
    key, made = field_of(terrain, View((7e5, 5.3e6, 5e3), (7e5, 5.2e6, 0.0)), 1.0, 1.0, 1 << 20)
    field = made()
    assert key == (Rectangle(0, 0, 300, 0, 200),) and field.turn == 0 and field.pool.nbytes < 1 << 20
    assert key.filled(terrain.shape, terrain.levels, MARGIN) == key
