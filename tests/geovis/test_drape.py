"""Draped images against rasterio, pyproj and plain means: where they lie, how they are averaged, where they are not."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS, Transformer
from rasterio.enums import ColorInterp
from rasterio.warp import transform_bounds

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, apply
from orograph.geovis import mipmap
from orograph.geovis.color import srgb_to_linear
from orograph.geovis.drape import Drape
from orograph.geovis.layers import Layer
from orograph.geovis.laying import Laid
from orograph.geovis.placement import TOLERANCE

UTM = CRS("EPSG:32633")
GRID = Grid((400, 400), Affine(30, 0, 500_000, 0, -30, 6_700_000), UTM)  # 60° N
COVER = Affine(120, 0, 500_000, 0, -120, 6_700_000)  # 100 × 100 pixels over GRID
LINEAR = srgb_to_linear(np.arange(256) / 255)


def places(grid: Grid, n: int = 4000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    west, south, east, north = grid.bounds()
    u, v = np.random.default_rng(seed).uniform(size=(2, n))
    return west + u * (east - west), south + v * (north - south)


def write(path: Path, pixels: np.ndarray, transform: Affine = COVER, crs: Any = UTM, **profile: Any) -> Path:
    """pixels (rows, cols) or (rows, cols, bands) as a GeoTIFF."""
    bands = np.moveaxis(pixels.reshape(*pixels.shape[:2], -1), -1, 0)
    tags = profile.pop("colorinterp", None), profile.pop("colormap", None)
    shape = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype}
    with rasterio.open(
        path, "w", driver="GTiff", transform=transform, crs=crs and CRS(crs).to_wkt(), **shape, **profile
    ) as file:
        file.write(bands)
        if tags[0]:
            file.colorinterp = tags[0]
        if tags[1]:
            file.write_colormap(1, tags[1])
    return path


def board(rows: int, cols: int) -> np.ndarray:
    """A checkerboard of black and white pixels (rows, cols, 3)."""
    return np.repeat((np.indices((rows, cols)).sum(0) % 2 * 255).astype(np.uint8)[..., None], 3, 2)


@pytest.mark.parametrize(
    ("image", "terrain", "grow"),
    [
        ("everest-landsat7-rgb/LE71400412000304SGS00_RGB.tif", "EPSG:32644", 0.3),
        ("everest-landsat7-rgb/LE71400412000304SGS00_RGB.tif", "EPSG:4326", 0.3),
        ("whitney-usgs-topo-map/whitney_rgb_z15_epsg3857.tif", "EPSG:32611", 0.1),
        ("fortbragg-1m-dem-ortho/naip_2014_rgb.tif", "EPSG:3358", 0.0),
    ],
)
def test_lies_where_pyproj_and_rasterio_say(shared_data: Path, image: str, terrain: str, grow: float) -> None:
    with rasterio.open(shared_data / image) as file:
        west, south, east, north = transform_bounds(file.crs, terrain, *file.bounds)
        band, transform, crs = file.read([1, 2, 3]), file.transform, CRS(file.crs.to_wkt())
    cell = (east - west) * (1 + 2 * grow) / 500
    corner = Affine(cell, 0, west - grow * (east - west), 0, -cell, north + grow * (north - south))
    grid = Grid((round((north - south) * (1 + 2 * grow) / cell), 500), corner, CRS(terrain))
    drape = Drape.open(shared_data / image, grid)
    x, y = places(grid)
    u, v = apply(~transform, *Transformer.from_crs(terrain, crs, always_xy=True).transform(x, y))
    ours = drape.positions(x, y)
    assert np.abs(np.stack(ours[:2]) - [u, v]).max() < 0.05
    rows, cols = band.shape[1:]
    border = np.minimum(np.minimum(u, cols - u), np.minimum(v, rows - v))
    got = drape.sample(x, y, np.full(len(x), 1e-6))
    assert (got[border > 0.1, 3] == 1).all() and (got[border < -0.1, 3] == 0).all()
    assert (border < -0.1).any() == (grow > 0)
    inside = border > 1
    u, v = u[inside] - 0.5, v[inside] - 0.5
    j, i = u.astype(int), v.astype(int)
    fx, fy = u - j, v - i
    light = LINEAR[band]
    truth = (light[:, i, j] * (1 - fx) + light[:, i, j + 1] * fx) * (1 - fy)
    truth += (light[:, i + 1, j] * (1 - fx) + light[:, i + 1, j + 1] * fx) * fy
    np.testing.assert_allclose(got[inside, :3], truth.T, atol=2.5 * TOLERANCE, rtol=0)
    assert np.abs(got[inside, :3] - truth.T).mean() < 2e-3


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_levels_are_means_of_light(rows: int, cols: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    picture = rng.integers(0, 256, (rows, cols, 4), dtype=np.uint8)
    pool, levels = mipmap.pool_for(rows, cols)
    pool[: rows * cols] = picture.reshape(-1, 4)
    mipmap.fill(pool, levels, 1)
    weight = picture[..., 3:].astype(float)
    for k, (base, r, c) in enumerate(levels):
        size = 2**k
        for i, j in {(0, 0), (r - 1, c - 1), (r // 2, c // 2)}:
            block = slice(i * size, (i + 1) * size), slice(j * size, (j + 1) * size)
            opacity = weight[block].mean()
            got = pool[base + i * c + j]
            assert abs(got[3] - opacity) <= 0.5 * k + 1e-6  # every level rounds once
            if opacity > 20:
                light = (LINEAR[picture[block][..., :3]] * weight[block]).sum((0, 1)) / weight[block].sum()
                np.testing.assert_allclose(LINEAR[got[:3]], light, atol=0.005 * k + 1e-6 + 0.1 * k / opacity)


def test_no_checkerboard_survives_from_afar(tmp_path: Path) -> None:
    """In degrees at 60° N a pixel is half as wide as high: both ways must be averaged."""
    path = write(tmp_path / "a.tif", board(2000, 4000), Affine(1e-4, 0, 14.95, 0, -1e-4, 60.5), "EPSG:4326")
    drape = Drape.open(path, GRID)
    x, y = places(GRID.window(10, 390, 10, 390))
    for footprint in (11.5, 30.0, 200.0):
        got = drape.sample(x, y, np.full(len(x), footprint))
        np.testing.assert_allclose(got[:, :3], 0.5, atol=0.02)
    assert drape.sample(x, y, np.full(len(x), 1e-3))[:, 0].std() > 0.15  # but near by it is seen


@pytest.mark.parametrize("overviews", [False, True])
def test_memory_and_the_picture_decide_how_much_is_read(tmp_path: Path, overviews: bool) -> None:
    fine = Affine(6, 0, 500_000, 0, -6, 6_700_000)
    path = write(tmp_path / "a.tif", board(2000, 2000), fine, tiled=True)
    if overviews:
        with rasterio.open(path, "r+") as file:
            file.build_overviews([2, 4], rasterio.enums.Resampling.average)
    x, y = places(GRID)
    small = Drape.open(path, GRID, max_memory=16 << 20)
    assert small.tiles is not None and small.texels.pool.nbytes + small.tiles._pool.nbytes <= 4 << 20
    assert small.step == 1 and not small.warnings
    far = Drape.open(path, GRID, metres=30.0)
    assert far.tiles is None and far.texels.pool.nbytes < 2000 * 2000 * 4 / 3 and not far.warnings
    assert 12 <= far.pixel <= 30
    grey = 0.5 if not overviews else LINEAR[127:129].mean()  # the file's own means are of its bytes
    for drape in (small, far):
        np.testing.assert_allclose(drape.sample(x, y, np.full(len(x), 30.0))[:, :3], grey, atol=0.01)


def test_reduced_windows_stay_in_register(tmp_path: Path) -> None:
    ramp = np.linspace(0, 255, 1999)
    picture = np.stack(np.broadcast_arrays(ramp[None, :], ramp[:, None], 0), -1).round().astype(np.uint8)
    fine = Affine(6, 0, 500_003, 0, -6, 6_699_991)
    path = write(tmp_path / "a.tif", picture, fine)
    x, y = places(GRID.window(10, 390, 10, 390))
    full, less = Drape.open(path, GRID), Drape.open(path, GRID, max_memory=3 << 20)
    assert less.texels.pool.nbytes < full.texels.pool.nbytes / 10
    a, b = (d.sample(x, y, np.full(len(x), 60.0)) for d in (full, less))
    np.testing.assert_allclose(a, b, atol=0.012)  # bytes are up to 0.009 apart
    assert np.abs((a - b).mean(0)).max() < 0.002  # half a texel would make 0.004


def test_transparent_pixels_lend_no_color(tmp_path: Path) -> None:
    picture = np.zeros((100, 100, 4), np.uint8)
    picture[:, :50] = 255, 0, 0, 255
    picture[:, 50:] = 0, 0, 255, 0
    names = [ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha]
    drape = Drape.open(write(tmp_path / "a.tif", picture, colorinterp=names), GRID)
    x, y = places(GRID)
    for footprint in (1.0, 500.0):
        got = drape.sample(x, y, np.full(len(x), footprint))
        seen = got[:, 3] > 0.01
        np.testing.assert_allclose(got[seen, :3], np.broadcast_to([1, 0, 0], (seen.sum(), 3)), atol=1e-5)
    partly = (got[:, 3] > 0.1) & (got[:, 3] < 0.9)
    assert partly.any() and np.abs(x[partly] - 506_000).max() < 1000
    # Nodata and a mask do the same.
    marked = picture[..., :3].copy()
    marked[:, 50:] = 7
    other = Drape.open(write(tmp_path / "b.tif", marked, nodata=7), GRID)
    np.testing.assert_allclose(other.sample(x, y, np.full(len(x), 500.0))[:, 3], got[:, 3], atol=1e-6)


def test_palettes_grey_and_wide_types(tmp_path: Path) -> None:
    x, y = places(GRID)
    one = np.full(len(x), 1.0)
    index = board(100, 100)[..., 0] // 255
    colors = {0: (255, 0, 0, 255), 1: (0, 0, 255, 255)}
    drape = Drape.open(write(tmp_path / "p.tif", index, colormap=colors), GRID)
    np.testing.assert_allclose(drape.sample(x, y, 2000 * one)[:, :3], [[0.5, 0, 0.5]] * len(x), atol=0.02)
    ramp = np.linspace(200, 3000, 10_000).reshape(100, 100)
    for kind in (np.uint16, np.float32, np.uint8):
        values = (ramp if kind != np.uint8 else ramp / 40 + 20).astype(kind)
        got = Drape.open(write(tmp_path / f"{np.dtype(kind)}.tif", values), GRID).sample(x, y, one)
        assert got[:, 0].min() < 0.01 and got[:, 0].max() > 0.9 and np.ptp(got[:, :3], axis=1).max() == 0
    ramp[40:60] = np.nan
    holes = Drape.open(write(tmp_path / "nan.tif", ramp.astype(np.float32)), GRID).sample(x, y, one)
    assert np.isfinite(holes).all() and 0.1 < (holes[:, 3] < 0.5).mean() < 0.3


def test_without_georeference_it_is_stretched_north_up(tmp_path: Path) -> None:
    from PIL import Image

    picture = np.zeros((50, 200, 3), np.uint8)
    picture[:25, :100] = 255  # white in the north-west
    Image.fromarray(picture).save(tmp_path / "a.png")
    drape = Drape.open(tmp_path / "a.png", GRID)
    assert "stretched" in drape.warnings[0] and str(tmp_path / "a.png") in drape.warnings[0]
    x, y = places(GRID)
    got = drape.sample(x, y, np.full(len(x), 1.0))
    assert (got[:, 3] == 1).all()
    west, north = x < 505_900, y > 6_694_200
    assert (got[west & north, 0] > 0.9).all() and got[(x > 506_100) | (y < 6_693_800), 0].max() == 0


def test_across_the_antimeridian(tmp_path: Path) -> None:
    """A picture of the whole world whose red tells the distance from the antimeridian, the terrain being there."""
    lon = np.arange(-179.5, 180)
    picture = np.zeros((180, 360, 3), np.uint8)
    picture[..., 0] = np.round(255 - np.minimum(180 - np.abs(lon), 30) * 8)
    path = write(tmp_path / "a.tif", picture, Affine(1, 0, -180, 0, -1, 90), "EPSG:4326")
    grid = Grid((200, 400), Affine(1000, 0, 500_000, 0, -1000, 8_200_000), CRS("EPSG:32760"))
    x, y = places(grid)
    got = Drape.open(path, grid).sample(x, y, np.full(len(x), 1.0))
    lon, _ = Transformer.from_crs(grid.crs, 4326, always_xy=True).transform(x, y)
    assert lon.min() < -179 and lon.max() > 179
    far = np.clip(180 - np.abs(lon), 0.5, 30)
    np.testing.assert_allclose(got[:, 0], srgb_to_linear((255 - far * 8) / 255), atol=0.01)
    assert (got[:, 3] == 1).all()


def test_what_cannot_be_draped(tmp_path: Path) -> None:
    picture = np.full((100, 100, 3), 9, np.uint8)
    with pytest.raises(ReadError, match="no such file"):
        Drape.open(tmp_path / "none.tif", GRID)
    with pytest.raises(ReadError, match=r"does not overlap.*500000 to 512000"):
        Drape.open(write(tmp_path / "a.tif", picture, Affine(120, 0, 560_000, 0, -120, 6_700_000)), GRID)
    with pytest.raises(UsageError, match=r"m\.tif.*celestial bodies.*same body"):
        Drape.open(write(tmp_path / "m.tif", picture, Affine(1, 0, 10, 0, -1, 65), "IAU_2015:30100"), GRID)
    with pytest.raises(ReadError, match="no valid pixel"):
        Drape.open(write(tmp_path / "n.tif", picture, nodata=9), GRID)
    with pytest.raises(ReadError, match="complex"):
        Drape.open(write(tmp_path / "c.tif", picture[..., 0].astype(np.complex64)), GRID)
    path = write(tmp_path / "t.tif", np.random.default_rng(0).integers(0, 255, (400, 400, 3), dtype=np.uint8))
    path.write_bytes(path.read_bytes()[:60_000])
    with pytest.raises(ReadError, match="cannot be read"):
        Drape.open(path, GRID)


def test_threads_agree_and_nowhere_is_transparent(tmp_path: Path) -> None:
    drape = Drape.open(write(tmp_path / "a.tif", board(100, 100), Affine(2e-3, 0, 15, 0, -1e-3, 60.43), 4326), GRID)
    x, y = places(GRID, 40_000)
    x[7], footprint = np.nan, np.full(len(x), 40.0)
    alone = drape.sample(x, y, footprint)
    assert (alone[7] == 0).all() and np.isfinite(alone).all()
    with ThreadPoolExecutor(4) as pool:
        for got in pool.map(lambda _: drape.sample(x, y, footprint), range(8)):
            np.testing.assert_array_equal(got, alone)
    assert drape.sample(x[:0], y[:0], footprint[:0]).shape == (0, 4)


@pytest.mark.parametrize(
    ("values", "step", "said"), [(10, 1, True), (2, 1, False), (200, 1, False), (16, 17, False), (7, 2, True)]
)
def test_few_values_without_colors_are_classes(tmp_path, values, step, said):
    """Not images in black and white, with many greys, or with few in equal steps from black to white."""
    codes = (np.arange(64 * 64).reshape(64, 64) % values * step).astype(np.uint8)
    with rasterio.open(tmp_path / "classes.tif", "w", driver="GTiff", width=64, height=64, count=1, dtype="uint8",
                       crs="EPSG:32611", transform=Affine(10, 0, 5e5, 0, -10, 4e6)) as file:  # fmt: skip
        file.write(codes, 1)
    grid = Grid((64, 64), Affine(10, 0, 5e5, 0, -10, 4e6), CRS.from_epsg(32611))
    laid = Laid.open(Layer(tmp_path / "classes.tif"), grid)
    assert any("so they are drawn as classes" in warning for warning in laid.warnings) == said
    x, y = grid.xy(np.tile(np.arange(64), 64), np.repeat(np.arange(64), 64))
    colors = Drape.open(tmp_path / "classes.tif", grid).sample(x, y, np.full(len(x), 1.0))[:, :3]
    if said:
        assert laid.bands.classes == tuple(range(0, values * step, step))
        of_class = np.array([np.median(colors[codes.ravel() == code], axis=0) for code in laid.bands.classes])
        inside = np.abs(colors - of_class[np.searchsorted(laid.bands.classes, codes.ravel())]).max(1)
        assert np.percentile(inside, 90) < 0.01  # (rounded to bytes)
        assert len(np.unique(np.round(of_class, 2), axis=0)) == values
    else:
        assert (colors == colors[:, :1]).all() and laid.bands.classes == ()
    assert not Laid.open(Layer(tmp_path / "classes.tif", colormap="viridis"), grid).warnings
