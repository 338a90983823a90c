"""USGS DEMs: every profile states its number, and the lowest and highest of its heights.

GDAL checks neither, so an altered digit or a profile in the wrong place goes unnoticed. Some writers leave these fields
empty or use them differently, so they count only if nearly all profiles agree with them.

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
_CERTAIN = 8  # profiles to learn the layout of records from
_NUMBER = re.compile(rb" *[+-]?(?:\d+\.?\d*|\.\d+)(?:[DE][+-]?\d+)? *\Z", re.I)


def fault(dataset: Any, path: str) -> str | None:
    """The fault of a USGS DEM, as a sentence; None if there is none."""
    if Path(path).stat().st_size > _LARGEST:
        return None
    data = _without_line_ends(Path(path).read_bytes())
    if not all(_NUMBER.match(data[at : at + 12]) for at in (816, 828)):
        return "Its first record does not declare its sample spacing."
    count, misplaced, contradicted = _profiles(data)
    few = (1 - _SHARE) * count
    if min(misplaced, default=count) < _CERTAIN and len(misplaced) > few:
        return None  # another layout of records, which GDAL may know
    if len(contradicted) > few:
        contradicted = []  # it does not follow this rule
    first = min((*contradicted, *misplaced), default=None)
    if first is None:
        return None
    return f"Its profile {first + 1} of {count} contradicts its own number, minimum or maximum."


def _without_line_ends(data: bytes) -> bytes:
    """Records without the line ends that some writers add."""
    lines = data.splitlines()
    return b"".join(lines) if all(len(line) == _RECORD for line in lines[:-1]) else data


def _profiles(data: bytes) -> tuple[int, list[int], list[int]]:
    """The expected number of profiles; those out of place; and those whose heights contradict their fields; from 0."""
    at, misplaced, contradicted = _RECORD, list[int](), list[int]()
    try:
        count, step = int(data[858:864]), _decimal(data[840:852])
    except ValueError:
        return 0, [], []
    for number in range(count):
        head = data[at : at + 144]
        try:
            column, rows = int(head[6:12]), int(head[12:18])
            datum, least, greatest = (_decimal(head[24 * i : 24 * i + 24]) for i in (3, 4, 5))
            values, at = _heights(data, at, rows)
        except (ValueError, OverflowError):
            return count, [*misplaced, *range(number, count)], contradicted
        if column != number + 1:
            misplaced.append(number)
        values = values[values != _VOID]
        if values.size:
            low, high = float(values.min()) * step + datum, float(values.max()) * step + datum
            if max(abs(low - least), abs(high - greatest)) > 1e-6 * max(1.0, abs(high)):
                contradicted.append(number)
    return count, misplaced, contradicted


def _decimal(text: bytes) -> float:
    return float(text.replace(b"D", b"E"))


def _heights(data: bytes, at: int, rows: int) -> tuple[NDArray[np.int64], int]:
    """The heights of a profile whose first record begins at an offset, and where the next profile begins."""
    pieces = [data[at + 144 : at + 144 + _WIDTH * min(rows, _FIRST)]]
    at, left = at + _RECORD, rows - _FIRST
    while left > 0:
        pieces.append(data[at : at + _WIDTH * min(left, _FULL)])
        at, left = at + _RECORD, left - _FULL
    text = b"".join(pieces)
    if not text or len(text) != _WIDTH * rows:
        raise ValueError("cut short")
    return np.frombuffer(text, f"S{_WIDTH}").astype(np.int64), at
