"""Colours by example: where ground is like the example's they are like the photo's, the same whatever the window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from pyproj import CRS

import orograph
from orograph.cli.synth import command
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.synthesis.colours import ColoursByExample

UTM = CRS.from_epsg(32632)
RED, BLUE = (200, 60, 50), (40, 80, 190)


def ground(rows: int, cols: int, spacing: float, seed: int) -> orograph.Dem:
    """Waves some 40 m high and 600 m long."""
    rng = np.random.default_rng(seed)
    y, x = spacing * np.mgrid[:rows, :cols]
    heights = sum(
        a * np.sin((x * np.cos(b) + y * np.sin(b)) / 100 + c) for a, b, c in rng.uniform([8, 0, 0], [20, 3, 6], (4, 3))
    )
    return orograph.Dem(heights.astype(np.float32), Grid(heights.shape, Affine(spacing, 0, 0, 0, -spacing, 0), UTM))


def rising(heights: np.ndarray) -> np.ndarray:
    """Whether ground rises to the east."""
    return np.gradient(heights.astype(float), axis=1) > 0


@pytest.fixture(scope="module")
def lidar() -> orograph.Dem:
    return ground(96, 110, 10, 1)


@pytest.fixture(scope="module")
def photo(lidar: orograph.Dem, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Red where ground rises to the east, else blue, with noise; twice as fine as the ground."""
    path = tmp_path_factory.mktemp("photo") / "photo.tif"
    colours = np.where(rising(lidar.heights)[..., None], RED, BLUE)
    colours = np.clip(colours + np.random.default_rng(2).normal(0, 10, colours.shape), 0, 255)
    fine = np.repeat(np.repeat(colours.astype(np.uint8), 2, 0), 2, 1)
    profile = {"driver": "GTiff", "height": 192, "width": 220, "count": 3, "dtype": "uint8", "crs": "EPSG:32632"}
    with rasterio.open(path, "w", **profile, transform=Affine(5, 0, 0, 0, -5, 0)) as file:
        file.write(np.moveaxis(fine, -1, 0))
    return path


@pytest.mark.stress
@pytest.mark.parametrize("spacing", [40.0, 5.0])
def test_like_ground_has_like_colours(photo: Path, lidar: orograph.Dem, spacing: float) -> None:
    shape = int(1600 / spacing) + 1, int(1200 / spacing) + 1
    over = ground(*shape, spacing, 7)
    made = ColoursByExample(photo, lidar, over, 3, jobs=1)
    assert made.grid.spacing == (10, 10) and made.grid.xy(0, 0) == over.grid.xy(0, 0)
    rows, cols = made.grid.shape
    whole = made.read(0, rows, 0, cols)
    truth = ground(rows, cols, 10, 7).heights
    red = whole[..., 0] > 120
    steep = np.abs(np.gradient(truth.astype(float), axis=1)) > 0.3
    assert (red == rising(truth))[steep].mean() > 0.75
    assert (whole[..., 3] == 255).all()
    np.testing.assert_array_equal(whole[21:60, 33:90], made.read(21, 60, 33, 90))


@pytest.mark.stress
def test_a_file_has_them_and_nothing_where_there_is_no_ground(photo: Path, lidar: orograph.Dem, tmp_path: Path) -> None:
    over = ground(50, 60, 40, 7)
    over.heights[:, :12] = np.nan
    for name, dem in (("over", over), ("lidar", lidar)):
        profile = {"driver": "GTiff", "height": dem.grid.rows, "width": dem.grid.cols, "count": 1, "dtype": "float32"}
        at = {"transform": dem.grid.transform, "crs": "EPSG:32632", "nodata": np.nan}
        with rasterio.open(tmp_path / f"{name}.tif", "w", **profile, **at) as file:
            file.write(dem.heights, 1)
    out = tmp_path / "colours.tif"
    files = ["--over", str(tmp_path / "over.tif"), "--ground", str(tmp_path / "lidar.tif"), "--exemplar", str(photo)]
    ran = CliRunner().invoke(command, ["-o", str(out), *files, "--seed", "5"], obj=None)
    assert ran.exit_code == 0, ran.output
    made = ColoursByExample(photo, lidar, over, 5, jobs=1)
    with rasterio.open(out) as file:
        found = np.moveaxis(file.read(), 0, -1)
        assert file.transform == made.grid.transform and file.colorinterp[3].name == "alpha"
    np.testing.assert_array_equal(found, made.read(0, made.grid.rows, 0, made.grid.cols))
    assert (found[:, : 4 * 11 + 2, 3] == 0).all() and (found[:, 4 * 12 :, 3] == 255).all()


def test_what_makes_no_sense_is_refused(photo: Path, lidar: orograph.Dem, tmp_path: Path) -> None:
    over, out = ground(20, 20, 40, 7), tmp_path / "a.tif"
    wider = ground(99, 110, 10, 1)
    for given, words in (
        ({"ground": lidar}, "Colours by example need"), ({"over": over}, "Colours by example need"),
        ({"over": over, "ground": wider}, "covers 97"), ({"over": over, "ground": lidar, "relief": 3}, "relief"),
    ):  # fmt: skip
        with pytest.raises(UsageError, match=words):
            orograph.synth(out, exemplar=photo, progress=False, **given)
    with pytest.raises(ReadError, match="photo"):
        orograph.synth(out, exemplar=tmp_path / "no.tif", over=over, ground=lidar, progress=False)
    with pytest.raises(UsageError, match="GeoTIFF"):
        orograph.synth(tmp_path / "a.oro", exemplar=photo, over=over, ground=lidar, progress=False)
    assert not out.exists()
