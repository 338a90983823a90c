"""What a view sees of the samples: their place before the camera, on the screen, inside or outside the frustum.

A ``Camera`` is the view in sample coordinates: (x, y, w) = M · (column, row, height, 1), x right and y up on the
screen, w depth, in stretched metres; the exaggeration and the grid's affine map are in M. In perspective the screen
position is x / (s·w) pixels right of the centre, with s the view's pixel slope; in a plan x / (metres per pixel). Both
are written as x / (p0 + p1·w), and the sides of what is seen as |x| ≤ a0 + a1·w and |y| ≤ b0 + b1·w.

This is the definition in ``View.project`` and ``View.frustum`` written down a second time, for kernels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.geo.grid import Grid
from orograph.viewpoint import View

P0, P1, A0, A1, B0, B1, NEAR, FAR = range(8)
"""Entries of a lens."""

BEFORE = 16
"""The outcode of what lies nearer than the near plane, or not in front of the eye."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A view as kernels take it.

    Attributes:
        matrix: (3, 4) float64, (column, row, height, 1) → (x, y, w).
        lens: (8,) float64: p0, p1, a0, a1, b0, b1, near, far.
    """

    matrix: NDArray[np.float64]
    lens: NDArray[np.float64]

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
        if view.part is not None:  # a tile of a picture: seen as if its own middle was straight ahead
            left, top, width, height = view.part
            aside = scale * (left + view.width / 2 - width / 2), scale * (height / 2 - top - view.height / 2)
            for i in (0, 1):
                matrix[i] -= np.array([0.0, 0.0, 0.0, aside[i]]) if plan else aside[i] * matrix[2]
        if plan:
            lens = [scale, 0.0, half_x, 0.0, half_y, 0.0, view.near, view.far]
        else:
            lens = [0.0, scale, 0.0, half_x, 0.0, half_y, max(view.near, math.ulp(0.0)), view.far]
        return cls(matrix, np.array(lens))

    def misses(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which boxes (…, 3) of column, row, height lie wholly beyond one side of the frustum."""
        common = np.full(low.shape[:-1], 63, np.uint8)
        for corner in range(8):
            pick = np.array([corner & 1, corner & 2, corner & 4], bool)
            x, y, w = np.moveaxis(np.where(pick, high, low) @ self.matrix[:, :3].T + self.matrix[:, 3], -1, 0)
            a, b = self.lens[A0] + self.lens[A1] * w, self.lens[B0] + self.lens[B1] * w
            tests = (x < -a, x > a, y < -b, y > b, w < self.lens[NEAR], w > self.lens[FAR])
            common &= sum((t.astype(np.uint8) << i for i, t in enumerate(tests)), np.zeros_like(common))
        return np.asarray(common != 0)


@inlined
def place(matrix, column, row, height):
    """(x, y, w) of a point."""
    x = matrix[0, 0] * column + matrix[0, 1] * row + matrix[0, 2] * height + matrix[0, 3]
    y = matrix[1, 0] * column + matrix[1, 1] * row + matrix[1, 2] * height + matrix[1, 3]
    w = matrix[2, 0] * column + matrix[2, 1] * row + matrix[2, 2] * height + matrix[2, 3]
    return x, y, w


@inlined
def outcode(lens, x, y, w):
    """The sides of the frustum beyond which a point lies, a bit each (Cohen & Sutherland); 0: it is in view."""
    a, b = lens[A0] + lens[A1] * w, lens[B0] + lens[B1] * w
    code = 0
    if x < -a:
        code |= 1
    if x > a:
        code |= 2
    if y < -b:
        code |= 4
    if y > b:
        code |= 8
    if w < lens[NEAR]:
        code |= BEFORE
    if w > lens[FAR]:
        code |= 32
    return code


@inlined
def side(lens, plane, x, y, w):
    """How far a point lies inside a side of the frustum; linear in the point."""
    if plane == 0:
        return x + lens[A0] + lens[A1] * w
    if plane == 1:
        return lens[A0] + lens[A1] * w - x
    if plane == 2:
        return y + lens[B0] + lens[B1] * w
    if plane == 3:
        return lens[B0] + lens[B1] * w - y
    if plane == 4:
        return w - lens[NEAR]
    return lens[FAR] - w


@leaf
def polygon_in_view(lens, points, count, scratch):
    """Whether the convex polygon ``points[:count]`` (x, y, w) reaches into the frustum; both arrays are overwritten.

    Sutherland & Hodgman's clipping against the six sides, each moved inward by a billionth of the polygon's distance,
    so that what merely touches the frustum is not in view.
    """
    scale = 0.0
    for i in range(count):
        for j in range(3):
            scale = max(scale, abs(points[i, j]))
    margin = 1e-9 * scale
    for plane in range(6):
        if plane == 5 and lens[FAR] == np.inf:
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
