"""GRIB 2: every message ends where it says, and the pictures in it (PNG, JPEG 2000) are intact.

The library behind GDAL's driver decodes as much of a packed picture as it can, and ignores PNG's checksums.

Source: WMO Manual on Codes, FM 92 GRIB edition 2 (sections 0, 5, 7 and 8).
"""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from orograph.dem.whole.jp2 import stream_fault
from orograph.dem.whole.png import bytes_fault

_JPEG2000, _PNG = (40, 40000), (41, 40010)
_LARGEST = 1 << 28
"""Bytes of a file up to which its packed data are checked."""


def fault(dataset: Any, path: str) -> str | None:
    """The fault of a GRIB file, as a sentence; None if there is none."""
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        at = file.read(1 << 16).find(b"GRIB")
        number = 0
        while 0 <= at < size:
            file.seek(at)
            head = file.read(16)
            if head[:4] != b"GRIB":
                rest = head + file.read(1 << 16)
                return (
                    f"It has bytes after message {number} that are not a message." if any(rest.strip(b"\r\n")) else None
                )
            if len(head) < 16 or head[7] != 2:
                return None
            (length,) = struct.unpack(">Q", head[8:])
            number += 1
            if at + length > size:
                return f"It ends after {size:,} bytes, within message {number}."
            if found := _message_fault(file, at + 16, at + length, size <= _LARGEST):
                return f"Message {number}: {found}"
            at += length
    return None


def _message_fault(file: IO[bytes], at: int, end: int, packed: bool) -> str | None:
    """The fault in the sections of a message between two bytes, as a sentence; None if there is none."""
    template = 0
    while at < end - 4:
        file.seek(at)
        head = file.read(11)
        length, section = struct.unpack(">IB", head[:5])
        if length < 5 or at + length > end - 4 or not 1 <= section <= 7:
            return f"its sections are inconsistent at byte {at:,}."
        if section == 5:
            (template,) = struct.unpack(">H", head[9:11])
        elif section == 7 and packed and length > 5 and template in (*_JPEG2000, *_PNG):
            file.seek(at + 5)
            data = file.read(length - 5)
            broken = bytes_fault(data) if template in _PNG else stream_fault(BytesIO(data), 0, len(data))
            if broken is not None:
                return broken
        at += length
    file.seek(end - 4)
    return None if file.read(4) == b"7777" else "it lacks its end marker (7777)."
