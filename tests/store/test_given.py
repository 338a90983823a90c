"""Whatever heights come as is the same terrain: files, datasets, windows, arrays, DataArrays; the rest is refused."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.transform import from_origin
from rasterio.windows import Window

import orograph
from orograph import measuring
from orograph.errors import OrographError, ReadError, UsageError
from orograph.progress import Progress

T = from_origin(380000, 3790000, 30, 30)
CRS = "EPSG:32611"


class Heard(Progress):
    def __init__(self) -> None:
        self.warnings: list[str] = []

    def warn(self, text: str) -> None:
        self.warnings.append(text)


def values() -> np.ndarray:
    rows, cols = np.mgrid[:40, :50]
    return (500 + 7 * rows + 3 * cols + rows * cols % 11).astype(np.int16)


def check(found: orograph.Terrain, heights: np.ndarray, transform: Affine = T) -> None:
    assert found.grid.shape == heights.shape
    assert found.grid.transform.almost_equals(transform)
    np.testing.assert_array_equal(found.read(0, 0, heights.shape[0], 0, heights.shape[1]), np.float32(heights))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "hill.tif"
    profile = {"driver": "GTiff", "width": 50, "height": 40, "count": 1, "dtype": "int16", "crs": CRS, "nodata": -1}
    with rasterio.open(file, "w", transform=T, **profile) as out:
        out.write(values(), 1)
    return file


@pytest.fixture
def dataset(path: Path) -> Iterator[Any]:
    with rasterio.open(path) as found:
        yield found


@pytest.mark.parametrize(
    "dtype", ["int8", "uint8", "int16", "uint16", "int32", "int64", "uint64", "f2", "f4", "f8", "g"]
)
def test_arrays_of_every_real_type(dtype: str) -> None:
    array = (values() % 100).astype(dtype)
    check(orograph.terrain(array, transform=T, crs=CRS), array)


def test_an_array_of_the_other_byte_order_and_a_list_of_rows() -> None:
    check(orograph.terrain(values().astype(">i2"), transform=T, crs=CRS), values())
    check(orograph.terrain(values().tolist(), transform=tuple(T)[:6], crs=CRS), values())
    check(orograph.terrain(values()[None], transform=T, crs=CRS), values())


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.zeros((4, 5), complex), "complex128.*heights must be real.*\\.real"),
        (np.zeros((4, 5), bool), "bool: booleans"),
        (np.full((4, 5), "a"), "<U1"),
        (np.zeros((4, 5), "M8[s]"), "datetime64"),
        (np.zeros(7), "rows and columns.*shape \\(7,\\)"),
        (np.zeros((3, 4, 5)), "layers="),
        (np.zeros((0, 5)), "shape \\(0, 5\\)"),
    ],
)
def test_arrays_that_are_no_heights(array: np.ndarray, words: str) -> None:
    with pytest.raises(OrographError, match=words):
        orograph.terrain(array, transform=T, crs=CRS)


def test_missing_samples_of_arrays() -> None:
    array = values().astype(np.float64)
    hidden = np.zeros(array.shape, bool)
    hidden[3, 4] = True
    wanted = array.copy()
    wanted[3, 4] = np.nan
    check(orograph.terrain(np.ma.masked_array(array, hidden), transform=T, crs=CRS), wanted)
    holed = array.copy()
    holed[3, 4] = -9999
    check(orograph.terrain(holed, transform=T, crs=CRS, nodata=-9999), wanted)
    for odd in (np.inf, -np.inf, 1e20):
        holed[3, 4] = odd
        check(orograph.terrain(holed, transform=T, crs=CRS), wanted)
    assert array[3, 4] == values()[3, 4], "what was given is left as it is"


def test_arrays_lie_where_they_say() -> None:
    south_up = T * Affine.translation(0, 40) * Affine.scale(1, -1)
    check(orograph.terrain(values()[::-1], transform=south_up, crs=CRS), values())
    east_first = T * Affine.translation(50, 0) * Affine.scale(-1, 1)
    check(orograph.terrain(values()[:, ::-1], transform=east_first, crs=CRS), values())
    feet = orograph.terrain(values(), transform=T, crs=CRS, vertical_unit="ft", assume_vertical="EGM96", name="ft")
    assert feet.height_range[1] == pytest.approx(float(values().max()) * 0.3048) and feet.name == "ft"
    assert feet.vertical == "EGM96 height"
    degrees = orograph.terrain(values(), transform=from_origin(7, 46, 1 / 3600, 1 / 3600), crs="EPSG:4326")
    assert degrees.grid.crs is not None and degrees.grid.crs.to_epsg() == 32632
    moved = orograph.terrain(values(), transform=T, assume_crs=CRS, crs="EPSG:3310")
    assert moved.grid.crs is not None and moved.grid.crs.to_epsg() == 3310


def test_an_array_without_a_place_says_so() -> None:
    heard = Heard()
    found = orograph.terrain(values(), progress=heard)
    assert found.grid.crs is None and found.grid.spacing == (1.0, 1.0)
    assert len(heard.warnings) == 1 and "1 m apart" in heard.warnings[0] and "transform=" in heard.warnings[0]
    heard = Heard()
    assert orograph.terrain(values(), progress=heard, spacing=30).grid.spacing == (30.0, 30.0)
    assert not heard.warnings


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"transform": T.to_gdal()}, "GDAL's order.*from_gdal"),
        ({"transform": (1, 2, 3)}, "six numbers"),
        ({"transform": Affine(1, 1, 0, 1, 1, 0)}, "degenerate"),
        ({"transform": T, "spacing": 30}, "not both"),
        ({"crs": CRS}, "transform="),
        ({"transform": T, "crs": "EPSG:99999999"}, "not a CRS"),
        ({"band": 2}, "`band`.*array"),
        ({"transfrom": T}, "Did you mean transform"),
        ({"spacing": -1}, "positive"),
    ],
)
def test_options_that_make_no_sense(options: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        orograph.terrain(values(), **options)


def test_rasterio(dataset: Any, path: Path) -> None:
    check(orograph.terrain(path), values())
    check(orograph.terrain(dataset), values())
    check(orograph.terrain([dataset]), values())
    check(orograph.terrain(dataset.read(1), transform=dataset.transform, crs=dataset.crs), values())
    window = Window(5, 3, 20, 10)
    for given in (window, ((3, 13), (5, 25)), Window.from_slices(slice(3, 13), slice(5, 25))):
        check(orograph.terrain((dataset, given)), values()[3:13, 5:25], dataset.window_transform(window))
    with pytest.raises(UsageError, match="not inside"):
        orograph.terrain((dataset, Window(45, 0, 20, 10)))
    with pytest.raises(UsageError, match="A window must be"):
        orograph.terrain((dataset, 7))


def test_a_window_of_a_raster_that_is_south_up(tmp_path: Path) -> None:
    file = tmp_path / "south.tif"
    turned = T * Affine.translation(0, 40) * Affine.scale(1, -1)
    with rasterio.open(
        file, "w", driver="GTiff", width=50, height=40, count=1, dtype="int16", crs=CRS, transform=turned
    ) as out:
        out.write(values()[::-1], 1)
    with rasterio.open(file) as dataset:
        check(orograph.terrain(dataset), values())
        found = orograph.terrain((dataset, ((0, 10), (0, 20))))
    check(found, values()[30:, :20], T * Affine.translation(0, 30))


def test_datasets_without_a_file(dataset: Any, path: Path) -> None:
    from rasterio.io import MemoryFile
    from rasterio.vrt import WarpedVRT

    with MemoryFile(path.read_bytes()) as held, held.open() as inside:
        check(orograph.terrain(inside), values())
        assert inside.read(1).shape == (40, 50), "it is still open"
    with WarpedVRT(dataset, crs=CRS) as virtual:
        check(orograph.terrain(virtual), values())
    with WarpedVRT(dataset, crs="EPSG:4326") as virtual:
        assert orograph.terrain(virtual).grid.crs.to_epsg() == 32611  # type: ignore[union-attr]


def test_datasets_that_cannot_be_read(path: Path, tmp_path: Path) -> None:
    with rasterio.open(path) as closed:
        pass
    with pytest.raises(UsageError, match="closed"):
        orograph.terrain(closed)
    with (
        rasterio.open(
            tmp_path / "w.tif", "w", driver="GTiff", width=5, height=5, count=1, dtype="float32", crs=CRS, transform=T
        ) as out,
        pytest.raises(UsageError, match="open for writing"),
    ):
        orograph.terrain(out)


def test_xarray(path: Path) -> None:
    xr = pytest.importorskip("xarray")
    rioxarray = pytest.importorskip("rioxarray")
    with rioxarray.open_rasterio(path) as array:
        check(orograph.terrain(array), values())
        check(orograph.terrain(array.isel(band=0)), values())
        check(orograph.terrain(array.sel(x=slice(380150, 380750)).isel(y=slice(3, 13))), values()[3:13, 5:25],
              T * Affine.translation(5, 3))  # fmt: skip
        check(orograph.terrain(array.T), values())
        two = xr.Dataset({"elevation": array.squeeze(), "slope": array.squeeze() * 0})
        check(orograph.terrain(two), values())
        with pytest.raises(UsageError, match=r"\(a, b\).*dataset\['name'\]"):
            orograph.terrain(two.rename(elevation="a", slope="b"))
        nameless = array.squeeze().drop_vars("spatial_ref")
        assert orograph.terrain(nameless, crs=CRS).grid.crs.to_epsg() == 32611  # type: ignore[union-attr]
        assert orograph.terrain(array, crs="EPSG:3310").grid.crs.to_epsg() == 3310  # type: ignore[union-attr]
        with pytest.raises(ReadError, match="complex"):
            orograph.terrain(array.astype(complex))
        feet = orograph.terrain(array, vertical_unit="ft", assume_vertical="EGM96")
        np.testing.assert_allclose(feet.read(0, 0, 40, 0, 50), values() * 0.3048, rtol=1e-6)
        assert feet.vertical == "EGM96 height"
        at_first = orograph.terrain(array, nodata=float(values()[0, 0]))
        assert np.isnan(at_first.read(0, 0, 1, 0, 1)).all()
        declared = array.assign_attrs(units="cm")
        check(orograph.terrain(declared, vertical_unit="m"), values())
        with pytest.raises(UsageError, match="'ell' is not a known unit"):
            orograph.terrain(array, vertical_unit="ell")
    with xr.open_dataset(path, engine="rasterio") as opened:
        check(orograph.terrain(opened), values())


def test_a_lazy_array_is_computed_chunk_by_chunk(path: Path) -> None:
    pytest.importorskip("dask")
    rioxarray = pytest.importorskip("rioxarray")
    with rioxarray.open_rasterio(path, chunks={"y": 7, "x": 11}) as lazy:
        check(orograph.terrain(lazy), values())
        check(orograph.terrain(lazy.data, transform=T, crs=CRS), values())
        check(orograph.terrain((lazy * 2).isel(y=slice(None, None, -1))), values() * 2)


def test_several_are_put_together(path: Path, dataset: Any) -> None:
    xr = pytest.importorskip("xarray")
    left, right = values()[:, :30], values()[:, 30:]
    west = orograph.Dem(np.float32(left), orograph.Grid(left.shape, T, dem_crs()))
    x, y = 380015 + 30 * np.arange(30, 50), 3789985 - 30 * np.arange(40)
    east = xr.DataArray(right, {"y": y, "x": x}, ("y", "x"), attrs={"crs": CRS})
    check(orograph.terrain([west, east]), values())
    check(orograph.terrain([(dataset, ((0, 40), (0, 30))), east]), values())
    check(orograph.terrain([str(path), west]), values())
    check(orograph.terrain([path, path]), values())


def dem_crs() -> Any:
    from pyproj import CRS as Crs

    return Crs.from_user_input(CRS)


@pytest.mark.parametrize(
    "given", [[1.0, 2.0], None, 3, object(), {}, (), [], [None], {"a": 1}, lambda: 0], ids=lambda g: repr(g)[:12]
)
def test_what_cannot_be_meant_is_refused_with_the_way_in(given: Any, tmp_path: Path) -> None:
    for name, call in {
        "render": lambda: orograph.render(given),
        "terrain": lambda: orograph.terrain(given),
        "build": lambda: orograph.build(given, tmp_path / "a.oro"),
        "whole": lambda: orograph.camera.whole(given, (64, 48)),
        "profile": lambda: measuring.profile(given, [(0, 0), (1, 1)]),
    }.items():
        with pytest.raises(UsageError, match=f"{name} (takes a path.*got|got an empty list)"):
            call()


def test_what_holds_heights_in_another_form_is_told_the_way_in(path: Path) -> None:
    import io

    pandas = pytest.importorskip("pandas")
    content = path.read_bytes()
    with rasterio.open(path) as dataset, rasterio.MemoryFile(content) as memory, path.open("rb") as file:
        for given, way in (
            (path.parent.glob("*.tif"), "Make a list of it"), (pandas.DataFrame(values()), r"\.to_numpy\(\)"),
            (rasterio.band(dataset, 1), "band="), (memory, r"\.open\(\)"), (content, "MemoryFile"),
            (io.BytesIO(content), "MemoryFile"), (file, "Give its path"),
        ):  # fmt: skip
            with pytest.raises(UsageError, match=f"terrain takes a path.*got.*{way}"):
                orograph.terrain(given)
    for odd, here in (("bounds", "bbox"), ("extent", "transform")):
        with pytest.raises(UsageError, match=f"It is called {here} here"):
            orograph.terrain(path, **{odd: (0, 1, 0, 1)})


def test_functions_that_take_a_terrain_take_them_all(path: Path, dataset: Any, tmp_path: Path) -> None:
    a, b = (380100.0, 3789900.0), (381000.0, 3789200.0)
    truth = measuring.profile(orograph.terrain(path), [a, b]).length
    place = {"transform": T, "crs": CRS}
    for given, options in ((path, {}), (dataset, {}), (values(), place), ([str(path)], {})):
        assert measuring.profile(given, [a, b], **options).length == truth
        view = orograph.camera.around(given, (64, 48), azimuth=200, pitch=30, distance=None, **options)
        picture = orograph.render(given, view, samples=1, shadows=False, **options)
        assert np.isfinite(picture.depth).any()
    slope = orograph.light(values(), "slope", **place)
    np.testing.assert_array_equal(slope.values, orograph.light(path, "slope").values)
    built = orograph.build(values(), tmp_path / "a.oro", **place)
    check(built, values())
    check(orograph.terrain(built.url), values())
    assert orograph.terrain(built) is built
    with pytest.raises(UsageError, match="`crs` cannot be used with a Terrain"):
        orograph.terrain(built, crs=CRS)


def test_what_is_said_of_files_is_what_a_source_is_opened_with() -> None:
    import inspect

    from orograph.dem import Source
    from orograph.dem.mosaic import Mosaic
    from orograph.store.given import OF_FILES, OF_GRIDS, OF_MANY

    assert tuple(inspect.signature(Source.open).parameters)[1:] == OF_FILES
    rest = set(inspect.signature(Mosaic.open).parameters) - {"paths", "progress", "options", *OF_MANY}
    assert set(OF_GRIDS) == rest
