"""The loops of a best view: how well cameras show pieces, and how high over a place an eye must be to see one.

What stands between a piece and an eye is found by ``measuring``'s walk along a line of sight over the surface, with a
pyramid of maxima: it gives the least height over the eye's place from which the line is clear, so one walk serves all
cameras there. What hides a camera at one height hides all below it.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.measuring.viewshed_kernels import along

LEAST = 1e-4
"""Metres by which ground must stand above a line of sight to hide: less is rounding."""


@inlined
def quality(eye, axes, slopes, fitting, point, kind, axis):
    """q of a piece in a camera's picture if nothing hides it, 0 to 1, but for its light (docs/best-view.md)."""
    dx, dy, dz = point[0] - eye[0], point[1] - eye[1], point[2] - eye[2]
    depth = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
    across = abs(axes[0, 0] * dx + axes[0, 1] * dy)
    above = abs(axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz)
    q = 0.0
    if depth > 0.0 and across <= slopes[0] * depth and above <= slopes[1] * depth:
        far2 = dx * dx + dy * dy + dz * dz
        far = np.sqrt(far2)
        near = min(1.0, fitting / far)
        facing = (axis[0] * dx + axis[1] * dy + axis[2] * dz) / far
        if kind == 2:
            q = max(-facing, 0.0) * near * near
        elif kind == 1:
            q = np.sqrt(max(1.0 - facing * facing, 0.0)) * near
        else:
            q = near
    return q


@kernel
def values(eyes, axes, slopes, fitting, points, kind, axis, weight, best, needed, first, last, out):
    """What cameras [first, last) add to what is seen already: Σ weight·max(q − best, 0) over the pieces they see.

    Args:
        weight: (n,) of the pieces, times their light. best: (n,) the largest q so far.
        needed: (n,) the height over the place from which each piece is seen; −inf where that is not known: an upper
            bound results.
        out: (last − first,) float64.
    """
    for m in range(first, last):
        s = 0.0
        for i in range(points.shape[0]):
            if eyes[m, 2] >= needed[i]:
                q = quality(eyes[m], axes[m], slopes[m], fitting[m], points[i], kind[i], axis[i])
                s += weight[i] * max(q - best[i], 0.0)
        out[m - first] = s


@kernel
def look(
    z, maxima, offset, per_row, at, place, lowest, heights, order, a, b,
    eyes, axes, slopes, fitting, points, kind, axis, weight, best, needed, first, last, out,
):  # fmt: skip
    """Find ``needed`` of pieces order[a:b] from one place, and take what its cameras do not see from their values.

    Args:
        z, maxima, offset, per_row: heights (``MISSING`` in holes) and their pyramid.
        at: (n, 2) column and row of the pieces in z; place: (2,) those of the place.
        lowest: height of the place's lowest camera. heights: (n,) what is looked at: the pieces, or what stands there.
        out: (last − first,) the values, an upper bound before and after.
    """
    nr, nc = z.shape[0] - 1, z.shape[1] - 1
    for k in range(a, b):
        i = order[k]
        h, _ = along(
            z, maxima, offset, per_row, nc, nr, at[i, 0], at[i, 1], heights[i], place[0], place[1], lowest, LEAST, False
        )
        needed[i] = h
        if h > lowest:
            for m in range(first, last):
                if eyes[m, 2] < h:
                    q = quality(eyes[m], axes[m], slopes[m], fitting[m], points[i], kind[i], axis[i])
                    out[m - first] -= weight[i] * max(q - best[i], 0.0)


@kernel
def shown(eye, axes, slopes, fitting, points, kind, axis, height, needed, out):
    """(n,) q of the pieces that one camera sees; −1 of those that are hidden or beside its picture."""
    for i in range(points.shape[0]):
        q = quality(eye, axes, slopes, fitting, points[i], kind[i], axis[i])
        out[i] = q if q > 0.0 and height >= needed[i] else -1.0


@kernel
def lit(z, maxima, offset, per_row, at, heights, step, rise, out):
    """Whether the sun reaches pieces: 1 or 0. step: (2,) columns and rows towards it, as far as ``rise`` metres up."""
    nr, nc = z.shape[0] - 1, z.shape[1] - 1
    for i in range(at.shape[0]):
        end = heights[i] + rise
        h, _ = along(
            z, maxima, offset, per_row, nc, nr, at[i, 0], at[i, 1], heights[i], at[i, 0] + step[0], at[i, 1] + step[1],
            end, LEAST, True,
        )  # fmt: skip
        out[i] = 1.0 if h <= end else 0.0
