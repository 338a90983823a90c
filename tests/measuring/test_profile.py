"""Lengths along the ground: closed forms, properties, holes, tables."""

from __future__ import annotations

import csv
import math

import brute
import numpy as np
import pytest
from affine import Affine
from closed_forms import RECTANGULAR, ROTATED, SQUARE, of_function, points_in, rough, terrain_of
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph import store
from orograph.errors import OutputError, UsageError
from orograph.measuring import profile
from orograph.measuring.ground import own_heights
from orograph.measuring.places import Places

ROUGH = {t: terrain_of(rough((30, 33), 4), t) for t in (SQUARE, RECTANGULAR, ROTATED)}


@pytest.mark.parametrize("transform", [SQUARE, RECTANGULAR, ROTATED])
def test_on_a_plane_ground_and_straight_are_one(transform):
    terrain = of_function((50, 60), lambda x, y: 0.5 * (x - 500_000) + 0.25 * (y - 4_000_000), transform)
    for a, b in points_in(terrain, np.random.default_rng(0), 40).reshape(-1, 2, 2):
        dx, dy = b - a
        truth = math.sqrt(dx * dx + dy * dy + (0.5 * dx + 0.25 * dy) ** 2)
        found = profile(terrain, [a, b])
        assert found.length == pytest.approx(truth, rel=1e-6)  # heights are float32
        assert found.straight == pytest.approx(truth, rel=1e-6)
        assert [found.grid, found.distance[-1]] == pytest.approx([math.hypot(dx, dy)] * 2)
        assert found.climb - found.descent == pytest.approx(0.5 * dx + 0.25 * dy, abs=1e-3)
        assert found.geodesic is None and found.missing == 0


def test_over_a_cone_s_top():
    # Along a row of samples through the top the triangulated cone is the cone.
    terrain = of_function((41, 41), lambda x, y: 1000 - 0.75 * np.hypot(x - 500_615, y - 3_999_385))
    a, b = (500_015, 3_999_385), (501_215, 3_999_385)
    found = profile(terrain, [a, b])
    assert found.length == pytest.approx(1200 * 1.25, rel=1e-6)
    assert (found.climb, found.descent) == pytest.approx((450, 450), abs=1e-3)
    assert found.highest == pytest.approx(1000) and found.straight == pytest.approx(1200)


def test_over_a_sphere_s_cap_it_is_the_arc():
    radius, half = 2000.0, 1200.0
    terrain = of_function((81, 81), lambda x, y: np.sqrt(radius**2 - (x - 501_215) ** 2 - (y - 3_998_785) ** 2))
    found = profile(terrain, [(501_215 - half, 3_998_785), (501_215 + half, 3_998_785)])
    arc = 2 * radius * math.asin(half / radius)
    # Inscribed chords of at most 30 m / cos(slope) each: short by (chord / radius)² / 24.
    assert arc * (1 - (30 / 0.8 / radius) ** 2 / 24) - 1e-2 < found.length < arc + 1e-2


def test_true_metres_at_a_height_are_geodesic_metres_lifted():
    crs, transform = "EPSG:32611", Affine(100, 0, 300_000, 0, -100, 4_000_000)
    terrain = of_function((300, 300), lambda x, y: 3000 + 0 * x, transform, crs)
    found = profile(terrain, [(302_000, 3_998_000), (320_000, 3_975_000)])
    assert found.geodesic is not None
    assert found.distance[-1] == pytest.approx(found.geodesic, rel=1e-7)
    assert found.length == pytest.approx(found.geodesic * (1 + 3000 / 6_371_008.8), rel=2e-7)
    assert found.grid == pytest.approx(math.hypot(18_000, 23_000))
    assert found.grid / found.geodesic - 1 == pytest.approx(6.5e-5, abs=3e-5)  # 180 km west of the middle of the zone
    ends = Places(terrain).ecef(found.points[[0, -1]], np.array([3000.0, 3000.0]))
    assert found.straight == pytest.approx(math.dist(*ends), abs=1e-9)
    radius = 6_371_008.8  # the chord of that arc
    assert found.straight == pytest.approx(2 * (radius + 3000) * math.sin(found.geodesic / 2 / radius), rel=3e-6)


def test_in_web_mercator_the_grid_is_twice_as_long_as_the_ground_at_60_degrees():
    transform = Affine(100, 0, 1_000_000, 0, -100, 8_400_000)
    terrain = terrain_of(np.zeros((200, 200)), transform, "EPSG:3857")
    found = profile(terrain, [(1_001_000, 8_399_000), (1_019_000, 8_382_000)])
    assert found.scale == pytest.approx(1.99, abs=0.02)
    assert found.length == pytest.approx(found.geodesic, rel=1e-5)  # the grid's straight line is not the shortest
    assert found.length >= found.geodesic


UNIT = st.floats(0, 1, allow_nan=False)
LINES = st.lists(st.tuples(UNIT, UNIT), min_size=2, max_size=5, unique=True)


def _line(terrain, corners):
    rows, cols = terrain.grid.shape
    u = np.array(corners)
    return np.stack(terrain.grid.xy(u[:, 0] * (cols - 1), u[:, 1] * (rows - 1)), axis=-1)


@given(LINES, st.sampled_from(list(ROUGH)))
@settings(max_examples=150)
def test_the_ground_is_no_shorter_than_straight_and_the_way_back_is_as_long(corners, transform):
    terrain = ROUGH[transform]
    line = _line(terrain, corners)
    if np.hypot(*np.diff(line, axis=0).T).sum() < 1e-3:
        return
    there, back = profile(terrain, line), profile(terrain, line[::-1])
    assert there.length >= there.straight * (1 - 1e-12)
    assert there.length >= there.distance[-1] * (1 - 1e-12)
    assert back.length == pytest.approx(there.length, rel=1e-9, abs=1e-6)
    assert (back.climb, back.descent) == pytest.approx((there.descent, there.climb), abs=1e-6)


@given(LINES, UNIT, st.sampled_from(list(ROUGH)))
@settings(max_examples=150)
def test_pieces_add_up(corners, cut, transform):
    terrain = ROUGH[transform]
    line = _line(terrain, corners[:2])
    if math.dist(*line) < 1e-3:
        return
    middle = line[0] + cut * (line[1] - line[0])
    whole = profile(terrain, line)
    parts = [profile(terrain, p) for p in ((line[0], middle), (middle, line[1])) if math.dist(*p) > 0]
    # The middle is rounded to 1e-9 m beside the line, where a steep edge is elsewhere.
    assert sum(p.length for p in parts) == pytest.approx(whole.length, rel=1e-9, abs=1e-5)
    assert sum(p.climb for p in parts) == pytest.approx(whole.climb, abs=1e-5)
    joined = profile(terrain, [line[0], middle, line[1]])
    assert joined.length == pytest.approx(whole.length, rel=1e-9, abs=1e-5)


def test_walking_in_small_steps_comes_to_the_same():
    h = rough((30, 30), 9)
    found = profile(terrain_of(h), [(500_100, 3_999_900), (500_700, 3_999_300), (500_050, 3_999_500)])
    short = []
    for steps in (20_000, 200_000):
        t = np.linspace(0, 1, steps + 1)
        total = 0.0
        for a, b in ((0, 1), (1, 2)):
            ends = found.points[found.vertices[[a, b]]]
            p = ends[0] + t[:, None] * (ends[1] - ends[0])
            x, y = terrain_of(h).grid.index(p[:, 0], p[:, 1])
            z = brute._height(h, x, y)
            total += np.hypot(np.hypot(*np.diff(p, axis=0).T), np.diff(z)).sum()
        short.append(found.length - total)
    # Each bend is cut short by less than a step.
    assert 0 < short[1] < 0.15 * short[0] < 0.15 * 1e-4 * found.length


def test_holes_are_told_not_bridged():
    h = np.zeros((20, 20), np.float32)
    h[:, 8:12] = np.nan
    found = profile(terrain_of(h), [(500_045, 3_999_700), (500_555, 3_999_700)])
    assert found.missing == pytest.approx(5 * 30) and found.length == pytest.approx(510)
    assert found.bridged == pytest.approx(150)
    assert found.straight == pytest.approx(510) and np.isnan(found.heights).any() and found.lowest == 0
    _, heights, ground = found.at([100, 500_255 - 500_045 + 75])
    assert heights[0] == 0 and math.isnan(heights[1]) and ground[1] == pytest.approx(285)
    inside = profile(terrain_of(h), [(500_300, 3_999_700), (500_320, 3_999_700)])
    assert inside.straight is None and inside.lowest is None
    assert inside.length == inside.bridged == pytest.approx(20)


def test_lowest_and_highest_are_those_of_bilinear_ground():
    """Between the places where the line crosses edges, too: as brute force finds them at a hundred thousand places."""
    rng = np.random.default_rng(5)
    terrain = terrain_of(rng.normal(0, 50, (12, 12)).astype(np.float32))
    for _ in range(20):
        ends = 500_015 + rng.uniform(0, 330, 2), 3_999_985 - rng.uniform(0, 330, 2)
        line = np.stack(ends, axis=1)
        found = profile(terrain, line)
        dense = line[0] + np.linspace(0, 1, 100_001)[:, None] * (line[1] - line[0])
        truth = own_heights(terrain, dense)
        assert truth.min() - 0.02 < found.lowest <= truth.min() + 1e-9  # (3 mm from place to place of the truth)
        assert truth.max() - 1e-9 <= found.highest < truth.max() + 0.02


def test_at_and_rows_are_exact():
    terrain = ROUGH[SQUARE]
    found = profile(terrain, [(500_100, 3_999_900), (500_700, 3_999_300)])
    rows = found.rows(every=7.0)
    assert len(rows) == math.ceil(found.distance[-1] / 7.0) + 1
    for row in rows[::9]:
        at = terrain.grid.index(row["easting"], row["northing"])
        assert row["surface_height_m"] == pytest.approx(float(brute._height(terrain.heights, *at)), abs=1e-6)
    assert rows[-1]["ground_m"] == pytest.approx(found.length)
    with pytest.raises(UsageError, match="positive"):
        found.rows(every=0)
    with pytest.raises(UsageError, match="ten million"):
        found.rows(every=1e-9)
    with pytest.raises(UsageError, match="from 0 to"):
        found.at(-1.0)


def test_the_table_reads_back(tmp_path):
    h = rough((30, 33), 4)
    h[10] = np.nan
    found = profile(terrain_of(h, SQUARE, "EPSG:32611"), [(500_100, 3_999_900), (500_700, 3_999_300)])
    found.save(tmp_path / "p.csv")
    with (tmp_path / "p.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    names = ["distance_m", "ground_m", "easting", "northing", "longitude", "latitude", "height_m", "surface_height_m"]
    assert list(table[0]) == names
    assert len(table) == len(found.heights)
    z = np.array([float(r["height_m"] or "nan") for r in table])
    np.testing.assert_allclose(z, found.heights, atol=6e-4)
    surface = np.array([float(r["surface_height_m"] or "nan") for r in table])
    np.testing.assert_allclose(surface, found.surface_heights, atol=6e-4)
    assert np.isnan(z).any()
    np.testing.assert_allclose([float(r["longitude"]) for r in table], found.lonlat[:, 0], atol=1e-8)
    with pytest.raises(OutputError, match="folder"):
        found.save(tmp_path / "no" / "p.csv")


def test_a_store_gives_the_same_and_is_read_by_tiles(tmp_path, monkeypatch):
    h = rough((1100, 900), 2)
    memory = terrain_of(h, crs="EPSG:32611")
    stored = store.build(store.ArraySource(h, memory.grid, "ground"), tmp_path / "g.oro")
    line = np.stack(memory.grid.xy([10.2, 880.7], [1090.1, 3.3]), axis=-1)
    read, windows = stored.read, []
    monkeypatch.setattr(stored, "read", lambda *w: windows.append(w) or read(*w))
    a, b = profile(memory, line), profile(stored, line)
    assert a.length == b.length and (a.surface_heights == b.surface_heights).all()
    assert len(windows) < 12 and all(w[2] - w[1] <= 257 and w[4] - w[3] <= 257 for w in windows)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ([(500_100, 3_999_900)], "at least 2 points"),
        ([(500_100, 3_999_900)] * 3, "no length"),
        ([(500_100, 3_999_900), (499_000, 3_999_900)], "1015 m west of ground"),
        ([(500_100, 3_999_900), (math.inf, 3_999_900)], "finite"),
    ],
)
def test_what_is_no_line_is_refused(line, says):
    with pytest.raises(UsageError, match=says):
        profile(ROUGH[SQUARE], line)


@pytest.mark.parametrize("crs", [None, "EPSG:32611"])
def test_a_hole_in_a_plane_changes_no_length_and_says_what_is_bridged(crs):
    def plane(x, y):
        return 300 + 0.4 * (x - 500_000) - 0.3 * (y - 4_000_000)

    whole = of_function((30, 40), plane, crs=crs)
    h = whole.read(0, 0, 30, 0, 40).copy()
    h[8:15, 10:22] = np.nan
    route = [(500_050, 3_999_950), (500_480, 3_999_640), (500_900, 3_999_300)]  # a corner lies in the hole
    full, holed = profile(whole, route), profile(terrain_of(h, crs=crs), route)
    assert holed.missing > 200 and holed.bridged / holed.missing > 1.05
    for name in ("length", "ground_grid", "straight", "climb", "descent"):
        assert getattr(holed, name) == pytest.approx(getattr(full, name), rel=1e-7), name
    assert full.bridged == full.missing == 0


def test_a_line_over_a_hole_is_never_shorter_than_straight_and_climbs_from_end_to_end():
    h = rough((40, 50), 3, holes=True)
    terrain = terrain_of(h, crs="EPSG:32611")
    rng = np.random.default_rng(1)
    bridged = 0
    for _ in range(40):
        ends = np.stack(terrain.grid.xy(rng.uniform(0, 49, 2), rng.uniform(0, 39, 2)), axis=-1)
        found = profile(terrain, ends)
        bridged += found.bridged > 0
        if found.straight is not None:
            assert found.length >= found.straight * (1 - 1e-12)
            rise = found.surface_heights[-1] - found.surface_heights[0]
            assert found.climb - found.descent == pytest.approx(rise, abs=1e-6)
    assert bridged > 5


def test_at_a_hole_at_the_end_of_a_line_the_bridge_is_level():
    h = np.full((20, 30), 100.0, np.float32)
    h[:, 20:] = np.nan
    found = profile(terrain_of(h), [(500_015, 3_999_900), (500_015 + 25 * 30, 3_999_900)])
    assert found.bridged == found.missing == pytest.approx(6 * 30)
    assert found.length == pytest.approx(25 * 30) and found.straight is None
