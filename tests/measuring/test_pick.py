"""Picking against closed forms, all triangles and the caster; slope and aspect against planes and the maps of light."""

from __future__ import annotations

import math

import brute
import numpy as np
import pytest
from closed_forms import RECTANGULAR, ROTATED, SQUARE, of_function, points_in, rough, terrain_of

from orograph import store
from orograph.errors import UsageError
from orograph.geo.ellipsoid import EARTH
from orograph.measuring import pick, place, slope_aspect
from orograph.measuring.pick import cast
from orograph.raycast.caster import Caster
from orograph.viewpoint import View


@pytest.mark.parametrize("transform", [SQUARE, RECTANGULAR, ROTATED])
@pytest.mark.parametrize("exaggeration", [1.0, 3.0])
def test_on_a_plane_the_place_is_that_of_the_pixel(transform, exaggeration):
    terrain = of_function((300, 290), lambda x, y: 700 + 0.25 * (x - 500_000) - 0.125 * (y - 4_000_000), transform)
    rng = np.random.default_rng(1)
    for _ in range(20):
        target = points_in(terrain, rng, 1)[0]
        height = 700 + 0.25 * (target[0] - 500_000) - 0.125 * (target[1] - 4_000_000)
        eye = (target[0] + rng.uniform(-3000, 3000), target[1] + rng.uniform(-3000, 3000), 6000.0)
        middle = terrain.grid.xy(140, 150)
        view = View(eye, (float(middle[0]), float(middle[1]), 800.0), width=640, height=480)
        pixel, depth = view.project(np.array([*target, height]), exaggeration)
        if not np.isfinite(pixel).all():
            continue
        hit = pick(terrain, view, tuple(pixel), exaggeration)
        assert hit is not None
        # Heights are float32: 6e-5 m, seen at a slant.
        assert hit.point == pytest.approx(tuple(target), abs=5e-3)
        assert hit.height == pytest.approx(height, abs=2e-3)
        assert hit.depth == pytest.approx(float(depth), rel=1e-5)
        assert hit.distance == pytest.approx(math.dist((*target, height), eye), rel=1e-5)


@pytest.mark.parametrize("holes", [False, True])
def test_rays_hit_what_all_triangles_say(holes):
    h = rough((34, 41), 5, holes)
    terrain = terrain_of(h)
    rng = np.random.default_rng(2)
    origins = np.column_stack([rng.uniform(-20, 60, 400), rng.uniform(-20, 60, 400), rng.uniform(300, 1200, 400)])
    ends = np.column_stack([rng.uniform(0, 40, 400), rng.uniform(0, 33, 400), rng.uniform(300, 700, 400)])
    directions = ends - origins
    to = np.column_stack([np.array(terrain.grid.xy(*ends[:, :2].T)).T, ends[:, 2]])
    start = np.column_stack([np.array(terrain.grid.xy(*origins[:, :2].T)).T, origins[:, 2]])
    found = [cast(terrain, o, t - o) for o, t in zip(start, to)]
    t = np.array([np.nan if f is None else f for f in found])
    sure = brute.check(h, origins, directions, t)
    assert sure.sum() > 200


def test_over_many_tiles_it_is_the_full_resolution_caster_s_hit_and_few_tiles_are_read(monkeypatch):
    h = rough((1100, 900), 7, True)
    terrain = terrain_of(h)
    caster = Caster.of(terrain.heights, 1)
    rng = np.random.default_rng(3)
    read, tiles = terrain.read, []
    monkeypatch.setattr(terrain, "read", lambda *w: tiles.append(w) or read(*w))
    hits = 0
    for k in range(300):
        a = np.array([rng.uniform(-400, 1300), rng.uniform(-400, 1500), rng.uniform(200, 900)])
        b = np.array([rng.uniform(0, 899), rng.uniform(0, 1099), rng.uniform(350, 650)])
        if k % 5 == 0:
            a[0], b[0] = (256.0 * round(a[0] / 256),) * 2  # along the border of tiles
        truth = caster.cast(a[None], (b - a)[None])[0][0]
        o, e = (np.array([*map(float, terrain.grid.xy(p[0], p[1])), p[2]]) for p in (a, b))
        found = cast(terrain, o, e - o)
        assert (found is None) == np.isnan(truth)
        if found is not None:
            hits += 1
            assert found == pytest.approx(truth, rel=1e-9, abs=1e-9)
    assert hits > 200
    assert len(tiles) < 300 * 6 and all(w[2] - w[1] <= 257 and w[4] - w[3] <= 257 for w in tiles)


def test_a_store_gives_the_same(tmp_path):
    h = rough((700, 600), 1)
    memory = terrain_of(h, crs="EPSG:32611")
    stored = store.build(store.ArraySource(h, memory.grid, "ground"), tmp_path / "g.oro")
    view = View((*map(float, memory.grid.xy(-50, 800)), 4000.0), (*map(float, memory.grid.xy(300, 350)), 500.0))
    for pixel in ((640, 360), (200, 500), (1000, 300.5)):
        assert pick(stored, view, pixel, 2.0) == pick(memory, view, pixel, 2.0)


def test_the_sky_and_holes_are_nothing_and_what_is_behind_a_hole_is_found():
    h = np.zeros((60, 60), np.float32)
    h[20:40, 20:40] = np.nan
    terrain = terrain_of(h)
    e, n = (float(v) for v in terrain.grid.xy(30, 30))
    down = View((e, n, 1000.0), (e, n, 0.0), width=100, height=100)
    assert pick(terrain, down, (50, 50)) is None
    level = View((e, n, 1000.0), (e + 1000, n, 1000.0), width=100, height=100)
    assert pick(terrain, level, (50, 20)) is None
    assert pick(terrain, down, (50, 0.0)) is not None
    assert place(terrain, (e, n)).height is None and place(terrain, (e, n)).slope is None
    assert math.isnan(slope_aspect(terrain, (e, n))[0])


def test_a_plan_is_picked_straight_down():
    h = rough((50, 50))
    terrain = terrain_of(h)
    e, n = (float(v) for v in terrain.grid.xy(25, 25))
    view = View((e, n, 9000.0), (e, n, 0.0), width=200, height=100, projection="plan")
    pixel, _ = view.project(np.array([*terrain.grid.xy(20.0, 23.0), 0.0]))
    hit = pick(terrain, view, tuple(pixel))
    assert hit is not None and hit.height == pytest.approx(float(h[23, 20]), abs=1e-3)


def test_near_and_far_count():
    terrain = terrain_of(np.zeros((50, 50)))
    e, n = (float(v) for v in terrain.grid.xy(25, 25))
    view = View((e, n, 1000.0), (e, n, 0.0), far=900.0)
    assert pick(terrain, view, (640, 360)) is None
    with pytest.raises(UsageError, match="pixel"):
        pick(terrain, view, (math.nan, 0))
    with pytest.raises(UsageError, match="exaggeration"):
        pick(terrain, view, (1, 1), 0.0)


@pytest.mark.parametrize("transform", [SQUARE, RECTANGULAR, ROTATED])
def test_a_plane_s_slope_and_aspect(transform):
    p, q = 0.25, -0.5  # rises to the east, falls to the north
    terrain = of_function((30, 30), lambda x, y: p * (x - 500_000) + q * (y - 4_000_000), transform)
    for point in points_in(terrain, np.random.default_rng(0), 20):
        slope, aspect = slope_aspect(terrain, point)
        assert slope == pytest.approx(math.degrees(math.atan(math.hypot(p, q))), abs=1e-3)
        assert aspect == pytest.approx(math.degrees(math.atan2(-p, -q)) % 360, abs=2e-3)


def test_slopes_are_true_where_the_projection_stretches():
    # Web Mercator at 60°: a grid metre is half a metre, so the ground is twice as steep as it is on the grid.
    from affine import Affine

    transform = Affine(30, 0, 1_000_000, 0, -30, 8_400_000)
    terrain = of_function((30, 30), lambda x, y: 0.25 * (x - 1_000_000), transform, "EPSG:3857")
    hit = place(terrain, (1_000_400, 8_399_600))
    _, vertical = EARTH.radii(hit.latitude)
    k = EARTH.a / (vertical * math.cos(math.radians(hit.latitude)))
    assert 1.9 < k < 2.1
    assert math.tan(math.radians(hit.slope)) == pytest.approx(0.25 * k / (1 + hit.height / 6371008), rel=1e-4)
    assert hit.aspect == pytest.approx(270, abs=1e-3) and hit.true_aspect == pytest.approx(270, abs=0.3)


def test_true_north_is_the_convergence_away_from_grid_north():
    from affine import Affine
    from pyproj import CRS, Proj

    transform = Affine(30, 0, 250_000, 0, -30, 5_000_000)  # at the western border of its zone
    terrain = of_function((30, 30), lambda x, y: 0.25 * (y - 5_000_000), transform, "EPSG:32612")
    hit = place(terrain, (250_400, 4_999_500))
    convergence = Proj(CRS(32612)).get_factors(hit.longitude, hit.latitude).meridian_convergence
    assert abs(convergence) > 2
    assert hit.aspect == pytest.approx(180, abs=1e-3)
    assert hit.true_aspect == pytest.approx(180 + convergence, abs=1e-3)


def test_at_samples_it_is_what_orograph_light_says():
    from orograph.lighting.context import Context
    from orograph.lighting.products import compute

    h = rough((40, 40), 2, True)
    terrain = terrain_of(h, RECTANGULAR)
    slope, aspect = (compute(Context(terrain), name)[0] for name in ("slope", "aspect"))
    checked = 0
    for r, c in np.random.default_rng(0).integers(0, 40, (300, 2)):
        found = slope_aspect(terrain, terrain.grid.xy(c, r))
        if math.isnan(found[0]):
            continue
        checked += 1
        assert found == pytest.approx((slope[r, c], aspect[r, c]), abs=1e-3)
    assert checked > 200


def test_level_ground_has_no_aspect():
    hit = place(terrain_of(np.full((9, 9), 7.0)), (500_100, 3_999_900))
    assert hit.slope == 0 and hit.aspect is None and hit.true_aspect is None and hit.height == 7
