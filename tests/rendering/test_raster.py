"""The rasteriser against brute force on whole numbers, against rays in double precision, against Embree and the caster;
broken meshes show where they are broken."""

from __future__ import annotations

import meshes
import numpy as np
import pytest
from meshes import Array, Triangles

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.raycast.caster import Caster
from orograph.rendering.cpu import raster
from orograph.rendering.cpu.raster import MeshSurface
from orograph.rendering.gbuffer import GBuffer
from orograph.rendering.projection import Projection
from orograph.rendering.ray_surface import RaySurface
from orograph.viewpoint import Camera, View

OBLIQUE = (41.0, 90.0, 2500.0, (41.0, 30.0, 800.0))
"""From the south, over the whole raster: eye's column, row and height, and target."""

ABOVE = (41.0, 30.1, 6000.0, (41.0, 30.0, 800.0))
WITHIN = (40.3, 31.2, 850.0, (60.0, 20.0, 700.0))
"""In the middle of the mesh, at its height."""


def surface(
    mesh: tuple[Array, Triangles], view: View, g: Grid, exaggeration: float = 1.0, jobs: int = 1
) -> MeshSurface:
    return MeshSurface(*mesh, Projection.of(Camera.over(g, view, exaggeration)), jobs)


def drawn(mesh: tuple[Array, Triangles], view: View, g: Grid, exaggeration: float = 1.0) -> GBuffer:
    return surface(mesh, view, g, exaggeration).draw((0, view.height, 0, view.width))


def same(a: GBuffer, b: GBuffer) -> bool:
    return np.array_equal(a.depth, b.depth, equal_nan=True) and np.array_equal(a.objects, b.objects)


# ---- cover -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("projection", ["plan", "perspective"])
def test_every_pixel_is_covered_once_and_by_the_triangle_that_brute_force_finds(seed: int, projection: str) -> None:
    g, mesh = meshes.grid("rotated"), meshes.scattered(seed, 250)
    mesh[0][:, 2] = 800 + mesh[0][:, 0]  # a plane: nothing hides anything
    view = meshes.seen_from(g, *ABOVE, projection=projection, fov_y=9)
    count, covered = meshes.cover(meshes.places(mesh[0], g), mesh[1], view, g)
    assert (count == 1).all()
    found = drawn(mesh, view, g)
    for k, pixels in enumerate(covered):
        assert np.array_equal(found.objects == k, pixels)


def test_overlapping_triangles_cover_what_brute_force_finds_and_the_nearest_wins() -> None:
    rng = np.random.default_rng(5)
    g = meshes.grid("north up")
    vertices = rng.random((60, 3)) * [82, 60, 600]
    tri = np.array([rng.choice(60, 3, replace=False) for _ in range(70)], np.int32)
    view = meshes.seen_from(g, *OBLIQUE)
    points = meshes.places(vertices, g)
    _, covered = meshes.cover(points, tri, view, g)
    found = drawn((vertices, tri), view, g)
    assert np.array_equal(np.isfinite(found.depth), np.any(covered, 0))
    i, j = np.nonzero(found.objects >= 0)
    assert len(i) > 500
    assert np.array(covered)[found.objects[i, j], i, j].all()
    t, which, certain = meshes.seen((vertices, tri), view, g, *meshes.centres(view))
    assert certain.mean() > 0.97
    assert np.array_equal(found.objects.ravel()[certain], which[certain])
    np.testing.assert_allclose(found.depth.ravel()[certain], t[certain], rtol=1e-11)


@pytest.mark.parametrize("step", [1.0, 2.0, 3.5, 0.25])
def test_corners_and_edges_on_pixel_centres_are_covered_once(step: float) -> None:
    """The triangle drawn last in one order is first in the other: at equal depth each pixel must show the same one."""
    n = int(40 / step) + 1
    vertices, tri = meshes.full(np.full((n, n), 100, np.float32))
    vertices[:, :2] = vertices[:, :2] * step + 5
    g = Grid((61, 83), meshes.GRIDS["north up"])
    distance = 15 * 65 / np.tan(np.radians(20))  # a pixel is one sample
    view = meshes.seen_from(g, 26.5, 24.5, 100 + distance, (26.5, 24.5, 100), projection="plan", width=65, height=65)
    one = drawn((vertices, tri), view, g)
    other = drawn((vertices, np.ascontiguousarray(tri[::-1])), view, g)
    assert np.array_equal(one.objects, np.where(other.objects < 0, -1, len(tri) - 1 - other.objects))
    inside = np.isfinite(one.depth)
    col = 26.5 + np.arange(65) + 0.5 - 32.5
    row = 24.5 + np.arange(65) + 0.5 - 32.5
    own = [(a >= 5) & (a < vertices[:, 0].max()) for a in (row, col)]  # top and left edges, not right and bottom ones
    assert np.array_equal(inside, own[0][:, None] & own[1])
    assert 0.3 < inside.mean() < 0.5


def test_of_equally_near_triangles_the_first_is_shown() -> None:
    g, (vertices, tri) = meshes.grid("north up"), meshes.scattered(1, 60)
    view = meshes.seen_from(g, *OBLIQUE)
    once = drawn((vertices, tri), view, g)
    assert same(drawn((vertices, np.concatenate([tri, tri])), view, g), once)
    again = drawn((vertices, np.concatenate([tri[::-1], tri])), view, g)
    assert np.array_equal(again.objects, np.where(once.objects < 0, -1, len(tri) - 1 - once.objects))


# ---- depth -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", meshes.GRIDS)
@pytest.mark.parametrize("exaggeration", [1.0, 2.5])
def test_shows_what_embree_meets(name: str, exaggeration: float) -> None:
    pytest.importorskip("embreex")
    g = meshes.grid(name)
    mesh = meshes.full(meshes.hills())
    view = meshes.seen_from(g, *OBLIQUE, width=320, height=200)
    found = drawn(mesh, view, g, exaggeration)
    points = meshes.places(mesh[0], g, exaggeration)
    o, d = meshes.rays(view, g, *meshes.centres(view), exaggeration)
    theirs = meshes.embree_hits(points, mesh[1], o, d)
    assert 0.1 < (theirs >= 0).mean() < 0.95
    assert (found.objects.ravel() == theirs).mean() > 0.999  # the rest lies on edges, in single precision
    both = (theirs >= 0) & (found.objects.ravel() == theirs)
    a, b, c = (points[mesh[1][theirs[both], k]] - o[both] for k in range(3))
    normal = np.cross(b - a, c - a)
    t = (normal * a).sum(1) / (normal * d[both]).sum(1)
    np.testing.assert_allclose(found.depth.ravel()[both], t, rtol=1e-9)


@pytest.mark.parametrize("projection", ["plan", "perspective"])
@pytest.mark.parametrize("camera", [OBLIQUE, ABOVE, WITHIN])
def test_agrees_with_the_ray_caster(camera: tuple[float, ...], projection: str) -> None:
    g, heights = meshes.grid("rectangular"), meshes.hills(seed=3)
    heights[20:24, 30:37] = np.nan
    view = meshes.seen_from(g, *camera, width=200, height=120, projection=projection)
    p = Projection.of(Camera.over(g, view, 1.5))
    area = (0, 120, 0, 200)
    mine, rays = MeshSurface(*meshes.full(heights), p).draw(area), RaySurface(Caster.of(heights, 1), p).draw(area)
    assert (np.isfinite(mine.depth) != np.isfinite(rays.depth)).sum() <= 2
    close = np.abs(mine.depth - rays.depth) <= 1e-9 * rays.depth
    assert np.isfinite(rays.depth).sum() > 700
    assert (~close & np.isfinite(rays.depth)).sum() <= 0.001 * rays.depth.size  # nearest one another on edges


@pytest.mark.parametrize(
    "camera,given",
    [
        (WITHIN, {}),
        (WITHIN, {"near": 200.0, "far": 900.0}),
        (WITHIN, {"fov_y": 150.0}),
        ((40.3, 31.2, 500.0, (40.4, 31.0, 900.0)), {}),  # from below
        (OBLIQUE, {"near": 2400.0, "far": 2800.0}),
        (ABOVE, {"near": 5150.0, "projection": "plan", "far": 5300.0}),
        (WITHIN, {"projection": "plan", "fov_y": 100.0}),
        ((41.0, 30.0, 804.0, (41.0, 29.0, 803.0)), {"fov_y": 0.5}),
    ],
)
@pytest.mark.parametrize("far_reaching", [False, True])
def test_near_plane_far_plane_and_triangles_around_the_eye(
    camera: tuple[float, ...], given: dict[str, float], far_reaching: bool
) -> None:
    """Also of a mesh whose border is a million samples away."""
    g, (vertices, tri) = meshes.grid("north up"), meshes.scattered(2, 80)
    if far_reaching:
        vertices[:4, :2] = (vertices[:4, :2] - [41, 30]) * 25_000
    view = meshes.seen_from(g, *camera, width=60, height=40, **given)
    found = drawn((vertices, tri), view, g)
    t, which, certain = meshes.seen((vertices, tri), view, g, *meshes.centres(view))
    assert certain.mean() > 0.97 and np.isfinite(t).sum() > 100
    assert np.array_equal(found.objects.ravel()[certain], which[certain])
    rounding = 1e-15 * float(np.abs(vertices).max() * 30)
    np.testing.assert_allclose(found.depth.ravel()[certain], t[certain], rtol=1e-9, atol=rounding)


def test_a_plane_below_the_eye_is_whole_up_to_the_horizon() -> None:
    """Where triangles are cut at the eye's plane and far outside the picture, their neighbours still meet them."""
    g, (vertices, tri) = meshes.grid("north up"), meshes.scattered(4, 3000)
    vertices[:, 2] = 500.0
    vertices[:4, :2] = (vertices[:4, :2] - [41, 30]) * 1e7
    view = meshes.seen_from(g, 41.2, 30.7, 500.003, (60.0, 30.0, 500.003), width=400, height=300, fov_y=100)
    found = drawn((vertices, tri), view, g)
    rows = np.arange(300) + 0.5
    t = 0.003 / ((rows - 150) * view.pixel_slope)
    assert np.isnan(found.depth[:150]).all()
    np.testing.assert_allclose(found.depth[150:], np.broadcast_to(t[150:, None], (150, 400)), rtol=1e-9)


# ---- areas, tiles, threads, positions --------------------------------------------------------------------------------


@pytest.mark.parametrize("projection", ["plan", "perspective"])
def test_areas_tiles_and_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch, projection: str) -> None:
    g, mesh = meshes.grid("rotated"), meshes.full(meshes.hills(seed=2))
    view = meshes.seen_from(g, *WITHIN, width=230, height=170, projection=projection)
    p = Projection.of(Camera.over(g, view))
    whole = MeshSurface(*mesh, p, 1).draw((0, 170, 0, 230))
    assert np.isfinite(whole.depth).mean() > 0.3
    assert Projection.of(Camera.over(g, view.tile(10, 20, 30, 40))).matrix().tolist() == p.matrix().tolist()
    monkeypatch.setattr(raster, "BLOCK", 97)
    for level, most, jobs in ((3, 4096, 3), (6, 4, 2), (6, 1, 1)):
        monkeypatch.setattr(raster, "LEVEL", level)
        monkeypatch.setattr(raster, "MOST", most)
        other = MeshSurface(*mesh, p, jobs)
        assert same(other.draw((0, 170, 0, 230)), whole)
        for top, bottom, left, right in ((0, 1, 0, 1), (63, 66, 60, 131), (101, 170, 7, 230)):
            part = other.draw((top, bottom, left, right))
            assert np.array_equal(part.depth, whole.depth[top:bottom, left:right], equal_nan=True)
            assert np.array_equal(part.objects, whole.objects[top:bottom, left:right])


@pytest.mark.parametrize("projection", ["plan", "perspective"])
def test_a_pixels_centre_asked_as_a_position_shows_the_same(projection: str) -> None:
    g, mesh = meshes.grid("rotated"), meshes.full(meshes.hills(seed=2))
    view = meshes.seen_from(g, *WITHIN, width=150, height=100, projection=projection)
    s = surface(mesh, view, g)
    whole = s.draw((0, 100, 0, 150))
    order = np.random.default_rng(0).permutation(100 * 150)[:9000]
    px, py = (a[order] for a in meshes.centres(view))
    some = s.at(px, py)
    assert np.array_equal(some.depth, whole.depth.ravel()[order], equal_nan=True)
    assert np.array_equal(some.objects, whole.objects.ravel()[order])
    assert s.at(px[:0], py[:0]).depth.shape == (0,)


def test_positions_within_pixels_show_what_their_rays_meet() -> None:
    g, mesh = meshes.grid("south up"), meshes.scattered(3, 200)
    view = meshes.seen_from(g, *OBLIQUE)
    rng = np.random.default_rng(1)
    px, py = rng.random(2000) * 96, rng.random(2000) * 64
    found = surface(mesh, view, g).at(px, py)
    t, which, certain = meshes.seen(mesh, view, g, px, py)
    assert certain.mean() > 0.97 and np.isfinite(t).sum() > 500
    assert np.array_equal(found.objects[certain], which[certain])
    np.testing.assert_allclose(found.depth[certain], t[certain], rtol=1e-11)


def test_a_mesh_shows_nothing_beside_its_picture() -> None:
    g, mesh = meshes.grid("north up"), meshes.scattered(3, 50)
    s = surface(mesh, meshes.seen_from(g, *ABOVE, fov_y=9), g)
    px, py = np.array([[-0.1, 48], [96, 32], [48, 64], [48, -1e9], [np.nan, 3], [95.9, 63.9], [0, 0], [1e12, 5]]).T
    assert np.isfinite(s.at(px, py).depth).tolist() == [False] * 5 + [True, True, False]


# ---- broken meshes ---------------------------------------------------------------------------------------------------


def test_a_missing_triangle_is_a_hole() -> None:
    g, (vertices, tri) = meshes.grid("north up"), meshes.scattered(6, 100)
    view = meshes.seen_from(g, *ABOVE, fov_y=15)
    whole = drawn((vertices, tri), view, g)
    gone = int(whole.objects[32, 48])
    broken = drawn((vertices, np.delete(tri, gone, 0)), view, g)
    hole = whole.objects == gone
    assert hole.sum() > 20
    assert np.isnan(broken.depth[hole]).all()
    assert np.array_equal(broken.depth[~hole], whole.depth[~hole], equal_nan=True)


def test_through_a_hole_what_lies_behind_is_seen() -> None:
    g, (vertices, tri) = meshes.grid("north up"), meshes.full(meshes.hills(tall=600))
    view = meshes.seen_from(g, 41.0, 75.0, 1100.0, (41.0, 30.0, 900.0), width=160)
    whole = drawn((vertices, tri), view, g)
    behind = 0
    for gone in np.unique(whole.objects[whole.objects >= 0])[::37]:
        hole = whole.objects == gone
        broken = drawn((vertices, np.delete(tri, gone, 0)), view, g)
        behind += int(np.isfinite(broken.depth[hole]).sum())
        assert not (broken.depth[hole] < whole.depth[hole] * (1 - 1e-12)).any()
    assert behind > 20


def test_a_t_junction_that_does_not_fit_shows_a_crack() -> None:
    """Two triangles north of an edge and one south of it; their middle vertex lies on the edge, then 50 m above it."""
    g = meshes.grid("north up")
    tri = np.array([[0, 3, 2], [3, 1, 2], [0, 4, 1]], np.int32)
    vertices = np.array([[10, 30, 500], [70, 30, 500], [40, 10, 500], [40, 30, 500], [40, 50, 500]], np.float64)
    view = meshes.seen_from(g, 40.0, 90.0, 1500.0, (40.0, 30.0, 500.0), width=300, height=200, fov_y=45)
    sound = drawn((vertices, tri), view, g)
    vertices[3, 2] += 50
    cracked = drawn((vertices, tri), view, g)
    new = np.isnan(cracked.depth) & np.isfinite(sound.depth)
    # The gap, from its corners: everything between the lower triangle's edge and the two upper ones'.
    points = meshes.places(np.vstack([vertices[[0, 1, 3]]]), g)
    _, (gap,) = meshes.cover(points, np.array([[0, 1, 2]], np.int32), view, g)
    assert new.sum() > 200
    assert np.array_equal(new, gap)


def test_a_t_junction_that_fits_shows_none() -> None:
    g = meshes.grid("north up")
    tri = np.array([[0, 3, 2], [3, 1, 2], [0, 4, 1]], np.int32)
    vertices = np.array([[10, 30, 500], [70, 30, 500], [40, 10, 500], [40, 30, 500], [40, 50, 500]], np.float64)
    view = meshes.seen_from(g, 40.0, 90.0, 1500.0, (40.0, 30.0, 500.0), width=300, height=200, fov_y=45)
    points = meshes.places(vertices, g)
    joined, _ = meshes.cover(points, np.array([[0, 1, 2], [0, 4, 1]], np.int32), view, g)
    assert np.array_equal(np.isfinite(drawn((vertices, tri), view, g).depth), joined > 0)


# ---- what is odd -----------------------------------------------------------------------------------------------------


def test_nothing_is_drawn_of_no_mesh_or_one_without_a_place() -> None:
    g = meshes.grid("north up")
    view = meshes.seen_from(g, *OBLIQUE)
    vertices, tri = meshes.scattered(1, 40)
    nowhere = vertices.copy()
    nowhere[:, 2] = np.nan
    behind = vertices + np.array([0, 200, 0])
    flat = np.ascontiguousarray(tri[:, [0, 1, 1]])
    for mesh in (
        (vertices[:0], tri[:0]), (vertices, tri[:0]), (nowhere, tri), (behind, tri), (vertices, flat)
    ):  # fmt: skip
        s = surface(mesh, view, g)
        found = s.draw((0, 64, 0, 96))
        assert np.isnan(found.depth).all() and (found.objects == -1).all() and not found.marks.any()
        assert np.isnan(s.at(np.array([48.5]), np.array([32.5])).depth).all()


def test_triangles_with_a_vertex_that_is_not_finite_are_left_out() -> None:
    g, (vertices, tri) = meshes.grid("north up"), meshes.scattered(7, 80)
    view = meshes.seen_from(g, *ABOVE, fov_y=15)
    whole = drawn((vertices, tri), view, g)
    bad = tri[whole.objects[32, 48], 0]
    for value in (np.nan, np.inf):
        broken = vertices.copy()
        broken[bad, 2] = value
        around = (tri == bad).any(1)
        left = drawn((vertices, tri[~around]), view, g)
        assert np.array_equal(drawn((broken, tri), view, g).depth, left.depth, equal_nan=True)
        assert np.isnan(left.depth).any()


def test_slivers_seen_edge_on_stay_within_the_depths_of_their_corners() -> None:
    """One in each column of pixels, thinner than the lattice: what they are snapped to holds centres, of whose rays the
    slivers' own planes know nothing."""
    g, rng = meshes.grid("north up"), np.random.default_rng(3)
    view = meshes.seen_from(g, *OBLIQUE)
    p = Projection.of(Camera.over(g, view))
    px = np.repeat(np.arange(96) + 0.5, 3) + rng.uniform(-0.6, 0.6, 288) / 4096
    py, t = rng.random(288) * 64, rng.uniform(1000, 3000, 288)
    found = drawn((p.place(px, py, t), np.arange(288, dtype=np.int32).reshape(-1, 3)), view, g)
    shown = found.objects >= 0
    assert shown.sum() > 100
    corners = t.reshape(-1, 3)[found.objects[shown]]
    assert (found.depth[shown] >= corners.min(1) * (1 - 1e-9)).all()
    assert (found.depth[shown] <= corners.max(1) * (1 + 1e-9)).all()


def test_a_triangle_that_ends_at_the_eye_is_seen_edge_on() -> None:
    g = meshes.grid("north up")
    p = Projection.of(Camera.over(g, meshes.seen_from(g, *OBLIQUE)))
    ends = p.place(np.array([60.2, 81.7, 20.3]), np.array([50.1, 33.9, 41.3]), np.array([900.0, 2000.0, 1500.0]))
    found = MeshSurface(np.vstack([p.o, ends]), np.array([[0, 1, 2], [2, 3, 0]], np.int32), p).draw((0, 64, 0, 96))
    assert np.isnan(found.depth).all()


def test_a_picture_that_is_too_large_is_refused() -> None:
    g = meshes.grid("north up")
    view = meshes.seen_from(g, *OBLIQUE, width=200_000, height=2)
    with pytest.raises(UsageError, match="131072"):
        surface(meshes.scattered(1, 10), view, g)
