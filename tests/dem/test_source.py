"""Source and read against GDAL, published heights and files made for the purpose."""

from __future__ import annotations

import copy
import gzip
import os
import shutil
import threading
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

import orograph
from orograph.dem import Dem, Source, read
from orograph.dem import handles as handle_pool
from orograph.dem import source as source_module
from orograph.dem.encode import decode_rgb
from orograph.dem.units import metres_per
from orograph.errors import ReadError, UsageError
from orograph.geo import Grid

UTM = Affine(30, 0, 500000, 0, -30, 4000000)


def write(path: Path, numbers: np.ndarray, **profile: Any) -> Path:
    bands = numbers if numbers.ndim == 3 else numbers[None]
    count, height, width = bands.shape
    base = {"driver": "GTiff", "height": height, "width": width, "count": count, "dtype": bands.dtype}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", **{**base, **profile}) as dataset:
            dataset.write(bands)
    return path


# Where samples lie -----------------------------------------------------------------------------------------------


def test_hgt_samples_lie_on_whole_arc_seconds(shared_data: Path) -> None:
    """The SRTM specification: sample (0, 0) of N44W072 is 45° N, 72° W exactly; Mount Washington's summit is in it."""
    dem = read(shared_data / "n44w072-hgt" / "N44W072.hgt")
    assert dem.grid.xy(0, 0) == pytest.approx((-72, 45), abs=1e-12)
    assert dem.grid.xy(1200, 1200) == pytest.approx((-71, 44), abs=1e-12)
    raw = np.fromfile(shared_data / "n44w072-hgt" / "N44W072.hgt", ">i2").reshape(1201, 1201)
    np.testing.assert_array_equal(dem.heights, raw)
    assert dem.vertical == "EGM96 height" and dem.name == "N44W072"
    col, row = np.unravel_index(np.nanargmax(dem.heights), dem.heights.shape)[::-1]
    lon, lat = dem.grid.xy(col, row)  # 1916.6 m at 44.2706° N, 71.3033° W (NGS)
    assert abs(lon + 71.3033) < 0.002 and abs(lat - 44.2706) < 0.002 and 1890 < dem.heights[row, col] < 1917


def test_dted_samples_lie_on_whole_degrees(shared_data: Path) -> None:
    dem = read(shared_data / "nasty-gdal" / "n43.dt0")
    assert dem.grid.xy([0, 120], [0, 120]) == (pytest.approx([-80, -79]), pytest.approx([44, 43]))
    assert dem.vertical == "mean sea level"


@pytest.mark.parametrize("kind", ["Area", "Point"])
def test_geotiff_area_and_point(tmp_path: Path, kind: str) -> None:
    """The file's own tie point is read by hand: the corner of the first pixel (area) or the first sample (point)."""
    path = write(tmp_path / "a.tif", np.zeros((4, 5), np.float32), crs="EPSG:32611", transform=UTM)
    with rasterio.open(path, "r+") as dataset:
        dataset.update_tags(AREA_OR_POINT=kind)
    import PIL.Image

    with PIL.Image.open(path) as picture:
        tie = picture.tag_v2[33922]  # ModelTiepointTag: raster i, j, k → x, y, z
    x, y = read(path).grid.xy(0, 0)
    half = 0.0 if kind == "Point" else 15.0
    assert (float(x), float(y)) == (tie[3] + half, tie[4] - half)


def test_south_up_and_east_first_are_turned_north_west_first(tmp_path: Path) -> None:
    numbers = np.arange(12, dtype=np.int16).reshape(3, 4)
    path = write(tmp_path / "a.tif", numbers, crs="EPSG:32611", transform=Affine(-10, 0, 540, 0, 10, 100))
    dem = read(path)
    np.testing.assert_array_equal(dem.heights, numbers[::-1, ::-1])
    assert dem.grid.transform == Affine(10, 0, 500, 0, -10, 130)


def test_a_rotated_transform_is_kept(shared_data: Path) -> None:
    dem = read(shared_data / "nasty-gdal" / "geomatrix.tif")
    assert dem.grid.transform == Affine(1.5, -5, 1841001.75, -5, -1.5, 1144003.25)
    assert dem.grid.xy(0, 0) == pytest.approx((1841000, 1144000))  # the file's matrix, of a point raster


def test_without_a_place(tmp_path: Path) -> None:
    path = write(tmp_path / "h.png", np.arange(12, dtype=np.uint16).reshape(3, 4), driver="PNG")
    source = Source.open(path)
    assert source.grid == Grid((3, 4), Affine(1, 0, 0, 0, -1, 3), None) and not source.georeferenced
    assert any("`spacing=METRES`" in w for w in source.warnings)
    dem = read(path, spacing=30)
    assert dem.grid == Grid((3, 4), Affine(30, 0, 0, 0, -30, 90), None)
    np.testing.assert_array_equal(dem.heights, np.arange(12).reshape(3, 4))
    for bad in (0, -1, float("nan"), float("inf")):
        with pytest.raises(UsageError, match="positive"):
            read(path, spacing=bad)


def test_assume_crs_is_for_files_that_name_none(tmp_path: Path) -> None:
    numbers = np.zeros((3, 4), np.float32)
    bare = write(tmp_path / "bare.tif", numbers, transform=Affine(0.001, 0, 7, 0, -0.001, 46))
    assert any("look like degrees" in w for w in Source.open(bare).warnings)
    assert read(bare, assume_crs="EPSG:4326").grid.crs == CRS("EPSG:4326")
    named = write(tmp_path / "named.tif", numbers, transform=UTM, crs="EPSG:32611")
    source = Source.open(named, assume_crs="EPSG:4326", spacing=3)
    assert source.grid.crs == CRS("EPSG:32611") and source.grid.transform == UTM
    assert any("`assume_crs`" in w for w in source.warnings) and any("`spacing`" in w for w in source.warnings)
    with pytest.raises(UsageError, match="not a CRS"):
        read(bare, assume_crs="EPSG:nonsense")


# What is a height --------------------------------------------------------------------------------------------------


def test_nodata_by_tag_option_and_none(tmp_path: Path) -> None:
    numbers = np.array([[1, -9999, 0, 7]], np.int16)
    path = write(tmp_path / "a.tif", numbers, transform=UTM, crs="EPSG:32611", nodata=-9999)
    nan = np.nan
    np.testing.assert_array_equal(read(path).heights, np.float32([[1, nan, 0, 7]]))
    np.testing.assert_array_equal(read(path, nodata=0).heights, np.float32([[1, -9999, nan, 7]]))
    np.testing.assert_array_equal(read(path, nodata="7").heights, np.float32([[1, -9999, 0, nan]]))
    np.testing.assert_array_equal(read(path, nodata="none").heights, np.float32(numbers))
    np.testing.assert_array_equal(read(path, nodata=1.5).heights, np.float32(numbers))  # no int16 is 1.5
    with pytest.raises(UsageError, match="nodata"):
        read(path, nodata="x")


def test_nodata_is_compared_before_scaling(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.array([[10, 100, 1]], np.int16), transform=UTM, nodata=10)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets, dataset.units = [0.1], [0.0], ["cm"]
    np.testing.assert_array_equal(read(path).heights, np.float32([[np.nan, 0.1, 0.001]]))
    np.testing.assert_array_equal(read(path, vertical_unit="m").heights, np.float32([[np.nan, 10, 0.1]]))


@pytest.mark.parametrize(
    "dtype,tag,value,missing",
    [
        ("float32", -3.4028234663852886e38, -3.4028234663852886e38, True),
        ("float32", -3.4028234663852886e38, -3.40282e38, True),  # a text rounded on its way: beyond any height
        ("float32", None, -1e37, True),
        ("float32", None, 1e11, False),
        ("float32", None, 1e20, True),
        ("float32", -99.9, -99.9, True),  # float64 tag, float32 number
        ("float64", -99.9, float(np.float32(-99.9)), True),  # the reverse
        ("float64", -9999.0, -9999.001, False),
        ("float64", 2.2250738585072014e-308, 0.0, False),
        ("float32", 0.0, -0.0, True),
        ("float64", None, 1e300, True),
        ("float32", None, np.inf, True),
    ],
)
def test_float_nodata(tmp_path: Path, dtype: str, tag: float | None, value: float, missing: bool) -> None:
    path = write(tmp_path / "a.tif", np.array([[value, 5]], dtype), transform=UTM, nodata=tag)
    assert read(path).valid.tolist() == [[not missing, True]]


def test_masks_and_alpha(tmp_path: Path, shared_data: Path) -> None:
    numbers, mask = np.arange(12, dtype=np.int16).reshape(3, 4), np.arange(12).reshape(3, 4) % 3 != 0
    path = write(tmp_path / "a.tif", numbers, transform=UTM)
    with rasterio.open(path, "r+") as dataset:  # an external .msk
        dataset.write_mask(mask)
    np.testing.assert_array_equal(read(path).valid, mask)
    bands = np.stack([numbers, np.where(mask, 255, 0).astype(np.int16)])
    path = write(tmp_path / "b.tif", bands, transform=UTM, alpha="yes", photometric="minisblack")
    np.testing.assert_array_equal(read(path).valid, mask)
    spearfish = Source.open(
        shared_data / "spearfish-sfdem-utm13" / "sfdem.tiff"
    )  # alpha of float32, which GDAL ignores
    heights = spearfish.read(0, 477, 0, 634)
    with rasterio.open(spearfish.path) as dataset:
        raw, alpha = dataset.read()
    np.testing.assert_array_equal(np.isnan(heights), alpha == 0)
    assert (np.nanmin(heights), np.nanmax(heights)) == (1066, 1840) and spearfish.undeclared == {float(raw.min())}


def test_vertical_units_and_datum_of_the_crs(tmp_path: Path) -> None:
    numbers = np.array([[1000]], np.float32)
    feet = write(tmp_path / "ftus.tif", numbers, transform=UTM, crs="EPSG:32611+6360")  # NAVD88 height (ftUS)
    dem = read(feet)
    assert dem.heights[0, 0] == np.float32(1000 * 1200 / 3937) and dem.vertical == "NAVD88 height"
    assert dem.grid.crs == CRS("EPSG:32611")
    assert read(feet, vertical_unit="ft").heights[0, 0] == np.float32(304.8)
    three = write(tmp_path / "3d.tif", numbers, transform=Affine(0.1, 0, 7, 0, -0.1, 46), crs="EPSG:4979")
    dem = read(three)
    assert dem.vertical == "ellipsoidal height" and dem.grid.crs == CRS("EPSG:4326")
    with pytest.raises(UsageError, match="unit"):
        read(feet, vertical_unit="furlong")


def test_unit_names() -> None:
    for name in ("m", "Metre", " meters ", "US survey foot", "us_survey_foot", "ft", "FEET", "centimetre"):
        assert metres_per(name) is not None
    assert metres_per("ft") == 0.3048 and metres_per("US survey foot") == 1200 / 3937
    for name in ("K", "Celsius", "degrees", "", "1"):
        assert metres_per(name) is None


def test_bands(shared_data: Path) -> None:
    path = shared_data / "spdatalarge-zion-nz-ecuador" / "ecuador_terrain_attributes_5band.tif"
    assert any("band 4 ('elev')" in w for w in Source.open(path).warnings)
    source = Source.open(path, band=4)
    assert not source.warnings and source.description == "elev"
    with rasterio.open(path) as dataset:
        np.testing.assert_array_equal(read(path, band=4).heights, dataset.read(4))
    with pytest.raises(UsageError, match=r"no band 6: it has 5 bands \(1: slope"):
        Source.open(path, band=6)


def test_a_color_table_is_not_heights_unless_it_is_of_plain_greys(tmp_path: Path, shared_data: Path) -> None:
    classes = shared_data / "spdatalarge-zion-nz-ecuador" / "zion_nlcd2011.tif"
    assert any("colour table" in w for w in Source.open(classes).warnings) and Source.open(classes).picture
    assert not Source.open(shared_data / "pugetsound-openglobe" / "ps-e.lg.png").picture


# Terrain-RGB -------------------------------------------------------------------------------------------------------


def test_terrain_rgb(shared_data: Path) -> None:
    fuji = shared_data / "martini-fuji" / "fuji.png"
    assert any("picture" in w for w in Source.open(fuji).warnings)
    heights = read(fuji, encoding="mapbox").heights
    assert 3700 < heights.max() < 3777 and heights.min() > -10  # Fuji is 3776 m; the tile has coast
    with rasterio.open(fuji) as dataset:
        r, g, b = dataset.read([1, 2, 3]).astype(np.int64)[:, 100, 200]
    assert heights[100, 200] == np.float32((-100000 + (r * 65536 + g * 256 + b)) / 10)
    heights = read(shared_data / "pymartini-tiles" / "terrarium.png", encoding="terrarium").heights
    assert -500 < heights.min() < heights.max() < 8849


def test_terrain_rgb_by_its_definition() -> None:
    bands = np.array([[[1, 128]], [[134, 0]], [[160, 64]], [[255, 0]]], np.uint8)
    # Mapbox's documentation: (1, 134, 160) is 0 m; Mapzen's: (128, 0, 0) is 0 m, blue counts 256ths
    assert decode_rgb(bands[:3], "mapbox")[0, 0] == 0 and decode_rgb(bands[:3], "terrarium")[0, 1] == 0.25
    assert np.isnan(decode_rgb(bands, "mapbox")).tolist() == [[False, True]]
    with pytest.raises(ValueError, match="unknown encoding"):
        decode_rgb(bands, "png")


def test_an_encoding_needs_colors(shared_data: Path) -> None:
    with pytest.raises(UsageError, match="three bands of 8 bits"):
        read(shared_data / "n44w072-hgt" / "N44W072.hgt", encoding="mapbox")


# Files -------------------------------------------------------------------------------------------------------------


def test_packed_files(shared_data: Path, tmp_path: Path) -> None:
    hgt = shared_data / "n44w072-hgt" / "N44W072.hgt"
    truth = read(hgt)
    packed = tmp_path / "N44W072.hgt.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(hgt, "N44W072.hgt")
        archive.writestr("readme.txt", "SRTM")
    dem = read(packed)
    np.testing.assert_array_equal(dem.heights, truth.heights)
    assert dem.name == "N44W072" and dem.grid == truth.grid
    with gzip.open(tmp_path / "N44W072.hgt.gz", "wb") as file:
        file.write(hgt.read_bytes())
    np.testing.assert_array_equal(read(tmp_path / "N44W072.hgt.gz").heights, truth.heights)
    with zipfile.ZipFile(tmp_path / "two.zip", "w") as archive:
        archive.writestr("a.tif", b"")
        archive.writestr("b.tif", b"")
    with pytest.raises(ReadError, match=r"2 files.*a\.tif"):
        read(tmp_path / "two.zip")
    (tmp_path / "no.zip").write_bytes(b"PK no")
    with pytest.raises(ReadError, match="zip archive"):
        read(tmp_path / "no.zip")


def test_ascii_grid_and_cog(tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text(
        "ncols 3\nnrows 2\nxllcorner 100\nyllcorner 200\ncellsize 10\nNODATA_value -9999\n1 2 3\n4 -9999 6.5\n"
    )
    dem = read(tmp_path / "a.asc")
    np.testing.assert_array_equal(dem.heights, np.float32([[1, 2, 3], [4, np.nan, 6.5]]))
    assert dem.grid.transform == Affine(10, 0, 100, 0, -10, 220)
    numbers = np.random.default_rng(1).integers(0, 3000, (700, 600)).astype(np.int16)
    path = write(tmp_path / "cog.tif", numbers, driver="COG", transform=UTM, crs="EPSG:32611", blocksize=128)
    with rasterio.open(path) as dataset:
        assert dataset.overviews(1)
    np.testing.assert_array_equal(read(path).heights, numbers)
    with Source.open(path) as source:  # nested samples, not what the overviews hold
        np.testing.assert_array_equal(source.read(0, 700, 0, 600, step=4), numbers[::4, ::4])


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (2, 3)])
def test_single_rows_and_columns(tmp_path: Path, shape: tuple[int, int]) -> None:
    numbers = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    path = write(tmp_path / "a.tif", numbers, transform=UTM)
    np.testing.assert_array_equal(read(path).heights, numbers)


def test_steps_over_all_block_layouts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = np.random.default_rng(2).normal(size=(300, 257)).astype(np.float32)
    monkeypatch.setattr(source_module, "_CHUNK", 4096)  # many small pieces
    for i, layout in enumerate(({}, {"tiled": True, "blockxsize": 64, "blockysize": 32}, {"blockysize": 300})):
        path = write(tmp_path / f"{i}.tif", numbers, transform=Affine(1, 0, 0, 0, 1 if i == 1 else -1, 9), **layout)
        truth = numbers[::-1] if i == 1 else numbers
        with Source.open(path) as source:
            for step in (1, 2, 3, 7, 16, 64, 255, 256, 1000):
                np.testing.assert_array_equal(source.read(0, 300, 0, 257, step=step), truth[::step, ::step])
                np.testing.assert_array_equal(source.read(5, 290, 3, 250, step=step), truth[5:290:step, 3:250:step])


def test_errors_say_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="no such file"):
        read(tmp_path / "none.tif")
    with pytest.raises(ReadError, match="directory"):
        read(tmp_path)
    (tmp_path / "empty.tif").touch()
    with pytest.raises(ReadError, match="empty"):
        read(tmp_path / "empty.tif")
    (tmp_path / "text.tif").write_text("hello")
    with pytest.raises(ReadError, match="GDAL cannot open it"):
        read(tmp_path / "text.tif")
    shutil.copy(tmp_path / "text.tif", tmp_path / "mountain.hgt")
    with pytest.raises(ReadError, match="N44W072"):
        read(tmp_path / "mountain.hgt")


def test_a_truncated_file_names_the_block_and_is_never_zeros(tmp_path: Path) -> None:
    numbers = np.full((512, 512), 77, np.float32)
    path = write(tmp_path / "a.tif", numbers, transform=UTM, tiled=True, blockxsize=128, blockysize=128)
    os.truncate(path, path.stat().st_size - 100_000)
    with Source.open(path) as source:
        np.testing.assert_array_equal(source.read(0, 128, 0, 512), numbers[:128])
        with pytest.raises(ReadError, match=r"a\.tif: The block of rows 384–511, columns \d+–\d+ cannot be read"):
            source.read(0, 512, 0, 512)
    with pytest.raises(ReadError, match="truncated"):
        read(path)


def test_too_large_for_memory_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.zeros((100, 100), np.int16), transform=UTM)
    with pytest.raises(ReadError, match="limit") as error:
        read(path, max_bytes=39_999)
    assert "`orograph.build`" in error.value.remedy
    assert read(path, max_bytes=40_000).heights.shape == (100, 100)


def test_windows_outside_are_refused(tmp_path: Path) -> None:
    source = Source.open(write(tmp_path / "a.tif", np.zeros((3, 4), np.int16), transform=UTM))
    for window in ((0, 4, 0, 4), (-1, 2, 0, 4), (1, 1, 0, 4), (0, 3, 2, 5), (2, 1, 0, 4)):
        with pytest.raises(ValueError, match="window"):
            source.read(*window)
    with pytest.raises(ValueError, match="step"):
        source.read(0, 3, 0, 4, step=0)


# Handles -----------------------------------------------------------------------------------------------------------


@pytest.mark.stress
def test_many_threads_and_files(tmp_path: Path) -> None:
    """200 files read by 8 threads, each file by several at once; the idle handles stay few."""
    sources = []
    for i in range(200):
        numbers = np.full((64, 64), i, np.int16) + np.arange(64, dtype=np.int16)
        sources.append(Source.open(write(tmp_path / f"{i}.tif", numbers, transform=UTM, compress="deflate")))
    wrong: list[int] = []

    def work(seed: int) -> None:
        for i in np.random.default_rng(seed).integers(0, 200, 300):
            if not (sources[i].read(3, 5, 10, 20) == i + np.arange(10, 20)).all():
                wrong.append(i)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(8)]
    [t.start() for t in threads]
    [t.join() for t in threads]
    assert not wrong
    if Path("/proc/self/fd").exists():
        opened = [p.readlink() for p in Path("/proc/self/fd").iterdir() if p.is_symlink()]
        assert 0 < sum(str(p).startswith(str(tmp_path)) for p in opened) <= handle_pool.IDLE
    for source in sources:
        source.close()
    if Path("/proc/self/fd").exists():
        opened = [p.readlink() for p in Path("/proc/self/fd").iterdir() if p.is_symlink()]
        assert not any(str(p).startswith(str(tmp_path)) for p in opened)


def test_opening_reads_no_samples(shared_data: Path) -> None:
    source = Source.open(shared_data / "nasty-gdal" / "huge4GB.tif")  # any sample of it is an error
    assert source.shape == (65535, 65535) and source.block == (1, 65535)


def test_dem_holds_what_it_says() -> None:
    grid = Grid((2, 3), UTM)
    with pytest.raises(TypeError, match="float32"):
        Dem(np.zeros((2, 3)), grid)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="grid"):
        Dem(np.zeros((3, 2), np.float32), grid)


def test_a_dem_says_what_to_use() -> None:
    grid = Grid((2, 3), Affine(30, 0, 0, 0, -30, 0), CRS.from_epsg(32611))
    dem = Dem(np.arange(6, dtype=np.float32).reshape(2, 3), grid)
    again = orograph.terrain(dem.to_xarray())
    np.testing.assert_array_equal(again.read(0, 0, 2, 0, 3), dem.heights)
    assert again.grid == grid and copy.deepcopy(dem) is not dem
    for name, here in (("plot", "render"), ("save", "export"), ("values", "heights"), ("crs", "grid.crs")):
        with pytest.raises(AttributeError, match=here):
            getattr(dem, name)
    assert not hasattr(dem, "__geo_interface__")


def test_a_raster_that_is_read_as_a_whole_warns_as_all_functions_do(tmp_path: Path) -> None:
    path = tmp_path / "dem.tif"
    y, x = np.mgrid[:60, :70]
    heights = (500 + 20 * np.sin(x / 9) * np.cos(y / 7)).astype("float32")
    heights[20:40, 30:60] = -9999
    with rasterio.open(path, "w", driver="GTiff", width=70, height=60, count=1, dtype="float32") as file:
        file.write(heights, 1)
    with pytest.warns(UserWarning) as told:
        read(path)
    texts = [str(one.message) for one in told]
    assert any("samples are assumed to be 1 m apart" in text for text in texts)
    assert any("-9999" in text and "nodata" in text for text in texts)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        read(path, progress=False)
        read(path, spacing=30, nodata=-9999)
