"""Elevation as text: every token is a number, and there are as many as the header promises.

GDAL reads the number that a token begins with: ``abc``, ``--`` and ``0x10`` become 0, ``1,234.5`` becomes 1.234, and a
missing number 0. A compiled pass goes through the bytes once, in pieces.

Formats: Arc/Info and GRASS ASCII grids, Surfer ASCII grids (DSAA), columns of x, y and height.
"""

from __future__ import annotations

import re
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

REMEDY = "Rewrite it with plain numbers such as -1234.5, and missing heights as its nodata value."

_PIECE = 8 << 20
_HEADER = 16384
_TAIL = 4096
_ENOUGH = 20  # numbers to learn the number of decimals from
_LONGEST = 64  # bytes of a token that a message shows
_ARC = re.compile(
    rb"\s*(?:(?:ncols|nrows|xllcorner|yllcorner|xllcenter|yllcenter|cellsize|dx|dy|nodata_value)\s+\S+\s+)+", re.I
)
_GRASS = re.compile(rb"\s*(?:(?:north|south|east|west|rows|cols|null|type|multiplier):\s*\S+\s+)+", re.I)
_SURFER = re.compile(rb"DSAA\s+(?:\S+\s+){8}")
_GXF = re.compile(rb".*?^#GRID[ \t]*\r?\n", re.S | re.M)
_ISG = re.compile(rb".*?^end_of_head[^\n]*\n", re.S | re.M)
_ZMAP = re.compile(rb"(?:![^\n]*\n)*@[^\n]*\n[ \t]*(\d+)[^@]*?\n@[ \t]*\r?\n")
_TITLES = re.compile(rb"[^\n]*[A-Za-z][^\n]*\n")
_FIELDS = re.compile(rb"[\s,;]+")
_NEGATIVE = re.compile(rb"\s*[^\s,;]+[\s,;]+[^\s,;]+[\s,;]+-[0-9.]*[1-9]")
_KNOWN = re.compile(
    rb"[+-]?(?:inf(?:inity)?|1\.#(?:inf|qnan|snan|ind)0*)\Z", re.I
)  # as C libraries write NaN and infinity


def arc(dataset: Any, path: str) -> str | None:
    """The fault of an Arc/Info ASCII grid, as a sentence; None if there is none."""
    return (
        _header_fault(path, (b"xll", b"yll"))
        or _contradiction(path, _ARC, "nodata_value")
        or _grid_fault(dataset, path, _ARC, True)
    )


def grass(dataset: Any, path: str) -> str | None:
    """The fault of a GRASS ASCII grid, as a sentence; None if there is none."""
    sides = (b"north", b"south", b"east", b"west")
    return (
        _header_fault(path, sides) or _contradiction(path, _GRASS, "null") or _grid_fault(dataset, path, _GRASS, True)
    )


def surfer(dataset: Any, path: str) -> str | None:
    """The fault of a Surfer ASCII grid, as a sentence; None if there is none."""
    return _grid_fault(dataset, path, _SURFER, False)


def gxf(dataset: Any, path: str) -> str | None:
    """The fault of an uncompressed Grid eXchange File, as a sentence; None if there is none."""
    with Path(path).open("rb") as file:
        head = file.read(_HEADER)
    if re.search(rb"^#GTYPE\s+[1-9]", head, re.M):
        return None
    return _grid_fault(dataset, path, _GXF, False)


def isg(dataset: Any, path: str) -> str | None:
    """The fault in the grid of a geoid model as text (ISG), as a sentence; None if there is none."""
    return _grid_fault(dataset, path, _ISG, False)


def zmap(dataset: Any, path: str) -> str | None:
    """The fault of a ZMap Plus grid, whose numbers have fields of one width, as a sentence; None if there is none."""
    count = 0
    with Path(path).open("rb") as file:
        found = _ZMAP.match(file.read(_HEADER))
        if found is None or not int(found[1]):
            return "Its header cannot be parsed."
        wide = int(found[1])
        file.seek(found.end())
        for number, line in enumerate(file):
            row = line.rstrip()
            for field in (row[at : at + wide] for at in range(0, len(row), wide)):
                if not _is_number(field):
                    return f"Line {number + 1} of its numbers: {field.strip().decode('latin-1')!r} is not a number."
                count += 1
    wanted = dataset.width * dataset.height
    return None if count == wanted else f"It holds {count:,} numbers where its header promises {wanted:,}."


def r_numbers(dataset: Any, path: str) -> str | None:
    """The fault in R's data as text, one number per line, as a sentence; None if there is none or no such data."""
    with Path(path).open("rb") as file:
        if file.read(7) != b"RDA2\nA\n":
            return None
        lines = file.read().split(b"\n")
    wanted = dataset.count * dataset.width * dataset.height
    try:
        begin = lines.index(b"%d" % wanted) + 1
    except ValueError:
        return "Its header cannot be parsed."
    odd = next((i for i in range(begin, begin + wanted) if i >= len(lines) or not _is_number(lines[i])), None)
    if odd is None and lines[begin + wanted : begin + wanted + 1] == [b"1026"]:
        return None
    return f"It does not hold {wanted:,} numbers, one per line: see line {(odd or begin + wanted) + 3:,}."


def _is_number(token: bytes) -> bool:
    try:
        float(token)
    except ValueError:
        return token == b"NA"
    return b"_" not in token


def points(dataset: Any, path: str) -> str | None:
    """The fault in columns of x, y and height, as a sentence; None if there is none."""
    with Path(path).open("rb") as file:
        head = file.read(_HEADER)
    titles = _TITLES.match(head)
    start = titles.end() if titles else 0
    line = head[start:].partition(b"\n")[0]
    parting = b";" if b";" in line else b"," if b", " in line or len(line.split()) < 3 else b""
    with Path(path).open("rb") as file:
        fault, count = _scanned(file, start, head.count(b"\n", 0, start), parting, True)
        if fault is not None:
            return fault
        columns = _scanned(BytesIO(line), 0, 0, parting, True)[1] or 3
        if count % columns or count // columns > _lines(file, start):
            return f"It holds {count:,} numbers, not {columns} in each line: lines were joined or truncated."
        return (
            _gap_fault(dataset, count // columns)
            or _column_fault(dataset, file, start)
            or _shortened(file, start, columns)
        )


def _gap_fault(dataset: Any, count: int) -> str | None:
    """GDAL fills gaps between points with 0 or −32768; where heights reach that low, it is 0, which may be a height."""
    wanted = dataset.width * dataset.height
    if count >= wanted or dataset.nodatavals[0] is not None:
        return None
    return f"It lacks {wanted - count:,} of {wanted:,} points, which would be read as 0."


def _column_fault(dataset: Any, file: BinaryIO, start: int) -> str | None:
    """GDAL rounds negative 16-bit integers up by one where points run along columns."""
    if dataset.dtypes[0] != "int16":
        return None
    file.seek(start)
    first, second = (_FIELDS.split(file.readline().strip(), maxsplit=1)[0] for _ in range(2))
    if first != second:
        return None
    file.seek(start)
    if not any(_NEGATIVE.match(line) for line in file):
        return None
    return "Its points run along columns, where negative whole numbers are read one too high: sort them by rows."


def _header_fault(path: str, needed: tuple[bytes, ...]) -> str | None:
    """A missing key, without which GDAL would place the grid at 0."""
    with Path(path).open("rb") as file:
        head = file.read(_HEADER)
    lacks = next((key.decode() for key in needed if not re.search(rb"^\s*" + key, head, re.I | re.M)), None)
    return None if lacks is None else f"Its header does not say where it lies ({lacks!r}…)."


def _contradiction(path: str, header: re.Pattern[bytes], missing: str) -> str | None:
    """Faults of a header that GDAL ignores: a repeated key, words for numbers, corners and centres at once, a factor.

    Args:
        missing: the key of the nodata value, which need not be a number ("nan", "*").
    """
    with Path(path).open("rb") as file:
        head = header.match(file.read(_HEADER))
    found = dict[str, str]()
    for key, value in re.findall(r"([a-z_]+):?\s*(\S+)", "" if head is None else head[0].decode("latin-1").lower()):
        if found.setdefault(key, value) != value:
            return f"Its header says {key!r} twice: {found[key]} and {value}."
        if key in ("north", "south", "east", "west") and ":" in value:
            return f"Its header says {key!r} in degrees and minutes ({value}), which GDAL reads as whole degrees."
        if key != "type" and not _is_number(value.replace(",", ".").encode()) and (key, value) != (missing, "*"):
            return f"Its header says {value!r} for {key!r}, which is not a number."
    if {"xllcorner", "yllcenter"} <= set(found) or {"xllcenter", "yllcorner"} <= set(found):
        return "Its header gives a corner along one axis and a centre along the other."
    if {"xllcorner", "xllcenter"} <= set(found) or {"yllcorner", "yllcenter"} <= set(found):
        return "Its header gives both a corner and a centre."
    if float(found.get("multiplier", 1)) != 1:
        return f"Its header multiplies heights by {found['multiplier']}, which GDAL does not."
    return None


CHECKS = (arc, grass, surfer, points, gxf, isg, zmap)


def _grid_fault(dataset: Any, path: str, header: re.Pattern[bytes], comma: bool) -> str | None:
    """The fault in the numbers after a header, of which there must be one per sample of the grid."""
    with Path(path).open("rb") as file:
        head = file.read(_HEADER)
        found = header.match(head)
        if found is None:
            return "Its header cannot be parsed."
        start, lines = found.end(), head.count(b"\n", 0, found.end())
        fault, count = _scanned(file, start, lines, b"", comma)
        wanted = dataset.width * dataset.height
        if fault is not None or count == wanted:
            return fault or _shortened(file, start)
        odd = _odd_line(file, start, lines, dataset.width)
    return f"It holds {count:,} numbers where its header promises {wanted:,}: {odd}."


def _lines(file: BinaryIO, start: int) -> int:
    """The number of lines from an offset on; the last one may lack its end."""
    file.seek(start)
    lines, last = 0, b"\n"
    for piece in iter(partial(file.read, _PIECE), b""):
        lines, last = lines + piece.count(b"\n"), piece[-1:]
    return lines + (last != b"\n")


def _shortened(file: BinaryIO, start: int, columns: int = 1) -> str | None:
    """The last number of a file if it has fewer decimals than all others in its column, which agree."""
    size = file.seek(0, 2)
    file.seek(max(start, size - _TAIL))
    text = file.read()
    fields = _FIELDS.split(text)[::-columns][::-1]
    alike = {len(field.partition(b".")[2]) for field in fields[1:-1]}
    if text[-1:].isspace() or len(fields) < _ENOUGH or len(alike) > 1 or min(alike) == 0:
        return None
    if len(fields[-1].partition(b".")[2]) >= min(alike):
        return None
    return f"Its last number is {fields[-1].decode('latin-1')!r}, with fewer decimals than others: it was cut short."


def _scanned(file: BinaryIO, start: int, lines: int, parting: bytes, comma: bool) -> tuple[str | None, int]:
    """The first token from byte ``start`` on that is not a number, and the count of numbers before it.

    Args:
        lines: before ``start``.
        parting, comma: as for ``scan``.
    """
    state = np.zeros(7, np.int64)
    state[2] = lines
    file.seek(max(0, start - _HEADER))
    before = file.read(start - max(0, start - _HEADER))
    state[3] = before.rfind(b"\n") + 1 - len(before)
    rest = b""
    while piece := file.read(_PIECE):
        data = rest + piece
        cut = max(data.rfind(b"\n"), data.rfind(b" ")) + 1
        fault = _first_fault(data[:cut], parting, comma, state)
        if fault is not None:
            return fault, int(state[1])
        rest = data[cut:]
        if len(rest) > _PIECE:
            return f"Line {state[2] + 1} holds {len(rest):,} bytes without a space: these are not numbers.", int(
                state[1]
            )
    fault = _first_fault(rest, parting, comma, state)
    if fault is None and state[4] and not state[5]:
        fault = (
            f"Line {state[6] + 1}: the commas in its numbers may be decimal commas or thousands separators: ambiguous."
        )
    return fault, int(state[1])


def _first_fault(data: bytes, parting: bytes, comma: bool, state: NDArray[np.int64]) -> str | None:
    from orograph.dem.whole.kernels import scan

    view = np.frombuffer(data, np.uint8)
    state[0] = 0
    while True:
        first, end = scan(view, parting[0] if parting else 0, comma, state)
        if first < 0:
            state[3] -= view.size
            return None
        token = data[first:end]
        if not _KNOWN.match(token):
            shown = token[:_LONGEST].decode("utf-8", "replace")
            return f"Line {state[2] + 1}, column {first - state[3] + 1}: {shown!r} is not a number."
        state[1] += 1


def _odd_line(file: BinaryIO, start: int, lines: int, cols: int) -> str:
    """Where numbers are missing or extra, if every line should be a row of the grid; otherwise where they end."""
    file.seek(start)
    number = lines
    for number, line in enumerate(file, lines + 1):
        count = len(line.split())
        if count and count != cols:
            return f"line {number} has {count:,} of {cols:,}"
    return f"they end in line {number}"
