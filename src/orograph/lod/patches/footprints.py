"""Which blocks of the screen patches may cover, from their prisms, which contain all of their vertices.

A prism is the patch's triangle (where it is squeezed onto the raster's last row or column, the rectangle around what is
left of it) between two heights. Its corners are projected in float64; what reaches the plane of the eye may lie
anywhere. Pixels, blocks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, read_only
from orograph.error.screen import camera_parameters
from orograph.geo.grid import Grid
from orograph.lod.patches.shape import STEPS
from orograph.viewpoint import Camera, View

Array = NDArray[np.float64]

MARGIN = 1.0
"""Pixels added all around: a sample may lie anywhere in its pixel, and shaders round."""


class Screen(NamedTuple):
    """A picture, or the part of one that is drawn, in blocks.

    Attributes:
        rows: (3, 4) float64, over (column, row, height, 1): w·x, w·y and w, x and y in pixels from the upper left.
        nearest: the least w of what is in front of the eye. side: pixels along a block.
        shape: rows and columns of blocks. pixels: float64 of that shape, the pixels of each.
    """

    rows: Array
    nearest: float
    side: int
    shape: tuple[int, int]
    pixels: Array

    @classmethod
    def of(cls, view: View, grid: Grid, exaggeration: float, side: int) -> Screen:
        """Of a view."""
        lens = camera_parameters(Camera.over(grid, view, exaggeration))
        plan = view.projection == "plan"
        left, top, width, height = view.frame
        w = np.array([0.0, 0.0, 0.0, 1.0] if plan else lens.depth)
        per_metre = 1.0 / (view.pixel_metres if plan else view.pixel_slope)
        rows = np.stack([
            np.multiply(lens.right, per_metre) + (width / 2 - left) * w,
            np.multiply(lens.up, -per_metre) + (height / 2 - top) * w, w,
        ])  # fmt: skip
        down, across = (-(-n // side) for n in (view.height, view.width))
        high, wide = (np.minimum(np.full(k, side), n - side * np.arange(k)) for k, n in
                      ((down, view.height), (across, view.width)))  # fmt: skip
        return cls(rows, 0.0 if plan else max(lens.near, 1e-3), side, (down, across), np.outer(high, wide) * 1.0)


def footprints(
    instances: NDArray[Any], spans: NDArray[np.float32], legs: int, last: tuple[int, int], screen: Screen
) -> NDArray[np.int64]:
    """The blocks that patches may lie over: (k, 4), first column, first row, and those after the last; none if empty.

    Args:
        instances: (k,) of ``shape.INSTANCE``. spans: (k, 2), metres between which their heights lie.
        legs: segments along a leg. last: the raster's last row and column.
    """
    found = np.empty((len(instances), 4), np.int64)
    fields = (read_only(np.ascontiguousarray(instances[name])) for name in ("row", "col", "omega", "step"))
    _find(*fields, read_only(np.ascontiguousarray(spans)), STEPS.astype(np.int64) * legs, last, screen.rows,
          screen.nearest, screen.side, screen.shape, found)  # fmt: skip
    return found


@inlined
def _clipped(edge, most):
    """A number of blocks, of at most so many; 0 if it is none."""
    return np.int64(min(edge, np.float64(most))) if edge > 0.0 else np.int64(0)


@inlined
def _corner(row, col, ways, s, n, last):
    """(row, column) of a patch's corner n of 4, float64: of its triangle, or of what is left where it is squeezed."""
    r1, c1, r2, c2 = row + (ways[0] << s), col + (ways[1] << s), row + (ways[2] << s), col + (ways[3] << s)
    bottom, right = max(row, r1, r2), max(col, c1, c2)
    if bottom > last[0] or right > last[1]:
        r = min(row, r1, r2) if n < 2 else bottom
        c = min(col, c1, c2) if n % 2 == 0 else right
        return np.float64(min(r, last[0])), np.float64(min(c, last[1]))
    r = row if n == 0 else r1 if n == 1 else r2
    c = col if n == 0 else c1 if n == 1 else c2
    return np.float64(r), np.float64(c)


@kernel
def _find(rows, cols, omegas, steps, spans, legs, last, m, nearest, side, shape, found):
    """``footprints``, patch by patch.

    Args:
        legs: int64 (8, 2, 2), by omega, the legs as (row, col), for s = 0. m, nearest, side, shape: of the screen.
        found: (k, 4), to be filled.
    """
    for k in range(len(rows)):
        row, col, s, o = np.int64(rows[k]), np.int64(cols[k]), np.int64(steps[k]), omegas[k]
        ways = legs[o, 0, 0], legs[o, 0, 1], legs[o, 1, 0], legs[o, 1, 1]
        x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
        anywhere = not (np.isfinite(spans[k, 0]) and np.isfinite(spans[k, 1]))
        for n in range(4):
            r, c = _corner(row, col, ways, s, n, last)
            for end in range(2):
                up = np.float64(spans[k, end])
                w = m[2, 0] * c + m[2, 1] * r + m[2, 3] + m[2, 2] * up
                if not w > nearest:
                    anywhere = True
                    break
                x = (m[0, 0] * c + m[0, 1] * r + m[0, 3] + m[0, 2] * up) / w
                y = (m[1, 0] * c + m[1, 1] * r + m[1, 3] + m[1, 2] * up) / w
                x0, y0, x1, y1 = min(x0, x), min(y0, y), max(x1, x), max(y1, y)
        if anywhere:
            found[k, 0], found[k, 1], found[k, 2], found[k, 3] = 0, 0, shape[1], shape[0]
            continue
        found[k, 0] = _clipped(np.floor((x0 - MARGIN) / side), shape[1])
        found[k, 1] = _clipped(np.floor((y0 - MARGIN) / side), shape[0])
        found[k, 2] = _clipped(np.floor((x1 + MARGIN) / side) + 1.0, shape[1])
        found[k, 3] = _clipped(np.floor((y1 + MARGIN) / side) + 1.0, shape[0])
