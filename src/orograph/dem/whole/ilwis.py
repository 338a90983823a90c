"""ILWIS: consistency of a map (.mpr), its place (.grf), its coordinate system (.csy) and its samples (.mp#).

GDAL's driver reads as much as it understands, and writes beyond its memory where number types contradict each other.

Source: the object definition files of ILWIS 3.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from orograph.dem.whole.header_text import Form, form_fault, pairs
from orograph.dem.whole.sizes import exact

_MAP = Form(
    (), None, other=("domain", "range", "georef", "size", "data", "structure"),
    needed=(("", "domain", "size", "data"),), shortest=6,
)  # fmt: skip
_SYSTEM = Form(
    (), None, words={"type": ("PROJECTION", "LATLON", "BOUNDSONLY", "FORMULA", "TIEPOINTS", "ORTHO", "DIRECTLINEAR")},
    needed=(("", "type"),), other=("projection", "ellipsoid"), shortest=6,
)  # fmt: skip
_CORNERS = Form(
    (), None, ("columns", "lines"), ("maxx", "maxy", "minx", "miny"), {"cornersofcorners": ("YES", "NO")},
    (("minx", "miny", "maxx", "maxy"),), (("minx", "maxx"), ("miny", "maxy")), ("coordsystem",),
)  # fmt: skip


def _header_fault(path: str) -> str | None:
    """The fault in an ILWIS map's header (.mpr) and place (.grf), as a sentence; None if there is none."""
    entries = _entries(Path(path))
    if fault := form_fault(_MAP, entries):
        return fault
    name = dict(entries).get("georef", "none").strip("'\"")
    if name.lower() in ("", "none", "none.grf"):
        return None
    place = Path(path).with_name(name)
    if not place.is_file():
        return f"Its place {place.name!r} is not there."
    corners = _entries(place)
    return form_fault(_CORNERS, corners) or _system_fault(Path(path).with_name(dict(corners).get("coordsystem", "")))


def _system_fault(file: Path) -> str | None:
    """The fault in an ILWIS map's coordinate system (.csy), without which GDAL finds no CRS."""
    if not file.is_file():
        return None  # one that is built into ILWIS
    entries = dict(_entries(file, keep_type=True))
    if fault := form_fault(_SYSTEM, list(entries.items())):
        return fault
    if entries["type"] == "Projection" and "projection" not in entries:
        return "Its coordinate system (.csy) does not declare its projection."
    return None


def _entries(file: Path, keep_type: bool = False) -> list[tuple[str, str]]:
    """Keys, in small letters, and values of an .ini file; without "type", which every section has, or its first."""
    entries = [(key.lower(), value) for key, value in pairs(file.read_text("latin-1"), "=")]
    first = next((value for key, value in entries if key == "type"), None) if keep_type else None
    return [pair for pair in entries if pair[0] != "type"] + ([] if first is None else [("type", first)])


_SPAN = re.compile(r"(-?[\d.]+(?:[eE][+-]?\d+)?):(-?[\d.]+(?:[eE][+-]?\d+)?)(?::([\d.]+(?:[eE][+-]?\d+)?))?(:.*)?")


def fault(dataset: Any, path: str) -> str | None:
    """The fault of an ILWIS map, whose samples are in another file (.mp#) of the type that the header (.mpr) names."""
    if wrong := _header_fault(path):
        return wrong
    entries = {(part, key): value for part, key, value in _sections(Path(path).read_text("latin-1"))}
    kind = entries.get(("mapstore", "type"), "Byte").lower()
    item = {"byte": 1, "int": 2, "long": 4, "float": 4, "real": 8}.get(kind)
    if item is None:
        return f"Its header calls its numbers {kind!r}, which is not a known type."
    span = _SPAN.fullmatch(entries.get(("basemap", "range"), ""))
    of_values = entries.get(("basemap", "domain"), "").lower().startswith("value.dom")
    if of_values and (span is None or not float(span[1]) <= float(span[2])):
        return "Its header does not declare what its numbers mean ('Range')."
    step = 0.0 if span is None else float(span[3] or 0)
    if np.dtype(dataset.dtypes[0]).itemsize < item and (kind in ("float", "real") or step == 0):
        return f"Its header says that its numbers are {kind!r} and {dataset.dtypes[0]}, which contradict each other."
    data = Path(path).with_name(entries.get(("mapstore", "data"), Path(path).stem + ".mp#").strip("'\""))
    rows, cols = dataset.height, dataset.width
    place = Path(path).with_name(entries.get(("map", "georef"), "").strip("'\""))
    if place.is_file():
        there = {key: value for _, key, value in _sections(place.read_text("latin-1"))}
        size = there.get("lines", str(rows)), there.get("columns", str(cols))
        if size != (str(rows), str(cols)):
            return f"It has {rows} × {cols} samples, and its place ({place.name}) {size[0]} × {size[1]}."
    return exact(data, rows * cols * item) if data.is_file() else None


def _sections(text: str) -> list[tuple[str, str, str]]:
    """(section, key, value) of an .ini text, sections and keys in small letters."""
    found, part = [], ""
    for line in text.splitlines():
        title = re.fullmatch(r"\s*\[(.*)\]\s*", line)
        if title:
            part = title[1].lower()
        elif "=" in line:
            key, _, value = line.partition("=")
            found.append((part, key.strip().lower(), value.strip()))
    return found
