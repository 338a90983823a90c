"""What a GeoTIFF says of its numbers that GDAL reads as something else."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph.dem import read
from orograph.errors import ReadError

HEIGHTS = np.arange(30, dtype=np.float32).reshape(5, 6)


def tiff(path: Path, nodata: bytes = b"", vertical: int = 0) -> Path:
    """A GeoTIFF 1.0 of HEIGHTS, with this text as its nodata value and this vertical CRS."""
    place, data = struct.pack("<6d", 0, 0, 0, 500000, 4000000, 0), HEIGHTS.tobytes()
    codes = [1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32611] + ([4096, 0, 1, vertical] if vertical else [])
    keys = struct.pack(f"<{len(codes) + 4}H", 1, 1, 0, len(codes) // 4, *codes)
    values: list[tuple[int, int, int, bytes]] = [
        (256, 3, 1, struct.pack("<H", 6)), (257, 3, 1, struct.pack("<H", 5)), (258, 3, 1, struct.pack("<H", 32)),
        (259, 3, 1, struct.pack("<H", 1)), (262, 3, 1, struct.pack("<H", 1)), (273, 4, 1, struct.pack("<I", 8)),
        (277, 3, 1, struct.pack("<H", 1)), (278, 3, 1, struct.pack("<H", 5)),
        (279, 4, 1, struct.pack("<I", len(data))), (339, 3, 1, struct.pack("<H", 3)),
        (33550, 12, 3, struct.pack("<3d", 30, 30, 0)), (33922, 12, 6, place), (34735, 3, len(codes) + 4, keys),
    ]  # fmt: skip
    if nodata:
        values.append((42113, 2, len(nodata), nodata))
    out = bytearray(b"II*\0\0\0\0\0" + data)
    entries = b""
    for tag, kind, count, value in values:
        if len(value) > 4:
            entries += struct.pack("<HHII", tag, kind, count, len(out))
            out += value + b"\0" * (len(value) % 2)
        else:
            entries += struct.pack("<HHI", tag, kind, count) + value.ljust(4, b"\0")
    out[4:8] = struct.pack("<I", len(out))
    path.write_bytes(out + struct.pack("<H", len(values)) + entries + bytes(4))
    return path


@pytest.mark.parametrize("text", ["abc", "0x270f", "-9,999", "\u22129999", "5abc"])
def test_a_nodata_value_that_is_no_number(tmp_path: Path, text: str) -> None:
    path = tiff(tmp_path / "a.tif", text.encode() + b"\0")
    with pytest.raises(ReadError, match="is no number"):
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
    with pytest.raises(ReadError, match="tells none apart"):
        read(path)
