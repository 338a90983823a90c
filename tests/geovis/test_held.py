"""Layers that are no files: arrays, DataArrays, datasets, colour maps and classes, beside the same in a file."""

from __future__ import annotations

import gc
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

import orograph
from orograph.errors import UsageError
from orograph.geovis.tables import Table

CRS = "EPSG:32611"
T = Affine(30, 0, 380000, 0, -30, 3790000)
PLAIN = {"samples": 1, "light": "none", "water": None, "size": (60, 50)}


@pytest.fixture(scope="module")
def ground() -> orograph.Terrain:
    return orograph.terrain(np.zeros((41, 51)), transform=T, crs=CRS)


def picture(ground: orograph.Terrain, layer: Any, **options: Any) -> np.ndarray:
    view = orograph.camera.plan(ground, (60, 50))
    return np.asarray(orograph.render(ground, view, layers=layer, **{**PLAIN, **options}))


def image() -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.kron(rng.integers(0, 256, (4, 5, 3), np.uint8), np.ones((8, 8, 1), np.uint8))


def written(path: Path, bands: np.ndarray, **profile: Any) -> Path:
    count, rows, cols = bands.shape
    more = {"driver": "GTiff", "width": cols, "height": rows, "count": count, "dtype": bands.dtype.name}
    with rasterio.open(path, "w", **more, **profile) as out:
        out.write(bands)
    return path


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
def test_colours_span_the_terrain(ground: orograph.Terrain, tmp_path: Path) -> None:
    colors = image()
    file = written(tmp_path / "a.tif", np.moveaxis(colors, 2, 0), photometric="RGB")
    truth = picture(ground, file)
    assert len(np.unique(truth.reshape(-1, 3), axis=0)) > 15
    alpha = np.concatenate([colors, np.full((32, 40, 1), 255, np.uint8)], 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        for given in (colors, [colors], np.moveaxis(colors, 2, 0), colors / 255, np.float32(colors / 255), alpha,
                      orograph.Layer(colors)):  # fmt: skip
            np.testing.assert_array_equal(picture(ground, given), truth)


def test_opacity_of_arrays(ground: orograph.Terrain) -> None:
    colors = image()
    bare, covered = picture(ground, None), picture(ground, colors)
    half = np.zeros((32, 40), bool)
    half[:, 20:] = True
    alpha = np.dstack([colors, np.where(half, 0, 255).astype(np.uint8)])
    masked = np.ma.masked_array(colors, np.repeat(half[..., None], 3, 2))
    holed = np.where(half[..., None], np.nan, colors / 255)
    for given in (alpha, masked, holed):
        found = picture(ground, given)
        np.testing.assert_array_equal(found[:, :28], covered[:, :28])
        np.testing.assert_array_equal(found[:, 32:], bare[:, 32:])


@pytest.mark.stress
def test_arrays_with_a_place(ground: orograph.Terrain, tmp_path: Path) -> None:
    xr = pytest.importorskip("xarray")
    values = np.add.outer(np.arange(20.0), np.arange(20.0)).astype(np.float32)
    place = T * Affine.translation(10, 5)
    file = written(tmp_path / "v.tif", values[None], transform=place, crs=CRS)
    truth = picture(ground, orograph.Layer(str(file), colormap="viridis"))
    x, y = 380015 + 30 * np.arange(10, 30), 3789985 - 30 * np.arange(5, 25)
    array = xr.DataArray(values, {"y": y, "x": x}, ("y", "x"), attrs={"crs": CRS})
    with rasterio.open(file) as dataset:
        for given in (
            orograph.Layer(values, transform=place, crs=CRS, colormap="viridis"),
            orograph.Layer(values.astype(np.float64), transform=place, crs=CRS, colormap="viridis"),
            orograph.Layer(array, colormap="viridis"),
            orograph.Layer(array.isel(y=slice(None, None, -1)).T, colormap="viridis"),
            orograph.Layer(dataset, colormap="viridis"),
        ):
            gc.collect()
            np.testing.assert_array_equal(picture(ground, given), truth)


def test_maps_of_light_are_layers(ground: orograph.Terrain) -> None:
    dem = orograph.Dem(np.add.outer(np.arange(41.0), np.arange(51.0) ** 2).astype(np.float32), ground.grid)
    steep = orograph.light(dem, "slope")
    np.testing.assert_array_equal(
        picture(ground, orograph.Layer(steep, colormap="magma")),
        picture(ground, orograph.Layer(steep.to_xarray(), colormap="magma")),
    )


def test_maps_of_matplotlib(ground: orograph.Terrain) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize

    values = 10.0 ** np.linspace(0, 4, 40)[None].repeat(32, 0)
    viridis = matplotlib.colormaps["viridis"]
    for norm, cmap in (
        (Normalize(0, 1e4), viridis), (LogNorm(1, 1e4), viridis), (LogNorm(1, 1e4), "viridis"),
        (BoundaryNorm([1, 10, 100, 1e4], 3), ListedColormap(["red", "lime", "blue"])),
    ):  # fmt: skip
        layer = orograph.Layer(values, colormap=cmap, norm=norm)
        colors = (viridis if isinstance(cmap, str) else cmap)(norm(values))
        wanted = picture(ground, np.round(colors[..., :3] * 255).astype(np.uint8))
        found = picture(ground, layer)
        # A table has 65,536 steps: 0.15 of these values, which at LogNorm's lower end are 4 of its 256 colours.
        assert np.abs(found.astype(int) - wanted).max() <= 6
    with pytest.raises(UsageError, match="vmin and vmax"):
        orograph.Layer(values, colormap="viridis", norm=Normalize())
    with pytest.raises(UsageError, match="norm needs a colour map"):
        orograph.Layer(values, norm=Normalize(0, 1))


def test_classes(ground: orograph.Terrain) -> None:
    values = np.kron(np.array([[1, 5], [7, 300]], np.uint16), np.ones((16, 20), np.uint16))
    found = picture(ground, orograph.Layer(values, colormap={1: "red", 5: (0, 1, 0), 300: "#0000ff80"}))
    bare = picture(ground, None)
    for color, at in (((255, 0, 0), (12, 15)), ((0, 255, 0), (12, 45))):
        np.testing.assert_array_equal(found[at], picture(ground, np.full((2, 2, 3), color, np.uint8))[at])
    np.testing.assert_array_equal(found[37, 15], bare[37, 15])
    assert bare[37, 45, 0] > found[37, 45, 0] > 0
    few = picture(ground, orograph.Layer(values, colormap={5: "red"}))
    for at in ((12, 15), (37, 15), (37, 45)):  # below, above and between: no class, no colour
        np.testing.assert_array_equal(few[at], bare[at])
    for wrong in ({}, {1.5: "red"}, {1: "no colour"}, {"a": "red"}, {0: "red", 10**6: "blue"}):
        with pytest.raises(UsageError, match=r"[Cc]lass"):
            orograph.Layer(values, colormap=wrong)


def test_the_tint_of_heights_is_a_map_of_matplotlib() -> None:
    matplotlib = pytest.importorskip("matplotlib")
    ground = orograph.terrain(np.add.outer(np.arange(41.0), np.arange(51.0)), transform=T, crs=CRS)
    found = picture(ground, None, colormap=matplotlib.colormaps["magma"])
    wanted = picture(ground, None, colormap="matplotlib:magma")
    assert np.abs(found.astype(int) - wanted).max() <= 2
    assert Table.of(matplotlib.colormaps["magma"]) == Table.of(matplotlib.colormaps["magma"])


@pytest.mark.parametrize(
    "given", [np.zeros(5), np.zeros((2, 2, 7, 2)), np.zeros((5, 5), complex), 3, np.array([["a"]])]
)
def test_what_is_no_layer(ground: orograph.Terrain, given: Any) -> None:
    with pytest.raises(UsageError, match="A layer must be a path"):
        picture(ground, given)


def test_a_file_is_gone_with_its_layer() -> None:
    layer = orograph.Layer(image())
    path, again = layer.path, layer.content
    del layer
    with rasterio.open(path) as there:
        assert there.count == 3
    assert again.label == "array"
    del again
    gc.collect()
    with pytest.raises(rasterio.errors.RasterioIOError):
        rasterio.open(path)
