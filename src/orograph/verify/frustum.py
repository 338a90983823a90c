"""How a view sees samples: their place in front of the camera and on the screen, inside or outside the frustum.

A ``Camera`` is the view in sample coordinates: (x, y, w) = M · (column, row, height, 1), x right and y up on the
screen, w depth, in stretched metres; M includes the exaggeration and the grid's affine map. In perspective the screen
position is x / (s·w) pixels right of the centre, with s the view's pixel slope; in a plan x / (metres per pixel). Both
are written as x / (p0 + p1·w), and the sides of the frustum as |x| ≤ a0 + a1·w and |y| ≤ b0 + b1·w. This repeats the
definition in ``View.project`` and ``View.frustum`` for kernels.

Between a point of the ground and the one δ metres above it there are f·g pixels, f = |δ| / (w + c·δ), where (a, b, c)
is the change of (x, y, w) per metre of height, and g = |(a·w − c·x, b·w − c·y)| / (s·w): the speed at which the
vertical there passes over the screen. In a plan g is 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.geo.grid import Grid
from orograph.viewpoint import View

BEFORE = 16
"""The outcode of points before the near plane, or not in front of the eye."""


class Lens(NamedTuple):
    """A camera's numbers, for kernels (see the module's text); ``matrix`` is (3, 4) float64."""

    matrix: NDArray[np.float64]
    p0: float
    p1: float
    a0: float
    a1: float
    b0: float
    b1: float
    near: float
    far: float


@dataclass(frozen=True, slots=True)
class Camera:
    """A view over a grid.

    Attributes:
        lens: as kernels take it.
    """

    lens: Lens

    @classmethod
    def of(cls, view: View, grid: Grid, exaggeration: float) -> Camera:
        """The camera of a view over a grid."""
        a, b, c, d, e, f = grid.samples[:6]
        matrix = np.empty((3, 4))
        plan = view.projection == "plan"
        for i, axis in enumerate(view.axes(exaggeration)):
            x, y, z = (float(v) for v in axis)
            origin = view.target if plan and i < 2 else view.eye
            matrix[i, 0], matrix[i, 1], matrix[i, 2] = a * x + d * y, b * x + e * y, z * exaggeration
            matrix[i, 3] = (c - origin[0]) * x + (f - origin[1]) * y - origin[2] * z * exaggeration
        scale = view.pixel_metres if plan else view.pixel_slope
        half_x, half_y = scale * view.width / 2, scale * view.height / 2
        if view.part is not None:  # a tile of a picture, as if its own middle were straight ahead
            left, top, width, height = view.part
            aside = scale * (left + view.width / 2 - width / 2), scale * (height / 2 - top - view.height / 2)
            for i in (0, 1):
                matrix[i] -= np.array([0.0, 0.0, 0.0, aside[i]]) if plan else aside[i] * matrix[2]
        near, far = float(view.near), float(view.far)
        if plan:
            return cls(Lens(matrix, scale, 0.0, half_x, 0.0, half_y, 0.0, near, far))
        return cls(Lens(matrix, 0.0, scale, 0.0, half_x, 0.0, half_y, max(near, math.ulp(0.0)), far))

    def misses(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which boxes (…, 3) of column, row, height lie wholly beyond one side of the frustum."""
        lens, common = self.lens, np.full(low.shape[:-1], 63, np.uint8)
        for corner in range(8):
            pick = np.array([corner & 1, corner & 2, corner & 4], bool)
            x, y, w = np.moveaxis(np.where(pick, high, low) @ lens.matrix[:, :3].T + lens.matrix[:, 3], -1, 0)
            a, b = lens.a0 + lens.a1 * w, lens.b0 + lens.b1 * w
            tests = (x < -a, x > a, y < -b, y > b, w < lens.near, w > lens.far)
            common &= sum((t.astype(np.uint8) << i for i, t in enumerate(tests)), np.zeros_like(common))
        return np.asarray(common != 0)


@inlined
def place(lens, column, row, height):
    """(x, y, w) of a point."""
    matrix = lens.matrix
    x = matrix[0, 0] * column + matrix[0, 1] * row + matrix[0, 2] * height + matrix[0, 3]
    y = matrix[1, 0] * column + matrix[1, 1] * row + matrix[1, 2] * height + matrix[1, 3]
    w = matrix[2, 0] * column + matrix[2, 1] * row + matrix[2, 2] * height + matrix[2, 3]
    return x, y, w


@inlined
def outcode(lens, x, y, w):
    """The sides of the frustum beyond which a point lies, as bits (Cohen & Sutherland); 0: it is in view."""
    a, b = lens.a0 + lens.a1 * w, lens.b0 + lens.b1 * w
    code = 0
    if x < -a:
        code |= 1
    if x > a:
        code |= 2
    if y < -b:
        code |= 4
    if y > b:
        code |= 8
    if w < lens.near:
        code |= BEFORE
    if w > lens.far:
        code |= 32
    return code


@inlined
def side(lens, plane, x, y, w):
    """How far a point lies inside a side of the frustum; linear in the point."""
    if plane == 0:
        return x + lens.a0 + lens.a1 * w
    if plane == 1:
        return lens.a0 + lens.a1 * w - x
    if plane == 2:
        return y + lens.b0 + lens.b1 * w
    if plane == 3:
        return lens.b0 + lens.b1 * w - y
    if plane == 4:
        return w - lens.near
    return lens.far - w


@inlined
def drop_factor(lens, w, drop):
    """f (see the module) for a point of depth w and the one ``drop`` metres above it.

    Infinite if that one is beside or behind the eye.
    """
    above = w + lens.matrix[2, 2] * drop if lens.p1 > 0.0 else 1.0
    return abs(drop) / above if above > 0.0 else np.inf


@inlined
def pixel_factor(lens, x, y, w):
    """g (see the module)."""
    if lens.p1 == 0.0:
        return 0.0
    matrix = lens.matrix
    across, along = matrix[0, 2] * w - matrix[2, 2] * x, matrix[1, 2] * w - matrix[2, 2] * y
    return math.sqrt(across * across + along * along) / (lens.p1 * w)


@leaf
def polygon_in_view(lens, points, count, scratch):
    """Whether the convex polygon ``points[:count]`` (x, y, w) reaches into the frustum; overwrites both arrays.

    Sutherland & Hodgman's clipping against the six sides, each moved inward by a billionth of the polygon's distance,
    so that a polygon that only touches the frustum is not in view.
    """
    scale = 0.0
    for i in range(count):
        for j in range(3):
            scale = max(scale, abs(points[i, j]))
    margin = 1e-9 * scale
    for plane in range(6):
        if plane == 5 and lens.far == np.inf:
            break
        kept = 0
        for i in range(count):
            j = i + 1 if i + 1 < count else 0
            p = side(lens, plane, points[i, 0], points[i, 1], points[i, 2]) - margin
            q = side(lens, plane, points[j, 0], points[j, 1], points[j, 2]) - margin
            if p > 0.0:
                scratch[kept, 0], scratch[kept, 1], scratch[kept, 2] = points[i, 0], points[i, 1], points[i, 2]
                kept += 1
            if (p > 0.0) != (q > 0.0):
                t = p / (p - q)
                for axis in range(3):
                    scratch[kept, axis] = points[i, axis] + t * (points[j, axis] - points[i, axis])
                kept += 1
        count = kept
        if count == 0:
            return False
        for i in range(count):
            points[i, 0], points[i, 1], points[i, 2] = scratch[i, 0], scratch[i, 1], scratch[i, 2]
    return True
