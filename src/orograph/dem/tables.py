"""Tables of points (CSV): columns of numbers by name, and which of them give the places of points.

The delimiter (comma, semicolon, tab) is the most frequent one in the first line. A field that is not a number is
missing. A line with more fields than there are names is refused, and so are commas that may separate thousands or
decimals.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.dem.handles import locate
from orograph.errors import ReadError

Array = NDArray[np.float64]

EAST = ("longitude", "lon", "long", "lng", "x", "easting", "east")
NORTH = ("latitude", "lat", "y", "northing", "north")
DEGREES = ("longitude", "lon", "long", "lng")


def read_table(path: str) -> dict[str, Array]:
    """The columns of a table, each (n,), NaN where there is no number; as ``read_texts``."""
    return {name: np.array([number(value) for value in values]) for name, values in read_texts(path).items()}


def read_texts(path: str) -> dict[str, list[str]]:
    """The columns of a table with a line of names, as they are written.

    Numbers may have a decimal comma, if they are quoted or semicolons or tabs part the columns.

    Raises:
        ReadError: the file cannot be read; it has no line of names, or nothing below it; two columns have one name; a
            line has more fields than there are names; commas may part thousands.
    """
    try:
        with Path(locate(path)).open(newline="", encoding="utf-8-sig") as file:
            sample = file.read(4096)
            file.seek(0)
            mark = max(",;\t", key=sample.split("\n", 1)[0].count)
            reader = csv.reader(file, delimiter=mark, strict=True)
            names = [name.strip() for name in next(reader, [])]
            rows = list(_rows(reader, len(names), path, mark))
    except (OSError, ValueError, csv.Error) as error:
        raise ReadError(f"Its points cannot be read: {error}", path=path, remedy="Check its contents.") from error
    if (
        any(names)
        and np.isfinite([number(v) if mark == "," else number(v.replace(",", ".")) for v in names if v]).all()
    ):
        raise ReadError(
            "Its first line holds numbers, not column names.", path=path,
            remedy="Add a line of names before it, such as x,y,z or longitude,latitude,height.",
        )  # fmt: skip
    twice = next((name for i, name in enumerate(names) if name and name in names[:i]), None)
    if twice is not None:
        raise ReadError(f"Two of its columns are named {twice!r}.", path=path, remedy="Give them different names.")
    if not rows:
        raise ReadError("It holds no points below its header line.", path=path, remedy="Name a file that has points.")
    columns = {name: [row[i] for row in rows] for i, name in enumerate(names) if name}
    return {name: _with_points(values, name, path, mark) for name, values in columns.items()}


def _rows(reader: Any, width: int, path: str, mark: str) -> Iterator[list[str]]:
    """The lines of a table, padded with empty fields to the length of the first.

    Raises:
        ReadError: a line has more fields than there are names, or a quotation mark that takes in further lines.
    """
    for row in reader:
        if any("\n" in field for field in row):
            raise ReadError(
                f"A quoted field spans several lines, down to line {reader.line_num:,}.", path=path,
                remedy="Close the quotation mark, or remove it.",
            )  # fmt: skip
        if any(row[width:]):
            commas = " With decimal commas, columns must be separated by semicolons." if mark == "," else ""
            raise ReadError(
                f"Line {reader.line_num:,} has {len(row)} fields, but the header line has {width}.", path=path,
                remedy=f"Write the same number in each line.{commas}",
            )  # fmt: skip
        if row:
            yield row[:width] + [""] * (width - len(row))


_PARTED = re.compile(r"\s*[+-]?[1-9]\d{0,2},\d{3}\s*\Z")


def _with_points(values: list[str], name: str, path: str, mark: str) -> list[str]:
    """Numbers with decimal commas replaced by points; where columns are parted by commas, thousands stay as they are.

    Raises:
        ReadError: all commas may part thousands as well (1,234), and columns are not parted by commas.
    """
    commas = [value for value in values if "," in value]
    if commas and all(_PARTED.match(value) for value in commas):
        if mark == ",":
            return values
        raise ReadError(
            f"The commas in its column {name!r} may be decimal commas or thousands separators ({commas[0].strip()}): "
            "ambiguous.", path=path, remedy="Rewrite it with decimal points.",
        )  # fmt: skip
    pointed = [value.replace(",", ".") for value in values]
    return [p if "," in v and np.isfinite(number(p)) else v for v, p in zip(values, pointed)]


def places_in(columns: dict[str, Any], path: str, crs: str) -> tuple[str, str]:
    """The names of the columns that hold the eastings and northings of points.

    Args:
        crs: whose x and y may be meant, in words, for the error.

    Raises:
        ReadError: there are none, several, or a longitude without a latitude.
    """
    east, north = (_only([k for k in columns if k.lower() in known], path) for known in (EAST, NORTH))
    if east is None or north is None or (east.lower() in DEGREES) != (north.lower() in ("latitude", "lat")):
        raise ReadError(
            f"Its columns do not say where the points lie; they are {', '.join(columns) or 'none'}.", path=path,
            remedy=f"Name them longitude and latitude, or x and y in {crs}.",
        )  # fmt: skip
    return east, north


def _only(names: list[str], path: str) -> str | None:
    """The one of these columns that exists; None if there is none."""
    if len(names) > 1:
        raise ReadError(
            f"Its columns {' and '.join(names)} may both say where the points lie.", path=path,
            remedy="Remove or rename the wrong ones.",
        )  # fmt: skip
    return names[0] if names else None


def number(value: Any) -> float:
    """A number; NaN where a text is not one."""
    try:
        if value is None or isinstance(value, bool) or (isinstance(value, str) and "_" in value):
            return np.nan  # ("1_000" is a number only in Python)
        return float(value)
    except (TypeError, ValueError):
        return np.nan
