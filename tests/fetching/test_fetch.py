"""Fetched heights are the tiles' own, to the bit and once each; seas, holes, seams, meridians, and other tilings."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image
from pyproj import Transformer
from sources import copernicus, heights, nasa, skadi, terrarium, tiff

import orograph
import orograph.store
from orograph.errors import ReadError, UsageError
from orograph.fetching import Request, register
from orograph.progress import Progress

BOX = (-119.3, 36.8, -118.6, 37.25)  # over the corner of four tiles


def joined(tiles):
    """(2400, 2400) samples of the four tiles, from 38° N, 120° W on."""
    return np.block([[tiles["N37W120"], tiles["N37W119"]], [tiles["N36W120"], tiles["N36W119"]]]).astype(np.float32)


def rows_and_columns(dem, n=1200, north=38, west=-120):
    """Where the DEM's first sample lies among those of ``joined``."""
    col, row = dem.grid.xy(0, 0)
    i, j = (north - float(row)) * n, (float(col) - west) * n
    assert abs(i - round(i)) < 1e-6
    assert abs(j - round(j)) < 1e-6
    return round(i), round(j)


def test_samples_of_four_tiles_are_the_tiles_own_and_appear_once(california, cut_tiles):
    dem = orograph.fetch(BOX, "copernicus-90")
    i, j = rows_and_columns(dem)
    rows, cols = dem.grid.shape
    assert (i, j) == (900, 840)
    assert (rows, cols) == (541, 841)  # every bound lies on a sample, and both ends count
    np.testing.assert_array_equal(dem.heights, joined(cut_tiles)[i : i + rows, j : j + cols])
    assert dem.vertical == "EGM2008 height"
    assert "Airbus" in dem.attribution[0]
    assert dem.grid.crs.to_epsg() == 4326


def test_bounds_between_samples_are_surrounded(california):
    dem = orograph.fetch((-119.30001, 36.80001, -118.6001, 37.2501), "copernicus-90")
    (west, north), (east, south) = dem.grid.xy(0, 0), dem.grid.xy(dem.grid.cols - 1, dem.grid.rows - 1)
    step = 1 / 1200
    assert -119.30001 - step < west < -119.30001
    assert -118.6001 < east < -118.6001 + step
    assert 36.80001 - step < south < 36.80001
    assert 37.2501 < north < 37.2501 + step


def test_one_whole_tile_of_shared_borders_needs_no_other(srtm, shared_data):
    dem = orograph.fetch((-119, 37, -118, 38), "srtm-3")
    np.testing.assert_array_equal(dem.heights, heights(shared_data, "N37W119").astype(np.float32))
    assert set(srtm.asked) == {"srtm-3/North/North_30_60/N37W119.tif"}
    assert dem.vertical == "EGM96 height"


def test_shared_borders_appear_once_and_each_sample_is_its_owners(srtm, shared_data):
    dem = orograph.fetch((-119.5, 36.5, -118.5, 37.5), "srtm-3")
    names = [["N37W120", "N37W119"], ["N36W120", "N36W119"]]
    truth = np.block([[heights(shared_data, n)[:1200, :1200] for n in row] for row in names])
    np.testing.assert_array_equal(dem.heights, truth[600:1801, 600:1801].astype(np.float32))


def test_a_row_shared_with_an_absent_tile_is_the_other_ones(srtm, shared_data):
    del srtm.files["srtm-3/North/North_30_60/N36W119.tif"], srtm.files["srtm-3/North/North_30_60/N36W120.tif"]
    dem = orograph.fetch((-118.9, 36.9, -118.5, 37.1), "srtm-3")
    tile = heights(shared_data, "N37W119")
    np.testing.assert_array_equal(dem.heights[:121], tile[1080:1201, 120:601].astype(np.float32))
    assert not dem.heights[121:].any()  # sea


def test_an_absent_tile_is_sea_or_missing_as_the_product_says_or_as_asked(california, cut_tiles):
    truth = joined(cut_tiles)[900:1441, 840:1681].copy()
    gone = [path for path in california.files if "N37_00_W119" in path]
    del california.files[gone[0]]
    dem = orograph.fetch(BOX, "copernicus-90")
    truth[:300, 360:] = 0
    np.testing.assert_array_equal(dem.heights, truth)
    dem = orograph.fetch(BOX, "copernicus-90", absent="missing")
    truth[:300, 360:] = np.nan
    np.testing.assert_array_equal(dem.heights, truth)


def test_a_tile_that_a_coarser_product_has_is_no_sea(california, cut_tiles):
    """GLO-30 lacks the tiles of some countries, which GLO-90 has."""
    register("copernicus-30", spacing=3)  # tiles of GLO-30 would take minutes to make
    tile = next(data for path, data in california.files.items() if "N37_00_W120" in path)
    name = "Copernicus_DSM_COG_10_N37_00_W120_00_DEM"
    california.files[f"copernicus-30/{name}/{name}.tif"] = tile
    dem = orograph.fetch((-119.5, 37.2, -118.5, 37.4), "copernicus-30")
    assert np.isnan(dem.heights[:, 600:]).all()
    np.testing.assert_array_equal(dem.heights[:, :600], cut_tiles["N37W120"][720:961, 600:].astype(np.float32))


def test_across_the_180th_meridian(web, cut_tiles, tmp_path):
    for name, values in (("S17E179", cut_tiles["N37W120"]), ("S17W180", cut_tiles["N37W119"])):
        path, data = copernicus(name, values)
        web.files[f"copernicus-90/{path}"] = data
    dem = orograph.fetch((179.5, -16.75, -179.5, -16.25), "copernicus-90")
    truth = np.block([cut_tiles["N37W120"], cut_tiles["N37W119"]]).astype(np.float32)
    np.testing.assert_array_equal(dem.heights, truth[300:901, 600:1801])
    assert dem.grid.xy(0, 0)[0] == pytest.approx(179.5)
    assert dem.grid.xy(1200, 0)[0] == pytest.approx(180.5)
    terrain = orograph.store.build(dem, tmp_path / "fiji.oro")
    assert terrain.valid_fraction > 0.9
    assert terrain.grid.crs.is_projected


def test_columns_that_lie_farther_apart_polewards_are_interpolated_on_those_of_the_south(web, cut_tiles):
    """A ramp of longitude is reproduced exactly by linear interpolation; rows on the columns of the south are kept."""
    lon = -10 + np.arange(1200) / 1200
    south = np.broadcast_to(2 * lon, (1200, 1200))
    north = np.broadcast_to(2 * (-10 + np.arange(800) / 800), (1200, 800))
    east = np.broadcast_to(2 * (-9 + np.arange(800) / 800), (1200, 800))
    for name, values, factor in (("N49W010", south, 1), ("N50W010", north, 1.5), ("N50W009", east, 1.5)):
        path, data = copernicus(name, values, factor)
        web.files[f"copernicus-90/{path}"] = data
    told = []

    class Heard(Progress):
        def warn(self, text):
            told.append(text)

    dem = orograph.fetch((-9.9, 49.9, -9.0004, 50.1), "copernicus-90", progress=Heard(), absent="missing")
    x, y = dem.grid.xy(np.arange(dem.grid.cols), 0)[0], dem.grid.xy(0, np.arange(dem.grid.rows))[1]
    assert any(abs(y - 50) < 1e-9)
    for row in np.flatnonzero(y > 50 + 1e-9):
        np.testing.assert_allclose(dem.heights[row], 2 * x, atol=2e-5)
    for row in np.flatnonzero(y < 50 + 1e-9):
        np.testing.assert_array_equal(dem.heights[row][:-1], (2 * x).astype(np.float32)[:-1])
    assert any("interpolated" in text for text in told)


@pytest.mark.stress
def test_gzipped_and_zipped_hgt_tiles(web, shared_data):
    values = np.fromfile(shared_data / "n44w072-hgt" / "N44W072.hgt", ">i2").reshape(1201, 1201)
    path, data = skadi("N44W072", values)
    web.files[f"skadi/{path}"] = data
    path, data = nasa("N44W072", values)
    web.files[f"srtm-1-nasa/{path}"] = data
    for name in ("skadi", "srtm-1-nasa"):
        register(name, spacing=3)  # this tile has 3″
        dem = orograph.fetch((-71.5, 44.1, -71.2, 44.4), name)
        np.testing.assert_array_equal(dem.heights, values[720:1081, 600:961].astype(np.float32))


def test_tiles_of_the_webs_mercator(web, shared_data):
    png = (shared_data / "pymartini-tiles" / "terrarium.png").read_bytes()
    real = np.asarray(Image.open(io.BytesIO(png)), np.float64)
    metres = (real[..., 0] * 256 + real[..., 1] + real[..., 2] / 256 - 32768).astype(np.float32)
    web.files["terrarium/3/1/2.png"] = png
    web.files["terrarium/3/2/2.png"] = terrarium(metres[::-1])
    dem = orograph.fetch((-100, 45, -80, 60), "terrarium", zoom=3)
    col = round((-100 + 180) / 360 * 2048 - 0.5)
    assert dem.grid.crs.to_epsg() == 3857
    x, y = dem.grid.xy(0, 0)
    lon, lat = Transformer.from_crs(3857, 4326, always_xy=True).transform(x, y)
    assert lon == pytest.approx((col + 0.5) / 2048 * 360 - 180)
    assert lat <= 60 + 0.1
    both = np.hstack([metres, metres[::-1]])
    row = round((20037508.342789244 - y) / (2 * 20037508.342789244) * 2048 - 0.5) - 512
    np.testing.assert_array_equal(dem.heights, both[row : row + dem.grid.rows, col - 256 : col - 256 + dem.grid.cols])
    with pytest.raises(UsageError, match="zooms 0 to 15"):
        orograph.fetch((-100, 45, -80, 60), "terrarium", zoom=16)


def test_cells_on_whole_degrees_and_tiles_that_overlap(web, cut_tiles):
    """3DEP: cells, 6 more on each side of a tile, named by the north-west corner, NAD 83."""
    n, values = 1200, joined(cut_tiles)
    inner = values[600:1800, 600:1800]
    register("3dep-30", spacing=3)
    data = tiff(values[594:1806, 594:1806], -119 - 6 / n, 38 + 6 / n, 1 / n, 1 / n, "EPSG:4269", nodata=-999999)
    web.files["3dep-30/n38w119/USGS_1_n38w119.tif"] = data
    dem = orograph.fetch((-118.75, 37.25, -118.5, 37.5), "3dep-30")
    np.testing.assert_array_equal(dem.heights, inner[600:900, 300:600])
    assert dem.grid.bounds() == pytest.approx((-118.75, 37.25, -118.5, 37.5))
    assert dem.vertical == "NAVD88 height"
    assert dem.grid.crs.to_epsg() == 4269


def test_one_file_of_another_body(web):
    """A simple cylindrical Moon of 1 sample a degree, scaled by half; also across its 180th meridian."""
    crs = "+proj=eqc +R=1737400 +units=m +no_defs"
    size = 1737400 * np.pi / 180
    values = (np.arange(180)[:, None] * 100 + np.arange(360)).astype(np.int16)
    data = tiff(values, -180 * size, 90 * size, size, size, crs)
    web.files["lola/Lunar_LRO_LOLA_Global_LDEM_118m_Mar2014.tif"] = data
    dem = orograph.fetch((-20, 10, -15, 12), "lola")
    np.testing.assert_array_equal(dem.heights, values[78:80, 160:165].astype(np.float32) / 2)
    dem = orograph.fetch((178, 10, -178, 12), "lola")
    around = np.hstack([values[78:80, 358:], values[78:80, :2]])
    np.testing.assert_array_equal(dem.heights, around.astype(np.float32) / 2)


def test_places_and_geometries(california):
    dem = orograph.fetch((-118.9, 37.1), "copernicus-90", radius=3000)
    west, south, east, north = dem.grid.bounds()
    assert (east - west) * 111320 * np.cos(np.radians(37.1)) == pytest.approx(6000, rel=0.05)
    assert (north - south) * 111000 == pytest.approx(6000, rel=0.05)
    shape = {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [
        [[-118.9, 37.1], [-118.8, 37.1], [-118.85, 37.2], [-118.9, 37.1]]]}}  # fmt: skip
    dem = orograph.fetch(shape, "copernicus-90")
    assert dem.grid.bounds() == pytest.approx((-118.9, 37.1, -118.8, 37.2), abs=1 / 1200)


def test_a_tile_that_is_not_of_the_product_is_refused_by_name(california):
    path = next(p for p in california.files if "N37_00_W119" in p)
    small = np.zeros((600, 600), np.float32)
    california.files[path] = tiff(small, -119 - 0.5 / 1200, 38 + 0.5 / 1200, 1 / 1200, 1 / 1200)
    with pytest.raises(ReadError, match=r"copernicus-90, tile N37W119: it has 600 × 600 samples") as told:
        orograph.fetch((-118.9, 37.1, -118.8, 37.2), "copernicus-90")
    assert told.value.path.startswith("http://127.0.0.1")
    california.files[path] = tiff(small, -119, 38, 1 / 600, 1 / 600)
    with pytest.raises(ReadError, match="not those of the product"):
        orograph.fetch((-118.9, 37.1, -118.8, 37.2), "copernicus-90")


def test_sizes_are_told_before_anything_is_asked_for(web):
    with pytest.raises(UsageError, match=r"10,\d\d\d|1 tile|tiles, .* samples, at most .* MB") as told:
        orograph.fetch((0, 0, 60, 60), "copernicus-30")
    assert "most=None" in told.value.remedy
    assert web.total == 0
    with pytest.raises(UsageError, match="more than fits into a Dem"):
        orograph.fetch((0, 0, 60, 60), "copernicus-30", most=None)
    assert web.total == 0


@pytest.mark.parametrize("gone", ["N36W119", "N37W120", None])
def test_a_window_is_a_part_of_the_whole(srtm, gone):
    """Also where neighbours share a row or a column with a tile that is absent."""
    if gone is not None:
        del srtm.files[f"srtm-3/North/North_30_60/{gone}.tif"]
    with Request((-119.01, 36.99, -118.99, 37.01), "srtm-3").fetched() as raster:
        rows, cols = raster.grid.shape
        whole = raster.read(0, rows, 0, cols)
        assert not np.isnan(whole).any()
        rng = np.random.default_rng(4)
        for _ in range(60):
            a, c = rng.integers(0, rows), rng.integers(0, cols)
            b, d = rng.integers(a + 1, rows + 1), rng.integers(c + 1, cols + 1)
            np.testing.assert_array_equal(raster.read(a, b, c, d), whole[a:b, c:d])


def test_a_window_of_interpolated_rows_is_a_part_of_the_whole(web, cut_tiles):
    for name in ("N50W010", "N50W009"):
        path, data = copernicus(name, cut_tiles["N37W119"][:, :800], 1.5)
        web.files[f"copernicus-90/{path}"] = data
    with Request((-9.05, 49.98, -8.95, 50.03), "copernicus-90").fetched() as raster:
        rows, cols = raster.grid.shape
        whole = raster.read(0, rows, 0, cols)
        for col in range(cols):
            np.testing.assert_array_equal(raster.read(3, rows, col, col + 1), whole[3:, col : col + 1])
