"""What a further attack with mutants found GDAL to read past: tables and directories of TIFFs, lengths, texts."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from orograph.dem import read
from orograph.errors import ReadError

from .test_tiff_layout import by_hand
from .test_whole import UTM, hill
from .test_whole import made as copied
from .test_whole_more import entry

COLS, ROWS = 83, 61


def put(path: Path, at: int, data: bytes) -> None:
    """Overwrite bytes of a file."""
    there = path.read_bytes()
    path.write_bytes(there[:at] + data + there[at + len(data) :])


def refused(path: Path, said: str) -> None:
    with pytest.raises(ReadError, match=said) as told:
        read(path)
    assert path.name in str(told.value) and told.value.remedy


@pytest.mark.parametrize("tag", [273, 279])
def test_tables_of_unequal_length(tmp_path: Path, tag: int) -> None:
    path = by_hand(tmp_path / "a.tif")
    put(path, entry(path, tag) + 4, struct.pack("<I", 3))
    refused(path, "places of|sizes of")


def test_bytes_that_lack_before_a_strip_that_is_filled_up(tmp_path: Path) -> None:
    """They shift all samples behind them, and the end of the file lies in what fills the last strip."""
    path = by_hand(tmp_path / "a.tif", pad=True)
    np.testing.assert_array_equal(read(path).heights, hill_of_tiff())
    data = path.read_bytes()
    path.write_bytes(data[:3000] + data[3003:])
    refused(path, "3 bytes before its last part")
    unfilled = len(data) - (64 - ROWS) * COLS * 2
    path.write_bytes(data[:unfilled])  # as writers do that leave the filling out
    np.testing.assert_array_equal(read(path).heights, hill_of_tiff())


def hill_of_tiff() -> np.ndarray:
    from .test_tiff_layout import hill as other

    return other().astype(np.float32)


@pytest.mark.parametrize("compress", [None, "deflate", "lzw"])
@pytest.mark.parametrize("bigtiff", ["NO", "YES"])
def test_a_mask_that_no_directory_leads_to(tmp_path: Path, compress: str | None, bigtiff: str) -> None:
    path = tmp_path / "a.tif"
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(
        path, "w", driver="GTiff", height=ROWS, width=COLS, count=1, dtype="int16", crs="EPSG:32611", transform=UTM,
        BIGTIFF=bigtiff, **({"compress": compress} if compress else {}),
    ) as file:  # fmt: skip
        file.write(hill(), 1)
        file.write_mask((hill() > 900).astype(np.uint8) * 255)
    assert np.isnan(read(path).heights).any()
    data = path.read_bytes()
    if bigtiff == "YES":
        (first,) = struct.unpack_from("<Q", data, 8)
        following = first + 8 + 20 * struct.unpack_from("<Q", data, first)[0]
    else:
        (first,) = struct.unpack_from("<I", data, 4)
        following = first + 2 + 12 * struct.unpack_from("<H", data, first)[0]
    assert any(data[following : following + 4])
    put(path, following, bytes(8 if bigtiff == "YES" else 4))
    refused(path, "mask")


def test_the_place_of_a_compressed_block_copied_from_another_of_its_size(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    rows = np.arange(ROWS * COLS, dtype=np.int16).reshape(ROWS, COLS)
    with rasterio.open(path, "w", driver="GTiff", height=ROWS, width=COLS, count=1, dtype="int16", blockysize=4,
                       compress="packbits", transform=UTM) as file:  # fmt: skip
        file.write(rows, 1)
    np.testing.assert_array_equal(read(path).heights, rows)
    data = path.read_bytes()
    count = struct.unpack_from("<I", data, entry(path, 279) + 4)[0]
    kind = struct.unpack_from("<H", data, entry(path, 279) + 2)[0]
    (places,), (sizes,) = (struct.unpack_from("<I", data, entry(path, tag) + 8) for tag in (273, 279))
    size = struct.unpack_from(f"<{count}{'H' if kind == 3 else 'I'}", data, sizes)
    twins = [(i, j) for i in range(count) for j in range(i) if size[i] == size[j]]
    i, j = twins[0]
    put(path, places + 4 * i, data[places + 4 * j : places + 4 * j + 4])
    refused(path, "twice")


@pytest.mark.parametrize("kind", ["one band", "colours in tiles", "four bands", "bands apart"])
def test_a_block_of_jpeg_that_libjpeg_only_warns_of(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.tif"
    bands = {"one band": 1, "colours in tiles": 3, "four bands": 4, "bands apart": 2}[kind]
    more: dict[str, object] = {"tiled": True, "blockxsize": 32, "blockysize": 32} if "tiles" in kind else {}
    more |= {"photometric": "ycbcr"} if bands == 3 else {}
    more |= {"interleave": "band" if "apart" in kind else "pixel"}
    with rasterio.open(path, "w", driver="GTiff", height=ROWS, width=COLS, count=bands, dtype="uint8",
                       compress="jpeg", transform=UTM, **more) as file:  # fmt: skip
        file.write(np.stack([hill("uint8")] * bands))
    assert read(path).heights.shape == (ROWS, COLS)
    data = bytearray(path.read_bytes())
    with rasterio.open(path) as file:
        place, size = (int(file.get_tag_item(f"BLOCK_{what}_0_0", "TIFF", bidx=1)) for what in ("OFFSET", "SIZE"))
    data[place + size // 2 : place + size // 2 + 2] = b"\xff\xd9"  # the mark of its end
    path.write_bytes(data)
    refused(path, "JPEG")


def test_a_jpeg_2000_whose_inner_box_has_no_length(tmp_path: Path) -> None:
    """GDAL goes round in it for ever."""
    path = copied(tmp_path / "made", "JP2OpenJPEG", "a.jp2", "uint8")
    data = path.read_bytes()
    put(path, data.index(b"colr") - 4, bytes(4))
    refused(path, "colr")


