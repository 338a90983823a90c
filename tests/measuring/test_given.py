"""What measures take: GeoJSON in all its forms, the shell's names, and errors by name."""

from __future__ import annotations

import json

import numpy as np
import pytest
from closed_forms import SQUARE, rough, terrain_of

from orograph import measure
from orograph.errors import OrographError, ReadError, UsageError

TERRAIN = terrain_of(rough((40, 50)), SQUARE, "EPSG:32611")


def corners(*at):
    return np.stack(TERRAIN.grid.xy(*np.array(at, float).T), -1)


def geometry(kind, points):
    places = measure.Places(TERRAIN).lonlat(points).tolist()
    return {"type": kind, "coordinates": [[*places, places[0]]] if kind == "Polygon" else places}


class Shape:
    """What shapely's and geopandas' objects have in common."""

    def __init__(self, told):
        self.__geo_interface__ = told


@pytest.fixture(params=["file", "mapping", "object"])
def given(request, tmp_path):
    def give(told):
        if request.param == "file":
            path = tmp_path / "shape.geojson"
            path.write_text(json.dumps(told))
            return path
        return told if request.param == "mapping" else Shape(told)

    return give


def test_area_and_profile_take_geojson(given):
    ring = corners((5, 5), (30, 7), (20, 30))
    found = measure.area(TERRAIN, given(geometry("Polygon", ring)))
    assert found.surface == pytest.approx(measure.area(TERRAIN, ring).surface, rel=1e-6)
    line = measure.profile(TERRAIN, given(geometry("LineString", ring)))
    assert line.length == pytest.approx(measure.profile(TERRAIN, ring).length, rel=1e-6)


def test_several_polygons_are_another_measure(given):
    one = geometry("Polygon", corners((5, 5), (30, 7), (20, 30)))
    with pytest.raises(ReadError, match="areas measures each"):
        measure.area(TERRAIN, given({"type": "GeometryCollection", "geometries": [one, one]}))
    with pytest.raises(ReadError, match="one LineString"):
        measure.profile(TERRAIN, given(one))


def test_an_error_may_be_given_by_its_parts():
    error = measure.HeightError(2.0, 60.0)
    one = measure.slope(TERRAIN, error, [10], draws=3)
    other = measure.slope(TERRAIN, exceeds=[10], sigma=2.0, range=60.0, draws=3)
    assert np.array_equal(one.values(), other.values(), equal_nan=True)
    with pytest.raises(UsageError, match="and `sigma`, too"):
        measure.slope(TERRAIN, error=error, sigma=1.0)
    with pytest.raises(UsageError, match="error"):
        measure.contours(TERRAIN, interval=10.0)


@pytest.mark.stress
def test_names_are_the_command_lines():
    a, b = corners((5, 5), (30, 20))
    assert measure.los(TERRAIN, a, b, eye=3.0, target=1.0, flat=True).bend == 0.0
    assert measure.viewshed(TERRAIN, a, eye=3.0, target=1.0, flat=True).bend == 0.0
    with pytest.raises(OrographError, match="eye_heigt"):
        measure.viewshed(TERRAIN, a, eye_heigt=3.0)


def test_a_profile_goes_to_a_gis(tmp_path):
    line = corners((5, 5), (30, 7), (20, 30))
    found = measure.profile(TERRAIN, line)
    found.save(tmp_path / "p.geojson")
    (feature,) = json.loads((tmp_path / "p.geojson").read_text())["features"]
    places = np.array(feature["geometry"]["coordinates"])
    np.testing.assert_allclose(measure.Places(TERRAIN).of_lonlat(places[:, :2]), found.points, atol=1e-3)
    np.testing.assert_array_equal(places[:, 2], found.surface_heights)
    assert feature["properties"]["ground_m"] == found.length
    back = measure.profile(TERRAIN, tmp_path / "p.geojson")
    assert back.length == pytest.approx(found.length, rel=1e-6)
    with pytest.raises(UsageError, match="no CRS"):
        measure.profile(terrain_of(rough((40, 50))), line).save(tmp_path / "q.geojson")
