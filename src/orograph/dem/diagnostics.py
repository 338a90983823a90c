"""Warnings about contradictions within an opened file or with its companion files."""

from __future__ import annotations

from typing import Any

from pyproj import CRS

from orograph.dem import beside, geotiff, virtual_bands
from orograph.dem.header import vertical_axis
from orograph.dem.missing import impossible_nodata


def diagnose(
    dataset: Any, band: int, *, nodata: float | str | None, unit: str | None, masked: bool, crs: CRS | None
) -> list[str]:
    """Warnings about a dataset.

    Args:
        dataset: of rasterio, open.
        band: of the heights, from 1.
        nodata, unit: that a user states for it; None: none.
        masked: whether a mask or an alpha band says what is missing.
        crs: its own, perhaps compound.

    Raises:
        ReadError: what it says cannot be.
    """
    axis = vertical_axis(crs) if unit is None else None
    metres = None if axis is None else float(axis.unit_conversion_factor)
    given = "" if nodata is None else str(nodata)
    return [
        *impossible_nodata(dataset, band, given, "The nodata value that was given"),
        *geotiff.diagnose(dataset, band, nodata, masked, metres),
        *beside.diagnose(dataset, band),
        *virtual_bands.diagnose(dataset, band, nodata=nodata, unit=unit, masked=masked, crs=crs),
    ]
