"""What a legend calls data: the words of their band, if it has any, and units as people write them."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

from orograph import lighting
from orograph.dem import Dem
from orograph.geo.grid import Grid
from orograph.geovis.data.classes import ClassTable, says_classes
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.reading import read
from orograph.geovis.data.units import fixed_unit
from orograph.geovis.keys import written_unit


@pytest.mark.parametrize(
    ("told", "written"),
    [
        ("Wh/m2", "Wh/m²"), ("W m-2", "W/m²"), ("J m**-2", "J/m²"), ("kg m^-3", "kg/m³"), ("km2", "km²"), ("m^3", "m³"),
        ("m s-1", "m/s"), ("mm", "mm"), ("m21", "m21"), ("CO2", "CO2"), ("1", ""),
    ],
)  # fmt: skip
def test_units_as_people_write_them(told, written):
    assert written_unit(told) == written


@pytest.mark.parametrize(
    ("description", "name"),
    [("sky-view factor", "sky-view factor"), ("Band 1", "some file"), ("Layer_1", "some file"), (None, "some file")],
)
def test_a_band_is_called_as_it_is_described(tmp_path, description, name):
    path = tmp_path / "some_file.tif"
    profile = {"driver": "GTiff", "width": 5, "height": 4, "count": 2, "dtype": "float32", "crs": "EPSG:32611"}
    with rasterio.open(path, "w", **profile, transform=Affine(30, 0, 5e5, 0, -30, 4e6)) as file:
        file.write(np.random.default_rng(1).random((2, 4, 5), np.float32))
        if description is not None:
            file.set_band_description(1, description)
    field = read(Dataset(str(path), band=1), Grid((4, 5), Affine(30, 0, 5e5, 0, -30, 4e6), CRS.from_epsg(32611)))
    assert field.name == name and field.chosen in ("", "band 1", description if name == "some file" else "")


def test_maps_of_light_say_what_they_are(tmp_path):
    rows, cols = 20, 30
    heights = np.add.outer(np.arange(rows) * 3.0, np.abs(np.arange(cols) - 15) * 25.0).astype(np.float32)
    grid = Grid((rows, cols), Affine(30, 0, 4e5, 0, -30, 3.8e6), CRS.from_epsg(32611))
    dem = Dem(heights, grid)
    lighting.shadows(dem, (90.0, 20.0)).save(tmp_path / "s.tif")
    code = read(Dataset(str(tmp_path / "s.tif"), band=2), grid)
    assert code.name == "shadow: code" and code.unit == "" and says_classes(code)
    names = ClassTable.of_tags(code.tags).names
    assert names == {0: "no data", 1: "lit", 2: "penumbra", 3: "self-shadow", 4: "cast shadow"}
    assert set(np.unique(code.values)) <= set(names)
    assert not says_classes(read(Dataset(str(tmp_path / "s.tif"), band=1), grid))
    lighting.insolation(dem, "2026-06-21", 8).save(tmp_path / "i.tif")
    energy = read(Dataset(str(tmp_path / "i.tif"), band=3), grid)
    assert (energy.name, energy.unit, energy.chosen) == ("insolation: global", "Wh/m²", "")


def test_a_unit_that_a_format_fixes_is_used_and_said(tmp_path):
    """GDAL tells no unit of BAG, whose standard has metres; of a GeoTIFF with such bands nothing is known."""
    from rasterio.shutil import copy

    place, crs = Affine(10, 0, 5e5, 0, -10, 4.7e6), "EPSG:32619"
    profile = {"driver": "GTiff", "width": 8, "height": 6, "count": 2, "dtype": "float32", "crs": crs, "nodata": 1e6}
    with rasterio.open(tmp_path / "sea.tif", "w", **profile, transform=place) as file:
        file.write(np.random.default_rng(1).uniform(-30, 5, (2, 6, 8)).astype(np.float32))
        file.descriptions = ("elevation", "uncertainty")
    copy(tmp_path / "sea.tif", tmp_path / "sea.bag", driver="BAG")
    grid = Grid((6, 8), place, CRS.from_user_input(crs))
    for band in (1, 2):
        field = read(Dataset(str(tmp_path / "sea.bag"), band=band), grid)
        assert (field.unit, field.chosen) == ("m", "in m by the BAG standard")
        assert read(Dataset(str(tmp_path / "sea.tif"), band=band), grid).unit == ""
    assert fixed_unit("BAG", "num_hypotheses") == fixed_unit("BAG", None) == ""
