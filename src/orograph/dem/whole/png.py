"""PNG: every chunk is there with a correct checksum, and the image data inflate to the size in the header.

Source: Portable Network Graphics (W3C Recommendation, third edition), sections 5 (chunks), 8 (interlacing), 10 (zlib).
"""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from pathlib import Path
from typing import IO, Any

_MAGIC = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))  # Adam7


def fault(dataset: Any, path: str) -> str | None:
    """The fault of a PNG file, as a sentence; None if there is none."""
    with Path(path).open("rb") as file:
        return _fault(file)


def bytes_fault(data: bytes) -> str | None:
    """The fault in a PNG's bytes, as a sentence; None if there is none."""
    return _fault(BytesIO(data))


def _fault(file: IO[bytes]) -> str | None:
    if file.read(8) != _MAGIC:
        return "It does not begin as a PNG does."
    wanted, found, inflate = 0, 0, zlib.decompressobj()
    while True:
        head = file.read(8)
        if len(head) < 8:
            return f"It ends after {file.tell():,} bytes, before its last chunk (IEND)."
        length, kind = struct.unpack(">I4s", head)
        data, check = file.read(length), file.read(4)
        if len(check) < 4:
            return f"It ends within chunk {kind.decode('latin-1')!r}, after {file.tell():,} bytes."
        if zlib.crc32(kind + data) != int.from_bytes(check, "big"):
            return f"Its chunk {kind.decode('latin-1')!r} before byte {file.tell():,} fails its checksum."
        if kind == b"IHDR":
            wanted = _image_bytes(data)
        elif kind == b"IDAT" and not inflate.eof:
            try:
                found += _inflated(inflate, data)
            except zlib.error as error:
                return f"Its image data cannot be decoded ({error})."
        elif kind == b"IEND":
            break
    if found < wanted or not inflate.eof:
        return f"Its image data end after {found:,} of {wanted:,} bytes."
    return None


def _inflated(inflate: Any, data: bytes) -> int:
    """The inflated size of a piece of the stream, without keeping the data."""
    size = 0
    while data:
        size += len(inflate.decompress(data, 1 << 20))
        data = inflate.unconsumed_tail
    return size


def _image_bytes(header: bytes) -> int:
    """Bytes of the filtered rows of all passes."""
    width, height, depth, colour, _, _, interlace = struct.unpack(">IIBBBBB", header)
    bits = depth * _CHANNELS.get(colour, 1)
    size = 0
    for x, y, dx, dy in _PASSES if interlace else ((0, 0, 1, 1),):
        cols, rows = -(-(width - x) // dx), -(-(height - y) // dy)
        if cols > 0 and rows > 0:
            size += rows * (1 + (cols * bits + 7) // 8)
    return size
