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
def camera(eyes, axes, slopes, fitting, m):
    """The numbers of camera m that ``quality`` takes."""
    return (
        eyes[m, 0], eyes[m, 1], eyes[m, 2], axes[m, 0, 0], axes[m, 0, 1], axes[m, 1, 0], axes[m, 1, 1], axes[m, 1, 2],
        axes[m, 2, 0], axes[m, 2, 1], axes[m, 2, 2], slopes[m, 0], slopes[m, 1], fitting[m],
    )  # fmt: skip


@inlined
def quality(cam, points, axis, i, kind, zero, one):
    """q of piece i in a camera's picture if nothing hides it, 0 to 1, but for its light (docs/best-view.md).

    There are no branches, ``kind`` is a constant where it counts, and ``i`` unsigned (a negative index would count from
    the end), so that loops over pieces become vector instructions. ``zero`` and ``one`` are of the numbers' type.
    """
    ex, ey, ez, rx, ry, ux, uy, uz, fx, fy, fz, tx, ty, fit = cam
    dx, dy, dz = points[0, i] - ex, points[1, i] - ey, points[2, i] - ez
    depth = fx * dx + fy * dy + fz * dz
    across, above = abs(rx * dx + ry * dy), abs(ux * dx + uy * dy + uz * dz)
    inside = (depth > zero) & (across <= tx * depth) & (above <= ty * depth)
    near = one / np.sqrt(dx * dx + dy * dy + dz * dz)
    facing = (axis[0, i] * dx + axis[1, i] * dy + axis[2, i] * dz) * near
    near = min(one, fit * near)
    if kind == 2:
        q = max(-facing, zero) * near * near
    elif kind == 1:
        q = np.sqrt(max(one - facing * facing, zero)) * near
    else:
        q = near
    return q if inside else zero


@kernel
def qualities(eyes, axes, slopes, fitting, m, points, spans, axis, out):
    """``quality`` of all pieces for camera m.

    Args:
        points, axis: (3, n); spans: (4,) the first piece of each kind, and n.
        out: (n,).
    """
    cam = camera(eyes, axes, slopes, fitting, m)
    for i in range(np.uint64(spans[0]), np.uint64(spans[1])):
        out[i] = quality(cam, points, axis, i, 0, 0.0, 1.0)
    for i in range(np.uint64(spans[1]), np.uint64(spans[2])):
        out[i] = quality(cam, points, axis, i, 1, 0.0, 1.0)
    for i in range(np.uint64(spans[2]), np.uint64(spans[3])):
        out[i] = quality(cam, points, axis, i, 2, 0.0, 1.0)


@kernel
def values(eyes, axes, slopes, fitting, points, spans, axis, weight, best, needed, first, last, out):
    """What cameras [first, last) add to what is seen already: Σ weight·max(q − best, 0) over the pieces they see.

    Args:
        weight: (n,) of the pieces, times their light. best: (n,) the largest q so far.
        needed: (n,) the height over the place from which each piece is seen; −inf where that is not known: an upper
            bound results.
        out: (last − first,) float64.
    """
    q = np.empty(points.shape[1])
    for m in range(first, last):
        qualities(eyes, axes, slopes, fitting, m, points, spans, axis, q)
        height = eyes[m, 2]
        for i in range(len(q)):
            more = weight[i] * max(q[i] - best[i], 0.0)
            q[i] = more if height >= needed[i] else 0.0
        s = 0.0
        for i in range(len(q)):
            s += q[i]
        out[m - first] = s


@kernel
def ceilings(eyes, axes, slopes, fitting, points, spans, axis, weight, starts, out):
    """Upper bounds of what the best camera of each place shows: what is in its picture, hidden or not; float32 arrays.

    Args:
        eyes, points: counted from the target's middle. slopes, fitting: a little too large, for the rounding.
        starts: (places + 1,) the first camera of each. out: (places,) float64.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    n = points.shape[1]
    q = np.zeros(n + 3, np.float32)
    for p in range(len(starts) - 1):
        most = 0.0
        for m in range(starts[p], starts[p + 1]):
            cam = camera(eyes, axes, slopes, fitting, m)
            for i in range(np.uint64(spans[0]), np.uint64(spans[1])):
                q[i] = weight[i] * quality(cam, points, axis, i, 0, zero, one)
            for i in range(np.uint64(spans[1]), np.uint64(spans[2])):
                q[i] = weight[i] * quality(cam, points, axis, i, 1, zero, one)
            for i in range(np.uint64(spans[2]), np.uint64(spans[3])):
                q[i] = weight[i] * quality(cam, points, axis, i, 2, zero, one)
            a = b = c = d = 0.0
            for i in range(0, n, 4):
                a, b, c, d = a + q[i], b + q[i + 1], c + q[i + 2], d + q[i + 3]
            most = max(most, a + b + c + d)
        out[p] = most


@kernel
def look(
    z, maxima, offset, per_row, at, place, lowest, heights, order, a, b,
    eyes, axes, slopes, fitting, points, spans, axis, weight, best, needed, first, last, out,
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
            kind = 0 if i < spans[1] else 1 if i < spans[2] else 2
            for m in range(first, last):
                if eyes[m, 2] < h:
                    q = quality(camera(eyes, axes, slopes, fitting, m), points, axis, i, kind, 0.0, 1.0)
                    out[m - first] -= weight[i] * max(q - best[i], 0.0)


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
