"""Mosaics brought to another vertical datum: against the geoid grid read by hand, PROJ, and published undulations."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS, Transformer

from orograph import store
from orograph.cli import cli
from orograph.dem import undulation as undulation_module
from orograph.dem.mosaic import Mosaic
from orograph.errors import ReadError, UsageError
from orograph.geo import Geoid

EGM96 = "EPSG:4326+5773"


@pytest.fixture(scope="module")
def egm96(shared_data: Path) -> Path:
    return shared_data / "egm96-grid" / "egm96_15.gtx"


def by_hand(path: Path, lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """Bilinear between the numbers of the file: big-endian float32 after a 40-byte header, rows from the south."""
    raw = np.fromfile(path, ">f4", offset=40).reshape(721, 1440).astype(np.float64)
    x, y = (np.asarray(lon) + 180) % 360 * 4, (np.asarray(lat) + 90) * 4
    i, j = np.floor(x).astype(int) % 1440, np.minimum(np.floor(y).astype(int), 719)
    s, t = x - np.floor(x), y - j
    below, above = (raw[k, i] * (1 - s) + raw[k, (i + 1) % 1440] * s for k in (j, j + 1))
    return below * (1 - t) + above * t


def write(
    path: Path, crs: str, transform: Affine, shape: tuple[int, int] = (40, 50), value: float | np.ndarray = 0.0
) -> Path:
    rows, cols = shape
    with rasterio.open(
        path, "w", driver="GTiff", height=rows, width=cols, count=1, dtype="float32", crs=crs, transform=transform
    ) as dataset:
        dataset.write(np.broadcast_to(np.float32(value), shape), 1)
    return path


def placed(m: Mosaic) -> tuple[np.ndarray, np.ndarray]:
    """Longitude and latitude of each sample, one by one."""
    x, y = m.grid.xy(*np.meshgrid(np.arange(m.grid.cols), np.arange(m.grid.rows)))
    return Transformer.from_crs(m.grid.crs, 4326, always_xy=True).transform(x, y)


def everything(m: Mosaic) -> np.ndarray:
    return m.read(0, m.grid.rows, 0, m.grid.cols)


AREAS = {
    "tile": (EGM96, Affine(0.002, 0, 13.9, 0, -0.002, 47.3), (500, 700)),  # several cells of the grid
    "wide": (EGM96, Affine(0.05, 0, 60, 0, -0.05, 12), (200, 300)),  # 10° by 15°, over the deepest hole of the geoid
    "antimeridian": (EGM96, Affine(0.01, 0, 178.7, 0, -0.01, 52.4), (90, 300)),
    "trench": (EGM96, Affine(0.01, 0, -67, 0, -0.01, 20.5), (200, 200)),  # Puerto Rico: the geoid is steepest
    "pole": (EGM96, Affine(0.25, 0, -180, 0, -0.05, 90), (60, 1440)),
    "projected": ("EPSG:32633+5773", Affine(200, 30, 4e5, 30, -200, 5.2e6), (300, 250)),
}


@pytest.mark.parametrize("area", AREAS)
@pytest.mark.parametrize("to", ["ellipsoidal", "orthometric"])
def test_it_is_the_grid_that_is_named(tmp_path: Path, egm96: Path, area: str, to: str) -> None:
    crs, transform, shape = AREAS[area]
    if to == "orthometric":
        crs = "EPSG:4979" if crs == EGM96 else "EPSG:32633"
    path = write(tmp_path / "a.tif", crs, transform, shape, 0.0)
    assumed = {"assume_vertical": "ellipsoidal"} if crs == "EPSG:32633" else {}
    plain = Mosaic.open(path, **assumed)
    m = Mosaic.open(path, to_vertical=to, geoid=egm96, **assumed)
    found = everything(m)
    assert m.grid == plain.grid and np.array_equal(np.isnan(found), np.isnan(everything(plain)))
    lon, lat = placed(m)
    expected = by_hand(egm96, lon, lat) * (1 if to == "ellipsoidal" else -1)
    valid = ~np.isnan(found)
    assert valid.mean() > 0.4 and np.abs(found[valid]).max() > 5
    np.testing.assert_allclose(found[valid], expected[valid], rtol=0, atol=1e-3)
    assert m.vertical == ("ellipsoidal height (WGS 84)" if to == "ellipsoidal" else "EGM96 height")


def test_it_is_proj_with_that_grid(shared_data: Path, egm96: Path) -> None:
    path = shared_data / "n44w072-hgt" / "N44W072.hgt"
    before, after = Mosaic.open(path), Mosaic.open(path, to_vertical="ellipsoidal", geoid=egm96)
    proj = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +proj=vgridshift +grids={egm96} +multiplier=1 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    low, high = everything(before)[400:700, 300:800], everything(after)[400:700, 300:800]
    lon, lat = (a[400:700, 300:800] for a in placed(before))
    expected = proj.transform(lon, lat, low.astype(float))[2]
    assert np.abs(expected - low).min() > 20  # PROJ did use the grid
    np.testing.assert_allclose(high, expected, rtol=0, atol=1e-3)


def test_published_undulations(tmp_path: Path, shared_data: Path, egm96: Path) -> None:
    with (shared_data / "geodesy-truth" / "egm96_spot_values.csv").open() as file:
        points = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    assert len(points) == 7
    for i, p in enumerate(points):
        lon = (p["lon"] + 180) % 360 - 180
        path = write(tmp_path / f"{i}.tif", EGM96, Affine(0.001, 0, lon - 0.02, 0, -0.001, p["lat"] + 0.02), value=1000)
        m = Mosaic.open(path, to_vertical="ellipsoidal", geoid=egm96)
        x, y = Transformer.from_crs(4326, m.grid.crs, always_xy=True).transform(lon, p["lat"])
        col, row = (round(float(v)) for v in m.grid.index(x, y))
        found = float(m.read(row, row + 1, col, col + 1)[0, 0]) - 1000
        assert found == pytest.approx(p["published_N_m"], abs=0.07)
        # The sample is within 80 m of the point; there the geoid is at most 0.1 m per kilometre steep.
        assert found == pytest.approx(p["bilinear_egm96_15_m"], abs=0.008)


@pytest.fixture(scope="module")
def converted(tmp_path_factory: pytest.TempPathFactory, egm96: Path) -> tuple[Mosaic, np.ndarray]:
    """Across the antimeridian: cells of the mesh that the seam of the grid bends; and holes."""
    heights = np.add.outer(np.arange(260.0), np.arange(300.0))
    heights[50:80, 100:200] = np.nan
    folder = tmp_path_factory.mktemp("converted")
    path = write(folder / "a.tif", EGM96, Affine(0.004, 0, 179.5, 0, -0.004, 66), (260, 300), heights)
    m = Mosaic.open(path, to_vertical="ellipsoidal", geoid=egm96)
    return m, everything(m)


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_windows_are_the_same_to_the_bit(converted: tuple[Mosaic, np.ndarray], data: st.DataObject) -> None:
    m, whole = converted
    rows, cols = m.grid.shape
    row0, col0 = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, cols - 1))
    row1 = data.draw(st.integers(row0 + 1, min(rows, row0 + 90)))
    col1 = data.draw(st.integers(col0 + 1, min(cols, col0 + 90)))
    assert np.array_equal(m.read(row0, row1, col0, col1), whole[row0:row1, col0:col1], equal_nan=True)


def test_threads_and_strips_do_not_matter(
    converted: tuple[Mosaic, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    m, whole = converted
    monkeypatch.setattr(undulation_module, "STRIP", 7)
    rows, cols = m.grid.shape
    windows = [(r, min(r + 61, rows), c, min(c + 83, cols)) for r in range(0, rows, 61) for c in range(0, cols, 83)]
    with ThreadPoolExecutor(4) as pool:
        for (a, b, c, d), part in zip(windows, pool.map(lambda w: m.read(*w), windows)):
            assert np.array_equal(part, whole[a:b, c:d], equal_nan=True)


def test_what_cannot_be_converted_is_refused(tmp_path: Path, shared_data: Path, egm96: Path) -> None:
    at = Affine(0.01, 0, 8, 0, -0.01, 47)
    none = write(tmp_path / "none.tif", "EPSG:4326", at)
    geoidal = write(tmp_path / "geoidal.tif", EGM96, at)
    ellipsoidal = write(tmp_path / "ellipsoidal.tif", "EPSG:4979", at)
    navd = write(tmp_path / "navd.tif", "EPSG:4269+5703", at)
    local = write(tmp_path / "local.tif", None, Affine(30, 0, 5e5, 0, -30, 4e6))  # type: ignore[arg-type]
    moon = write(tmp_path / "moon.tif", "IAU_2015:30100", at)

    def refused(error: type[Exception], says: str, path: Path | list[Path], **options: object) -> None:
        with pytest.raises(error, match=says):
            Mosaic.open(path, **options)  # type: ignore[arg-type]

    up, down = {"to_vertical": "ellipsoidal", "geoid": egm96}, {"to_vertical": "orthometric", "geoid": egm96}
    refused(UsageError, '`geoid="egm96', geoidal, to_vertical="ellipsoidal")
    refused(UsageError, "`to_vertical='ellipsoidal'`", geoidal, geoid=egm96)
    refused(UsageError, "not 'up'", geoidal, to_vertical="up", geoid=egm96)
    refused(ReadError, "no such geoid grid", geoidal, to_vertical="ellipsoidal", geoid=tmp_path / "egm96_15.gtx")
    refused(UsageError, "already", ellipsoidal, **up)
    refused(UsageError, "already", geoidal, **down)
    refused(UsageError, "NAVD88 height", navd, **up)
    refused(UsageError, "NAVD88 height", navd, **down)
    refused(UsageError, "navd does|of 'NAVD88", [geoidal, navd], **up)
    refused(UsageError, "`assume_vertical='EGM96'`", none, **up)
    refused(UsageError, "`assume_vertical='ellipsoidal'`", none, **down)
    refused(UsageError, "not a known vertical datum", none, **up, assume_vertical="sea")
    refused(UsageError, "NAVD88 height", none, **up, assume_vertical="EPSG:5703")
    refused(ReadError, "no CRS", local, **up, assume_vertical="EGM96")
    refused(ReadError, "another body", moon, **up, assume_vertical="EGM96")
    stated = Mosaic.open(none, **up, assume_vertical="egm96")  # type: ignore[arg-type]
    assert np.array_equal(everything(stated), everything(Mosaic.open(geoidal, **up)), equal_nan=True)  # type: ignore[arg-type]
    # What a file declares is not overruled.
    said = Mosaic.open(navd, assume_vertical="EGM96")
    assert said.vertical == "NAVD88 height" and any("`assume_vertical`" in w for w in said.warnings)


@pytest.mark.parametrize("east,north", [(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1), (1, 1)])
def test_one_corner_off_the_grid_is_refused(tmp_path: Path, east: int, north: int) -> None:
    """A grid over 4…10° E, 44…48° N; a terrain of 1° within it, or 0.1° out of it."""
    geoid = write(tmp_path / "egm96_part.tif", "EPSG:4326", Affine(1, 0, 3.5, 0, -1, 48.5), (5, 7), 50.0)
    lon, lat = 7 + east * 2.6, 46 + north * 1.6
    path = write(tmp_path / "a.tif", EGM96, Affine(0.02, 0, lon - 0.5, 0, -0.02, lat + 0.5), (50, 50), 10.0)
    if (east, north) == (0, 0):
        found = everything(Mosaic.open(path, to_vertical="ellipsoidal", geoid=geoid))
        assert np.nanmin(found) == np.nanmax(found) == 60
        return
    with pytest.raises(ReadError, match="lies off the geoid grid"):
        Mosaic.open(path, to_vertical="ellipsoidal", geoid=geoid)


def test_the_corner_of_a_turned_terrain_off_the_grid_is_refused(tmp_path: Path) -> None:
    """Turned by 45°, so that only its eastern corner reaches beyond 10° E."""
    geoid = write(tmp_path / "egm96_part.tif", "EPSG:4326", Affine(1, 0, 3.5, 0, -1, 48.5), (5, 7), 50.0)
    half = 0.5**0.5
    for size, fits in ((60, True), (64, False)):  # its eastern corner is at 9.1° + size · 0.01° · √2
        turned = Affine(0.01 * half * 2, 0.01 * half * 2, 9.1 - size * 0.01 * half * 2, 0.01 * half, -0.01 * half, 46)
        path = write(tmp_path / f"{size}.tif", EGM96, turned, (size, size), 10.0)
        corners = [9.1 + (i + j - size) * 0.02 * half for i in (0, size) for j in (0, size)]
        assert (max(corners) < 10) is fits
        if fits:
            Mosaic.open(path, to_vertical="ellipsoidal", geoid=geoid)
        else:
            with pytest.raises(ReadError, match="lies off the geoid grid"):
                Mosaic.open(path, to_vertical="ellipsoidal", geoid=geoid)


def test_a_hole_of_the_grid_is_refused_where_there_are_heights(tmp_path: Path) -> None:
    values = np.full((5, 7), 50.0)
    values[2, 3] = np.nan  # 7° E, 46° N
    geoid = write(tmp_path / "egm96_part.tif", "EPSG:4326", Affine(1, 0, 3.5, 0, -1, 48.5), (5, 7), values)
    heights = np.full((50, 50), 10.0)
    path = write(tmp_path / "a.tif", EGM96, Affine(0.02, 0, 6.5, 0, -0.02, 46.5), (50, 50), heights)
    with pytest.raises(ReadError, match="hole"):
        everything(Mosaic.open(path, to_vertical="ellipsoidal", geoid=geoid))
    path = write(tmp_path / "b.tif", EGM96, Affine(0.02, 0, 6.5, 0, -0.02, 46.5), (50, 50), np.nan)
    assert np.isnan(everything(Mosaic.open(path, to_vertical="ellipsoidal", geoid=geoid))).all()


def test_fingerprints_know_the_grid(tmp_path: Path, egm96: Path) -> None:
    path = write(tmp_path / "a.tif", EGM96, Affine(0.01, 0, 8, 0, -0.01, 47))
    other = write(tmp_path / "egm96_other.tif", "EPSG:4326", Affine(1, 0, 3.5, 0, -1, 48.5), (5, 7), 50.0)
    open_: Callable[..., str] = lambda **o: Mosaic.open(path, **o).fingerprint()  # noqa: E731
    prints = [open_(), open_(to_vertical="ellipsoidal", geoid=egm96), open_(to_vertical="ellipsoidal", geoid=other)]
    write(other, "EPSG:4326", Affine(1, 0, 3.5, 0, -1, 48.5), (5, 7), 51.0)
    prints.append(open_(to_vertical="ellipsoidal", geoid=other))
    assert len(set(prints)) == 4
    assert prints[1] == open_(to_vertical="ellipsoidal", geoid=Geoid.open(egm96))


def run(*args: object) -> tuple[int, str]:
    result = CliRunner().invoke(cli, ["--quiet", *map(str, args)])
    code = getattr(result.exception, "exit_code", result.exit_code)  # as the command's main() has it
    return code, f"{result.output}{result.exception or ''}"


def test_on_the_command_line(tmp_path: Path, egm96: Path) -> None:
    path = write(tmp_path / "a.tif", "EPSG:32632", Affine(30, 0, 4.5e5, 0, -30, 5.2e6), value=500)
    wanted = ["--to-vertical", "ellipsoidal", "--geoid", egm96, "--assume-vertical", "EGM96"]
    code, said = run("build", path, "-o", tmp_path / "a.oro", "--json", *wanted)
    assert code == 0, said
    told = json.loads(said)
    assert told["vertical_datum"] == "ellipsoidal height (WGS 84)"
    lon, lat = Transformer.from_crs(32632, 4326, always_xy=True).transform(4.5e5 + 15, 5.2e6 - 15)
    with store.open(tmp_path / "a.oro") as terrain:
        found = terrain.read(0, 0, 1, 0, 1)[0, 0]
        assert found == pytest.approx(500 + float(by_hand(egm96, np.array(lon), np.array(lat))), abs=1e-3)
        assert terrain.vertical == "ellipsoidal height (WGS 84)" and terrain.grid.crs == CRS(32632)
    code, said = run("render", path, "-o", tmp_path / "a.png", "--size", "64x48", "--json", *wanted)
    assert code == 0 and (tmp_path / "a.png").exists(), said
    for verb, out in (("build", "b.oro"), ("render", "b.png")):
        assert run(verb, path, "-o", tmp_path / out, *wanted[:2])[0] == 2
        assert run(verb, path, "-o", tmp_path / out, *wanted[2:4])[0] == 2
        assert run(verb, path, "-o", tmp_path / out, *wanted[:4])[0] == 2  # the file does not say above what it is
        code, said = run(verb, path, "-o", tmp_path / out, *wanted[:2], "--geoid", tmp_path / "x.gtx", *wanted[4:])
        assert code == 3 and "x.gtx" in said
    code, said = run("info", path, "--json", "--assume-vertical", "EGM2008")
    assert json.loads(said)["vertical_datum"] == "EGM2008 height"
    assert run("render", tmp_path / "a.oro", "-o", tmp_path / "c.png", *wanted[:4])[0] == 2
