"""Headers that say a thing twice, or what GDAL passes over: they are refused, or their word is kept."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.shutil import copy

from orograph.dem import Source, read
from orograph.errors import ReadError

from .test_whole import UTM, hill, made

BODY = "1 2.5 3\n4 5 6\n"
ARC = {"ncols": "3", "nrows": "2", "xllcorner": "0", "yllcorner": "0", "cellsize": "1"}
GRASS = {"north": "2", "south": "0", "east": "3", "west": "0", "rows": "2", "cols": "3"}


def text(folder: Path, header: list[tuple[str, str]], parting: str) -> Path:
    path = folder / "a.asc"
    path.write_text("".join(f"{key}{parting} {value}\n" for key, value in header) + BODY)
    return path


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"xllcorner": "abc"}, "'abc' for 'xllcorner', which is not a number"),
        ({"NODATA_value": "abc"}, "not a number"),
        ({"yllcorner": None, "yllcenter": "0"}, "a centre along the other"),
        ({"xllcenter": "900", "yllcenter": "0"}, "a corner"),
        ({"CELLSIZE": "2"}, "'cellsize' twice: 1 and 2"),
    ],
)
def test_arc(tmp_path: Path, more: dict[str, str | None], said: str) -> None:
    header = [(key, value) for key, value in {**ARC, **more}.items() if value is not None]
    with pytest.raises(ReadError, match=said):
        read(text(tmp_path, header, ""))


@pytest.mark.parametrize(
    "more", [{}, {"NODATA_value": "nan"}, {"cellsize": "30,5"}, {"cellsize": None, "dx": "1", "dy": "2"}]
)
def test_sound_headers_of_arc(tmp_path: Path, more: dict[str, str | None]) -> None:
    header = [(key, value) for key, value in {**ARC, **more}.items() if value is not None]
    np.testing.assert_array_equal(read(text(tmp_path, header, "")).heights, [[1, 2.5, 3], [4, 5, 6]])


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"north": "46:30:00N"}, "in degrees and minutes"),
        ({"multiplier": "2"}, "multiplies heights by 2"),
        ({"null": "abc"}, "'abc' for 'null', which is not a number"),
        ({"NORTH": "5"}, "'north' twice"),
    ],
)
def test_grass(tmp_path: Path, more: dict[str, str], said: str) -> None:
    with pytest.raises(ReadError, match=said):
        read(text(tmp_path, list({**GRASS, **more}.items()), ":"))
    sound = text(tmp_path, list({**GRASS, "null": "*", "type": "float"}.items()), ":")
    np.testing.assert_array_equal(read(sound).heights, [[1, 2.5, 3], [4, 5, 6]])


def altered(path: Path, *changes: tuple[int, str, float]) -> None:
    data = bytearray(path.read_bytes())
    for at, form, value in changes:
        struct.pack_into(form, data, at, value)
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("change", "said"),
    [((124, "<d", 0.4), "rotated by 0.4 radians"), ((116, "<d", 60.0), "Its cells are 30 × 60"),
     ((108, "<d", np.nan), "Its cells are nan"), ((108, "<d", -30.0), "Its cells are -30")],
)  # fmt: skip
def test_pcraster(tmp_path: Path, change: tuple[int, str, float], said: str) -> None:
    path = made(tmp_path / "made", "PCRaster", "a.map", "float32", PCRASTER_VALUESCALE="VS_SCALAR")
    read(path)
    altered(path, change)
    with pytest.raises(ReadError, match=said):
        read(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [((116, ">d", 60.0), "Its header places"), ((60, ">d", 4e5), "Its header places"),
     ((92, ">d", 5e6), "Its header places"), ((52, ">d", 0.0), "has 0 height steps"),
     ((52, ">d", np.inf), "has inf height steps"), ((52, ">d", -1000.0), "has -1000 height steps"),
     ((52, ">d", 1.0), "where its header has all between")],
)  # fmt: skip
def test_sigdem(tmp_path: Path, change: tuple[int, str, float], said: str) -> None:
    path = made(tmp_path / "made", "SIGDEM", "a.sigdem", "float64")
    read(path)
    altered(path, change)
    with pytest.raises(ReadError, match=said):
        read(path)


RECORD, HEADERS = 12 + 2 * 121, 3428


def exchanged(data: bytearray) -> None:
    one, two = (slice(HEADERS + column * RECORD, HEADERS + (column + 1) * RECORD) for column in (10, 50))
    data[one], data[two] = data[two], data[one]


def copied(data: bytearray) -> None:
    data[HEADERS + 10 * RECORD : HEADERS + 11 * RECORD] = data[HEADERS + 50 * RECORD : HEADERS + 51 * RECORD]


def put(at: int, what: bytes) -> Callable[[bytearray], None]:
    def change(data: bytearray) -> None:
        data[at : at + len(what)] = what

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [(exchanged, "out of order"), (copied, "out of order"), (put(4, b"0900000E"), "begins at longitude 90"),
     (put(4, b"09x0000E"), "has no position"), (put(12, b"0100000N"), "begins at latitude 10"),
     (put(20, b"0600"), "an eastward step"), (put(24, b"0600"), "a northward step")],
)  # fmt: skip
def test_dted(shared_data: Path, tmp_path: Path, change: Callable[[bytearray], None], said: str) -> None:
    data = bytearray((shared_data / "nasty-gdal" / "n43.dt0").read_bytes())
    change(data)
    path = tmp_path / "n43.dt0"
    path.write_bytes(data)
    with pytest.raises(ReadError, match=said):
        read(path)


def test_what_gdal_writes_as_dted_is_whole(tmp_path: Path) -> None:
    plain = tmp_path / "plain.tif"
    with rasterio.open(plain, "w", driver="GTiff", height=121, width=121, count=1, dtype="int16", crs="EPSG:4326",
                       transform=Affine(1 / 120, 0, -72 - 1 / 240, 0, -1 / 120, 45 + 1 / 240)) as file:  # fmt: skip
        file.write(np.arange(121 * 121, dtype=np.int16).reshape(121, 121) % 3000, 1)
    copy(str(plain), str(tmp_path / "a.dt0"), driver="DTED")
    np.testing.assert_array_equal(read(tmp_path / "a.dt0").heights, read(plain).heights)


def test_tiles_of_srtm_that_lie_nowhere(shared_data: Path, tmp_path: Path) -> None:
    tile = shared_data / "n44w072-hgt" / "N44W072.hgt"
    for name in ("N95W072.hgt", "N44W272.hgt"):
        (tmp_path / name).write_bytes(tile.read_bytes())
        with pytest.raises(ReadError, match="not a valid position"):
            read(tmp_path / name)


OLD = "Projection    UTM\nZone          33\nDatum         WGS84\nZunits        {}\nUnits         METERS\nXshift {}\n"


def test_the_old_words_of_a_prj(tmp_path: Path) -> None:
    path = text(tmp_path, list(ARC.items()), "")
    for zunits, factor in (("FEET", 0.3048), ("METERS", 1), ("NO", 1)):
        path.with_suffix(".prj").write_text(OLD.format(zunits, "0.0") + "Parameters\n")
        np.testing.assert_allclose(read(path).heights, np.array([[1, 2.5, 3], [4, 5, 6]]) * factor, rtol=1e-6)
    path.with_suffix(".prj").write_text(OLD.format("NO", "100.0") + "Parameters\n")
    with pytest.raises(ReadError, match="shifted"):
        read(path)


@pytest.mark.parametrize("what", ["+proj=utm +zone=32", "<html>404</html>"])
def test_a_prj_that_is_not_understood_is_told(tmp_path: Path, what: str) -> None:
    path = text(tmp_path, list(ARC.items()), "")
    path.with_suffix(".prj").write_text(what)
    with Source.open(path) as source:
        assert any("cannot be understood (a.prj)" in warning for warning in source.warnings) == (
            source.grid.crs is None
        )


def test_two_units_of_height(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    with rasterio.open(path, "w", driver="GTiff", height=61, width=83, count=1, dtype="float32",
                       crs="EPSG:32632+8228", transform=UTM) as file:  # fmt: skip
        file.write(hill("float32"), 1)
        file.units = ("m",)
    with Source.open(path) as source:
        assert any("another unit (0.3048 m): m is used" in warning for warning in source.warnings)
