"""What a GeoTIFF says of its numbers that GDAL reads as something else."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph.dem import Source, read
from orograph.errors import ReadError

UTM = Affine(30, 0, 5e5, 0, -30, 4e6)
HEIGHTS = np.arange(30, dtype=np.float32).reshape(5, 6)


def tiff(
    path: Path, nodata: bytes = b"", vertical: int = 0, *, keys: tuple[tuple[int, int, int, int], ...] = (),
    kind: str = "float32",    more: dict[int, tuple[int, int, bytes] | None] | None = None, following: bool = False,
) -> Path:  # fmt: skip
    """A GeoTIFF 1.0 of HEIGHTS, with this text as its nodata value, this vertical CRS, further keys, and other tags
    (type, count, value; None: without it); perhaps with a second image of twice as many rows."""
    place, data = struct.pack("<6d", 0, 0, 0, 500000, 4000000, 0), HEIGHTS.astype(kind).tobytes()
    codes = [1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32611] + ([4096, 0, 1, vertical] if vertical else [])
    codes += [value for key in keys for value in key]
    packed = struct.pack(f"<{len(codes) + 4}H", 1, 1, 0, len(codes) // 4, *codes)
    values: list[tuple[int, int, int, bytes]] = [
        (256, 3, 1, struct.pack("<H", 6)), (257, 3, 1, struct.pack("<H", 5)),
        (258, 3, 1, struct.pack("<H", 8 * np.dtype(kind).itemsize)),
        (259, 3, 1, struct.pack("<H", 1)), (262, 3, 1, struct.pack("<H", 1)), (273, 4, 1, struct.pack("<I", 8)),
        (277, 3, 1, struct.pack("<H", 1)), (278, 3, 1, struct.pack("<H", 5)),
        (279, 4, 1, struct.pack("<I", len(data))), (339, 3, 1, struct.pack("<H", " uif".index(np.dtype(kind).kind))),
        (33550, 12, 3, struct.pack("<3d", 30, 30, 0)), (33922, 12, 6, place), (34735, 3, len(codes) + 4, packed),
    ]  # fmt: skip
    if nodata:
        values.append((42113, 2, len(nodata), nodata))
    more = more or {}
    values = [value for value in values if value[0] not in more]
    values = sorted([*values, *((tag, *value) for tag, value in more.items() if value is not None)])
    out = bytearray(b"II*\0\0\0\0\0" + data)
    entries = b""
    for tag, kind, count, value in values:
        if len(value) > 4:
            entries += struct.pack("<HHII", tag, kind, count, len(out))
            out += value + b"\0" * (len(value) % 2)
        else:
            entries += struct.pack("<HHI", tag, kind, count) + value.ljust(4, b"\0")
    out[4:8] = struct.pack("<I", len(out))
    out += struct.pack("<H", len(values)) + entries
    if following:
        taller = {257: struct.pack("<HHIHH", 257, 3, 1, 10, 0), 278: struct.pack("<HHIHH", 278, 3, 1, 10, 0)}
        taller[279] = struct.pack("<HHII", 279, 4, 1, 2 * len(data))
        plain = [entries[i : i + 12] for i in range(0, len(entries), 12) if i < 10 * 12]
        out += struct.pack("<I", len(out) + 4 + 2 * len(data))
        taller[273] = struct.pack("<HHII", 273, 4, 1, len(out))
        out += data + data + struct.pack("<H", len(plain))
        out += b"".join(taller.get(struct.unpack_from("<H", entry)[0], entry) for entry in plain)
    path.write_bytes(out + bytes(4))
    return path


@pytest.mark.parametrize("text", ["abc", "0x270f", "-9,999", "\u22129999", "5abc"])
def test_a_nodata_value_that_is_no_number(tmp_path: Path, text: str) -> None:
    path = tiff(tmp_path / "a.tif", text.encode() + b"\0")
    with pytest.raises(ReadError, match="is not a number"):
        read(path)
    np.testing.assert_array_equal(read(path, nodata="none").heights, HEIGHTS)


@pytest.mark.parametrize("text", ["7", "7.0", " 7 ", "7,0", "+7e0", "7."])
def test_spellings_of_a_nodata_value(tmp_path: Path, text: str) -> None:
    found = read(tiff(tmp_path / "a.tif", text.encode() + b"\0")).heights
    np.testing.assert_array_equal(found, np.where(HEIGHTS == 7, np.nan, HEIGHTS))


def test_the_vertical_datum_of_geotiff_1_0(tmp_path: Path) -> None:
    assert read(tiff(tmp_path / "a.tif", vertical=5703)).vertical == "NAVD88 height"
    depths = read(tiff(tmp_path / "b.tif", vertical=5715))
    assert depths.vertical == "MSL height"
    np.testing.assert_array_equal(depths.heights, -HEIGHTS)


@pytest.mark.parametrize(("scale", "offset"), [(0, 0), (0, 700), (np.nan, 0), (np.inf, 0), (1, np.nan)])
def test_a_scale_that_tells_no_heights_apart(tmp_path: Path, scale: float, offset: float) -> None:
    path = tmp_path / "a.tif"
    with rasterio.open(path, "w", driver="GTiff", height=5, width=6, count=1, dtype="float32", crs="EPSG:32611",
                       transform=Affine(30, 0, 5e5, 0, -30, 4e6)) as file:  # fmt: skip
        file.write(HEIGHTS, 1)
        file.scales, file.offsets = (scale,), (offset,)
    with pytest.raises(ReadError, match="makes them all alike"):
        read(path)


@pytest.mark.parametrize("kind", ["float32", "float64", "int16", "uint8"])
def test_lerc_with_the_high_byte_first(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.tif"
    with rasterio.open(path, "w", driver="GTiff", height=5, width=6, count=1, dtype=kind, crs="EPSG:32611",
                       transform=UTM, compress="LERC", ENDIANNESS="BIG") as file:  # fmt: skip
        file.write(HEIGHTS.astype(kind), 1)
    if kind.startswith("float"):
        with pytest.raises(ReadError, match=r"LERC-compressed in big-endian order.*ENDIANNESS=LITTLE"):
            read(path)
    else:
        np.testing.assert_array_equal(read(path).heights, HEIGHTS)


def warnings_of(path: Path, **options: str) -> str:
    with Source.open(path, **options) as source:  # type: ignore[arg-type]
        return " ".join(source.warnings)


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [("uint16", b"-9999", "stored as 55537"), ("uint8", b"-1", "stored as 255"), ("int16", b"32768", "as -32768"),
     ("int16", b"-3.4e38", "cannot occur in int16, so it marks nothing"), ("int16", b"-32767.5", "cannot occur")],
)  # fmt: skip
def test_a_nodata_value_that_its_type_cannot_hold(tmp_path: Path, kind: str, text: bytes, said: str) -> None:
    path = tiff(tmp_path / "a.tif", text + b"\0", kind=kind)
    assert said in warnings_of(path)
    assert warnings_of(path, nodata="none") == ""


@pytest.mark.parametrize("text", [b"nan", b"7", b"255", b"0"])
def test_a_nodata_value_that_is_sound(tmp_path: Path, text: bytes) -> None:
    assert warnings_of(tiff(tmp_path / "a.tif", text + b"\0", kind="uint8")) == ""


def doubles(*numbers: float) -> tuple[int, int, bytes]:
    return 12, len(numbers), struct.pack(f"<{len(numbers)}d", *numbers)


TIE = (0.0, 0.0, 0.0, 5e5, 4e6, 0.0)
MATRIX = (30, 0, 0, 5e5, 0, -30, 0, 4e6, 0, 0, 0, 0, 0, 0, 0, 1)


@pytest.mark.parametrize(
    ("more", "said"),
    [({33550: doubles(30, -30, 0)}, "negative in y"),
     ({33922: doubles(*TIE, 6, 5, 0, 505000, 3990000, 0)}, "2 tie points contradict"),
     ({34264: doubles(*MATRIX[:3], 6e5, *MATRIX[4:])}, "two different places"),
     ({34264: doubles(40, *MATRIX[1:])}, "two different places"),
     ({274: (3, 1, struct.pack("<H", 3))}, "rotated or mirrored")],
)  # fmt: skip
def test_a_place_that_contradicts_itself(
    tmp_path: Path, more: dict[int, tuple[int, int, bytes] | None], said: str
) -> None:
    assert said in warnings_of(tiff(tmp_path / "a.tif", more=more))


@pytest.mark.parametrize(
    "more",
    [{}, {34264: doubles(*MATRIX)}, {33922: doubles(*TIE, 6, 5, 0, 500180, 3999850, 0)},
     {33922: doubles(6, 5, 0, 500180, 3999850, 0)}, {274: (3, 1, struct.pack("<H", 1))}],
)  # fmt: skip
def test_a_place_said_twice_alike(tmp_path: Path, more: dict[int, tuple[int, int, bytes] | None]) -> None:
    path = tiff(tmp_path / "a.tif", more=more)
    assert warnings_of(path) == ""
    assert read(path).grid.transform == UTM


def test_a_pixel_scale_without_a_tie_point(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="not their place"):
        read(tiff(tmp_path / "a.tif", more={33922: None}))


def test_keys_that_contradict(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"occurs twice \(3072: 32611 and 32612\)"):
        read(tiff(tmp_path / "a.tif", keys=((3072, 0, 1, 32612),)))
    survey = tiff(tmp_path / "b.tif", vertical=5703, keys=((4099, 0, 1, 9003),))
    assert "unit of 0.304800" in warnings_of(survey)
    assert "VerticalUnits" not in warnings_of(survey, vertical_unit="m")
    alike = tiff(tmp_path / "c.tif", vertical=5703, keys=((4099, 0, 1, 9001),))
    assert warnings_of(alike) == ""
    feet = tiff(tmp_path / "d.tif", keys=((4099, 0, 1, 9002),))
    np.testing.assert_allclose(read(feet).heights, HEIGHTS * 0.3048, rtol=1e-6)
    assert warnings_of(feet) == ""


@pytest.mark.parametrize("nodata", [None, -1])
def test_blocks_that_are_not_written(tmp_path: Path, nodata: int | None) -> None:
    path = tmp_path / "a.tif"
    with rasterio.open(path, "w", driver="GTiff", height=64, width=64, count=1, dtype="float32", crs="EPSG:32611",
                       transform=UTM, tiled=True, blockxsize=32, blockysize=32, SPARSE_OK="TRUE",
                       nodata=nodata) as file:  # fmt: skip
        file.write(np.full((32, 32), 900, np.float32), 1, window=rasterio.windows.Window(0, 0, 32, 32))
    assert ("3 of its 4 blocks are not written" in warnings_of(path)) == (nodata is None)


def test_a_thumbnail_before_the_raster(tmp_path: Path) -> None:
    path = tiff(tmp_path / "a.tif", following=True)
    assert "number 2 has 10 × 6" in warnings_of(path)
    np.testing.assert_array_equal(read(f"GTIFF_DIR:2:{path}").heights, np.vstack([HEIGHTS, HEIGHTS]))


def test_overviews_and_masks_are_no_further_images(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK="YES"),
        rasterio.open(
            path, "w", driver="GTiff", height=64, width=64, count=1, dtype="float32", crs="EPSG:32611", transform=UTM
        ) as file,
    ):
        file.write(np.full((64, 64), 900, np.float32), 1)
        file.write_mask(np.eye(64) == 0)
        file.build_overviews([2, 4])
    assert warnings_of(path) == ""


@pytest.mark.parametrize(
    ("kind", "nodata", "said"),
    [("uint16", -9999, "stored as 55537"), ("uint8", 300, "stored as 44"), ("int16", 0.5, "(0.5) cannot occur"),
     ("int16", "-32769", "stored as 32767"), ("uint16", "9e99", "(9e99) cannot occur in uint16")],
)  # fmt: skip
def test_a_nodata_value_given_that_cannot_occur_is_told(tmp_path: Path, kind: str, nodata: object, said: str) -> None:
    path = tiff(tmp_path / "a.tif", kind=kind)
    with Source.open(path, nodata=nodata) as source:  # type: ignore[arg-type]
        assert "The nodata value that was given" in " ".join(source.warnings)
        assert said in " ".join(source.warnings)


@pytest.mark.parametrize(
    ("kind", "nodata"), [("uint16", 9999), ("float32", -9999.5), ("uint16", "none"), ("int16", -1)]
)
def test_a_nodata_value_given_that_can_occur_is_not(tmp_path: Path, kind: str, nodata: object) -> None:
    with Source.open(tiff(tmp_path / "a.tif", kind=kind), nodata=nodata) as source:  # type: ignore[arg-type]
        assert source.warnings == []
