"""Warnings about a VRT's band that does not repeat properties of its parts, and about contradictions within the parts.

GDAL passes on a part's numbers as stored: the part's unit, scale, offset and nodata value count only if the VRT's band
repeats them. Where no part lies and no nodata value is declared, it gives 0; numbers that do not fit a narrower type
are clipped (https://gdal.org/drivers/raster/vrt.html).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pyproj import CRS

from orograph.dem import beside, geotiff
from orograph.dem.bands import unit_tag
from orograph.dem.handles import lent, stamped
from orograph.dem.header import full_crs, unit_of, vertical_axis
from orograph.dem.missing import impossible_nodata, nodata_text
from orograph.dem.whole.files import on_disk
from orograph.dem.whole.virtual import Part, parts_of
from orograph.errors import ReadError

_MOST_RECTANGLES = 4096


def diagnose(
    dataset: Any, band: int, *, nodata: float | str | None, unit: str | None, masked: bool, crs: CRS | None
) -> list[str]:
    """Warnings about a VRT; arguments as for ``diagnostics.diagnose``."""
    if dataset.driver != "VRT":
        return []
    parts = [
        part
        for part in parts_of(dataset, stamped(str(dataset.name)))
        if part.onto in (0, band) and not part.for_mask and not part.by_mask
    ]
    silent = nodata is None and dataset.nodatavals[band - 1] is None and not masked
    found = list(impossible_nodata(dataset, band, nodata_text(dataset, band))) if nodata is None else []
    if silent and any(part.tag == "GDALWarpOptions" for part in parts):
        found.append("It is warped and declares no nodata value: empty areas read as heights of 0.")
    elif silent and all(part.onto for part in parts) and not _covered(dataset.shape, parts):
        found.append(
            "Its parts do not cover all of it, and it declares no nodata value: the rest reads as heights of 0."
        )
    factor = unit_of(dataset, band, crs, None, []) if unit is None else None
    unlike: dict[str, list[str]] = {}
    every = list({part.location: part for part in parts if not part.needs}.values())
    own: dict[str, list[str]] = {}
    known = nodata if nodata is not None else dataset.nodatavals[band - 1]
    for part in every:
        if not on_disk(part.location).is_file():
            continue
        try:
            with lent(part.location) as (file, _):
                if part.band <= file.count:
                    for text in _unlike(dataset, band, part, file, factor, nodata is not None or masked):
                        unlike.setdefault(text, []).append(part.location)
                    for text in _of_itself(file, part.band, known, masked or part.by_mask):
                        own.setdefault(text, []).append(part.location)
        except ReadError:  # damage is reported when it is read
            continue
    found += [f"{text} ({_named(names)})." for text, names in unlike.items()]
    found += [f"Of its part {_named(names)}: {text}" for text, names in own.items()]
    return found


def _named(names: list[str]) -> str:
    return names[0] + (f" and {len(names) - 1} others" if len(names) > 1 else "")


def _of_itself(file: Any, band: int, nodata: float | str | None, masked: bool) -> list[str]:
    """Contradictions within a part's file or with its companions, as for the file alone.

    Args:
        nodata: that counts instead of its own; None: its own does.
    """
    try:
        warnings = geotiff.diagnose(file, band, nodata, masked, None)
    except ReadError as error:  # a fault for which the file alone would be refused; in a VRT, only place and CRS matter
        warnings = [error.what]
    return warnings + beside.diagnose(file, band)


def _unlike(dataset: Any, band: int, part: Part, file: Any, factor: float | None, excused: bool) -> Iterator[str]:
    """How a part's file differs from the VRT's band.

    Args:
        factor: metres in the unit of the VRT; None: a user states it.
        excused: whether missing samples are declared in another way.
    """
    kind, own = np.dtype(dataset.dtypes[band - 1]), np.dtype(file.dtypes[part.band - 1])
    if not part.converted:
        crs = full_crs(file, [])
        tells = unit_tag(file, part.band) or vertical_axis(crs) is not None
        theirs = unit_of(file, part.band, crs, None, []) if tells else factor
        if factor is not None and theirs is not None and abs(theirs - factor) > 1e-9:
            yield (
                f"Parts of it are in a unit of {theirs:.9g} m, but it declares {factor:.9g} m, which is used for all "
                "(give `vertical_unit` if all are in another)"
            )
        scales = [
            (float(one.scales[i - 1]), float(one.offsets[i - 1])) for one, i in ((dataset, band), (file, part.band))
        ]
        if scales[0] != scales[1]:
            yield (
                f"Parts of it have a scale of {scales[1][0]:g} and an offset of {scales[1][1]:g}, which it does not "
                "repeat: their stored numbers are read unscaled"
            )
        if kind.kind in "iu" and not np.can_cast(own, kind, "safe"):
            yield f"Its numbers are {kind.name} and those of parts {own.name}: they are rounded and clipped"
    if excused or part.tag == "GDALWarpOptions":
        return
    mine, theirs = dataset.nodatavals[band - 1], file.nodatavals[part.band - 1]
    if part.fills and mine is None:
        yield "It skips missing samples of its parts and declares no nodata value: they become heights of 0"
    elif not part.fills and theirs is not None and not _same(mine, theirs):
        yield f"Missing samples of parts are {theirs:g}, which its own nodata value is not: they are read as heights"
    elif not part.fills and theirs is None and _has_mask(file, part.band):
        yield "Parts have a mask, which it does not use: their missing samples are read as heights"


def _same(one: float | None, other: float) -> bool:
    with np.errstate(over="ignore"):
        return one is not None and bool(np.array_equal(np.float32(one), np.float32(other), equal_nan=True))


def _has_mask(file: Any, band: int) -> bool:
    from rasterio.enums import MaskFlags

    flags = file.mask_flag_enums[band - 1]
    return MaskFlags.per_dataset in flags and MaskFlags.alpha not in flags


def _covered(shape: tuple[int, int], parts: list[Part]) -> bool:
    """Whether each sample of a VRT lies in a part; True also where there are too many to compare."""
    if any(part.target is None for part in parts) or len(parts) > _MOST_RECTANGLES:
        return True
    boxes = np.array([part.target for part in parts]).reshape(-1, 4)
    lines = []
    for axis, size in ((0, shape[1]), (1, shape[0])):
        begin = np.clip(np.round(boxes[:, axis]), 0, size)
        end = np.clip(np.round(boxes[:, axis] + boxes[:, axis + 2]), 0, size)
        edges = np.unique(np.concatenate([[0, size], begin, end]))
        lines.append((edges, np.searchsorted(edges, begin), np.searchsorted(edges, end)))
    (across, left, right), (down, top, bottom) = lines
    held = np.zeros((down.size - 1, across.size - 1), bool)
    for a, b, c, d in zip(top, bottom, left, right, strict=True):
        held[a:b, c:d] = True
    return bool(held.all())
