"""Draped images: registration against rasterio and pyproj point by point, filtering box means in linear light."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS, Transformer

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.colour import linear_to_srgb, srgb_to_linear
from orograph.geovis.drape import Drape
from orograph.geovis.image import TILE, Image

UTM = CRS.from_epsg(32645)


def write(path, pixels, *, crs=None, transform=None, **options):
    """pixels (rows, cols, bands) → a GeoTIFF at ``path``."""
    rows, cols, bands = pixels.shape
    placed = {"crs": crs, "transform": transform} if transform is not None else {}
    profile = {
        "driver": "GTiff",
        "height": rows,
        "width": cols,
        "count": bands,
        "dtype": pixels.dtype,
        **placed,
        **options,
    }
    colormap = profile.pop("colormap", None)
    with rasterio.open(path, "w", **profile) as out:
        out.write(np.moveaxis(pixels, -1, 0))
        if colormap:
            out.write_colormap(1, colormap)
    return path


def noise(rows, cols, bands=3, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (rows, cols, bands), np.uint8)


@pytest.fixture
def grid() -> Grid:
    return Grid((200, 300), Affine(30, 0, 478000, 0, -30, 3108140), UTM)


def test_pixel_centres_are_exact_in_the_same_crs(tmp_path, grid):
    pixels = noise(200, 300)
    drape = Drape.open(write(tmp_path / "a.tif", pixels, crs=UTM, transform=grid.transform), grid)
    rows, cols = (a.ravel() for a in np.indices((200, 300)))
    got = drape.sample(*grid.xy(cols, rows), np.full(rows.size, 1.0))
    assert (got[:, 3] == 1).all()
    assert drape.pixels_per_metre == pytest.approx(1 / 30)
    np.testing.assert_array_equal(np.round(linear_to_srgb(got[:, :3]) * 255), pixels.reshape(-1, 3))


def test_between_pixels_light_is_bilinear_and_outside_there_is_nothing(tmp_path, grid):
    pixels = noise(200, 300)
    drape = Drape.open(write(tmp_path / "a.tif", pixels, crs=UTM, transform=grid.transform), grid)
    x, y = grid.xy([10.25, -0.49, -0.51, 299.51, np.nan], [20.5, 0, 0, 0, 3])
    got = drape.sample(x, y, np.full(5, 1.0))
    light = srgb_to_linear(pixels / 255.0)
    expected = (light[20, 10] + light[21, 10]) * 0.375 + (light[20, 11] + light[21, 11]) * 0.125
    np.testing.assert_allclose(got[0, :3], expected, atol=1e-5)
    np.testing.assert_array_equal(got[:, 3], [1, 1, 0, 0, 0])


@pytest.mark.parametrize(
    ("image", "dem"),
    [
        ("everest-landsat7-rgb/LE71400412000304SGS00_RGB.tif", "osgearth-srtm90m-volcano-voids/mt_everest_90m.tif"),
        ("whitney-usgs-topo-map/whitney_rgb_z15_epsg3857.tif", "california-3s-tiles/N36W119.tif"),
    ],
)
def test_registration_of_real_images_in_other_crs(shared_data, image, dem):
    """Where pyproj puts the centre of a pixel, the drape has that pixel's colour (moved by less than its tolerance)."""
    with rasterio.open(shared_data / dem) as d:
        terrain = Grid(d.shape, d.transform, CRS.from_user_input(d.crs))
    drape = Drape.open(shared_data / image, terrain)
    rng = np.random.default_rng(2)
    with rasterio.open(shared_data / image) as picture:
        row, col = rng.integers(0, picture.height, 4000), rng.integers(0, picture.width, 4000)
        x, y = picture.transform * np.stack([col + 0.5, row + 0.5])
        here = Transformer.from_crs(picture.crs, terrain.crs, always_xy=True).transform(x, y)
        truth = np.array(list(picture.sample(zip(x, y))))
    c, r = terrain.index(*here)
    on = (c >= 0) & (c <= terrain.cols - 1) & (r >= 0) & (r <= terrain.rows - 1)
    u, v = drape._find(*(a[on] for a in here))
    assert np.abs(np.stack([u - col[on], v - row[on]])).max() < 0.05
    got = drape.sample(here[0][on], here[1][on], np.zeros(on.sum()))
    assert on.sum() > 1000 and got[:, 3].min() > 0.9999
    step = np.abs(linear_to_srgb(got[:, :3]) * 255 - truth[on])
    assert np.median(step) <= 1 and step.mean() < 3


def test_far_pixels_are_means_of_light(tmp_path, grid):
    """A checkerboard of black and white seen from afar is half the light: sRGB 188, not 128; and nothing sparkles."""
    board = np.where(np.indices((800, 1200)).sum(0) % 2, 255, 0).astype(np.uint8)[..., None].repeat(3, 2)
    fine = Affine(7.5, 0, 478000, 0, -7.5, 3108140)
    drape = Drape.open(write(tmp_path / "b.tif", board, crs=UTM, transform=fine), grid)
    x, y = grid.xy(*np.random.default_rng(1).uniform(5, 190, (2, 500)))
    got = drape.sample(x, y, np.full(500, 30.0))
    np.testing.assert_allclose(got[:, :3], 0.5, atol=0.005)


def test_pyramid_is_the_box_mean_over_tiles_and_odd_edges(tmp_path):
    pixels = noise(TILE + 77, TILE * 2 + 3, seed=4)
    image = Image(write(tmp_path / "c.tif", pixels))
    assert image.levels == 12 and image.size(2) == (148, 257) and image.size(11) == (1, 1)
    light = np.pad(srgb_to_linear(pixels / 255.0), ((0, 3), (0, 1), (0, 0)), mode="edge")
    whole = light.reshape(148, 4, 257, 4, 3).mean((1, 3))
    got = image.window(2, 0, 148, 0, 257)
    assert np.abs(got[:147, :256, :3] - linear_to_srgb(whole)[:147, :256] * 255).max() < 1.6  # rounded twice to bytes


def test_file_overviews_are_used(tmp_path):
    pixels = noise(2048, 2048)
    path = write(tmp_path / "o.tif", pixels, tiled=True)
    with rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2, 4], rasterio.enums.Resampling.average)
        expected = dataset.read(out_shape=(3, 512, 512))
    image = Image(path)
    got = image.window(2, 0, 512, 0, 512)
    np.testing.assert_array_equal(np.moveaxis(got[..., :3], -1, 0), expected)
    assert set(image._tiles) == {(2, 0, 0)}  # nothing finer was read


def test_budget_of_bytes_is_kept(tmp_path):
    path = write(tmp_path / "m.tif", noise(3000, 3000))
    image = Image(path, max_bytes=6 << 20)
    image.window(0, 0, 3000, 0, 3000)
    image.window(3, 0, 375, 0, 375)
    assert image._bytes == sum(t.nbytes for t in image._tiles.values()) <= 6 << 20


def test_palettes_alpha_and_missing_pixels(tmp_path, grid):
    from PIL import Image as Pillow

    index = (np.arange(200 * 300).reshape(200, 300) % 3).astype(np.uint8)
    picture = Pillow.fromarray(index, "P")
    picture.putpalette([255, 0, 0, 255, 0, 255, 0, 255, 0, 0, 255, 0], "RGBA")
    picture.save(tmp_path / "p.png")
    drape = Drape.open(tmp_path / "p.png", grid)
    got = drape.sample(*grid.xy([0, 1, 2], [0, 0, 0]), np.ones(3))
    np.testing.assert_allclose(got, [[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 0, 0]])
    # From afar the transparent blue does not bleed into what is seen of red and green.
    far = drape.sample(*grid.xy([150.0], [100.0]), np.array([240.0]))
    np.testing.assert_allclose(far, [[0.5, 0.5, 0, 2 / 3]], atol=0.06)
    rgba = noise(200, 300, 4)
    path = write(tmp_path / "r.tif", rgba, crs=UTM, transform=grid.transform, photometric="rgb", alpha="yes")
    got = Drape.open(path, grid).sample(*grid.xy([7], [9]), np.ones(1))
    assert got[0, 3] == pytest.approx(rgba[9, 7, 3] / 255)
    blank = noise(200, 300)
    blank[9, 7] = 0
    path = write(tmp_path / "n.tif", blank, crs=UTM, transform=grid.transform, nodata=0)
    assert Drape.open(path, grid).sample(*grid.xy([7], [9]), np.ones(1))[0, 3] < 1e-6


def test_sixteen_bits_are_stretched(tmp_path, grid):
    values = np.linspace(4000, 9000, 200 * 300).reshape(200, 300, 1).astype(np.uint16)
    drape = Drape.open(write(tmp_path / "s.tif", values, crs=UTM, transform=grid.transform), grid)
    got = linear_to_srgb(drape.sample(*grid.xy([0, 150, 299], [0, 100, 199]), np.ones(3))[:, :3])
    np.testing.assert_allclose(got, np.array([0, 0.5, 1])[:, None].repeat(3, 1), atol=0.02)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_without_georeference_it_is_stretched_over_the_terrain(tmp_path, grid):
    pixels = noise(100, 150)
    drape = Drape.open(write(tmp_path / "u.png", pixels, driver="PNG"), grid)
    x, y = grid.transform * np.array([[(30 + 0.5) * 2], [(40 + 0.5) * 2]])  # the middle of image pixel (40, 30)
    got = drape.sample(x, y, np.ones(1))
    np.testing.assert_array_equal(np.round(linear_to_srgb(got[0, :3]) * 255), pixels[40, 30])


def test_world_images_in_degrees_wrap(shared_data, grid):
    path = shared_data / "bluemarble-720x360" / "bl_mrbl_ng_jul2004_rgb_720x360.tif"
    west = Grid((50, 50), Affine(2000, 0, -17600000, 0, -2000, 100000), CRS.from_epsg(3857))
    drape = Drape.open(path, west)
    with rasterio.open(path) as picture:
        truth = picture.read()[:, 179, 43]
    x, y = Transformer.from_crs(4326, 3857, always_xy=True).transform([-158.25], [0.25])
    u, v = drape._find(np.array(x), np.array(y))
    assert (u[0], v[0]) == pytest.approx((43, 179), abs=0.05)
    got = drape.sample(np.array(x), np.array(y), np.zeros(1))
    assert np.abs(linear_to_srgb(got[0, :3]) * 255 - truth).max() < 3 or got[0, 3] == 0


def test_an_image_of_elsewhere_is_refused(tmp_path, grid):
    away = Affine(30, 0, 100000, 0, -30, 1000000)
    path = write(tmp_path / "e.tif", noise(20, 20), crs=UTM, transform=away)
    with pytest.raises(UsageError, match="do not meet"):
        Drape.open(path, grid)
    (tmp_path / "t.tif").write_text("no image")
    with pytest.raises(ReadError):
        Drape.open(tmp_path / "t.tif", grid)


def test_threads_and_blocks_do_not_matter(tmp_path, grid):
    from orograph.parallel import map_ordered

    path = write(tmp_path / "a.tif", noise(1000, 1500), crs=UTM, transform=Affine(6, 0, 478000, 0, -6, 3108140))
    x, y = grid.xy(*np.random.default_rng(1).uniform(0, 199, (2, 4000)))
    width = np.random.default_rng(2).uniform(1, 100, 4000)
    whole = Drape.open(path, grid).sample(x, y, width)
    drape = Drape.open(path, grid, max_bytes=8 << 20)
    parts = map_ordered(
        lambda k: drape.sample(x[k : k + 100], y[k : k + 100], width[k : k + 100]), range(0, 4000, 100), 4
    )
    np.testing.assert_array_equal(np.concatenate(list(parts)), whole)
