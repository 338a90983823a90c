"""MRF: each tile of the raster lies in the file of tiles, and decodes to as many bytes as a tile has.

A tile that does not decode is uninitialised memory to GDAL, one that is not listed is 0. The index (.idx) lists the
offset and size of each tile, in the order of rows; Deflate has its own checksum.

Source: the MRF specification (NASA GIBS), as GDAL's frmts/mrf documents it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
import zlib
from pathlib import Path
from typing import Any

import numpy as np

_ENDINGS = {
    "PNG": ".ppg", "PPNG": ".ppg", "JPEG": ".pjg", "JPNG": ".pjp", "NONE": ".til", "DEFLATE": ".pzp", "TIF": ".ptf",
    "LERC": ".lrc", "ZSTD": ".pzs",
}  # fmt: skip


def fault(dataset: Any, path: str) -> str | None:
    """What is wrong with an MRF, a sentence; None: nothing."""
    root = ET.fromstring(Path(path).read_bytes())
    raster = root.find("Raster")
    if raster is None:
        return "Its header has no raster."
    if root.find("CachedSource") is not None:
        return "It keeps parts of another raster, which may be lost."
    codec = (raster.findtext("Compression") or "PNG").strip().upper()
    wide, high, deep = _shape(raster, "PageSize", (512, 512, 1))
    cols, rows, bands = _shape(raster, "Size", (0, 0, 1))
    if (cols, rows, bands) != (dataset.width, dataset.height, dataset.count) or min(wide, high, deep) < 1:
        return "Its header contradicts itself."
    index = _beside(path, raster.findtext("IndexFile"), ".idx")
    tiles = _beside(path, raster.findtext("DataFile"), _ENDINGS.get(codec, ""))
    if index is None or tiles is None:
        return "Its index or its file of tiles is not there."
    count = -(-cols // wide) * -(-rows // high) * -(-bands // deep)
    listed = np.fromfile(index, ">u8", 2 * count)
    if listed.size < 2 * count or index.stat().st_size % 16:
        return f"Its index lists {listed.size // 2:,} of {count:,} tiles, or is damaged."
    item = np.dtype(dataset.dtypes[0]).itemsize
    return _tiles_fault(tiles, listed.reshape(-1, 2).astype(object), codec, wide * high * deep * item)


def _shape(raster: ET.Element, name: str, else_: tuple[int, int, int]) -> tuple[int, int, int]:
    element = raster.find(name)
    if element is None:
        return else_
    x, y, c = (int(element.get(axis, value)) for axis, value in zip("xyc", else_, strict=True))
    return x, y, c


def _beside(path: str, name: str | None, ending: str) -> Path | None:
    """A file that the header names, or that is called after it."""
    file = Path(path).with_suffix(ending) if name is None or not name.strip() else Path(path).parent / name.strip()
    return file if file.is_file() else None


def _tiles_fault(tiles: Path, listed: Any, codec: str, wanted: int) -> str | None:
    size = tiles.stat().st_size
    there = [(int(at), int(length)) for at, length in listed if length]
    end = max((at + length for at, length in there), default=0)
    if end > size:
        return f"Its file of tiles ends after {size:,} of the {end:,} bytes that its index promises."
    if len(there) < len(listed) and there:
        return f"Its index lacks {len(listed) - len(there):,} of {len(listed):,} tiles."
    ordered = sorted(set(there))
    if any(at + length > after for (at, length), (after, _) in zip(ordered, ordered[1:], strict=False)):
        return "Its tiles overlap one another: its index is damaged."
    if codec == "NONE" and (size > end or any(length != wanted for _, length in there)):
        return "Its file of tiles does not have the size that its index says."
    if codec not in ("DEFLATE", "ZSTD"):
        return None
    with tiles.open("rb") as file:
        for number, (at, length) in enumerate(there):
            file.seek(at)
            if _length(file.read(length), codec) != wanted:
                return f"Its tile {number} does not decode."
    return None


def _length(data: bytes, codec: str) -> int:
    """How many bytes a tile decodes to; -1 if it does not."""
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
