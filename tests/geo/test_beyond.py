"""How far a place is outside: geodesics that GeographicLib knows, and borders by their names."""

from __future__ import annotations

import math

import pytest
from affine import Affine
from pyproj import CRS, Geod, Transformer

from orograph.geo.beyond import beyond
from orograph.geo.grid import Grid

UTM = CRS.from_epsg(32611)
PLACE = Affine(30, 0, 500_000, 0, -30, 4_000_000)
LAND = Grid((80, 100), PLACE, UTM)


def test_what_is_within_is_not_beyond():
    for col, row in ((0, 0), (99, 79), (50.3, 20.7)):
        assert beyond(LAND, *(float(v) for v in LAND.xy(col, row))) is None


@pytest.mark.parametrize(
    ("col", "row", "border"),
    [
        (50, -100, "northern border"), (400, 40, "eastern border"), (3, 300, "southern border"),
        (-90, 78, "western border"), (-5, -5, "north-western corner"), (110, -900, "north-eastern corner"),
        (110, 90, "south-eastern corner"), (-10, 90, "south-western corner"),
    ],
)  # fmt: skip
def test_borders_have_names(col, row, border):
    found = beyond(LAND, *(float(v) for v in LAND.xy(col, row)))
    assert found.border == border
    plain = 30 * math.hypot(min(max(col, 0), 99) - col, min(max(row, 0), 79) - row)
    assert found.metres == pytest.approx(plain, rel=2e-3)  # (UTM's scale)


def test_a_quarter_turned_raster_names_the_borders_of_the_ground():
    turned = Grid((80, 100), PLACE @ Affine.rotation(90), UTM)
    x, y = (float(v) for v in turned.xy(200, 40))
    east, north = (float(v) for v in turned.xy(50, 40))
    assert beyond(turned, x, y).border == ("northern border" if y > north else "southern border")
    assert abs(x - east) < 1


def test_far_away_distances_are_geodesics():
    to_utm = Transformer.from_crs("EPSG:4326", UTM, always_xy=True)
    corner = Transformer.from_crs(UTM, "EPSG:4326", always_xy=True).transform(*(float(v) for v in LAND.xy(99, 79)))
    x, y = to_utm.transform(-80.0, 10.0)
    told = beyond(LAND, x, y)
    assert told.metres == pytest.approx(Geod(ellps="WGS84").inv(*corner, -80.0, 10.0)[2], rel=1e-6)
    assert str(told) == f"{told.metres / 1000:,.0f} km beyond the terrain's south-eastern corner"
    nowhere = Grid((80, 100), PLACE, None)
    assert beyond(nowhere, 500_015.0, 4_000_985.0).metres == 1000.0
