"""Tables of points (CSV): columns of numbers by name, and which of them say where the points lie.

The delimiter (comma, semicolon, tab) is the one that the first line has most of. What is no number is missing.
"""

from __future__ import annotations

import csv
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
    """The columns of a table with a line of names, each (n,), NaN where there is no number.

    Where semicolons or tabs part the columns, numbers may have a decimal comma.

    Raises:
        ReadError: the file cannot be read; it has no line of names, or nothing below it.
    """
    try:
        with Path(locate(path)).open(newline="", encoding="utf-8-sig") as file:
            sample = file.read(4096)
            file.seek(0)
            mark = max(",;\t", key=sample.split("\n", 1)[0].count)
            reader = csv.DictReader(file, delimiter=mark)
            rows = list(reader)
    except (OSError, ValueError, csv.Error) as error:
        raise ReadError(f"Its points cannot be read: {error}", path=path, remedy="See what it holds.") from error
    keys = [k for k in reader.fieldnames or () if k]
    read = number if mark == "," else _number_with_comma
    if keys and np.isfinite([read(k) for k in keys]).all():
        raise ReadError(
            "Its first line holds numbers, not the names of its columns.", path=path,
            remedy="Put a line of names before it, such as x,y,z or longitude,latitude,height.",
        )  # fmt: skip
    if not rows:
        raise ReadError("It holds no points below its line of names.", path=path, remedy="Name a file that has some.")
    return {k.strip(): np.array([read(row.get(k)) for row in rows]) for k in keys}


def places_in(columns: dict[str, Any], path: str, crs: str) -> tuple[str, str]:
    """The names of the columns that say where points lie: eastwards and northwards.

    Args:
        crs: whose x and y may be meant, in words, for the error.

    Raises:
        ReadError: there are none.
    """
    east, north = (next((k for k in columns if k.lower() in known), None) for known in (EAST, NORTH))
    if east is None or north is None:
        raise ReadError(
            f"Its columns do not say where the points lie; they are {', '.join(columns) or 'none'}.", path=path,
            remedy=f"Call them longitude and latitude, or x and y in {crs}.",
        )  # fmt: skip
    return east, north


def _number_with_comma(value: Any) -> float:
    """A number whose decimals follow a point or a comma."""
    return number(value.replace(",", ".") if isinstance(value, str) and value.count(",") == 1 else value)


def number(value: Any) -> float:
    """A number, NaN where something is none."""
    try:
        return float(value) if value is not None and not isinstance(value, bool) else np.nan
    except (TypeError, ValueError):
        return np.nan
