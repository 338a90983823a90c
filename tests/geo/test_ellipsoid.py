"""Geodetic ⇄ geocentric against PROJ, the EPSG guidance note, published radii, and its own inverse."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pyproj import CRS, Transformer

from orograph.geo import BODIES, EARTH, MARS, MOON, Ellipsoid

lons = st.floats(-180, 180)
lats = st.floats(-90, 90)
heights = st.floats(-11000, 1e7)


def table(shared_data: Path) -> np.ndarray:
    with (shared_data / "geodesy-truth" / "wgs84_ecef_enu_pyproj.csv").open() as file:
        return np.array([[float(v) for v in row.values()] for row in csv.DictReader(file)])


def test_ecef_of_the_truth_table(shared_data: Path) -> None:
    """The table gives angles to 1e-9 degrees, which is 0.1 mm."""
    rows = table(shared_data)
    assert len(rows) >= 50
    np.testing.assert_allclose(EARTH.ecef(rows[:, [4, 3, 5]]), rows[:, 6:9], rtol=0, atol=1e-4)


def test_geodetic_of_the_truth_table(shared_data: Path) -> None:
    rows = table(shared_data)
    found = EARTH.geodetic(rows[:, 6:9])
    np.testing.assert_allclose(found[:, 1], rows[:, 3], rtol=0, atol=5.1e-10)
    np.testing.assert_allclose(found[:, 2], rows[:, 5], rtol=0, atol=3e-9)
    turn = (found[:, 0] - rows[:, 4] + 180) % 360 - 180
    np.testing.assert_allclose(turn * np.cos(np.radians(rows[:, 3])), 0, atol=5.1e-10)


@pytest.mark.parametrize("name", sorted(BODIES))
@given(lons, lats, heights)
def test_ecef_is_that_of_proj(name: str, lon: float, lat: float, height: float) -> None:
    body = BODIES[name]
    proj = Transformer.from_pipeline(f"+proj=cart +a={body.a!r} +b={body.b!r}")
    scale = body.a + abs(height)
    assert np.allclose(body.ecef([lon, lat, height]), proj.transform(lon, lat, height), rtol=0, atol=4e-16 * scale * 4)


@pytest.mark.parametrize("name", sorted(BODIES))
@given(lons, st.floats(-89.999, 89.999), st.floats(-11000, 1e9))
def test_the_inverse_undoes_it(name: str, lon: float, lat: float, height: float) -> None:
    body = BODIES[name]
    scale = 1 + abs(height) / body.a
    back = body.geodetic(body.ecef([lon, lat, height]))
    assert abs(back[1] - lat) < 1e-13 * 90
    assert abs(back[2] - height) < 8e-9 * scale
    assert abs((back[0] - lon + 180) % 360 - 180) < 1e-12 / np.cos(np.radians(lat))


@given(st.floats(-6.3e6, 6.3e6), st.floats(-6.3e6, 6.3e6), st.floats(-6.3e6, 6.3e6))
@example(0.0, 0.0, 3.134223416023137e-150)
@example(2e4, 0.0, -1e-155)
@example(1e-150, 0.0, 1e-149)
def test_the_inverse_holds_inside_the_body(x: float, y: float, z: float) -> None:
    """Deep inside, other methods fail; geodetic → ECEF must give the point back from anywhere, the evolute included."""
    np.testing.assert_allclose(EARTH.ecef(EARTH.geodetic([x, y, z])), [x, y, z], rtol=0, atol=2e-8)


@pytest.mark.parametrize(
    "point", [(0, 0, 0), (0, 0, 6356752.3), (0, 0, -10.0), (1e4, 0, 0), (0, -4e4, 0), (42841.3, 0, 0)]
)
def test_the_inverse_on_the_axis_and_in_the_singular_disc(point: tuple[float, float, float]) -> None:
    for body in (EARTH, MARS, MOON):
        np.testing.assert_allclose(body.ecef(body.geodetic(point)), point, rtol=0, atol=1e-8)


def test_example_of_the_epsg_guidance_note() -> None:
    """IOGP 373-7-2, method 9602: 53°48'33.820"N, 2°07'46.380"E, 73.0 m (WGS 84), given to the millimetre."""
    lat, lon = 53 + 48 / 60 + 33.820 / 3600, 2 + 7 / 60 + 46.380 / 3600
    np.testing.assert_allclose(
        EARTH.ecef([lon, lat, 73.0]), [3771793.968, 140253.342, 5124304.349], rtol=0, atol=1.5e-3
    )


def test_published_radii() -> None:
    assert (EARTH.a, round(EARTH.b, 4)) == (6378137.0, 6356752.3142)  # NGA TR8350.2
    assert (MOON.a, MOON.b) == (1737400.0, 1737400.0)  # IAU 2015
    assert (MARS.a, round(MARS.b, 6)) == (3396190.0, 3376200.0)  # IAU 2015
    for body, code in ((EARTH, "EPSG:4326"), (MOON, "IAU_2015:30100"), (MARS, "IAU_2015:49901")):
        other = Ellipsoid.of(CRS(code))
        assert other.a == body.a and other.b == pytest.approx(body.b, abs=1e-6)


@given(lats)
def test_degree_lengths_are_those_along_the_curves(lat: float) -> None:
    """A finite difference of ECEF along the meridian and the parallel."""
    lat = float(np.clip(lat, -89.9, 89.9))
    d = 1e-4
    for body in (EARTH, MARS, MOON):
        x, y = body.degree_lengths(lat)
        east, west = body.ecef([[d / 2, lat, 0], [-d / 2, lat, 0]])
        north, south = body.ecef([[0, lat + d / 2, 0], [0, lat - d / 2, 0]])
        assert np.linalg.norm(east - west) / d == pytest.approx(x, rel=1e-8, abs=1e-4)
        assert np.linalg.norm(north - south) / d == pytest.approx(y, rel=1e-8)


def test_many_points_are_each_point() -> None:
    rng = np.random.default_rng(1)
    points = np.stack([rng.uniform(-180, 180, 500), rng.uniform(-90, 90, 500), rng.uniform(-1e4, 1e4, 500)], -1)
    together = EARTH.geodetic(EARTH.ecef(points.reshape(5, 100, 3)))
    assert together.shape == (5, 100, 3)
    one_by_one = np.array([EARTH.geodetic(EARTH.ecef(p)) for p in points])
    np.testing.assert_allclose(together.reshape(-1, 3), one_by_one, rtol=0, atol=8e-9)


@pytest.mark.parametrize("a,f", [(-1, 0), (1, 1), (1, -0.1), (float("inf"), 0), (0, 0)])
def test_impossible_ellipsoids_are_refused(a: float, f: float) -> None:
    with pytest.raises(ValueError, match="ellipsoid"):
        Ellipsoid("x", a, f)
    with pytest.raises(ValueError, match=r"\(\.\.\., 3\)"):
        EARTH.ecef([1.0, 2.0])
