"""Names and colours of classes beside a raster or in a VRT, as GDAL stores them: raster attribute tables, category
names.

The file is ``NAME.aux.xml`` (GDAL's PAM) or the VRT itself. A table's columns say what they are for by their usage
(``GDALRATFieldUsage``): 2 names, 3 to 5 the least and the greatest value or both, 6 to 8 red, green and blue; without
values rows are counted from ``Row0Min`` by ``BinSize``. Category names are those of 0, 1, 2…
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from orograph.errors import ReadError

NAME, LOW, HIGH, BOTH, COLORS = 2, 3, 4, 5, (6, 7, 8)

CALLED = ("name", "class", "class_name", "classname", "label", "category", "landcover", "land cover", "description")
"""Usual names of a column of names, if no usage is declared."""

MOST = 4096
"""Maximum values of a row's range."""


class Named(NamedTuple):
    """Names and colours (#rrggbb) by number."""

    names: Mapping[int, str]
    colors: Mapping[int, str]


def named_beside(location: str, band: int) -> Named | None:
    """A band's classes from the file beside a raster, or from a VRT; None: nothing.

    Raises:
        ReadError: the file is not XML, or a row of its table has no numbers.
    """
    path = Path(location)
    own = path if path.suffix.lower() == ".vrt" else Path(f"{location}.aux.xml")
    if not own.is_file():
        return None
    try:
        root = ElementTree.parse(own).getroot()
    except (ElementTree.ParseError, OSError) as error:
        raise ReadError(f"It cannot be read: {error}.", path=str(own), remedy="Remove or correct it.") from error
    bands = [one for tag in ("PAMRasterBand", "VRTRasterBand") for one in root.iter(tag)]
    for one in bands:
        if int(one.get("band", "1")) != band:
            continue
        table, words = one.find("GDALRasterAttributeTable"), one.find("CategoryNames")
        if table is not None:
            found = _of_table(table, str(own))
            if found.names or found.colors:
                return found
        if words is not None:
            told = [(word.text or "").strip() for word in words]
            return Named({k: word for k, word in enumerate(told) if word}, {})
    return None


def _of_table(table: ElementTree.Element, path: str) -> Named:
    usage: dict[int, int] = {}
    for k, field in enumerate(table.iter("FieldDefn")):
        use = int(field.findtext("Usage", "0"))
        called = field.findtext("Name", "").strip().lower()
        if use == 0 and called in CALLED and NAME not in usage:
            use = NAME
        if use == 0 and called == "value" and not usage.keys() & {LOW, BOTH}:
            use = BOTH
        usage.setdefault(use, k)
    rows = [[(cell.text or "").strip() for cell in row.findall("F")] for row in table.findall("Row")]
    first, step = float(table.get("Row0Min", "0")), float(table.get("BinSize", "1"))
    names: dict[int, str] = {}
    colors: dict[int, str] = {}
    try:
        bright = [float(row[usage[use]]) for row in rows for use in COLORS if use in usage]
        unit = 255.0 if bright and max(bright) <= 1 and any(v != int(v) for v in bright) else 1.0
        for k, row in enumerate(rows):
            low = float(row[usage[BOTH if BOTH in usage else LOW]]) if usage.keys() & {LOW, BOTH} else first + k * step
            high = float(row[usage[HIGH]]) if HIGH in usage and BOTH not in usage else low
            codes = range(round(low), min(round(high), round(low) + MOST) + 1)
            if NAME in usage and row[usage[NAME]]:
                names |= dict.fromkeys(codes, row[usage[NAME]])
            if all(use in usage for use in COLORS):
                rgb = [min(max(round(float(row[usage[use]]) * unit), 0), 255) for use in COLORS]
                colors |= dict.fromkeys(codes, "#{:02x}{:02x}{:02x}".format(*rgb))
    except (ValueError, IndexError) as error:
        raise ReadError(
            f"Row {len(names) + 1} of its attribute table lacks a number.", path=path,
            remedy="Correct or remove the table.",
        ) from error  # fmt: skip
    return Named(names, colors)
