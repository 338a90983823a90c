"""Which blocks of the screen patches may cover, from their prisms, which contain all of their vertices.

A prism is the patch's triangle (where it is squeezed onto the raster's last row or column, the rectangle around what is
left of it) between two heights. Its corners are projected in float64; what reaches the plane of the eye may lie
anywhere. Pixels, blocks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    omega, step = instances["omega"], instances["step"].astype(np.int64)
    places = []  # rows and columns of four corners, the last two the same unless squeezed: (4, k)
    for axis, name in enumerate(("row", "col")):
        apex = instances[name].astype(np.int64)
        ends = [apex + (legs * STEPS[omega, e, axis].astype(np.int64) << step) for e in range(2)]
        places.append(np.stack([apex, *ends, ends[1]]))
    squeezed = (places[0].max(0) > last[0]) | (places[1].max(0) > last[1])
    if squeezed.any():
        for place, end, which in zip(places, last, ([0, 0, 1, 1], [0, 1, 0, 1]), strict=True):
            some = np.minimum(place[:, squeezed], end)
            place[:, squeezed] = np.stack([some.min(0), some.max(0)])[which]
    m, flat, up = screen.rows, [], spans.astype(np.float64).T[:, None]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for n in range(3):
            ground = m[n, 0] * places[1] + m[n, 1] * places[0] + m[n, 3]
            flat.append((ground + m[n, 2] * up).reshape(8, -1))
        x, y, w = flat
        anywhere = ~(w.min(0) > screen.nearest) | ~np.isfinite(spans).all(1)
        x, y = x / w, y / w
        edges = np.stack([x.min(0) - MARGIN, y.min(0) - MARGIN, x.max(0) + MARGIN, y.max(0) + MARGIN]) / screen.side
        most = np.array([*screen.shape[::-1], *screen.shape[::-1]])[:, None]
        ends = np.floor(edges) + np.array([[0], [0], [1], [1]])
        found: NDArray[np.int64] = np.clip(np.nan_to_num(ends), 0, most).astype(np.int64).T
    found[anywhere] = 0, 0, *screen.shape[::-1]
    return found
