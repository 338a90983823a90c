"""The camera as shaders see it: axes and focal lengths, and the eye split into whole cells and a remainder.

All differences between large coordinates are taken here in float64; on the GPU every position is relative to the eye. A
mesh vertex is exactly a whole number of cells away from the eye's cell, whichever tile it comes from; so meshes have no
cracks, and a camera moving by a millimetre moves the picture by exactly that.
"""

from __future__ import annotations

import math
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from orograph.store.terrain import Terrain
from orograph.viewpoint import View

CAMERA = np.dtype(
    [
        ("right", "<f4", 4), ("up", "<f4", 4), ("forward", "<f4", 4), ("linear", "<f4", 4), ("inverse", "<f4", 4),
        ("eye_frac", "<f4", 2), ("centre", "<f4", 2), ("eye_cell", "<i4", 2), ("last", "<i4", 2),
        ("eye_height", "<f4", 2), ("near", "<f4"), ("far", "<f4"), ("size", "<f4", 2), ("plan", "<u4"),
        ("pixel", "<f4"), ("shift", "<f4", 2), ("pad", "<u4", 2),
    ]
)  # fmt: skip
"""The uniform ``Camera`` of ``shaders/camera.wgsl``."""

_PACKED = Struct("<24f4i6fIf2f8x")
"""The same, packed at once rather than field by field, since a frame has little time."""


def nearest(view: View) -> float:
    """Nothing nearer than this is drawn, metres: reversed depth only needs it to be greater than 0."""
    return max(view.near, 0.02)


Numbers = tuple[float, ...]


def axes_of(
    view: View, exaggeration: float, shift: tuple[float, float] = (0.0, 0.0)
) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """The part of the uniform that describes the projection: right and up, each with its fourth number, forward,
    centre."""
    right, up, forward = view.plain_axes(exaggeration)
    left, top, width, height = view.frame
    pixel = view.pixel_metres if view.projection == "plan" else view.pixel_slope
    # The optical axis in the target, from its left upper corner; a sample lies ``shift`` from its pixel's centre.
    x, y = width / 2 - left - shift[0], height / 2 - top - shift[1]
    centre = 2 * x / view.width - 1, 1 - 2 * y / view.height
    return (*right, 2.0 / (view.width * pixel)), (*up, 2.0 / (view.height * pixel)), forward, centre


def camera_of(
    view: View, terrain: Terrain, exaggeration: float, *, shift: tuple[float, float] = (0.0, 0.0)
) -> NDArray[np.void]:
    """The uniform for a view of a terrain.

    Args:
        shift: where in a pixel its sample lies, pixels from its centre (jitter).
    """
    grid = terrain.grid
    right, up, forward, centre = axes_of(view, exaggeration, shift)
    plan = view.projection == "plan"
    pixel = view.pixel_metres if plan else view.pixel_slope
    (a, b), (d, e) = terrain.chart.linear.tolist()
    area = a * e - b * d
    col, row = (float(v) for v in grid.index(*(view.target if plan else view.eye)[:2]))
    high = float(np.float32(view.eye[2]))
    near, far = nearest(view), 0.0
    if plan:
        low, top_height = terrain.height_range
        near = max(view.near, (view.eye[2] - top_height) * exaggeration - 1.0)
        far = min(view.far, (view.eye[2] - low) * exaggeration + 1.0)
    packed = _PACKED.pack(
        *right, *up, *forward, exaggeration,
        a, b, d, e, e / area, -b / area, -d / area, a / area,
        col - math.floor(col), row - math.floor(row), *centre,
        math.floor(col), math.floor(row), grid.cols - 1, grid.rows - 1, high, view.eye[2] - high, near, far,
        view.width, view.height, plan, pixel, *shift,
    )  # fmt: skip
    out: NDArray[np.void] = np.frombuffer(packed, CAMERA).reshape(())
    return out
