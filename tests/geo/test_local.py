"""East-north-up frames against the truth table, PROJ's topocentric conversion and the EPSG example."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

from orograph.geo import EARTH, LocalFrame


def test_the_truth_table(shared_data: Path) -> None:
    """The table gives angles to 1e-9 degrees, which is 0.1 mm here and there."""
    with (shared_data / "geodesy-truth" / "wgs84_ecef_enu_pyproj.csv").open() as file:
        rows = np.array([[float(v) for v in row.values()] for row in csv.DictReader(file)])
    for row in rows:
        frame = LocalFrame(row[1], row[0], row[2])
        np.testing.assert_allclose(frame.from_ecef(row[6:9]), row[9:12], rtol=0, atol=2e-4)
        np.testing.assert_allclose(frame.from_geodetic(row[[4, 3, 5]]), row[9:12], rtol=0, atol=2e-4)
        np.testing.assert_allclose(frame.to_ecef(row[9:12]), row[6:9], rtol=0, atol=2e-4)


def test_example_of_the_epsg_guidance_note() -> None:
    """IOGP 373-7-2, methods 9836 and 9837 (also in PROJ's builtins.gie), given to the millimetre."""
    frame = LocalFrame(5.0, 55.0, 200.0)
    np.testing.assert_allclose(
        frame.from_geodetic([2.12955, 53.80939444444444, 73.0]), [-189013.869, -128642.040, -4220.171], atol=6e-4
    )
    np.testing.assert_allclose(
        frame.from_ecef([3771793.968, 140253.342, 5124304.349]), [-189013.869, -128642.040, -4220.171], atol=1e-3
    )


@given(
    st.floats(-180, 180),
    st.floats(-90, 90),
    st.floats(-1000, 9000),
    st.floats(-180, 180),
    st.floats(-90, 90),
    st.floats(-1e3, 1e4),
)
def test_it_is_that_of_proj(lon0: float, lat0: float, h0: float, lon: float, lat: float, h: float) -> None:
    proj = Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        f"+lon_0={lon0:.17f} +lat_0={lat0:.17f} +h_0={h0:.17f}"
    )
    frame = LocalFrame(lon0, lat0, h0)
    np.testing.assert_allclose(frame.from_geodetic([lon, lat, h]), proj.transform(lon, lat, h), rtol=0, atol=2e-8)


@given(
    st.floats(-180, 180), st.floats(-90, 90), st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 3), min_size=1, max_size=5)
)
def test_there_and_back(lon: float, lat: float, points: list[tuple[float, float, float]]) -> None:
    frame = LocalFrame(lon, lat, 123.0)
    np.testing.assert_allclose(frame.from_ecef(frame.to_ecef(points)), points, rtol=0, atol=4e-9)
    np.testing.assert_allclose(frame.from_geodetic(frame.to_geodetic(points)), points, rtol=0, atol=4e-8)


def test_the_axes_are_east_north_up() -> None:
    frame = LocalFrame(30.0, 60.0)
    np.testing.assert_allclose(frame.axes @ frame.axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(frame.axes) > 0
    np.testing.assert_allclose(frame.from_geodetic([30.0, 60.0, 50.0]), [0, 0, 50.0], atol=2e-9)
    east, north = frame.from_geodetic([[30.001, 60.0, 0], [30.0, 60.001, 0]])
    assert east[0] > 50 and abs(east[1]) < 0.01 and north[1] > 100 and abs(north[0]) < 1e-6
    assert LocalFrame(30.0, 60.0, ellipsoid=EARTH) == frame
