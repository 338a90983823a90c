"""Nodata values that GDAL reads as other numbers than the file says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph.dem import read
from orograph.errors import ReadError

PLACE = {"crs": "EPSG:32611", "transform": Affine(30, 0, 500000, 0, -30, 4000000)}


def write(path: Path, heights: np.ndarray, nodata: float | None, **more: object) -> Path:
    rows, cols = heights.shape
    with rasterio.open(path, "w", driver="GTiff", width=cols, height=rows, count=1, dtype=heights.dtype, nodata=nodata,
                       **PLACE, **more) as file:  # fmt: skip
        file.write(heights, 1)
    return path


@pytest.mark.parametrize(("dtype", "nodata"), [("int64", -(2**63)), ("uint64", 2**63), ("int64", -9), ("uint64", 9)])
@pytest.mark.parametrize("more", [{}, {"BIGTIFF": "YES"}, {"ENDIANNESS": "BIG"}])
def test_nodata_of_64_bits(tmp_path: Path, dtype: str, nodata: int, more: dict) -> None:
    """rasterio writes −9.2233720368547758e+18, which GDAL reads as −9."""
    heights = np.arange(-20 if dtype == "int64" else 0, 20).reshape(4, -1).astype(dtype)
    heights[1, 2] = nodata
    expected = np.where(heights == np.array(nodata, dtype), np.nan, heights.astype(np.float32))
    np.testing.assert_array_equal(read(write(tmp_path / "a.tif", heights, nodata, **more)).heights, expected)


@pytest.mark.parametrize(("text", "missing"), [("-1e5", None), ("-1", -1), ("-9.2233720368547758e+18", None)])
def test_nodata_of_a_vrt_of_64_bits(tmp_path: Path, text: str, missing: int | None) -> None:
    heights = np.arange(-20, 20).reshape(4, 10).astype("int16")
    write(tmp_path / "part.tif", heights, None)
    path = tmp_path / "a.vrt"
    path.write_text(
        '<VRTDataset rasterXSize="10" rasterYSize="4"><SRS>EPSG:32611</SRS><GeoTransform>5e5,30,0,4e6,0,-30'
        f'</GeoTransform><VRTRasterBand dataType="Int64" band="1"><NoDataValue>{text}</NoDataValue><SimpleSource>'
        '<SourceFilename relativeToVRT="1">part.tif</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>'
    )
    expected = np.where(heights == (99 if missing is None else missing), np.nan, heights.astype(np.float32))
    np.testing.assert_array_equal(read(path).heights, expected)
    with pytest.raises(ReadError, match="first digit"):
        read(f"vrt://{path}")
    np.testing.assert_array_equal(read(f"vrt://{path}", nodata="none").heights, heights)
