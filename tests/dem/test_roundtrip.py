"""Property test: small rasters of every kind, written by rasterio, are read back as what was written."""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pyproj import CRS

from orograph.dem import Source, read
from orograph.geo.grid import compose

DTYPES = ("uint8", "int8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64")
CRSES = (None, "EPSG:4326", "EPSG:32611", "EPSG:3857", "EPSG:2225", "EPSG:32633+5773", "EPSG:3413")
counter = itertools.count()


@pytest.fixture(scope="module")
def folder() -> Any:
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


@st.composite
def rasters(draw: st.DrawFn) -> dict[str, Any]:
    dtype = np.dtype(draw(st.sampled_from(DTYPES)))
    shape = draw(st.tuples(st.integers(1, 40), st.integers(1, 40)))
    if dtype.kind == "f":
        elements = st.one_of(
            st.floats(-12000, 9000, width=32), st.sampled_from([np.nan, np.inf, -np.inf, -9999.0, 0.0, 1.5])
        )
        nodata = draw(st.sampled_from([None, np.nan, -9999.0, 0.0, 1.5, -3.4028234663852886e38, -99.9]))
    else:
        info = np.iinfo(dtype)
        elements = st.integers(max(info.min, -(2**53)), min(info.max, 2**53))
        choices = [0, 1, int(info.max), int(info.min)] if dtype.itemsize < 8 else [0, 1]
        nodata = draw(st.sampled_from([None, *choices]))
    numbers = draw(hnp.arrays(dtype, shape, elements=elements))
    if nodata is not None and not np.isnan(nodata):
        with np.errstate(over="ignore"):
            numbers[draw(hnp.arrays(bool, shape))] = np.asarray(nodata).astype(dtype)
    x, y = draw(st.floats(-1e6, 1e6)), draw(st.floats(-1e6, 1e6))
    dx, dy = draw(st.floats(0.001, 1000)), draw(st.floats(0.001, 1000))
    kind = draw(st.sampled_from(["north-up", "south-up", "east-first", "reversed", "rotated"]))
    transform = {
        "north-up": Affine(dx, 0, x, 0, -dy, y),
        "south-up": Affine(dx, 0, x, 0, dy, y),
        "east-first": Affine(-dx, 0, x, 0, -dy, y),
        "reversed": Affine(-dx, 0, x, 0, dy, y),
        "rotated": compose(Affine.translation(x, y), Affine.rotation(draw(st.floats(5, 85))), Affine.scale(dx, -dy)),
    }[kind]
    return {
        "numbers": numbers,
        "nodata": nodata,
        "transform": transform,
        "crs": draw(st.sampled_from(CRSES)),
        "scale": draw(st.sampled_from([1.0, 1.0, 0.1, 2.5])),
        "offset": draw(st.sampled_from([0.0, 0.0, -1000.0, 0.25])),
        "unit": draw(st.sampled_from(["", "m", "ft", "US survey foot", "cm"])),
        "mask": draw(st.none() | hnp.arrays(bool, shape)),
        "layout": draw(
            st.sampled_from(
                [
                    {},
                    {"tiled": True, "blockxsize": 16, "blockysize": 16},
                    {"blockysize": 3},
                    {"tiled": True, "blockxsize": 32, "blockysize": 16},
                ]
            )
        ),
        "compress": draw(st.sampled_from([None, "deflate", "lzw", "zstd"])),
    }


def write(path: Path, case: dict[str, Any]) -> None:
    numbers = case["numbers"]
    height, width = numbers.shape
    profile = {"driver": "GTiff", "height": height, "width": width, "count": 1, "dtype": numbers.dtype}
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(
            path, "w", **profile, crs=case["crs"], transform=case["transform"], nodata=case["nodata"],
            compress=case["compress"], **case["layout"],
        ) as dataset,
    ):  # fmt: skip
        # First these: beside a vertical CRS, GDAL writes them into the geotransform's tags and loses them afterwards.
        dataset.scales, dataset.offsets, dataset.units = [case["scale"]], [case["offset"]], [case["unit"]]
        dataset.write(numbers, 1)
        if case["mask"] is not None and case["nodata"] is None:
            dataset.write_mask(case["mask"])


def truth(case: dict[str, Any]) -> np.ndarray:
    """What was meant, in the file's order: metres as float32, NaN where missing or no height of any body (1e12 m)."""
    numbers = case["numbers"]
    metres = {"": 1.0, "m": 1.0, "ft": 0.3048, "US survey foot": 1200 / 3937, "cm": 0.01}[case["unit"]]
    if case["unit"] == "" and case["crs"] == "EPSG:32633+5773":
        metres = 1.0
    heights = ((numbers.astype(np.float64) * case["scale"] + case["offset"]) * metres).astype(np.float32)
    heights[~(np.abs(heights) < np.float32(1e12))] = np.nan
    if case["nodata"] is not None and not np.isnan(case["nodata"]):
        if numbers.dtype.kind == "f":
            heights[numbers.astype(np.float32) == np.float32(case["nodata"])] = np.nan
        else:
            heights[numbers == numbers.dtype.type(case["nodata"])] = np.nan
    elif case["mask"] is not None and case["nodata"] is None:
        heights[~case["mask"]] = np.nan
    return heights


def huge_number(number: int) -> dict[str, Any]:
    """A raster of one integer that is rarely drawn."""
    return {
        "numbers": np.array([[number]]), "nodata": None, "transform": Affine(1, 0, 0, 0, -1, 0), "crs": None,
        "scale": 1.0, "offset": 0.0, "unit": "", "mask": None, "layout": {}, "compress": None,
    }  # fmt: skip


@pytest.mark.parametrize(("number", "there"), [(999_999_900_000, True), (999_999_963_137, False), (2**53, False)])
def test_no_height_reaches_1e12_metres(folder: Path, number: int, there: bool) -> None:
    """As float32: 999,999,963,137 rounds to the number that 1e12 rounds to."""
    path = folder / f"{next(counter)}.tif"
    write(path, huge_number(number))
    assert np.isfinite(read(path).heights).item() == there
    np.testing.assert_array_equal(read(path).heights, truth(huge_number(number)))


@pytest.mark.stress
@settings(max_examples=150, deadline=None)
@given(rasters(), st.data())
def test_what_was_written_is_read(folder: Path, case: dict[str, Any], data: st.DataObject) -> None:
    path = folder / f"{next(counter)}.tif"
    write(path, case)
    dem = read(path)
    rows, cols = dem.heights.shape
    assert dem.heights.dtype == np.float32 and dem.heights.shape == case["numbers"].shape

    # Every sample lies where the file has it, whatever order it is read in.
    i, j = np.mgrid[:rows, :cols]
    x, y = dem.grid.xy(j, i)
    a, b, c, d, e, f = case["transform"][:6]
    determinant = a * e - b * d
    col = (e * (x - c) - b * (y - f)) / determinant - 0.5
    row = (-d * (x - c) + a * (y - f)) / determinant - 0.5
    assert np.abs(col - np.rint(col)).max() < 1e-3 and np.abs(row - np.rint(row)).max() < 1e-3
    expected = truth(case)[np.rint(row).astype(int), np.rint(col).astype(int)]
    np.testing.assert_array_equal(dem.heights, expected)
    if not (b or d):
        assert x[0, 0] <= x[0, -1] and y[0, 0] >= y[-1, 0]  # north-west first

    crs = case["crs"]
    if crs is None:
        assert dem.grid.crs is None
    elif "+" in crs:
        assert dem.grid.crs is not None and dem.grid.crs.to_epsg() == 32633 and dem.vertical == "EGM96 height"
    else:
        assert dem.grid.crs == CRS(crs) and dem.vertical is None

    # Windows and steps are parts of the whole.
    r0, c0 = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, cols - 1))
    r1, c1 = data.draw(st.integers(r0 + 1, rows)), data.draw(st.integers(c0 + 1, cols))
    step = data.draw(st.integers(1, 50))
    with Source.open(path) as source:
        np.testing.assert_array_equal(source.read(r0, r1, c0, c1, step=step), expected[r0:r1:step, c0:c1:step])
    path.unlink()
