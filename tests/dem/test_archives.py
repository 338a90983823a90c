"""Archives by their plain paths: the raster in them is read, and what cannot be is told."""

from __future__ import annotations

import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

import orograph
from orograph.dem.units import metres_per
from orograph.dem.whole.files import stream
from orograph.errors import ReadError

HEIGHTS = np.arange(60 * 50, dtype=np.float32).reshape(60, 50)


def raster(path: Path, heights: np.ndarray = HEIGHTS) -> Path:
    rows, cols = heights.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=1, dtype="float32", crs="EPSG:32611",
        transform=Affine(30, 0, 4e5, 0, -30, 4e6), compress="deflate",
    ) as file:  # fmt: skip
        file.write(heights, 1)
    return path


@pytest.mark.parametrize("ending", [".tar", ".tar.gz", ".tgz"])
def test_a_tar_is_read_by_its_path(tmp_path: Path, ending: str) -> None:
    packed = tmp_path / f"dem.tif{ending}"
    with tarfile.open(packed, "w:" + ("gz" if ending != ".tar" else "")) as archive:
        archive.add(raster(tmp_path / "dem.tif"), "folder/dem.tif")
        (tmp_path / "read.txt").write_text("of whom it is")
        archive.add(tmp_path / "read.txt", "folder/read.txt")
    dem = orograph.read(packed)
    np.testing.assert_array_equal(dem.heights, HEIGHTS)
    assert dem.name == "dem"


def test_a_tar_of_several_rasters_names_them(tmp_path: Path) -> None:
    packed = tmp_path / "many.tgz"
    with tarfile.open(packed, "w:gz") as archive:
        for name in ("a.tif", "b.tif"):
            archive.add(raster(tmp_path / name), name)
    with pytest.raises(ReadError, match=r"/vsitar/.*many\.tgz/a\.tif"):
        orograph.read(packed)
    np.testing.assert_array_equal(orograph.read(f"/vsitar/{packed}/a.tif").heights, HEIGHTS)


def test_what_is_no_tar_and_what_was_cut_are_told(tmp_path: Path) -> None:
    (tmp_path / "no.tgz").write_bytes(b"this is no archive" * 40)
    whole = tmp_path / "dem.tar.gz"
    with tarfile.open(whole, "w:gz") as archive:
        archive.add(raster(tmp_path / "dem.tif", np.random.default_rng(1).random((60, 50)).astype(np.float32)), "d.tif")
    (tmp_path / "cut.tar.gz").write_bytes(whole.read_bytes()[:-3000])
    for name in ("no.tgz", "cut.tar.gz"):
        with pytest.raises(ReadError, match=name.replace(".", r"\.")):
            orograph.read(tmp_path / name)


def test_a_way_of_packing_that_is_not_known_is_told(tmp_path: Path) -> None:
    path = tmp_path / "dem.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(raster(tmp_path / "dem.tif"), "dem.tif")
    data = bytearray(path.read_bytes())
    for sign, at in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):  # APPNOTE 4.3: where the headers name the method
        data[data.index(sign) + at] = 9  # Deflate64
    path.write_bytes(data)
    told = pytest.raises(ReadError, match=r"cannot be unpacked here")
    with told as caught, stream(f"/vsizip/{{{path}}}/dem.tif") as inside:
        inside.read()
    assert "dem.zip" in str(caught.value)


def test_inches_are_a_length() -> None:
    assert metres_per("inches") == 0.0254
