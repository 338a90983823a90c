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
from orograph.measuring.viewshed_kernels import along

LEAST = 1e-4
"""Metres by which ground must rise above a line of sight to hide: less is rounding."""


class Pinholes(NamedTuple):
    """All cameras (n,): ``best_cameras.Cameras`` has their eyes (n, 3), axes (n, 3, 3), slopes (n, 2) and fitting."""

    eyes: NDArray[Any]
    axes: NDArray[Any]
    slopes: NDArray[Any]
    fitting: NDArray[Any]


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
    """The numbers of camera m for ``quality``."""
    eyes, axes, slopes, fitting = cameras
    return (
        eyes[m, 0], eyes[m, 1], eyes[m, 2], axes[m, 0, 0], axes[m, 0, 1], axes[m, 1, 0], axes[m, 1, 1], axes[m, 1, 2],
        axes[m, 2, 0], axes[m, 2, 1], axes[m, 2, 2], slopes[m, 0], slopes[m, 1], fitting[m],
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
    """``quality`` of all ``Pieces`` for camera m of ``Pinholes``; out: (n,)."""
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
        height = cameras.eyes[m, 2]
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
    n = points.shape[1]
    q = np.zeros(n + 3, np.float32)
    for p in range(len(starts) - 1):
        most = 0.0
        for m in range(starts[p], starts[p + 1]):
            cam = camera(cameras, m)
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
def look(pyramid, at, heights, which, place, cameras, pieces, best, needed, first, last, out):
    """Find ``needed`` of the pieces ``which`` from one place, and subtract those that its cameras do not see.

    Args:
        pyramid: ``Pyramid`` of heights. at: (n, 2) column and row of the pieces in it.
        heights: (n,) of the points to see: the pieces, or targets standing there.
        place: column, row and height of the place's lowest camera.
        out: (last − first,) the values, an upper bound before and after.
    """
    points, spans, axis, weight = pieces
    eyes, lowest = cameras.eyes, place[2]
    for i in which:
        h, _ = along(pyramid, (at[i, 0], at[i, 1], heights[i]), place, LEAST, False)
        needed[i] = h
        if h > lowest:
            kind = 0 if i < spans[1] else 1 if i < spans[2] else 2
            for m in range(first, last):
                if eyes[m, 2] < h:
                    q = quality(camera(cameras, m), points, axis, i, kind, 0.0, 1.0)
                    out[m - first] -= weight[i] * max(q - best[i], 0.0)


@kernel
def lit(pyramid, at, heights, step, rise, out):
    """Whether the sun reaches pieces: 1 or 0. step: (2,) columns and rows towards it, as far as ``rise`` metres up."""
    for i in range(at.shape[0]):
        end = heights[i] + rise
        start, sun = (at[i, 0], at[i, 1], heights[i]), (at[i, 0] + step[0], at[i, 1] + step[1], end)
        h, _ = along(pyramid, start, sun, LEAST, True)
        out[i] = 1.0 if h <= end else 0.0
