"""What is said of layers, and what compositing makes of it, against the formulas of Porter and Duff in plain NumPy."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any

import cmap
import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from pyproj import CRS

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.drape import Drape
from orograph.geovis.layers import FIELDS, MOST, Layer, basemap, composite, found_beside, layers_of, nothing_over

GRID = Grid((100, 100), Affine(10, 0, 500_000, 0, -10, 4_000_000), CRS.from_epsg(32611))


@pytest.mark.parametrize(
    ("text", "layer"),
    [
        ("a.tif", Layer("a.tif")),
        ("a.tif,opacity=0.5", Layer("a.tif", 0.5)),
        ("C:\\maps\\a.tif,blend=multiply,name=Old map", Layer("C:\\maps\\a.tif", blend="multiply", name="Old map")),
        ("https://x.org/a,b.tif,visible=no", Layer("https://x.org/a,b.tif", visible=False)),
        (
            "r.tif,colormap=viridis,range=-5:80,band=2,nodata=-9999",
            Layer("r.tif", colormap="viridis", range=(-5, 80), band=2, nodata=-9999),
        ),
        ("r.tif,colormap=viridis,range=80:-5", Layer("r.tif", colormap="viridis", range=(80.0, -5.0))),
    ],
)
def test_on_the_command_line(text: str, layer: Layer) -> None:
    assert Layer.parse(text) == layer
    assert Layer.from_dict(layer.to_dict()) == layer


def test_a_file_with_commas_in_its_name(tmp_path: Path) -> None:
    path = tmp_path / "a,opacity=0.5"
    path.touch()
    assert Layer.parse(str(path)) == Layer(str(path))
    assert Layer.parse(f"{path},opacity=0.25") == Layer(str(path), 0.25)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a.tif,opactiy=0.5", "opacity"),
        ("a.tif,opacity=2", "0 to 1"),
        ("a.tif,opacity=much", "number"),
        ("a.tif,blend=screen", "multiply"),
        ("a.tif,range=0:1", "colormap"),
        ("a.tif,colormap=viridsi", "viridis"),
        ("a.tif,colormap=viridis,range=1", "LOW:HIGH"),
        ("a.tif,colormap=viridis,range=1:1", "range"),
        ("a.tif,colormap=viridis,band=0", "from 1"),
        ("a.tif,opacity=1,opacity=0", "twice"),
        ("", "path"),
    ],
)
def test_what_is_wrong_is_said(text: str, said: str) -> None:
    with pytest.raises(UsageError) as error:
        Layer.parse(text)
    assert said in f"{error.value.what} {error.value.remedy}"


def test_what_a_user_may_give(tmp_path: Path) -> None:
    assert layers_of(None) == () == layers_of([])
    assert layers_of("a.tif") == layers_of(Path("a.tif")) == (Layer("a.tif"),)
    assert layers_of(["a.tif", Layer("b.tif", 0.5)]) == (Layer("a.tif"), Layer("b.tif", 0.5))
    hidden = [Layer(f"{k}.tif", visible=False) for k in range(20)]
    assert len(layers_of(hidden)) == 20
    with pytest.raises(UsageError, match=str(MOST)):
        layers_of([f"{k}.tif" for k in range(MOST + 1)])
    assert {"path", "opacity", "blend"} <= set(FIELDS)
    (tmp_path / "a.tif").touch()
    assert found_beside(layers_of(["a.tif", "none.tif"]), tmp_path) == (
        Layer(str(tmp_path / "a.tif")), Layer("none.tif"),
    )  # fmt: skip


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), max_size=5), st.integers(0, 2**32 - 1))
def test_compositing_is_that_of_porter_and_duff(stack: list[tuple[float, bool]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    ground = rng.random((7, 3))
    ours, expected, clear = nothing_over(7), ground.copy(), np.ones(7)
    for opacity, multiply in stack:
        image = rng.random((7, 4)).astype(np.float32)
        composite(image, opacity, multiply, ours)
        a = image[:, 3:] * opacity
        expected = expected * (1 - a) + a * (image[:, :3] * expected if multiply else image[:, :3])
        clear *= 1 if multiply else 1 - a[:, 0]
    np.testing.assert_allclose(ground * ours[:, 3:6] + ours[:, :3], expected, atol=2e-6)
    np.testing.assert_allclose(ours[:, 6], clear, atol=2e-6)


def raster(path: Path, values: np.ndarray, **profile: Any) -> str:
    bands = values.reshape(-1, *values.shape[-2:])
    with rasterio.open(
        path, "w", driver="GTiff", count=len(bands), height=bands.shape[1], width=bands.shape[2], dtype=values.dtype,
        transform=GRID.transform, crs=GRID.crs.to_wkt(), **profile,
    ) as file:  # fmt: skip
        file.write(bands)
    return str(path)


def at_samples(layer: Layer) -> np.ndarray:
    """Colours and opacity (rows, cols, 4) at all samples of the grid, linear."""
    col, row = np.meshgrid(np.arange(100.0), np.arange(100.0))
    x, y = GRID.xy(col.ravel(), row.ravel())
    return Drape.open(layer, GRID).sample(x, y, np.full(len(x), 1e-6)).reshape(100, 100, 4)


def srgb(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("dtype", ["float32", "float64", "int16", "uint16"])
def test_a_raster_by_its_values(tmp_path: Path, dtype: str) -> None:
    row, col = np.mgrid[:100, :100]
    values = (20 * row + col).astype(dtype)
    values[30:40, 50:60] = 777
    path = raster(tmp_path / "r.tif", np.stack([0 * values, values]))
    got = at_samples(Layer(path, colormap="viridis", range=(0, 2000), band=2, nodata=777))
    expected = np.asarray(cmap.Colormap("viridis")(np.clip(values / 2000.0, 0, 1)))
    there = values != 777
    assert (np.abs(got[..., 3] - there) < 1e-6).all()
    assert np.abs(srgb(got[..., :3]) - expected[..., :3])[there].max() < 0.0145  # a step of the map (of 256), and bytes
    turned = at_samples(Layer(path, colormap="viridis", range=(2000, 0), band=2, nodata=777))
    expected = np.asarray(cmap.Colormap("viridis")(1 - np.clip(values / 2000.0, 0, 1)))
    assert np.abs(srgb(turned[..., :3]) - expected[..., :3])[there].max() < 0.0145


def test_its_own_nodata_and_range(tmp_path: Path) -> None:
    values = np.linspace(5.0, 25.0, 10_000, dtype=np.float32).reshape(100, 100)
    values[:10] = -9999
    values[10, :50] = np.nan
    path = raster(tmp_path / "r.tif", values, nodata=-9999)
    got = at_samples(Layer(path, colormap="viridis"))
    assert got[:10, :, 3].max() < 1e-6 and got[10, :50, 3].max() < 1e-6 and got[11:, :, 3].min() > 1 - 1e-6
    low, high = np.nanpercentile(np.where(values > -9999, values, np.nan), [2, 98])
    expected = np.asarray(cmap.Colormap("viridis")(np.clip((values[20:] - low) / (high - low), 0, 1)))
    assert np.abs(srgb(got[20:, :, :3]) - expected[..., :3]).max() < 0.02
    with pytest.raises(ReadError, match="no band 3"):
        at_samples(Layer(path, colormap="viridis", band=3))


def test_bands_by_name(tmp_path: Path) -> None:
    values = np.linspace(0, 1, 10_000, dtype=np.float32).reshape(100, 100)
    path = raster(tmp_path / "r.tif", np.stack([0 * values, values]))
    with rasterio.open(path, "r+") as file:
        file.descriptions = ("hillshade", "slope")
    named = Layer.parse(f"{path},colormap=viridis,band=slope")
    np.testing.assert_array_equal(at_samples(named), at_samples(Layer(path, colormap="viridis", band=2)))
    assert Layer.from_dict(named.to_dict()) == named
    with pytest.raises(ReadError, match="no band steep") as error:
        at_samples(Layer(path, colormap="viridis", band="steep"))
    assert "hillshade, slope" in error.value.remedy


def test_the_card_of_a_layer(tmp_path):
    path = tmp_path / "rain.tif"
    with rasterio.open(path, "w", driver="GTiff", height=300, width=500, count=1, dtype="float32", crs="EPSG:32611",
                       transform=Affine(30, 0, 5e5, 0, -30, 4e6)) as file:  # fmt: skip
        file.write(np.tile(np.linspace(0, 80, 500, dtype=np.float32), (300, 1)), 1)
    said = Layer(str(path), colormap="viridis", range=(0, 80), opacity=0.5)._repr_html_()
    for text in ("rain.tif", "300 × 500", "30 m", "UTM zone 11N", "viridis", "0.5"):
        assert text in said
    png = base64.b64decode(said.partition("base64,")[2].partition('"')[0])
    with Image.open(io.BytesIO(png)) as small:
        assert small.size == (125, 75)
        left, right = small.getpixel((1, 40)), small.getpixel((123, 40))
    assert left[2] > left[0] and right[0] > 200 and right[2] < 80  # violet, yellow
    assert "no such file" in Layer("nothing.tif")._repr_html_()
    array = Layer(np.zeros((9, 8, 3), np.uint8))._repr_html_()
    assert "(in memory)" in array and "spacing" not in array
    service = basemap("OpenTopoMap")._repr_html_()
    assert "OpenTopoMap" in service and "<img" not in service  # a server would be asked for it
