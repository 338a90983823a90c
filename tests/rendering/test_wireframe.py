"""What a method made, seen: its surface by Embree, its lines by what is visible of them, their weight by geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from plain import refiner
from scenes import embree_hits, hills, holes, terrain

import orograph
from orograph.errors import UsageError
from orograph.lod.soar import Soar
from orograph.raycast.select import rectangles
from orograph.rendering.cpu import draw as cpu
from orograph.rendering.cpu.mesh_surface import surface_of
from orograph.rendering.cpu.mesh_terrain import MeshTerrain
from orograph.rendering.cpu.wireframe import draw_edges, draw_lines, edges_of, project
from orograph.scene import camera
from orograph.scene.scene import Scene
from orograph.store.memory import MemoryTerrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import View

SIZE = (200, 120)


@pytest.fixture(scope="module")
def ground():
    return terrain(hills(129, 129, tall=300.0))


@pytest.fixture(scope="module")
def view(ground):
    return camera.whole(ground, SIZE, azimuth=205.0, pitch=22.0)


@pytest.fixture(scope="module")
def mesh(ground, view):
    made = refiner(Soar, ground).refine(view, tolerance=6.0)
    assert 100 < len(made.triangles) < 4000
    return made


def rays(view, px, py):
    """Directions (n, 3) through pixel positions."""
    _, _, _, d0, du, dv = view.ray_basis()
    return d0 + np.asarray(px)[:, None] * du + np.asarray(py)[:, None] * dv


# ---- the surface -----------------------------------------------------------------------------------------------------


def test_the_surface_is_the_mesh_by_embree(ground, view, mesh):
    picture = cpu.draw(Scene.of(ground, view, method="soar", water=None), mesh=mesh)
    px, py = (a.ravel() + 0.5 for a in np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])))
    truth = embree_hits(mesh.positions(ground.grid), mesh.triangles, np.array(view.eye), rays(view, px, py))
    depth = picture.depth.ravel()
    both = np.isfinite(truth) & np.isfinite(depth)
    assert both.mean() > 0.2 and (np.isfinite(truth) == np.isfinite(depth)).mean() > 0.999
    close = np.abs(depth[both] / truth[both] - 1) < 1e-4
    assert close.mean() > 0.999  # but for pixels whose centre a ridge touches
    # The terrain itself is another surface.
    exact = cpu.draw(Scene.of(ground, view, water=None)).depth.ravel()
    assert (np.abs(exact[both] / truth[both] - 1) < 1e-4).mean() < 0.5


def test_its_heights_are_the_triangles_own():
    """Plane by plane, at random places; holes and what no triangle covers stay the terrain's."""
    ground = terrain(holes(hills(100, 75)))
    view = View((501_500, 3_998_000, 2000), (501_200, 3_999_500, 800), fov_y=20, width=200, height=120)
    mesh = refiner(Soar, ground).refine(view, tolerance=4.0)
    surface = surface_of(mesh, ground).heights
    truth = ground.heights
    assert (np.isnan(surface) == np.isnan(truth)).all() and not np.array_equal(surface, truth, equal_nan=True)
    rng = np.random.default_rng(3)
    covered = np.zeros(truth.shape, bool)
    for corners in mesh.vertices[mesh.triangles]:
        low, high = corners[:, :2].min(0).astype(int), corners[:, :2].max(0).astype(int)
        for _ in range(4):
            c, r = rng.integers(low[0], high[0] + 1), rng.integers(low[1], high[1] + 1)
            weights = np.linalg.solve(np.vstack([corners[:, :2].T, np.ones(3)]), [c, r, 1.0])
            if (weights >= -1e-12).all():
                assert surface[r, c] == pytest.approx(weights @ corners[:, 2], abs=1e-3)
        c, r = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        covered[r, c] = True
    assert not covered.all()
    np.testing.assert_array_equal(surface[~covered], truth[~covered])
    for c, r, z in mesh.vertices:
        assert surface[int(r), int(c)] == z


@pytest.mark.parametrize("shape", [(100, 75), (129, 257), (2, 2), (3, 90), (600, 530)])
def test_read_by_windows_it_is_the_same(shape, monkeypatch):
    """Samples of every level, in any window, and their box means, as of the whole in memory."""
    monkeypatch.setattr("orograph.rendering.cpu.mesh_terrain.STRIP", 3000)
    ground = terrain(holes(hills(*shape)) if min(shape) > 60 else hills(*shape))
    mesh = refiner(Soar, ground, cull=False).refine(
        View((501_500, 3_998_000, 2000), (501_200, 3_999_500, 800)), tolerance=4.0
    )
    whole = surface_of(mesh, ground)
    windows = surface_of(mesh, ground, 4)
    assert isinstance(whole, MemoryTerrain) and not isinstance(windows, MemoryTerrain)
    rng = np.random.default_rng(5)
    for level in range(ground.levels):
        for read, size in (("read", ground.shape(level)), ("read_mean", ground.mean_shape(level))):
            for _ in range(8):
                r0, r1 = sorted(rng.integers(0, size[0] + 1, 2))
                c0, c1 = sorted(rng.integers(0, size[1] + 1, 2))
                got, want = (np.array(getattr(t, read)(level, r0, r1, c0, c1)) for t in (windows, whole))
                assert got.shape == want.shape and (np.isnan(got) == np.isnan(want)).all()
                if read == "read" or level < 3:
                    np.testing.assert_allclose(got, want, rtol=2e-6)
        table = windows.tiles(level)
        heights = whole.tiles(level)
        assert (np.nan_to_num(table.minimum, nan=1e9) <= np.nan_to_num(heights.minimum, nan=1e9) + 1e-3).all()
        assert (np.nan_to_num(table.maximum, nan=-1e9) >= np.nan_to_num(heights.maximum, nan=-1e9) - 1e-3).all()


def test_means_of_coarse_levels_are_those_of_the_surface():
    """From level 3 by the trapezoid rule: off by half a sample's slope on a plane, and little more on round hills."""
    y, x = np.mgrid[:1500, :1301]
    for heights, close in ((0.3 * x - 0.2 * y, 0.06), (100 * np.sin(x / 40) * np.cos(y / 30), 3.5)):
        ground = terrain(heights.astype(np.float32))
        mesh = Tessellation(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
        windows = MeshTerrain(mesh, ground)
        rows, cols = ground.mean_shape(3)
        got, want = windows.read_mean(3, 0, rows, 0, cols), ground.read_mean(3, 0, rows, 0, cols)
        assert np.abs(got - want)[:-1, :-1].max() < close


def test_a_large_mesh_is_drawn_as_it_is_within_a_part_of_a_pixel(monkeypatch):
    """What windows of coarse levels show of it, sample by sample on the screen beside the whole; and the picture."""
    y, x = np.mgrid[:1100, :1025]
    ground = terrain((2000 * np.sin(x / 40) * np.cos(y / 50)).astype(np.float32))
    view = camera.whole(ground, SIZE, azimuth=205.0, pitch=12.0)
    mesh = refiner(Soar, ground).refine(view, tolerance=0.1)  # finer than the windows
    whole = surface_of(mesh, ground)
    scene = Scene.of(ground, view, method="soar", water=None, samples=1)
    monkeypatch.setattr("orograph.rendering.cpu.mesh_surface.EXACT_SAMPLES", 1000)
    windows = surface_of(mesh, ground)
    found = rectangles(windows, view, 1.0, 0.25)
    assert found[-1].level > 0
    rows, cols = np.mgrid[0 : whole.grid.rows : 3, 0 : whole.grid.cols : 3]
    shown = np.full(rows.shape, np.nan)
    for r in found:  # the finest window that holds a sample is what is seen
        step = 1 << r.level
        read = windows.read(r.level, r.row0, r.row1, r.col0, r.col1)
        inside = (rows >= r.row0 * step) & (rows < (r.row1 - 1) * step)
        inside &= (cols >= r.col0 * step) & (cols < (r.col1 - 1) * step)
        shown[inside] = cell_heights(read, rows[inside] / step - r.row0, cols[inside] / step - r.col0, r)
    there = np.isfinite(shown)
    assert there.mean() > 0.98
    east, north = ground.grid.samples @ (cols[there], rows[there])
    placed = [
        np.asarray(view.project(np.stack([east, north, z], -1))[0])
        for z in (shown[there], whole.heights[::3, ::3][there])
    ]
    moved = np.hypot(*(placed[0] - placed[1]).T)
    assert 0.01 < moved.max() <= 0.25
    parts = cpu.draw(scene, mesh=mesh)
    assert parts.facts["tolerance_px"] == 0.25
    monkeypatch.undo()
    exact = cpu.draw(scene, mesh=mesh)
    both = np.isfinite(exact.depth) & np.isfinite(parts.depth)
    assert (np.isfinite(exact.depth) == np.isfinite(parts.depth)).mean() > 0.99
    assert np.abs(parts.pixels[both].astype(int) - exact.pixels[both]).mean() < 2.0


def cell_heights(heights, row, col, window):
    """The surface of a level at places (n,) of a window of it: each cell is cut from its even to its odd corner."""
    i, j = row.astype(int), col.astype(int)
    v, u = row - i, col - j
    a, b, c, d = heights[i, j], heights[i, j + 1], heights[i + 1, j], heights[i + 1, j + 1]
    turned = (i + window.row0 + j + window.col0) % 2 == 1
    upper = np.where(u >= v, a + u * (b - a) + v * (d - b), a + v * (c - a) + u * (d - c))
    other = np.where(u + v <= 1, a + u * (b - a) + v * (c - a), d + (1 - u) * (c - d) + (1 - v) * (b - d))
    return np.where(turned, other, upper)


# ---- lines -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [0.6, 1.0, 2.5])
@pytest.mark.parametrize("angle", [0, 17, 45, 60, 90, 133])
def test_a_line_has_its_width_whatever_its_direction(angle, width):
    """All its ink is its length times its width, but for the round of its ends."""
    a = math.radians(angle)
    middle, half = np.array([60.3, 50.7]), 40.0
    step = half * np.array([math.cos(a), math.sin(a)])
    ends = np.array([[*(middle - step), 1.0, *(middle + step), 1.0, 1.0]])
    ink = np.zeros((100, 120), np.float32)
    draw_lines(ends, np.full(ink.shape, 2.0), False, width / 2, 1.0, 0, 100, ink)
    assert ink.sum() == pytest.approx(2 * half * width, rel=0.1)
    y, x = np.nonzero(ink)
    away = np.abs((x + 0.5 - middle[0]) * math.sin(a) - (y + 0.5 - middle[1]) * math.cos(a))
    assert away.max() < width / 2 + 0.5
    again = np.zeros_like(ink)
    for row in range(0, 100, 7):  # in bands, for threads
        draw_lines(ends, np.full(ink.shape, 2.0), False, width / 2, 1.0, row, min(row + 7, 100), again)
    np.testing.assert_array_equal(ink, again)


def test_edges_are_each_drawn_once():
    triangles = np.array([[0, 1, 2], [2, 1, 3]], np.int32)
    edges, room = edges_of(triangles, np.array([1.0, 5.0]))
    assert {tuple(e) for e in edges} == {(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)} and len(edges) == 5
    assert {tuple(e): r for e, r in zip(edges, room)} == {(0, 1): 1, (0, 2): 1, (1, 2): 5, (1, 3): 5, (2, 3): 5}
    assert len(edges_of(np.zeros((0, 3), np.int32), np.zeros(0))[0]) == 0


def test_hidden_lines_are_hidden_and_visible_ones_are_whole(ground, view, mesh):
    """Points along the edges are visible or not by Embree: visible ones have ink, and ink is near visible ones only."""
    big = view.resized(600, 360)
    depth = cpu.draw(Scene.of(ground, big, method="soar", water=None, samples=1), mesh=mesh).depth.astype(np.float64)
    linear = np.ones((*depth.shape, 3), np.float32)
    draw_edges(linear, depth, mesh, ground.grid, big, width=1.0)
    ink = 1 - linear.mean(-1)

    positions = mesh.positions(ground.grid)
    edges, _ = edges_of(mesh.triangles, np.zeros(len(mesh.triangles)))
    t = np.linspace(0.02, 0.98, 60)[:, None]
    points = np.concatenate([positions[a] * (1 - t) + positions[b] * t for a, b in edges])
    screen, w = big.project(points)
    hit = embree_hits(positions, mesh.triangles, np.array(big.eye), rays(big, *screen.T))
    inside = (screen > 1).all(1) & (screen < [598, 358]).all(1)
    visible = inside & ~(hit < w * (1 - 2e-4))
    hidden = inside & (hit < w * (1 - 2e-2))
    assert visible.sum() > 5000 and hidden.sum() > 1000
    j, i = np.floor(screen[visible]).astype(int).T
    # The nearest pixel centre is at most √½ away, where a line one pixel wide covers at least 0.29.
    assert (ink[i, j] > 0.29 * 0.86 * 0.3 * 0.5 * 0.9).mean() > 0.998
    reach = np.zeros(depth.shape, bool)
    for di in (-1, 0, 1):
        for dj in (-1, 0, 1):
            reach[np.clip(i + di, 0, 359), np.clip(j + dj, 0, 599)] = True
    stray = (ink > 0.05) & ~reach
    assert stray.sum() < 0.004 * reach.sum()
    only_hidden = np.zeros(depth.shape, bool)
    j, i = np.floor(screen[hidden]).astype(int).T
    only_hidden[i, j] = True
    only_hidden &= ~reach
    assert only_hidden.sum() > 50 and (ink[only_hidden] > 0.05).mean() < 0.05


def test_lines_that_pass_the_eye_are_cut(ground):
    """An eye among the triangles: no line from behind it, none that is not finite."""
    view = View((501_900, 3_998_000, 1500), (501_900, 4_001_000, 1200), fov_y=90, width=160, height=90)
    mesh = refiner(Soar, ground, cull=False).refine(view, tolerance=8.0)
    ends = project(mesh.positions(ground.grid), mesh.triangles, view)
    assert np.isfinite(ends).all() and (ends[:, [2, 5]] > 0).all()
    behind = Tessellation(mesh.vertices, mesh.triangles[(mesh.vertices[mesh.triangles, 1] > 80).all(1)])
    assert len(behind.triangles) > 10
    assert len(project(behind.positions(ground.grid), behind.triangles, view)) == 0
    picture = cpu.draw(Scene.of(ground, view, method="soar", wireframe=True, tolerance=8.0))
    assert np.isfinite(picture.pixels).all()


# ---- pictures --------------------------------------------------------------------------------------------------------


def test_pictures_of_a_method(ground, view):
    drawn = {
        (method, wireframe): orograph.render(
            ground, view, method=method, wireframe=wireframe, tolerance=None if method == "auto" else 6.0, jobs=jobs
        )
        for method, wireframe, jobs in (("auto", False, 1), ("soar", False, 1), ("soar", True, 1))
    }
    plain, faces, lines = drawn.values()
    assert faces.facts["mesh"]["method"] == "soar" and faces.facts["mesh"]["tolerance"] == 6.0
    assert "mesh" not in plain.facts
    assert (plain.pixels != faces.pixels).any(-1).mean() > 0.1
    np.testing.assert_array_equal(faces.depth, lines.depth)
    seen = np.isfinite(lines.depth)
    assert lines.pixels[seen].mean() < faces.pixels[seen].mean() - 8  # ink
    many = orograph.render(ground, view, method="soar", wireframe=True, tolerance=6.0, jobs=3)
    np.testing.assert_array_equal(many.pixels, lines.pixels)


def test_a_mesh_is_looked_at_from_elsewhere(ground, view):
    """Made for an eye close by, seen from far: lines lie where that eye looks, and nowhere else."""
    near = View((501_800, 3_997_800, 1100), (501_800, 3_999_000, 800), fov_y=40, width=200, height=120)
    view = view.resized(500, 300)
    plain = orograph.render(ground, view, tolerance=0)
    lines = orograph.render(ground, view, method="soar", wireframe=True, mesh_view=near, tolerance=6.0)
    assert lines.facts["mesh"] == refiner(Soar, ground).refine(near, tolerance=6.0).stats | {
        k: lines.facts["mesh"][k] for k in ("refine_ms", "index_ms")
    }
    inked = (np.abs(plain.pixels.astype(int) - lines.pixels) > 25).any(-1)
    x, y = ground.grid.xy(*np.meshgrid(np.arange(129), np.arange(129)))
    places = np.stack([x, y, ground.heights], -1)
    there, depth = near.project(places)
    pixels = view.project(places)[0].astype(int)
    before, behind = pixels[(there > 0).all(-1) & (there < [200, 120]).all(-1)], pixels[depth < -500]
    assert len(before) > 500 and inked[before[:, 1], before[:, 0]].mean() > 0.05
    assert len(behind) > 500 and inked[behind[:, 1], behind[:, 0]].mean() < 0.01


def test_a_picture_of_so_many_triangles_by_a_metric(ground, view):
    told = orograph.render(ground, view, method="soar,metric=isotropic", triangles=500).facts["mesh"]
    assert 300 < told["triangles"] <= 500 and told["metric"] == "isotropic"
    alone = refiner(Soar, ground, metric="isotropic").refine(view, triangles=500)
    assert told["triangles"] == len(alone.triangles)
    with pytest.raises(UsageError, match="tolerance"):
        orograph.render(ground, view, method="soar", triangles=500, tolerance=1.0)
    with pytest.raises(UsageError, match="not 'wedgie'"):
        orograph.render(ground, view, method="soar,metric=wedgie")


def test_a_wireframe_is_of_a_method(ground, view):
    with pytest.raises(UsageError, match="method"):
        orograph.render(ground, view, triangles=9)
    with pytest.raises(UsageError, match="method"):
        orograph.render(ground, view, mesh_view=view)
    with pytest.raises(UsageError, match="method"):
        orograph.render(ground, view, wireframe=True)
    with pytest.raises(UsageError, match="no method 'sore'"):
        orograph.render(ground, view, method="sore")
