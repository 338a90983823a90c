"""Areas: closed forms, all triangles clipped another way, properties, volumes, holes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from affine import Affine
from closed_forms import RECTANGULAR, ROTATED, SQUARE, of_function, points_in, rough, terrain_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from orograph import store
from orograph.errors import UsageError
from orograph.measuring import area


def ring(centre, radius, n=8, inner=1.0, turn=0.1):
    """A star of n points (a polygon if inner is 1)."""
    a = turn + 2 * np.pi * np.arange(n) / n
    r = radius * np.where(np.arange(n) % 2, inner, 1.0)
    return np.asarray(centre) + r[:, None] * np.stack([np.cos(a), np.sin(a)], axis=-1)


MIDDLE = (500_465, 3_999_535)


@pytest.mark.parametrize("transform", [SQUARE, RECTANGULAR, ROTATED])
def test_on_a_plane_the_surface_is_the_plan_by_the_cosine(transform):
    terrain = of_function((60, 60), lambda x, y: 0.5 * (x - 500_000) + 0.25 * (y - 4_000_000), transform)
    middle = np.array(terrain.grid.xy(29.3, 30.1))
    star = ring(middle, 500, 14, 0.4)
    found = area(terrain, star, level=0.5 * (middle[0] - 500_000) + 0.25 * (middle[1] - 4_000_000))
    plan = 7 * 500 * 200 * math.sin(2 * math.pi / 14)
    assert found.plan == found.plan_grid == pytest.approx(plan, rel=1e-9)
    assert found.surface == found.surface_grid == pytest.approx(plan * math.sqrt(1 + 0.3125), rel=1e-6)
    assert found.mean_height == pytest.approx(found.level, abs=1e-2)
    assert found.above == pytest.approx(found.below, rel=1e-4)  # the star is symmetric, but for float32
    assert found.missing_grid == 0


def test_a_cone_s_mantle_and_volume():
    top, slope = 800.0, 0.75
    errors = []
    for spacing in (20, 10):
        n = 1601 // spacing
        transform = Affine(spacing, 0, 0, 0, -spacing, 0)
        x0 = y0 = (n // 2 + 0.5) * spacing
        terrain = of_function((n, n), lambda x, y: top - slope * np.hypot(x - x0, y + y0), transform)  # noqa: B023
        found = area(terrain, ring((x0, -y0), 600, 720), level=top - slope * 600)
        plan = 0.5 * 720 * 600**2 * math.sin(2 * math.pi / 720)
        errors.append((plan * math.sqrt(1 + slope**2) - found.surface, plan * slope * 600 / 3 - found.above))
        assert found.plan == pytest.approx(plan, rel=1e-9) and found.below < 1e-3 * found.above
    assert abs(errors[0][0]) < 1e-3 * plan and abs(errors[1][0]) < abs(errors[0][0])
    # Inscribed in a concave surface, the triangulation is below it: error falls with the spacing squared, near enough.
    assert 0 < errors[1][1] < 0.4 * errors[0][1]


def test_a_sphere_s_cap():
    radius, rim = 3000.0, 1200.0
    terrain = of_function((161, 161), lambda x, y: np.sqrt(radius**2 - (x - 501_214.5) ** 2 - (y - 3_998_785.5) ** 2),
                          Affine(15, 0, 500_007, 0, -15, 3_999_993))  # fmt: skip
    found = area(terrain, ring((501_214.5, 3_998_785.5), rim, 2000), level=math.sqrt(radius**2 - rim**2))
    height = radius - math.sqrt(radius**2 - rim**2)
    assert found.surface == pytest.approx(2 * math.pi * radius * height, rel=2e-5)
    assert found.above == pytest.approx(math.pi * height * (3 * rim**2 + height**2) / 6, rel=3e-4)


def triangles(h):
    """All (3, 3) = x, y, z of the surface, by its definition."""
    for r in range(h.shape[0] - 1):
        for c in range(h.shape[1] - 1):
            p = [(c + i, r + j, float(h[r + j, c + i])) for j in (0, 1) for i in (0, 1)]
            for k in ((0, 1, 3), (0, 3, 2)) if (r + c) % 2 == 0 else ((0, 1, 2), (1, 3, 2)):
                yield np.array([p[i] for i in k])


def overlap(tri, corners):
    """Area in plan of a triangle within a convex polygon, by half-spaces."""
    rows = []
    for poly in (tri[:, :2], corners):
        centre = poly.mean(axis=0)
        for a, b in zip(poly, np.roll(poly, -1, axis=0)):
            normal = np.array([b[1] - a[1], a[0] - b[0]])
            sign = np.sign(normal @ (centre - a))
            rows.append([*(-sign * normal), sign * normal @ a])
    spaces = np.array(rows)
    # The point deepest inside: a linear programme.
    from scipy.optimize import linprog

    norm = np.linalg.norm(spaces[:, :2], axis=1, keepdims=True)
    best = linprog([0, 0, -1], A_ub=np.hstack([spaces[:, :2], norm]), b_ub=-spaces[:, 2], bounds=[(None, None)] * 3)
    if not best.success or best.x[2] < 1e-9:
        return 0.0
    try:
        return float(ConvexHull(HalfspaceIntersection(spaces, best.x[:2]).intersections).volume)
    except QhullError:
        return 0.0


@pytest.mark.parametrize("transform", [SQUARE, ROTATED])
def test_every_triangle_is_clipped_as_half_spaces_clip_it(transform):
    h = rough((9, 10), 1)
    h[4, 5] = np.nan
    terrain = terrain_of(h, transform)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        samples = ring((4.4, 4.1), 3.6, 5, turn=rng.uniform(0, 6)) + rng.uniform(-0.4, 0.4, 2)
        polygon = np.stack(terrain.grid.xy(*samples.T), axis=-1)
        found = area(terrain, polygon)
        cell = abs(transform.determinant)
        surface = missing = 0.0
        for tri in triangles(h):
            part = 2 * overlap(tri, samples)  # a triangle is half a cell
            if np.isnan(tri).any():
                missing += part * cell / 2
                continue
            xy = np.stack(terrain.grid.xy(tri[:, 0], tri[:, 1]), axis=-1)
            space = np.column_stack([xy, tri[:, 2]])
            surface += part * 0.5 * float(np.linalg.norm(np.cross(space[1] - space[0], space[2] - space[0])))
        assert found.surface == pytest.approx(surface, rel=1e-7)
        assert found.missing_grid == pytest.approx(missing, rel=1e-7, abs=1e-6) and missing > 0


@pytest.mark.stress
def test_the_whole_raster_over_many_tiles_is_the_sum_of_its_triangles():
    h = rough((530, 610), 3, True)
    terrain = terrain_of(h, RECTANGULAR)
    z = h.astype(float)
    a, b, c, d = z[:-1, :-1], z[:-1, 1:], z[1:, :-1], z[1:, 1:]
    y, x = np.mgrid[: a.shape[0], : a.shape[1]]
    even = (x + y) % 2 == 0
    first = np.where(even, [b - a, d - b], [b - a, c - a])
    second = np.where(even, [d - c, c - a], [d - c, d - b])
    facets = np.stack([np.sqrt(1 + (p / 20) ** 2 + (q / 35) ** 2) for p, q in (first, second)])
    corners = np.stack(terrain.grid.xy([0, 609, 609, 0], [0, 0, 529, 529]), axis=-1)
    found = area(terrain, corners, level=500.0, jobs=2)
    assert found.surface == pytest.approx(np.nansum(facets) * 350, rel=1e-12)
    assert found.missing_grid == pytest.approx(np.isnan(facets).sum() * 350)
    assert found.plan_grid == pytest.approx(609 * 529 * 700)
    ground = found.plan_grid - found.missing_grid
    assert found.above - found.below == pytest.approx((found.mean_height - 500) * ground, rel=1e-9)
    assert area(terrain, corners, level=500.0, jobs=1) == found
    plain = area(terrain, corners)  # triangles inside are not clipped then
    assert (plain.surface, plain.mean_height) == pytest.approx((found.surface, found.mean_height), rel=1e-12)


TERRAIN = terrain_of(rough((40, 40), 6, True))
UNIT = st.floats(0, 1)


@given(st.integers(3, 12), st.floats(0.2, 1), UNIT, st.floats(0, 6.2), st.floats(60, 440))
@settings(max_examples=60)
def test_parts_add_up(n, inner, cut, turn, radius):
    star = ring(MIDDLE, radius, 2 * n, inner, turn)
    whole = area(TERRAIN, star, level=500.0)
    k = 2 + round(cut * (2 * n - 4))  # from the middle to two corners: both parts are simple
    parts = [area(TERRAIN, [MIDDLE, *part], level=500.0) for part in (star[: k + 1], [*star[k:], star[0]])]
    for name in ("plan", "surface", "missing_grid", "above", "below"):
        assert sum(getattr(p, name) for p in parts) == pytest.approx(getattr(whole, name), rel=1e-9, abs=1e-5), name
    assert whole.surface + whole.missing_grid >= whole.plan * (1 - 1e-12)


def test_either_sense_a_closed_ring_and_a_hole():
    outer, inner = ring(MIDDLE, 400, 9), ring(MIDDLE, 150, 7)
    whole, cut = area(TERRAIN, outer, level=480), area(TERRAIN, inner, level=480)
    for rings in ([outer, inner], [outer[::-1], inner], [[*outer, outer[0]], inner[::-1]]):
        found = area(TERRAIN, rings, level=480)
        assert found.surface == pytest.approx(whole.surface - cut.surface, rel=1e-12)
        assert found.plan == pytest.approx(whole.plan - cut.plan, rel=1e-12)
        assert found.above == pytest.approx(whole.above - cut.above, rel=1e-9)
        assert found.perimeter == pytest.approx(whole.perimeter + cut.perimeter)


@pytest.mark.parametrize(
    ("crs", "east", "north"),
    [("EPSG:32611", 300_000, 4_000_000), ("EPSG:3857", 1_000_000, 8_400_000), ("EPSG:3035", 7_400_000, 4_800_000)],
)
def test_true_areas_are_those_of_the_ellipsoid(crs, east, north):
    transform = Affine(100, 0, east, 0, -100, north)
    terrain = of_function((300, 300), lambda x, y: 0 * x, transform, crs)
    corners = np.add((east, north), [[2000, -2000], [27_000, -4000], [25_000, -27_000], [9000, -12_000]])
    found = area(terrain, corners)
    if crs == "EPSG:3035":
        assert found.plan == pytest.approx(found.plan_grid, rel=1e-8)  # an equal-area projection
    else:
        assert abs(found.plan / found.plan_grid - 1) > 2e-5
    assert (found.surface, found.surface_grid) == (found.plan, found.plan_grid)  # level ground at height 0
    high = area(terrain_of(np.full((300, 300), 3000.0), transform, crs), corners)
    assert high.surface == pytest.approx(high.plan * (1 + 3000 / 6_371_008.8) ** 2, rel=1e-11)


@pytest.mark.stress
def test_a_store_gives_the_same(tmp_path):
    h = rough((600, 600), 2)
    memory = terrain_of(h, crs="EPSG:32611")
    stored = store.build(store.ArraySource(h, memory.grid, "ground"), tmp_path / "g.oro")
    star = ring(memory.grid.xy(300, 300), 8000, 22, 0.5)
    assert area(stored, star, level=500) == area(memory, star, level=500)


def test_only_tiles_that_the_polygon_meets_are_read(monkeypatch):
    terrain = terrain_of(rough((1100, 1100)))
    read, windows = terrain.read, []
    monkeypatch.setattr(terrain, "read", lambda *w: windows.append(w) or read(*w))
    area(terrain, np.stack(terrain.grid.xy([10, 1090, 1090], [10, 10, 30]), axis=-1))
    assert len(windows) == 5 and all(w[1] == 0 for w in windows)


@pytest.mark.parametrize(
    ("corners", "says"),
    [
        ([(500_100, 3_999_900), (500_700, 3_999_300)], "three corners"),
        ([(500_100, 3_999_900), (500_700, 3_999_300), (500_400, 3_999_600)], "on a line"),
        ([(500_100, 3_999_900), (500_700, 3_999_300), (500_700, 3_999_900), (500_100, 3_999_300)], "cross"),
        ([(500_100, 3_999_900), (500_700, 3_999_300), (400_000, 3_999_900)], "of ground, whose surface"),
        ([ring(MIDDLE, 200), ring((500_800, 3_999_200), 50)], "not inside"),
    ],
)
def test_what_is_no_polygon_is_refused(corners, says):
    with pytest.raises(UsageError, match=says):
        area(TERRAIN, corners)


def test_a_level_is_a_height():
    with pytest.raises(UsageError, match="level"):
        area(TERRAIN, ring(MIDDLE, 100), level=math.nan)
    assert points_in(TERRAIN, np.random.default_rng(0), 1).shape == (1, 2)
