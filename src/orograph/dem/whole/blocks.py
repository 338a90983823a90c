"""GeoTIFFs: each block decodes to its own size and ends where its data end.

libtiff stops as soon as a block is full. A damaged stream that happens to yield more than the block holds is thus
accepted, its Adler-32 (Deflate, RFC 1950) is never read, and the end of the block may be uninitialised memory; LZW and
PackBits streams that yield too little leave the rest unchanged. Here, every block of these codecs (and of Zstandard) is
decoded once more before its samples are used, once per file and process. Cloud-optimised files store each block's
length before it and repeat its last bytes after it; these are compared for every codec.
"""

from __future__ import annotations

import threading
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO, Any

import numpy as np

from orograph.dem.whole.files import DAMAGED, OPENING, archived, main_file, stream
from orograph.errors import ReadError

_FILES = 256
_sound: OrderedDict[object, bytearray] = OrderedDict()
_lock = threading.Lock()


def check_blocks(dataset: Any, key: object, band: int, window: tuple[int, int, int, int], step: int = 1) -> None:
    """Raise ReadError if a block of a GeoTIFF that holds samples of a window is damaged.

    Args:
        dataset: of rasterio, open.
        key: the file's name and state.
        band: of the samples, from 1.
        window: top, left, height, width; of which every ``step``-th row is wanted.
    """
    name = main_file(dataset)
    if dataset.driver != "GTiff" or archived(name) or not Path(name).is_file():
        return
    codec, guarded = _compression(dataset), _guarded(dataset)
    if codec not in CODECS and not codec.endswith("JPEG") and not guarded:
        return
    top, left, height, width = window
    high, wide = dataset.block_shapes[band - 1]
    down, across = -(-dataset.height // high), -(-dataset.width // wide)
    plane = 0 if _together(dataset) > 1 else band - 1
    sound = _sound_blocks(key, dataset.count * down * across)
    with Path(name).open("rb") as file:
        for row in _block_rows(top, height, high, step):
            for col in range(left // wide, (left + width - 1) // wide + 1):
                index = (plane * down + row) * across + col
                if not sound[index]:
                    _check(dataset, file, plane + 1, row, col, codec, guarded)
                    sound[index] = 1


def _block_rows(top: int, height: int, high: int, step: int) -> Iterable[int]:
    """The rows of blocks in which every ``step``-th row of a window lies."""
    if step <= high:
        return range(top // high, (top + height - 1) // high + 1)
    return (row // high for row in range(top, top + height, step))


def check_archived(dataset: Any) -> None:
    """Raise ReadError if any block of a GeoTIFF in an archive is damaged: all at once, in the order of the file."""
    codec, guarded = _compression(dataset), _guarded(dataset)
    if codec not in CODECS and not codec.endswith("JPEG") and not guarded:
        return
    high, wide = dataset.block_shapes[0]
    blocks = [
        (int(place[0]), band, row, col)
        for band in range(1, (1 if _together(dataset) > 1 else dataset.count) + 1)
        for row in range(-(-dataset.height // high))
        for col in range(-(-dataset.width // wide))
        if (place := _place(dataset, band, row, col))
    ]
    with stream(main_file(dataset)) as file:
        for _, band, row, col in sorted(blocks):
            _check(dataset, file, band, row, col, codec, guarded)


def _compression(dataset: Any) -> str:
    return str(dataset.tags(ns="IMAGE_STRUCTURE").get("COMPRESSION", ""))


def _guarded(dataset: Any) -> bool:
    """Whether each block has its length before it and its last four bytes repeated after it, as in GDAL's COGs."""
    name = main_file(dataset)
    try:
        with Path(name).open("rb") if not archived(name) else stream(name) as file:
            head = file.read(1024)
    except OSError:
        return False
    at = 16 if head[2:3] == b"+" or head[3:4] == b"+" else 8
    notes = head[at : at + 512]
    return (
        notes.startswith(b"GDAL_STRUCTURAL_METADATA_SIZE=")
        and b"BLOCK_LEADER=SIZE_AS_UINT4" in notes
        and b"BLOCK_TRAILER=LAST_4_BYTES_REPEATED" in notes
        and b"KNOWN_INCOMPATIBLE_EDITION=NO" in notes
    )


def _sound_blocks(key: object, count: int) -> bytearray:
    """The blocks of a file that passed the check."""
    with _lock:
        if key not in _sound or len(_sound[key]) < count:
            _sound[key] = bytearray(count)
        _sound.move_to_end(key)
        while len(_sound) > _FILES:
            _sound.popitem(last=False)
        return _sound[key]


def _check(dataset: Any, file: IO[bytes], band: int, row: int, col: int, codec: str, guarded: bool) -> None:
    """Raise ReadError unless a block's data end with it and hold what it needs."""
    place = _place(dataset, band, row, col)
    if place is None:
        return
    file.seek(place[0] - 4 if guarded else place[0])
    data = file.read(place[1] + 8 if guarded else place[1])
    cause = None
    if guarded:
        before, data, after = data[:4], data[4:-4], data[-4:]
        if int.from_bytes(before, "little") != place[1] or after != data[-4:]:
            cause = "the guard bytes before and after it do not match"
    if cause is None and codec.endswith("JPEG"):
        cause = _jpeg(dataset, data, band)
    elif cause is None and codec in CODECS:
        least, most = _bytes_held(dataset, band, row)
        cause = CODECS[codec](data, least, most)
    if cause is not None:
        high, wide = dataset.block_shapes[band - 1]
        raise ReadError(
            f"The block of rows {row * high}–{row * high + high - 1}, columns {col * wide}–{col * wide + wide - 1} "
            f"cannot be read: {cause}.",
            path=dataset.name,
            remedy=DAMAGED,
        )


def _deflate(data: bytes, least: int, most: int) -> str | None:
    inflate = zlib.decompressobj()
    try:
        made = len(inflate.decompress(data))
    except zlib.error:
        made = -1
    return None if inflate.eof and made in (least, most) else "its Deflate stream is damaged"


def _lzw(data: bytes, least: int, most: int) -> str | None:
    from orograph.dem.whole.kernels import lzw_length

    if data[:1] == b"\0" and data[1:2] and data[1] & 1:  # from before TIFF 6.0: the other bit order
        return None
    made, ended = lzw_length(np.frombuffer(data, np.uint8), most)
    return None if ended and made in (least, most) else "its LZW stream is damaged"


def _packed(data: bytes, least: int, most: int) -> str | None:
    from orograph.dem.whole.kernels import packed_length

    made = packed_length(np.frombuffer(data, np.uint8), most)
    return None if made in (least, most) else "its PackBits runs do not fill the block"


def _zstandard(data: bytes, least: int, most: int) -> str | None:
    from orograph._blosc import zstandard

    end = _frame_end(data)
    try:
        made = len(zstandard.decode(data[:end])) if end else -1
    except (RuntimeError, ValueError):
        made = -1
    return None if made in (least, most) else "its Zstandard frame is damaged"


def _jpeg(dataset: Any, data: bytes, band: int) -> str | None:
    """The fault of a JPEG block, whose tables are stored once for all blocks.

    libtiff continues where libjpeg warns. So the block is decoded as a separate file, for which GDAL treats warnings as
    errors (``handles``).
    """
    from rasterio.errors import RasterioError
    from rasterio.io import MemoryFile

    if dataset.dtypes[band - 1] != "uint8":
        return None  # 12 bits, which GDAL's JPEG driver may not support
    tables = bytes.fromhex(dataset.get_tag_item("JPEGTABLES", "TIFF", bidx=band) or "")
    whole = tables[:-2] + data[2:] if tables else data
    try:
        with OPENING, MemoryFile(whole, ext=".jpg") as file, file.open(driver="JPEG") as block:
            block.read()
            wide = block.width
    except (RasterioError, OSError, ValueError):
        wide = 0
    return None if wide == dataset.block_shapes[band - 1][1] else "its JPEG stream is damaged"


def _frame_end(data: bytes) -> int:
    """Where a Zstandard frame ends (RFC 8878, section 3.1.1); 0 if it does not."""
    if data[:4] != b"\x28\xb5\x2f\xfd" or len(data) < 6:
        return 0
    kind = data[4]
    single = kind >> 5 & 1
    at = 5 + (1 - single) + (0, 1, 2, 4)[kind & 3] + ((1, 2, 4, 8) if single else (0, 2, 4, 8))[kind >> 6]
    while at + 3 <= len(data):
        block = int.from_bytes(data[at : at + 3], "little")
        at += 3 + (1 if block >> 1 & 3 == 1 else block >> 3)
        if block & 1:
            at += 4 * (kind >> 2 & 1)
            return at if at <= len(data) else 0
    return 0


CODECS: dict[str, Callable[[bytes, int, int], str | None]] = {
    "DEFLATE": _deflate, "LZW": _lzw, "PACKBITS": _packed, "ZSTD": _zstandard,
}  # fmt: skip
"""Codec → a function to a block's fault, or None. It takes its data and its bytes without and with rows beyond the
raster."""


def _place(dataset: Any, band: int, row: int, col: int) -> tuple[int, int] | None:
    """Offset and size of a block in the file; None if a sparse file leaves it out."""
    offset = dataset.get_tag_item(f"BLOCK_OFFSET_{col}_{row}", "TIFF", bidx=band)
    size = dataset.get_tag_item(f"BLOCK_SIZE_{col}_{row}", "TIFF", bidx=band)
    return (int(offset), int(size)) if offset and size else None


def _together(dataset: Any) -> int:
    """The number of bands in a block."""
    from rasterio.enums import Interleaving

    return dataset.count if dataset.interleaving == Interleaving.pixel else 1


def _bytes_held(dataset: Any, band: int, row: int) -> tuple[int, int]:
    """Bytes of the block's rows within the raster (the last block may end with them), and of all its rows."""
    high, wide = dataset.block_shapes[band - 1]
    bits = dataset.tags(band, ns="IMAGE_STRUCTURE").get("NBITS")
    sample = int(bits) if bits else 8 * np.dtype(dataset.dtypes[band - 1]).itemsize
    rows = min(high, dataset.height - row * high)
    line = -(-wide * _together(dataset) * sample // 8)
    return int(rows * line), int(high * line)
