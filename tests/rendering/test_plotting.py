"""A picture where people of NumPy, matplotlib and xarray expect it: arrays, axes with its extent, a Dataset, a cell."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image
from scenes import NORTH_UP, ROTATED, hills, terrain

import orograph
from orograph import measuring
from orograph.errors import UsageError

SIZE = (60, 40)
PLAIN = {"samples": 1, "shadows": False, "water": None}


def plan(azimuth: float = 180.0, place=NORTH_UP, **options) -> orograph.Picture:
    ground = terrain(hills(), place)
    return orograph.render(ground, orograph.camera.plan(ground, SIZE, azimuth=azimuth), **PLAIN, **options)


@pytest.fixture
def pyplot():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg", force=True)
    import matplotlib.pyplot as found

    yield found
    found.close("all")


def test_as_an_array_and_in_a_cell():
    picture = plan()
    np.testing.assert_array_equal(np.asarray(picture), picture.pixels)
    assert np.asarray(picture, dtype=np.float32).dtype == np.float32
    shown = np.asarray(Image.open(io.BytesIO(picture._repr_png_())))
    np.testing.assert_array_equal(shown, picture.pixels)


@pytest.mark.parametrize("view", ["plan", "turned", "perspective"])
@pytest.mark.parametrize("exaggeration", [1.0, 2.5])
def test_each_pixel_has_the_place_that_is_picked_there(view, exaggeration):
    xarray = pytest.importorskip("xarray")
    ground = terrain(hills(), ROTATED if view == "turned" else NORTH_UP)
    if view == "perspective":
        camera = orograph.camera.around(ground, SIZE, azimuth=210, pitch=35, distance=None)
    else:
        camera = orograph.camera.plan(ground, SIZE, azimuth=200 if view == "turned" else 180)
    picture = orograph.render(ground, camera, exaggeration=exaggeration, tolerance=0, **PLAIN)
    found = picture.to_xarray()
    assert isinstance(found, xarray.Dataset) and found.pixels.dims == ("y", "x", "band")
    np.testing.assert_array_equal(found.depth, picture.depth)
    np.testing.assert_array_equal(np.isfinite(found.height), np.isfinite(picture.depth))
    rows, cols = np.nonzero(np.isfinite(picture.depth))
    for row, col in list(zip(rows, cols))[:: max(1, len(rows) // 12)]:
        hit = measuring.pick(ground, camera, (col + 0.5, row + 0.5), exaggeration)
        assert hit is not None
        at = [float(found[name][row, col]) for name in ("easting", "northing", "height")]
        # Depths are float32: of some ten kilometres they know a centimetre.
        np.testing.assert_allclose(at, [*hit.point, hit.surface_height], atol=0.05)
        if view == "plan":
            np.testing.assert_allclose([found.x[col], found.y[row]], at[:2], atol=1e-6)


def test_a_plan_on_axes_lies_in_its_crs(pyplot):
    picture = plan()
    image = picture.plot()
    west, south, east, north = picture.grid.bounds()
    assert image.get_extent() == pytest.approx([west, east, south, north])
    assert image.axes.get_aspect() == 1.0
    # Drawn pixel by pixel on axes of its own size, matplotlib shows the pixels themselves.
    figure = pyplot.figure(figsize=(0.6, 0.4), dpi=100)
    ax = figure.add_axes((0, 0, 1, 1))
    assert picture.plot(ax, interpolation="nearest").axes is ax
    ax.set_axis_off()
    figure.canvas.draw()
    np.testing.assert_array_equal(np.asarray(figure.canvas.buffer_rgba())[..., :3], picture.pixels)


def test_a_turned_plan_on_axes_is_turned(pyplot):
    picture = plan(azimuth=217.0)
    image = picture.plot()
    inside = picture.grid.xy(10, 30)
    to_pixels = (image.get_transform() - image.axes.transData).inverted()
    np.testing.assert_allclose(to_pixels.transform(inside), [10.5, 30.5], atol=1e-6)


def test_perspective_has_no_axes_and_heights_have_a_bar(pyplot):
    ground = terrain(hills())
    picture = orograph.render(ground, size=SIZE, **PLAIN)
    image = picture.plot()
    assert image.get_extent() == [-0.5, 59.5, 39.5, -0.5] and not image.axes.axison
    bar = picture.colorbar(image.axes)
    low, high, _ = picture.tint.scale()
    assert (bar.vmin, bar.vmax) == (low, high) and bar.ax.get_ylabel() == "height (m)"
    with pytest.raises(UsageError, match="colours of heights"):
        orograph.Picture(picture.pixels, picture.depth, picture.view).colorbar()


def test_shown_outside_notebooks(monkeypatch):
    seen = []
    monkeypatch.setattr(Image.Image, "show", lambda self: seen.append(np.asarray(self)))
    picture = plan()
    picture.show()
    np.testing.assert_array_equal(seen[0], picture.pixels)


def test_on_axes_of_cartopy_a_plan_is_brought_to_their_projection(pyplot):
    projections = pytest.importorskip("cartopy.crs")
    picture = plan()
    west, south, east, north = picture.grid.bounds()
    own, other = projections.epsg(32611), projections.PlateCarree()
    for projection in (own, other):
        ax = pyplot.figure().add_subplot(projection=projection)
        image = picture.plot(ax)
        x, y = projection.transform_point((west + east) / 2, (south + north) / 2, own)
        x0, x1, y0, y1 = image.get_extent()
        assert x0 < x < x1 and y0 < y < y1
        assert ax.get_extent(own) == pytest.approx((west, east, south, north), abs=0.1 * (east - west))
