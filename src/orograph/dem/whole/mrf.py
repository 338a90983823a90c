"""MRF: each tile of the raster lies in the tile file, and decodes to the size of a tile.

For GDAL, a tile that does not decode is uninitialised memory, and one that is not listed is 0. The index (.idx) lists
the offset and size of each tile, row by row; Deflate has its own checksum.

Source: the MRF specification (NASA GIBS), as GDAL's frmts/mrf documents it.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
import zlib
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from orograph.dem.whole import png, tiff

_ENDINGS = {
    "PNG": ".ppg", "PPNG": ".ppg", "JPEG": ".pjg", "JPNG": ".pjp", "NONE": ".til", "DEFLATE": ".pzp", "TIF": ".ptf",
    "LERC": ".lrc", "ZSTD": ".pzs",
}  # fmt: skip


def fault(dataset: Any, path: str) -> str | None:
    """The fault of an MRF, as a sentence; None if there is none."""
    root = ET.fromstring(Path(path).read_bytes())
    raster = root.find("Raster")
    if raster is None:
        return "Its header has no raster."
    if root.find("CachedSource") is not None:
        return "It caches parts of another raster, which may be missing."
    codec = (raster.findtext("Compression") or "PNG").strip().upper()
    wide, high, deep = _shape(raster, "PageSize", (512, 512, 1))
    cols, rows, bands = _shape(raster, "Size", (0, 0, 1))
    if (cols, rows, bands) != (dataset.width, dataset.height, dataset.count) or min(wide, high, deep) < 1:
        return "Its header contradicts itself."
    index = _beside(path, raster.findtext("IndexFile"), ".idx")
    tiles = _beside(path, raster.findtext("DataFile"), _ENDINGS.get(codec, ""))
    if index is None or tiles is None:
        return "Its index or its tile file is missing."
    count = -(-cols // wide) * -(-rows // high) * -(-bands // deep)
    listed = np.fromfile(index, ">u8").reshape(-1) if index.stat().st_size % 16 == 0 else np.zeros(0, ">u8")
    if listed.size < 2 * count:
        return f"Its index lists {listed.size // 2:,} of {count:,} tiles, or is damaged."
    if fault := _extent_fault(root):
        return fault
    item = np.dtype(dataset.dtypes[0]).itemsize
    entries = [(int(at), int(length)) for at, length in listed.reshape(-1, 2)]
    return _tiles_fault(tiles, entries, count, codec, (wide, high, wide * high * deep * item))


def _shape(raster: ET.Element, name: str, else_: tuple[int, int, int]) -> tuple[int, int, int]:
    element = raster.find(name)
    if element is None:
        return else_
    x, y, c = (int(element.get(axis, value)) for axis, value in zip("xyc", else_, strict=True))
    return x, y, c


def _beside(path: str, name: str | None, ending: str) -> Path | None:
    """A file that the header names, or a companion of the same name."""
    file = Path(path).with_suffix(ending) if name is None or not name.strip() else Path(path).parent / name.strip()
    return file if file.is_file() else None


def _extent_fault(root: ET.Element) -> str | None:
    box = root.find("GeoTags/BoundingBox")
    if box is None:
        return None
    west, south, east, north = (float(box.get(side, "nan")) for side in ("minx", "miny", "maxx", "maxy"))
    return None if west < east and south < north else "Its header contradicts itself about where it lies."


def _tiles_fault(
    tiles: Path, listed: list[tuple[int, int]], count: int, codec: str, shape: tuple[int, int, int]
) -> str | None:
    """The fault in the tiles; None if there is none.

    Takes the offset and size of each, how many the raster itself has, and a tile's columns, rows and bytes.
    """
    wide, high, wanted = shape
    size = tiles.stat().st_size
    there = [(at, length) for at, length in listed if length]
    end = max((at + length for at, length in there), default=0)
    if end > size:
        return f"Its tile file ends after {size:,} of the {end:,} bytes that its index promises."
    ordered = sorted(set(there))
    if any(at + length > after for (at, length), (after, _) in pairwise(ordered)):
        return "Its tiles overlap: its index is damaged."
    if len(there) < len(listed) and sum(length for _, length in ordered) < size:
        return "Its index lacks tiles, and its tile file has bytes that belong to none."
    if codec == "NONE" and (size > end or any(length != wanted for _, length in there)):
        return "Its tile file does not have the size that its index declares."
    with tiles.open("rb") as file:
        for number, (at, length) in enumerate(listed[:count]):
            file.seek(at)
            if length and not _decodes(file.read(length), codec, wide, high, wanted):
                return f"Its tile {number} cannot be decoded."
    return None


def _decodes(data: bytes, codec: str, wide: int, high: int, wanted: int) -> bool:
    """Whether a tile has the required size, as far as its codec tells."""
    if codec in ("DEFLATE", "ZSTD"):
        return _length(data, codec) == wanted
    if codec in ("PNG", "PPNG"):
        return png.bytes_fault(data) is None and struct.unpack_from(">II", data, 16) == (wide, high)
    if codec == "TIF":
        return tiff.tile_fault(data, wide, high) is None
    return True


def _length(data: bytes, codec: str) -> int:
    """The decoded bytes of a tile; -1 if it does not decode."""
    if codec == "ZSTD":
        from orograph._blosc import zstandard

        try:
            return len(zstandard.decode(data))
        except (RuntimeError, ValueError):
            return -1
    for window in (47, -15):  # zlib's or gzip's, or without a header
        inflate = zlib.decompressobj(window)
        try:
            made = len(inflate.decompress(data))
        except zlib.error:
            continue
        if inflate.eof and not inflate.unused_data:
            return made
    return -1
