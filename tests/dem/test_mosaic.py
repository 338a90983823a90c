"""Mosaics against brute force (exact pyproj + SciPy), against GDAL, and against the raster they were cut from."""

from __future__ import annotations

import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from rasterio.warp import Resampling, reproject
from scipy.ndimage import map_coordinates

from orograph.dem import layers as layers_module
from orograph.dem.mosaic import Mosaic
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, compose
from orograph.store.source import ArraySource

WGS84 = CRS.from_epsg(4326)
UTM11 = CRS.from_epsg(32611)


@dataclass
class Held:
    """A raster in memory."""

    heights: NDArray[np.float32]
    grid: Grid
    name: str = "held"
    vertical: str | None = None

    def read(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
        assert 0 <= row0 < row1 <= self.grid.rows and 0 <= col0 < col1 <= self.grid.cols
        return self.heights[row0:row1, col0:col1].copy()


def held(heights: NDArray, transform: Affine, crs: CRS | None, **more: str) -> Held:
    return Held(np.asarray(heights, np.float32), Grid(heights.shape, transform, crs), **more)


def cut(whole: Held, *windows: tuple[int, int, int, int]) -> list[Held]:
    return [Held(whole.heights[a:b, c:d], whole.grid.window(a, b, c, d), f"{a}-{c}") for a, b, c, d in windows]


def everything(m: Mosaic) -> NDArray[np.float32]:
    return m.read(0, m.grid.rows, 0, m.grid.cols)


def same(a: NDArray, b: NDArray) -> bool:
    return np.array_equal(a, b, equal_nan=True)


def hills(rows: int, cols: int, seed: int = 0) -> NDArray[np.float32]:
    from scipy.ndimage import gaussian_filter

    rough = np.random.default_rng(seed).normal(size=(rows, cols))
    return (gaussian_filter(rough, 4) * 4000 + 500).astype(np.float32)


def truth(m: Mosaic, source: Held) -> NDArray[np.float64]:
    """Bilinear by SciPy at coordinates projected one by one by pyproj; NaN beyond the outermost samples."""
    cols, rows = np.meshgrid(np.arange(m.grid.cols), np.arange(m.grid.rows))
    x, y = m.grid.xy(cols, rows)
    x, y = Transformer.from_crs(m.grid.crs, source.grid.crs, always_xy=True).transform(x, y)
    if source.grid.crs is not None and source.grid.crs.is_geographic:
        middle = source.grid.xy(source.grid.cols / 2, 0)[0]
        x = x + 360 * np.round((middle - x) / 360)
    u, v = source.grid.index(x, y)
    return map_coordinates(source.heights.astype(float), [v, u], order=1, mode="constant", cval=np.nan)


def geographic(box: tuple[float, float, float, float], cols: int, seed: int = 0) -> Held:
    west, south, east, north = box
    step = (east - west) / cols
    heights = hills(round((north - south) / step), cols, seed)
    return held(heights, Affine(step, 0, west, 0, -step, north), WGS84)


@pytest.mark.parametrize(
    "box",
    [
        (-117, 36, -116, 37),
        (179.5, -17, 180.5, -16),  # across the antimeridian, eastwards
        (-180.5, 65, -179.5, 66),
        (242.5, 36, 243.5, 37),  # longitudes 0…360
        (10, 86, 16, 87),
        (-125, 36, -114, 40),
    ],
)
def test_equals_exact_projection_and_scipy(box: tuple[float, float, float, float]) -> None:
    source = geographic(box, 300)
    m = Mosaic([source], resolution=source.grid.transform.a * 111_320 * np.cos(np.radians(box[3])))  # nothing averaged
    got, want = everything(m), truth(m, source)
    both = ~np.isnan(got) & ~np.isnan(want)
    assert both.mean() > 0.3
    slope = np.abs(np.diff(source.heights, axis=0)).max() + np.abs(np.diff(source.heights, axis=1)).max()
    difference = np.abs(got - want)[both]
    assert difference.max() < 0.01 * slope + 1e-3  # coordinates are within 0.01 sample
    assert difference.mean() < 0.02
    assert not np.any(np.isnan(got) & ~np.isnan(want))


@pytest.mark.parametrize("box", [(-180, 84.5, 180, 90), (0, -90, 360, -80)])
def test_around_a_pole(box: tuple[float, float, float, float]) -> None:
    """The whole circle, in which columns repeat: no seam at the raster's edge, none at the pole but the last row."""
    west, south, _, north = box
    cols, rows = 1440, round((north - south) * 4)
    step = 0.25
    transform = Affine(step, 0, west, 0, -step, north)
    c, r = np.meshgrid(np.arange(cols), np.arange(rows))
    lon, lat = Grid((rows, cols), transform, WGS84).xy(c, r)
    colatitude = 90 - np.abs(lat)
    heights = 1000 + 80 * colatitude * np.cos(np.radians(lon))  # a plane near the pole, nearly
    m = Mosaic([held(heights, transform, WGS84)])
    got = everything(m)
    x, y = m.grid.xy(*np.meshgrid(np.arange(m.grid.cols), np.arange(m.grid.rows)))
    lon, lat = Transformer.from_crs(m.grid.crs, WGS84, always_xy=True).transform(x, y)
    want = 1000 + 80 * (90 - np.abs(lat)) * np.cos(np.radians(lon))
    inside = 90 - np.abs(lat) < (north - south) - step
    assert not np.isnan(got[inside]).any()
    # the half row around the pole has one value per column
    assert np.abs(got - want)[inside].max() < 80 * step / 2 + 0.5
    assert np.abs(got - want)[inside & (90 - np.abs(lat) > step)].max() < 0.1


@pytest.mark.parametrize("west", [-180.0, 0.0])
@pytest.mark.parametrize("code", ["EPSG:8857", "ESRI:54009"])  # Equal Earth, Mollweide: equal-area, curved rims
def test_beyond_the_rim_of_a_world_map_there_is_nothing(code: str, west: float) -> None:
    lon = west + 0.5 + np.arange(360)
    turned = (lon + 180) % 360 - 180
    world = held(np.broadcast_to(turned, (180, 360)), Affine(1, 0, west, 0, -1, 90), WGS84)
    m = Mosaic([world], crs=code, resolution=50_000, resampling="nearest")
    found = everything(m)
    area = np.isfinite(found).sum() * 50_000.0**2
    assert area == pytest.approx(510.066e12, rel=0.004)  # of the WGS 84 ellipsoid
    assert found.size * 50_000.0**2 > 1.1 * area
    x = np.broadcast_to(m.grid.xy(np.arange(m.grid.cols), 0)[0], found.shape)
    known = np.isfinite(found) & (np.abs(x) > 200_000)
    assert (np.sign(found[known]) == np.sign(x[known])).all()  # west is left, east is right
    assert same(m.read(20, 45, 3, 600), found[20:45, 3:600])


def test_against_gdal_on_a_real_tile(shared_data: Path) -> None:
    """GDAL interpolates positions along its rows (rasterio gives no way to have them exact), so its pixels depend on
    the window: 8 m off in one of the whole tile, right in one of 16². Finer than the source it does not widen its
    kernel, and is plain bilinear."""
    path = shared_data / "california-3s-tiles" / "N38W119.tif"
    m = Mosaic.open(path, resolution=60)
    assert m.grid.crs is not None
    with rasterio.open(path) as file:
        heights, transform, crs = file.read(1).astype(np.float32), file.transform, file.crs
    rng = np.random.default_rng(0)
    differences = []
    for row, col in zip(rng.integers(60, m.grid.rows - 80, 25), rng.integers(60, m.grid.cols - 80, 25)):
        window = (int(row), int(row) + 16, int(col), int(col) + 16)
        want = np.full((16, 16), np.nan, np.float32)
        reproject(
            heights,
            want,
            src_transform=transform,
            src_crs=crs,
            dst_transform=m.grid.window(*window).transform,
            dst_crs=m.grid.crs.to_wkt(),
            resampling=Resampling.bilinear,
            src_nodata=np.nan,
            dst_nodata=np.nan,
        )
        differences.append(np.abs(m.read(*window) - want))
    assert np.mean(differences) < 0.005 and np.max(differences) < 0.05


def test_sea_stays_at_zero_and_constants_constant() -> None:
    for height in (0.0, -85.0, 123.4):
        source = geographic((-117, 36, -116, 37), 120)
        source.heights[:] = height
        got = everything(Mosaic([source]))
        assert set(np.unique(got[~np.isnan(got)])) == {np.float32(height)}
        coarse = everything(Mosaic([source], resolution=5000))
        assert set(np.unique(coarse[~np.isnan(coarse)])) == {np.float32(height)}


@pytest.mark.parametrize("method", ["bilinear", "cubic"])
@pytest.mark.parametrize("resolution", [7.0, 10.0, 33.0, 100.0])
def test_a_plane_comes_out_as_a_plane(method: str, resolution: float) -> None:
    """Slanted sampling, shrinking (with averaging) and growing all keep a plane."""
    transform = compose(Affine.translation(500_000, 4_000_000), Affine.rotation(13), Affine.scale(10, -10))
    grid = Grid((300, 280), transform, UTM11)
    x, y = grid.xy(*np.meshgrid(np.arange(280), np.arange(300)))
    plane = lambda x, y: 0.3 * (x - 500_000) - 0.2 * (y - 4_000_000) + 50  # noqa: E731
    m = Mosaic([held(plane(x, y), transform, UTM11)], resolution=resolution, resampling=method)
    got = everything(m)
    x, y = m.grid.xy(*np.meshgrid(np.arange(m.grid.cols), np.arange(m.grid.rows)))
    col, row = grid.index(x, y)
    margin = 1.5 * max(1, resolution / 10)
    inside = (col > margin) & (col < 279 - margin) & (row > margin) & (row < 299 - margin)
    assert inside.sum() > 100 and np.abs(got - plane(x, y))[inside].max() < 1e-3


def test_coarser_resolution_does_not_alias() -> None:
    """A checkerboard of single samples averages out; sampled without averaging it would not."""
    heights = np.where(np.add.outer(np.arange(400), np.arange(400)) % 2, 100.0, 0.0)
    got = everything(Mosaic([held(heights, Affine(10, 0, 500_003, 0, -10, 4_000_001), UTM11)], resolution=40))
    assert np.nanmax(np.abs(got[2:-2, 2:-2] - 50)) < 1e-3


def test_projected_is_kept_to_the_bit_and_rotated_too() -> None:
    for transform in (
        Affine(30, 0, 500_000.5, 0, -30, 4e6),
        compose(Affine.translation(5e5, 4e6), Affine.rotation(20), Affine.scale(5, -5)),
    ):
        source = held(hills(90, 70), transform, UTM11)
        source.heights[4:9, 3:8] = np.nan
        m = Mosaic([source])
        assert m.lossless and m.grid == source.grid and same(everything(m), source.heights)


def test_feet_become_metres_sample_for_sample() -> None:
    feet = CRS.from_epsg(2229)
    source = held(hills(50, 60), Affine(100, 0, 6_500_000, 0, -100, 1_900_000), feet)
    m = Mosaic([source])
    assert m.lossless and same(everything(m), source.heights)
    assert m.grid.spacing == pytest.approx((100 * 1200 / 3937,) * 2)
    assert m.grid.crs is not None and m.grid.crs.axis_info[0].unit_name == "metre"
    place = Transformer.from_crs(feet, WGS84, always_xy=True).transform(*source.grid.xy(20, 30))
    again = Transformer.from_crs(m.grid.crs, WGS84, always_xy=True).transform(*m.grid.xy(20, 30))
    assert np.allclose(place, again, atol=1e-11)


SPLITS = {
    "touching": [(0, 50, 0, 60), (0, 50, 60, 130), (50, 110, 0, 60), (50, 110, 60, 130)],
    "shared edge": [(0, 51, 0, 61), (0, 51, 60, 130), (50, 110, 0, 61), (50, 110, 60, 130)],
    "overlapping": [(0, 70, 0, 80), (0, 70, 40, 130), (30, 110, 0, 80), (30, 110, 40, 130)],
}


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("crs", [WGS84, UTM11], ids=["degrees", "metres"])
@pytest.mark.parametrize("resolution", [None, 370.0])
def test_tiles_equal_the_raster_they_were_cut_from(split: str, crs: CRS, resolution: float | None) -> None:
    transform = Affine(0.001, 0, -117, 0, -0.001, 36) if crs is WGS84 else Affine(90, 0, 5e5, 0, -90, 4e6)
    whole = held(hills(110, 130), transform, crs)
    a, b = Mosaic([whole], resolution=resolution), Mosaic(cut(whole, *SPLITS[split]), resolution=resolution)
    assert a.grid == b.grid and a.lossless == b.lossless
    assert same(everything(a), everything(b))


def test_a_missing_tile_is_missing_and_nothing_else() -> None:
    whole = held(hills(110, 130), Affine(0.001, 0, -117, 0, -0.001, 36), WGS84)
    hole = Held(whole.heights.copy(), whole.grid)
    hole.heights[50:, 60:] = np.nan
    a, b = Mosaic([hole]), Mosaic(cut(whole, *SPLITS["touching"][:3]))
    assert a.grid == b.grid and same(everything(a), everything(b))
    assert np.isnan(everything(b)).mean() > 0.2


def test_first_file_with_a_valid_sample_wins() -> None:
    transform = Affine(30, 0, 5e5, 0, -30, 4e6)
    one, two = np.full((20, 20), 1.0), np.full((20, 20), 2.0)
    one[5:10, 12:] = np.nan
    sources = [held(one, transform, UTM11), held(two, compose(transform, Affine.translation(10, 0)), UTM11)]
    got = everything(Mosaic(sources))
    want = np.full((20, 30), 2.0, np.float32)
    want[:, :20] = 1
    want[5:10, 12:20] = 2
    assert same(got, want)
    assert (everything(Mosaic(sources[::-1]))[:, 10:] == 2).all()


@pytest.mark.parametrize("order", [1, -1])
def test_finest_wins_and_coarser_fills(order: int) -> None:
    fine = held(hills(100, 100, 1), Affine(10, 0, 500_000, 0, -10, 4_000_000), UTM11)
    fine.heights[30:40, 30:50] = np.nan
    coarse = held(np.full((60, 60), 7.0), Affine(50, 0, 499_015, 0, -50, 4_001_010), UTM11)
    m = Mosaic([fine, coarse][::order])
    got = everything(m)
    col, row = (round(float(v)) for v in m.grid.index(*fine.grid.xy(0, 0)))
    inner = got[row : row + 100, col : col + 100]
    valid = ~np.isnan(fine.heights)
    assert same(inner[valid], fine.heights[valid]) and (inner[~valid] == 7).all()
    assert not m.lossless and (got[:row] == 7)[5:, 5:-5].all()


def test_mixed_crs_agree_where_they_meet() -> None:
    """One smooth surface seen through two UTM zones and degrees: the mosaic is that surface."""

    def surface(lon: NDArray, lat: NDArray) -> NDArray:
        return 1000 + 500 * np.sin(lon * 40) * np.cos(lat * 35)

    def make(crs: CRS, transform: Affine, shape: tuple[int, int]) -> Held:
        grid = Grid(shape, transform, crs)
        x, y = grid.xy(*np.meshgrid(np.arange(shape[1]), np.arange(shape[0])))
        return held(surface(*Transformer.from_crs(crs, WGS84, always_xy=True).transform(x, y)), transform, crs)

    zone10, zone11 = CRS.from_epsg(32610), UTM11
    sources = [
        make(zone11, Affine(100, 0, 240_000, 0, -100, 4_020_000), (300, 300)),
        make(zone10, Affine(101, 0, 740_000, 0, -101, 4_030_000), (300, 300)),
        make(WGS84, Affine(0.0012, 0, -120.2, 0, -0.0012, 36.3), (300, 500)),
    ]
    m = Mosaic(sources)
    assert m.grid.crs == zone11
    got = everything(m)
    x, y = m.grid.xy(*np.meshgrid(np.arange(m.grid.cols), np.arange(m.grid.rows)))
    want = surface(*Transformer.from_crs(zone11, WGS84, always_xy=True).transform(x, y))
    difference = np.abs(got - want)[~np.isnan(got)]
    # Bilinear itself is off by 0.4 m; half a sample of the steepest slope (0.22) at the rims, which are constant.
    assert (difference > 0.5).mean() < 0.01 and difference.max() < 12
    assert (~np.isnan(got)).mean() > 0.5


def test_adjacent_rasters_of_different_lattices_leave_no_gap() -> None:
    left = held(np.full((50, 50), 3.0), Affine(30, 0, 500_000, 0, -30, 4_000_000), UTM11)
    right = held(np.full((70, 70), 3.0), Affine(21, 0, 501_500, 0, -21, 4_000_000), UTM11)
    got = everything(Mosaic([left, right], resolution=10))
    assert (got[:140] == 3).all()


def california(data: Path) -> Sequence[Path]:
    return sorted((data / "california-3s-tiles").glob("N3[67]W11[89].tif"))


@pytest.mark.stress
def test_no_seam_between_real_tiles(shared_data: Path) -> None:
    """Across shared edges the steps from sample to sample are no larger than within the tiles."""
    m = Mosaic.open(california(shared_data))
    heights = everything(m)
    assert not np.isnan(heights[200:-200, 200:-200]).any()
    lon, lat = Transformer.from_crs(m.grid.crs, WGS84, always_xy=True).transform(
        *m.grid.xy(*np.meshgrid(np.arange(m.grid.cols), np.arange(m.grid.rows)))
    )
    bend = np.full(heights.shape, np.nan)
    bend[:, 1:-1] = np.abs(np.diff(heights, 2, axis=1))
    seam = (np.abs(lon + 118) < 0.0008) & (np.abs(lat - 37) < 0.9)
    beside = (np.abs(lon + 118) < 0.01) & (np.abs(lat - 37) < 0.9) & ~seam
    assert np.nanmean(bend[seam]) < 1.1 * np.nanmean(bend[beside])


@pytest.fixture(scope="module")
def tricky() -> tuple[Mosaic, NDArray[np.float32]]:
    """Two lattices, voids, averaging in one of them and a polar projection (bent mesh cells)."""
    fine = geographic((20, 88.0, 60, 89.9), 800)
    fine.heights[np.random.default_rng(1).random(fine.heights.shape) < 0.05] = np.nan
    coarse = geographic((-180, 87, 180, 90), 1800, seed=3)
    m = Mosaic([fine, coarse], resolution=1500)
    return m, everything(m)


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_windows_are_the_same_to_the_bit(tricky: tuple[Mosaic, NDArray[np.float32]], data: st.DataObject) -> None:
    m, whole = tricky
    rows, cols = m.grid.shape
    row0, col0 = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, cols - 1))
    row1, col1 = (
        data.draw(st.integers(row0 + 1, min(rows, row0 + 90))),
        data.draw(st.integers(col0 + 1, min(cols, col0 + 90))),
    )
    assert same(m.read(row0, row1, col0, col1), whole[row0:row1, col0:col1])


@pytest.mark.stress
def test_threads_and_internal_pieces_do_not_matter(
    tricky: tuple[Mosaic, NDArray[np.float32]], monkeypatch: pytest.MonkeyPatch
) -> None:
    m, whole = tricky
    monkeypatch.setattr(layers_module, "PIECE", 3000)
    monkeypatch.setattr(layers_module, "BUDGET", 20_000)
    monkeypatch.setattr(layers_module, "STRIP", 7)
    rows, cols = m.grid.shape
    windows = [(r, min(r + 61, rows), c, min(c + 83, cols)) for r in range(0, rows, 61) for c in range(0, cols, 83)]
    with ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(lambda w: m.read(*w), windows))
    for (a, b, c, d), part in zip(windows, parts):
        assert same(part, whole[a:b, c:d])


def test_voids_keep_their_size() -> None:
    source = geographic((-117, 36, -116, 37), 400)
    source.heights[100:300, 150:350] = np.nan
    m = Mosaic([source])
    got = everything(m)
    x, y = m.grid.xy(*np.meshgrid(np.arange(m.grid.cols), np.arange(m.grid.rows)))
    u, v = source.grid.index(*Transformer.from_crs(m.grid.crs, WGS84, always_xy=True).transform(x, y))
    clear = np.minimum(np.abs(u % 1 - 0.5), np.abs(v % 1 - 0.5)) > 0.01  # not on the line between two samples
    inside = (u > -0.5) & (u < 399.5) & (v > -0.5) & (v < 399.5) & clear
    void = (u > 149.5) & (u < 349.5) & (v > 99.5) & (v < 299.5)
    assert np.array_equal(np.isnan(got)[inside], void[inside])


def test_without_crs() -> None:
    grid = Affine(2, 0, 1000, 0, -2, 5000)
    m = Mosaic([held(hills(30, 40), grid, None)])
    assert m.lossless and m.grid.crs is None and any("assumed to be metres" in w for w in m.warnings)
    local = Mosaic([held(hills(30, 40), Affine(0.5, 0, 0, 0, -0.5, 0), None)], options={"spacing": 0.5})
    assert local.grid.spacing == (0.5, 0.5) and not local.warnings
    with pytest.raises(ReadError, match="`spacing=30`"):
        Mosaic([held(hills(30, 40), Affine.identity(), None)])
    with pytest.raises(ReadError, match='`assume_crs="EPSG:4326"`'):
        Mosaic([held(hills(30, 40), Affine(0.01, 0, 7, 0, -0.01, 46), None)])
    with pytest.raises(ReadError, match="no CRS while other files have one"):
        Mosaic([held(hills(30, 40), grid, None), held(hills(30, 40), grid, UTM11)])
    with pytest.raises(UsageError, match="no CRS"):
        Mosaic([held(hills(30, 40), grid, None)], crs="EPSG:32611")


def test_warnings() -> None:
    transform = Affine(30, 0, 5e5, 0, -30, 4e6)
    parts = [held(hills(20, 20), transform, UTM11, vertical=v) for v in ("EGM96 height", "NAVD88 height")]
    m = Mosaic(parts)
    assert m.vertical is None and any("EGM96 height, NAVD88 height" in w for w in m.warnings)
    assert Mosaic(parts[:1]).vertical == "EGM96 height" and not Mosaic(parts[:1]).warnings
    web = Mosaic([held(hills(20, 20), Affine(30, 0, 1e6, 0, -30, 6e6), CRS.from_epsg(3857))])
    said = re.search(r"A metre of .* is (\S+) m on the ground", " ".join(web.warnings))
    # 47.36° N is y = 6 000 000 on EPSG:3857's sphere: a metre of the map is cos(latitude) on the ground
    latitude = 2 * np.arctan(np.exp(6e6 / 6378137)) - np.pi / 2
    assert said and float(said[1]) == pytest.approx(np.cos(latitude), rel=5e-3)


def test_windows_outside_are_refused() -> None:
    m = Mosaic([held(hills(20, 20), Affine(30, 0, 5e5, 0, -30, 4e6), UTM11)])
    for window in ((0, 0, 0, 5), (-1, 5, 0, 5), (0, 21, 0, 5), (5, 4, 0, 5), (0, 5, 10, 21)):
        with pytest.raises(ValueError, match="window"):
            m.read(*window)
    with pytest.raises(UsageError, match="lanczos"):
        Mosaic(m.sources, resampling="lanczos")
    with pytest.raises(UsageError, match="no file"):
        Mosaic([])


def test_fingerprint_follows_files_and_options(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"

    def write(value: float) -> None:
        profile = {"driver": "GTiff", "width": 8, "height": 9, "count": 1, "dtype": "float32", "crs": "EPSG:32611"}
        with rasterio.open(path, "w", transform=Affine(30, 0, 5e5, 0, -30, 4e6), **profile) as file:
            file.write(np.full((9, 8), value, np.float32), 1)

    write(1)
    first = Mosaic.open(path).fingerprint()
    assert Mosaic.open([path]).fingerprint() == first
    assert Mosaic.open(path, band=1, nodata=None).fingerprint() == first  # what is usual need not be said
    others = {Mosaic.open(path, resolution=20).fingerprint(), Mosaic.open(path, resampling="cubic").fingerprint()}
    others.add(Mosaic.open(path, nodata=3.0).fingerprint())
    assert len(others | {first}) == 4
    path.unlink()
    write(2.5)
    assert Mosaic.open(path).fingerprint() != first


def test_real_projected_file_is_kept(shared_data: Path) -> None:
    path = next((shared_data / "bigtujunga-srtm30m-utm").glob("*.tif"))
    m = Mosaic.open(path)
    with rasterio.open(path) as file:
        raw = file.read(1, masked=True)
        assert tuple(m.grid.transform[:6]) == tuple(file.transform[:6])
    assert m.lossless and m.name == path.stem
    assert same(everything(m), raw.astype(np.float32).filled(np.nan))


def test_a_mosaic_of_arrays_has_another_fingerprint_with_other_heights() -> None:
    grid = Grid((3, 3), Affine(0.01, 0, 7, 0, -0.01, 46), CRS.from_epsg(4326))
    first, second = (Mosaic([ArraySource(np.full((3, 3), v, np.float32), grid, "same")]) for v in (1, 2))
    assert first.fingerprint() != second.fingerprint()


def test_damaged_and_missing_files_are_all_named_or_left_out(tmp_path: Path) -> None:
    paths = []
    for k in range(4):
        heights = np.full((20, 30), 100.0 + k, np.float32)
        profile = {"driver": "GTiff", "width": 30, "height": 20, "count": 1, "dtype": "float32", "crs": "EPSG:32611"}
        paths.append(tmp_path / f"{k}.tif")
        with rasterio.open(
            paths[-1], "w", transform=Affine(10, 0, 500_000 + 300 * k, 0, -10, 4_000_000), **profile
        ) as file:  # fmt: skip
            file.write(heights, 1)
    paths[1].write_bytes(b"no TIFF")
    gone = tmp_path / "gone.tif"
    everything = [*paths, gone]
    with pytest.raises(ReadError, match=r"2 of 5 files are damaged or missing(.|\n)*1\.tif(.|\n)*gone\.tif"):
        Mosaic.open(everything)
    with pytest.raises(ReadError, match=r"^[^\n]*gone\.tif[^\n]*$"):  # one alone says it as it always does
        Mosaic.open([paths[0], gone])
    found = Mosaic.open(everything, skip_damaged=True)
    assert len(found.skipped) == 2 and "1.tif" in found.skipped[0] and "gone.tif" in found.skipped[1]
    assert any("2 of 5 files are left out" in text for text in found.warnings)
    sound = Mosaic.open([paths[0], *paths[2:]])
    assert found.grid == sound.grid and found.fingerprint() == sound.fingerprint() and sound.skipped == ()
    rows, cols = sound.grid.shape
    np.testing.assert_array_equal(found.read(0, rows, 0, cols), sound.read(0, rows, 0, cols))
    assert np.isnan(found.read(0, rows, 30, 60)).all()
    again, options = found.recipe() or ([], {})
    assert len(again) == 3 and "skip_damaged" not in options
    with pytest.raises(ReadError, match="2 of 2 files"):
        Mosaic.open([paths[1], gone], skip_damaged=True)
