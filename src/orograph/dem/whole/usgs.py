"""USGS DEMs: every profile says which one it is, and the least and the greatest of its heights.

GDAL looks at neither, so that a digit that was altered or a profile in another's place is a height like others. Some
writers leave these fields empty or fill them otherwise: they count where nearly all profiles keep to them.

Source: Standards for Digital Elevation Models, part 2 (USGS, 1998), records A and B.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_RECORD, _FIRST, _WIDTH = 1024, 146, 6  # bytes of a record; heights in a profile's first one; characters of a height
_FULL = (_RECORD - 4) // _WIDTH
_LARGEST = 64 << 20
_VOID = -32767
_SHARE = 0.9
_NUMBER = re.compile(rb" *[+-]?(?:\d+\.?\d*|\.\d+)(?:[DE][+-]?\d+)? *\Z", re.I)


def fault(dataset: Any, path: str) -> str | None:
    """What is wrong with a USGS DEM, a sentence; None: nothing."""
    if Path(path).stat().st_size > _LARGEST:
        return None
    data = _without_line_ends(Path(path).read_bytes())
    if not all(_NUMBER.match(data[at : at + 12]) for at in (816, 828)):
        return "Its first record does not say how far its samples lie apart."
    try:
        wrong, count = _odd_profiles(data)
    except (ValueError, OverflowError):
        return None  # records laid out otherwise, which GDAL may know
    if not wrong or len(wrong) > (1 - _SHARE) * count:
        return None
    return f"Its profile {wrong[0] + 1} of {count} contradicts what it says of itself: its number, least or greatest."


def _without_line_ends(data: bytes) -> bytes:
    """Records without what some writers put behind each."""
    lines = data.splitlines()
    return b"".join(lines) if all(len(line) == _RECORD for line in lines[:-1]) else data


def _odd_profiles(data: bytes) -> tuple[list[int], int]:
    """Which profiles contradict themselves, from 0, and how many there are.

    Raises:
        ValueError: records are laid out otherwise.
    """
    count, step = int(data[858:864]), float(data[840:852].replace(b"D", b"E"))
    at, wrong = _RECORD, []
    for number in range(count):
        head = data[at : at + 144].replace(b"D", b"E")
        column, rows = int(head[6:12]), int(head[12:18])
        datum, least, greatest = (float(head[24 * i : 24 * i + 24]) for i in (3, 4, 5))
        if rows < 1:
            raise ValueError("no profile")
        values, at = _heights(data, at, rows)
        values = values[values != _VOID]
        low, high = (float(v) * step + datum for v in (values.min(), values.max())) if values.size else (least, greatest)
        if column != number + 1 or max(abs(low - least), abs(high - greatest)) > 1e-6 * max(1.0, abs(high)):
            wrong.append(number)
    return wrong, count


def _heights(data: bytes, at: int, rows: int) -> tuple[NDArray[np.int64], int]:
    """The heights of a profile whose first record begins at a byte, and where the next one begins."""
    pieces = [data[at + 144 : at + 144 + _WIDTH * min(rows, _FIRST)]]
    at, left = at + _RECORD, rows - _FIRST
    while left > 0:
        pieces.append(data[at : at + _WIDTH * min(left, _FULL)])
        at, left = at + _RECORD, left - _FULL
    text = b"".join(pieces)
    if len(text) != _WIDTH * rows:
        raise ValueError("cut short")
    return np.frombuffer(text, f"S{_WIDTH}").astype(np.int64), at
