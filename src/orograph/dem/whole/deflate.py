"""GeoTIFFs of Deflate: each block inflates to its own size and has its checksum (RFC 1950).

libtiff stops as soon as a block is full. A damaged stream that happens to yield more than the block holds is thus taken
for whole, its Adler-32 never read, and the end of the block may be uninitialised memory. Here every block is
inflated once more before its samples are used, once per file and process.
"""

from __future__ import annotations

import threading
import zlib
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

import numpy as np

from orograph.dem.whole.files import DAMAGED, archived, main_file, stream
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
    if not deflated(dataset) or archived(name) or not Path(name).is_file():
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
                    _check(dataset, file, plane + 1, row, col)
                    sound[index] = 1


def _block_rows(top: int, height: int, high: int, step: int) -> Iterable[int]:
    """The rows of blocks in which every ``step``-th row of a window lies."""
    if step <= high:
        return range(top // high, (top + height - 1) // high + 1)
    return (row // high for row in range(top, top + height, step))


def check_archived(dataset: Any) -> None:
    """Raise ReadError if any block of a GeoTIFF in an archive is damaged: all at once, in the order of the file."""
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
            _check(dataset, file, band, row, col)


def deflated(dataset: Any) -> bool:
    """Whether a dataset is a GeoTIFF of Deflate."""
    return bool(dataset.driver == "GTiff" and dataset.tags(ns="IMAGE_STRUCTURE").get("COMPRESSION") == "DEFLATE")


def _sound_blocks(key: object, count: int) -> bytearray:
    """Which blocks of a file were found sound."""
    with _lock:
        if key not in _sound or len(_sound[key]) < count:
            _sound[key] = bytearray(count)
        _sound.move_to_end(key)
        while len(_sound) > _FILES:
            _sound.popitem(last=False)
        return _sound[key]


def _check(dataset: Any, file: IO[bytes], band: int, row: int, col: int) -> None:
    """Raise ReadError unless a block's stream ends, has its checksum, and holds what the block needs."""
    place = _place(dataset, band, row, col)
    if place is None:
        return
    file.seek(place[0])
    inflate = zlib.decompressobj()
    try:
        made = len(inflate.decompress(file.read(place[1])))
    except zlib.error:
        made = -1
    if not inflate.eof or made < _least_bytes(dataset, band, row):
        high, wide = dataset.block_shapes[band - 1]
        raise ReadError(
            f"The block of rows {row * high}–{row * high + high - 1}, columns {col * wide}–{col * wide + wide - 1} "
            "cannot be read: its Deflate stream is damaged.",
            path=dataset.name,
            remedy=DAMAGED,
        )


def _place(dataset: Any, band: int, row: int, col: int) -> tuple[int, int] | None:
    """Offset and size of a block in the file; None if a sparse file leaves it out."""
    offset = dataset.get_tag_item(f"BLOCK_OFFSET_{col}_{row}", "TIFF", bidx=band)
    size = dataset.get_tag_item(f"BLOCK_SIZE_{col}_{row}", "TIFF", bidx=band)
    return (int(offset), int(size)) if offset and size else None


def _together(dataset: Any) -> int:
    """How many bands a block holds."""
    from rasterio.enums import Interleaving

    return dataset.count if dataset.interleaving == Interleaving.pixel else 1


def _least_bytes(dataset: Any, band: int, row: int) -> int:
    """Bytes of the block's rows that lie within the raster (a last strip may end with them)."""
    high, wide = dataset.block_shapes[band - 1]
    bits = dataset.tags(band, ns="IMAGE_STRUCTURE").get("NBITS")
    sample = int(bits) if bits else 8 * np.dtype(dataset.dtypes[band - 1]).itemsize
    rows = min(high, dataset.height - row * high)
    return int(rows * -(-wide * _together(dataset) * sample // 8))
