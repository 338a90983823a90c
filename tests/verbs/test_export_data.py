"""Data that are written for other tools: what those read is what pictures show."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from pyproj import CRS, Transformer

import orograph
from orograph.cli import cli
from orograph.errors import UsageError
from orograph.geovis.data.derived import read_data
from orograph.geovis.data.sampling import Positions

PLACE = Affine(100, 0, 500_000, 0, -120, 5_600_000)


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    y, x = np.mgrid[:300, :330]
    heights = (100 + 40 * np.sin(x / 30) * np.cos(y / 20)).astype(np.float32)
    return orograph.terrain(heights, transform=PLACE, crs="EPSG:32630")


@pytest.fixture(scope="module")
def ensemble(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five members in degrees, half of the terrain."""
    path = tmp_path_factory.mktemp("data") / "members.tif"
    values = np.random.default_rng(1).normal(12, 3, (5, 30, 26)).astype(np.float32)
    place = Affine(0.02, 0, -3.1, 0, -0.02, 50.6)
    with rasterio.open(path, "w", driver="GTiff", width=26, height=30, count=5, dtype="float32", crs="EPSG:4326",
                       transform=place) as file:  # fmt: skip
        file.write(values)
        file.units = ("degC",) * 5
    return path


def expected(ground: orograph.Terrain, data: orograph.Dataset) -> np.ndarray:
    field = read_data(data, ground.grid)
    return Positions.of(ground.grid, field).values(field.shown)


def test_a_geotiff_has_values_and_their_uncertainty(ground, ensemble, tmp_path):
    data = orograph.Dataset(ensemble, value="p90", uncertainty="spread", name="Warmth")
    path = orograph.export(ground, tmp_path / "w.tif", data=data, progress=False)
    with rasterio.open(path) as file:
        values = file.read()
        assert file.transform.almost_equals(PLACE) and file.crs.to_epsg() == 32630
        assert file.descriptions == ("Warmth, p90", "Warmth, p90: standard deviation") and file.units == ("°C", "°C")
    np.testing.assert_allclose(values[0], expected(ground, data), atol=0.1)  # (blocks have lattices of their own)
    assert 0.3 < np.isfinite(values[0]).mean() < 1 and np.nanmin(values[1]) > 0
    np.testing.assert_allclose(values[1], expected(ground, data.but(value="spread", uncertainty=None)), atol=0.1)


def test_netcdf_is_cf(ground, ensemble, tmp_path):
    xarray = pytest.importorskip("xarray")
    several = [orograph.Dataset(ensemble, exceeds=12, name="Warmth"), orograph.Dataset(ensemble, uncertainty="ci90")]
    path = orograph.export(ground, tmp_path / "w.nc", data=several, progress=False)
    with xarray.open_dataset(path, engine="scipy", decode_coords="all") as found:
        one = found["p_warmth_12_c"]
        assert found.attrs["Conventions"] == "CF-1.8" and one.dims == ("y", "x") and one.dtype == np.float32
        assert one.attrs["units"] == "1" and one.attrs["long_name"] == "P(Warmth > 12 °C)"
        assert found["members_2"].attrs["units"] == "degC"
        assert found["members_2"].attrs["ancillary_variables"] == "members_2_uncertainty"
        np.testing.assert_allclose(found.x[[0, 1]], [500_050, 500_150])
        np.testing.assert_allclose(found.y[[0, 1]], [5_599_940, 5_599_820])
        assert found.x.attrs["standard_name"] == "projection_x_coordinate" and found.x.attrs["units"] == "m"
        assert CRS.from_cf(found["crs"].attrs) == CRS.from_epsg(32630)
        np.testing.assert_allclose(one.values, expected(ground, several[0]), atol=0.05)
    again = orograph.Dataset(path, variable="members_2")  # and Orograph reads it
    back = read_data(again, ground.grid)
    assert back.unit == "°C" and np.nanmax(back.mean) > 10


def quakes(tmp_path: Path) -> orograph.Dataset:
    path = tmp_path / "quakes.csv"
    path.write_text("longitude,latitude,mag,error\n-2.95,50.53,4.5,0.1\n-2.9,50.5,,0.2\n-2.8,50.45,3.25,0.3\n9,9,1,1\n")
    return orograph.Dataset(path, variable="mag", uncertainty="error")


def test_points_are_tables(ground, tmp_path):
    data = quakes(tmp_path)
    path = orograph.export(ground, tmp_path / "q.csv", data=data, progress=False)
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["mag"] for row in rows] == ["4.5", "3.25"] and [row["uncertainty"] for row in rows] == ["0.1", "0.3"]
    assert [float(row["longitude"]) for row in rows] == pytest.approx([-2.95, -2.8])
    x, y = Transformer.from_crs(4326, 32630, always_xy=True).transform([-2.95, -2.8], [50.53, 50.45])
    np.testing.assert_allclose([[float(r["x"]), float(r["y"])] for r in rows], np.stack([x, y], 1), atol=1e-3)
    heights = [orograph.measure.place(ground, at).height for at in zip(x, y)]
    assert [float(row["ground_height_m"]) for row in rows] == pytest.approx(heights)
    out = orograph.export(ground, tmp_path / "q.geojson", data=data, progress=False)
    features = json.loads(out.read_text(encoding="utf-8"))["features"]
    assert features[0]["geometry"]["coordinates"] == pytest.approx([-2.95, 50.53])
    assert features[1]["properties"]["mag"] == 3.25
    shown = orograph.Dataset(out, variable="mag")
    assert orograph.export(ground, tmp_path / "r.csv", data=shown, progress=False).stat().st_size > 100


def test_a_geopackage(ground, tmp_path):
    pyogrio = pytest.importorskip("pyogrio")
    out = orograph.export(ground, tmp_path / "q.gpkg", data=quakes(tmp_path), progress=False)
    meta, _, shapes, values = pyogrio.raw.read(out)
    assert CRS(meta["crs"]).to_epsg() == 32630 and meta["geometry_type"] == "Point" and len(shapes) == 2
    columns = dict(zip(meta["fields"], values))
    assert columns["mag"].tolist() == [4.5, 3.25] and columns["longitude"] == pytest.approx([-2.95, -2.8])


def test_the_command_line_writes_the_same(ground, ensemble, tmp_path):
    orograph.export(ground, tmp_path / "ground.tif", progress=False)

    def run(*args):
        return CliRunner().invoke(cli, ["-q", *map(str, args)], obj={})

    said = f"{ensemble},member=2-4,name=Warmth"
    ran = run("export", tmp_path / "ground.tif", "-o", tmp_path / "a.tif", "--data", said, "--uncertainty", "spread")
    assert ran.exit_code == 0, ran.output
    data = orograph.Dataset(ensemble, member="2-4", name="Warmth", uncertainty="spread")
    orograph.export(ground, tmp_path / "b.tif", data=data, progress=False)
    with rasterio.open(tmp_path / "a.tif") as one, rasterio.open(tmp_path / "b.tif") as other:
        np.testing.assert_array_equal(one.read(), other.read())
    box = ("--bbox", "-2.98,50.45,-2.9,50.5")
    ran = run("export", tmp_path / "ground.tif", "-o", tmp_path / "c.nc", "--data", said, *box)
    assert ran.exit_code == 0 and (tmp_path / "c.nc").stat().st_size < (tmp_path / "b.tif").stat().st_size


def test_what_cannot_be_written_is_said(ground, ensemble, tmp_path):
    with pytest.raises(UsageError, match=r"\.tif or \.nc"):
        orograph.export(ground, tmp_path / "a.csv", data=ensemble, progress=False)
    with pytest.raises(UsageError, match=r"\.csv, \.geojson, \.gpkg"):
        orograph.export(ground, tmp_path / "a.tif", data=quakes(tmp_path), progress=False)
    with pytest.raises(UsageError, match="one data set at a time"):
        orograph.export(ground, tmp_path / "a.csv", data=[quakes(tmp_path), ensemble], progress=False)
    line = {"type": "LineString", "coordinates": [[-2.95, 50.53], [-2.9, 50.5]]}
    with pytest.raises(UsageError, match="Lines cannot be written"):
        orograph.export(ground, tmp_path / "a.csv", data=orograph.Dataset(line), progress=False)
    turned = orograph.terrain(np.zeros((9, 9), np.float32), transform=PLACE @ Affine.rotation(9), crs="EPSG:32630")
    with pytest.raises(UsageError, match="rotated"):
        orograph.export(turned, tmp_path / "a.nc", data=ensemble, progress=False)
    with pytest.raises(UsageError, match="too many for NetCDF"):
        orograph.export(ground, tmp_path / "a.nc", data=ensemble, max_memory=1 << 18, progress=False)
    assert not [one for one in tmp_path.iterdir() if one.name.startswith(("a.", ".a."))]
