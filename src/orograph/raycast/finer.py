"""Which tiles of a level a view needs finer (``raycast.select``), tile by tile; and what kernels ask of a tile's box.

Boxes are west, east, north, south in samples of the full resolution, and two heights.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel


class Eye(NamedTuple):
    """Where a view is seen from, and what is too coarse for it.

    Attributes:
        planes: (m, 4) of the frustum, over column, row and height. place: column, row, height.
        scale: metres per column and row, and the exaggeration.
        pixel: metres across a pixel at unit distance, or anywhere in a plan. off_axis: ``select.off_axis``.
        near: metres; what is nearer counts as this far.
        plan: whether it is one. by_error: see ``select.rectangles``. tolerance: pixels.
    """

    planes: NDArray[np.float64]
    place: tuple[float, float, float]
    scale: tuple[float, float, float]
    pixel: float
    off_axis: float
    near: float
    plan: bool
    by_error: bool
    tolerance: float


@inlined
def in_view(planes, west, east, north, south, low, high):
    """Whether a box is not wholly outside one plane (m, 4) over column, row and height."""
    for k in range(planes.shape[0]):
        # The box's most positive corner decides.
        a, b, c, d = planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3]
        reach = d + a * (east if a > 0 else west) + b * (south if b > 0 else north) + c * (high if c > 0 else low)
        if reach < 0.0:
            return False
    return True


@inlined
def distance(place, scale, west, east, north, south, low, high):
    """A lower bound of the distance from a place to a box, metres of stretched space."""
    dx = max(max(west - place[0], place[0] - east), 0.0) * scale[0]
    dy = max(max(north - place[1], place[1] - south), 0.0) * scale[1]
    dz = max(max(low - place[2], place[2] - high), 0.0) * scale[2]
    return np.sqrt(dx * dx + dy * dy + dz * dz)


@inlined
def too_coarse(eye, error, partly, size, d):
    """Whether a tile in view is too coarse.

    Args:
        error: metres. partly: whether part of the tile is missing. size: metres between its samples. d: its distance.
    """
    if eye.plan:
        return (partly or not eye.by_error) and size / eye.pixel > eye.tolerance
    samples = size / eye.pixel / max(d, eye.near, 1e-9)
    if not eye.by_error:
        return samples > eye.tolerance
    if partly and 0.5 * samples > eye.tolerance:
        return True
    moved, d = error * eye.scale[2], max(d, eye.near)
    if moved > 0.0:
        return d <= moved or 1.0 / eye.pixel * moved / ((d - moved) * eye.off_axis) > eye.tolerance
    return False


@kernel
def needed(lowest, highest, errors, valid, part, step, size, last, eye):
    """The first and last row and column of the tiles of a part that must be drawn finer; row −1 if there are none.

    Args:
        lowest, highest, errors: float32, valid: uint8, (rows, cols) of tiles, as in ``TileTable``.
        part: first row, end row, first column, end column. step: samples of the full resolution along a tile.
        size: metres between a tile's samples. last: the last sample's row and column. eye: ``Eye``. Float64 all of it.
    """
    row0, row1, col0, col1 = -1, -1, part[3], part[2] - 1
    for i in range(part[0], part[1]):
        north, south = i * step, min(i * step + step, last[0])
        for j in range(part[2], part[3]):
            if row1 == i and col0 <= j <= col1:
                continue  # it is among them already
            low, high = np.float64(lowest[i, j]), np.float64(highest[i, j])
            if not np.isfinite(high):
                continue
            west, east = j * step, min(j * step + step, last[1])
            if not in_view(eye.planes, west, east, north, south, low, high):
                continue
            d = distance(eye.place, eye.scale, west, east, north, south, low, high)
            if too_coarse(eye, np.float64(errors[i, j]), valid[i, j] == 1, size, d):
                row0, row1 = i if row0 < 0 else row0, i
                col0, col1 = min(col0, j), max(col1, j)
    return row0, row1, col0, col1
