"""Heights already in memory, as a Dem: arrays, masked arrays, and convertible ones (Dask's, PyTorch's…).

An array has no place and no unit: ``transform`` and ``crs``, as in rasterio, or ``spacing`` give them. Otherwise its
samples are assumed to be 1 m apart, with a warning. Missing are NaN, ±inf, what a mask hides, what equals ``nodata`` as
stored, and anything of magnitude ``HUGE``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.dem.header import oriented, parsed_crs, settled_vertical
from orograph.dem.missing import is_nodata
from orograph.dem.raster import Dem
from orograph.dem.source import HUGE
from orograph.dem.units import metres_per
from orograph.errors import ReadError, UsageError

UNPLACED = (
    "The array has no georeferencing: its samples are assumed to be 1 m apart (give `spacing=METRES`, or transform= "
    "and crs=)."
)


def heights_of(values: Any, called: str, *, nodata: float | None = None, factor: float = 1.0) -> NDArray[np.float32]:
    """Numbers of any real type as heights: float32 metres, NaN where missing; always a copy.

    Args:
        values: an array or what becomes one; masked samples are missing.
        called: what to call it in errors.
        nodata: the stored number that means "missing".
        factor: metres in one of the numbers' unit.

    Raises:
        ReadError: the numbers are complex, booleans, or not numbers.
    """
    raw = np.ma.getdata(values) if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
    kind, said = raw.dtype.kind, f"The numbers of {called} are {raw.dtype}"
    if kind == "c":
        raise ReadError(f"{said}, but heights must be real.", remedy="Take their .real part, or their np.abs().")
    if kind == "b":
        raise ReadError(f"{said}: booleans, not heights.", remedy="Convert them to numbers with .astype(np.uint8).")
    if kind not in "iuf":
        raise ReadError(f"{said}, which cannot be heights.", remedy="Convert them with .astype(np.float32).")
    with np.errstate(over="ignore", invalid="ignore"):
        plain = factor == 1
        heights = raw.astype(np.float32) if plain else (raw.astype(np.float64) * factor).astype(np.float32)
        if kind == "f" or not plain or raw.dtype.itemsize > 4:
            heights[~(np.abs(heights) < HUGE)] = np.nan
    if nodata is not None:
        heights[is_nodata(raw, nodata)] = np.nan
    if isinstance(values, np.ma.MaskedArray):
        heights[np.ma.getmaskarray(values)] = np.nan
    return heights


def from_array(
    values: Any, *, transform: Affine | Sequence[float] | None = None, crs: Any = None, spacing: float | None = None,
    nodata: float | str | None = None, vertical_unit: str | None = None, assume_vertical: str | None = None,
    name: str | None = None, warnings: list[str] | None = None,
) -> Dem:  # fmt: skip
    """A Dem of an array.

    Args:
        values: (rows, cols) of any real type; dimensions of length 1 in front are dropped.
        transform: from (col, row) corners to the CRS's coordinates: an ``Affine``, or its six numbers a, b, c, d, e, f.
        crs: the CRS of those coordinates, as pyproj takes it; None: they are metres.
        spacing: instead of a transform: metres between samples.
        nodata: the stored number that means "missing"; None or "none": there is none.
        vertical_unit: the unit of the heights; None: metres.
        assume_vertical: their vertical datum.
        name: what to call it. Default: "array".
        warnings: collects messages for the user.

    Raises:
        ReadError: they are no real numbers. UsageError: they are not two-dimensional, or an option makes no sense.
    """
    told = [] if warnings is None else warnings
    called = name or "array"
    array = values if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
    while array.ndim > 2 and array.shape[0] == 1:
        array = array[0]
    if array.ndim != 2 or 0 in array.shape:
        bands = array.ndim == 3 and (array.shape[0] in (3, 4) or array.shape[2] in (3, 4))
        raise UsageError(
            f"Heights must be an array of rows and columns; this one has the shape {array.shape}.",
            remedy="A picture is laid over a terrain with layers=." if bands else "Select one layer of it.",
        )
    factor = 1.0 if vertical_unit is None else metres_of(vertical_unit)
    heights = heights_of(array, name or "the array", nodata=number_of(nodata), factor=factor)
    shape = (array.shape[0], array.shape[1])
    place = oriented(shape, affine_of(transform, spacing, crs, shape, told), None if crs is None else parsed_crs(crs))
    heights = heights[:: -1 if place.flip_rows else 1, :: -1 if place.flip_cols else 1]
    vertical = settled_vertical(None, assume_vertical, told)
    return Dem(np.ascontiguousarray(heights), place.grid, vertical, called)


def metres_of(unit: str) -> float:
    """Metres in a unit that the user names.

    Raises:
        UsageError: it is not known.
    """
    factor = metres_per(unit)
    if factor is None:
        raise UsageError(f"{unit!r} is not a known unit of length (m, ft, us-ft, cm…).")
    return factor


def number_of(nodata: float | str | None) -> float | None:
    """The number that a nodata value is; None if there is none.

    Raises:
        UsageError: it is not a number.
    """
    if nodata is None or (isinstance(nodata, str) and nodata.strip().lower() == "none"):
        return None
    try:
        return float(nodata)
    except ValueError:
        raise UsageError(f"The nodata value must be a number or 'none', not {nodata!r}.") from None


def affine_of(
    transform: Any, spacing: float | None, crs: Any, shape: tuple[int, int], warnings: list[str]
) -> Affine:  # fmt: skip
    """The given transform, or that of samples ``spacing`` metres apart (1, with a warning).

    Raises:
        UsageError: it is not a transform, or is degenerate.
    """
    if transform is None:
        if crs is not None:
            raise UsageError("`crs` does not place an array without a transform.", remedy="Also give transform=.")
        if spacing is None:
            warnings.append(UNPLACED)
        elif not 0 < spacing < float("inf"):
            raise UsageError(f"The spacing must be a positive number of metres, not {spacing:g}.")
        step = 1.0 if spacing is None else float(spacing)
        return Affine(step, 0, 0, 0, -step, shape[0] * step)
    if spacing is not None:
        raise UsageError("Give transform or spacing, not both: each defines the distance between samples.")
    try:
        numbers = [float(v) for v in transform]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in (6, 9):
        raise UsageError(f"A transform must be an Affine, or its six numbers a, b, c, d, e, f, not {transform!r}.")
    if numbers[2] == numbers[4] == 0 != numbers[5] and numbers[0] != numbers[1] != 0:
        raise UsageError(
            f"The transform {tuple(numbers[:6])} has its numbers in GDAL's order.",
            remedy="Give transform=Affine.from_gdal(*numbers).",
        )
    found = Affine(*numbers[:6])
    if not np.isfinite(numbers).all() or found.determinant == 0:
        raise UsageError(f"The transform {tuple(numbers[:6])} is degenerate: its samples lie on a line or a point.")
    return found
