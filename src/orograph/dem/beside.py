"""Warnings about companion files (.aux.xml, .tfw) that contradict their GeoTIFF.

GDAL silently prefers the .aux.xml to the file, and the file to the world file. Programs write such .aux.xml files if
they may not or will not change the file itself; the .aux.xml then stays when the file is replaced under its name
(https://gdal.org/drivers/raster/gtiff.html, "Georeferencing", and the PAM's XML).
"""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path
from typing import Any

from affine import Affine

from orograph.dem.bands import unit_tag
from orograph.dem.units import metres_per
from orograph.dem.whole.files import OPENING

_DECIDING = re.compile(rb"<(?:SRS|GeoTransform|NoDataValue|UnitType|Offset|Scale|GCPList)\b")
_APART = 0.01  # samples
_WORLD = {"GTiff": (".tfw", ".tifw", ".wld"), "JP2OpenJPEG": (".j2w", ".wld")}
_WORLD_APART = 0.1  # samples; world files have few digits


def diagnose(dataset: Any, band: int) -> list[str]:
    """Warnings about an .aux.xml whose CRS, place, unit, scale or nodata value differs from its GeoTIFF's.

    Args:
        dataset: of rasterio, open, with its companion files.
        band: of the heights, from 1.
    """
    name = str(dataset.name)
    found = _world_files(dataset, name)
    note = Path(f"{name}.aux.xml")
    if dataset.driver != "GTiff" or not note.is_file() or not _DECIDING.search(note.read_bytes()):
        return found
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with rasterio.Env(GDAL_PAM_ENABLED="NO"), OPENING, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(name) as alone:
            differ = _differences(dataset, alone, band)
    return found + [
        f"{note.name} beside it says {theirs}, but the file itself says {own}: the former is used (remove it if it is "
        "out of date)."
        for theirs, own in differ
    ]


def _world_files(dataset: Any, name: str) -> list[str]:
    """Warnings about world files that give another place than the one used."""
    place = dataset.transform
    if dataset.driver not in _WORLD or place.is_identity:
        return []
    found = []
    for file in (Path(name).with_suffix(suffix) for suffix in _WORLD[dataset.driver]):
        try:
            a, d, b, e, x, y = map(float, file.read_text().replace(",", ".").split()[:6])
        except (OSError, ValueError):  # missing or empty
            continue
        # A world file gives the centre of the first sample.
        world = Affine(a, b, x - (a + b) / 2, d, e, y - (d + e) / 2)
        off = max(_apart(world, place, corner) for corner in ((0, 0), (dataset.width, dataset.height)))
        if not off <= _WORLD_APART * _step(place):
            found.append(
                f"{file.name} beside it says that it lies at {world.c:.10g}, {world.f:.10g} with samples of {a:.10g} × "
                f"{e:.10g}; it says itself {place.c:.10g}, {place.f:.10g} with {place.a:.10g} × {place.e:.10g}, which "
                "is used (remove the former if it is out of date)."
            )
    return found


def _step(place: Affine) -> float:
    """The smaller distance between samples."""
    return min(math.hypot(place.a, place.d), math.hypot(place.b, place.e))


def _differences(dataset: Any, alone: Any, band: int) -> list[tuple[str, str]]:
    """Properties that a dataset has with its companions and not from its file alone: (dataset, file)."""
    found: list[tuple[str, str]] = []
    if alone.crs and dataset.crs != alone.crs:
        found.append((f"the CRS {_called(dataset.crs)}", _called(alone.crs)))
    mine, own = dataset.transform, alone.transform
    if not own.is_identity:
        step = _step(own)
        size = alone.width, alone.height
        off = max(_apart(mine, own, (0, 0)), _apart(mine, own, size))
        if off > _APART * step:
            found.append((f"that it lies at {mine.c:.10g}, {mine.f:.10g}", f"{own.c:.10g}, {own.f:.10g}"))
    nodata, inside = dataset.nodatavals[band - 1], alone.nodatavals[band - 1]
    if inside is not None and nodata != inside and not (nodata != nodata and inside != inside):
        found.append((f"that {nodata} is missing", f"{inside}"))
    unit, inner = unit_tag(dataset, band), unit_tag(alone, band)
    if inner and metres_per(unit) != metres_per(inner):
        found.append((f"that heights are in {unit!r}", f"{inner!r}"))
    scale, within = ((one.scales[band - 1], one.offsets[band - 1]) for one in (dataset, alone))
    if within != (1, 0) and scale != within:
        found.append((f"a scale and offset of {scale[0]:g}, {scale[1]:g}", f"{within[0]:g}, {within[1]:g}"))
    return found


def _called(crs: Any) -> str:
    """A short name for a CRS."""
    if not crs:
        return "none"
    named = re.match(r'\w+\["([^"]*)"', crs.to_wkt())
    return named[1] if named is not None else crs.to_string()


def _apart(one: Any, other: Any, corner: tuple[int, int]) -> float:
    """The distance between a corner's places under two transforms."""
    a, b, c, d, e, f = (x - y for x, y in zip(one[:6], other[:6], strict=True))
    return float(max(abs(a * corner[0] + b * corner[1] + c), abs(d * corner[0] + e * corner[1] + f)))
