"""DTED and SRTM's .hgt: the place of a tile, which a file states more than once.

Source: MIL-PRF-89020B, section 3.13 (UHL, DSI and the data records); SRTM's topography format (.hgt).
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from orograph.dem.whole.sizes import exact

_HEADERS = 3428  # bytes: UHL, DSI, ACC
_ANGLE = re.compile(rb"(\d{2,3})(\d\d)(\d\d(?:\.\d+)?)([NSEW])\Z")


def fault(dataset: Any, path: str) -> str | None:
    """The fault of a DTED file, as a sentence; None if there is none."""
    record = 12 + 2 * dataset.height
    size = Path(path).stat().st_size
    partial = dataset.tags().get("DTED_PartialCellIndicator", "00").strip() not in ("", "0", "00")
    cut = partial and size < _HEADERS + dataset.width * record and (size - _HEADERS) % record == 0
    short = None if cut else exact(path, _HEADERS + dataset.width * record)  # a partial cell may omit columns
    return short or _headers_fault(path) or _order_fault(path, record, (size - _HEADERS) // record)


def _headers_fault(path: str) -> str | None:
    """Compare the place in the first header (UHL), which GDAL uses, with that in the second (DSI)."""
    with Path(path).open("rb") as file:
        head = file.read(_HEADERS)
    at = head.find(b"UHL")
    west, south = _angle(head[at + 4 : at + 12]), _angle(head[at + 12 : at + 20])
    if west is None or south is None:
        return "Its first header (UHL) has no position."
    data = at + 80
    for what, here, there in (
        ("begins at longitude", west, _angle(head[data + 194 : data + 204])),
        ("begins at latitude", south, _angle(head[data + 185 : data + 194])),
        ("has an eastward step of", _tenths(head[at + 20 : at + 24]), _tenths(head[data + 277 : data + 281])),
        ("has a northward step of", _tenths(head[at + 24 : at + 28]), _tenths(head[data + 273 : data + 277])),
    ):
        limit = 1.0 if "begins" in what else 1e-9  # the data of a partial cell may begin inside its degree
        if here is not None and there is not None and abs(here - there) > limit:
            return f"Its first header says that it {what} {here:g}, the second (DSI) {there:g} degrees."
    return None


def _angle(text: bytes) -> float | None:
    """Degrees from "DDDMMSSH" or "DDMMSS.SH"; None if it is invalid."""
    found = _ANGLE.match(text.strip())
    if found is None:
        return None
    degrees = int(found[1]) + int(found[2]) / 60 + float(found[3]) / 3600
    return -degrees if found[4] in b"SW" else degrees


def _tenths(text: bytes) -> float | None:
    """Degrees from tenths of seconds; None if there are none."""
    return int(text) / 36000 if text.strip().isdigit() else None


def _order_fault(path: str, record: int, count: int) -> str | None:
    """Check the numbers of records and of their columns (all 0: the writer did not count)."""
    with Path(path).open("rb") as file:
        file.seek(_HEADERS)
        numbers = [struct.unpack_from(">H", file.read(record), 4)[0] for _ in range(count)]
    steps = np.diff(numbers)
    odd = int(np.argmax(steps <= 0)) if steps.size and any(numbers) and (steps <= 0).any() else None
    if odd is None:
        return None
    return f"Its columns are out of order: record {odd} is column {numbers[odd]}, the next column {numbers[odd + 1]}."


def hgt(dataset: Any, path: str) -> str | None:
    """The fault of an SRTM tile's name, which alone gives its place; None if there is none."""
    found = re.match(r"[NS](\d\d)[EW](\d{3})", Path(str(dataset.name)).name.upper())
    if found is not None and (int(found[1]) > 90 or int(found[2]) > 180):
        return f"Its name places it at {found[0]}, which is not a valid position."
    return None
