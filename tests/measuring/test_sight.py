"""Lines of sight: horizons, walls and needed heights in closed form; sampled finely; properties."""

from __future__ import annotations

import math

import brute
import numpy as np
import pytest
from affine import Affine
from closed_forms import RECTANGULAR, ROTATED, SQUARE, of_function, points_in, rough, terrain_of
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph.errors import ReadError, UsageError
from orograph.measuring import line_of_sight
from orograph.measuring.places import Places

SEA = terrain_of(np.zeros((40, 400)), Affine(250, 0, 0, 0, -250, 0))
R = 6_371_008.8


def at(x):
    return (125.0 + x, -5000.0)


@pytest.mark.parametrize("refraction", [0.0, 0.13])
@pytest.mark.parametrize("eye", [1.7, 25.0])
def test_the_sea_s_horizon(eye, refraction):
    horizon = math.sqrt(2 * R / (1 - refraction) * eye)
    seen = line_of_sight(SEA, at(0), at(horizon - 60), eye, refraction=refraction)
    hidden = line_of_sight(SEA, at(0), at(horizon + 900), eye, refraction=refraction)
    assert seen.visible and seen.obstruction is None and seen.needed == 0
    assert not hidden.visible
    beyond = line_of_sight(SEA, at(0), at(2.5 * horizon), eye, refraction=refraction)
    assert beyond.needed == pytest.approx((1.5 * horizon) ** 2 * (1 - refraction) / 2 / R, rel=1e-9)
    assert not line_of_sight(SEA, at(0), at(2.5 * horizon), eye, 0.999 * beyond.needed, refraction=refraction).visible
    tall = line_of_sight(SEA, at(0), at(2.5 * horizon), eye, 1.001 * beyond.needed, refraction=refraction)
    assert tall.visible and tall.tightest.distance == pytest.approx(horizon, rel=2e-3)  # it grazes the horizon
    assert tall.tightest.clearance == pytest.approx(0.001 * beyond.needed / 2.5, rel=0.01)


def test_over_the_plane_without_curvature_everything_is_seen():
    assert line_of_sight(SEA, at(0), at(90_000), 1e-3, flat=True).visible
    lowest = line_of_sight(SEA, at(0), at(90_000), 2.0, 2.0)
    # The line sags below the sea's bulge, deepest in the middle: s²/8R' less the eyes' 2 m.
    assert lowest.tightest.clearance == pytest.approx(2 - 90_000**2 * 0.87 / 8 / R, rel=1e-4)
    assert lowest.tightest.distance == pytest.approx(45_000, abs=1)


def test_a_wall():
    h = np.zeros((9, 60), np.float32)
    h[:, 20] = 40.0
    terrain = terrain_of(h)  # 30 m
    a, b = terrain.grid.xy(0.0, 4.0), terrain.grid.xy(50.0, 4.0)
    found = line_of_sight(terrain, a, b, 10.0, 0.0, flat=True)
    assert not found.visible
    assert found.needed == pytest.approx(10 + (40 - 10) / (20 * 30) * 50 * 30)
    # The line falls 10 m in 1500 m and meets the wall's slope, 40 m in 30 m, where both are as high.
    s = (10 + 19 * 40) / (40 / 30 + 10 / 1500)
    assert found.obstruction.distance == pytest.approx(s)
    assert found.obstruction.height == pytest.approx(10 - s * 10 / 1500)
    assert found.obstruction.clearance == pytest.approx(0, abs=1e-9)
    assert (found.obstruction.easting, found.obstruction.northing) == pytest.approx((500_015 + s, 3_999_985 - 120))
    assert found.tightest.distance == pytest.approx(600) and found.tightest.clearance == pytest.approx(-34)
    assert line_of_sight(terrain, a, b, 10.0, found.needed + 1e-3, flat=True).visible
    assert not line_of_sight(terrain, a, b, 10.0, found.needed - 1e-2, flat=True).visible


@pytest.mark.parametrize("transform", [SQUARE, RECTANGULAR, ROTATED])
def test_it_is_what_a_fine_sampling_says(transform):
    h = rough((30, 33), 5, True)
    terrain = terrain_of(h, transform)
    rng = np.random.default_rng(0)
    counts = [0, 0]
    for _ in range(150):
        a, b = points_in(terrain, rng, 2)
        x, y = terrain.grid.index(*np.stack([a, b]).T)
        t = np.linspace(0, 1, 8001)
        z = brute._height(h, x[0] + t * (x[1] - x[0]), y[0] + t * (y[1] - y[0]))
        if np.isnan(z[[0, -1]]).any():
            with pytest.raises(UsageError, match="hole"):
                line_of_sight(terrain, a, b)
            continue
        s = t * math.dist(a, b)
        drop = 0.87 / 2 / R * s**2
        clear = z[0] + 20 + t * (z[-1] + 5 - drop[-1] - z[0] - 20) - (z - drop)
        found = line_of_sight(terrain, a, b, 20.0, 5.0)
        least = float(np.nanmin(clear))
        if abs(least) < 1e-2:
            continue
        assert found.visible == (least > 0)
        counts[found.visible] += 1
        if found.visible:
            continue
        assert found.tightest.clearance == pytest.approx(least, abs=0.1) and found.tightest.clearance <= least + 1e-9
        first = s[np.flatnonzero(clear < 0)[0]]
        assert first - s[1] - 1e-9 <= found.obstruction.distance <= first + 1e-9
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.nanmax((z - drop - z[0] - 20)[1:] / s[1:])
        assert found.needed == pytest.approx(max(0, z[0] + 20 + slope * s[-1] - (z[-1] - drop[-1])), abs=0.5, rel=1e-2)
    assert min(counts) > 10


@given(st.tuples(*[st.floats(0.0, 29.0)] * 4), st.floats(0, 80), st.floats(0, 80))
@settings(max_examples=150)
def test_who_sees_is_seen(samples, one, other):
    terrain = terrain_of(rough((30, 30), 8))
    a, b = (np.array(terrain.grid.xy(*p)) for p in (samples[:2], samples[2:]))
    if math.dist(a, b) < 1.0:
        return
    there, back = line_of_sight(terrain, a, b, one, other), line_of_sight(terrain, b, a, other, one)
    least = min((m.clearance for m in (there.tightest, back.tightest) if m is not None), default=1.0)
    if abs(least) > 1e-3:  # the drop at s from one end and from the other round differently
        assert there.visible == back.visible
    if there.tightest is not None and not there.visible and not back.visible:
        assert there.tightest.clearance == pytest.approx(back.tightest.clearance, abs=1e-6)


def test_gauss_s_radius_at_the_eye_counts():
    terrain = terrain_of(np.zeros((20, 400)), Affine(250, 0, 300_000, 0, -250, 4_000_000), "EPSG:32611")
    a, b = (310_000, 3_998_000), (390_000, 3_998_000)
    found = line_of_sight(terrain, a, b, 2.0, refraction=0.1)
    places = Places(terrain)
    body, lat = places.ellipsoid, places.geodetic(np.array([a], float))[0, 1]
    m, n = body.radii(lat)
    assert found.bend == pytest.approx(0.9 / math.sqrt(m * n), rel=1e-12)
    d = float(found.profile.distance[-1])
    assert d == pytest.approx(found.profile.geodesic, rel=1e-6)  # true metres, not the grid's
    assert found.needed == pytest.approx((d - math.sqrt(2 * 2.0 / found.bend)) ** 2 * found.bend / 2, rel=1e-9)


def test_holes_hide_nothing_and_are_told():
    h = np.zeros((9, 60), np.float32)
    h[:, 20] = 40.0
    h[:, 19:22] = np.nan
    terrain = terrain_of(h)
    found = line_of_sight(terrain, terrain.grid.xy(0.0, 4.0), terrain.grid.xy(50.0, 4.0), 2.0, flat=True)
    assert found.visible and found.profile.missing == pytest.approx(4 * 30)


@pytest.mark.parametrize("what", [{"eye": -1.0}, {"target": math.nan}, {"refraction": 1.0}])
def test_nonsense_is_refused(what):
    with pytest.raises(UsageError):
        line_of_sight(SEA, at(0), at(1000), **what)
    with pytest.raises(UsageError, match="no length"):
        line_of_sight(SEA, at(0), at(0))
    with pytest.raises(UsageError, match="two points"):
        line_of_sight(SEA, [at(0), at(10)], at(20))


@pytest.mark.stress
def test_plots(tmp_path, monkeypatch):
    from PIL import Image

    from orograph.measuring import profile

    terrain = of_function((50, 50), lambda x, y: 300 + 100 * np.sin(x / 200) * np.cos(y / 150))
    h = terrain.heights.copy()
    h[20:24] = np.nan
    holed = terrain_of(h)
    ends = [(500_100, 3_999_900), (501_400, 3_998_600)]
    for made, name in ((profile(terrain, ends), "a.png"), (profile(holed, ends), "b.svg")):
        assert made.save(tmp_path / name) == tmp_path / name
    sights = [line_of_sight(t, *ends, e) for t, e in ((terrain, 2.0), (terrain, 900.0), (holed, 2.0))]
    assert [s.visible for s in sights][:2] == [False, True]
    for k, sight in enumerate(sights):
        sight.save(tmp_path / f"s{k}.png")
        with Image.open(tmp_path / f"s{k}.png") as image:
            colors = {tuple(c) for c in np.asarray(image.convert("RGB")).reshape(-1, 3)}
        assert ((198, 47, 29) in colors) == (not sight.visible)  # the mark
    assert "Profile over ground" in (tmp_path / "b.svg").read_text() or "<svg" in (tmp_path / "b.svg").read_text()
    with pytest.raises(UsageError, match=r"\.svg"):
        profile(terrain, ends).save(tmp_path / "a.txt")
    with pytest.raises(UsageError, match=r"\.csv, \.png"):
        sights[0].save(tmp_path / "a.geojson")
    assert sights[0].save(tmp_path / "s.csv").read_text().startswith("distance_m,")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ReadError, match=r"orograph\[sample\]"):
        profile(terrain, ends).save(tmp_path / "c.png")
