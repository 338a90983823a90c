"""GeoTIFFs: bytes put in, damaged tables, streams that do not fill their block; and odd ones that are sound."""

from __future__ import annotations

import struct
import tarfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from PIL import Image
from rasterio.shutil import copy

from orograph.dem import read
from orograph.errors import ReadError

ROWS, COLS, STRIP = 61, 83, 16
CODECS = ["none", "lzw", "deflate", "zstd", "packbits"]


def hill() -> np.ndarray:
    row, col = np.mgrid[:ROWS, :COLS]
    return (900 + 300 * np.sin(col / 9) * np.cos(row / 7) + (row * 7 + col * 13) % 11).astype(np.int16)


def made(path: Path, heights: np.ndarray | None = None, **more: object) -> Path:
    heights = hill() if heights is None else heights
    bands = heights.reshape(-1, *heights.shape[-2:])
    profile = {"driver": "GTiff", "height": bands.shape[1], "width": bands.shape[2], "count": len(bands),
               "dtype": heights.dtype.name, "crs": "EPSG:32611",
               "transform": Affine(30, 0, 500_000, 0, -30, 4_000_000)}  # fmt: skip
    with rasterio.open(path, "w", **{**profile, **more}) as file:
        file.write(bands)
    return path


def by_hand(
    path: Path,
    pad: bool = False,
    extra: int = 0,
    code: int = 1,
    pack: Callable[[bytes], bytes] = bytes,
    behind: bytes = b"",
) -> Path:
    """A TIFF of strips as other writers make them.

    Args:
        pad: the last strip is as long as the others.
        extra: entries more in the tables of strips than there are strips.
    """
    strips = [hill()[i : i + STRIP].tobytes() for i in range(0, ROWS, STRIP)]
    strips[-1] = strips[-1].ljust(len(strips[0]), b"\0") if pad else strips[-1]
    packed = [pack(strip) for strip in strips]
    count = len(packed) + extra
    tables = 8 + 2 + 10 * 12 + 4
    begin = tables + 8 * count
    places = [begin + sum(map(len, packed[:i])) for i in range(len(packed))] + [0xFFFFFFF0] * extra
    short = [(256, COLS), (257, ROWS), (258, 16), (259, code), (262, 1), (277, 1), (278, STRIP), (339, 2)]
    entries = [(tag, struct.pack("<HHIHH", tag, 3, 1, value, 0)) for tag, value in short]
    entries += [
        (273, struct.pack("<HHII", 273, 4, count, tables)),
        (279, struct.pack("<HHII", 279, 4, count, tables + 4 * count)),
    ]
    sizes = [*map(len, packed), *[77] * extra]
    path.write_bytes(
        b"II*\0" + struct.pack("<IH", 8, 10) + b"".join(entry for _, entry in sorted(entries)) + bytes(4)
        + struct.pack(f"<{2 * count}I", *places, *sizes) + b"".join(packed) + behind
    )  # fmt: skip
    return path


ODD: dict[str, dict[str, object]] = {
    "plain": {}, "padded": {"pad": True}, "extra": {"extra": 2}, "padded, extra": {"pad": True, "extra": 1},
    "deflate": {"code": 8, "pack": zlib.compress}, "deflate, padded": {"code": 8, "pack": zlib.compress, "pad": True},
    "deflate, longer": {"code": 8, "pack": lambda data: zlib.compress(data) + b"\0\0"},
}  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_odd_files_of_other_writers(tmp_path: Path, name: str) -> None:
    path = by_hand(tmp_path / "a.tif", **ODD[name])  # type: ignore[arg-type]
    np.testing.assert_array_equal(read(path).heights, hill())


@pytest.mark.parametrize("codec", ["raw", "tiff_lzw", "packbits", "tiff_adobe_deflate"])
def test_files_of_pillow(tmp_path: Path, codec: str) -> None:
    Image.fromarray(hill().astype(np.uint16)).save(tmp_path / "a.tif", compression=codec)
    np.testing.assert_array_equal(read(tmp_path / "a.tif").heights, hill())


@pytest.mark.parametrize("codec", CODECS)
def test_files_that_were_written_over(tmp_path: Path, codec: str) -> None:
    """They have gaps, and directories behind the samples."""
    path = made(tmp_path / "a.tif", np.zeros_like(hill()), compress=codec, blockysize=STRIP)
    with rasterio.open(path, "r+") as file:
        file.write(hill()[:20, :20], 1, window=((0, 20), (0, 20)))
        file.update_tags(A="x" * 5000)
    with rasterio.open(path, "r+") as file:
        file.write(hill(), 1)
        file.build_overviews([2, 4])
    np.testing.assert_array_equal(read(path).heights, hill())
    if codec != "packbits":
        copy(str(path), str(tmp_path / "cog.tif"), driver="COG", COMPRESS=codec.upper(), BLOCKSIZE="128")
        np.testing.assert_array_equal(read(tmp_path / "cog.tif").heights, hill())
        with rasterio.open(tmp_path / "cog.tif", "r+", IGNORE_COG_LAYOUT_BREAK="YES") as file:
            file.write(hill()[::-1], 1)
        np.testing.assert_array_equal(read(tmp_path / "cog.tif").heights, hill()[::-1])


@pytest.mark.parametrize("codec", CODECS)
def test_layouts_of_bands_and_bits(tmp_path: Path, codec: str) -> None:
    several = np.stack([hill(), hill() + 1, hill() + 2])
    for interleave in ("band", "pixel"):
        path = made(tmp_path / f"{interleave}.tif", several, compress=codec, interleave=interleave)
        np.testing.assert_array_equal(read(path, band=2).heights, several[1])
    for bits in (1, 11):
        values = (hill() % 2**bits).astype(np.uint8 if bits == 1 else np.uint16)
        path = made(tmp_path / f"{bits}.tif", values, compress=codec, nbits=bits)
        np.testing.assert_array_equal(read(path).heights, values)
    path = made(tmp_path / "rows.tif", compress=codec, blockysize=1, bigtiff="YES", endianness="BIG")
    np.testing.assert_array_equal(read(path).heights, hill())


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("tiled", [False, True])
def test_bytes_put_in_are_noticed(tmp_path: Path, codec: str, tiled: bool) -> None:
    shape = {"tiled": True, "blockxsize": 32, "blockysize": 32} if tiled else {"blockysize": STRIP}
    path = made(tmp_path / "a.tif", compress=codec, **shape)
    data = path.read_bytes()
    for at, put in ((len(data) // 2, b"\x03"), (len(data) * 3 // 4, b"\x11\x12"), (len(data) // 3, bytes(100))):
        path.write_bytes(data[:at] + put + data[at:])
        with pytest.raises(ReadError, match=r"a\.tif"):
            read(path)


def test_bytes_put_into_a_cloud_optimised_file(tmp_path: Path) -> None:
    large = np.tile(hill(), (6, 6))
    copy(
        str(made(tmp_path / "a.tif", large)), str(tmp_path / "cog.tif"), driver="COG", COMPRESS="NONE", BLOCKSIZE="128"
    )
    path = tmp_path / "cog.tif"
    np.testing.assert_array_equal(read(path).heights, large)
    data = path.read_bytes()
    at = len(data) * 2 // 3
    for mutant in (data[:at] + b"\1\2" + data[at + 1 :], data[:at] + data[at + 2 :] + b"\1\2"):
        path.write_bytes(mutant)
        with pytest.raises(ReadError, match=r"cog\.tif"):
            read(path)


def test_a_table_of_blocks_that_overlap(tmp_path: Path) -> None:
    path = by_hand(tmp_path / "a.tif")
    data = bytearray(path.read_bytes())
    data[134 + 4] ^= 64  # the second strip's place
    path.write_bytes(data)
    with pytest.raises(ReadError, match="overlap"):
        read(path)


def test_a_mask_behind_a_broken_link(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(made(path), "r+") as file:
        file.write_mask((hill() > 900).astype(np.uint8) * 255)
    assert np.isnan(read(path).heights).any()
    data = bytearray(path.read_bytes())
    (first,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, first)
    link = first + 2 + 12 * count
    assert struct.unpack_from("<I", data, link) != (0,)
    data[link + 2] ^= 255
    path.write_bytes(data)
    with pytest.raises(ReadError, match=r"director(y|ies)"):
        read(path)


@pytest.mark.parametrize("codec", ["lzw", "packbits", "zstd", "deflate"])
def test_a_stream_that_does_not_fill_its_block(tmp_path: Path, codec: str) -> None:
    """Of a stream of another block libtiff takes as much as it needs, or leaves the rest as it was."""
    path = made(tmp_path / "a.tif", compress=codec, blockysize=STRIP)
    other = made(tmp_path / "b.tif", np.tile(hill(), (2, 1)), compress=codec, blockysize=2 * STRIP)
    with rasterio.open(path) as file, rasterio.open(other) as longer:
        place, size = (int(file.get_tag_item(f"BLOCK_{what}_0_1", "TIFF", bidx=1)) for what in ("OFFSET", "SIZE"))
        begin = int(longer.get_tag_item("BLOCK_OFFSET_0_0", "TIFF", bidx=1))
    data = path.read_bytes()
    stream = other.read_bytes()[begin : begin + size]
    path.write_bytes(data[:place] + stream + data[place + size :])
    with pytest.raises(ReadError, match="block of rows 16"):
        read(path)


def test_the_length_of_streams() -> None:
    from orograph.dem.whole.kernels import lzw_length, packed_length

    def lzw(*codes: int) -> np.ndarray:
        bits = "".join(f"{code:09b}" for code in codes)
        return np.frombuffer(
            int(bits.ljust(-(-len(bits) // 8) * 8, "0"), 2).to_bytes(-(-len(bits) // 8), "big"), np.uint8
        )

    assert lzw_length(lzw(256, 7, 258, 258, 257), 100) == (5, True)  # 7, 7 7, 7 7
    assert lzw_length(lzw(256, 7, 300, 257), 100) == (-1, False)  # a code that is not made yet
    assert lzw_length(lzw(256, 7, 8), 100)[0] == 2
    assert packed_length(np.array([2, 1, 2, 3, 254, 9, 128], np.uint8), 6) == 6
    assert packed_length(np.array([2, 1, 2], np.uint8), 6) == -1


@pytest.mark.parametrize("form", [tarfile.PAX_FORMAT, tarfile.GNU_FORMAT], ids=["PAX", "GNU"])
@pytest.mark.parametrize("ending", [".tar", ".tar.gz"])
@pytest.mark.parametrize("name", ["höhe.tif", "täler/höhe.tif", "x" * 120 + ".tif"])
def test_names_in_archives(tmp_path: Path, form: int, ending: str, name: str) -> None:
    plain = made(tmp_path / "plain.tif")
    path = tmp_path / f"a{ending}"
    with tarfile.open(path, "w:gz" if ending == ".tar.gz" else "w", format=form) as archive:
        archive.add(plain, name)
    np.testing.assert_array_equal(read(path).heights, hill())


def test_what_is_wrong_with_an_archive_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "a.tar"
    with tarfile.open(path, "w") as archive:
        archive.add(made(tmp_path / "plain.tif"), "a.tif")
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data)
    with pytest.raises(ReadError) as told:
        read(path)
    assert "\n" not in str(told.value)
