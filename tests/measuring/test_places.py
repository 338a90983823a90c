"""True metres against PROJ's own factors and geodesics; where points may be."""

from __future__ import annotations

import re

import numpy as np
import pytest
from affine import Affine
from closed_forms import ROTATED, terrain_of
from pyproj import CRS, Proj

from orograph.errors import UsageError
from orograph.measuring import Places

FLAT = np.zeros((40, 50), np.float32)
CONFORMAL = [
    ("EPSG:32611", (420_000, 4_000_000)),
    ("EPSG:3395", (1_000_000, 8_400_000)),
    ("EPSG:2154", (700_000, 6_600_000)),
    ("EPSG:3995", (1_000_000, -500_000)),
]


@pytest.mark.parametrize(("crs", "origin"), CONFORMAL)
def test_a_conformal_projection_has_proj_s_scale_and_convergence(crs, origin):
    places = Places(terrain_of(FLAT, Affine(30, 0, origin[0], 0, -30, origin[1]), crs))
    point = np.add(origin, (700.0, -600.0))
    lon, lat = places.geodetic(point[None])[0]
    factors = Proj(CRS(crs)).get_factors(lon, lat)
    k = factors.meridional_scale
    assert factors.parallel_scale == pytest.approx(k, rel=1e-8)
    np.testing.assert_allclose(places.metric(point[None])[0], np.eye(2) / k**2, atol=2e-8)
    j = places.jacobian(point)
    # Grid north, seen from true north: minus the convergence of the meridian.
    assert np.degrees(np.arctan2(j[0, 1], j[1, 1])) == pytest.approx(factors.meridian_convergence, abs=1e-5)


def test_an_equal_area_projection_keeps_areas_and_its_lengths_are_geodesic():
    crs = "EPSG:3035"
    places = Places(terrain_of(FLAT, Affine(30, 0, 7_400_000, 0, -30, 4_800_000), crs))
    point = np.array([7_400_700.0, 4_799_400.0])
    g = places.metric(point[None])[0]
    assert np.linalg.det(g) == pytest.approx(1.0, abs=1e-8)
    assert g[0, 0] != pytest.approx(1.0, abs=1e-3)  # not conformal: lengths depend on direction
    for step in ([40.0, 0.0], [0.0, 40.0], [25.0, -31.0]):
        ends = places.geodetic(np.stack([point - step, point + step]))
        metres = places.geod.line_length(*ends.T)
        assert 2 * np.sqrt(step @ g @ np.array(step)) == pytest.approx(metres, rel=1e-8)


def test_web_mercator_is_not_conformal_on_the_ellipsoid():
    # PROJ's factors are those of the sphere it draws; on WGS 84 it is a / (N cos φ) eastward, a / (M cos φ) northward.
    places = Places(terrain_of(FLAT, Affine(30, 0, 1_000_000, 0, -30, 8_400_000), "EPSG:3857"))
    point = np.array([[1_000_700.0, 8_399_400.0]])
    lat = places.geodetic(point)[0, 1]
    meridian, vertical = places.ellipsoid.radii(lat)
    k = 6378137.0 / np.array([vertical, meridian]) / np.cos(np.radians(lat))
    assert k[1] / k[0] - 1 == pytest.approx(0.0017, abs=1e-4)
    np.testing.assert_allclose(places.metric(point)[0], np.diag(1 / k**2), atol=2e-8)


def test_the_metric_holds_at_the_pole_where_longitudes_turn():
    places = Places(terrain_of(FLAT, Affine(30, 0, -600, 0, -30, 600), "EPSG:3995"))
    k = Proj(CRS("EPSG:3995")).get_factors(0, 90).meridional_scale
    np.testing.assert_allclose(places.metric(np.zeros((1, 2)))[0], np.eye(2) / k**2, atol=1e-8)


def test_degrees_go_there_and_back():
    places = Places(terrain_of(FLAT, crs="EPSG:32611"))
    points = np.array([[500_100.0, 3_999_900.0], [500_900.0, 3_999_200.0]])
    degrees = places.lonlat(points)
    assert -117.1 < degrees[0, 0] < -116.9 and 36.1 < degrees[0, 1] < 36.2
    np.testing.assert_allclose(places.of_lonlat(degrees), points, atol=1e-5)


def test_another_body_has_its_own_degrees_and_radius():
    moon = CRS.from_proj4("+proj=stere +lat_0=-80 +lon_0=30 +R=1737400 +units=m")
    places = Places(terrain_of(FLAT, Affine(30, 0, 0, 0, -30, 600), moon.to_wkt()))
    lon, lat = places.lonlat(np.array([[0.0, 0.0]]))[0]
    assert (lon, lat) == pytest.approx((30, -80), abs=1e-9)
    assert places.radius == places.gauss_radius(np.array([0.0, 0.0])) == pytest.approx(1_737_400)


def test_points_beyond_the_last_samples_are_refused_but_not_for_rounding():
    places = Places(terrain_of(FLAT, crs="EPSG:32611"))
    east, south = 500_015 + 49 * 30, 3_999_985 - 39 * 30
    np.testing.assert_allclose(places.samples(np.array([[east + 1e-6, south - 1e-6]])), [[49, 39]], atol=0)
    with pytest.raises(UsageError, match=r"1 m east of ground.*longitudes -117.*easting, northing"):
        places.points((east + 1, south))
    for wrong in [(1.0,), (1.0, 2.0, 3.0), (np.nan, 0.0), ("a", "b"), "east"]:
        with pytest.raises(UsageError, match="easting and northing"):
            places.points(wrong)


@pytest.mark.parametrize(
    ("step", "said"), [((35, 0), "35 m east of"), ((-0.25, 0), "0.25 m west of"), ((0, 12.5), "12.5 m north of"),
                       ((20, -3), "20 m east and 3 m south of")],
)  # fmt: skip
def test_a_point_outside_is_told_how_far_and_the_nearest_point_inside_is_taken(step, said):
    places = Places(terrain_of(FLAT, crs="EPSG:32611"))
    corner = np.array([500_015 + 49 * 30 if step[0] > 0 else 500_015, 3_999_985 - (39 * 30 if step[1] < 0 else 0)])
    point = corner + step
    with pytest.raises(UsageError) as refused:
        places.points(point)
    assert f"{said} ground" in str(refused.value)
    nearest = re.search(r"nearest point of it is (\S+?),(\S+) \(longitude (\S+), latitude (\S+)\)", refused.value.what)
    inside = np.array([float(nearest[1]), float(nearest[2])])
    np.testing.assert_allclose(inside, corner, atol=0.02)
    places.points(inside)
    places.points(places.of_lonlat((float(nearest[3]), float(nearest[4]))))


def test_degrees_given_as_metres_are_recognised():
    places = Places(terrain_of(FLAT, crs="EPSG:32611"))
    inside = np.stack(places.grid.xy(20.0, 15.0))
    with pytest.raises(UsageError) as refused:
        places.points(places.lonlat(inside[None])[0])
    assert refused.value.remedy.startswith("As longitude, latitude it would lie there: give it so with")
    for elsewhere in [(10.0, 50.0), (200.0, 95.0)]:
        with pytest.raises(UsageError) as refused:
            places.points(elsewhere)
        assert refused.value.remedy.startswith("Give easting, northing")


def test_outside_of_a_turned_grid_is_told_along_both_axes():
    places = Places(terrain_of(FLAT, ROTATED))
    edge = np.stack(places.grid.xy(49.0, 20.0))
    away = edge + 10.0 * np.array([np.cos(np.radians(25)), np.sin(np.radians(25))])
    with pytest.raises(UsageError, match=r"9\.06\d* m east and 4\.22\d* m north of ground"):
        places.points(away)


def test_degrees_need_a_crs_and_a_place():
    with pytest.raises(UsageError, match="no CRS"):
        Places(terrain_of(FLAT)).of_lonlat((10, 50))
    places = Places(terrain_of(FLAT, crs="EPSG:32611"))
    with pytest.raises(UsageError, match="Longitude comes first"):
        places.of_lonlat((36.0, -117.0))


def test_a_single_row_is_no_surface():
    with pytest.raises(UsageError, match="no surface"):
        Places(terrain_of(np.zeros((1, 9))))


@pytest.mark.parametrize(
    ("point", "lonlat", "remedy"),
    [((36.1, 9.0), True, "other way round"), ((36.1, 9.0), False, "As latitude, longitude"),
     ((9.0, 36.1), False, "As longitude, latitude"), ((20.0, 50.1), True, "Give easting, northing")],
)  # fmt: skip
def test_degrees_in_the_wrong_order_are_told(point, lonlat, remedy):
    places = Places(terrain_of(FLAT, Affine(300, 0, 495000, 0, -300, 4004000), "EPSG:32632"))
    with pytest.raises(UsageError, match=remedy):
        places.points(point, lonlat=lonlat)
