"""The loops of a best view: how well cameras show pieces, and how high above a place an eye must be to see one.

Ground between a piece and an eye is found by ``measuring``'s walk along a line of sight over the surface, with a
pyramid of maxima: it gives the smallest height above the eye's place from which the line is clear, so one walk serves
all cameras there. A piece hidden from one height is hidden from all heights below it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.measuring.viewshed_kernels import INF, along

PARTS, LEAST_PART = 12, 48
"""In how many parts a place's pieces are tested, and how many pieces a part has at least."""
LEAST = 1e-4
"""Metres by which ground must rise above a line of sight to hide: less is rounding."""


class Pieces(NamedTuple):
    """The pieces of a target.

    Attributes:
        points, axis: (3, n). spans: (4,) the first piece of each kind, and n. weight: (n,), times their light.
    """

    points: NDArray[Any]
    spans: NDArray[np.int64]
    axis: NDArray[Any]
    weight: NDArray[Any]


@inlined
def camera(cameras, m):
    """The numbers of camera m for ``quality``. cameras: (14, m), ``best_cameras.Cameras.numbers``."""
    return (
        cameras[0, m], cameras[1, m], cameras[2, m], cameras[3, m], cameras[4, m], cameras[5, m], cameras[6, m],
        cameras[7, m], cameras[8, m], cameras[9, m], cameras[10, m], cameras[11, m], cameras[12, m], cameras[13, m],
    )  # fmt: skip


@inlined
def quality(cam, points, axis, i, kind, zero, one):
    """q of piece i in a camera's picture if nothing hides it, 0 to 1, without its light (docs/best-view.md).

    There are no branches, ``kind`` is a constant where it matters, and ``i`` is unsigned (a negative index would count
    from the end), so that loops over pieces are vectorised. ``zero`` and ``one`` have the numbers' type.
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
def qualities(cameras, m, pieces, out):
    """``quality`` of all ``Pieces`` for camera m; out: (n,)."""
    points, spans, axis, _ = pieces
    cam = camera(cameras, m)
    for i in range(np.uint64(spans[0]), np.uint64(spans[1])):
        out[i] = quality(cam, points, axis, i, 0, 0.0, 1.0)
    for i in range(np.uint64(spans[1]), np.uint64(spans[2])):
        out[i] = quality(cam, points, axis, i, 1, 0.0, 1.0)
    for i in range(np.uint64(spans[2]), np.uint64(spans[3])):
        out[i] = quality(cam, points, axis, i, 2, 0.0, 1.0)


@kernel
def values(cameras, pieces, best, needed, first, last, out):
    """The gain of cameras [first, last): Σ weight·max(q − best, 0) over the pieces they see.

    Args:
        best: (n,) the largest q so far.
        needed: (n,) the height above the place from which each piece is visible; −inf where it is unknown, which gives
            an upper bound.
        out: (last − first,) float64.
    """
    weight = pieces.weight
    q = np.empty(len(weight))
    for m in range(first, last):
        qualities(cameras, m, pieces, q)
        height = cameras[2, m]
        for i in range(len(q)):
            more = weight[i] * max(q[i] - best[i], 0.0)
            q[i] = more if height >= needed[i] else 0.0
        s = 0.0
        for i in range(len(q)):
            s += q[i]
        out[m - first] = s


@kernel
def ceilings(cameras, pieces, starts, out):
    """Upper bounds of what the best camera of each place shows: its picture without occlusion; float32 arrays.

    Args:
        cameras, pieces: places relative to the target's middle; slopes, fitting slightly too large, because of
        rounding.
        starts: (places + 1,) the first camera of each. out: (places,) float64.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    points, spans, axis, weight = pieces
    q = np.empty(points.shape[1], np.float32)
    for p in range(len(starts) - 1):
        most = zero
        for m in range(starts[p], starts[p + 1]):
            cam = camera(cameras, m)
            for i in range(np.uint64(spans[0]), np.uint64(spans[1])):
                q[i] = weight[i] * quality(cam, points, axis, i, 0, zero, one)
            for i in range(np.uint64(spans[1]), np.uint64(spans[2])):
                q[i] = weight[i] * quality(cam, points, axis, i, 1, zero, one)
            for i in range(np.uint64(spans[2]), np.uint64(spans[3])):
                q[i] = weight[i] * quality(cam, points, axis, i, 2, zero, one)
            n = np.uint64(len(q))
            while n > 1:  # in pairs: rounding stays below ``WIDER``, and the loop is vectorised
                half = (n + np.uint64(1)) // np.uint64(2)
                for i in range(n - half):
                    q[i] += q[half + i]
                n = half
            most = max(most, q[0])
        out[p] = most


@inlined
def hide(cameras, points, axis, i, kind, height, weight, best, first, out):
    """Subtract a piece from the values of the cameras, from number ``first`` on, that are below a height."""
    for k in range(np.uint64(out.shape[0])):
        m = np.uint64(first) + k
        q = quality(camera(cameras, m), points, axis, i, kind, 0.0, 1.0)
        less = weight * max(q - best, 0.0)
        out[k] -= less if cameras[2, m] < height else 0.0


@kernel
def look(pyramid, at, heights, which, done, place, cameras, pieces, best, needed, first, last, rival, out):
    """Find ``needed`` of pieces from one place, and subtract those that its cameras do not see, in parts.

    It ends when all pieces are known, or no camera of the place may be as good as the rival.

    Args:
        pyramid: ``Pyramid`` of heights. at: (n, 2) column and row of the pieces in it.
        heights: (n,) of the points to see: the pieces, or targets standing there.
        which: (n,) the order of the pieces, the first ``done`` of which are known. place: column and row.
        needed: written; inf where no camera is high enough. rival: the next place's bound.
        out: (last − first,) the values, an upper bound before and after.

    Returns:
        The number of pieces that are known, and the largest value.
    """
    points, spans, axis, weight = pieces
    lowest, highest = INF, -INF
    for m in range(first, last):
        lowest, highest = min(lowest, cameras[2, m]), max(highest, cameras[2, m])
    bound = out.max()
    part = max(-(-len(which) // PARTS), LEAST_PART)
    while done < len(which):
        for i in which[done : done + part]:
            piece = at[i, 0], at[i, 1], heights[i]
            h, _ = along(pyramid, piece, (place[0], place[1], lowest), LEAST, highest)
            needed[i] = h
            if h <= lowest:
                continue
            k = np.uint64(i)
            if i >= spans[2]:
                hide(cameras, points, axis, k, 2, h, weight[i], best[i], first, out)
            elif i >= spans[1]:
                hide(cameras, points, axis, k, 1, h, weight[i], best[i], first, out)
            else:
                hide(cameras, points, axis, k, 0, h, weight[i], best[i], first, out)
        done = min(done + part, len(which))
        bound = out.max()
        if bound < rival:
            break
    return done, bound


@kernel
def lit(pyramid, at, heights, step, rise, out):
    """Whether the sun reaches pieces: 1 or 0. step: (2,) columns and rows towards it, as far as ``rise`` metres up."""
    for i in range(at.shape[0]):
        end = heights[i] + rise
        start, sun = (at[i, 0], at[i, 1], heights[i]), (at[i, 0] + step[0], at[i, 1] + step[1], end)
        h, _ = along(pyramid, start, sun, LEAST, -INF)
        out[i] = 1.0 if h <= end else 0.0
