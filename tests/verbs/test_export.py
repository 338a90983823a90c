"""Heights that are given back: what other tools read of the file is what the terrain holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner
from pyproj import CRS, Transformer

import orograph
from orograph.cli import cli
from orograph.errors import OutputError, UsageError


def run(*args: object) -> str:
    ran = CliRunner().invoke(cli, [str(a) for a in args], obj={}, catch_exceptions=False)
    assert ran.exit_code == 0, ran.output
    return ran.stdout


def store(shared_data: Path, folder: Path, name: str = "n44w072-hgt/N44W072.hgt") -> orograph.Terrain:
    return orograph.build(str(shared_data / name), str(folder / "area.oro"), errors=(), progress=False)


def test_all_of_a_store_comes_back(shared_data: Path, tmp_path: Path) -> None:
    terrain = store(shared_data, tmp_path)
    out = orograph.export(terrain, tmp_path / "area.tif", progress=False)
    rows, cols = terrain.grid.shape
    with rasterio.open(out) as file:
        np.testing.assert_array_equal(file.read(1), terrain.read(0, 0, rows, 0, cols))
        assert file.transform.almost_equals(terrain.grid.transform) and np.isnan(file.nodata)
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG" and file.overviews(1) and file.units == ("m",)
        assert CRS(file.crs.to_wkt()).sub_crs_list[1].name == terrain.vertical == "EGM96 height"
    again = orograph.read(out)
    assert again.vertical == terrain.vertical and again.grid.crs.equals(terrain.grid.crs, ignore_axis_order=True)


def test_an_area_holds_the_samples_within(shared_data: Path, tmp_path: Path) -> None:
    terrain = store(shared_data, tmp_path)
    box = (-71.4, 44.2, -71.2, 44.35)
    run("export", tmp_path / "area.oro", "-o", tmp_path / "part.tif", "--bbox", ",".join(map(str, box)))
    with rasterio.open(tmp_path / "part.tif") as file:
        found, transform = file.read(1), file.transform
    rows, cols = terrain.grid.shape
    x, y = terrain.grid.xy(*np.meshgrid(np.arange(cols), np.arange(rows)))
    lon, lat = Transformer.from_crs(terrain.grid.crs, 4326, always_xy=True).transform(x, y)
    inside = (lon >= box[0]) & (lon <= box[2]) & (lat >= box[1]) & (lat <= box[3])
    r, c = np.nonzero(inside.any(1))[0], np.nonzero(inside.any(0))[0]
    assert found.shape == (r[-1] - r[0] + 1, c[-1] - c[0] + 1)  # the smallest rectangle that has them all
    np.testing.assert_array_equal(found, terrain.read(0, r[0], r[-1] + 1, c[0], c[-1] + 1))
    at = terrain.grid.window(r[0], r[-1] + 1, c[0], c[-1] + 1).transform
    assert transform.almost_equals(at)


def test_files_come_onto_the_grid_that_is_asked_for(shared_data: Path, tmp_path: Path) -> None:
    dem, box = str(shared_data / "n44w072-hgt/N44W072.hgt"), "-71.4,44.2,-71.2,44.35"
    how = {"crs": "EPSG:32619", "resolution": 200, "resampling": "cubic", "bbox": box}
    run("export", dem, "-o", tmp_path / "a.tif", *(text for k, v in how.items() for text in (f"--{k}", v)))
    orograph.export(dem, tmp_path / "b.tif", progress=False, **how)
    with rasterio.open(tmp_path / "a.tif") as one, rasterio.open(tmp_path / "b.tif") as other:
        assert one.res == (200, 200) and one.crs == other.crs
        assert CRS(one.crs.to_wkt()).sub_crs_list[0].equals(CRS(32619), ignore_axis_order=True)
        np.testing.assert_array_equal(one.read(1), other.read(1))


def test_voids_stay_voids(tmp_path: Path) -> None:
    heights = np.linspace(0, 900, 70 * 300, dtype=np.float32).reshape(70, 300)
    heights[20:30, 250:] = np.nan
    out = orograph.export(heights, tmp_path / "plain.tif", progress=False)
    with rasterio.open(out) as file:
        np.testing.assert_array_equal(file.read(1), heights)
        assert file.dtypes == ("float32",)


def test_what_cannot_be_is_told(shared_data: Path, tmp_path: Path) -> None:
    terrain = store(shared_data, tmp_path)
    for box, why in (((1, 2, 3, 4), "No sample"), ((1, 4, 3, 2), "west, south, east, north")):
        with pytest.raises(UsageError, match=why):
            orograph.export(terrain, tmp_path / "a.tif", bbox=box, progress=False)
    with pytest.raises(UsageError, match=r"\.tif"):
        orograph.export(terrain, tmp_path / "a.png", progress=False)
    (tmp_path / "there.tif").write_text("mine")
    with pytest.raises(OutputError, match="already"):
        orograph.export(terrain, tmp_path / "there.tif", progress=False)
    assert (tmp_path / "there.tif").read_text() == "mine" and not (tmp_path / "a.tif").exists()
