"""The height of the horizon around every sample of a raster in memory: ``sweep`` on arrays.

Slopes are tangents of elevation angles above the raster's plane. Azimuths are degrees clockwise from (grid) north
towards the light. Lines, interpolation, missing samples and borders: see ``sweep``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from orograph.errors import UsageError
from orograph.lighting.sky import sky_view
from orograph.lighting.sweep import Block, fold, horizons
from orograph.lighting.sweep_lines import direction
from orograph.lighting.sweep_pass import Values

__all__ = ["direction", "horizon", "sky_view"]


def horizon(
    heights: ArrayLike,
    linear: ArrayLike,
    azimuth: float,
    *,
    lowest: float = 0.0,
    radius: float | None = None,
    curvature: float = 0.0,
    jobs: int | None = None,
) -> Values:
    """The slope of the horizon seen from every sample in one azimuth.

    Args:
        heights: (rows, cols), metres, NaN where missing.
        linear: (2, 2) linear part of the geotransform [[a, b], [d, e]]: metres east and north per column and per row.
        azimuth: degrees clockwise from north.
        lowest: the smallest slope: 0 is a level horizon, -inf allows negative slopes (-inf at the border).
        radius: metres beyond which nothing occludes; None: unlimited.
        curvature: of the body, per metre (``sweep.curvature_of``); 0: flat.
        jobs: threads; None: all processors.

    Returns:
        (rows, cols) float32, tangent of the elevation angle; NaN where heights are.

    Raises:
        UsageError: the shapes are wrong, or the cells degenerate.
    """
    surface = np.ascontiguousarray(heights, np.float32)
    if surface.ndim != 2 or surface.size == 0:
        raise UsageError(f"Horizons need heights of shape (rows, cols), not {surface.shape}.")
    out = np.empty(surface.shape, np.float32)
    blocks = horizons(
        lambda row0, row1, col0, col1: surface[row0:row1, col0:col1], (surface.shape[0], surface.shape[1]),
        np.asarray(linear, np.float64), np.array([azimuth], np.float64), lowest=lowest, radius=radius,
        curvature=curvature, jobs=jobs,
    )  # fmt: skip

    def keep(block: Block, first: int, last: int) -> None:
        out[block.row0 + first : block.row0 + last, block.col0 : block.col1] = block.slopes[0, first:last]

    fold(blocks, keep, jobs)
    return out
