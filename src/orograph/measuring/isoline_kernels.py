"""The inner loops of contour lines as vectors (``measuring.isolines``): marching, linking, simplifying.

Kernels: arguments are arrays, types are Numba's to infer. The readable references are in ``tests/measuring``.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel

EDGES = 3
"""Edges of the triangulation by sample: to the right, downward, and the diagonal of the cell below and to the right."""


@inlined
def _march(ranks, edges, levels, size, at, starts, ends, counts):
    """Pieces of a triangle whose corners, of these ranks, turn in one direction; see ``march``."""
    (ka, kb, kc), (ab, bc, ca), (low, high) = ranks, edges, levels
    if ka < 0 or kb < 0 or kc < 0:
        return at
    first, last = max(min(ka, kb, kc), low), min(max(ka, kb, kc), high)
    for k in range(first, last):
        if len(starts) == 0:
            counts[k] += 1
        else:
            a, b, c = ka > k, kb > k, kc > k
            start = ab if b and not a else bc if c and not b else ca
            end = ab if a and not b else bc if b and not c else ca
            starts[at], ends[at] = k * size + start, k * size + end
        at += 1
    return at


@kernel
def march(ranks, row0, col0, width, size, low, high, starts, ends, counts):
    """Pieces of isolines in all triangles of a window, and how many there are.

    Args:
        ranks: (rows, cols) int32: how many levels lie below each sample; −1 where it is missing. The window's first
            sample is (row0, col0) of a raster ``width`` samples wide, with ``size`` edges in all.
        low, high: levels [low, high) are marched.
        starts, ends: (n,) int64, filled: the edges from which and to which each piece runs, with higher ground on its
            left (columns to the right, rows downward): level · size + edge. Empty ones: pieces are only counted.
        counts: (levels,) int64, by level, added to where they are only counted.
    """
    rows, cols = ranks.shape
    levels = low, high
    at = 0
    for i in range(rows - 1):
        for j in range(cols - 1):
            a, b, c, d = ranks[i, j], ranks[i, j + 1], ranks[i + 1, j], ranks[i + 1, j + 1]
            if a == b and a == c and a == d:
                continue
            row, col = row0 + i, col0 + j
            cell = (row * width + col) * EDGES
            top, left, across = cell, cell + 1, cell + 2
            right, bottom = cell + EDGES + 1, cell + width * EDGES
            if (row + col) % 2 == 0:  # cut from a to d
                at = _march((a, b, d), (top, right, across), levels, size, at, starts, ends, counts)
                at = _march((a, d, c), (across, bottom, left), levels, size, at, starts, ends, counts)
            else:  # from b to c
                at = _march((a, b, c), (top, across, left), levels, size, at, starts, ends, counts)
                at = _march((b, d, c), (right, bottom, across), levels, size, at, starts, ends, counts)
    return at


@kernel
def follow(following, begins, order, stops):
    """Pieces in the order of the lines they make; how many lines there are.

    Args:
        following: (n,) int64: the piece after each one; −1: none. begins: (n,) bool: no piece runs into it.
        order: (n,) int64, filled: pieces line by line, first the open lines, then the rings.
        stops: (n,) int64, filled: where in ``order`` each line ends; a ring's is given as its complement, ~stop.
    """
    done = np.zeros(len(following), np.bool_)
    at = lines = 0
    for ring in range(2):
        for first in range(len(following)):
            if done[first] or (ring == 0 and not begins[first]):
                continue
            piece = first
            while piece >= 0 and not done[piece]:
                done[piece] = True
                order[at] = piece
                at += 1
                piece = following[piece]
            stops[lines] = ~at if ring == 1 else at
            lines += 1
    return lines


@inlined
def _away(x, y, x0, y0, x1, y1):
    """The squared distance of (x, y) from the stretch between two points."""
    dx, dy = x1 - x0, y1 - y0
    along = dx * dx + dy * dy
    t = 0.0 if along == 0.0 else min(max(((x - x0) * dx + (y - y0) * dy) / along, 0.0), 1.0)
    u, v = x - (x0 + t * dx), y - (y0 + t * dy)
    return u * u + v * v


@inlined
def _farthest(points, first, last):
    """The point of a stretch that is farthest from its chord, and its squared distance."""
    worst, at = -1.0, first
    for i in range(first + 1, last):
        away = _away(points[i, 0], points[i, 1], points[first, 0], points[first, 1], points[last, 0], points[last, 1])
        if away > worst:
            worst, at = away, i
    return at, worst


@kernel
def thin(points, offsets, bound, keep):
    """Mark the points (n,) bool of lines that stand for all of them: Douglas & Peucker (1973), distances to stretches.

    A ring keeps three different points at least.

    Args:
        points: (n, 2), metres. offsets: (m + 1,): where lines begin. bound: metres. keep: filled.
    """
    stack = np.empty((128, 2), np.int64)
    for line in range(len(offsets) - 1):
        begin, end = offsets[line], offsets[line + 1] - 1
        keep[begin] = keep[end] = True
        ring = points[begin, 0] == points[end, 0] and points[begin, 1] == points[end, 1]
        count = 0
        if ring:
            middle, _ = _farthest(points, begin, end)
            one, away_one = _farthest(points, begin, middle)
            two, away_two = _farthest(points, middle, end)
            third = one if away_one >= away_two else two
            low, high = min(middle, third), max(middle, third)
            keep[low] = keep[high] = True
            stack[0, 0], stack[0, 1], stack[1, 0], stack[1, 1], stack[2, 0], stack[2, 1] = (
                begin, low, low, high, high, end
            )  # fmt: skip
            count = 3
        else:
            stack[0, 0], stack[0, 1] = begin, end
            count = 1
        while count > 0:
            count -= 1
            first, last = stack[count, 0], stack[count, 1]
            at, worst = _farthest(points, first, last)
            if worst > bound * bound:
                keep[at] = True
                if count + 2 > len(stack):
                    more = np.empty((2 * len(stack), 2), np.int64)
                    for k in range(len(stack)):
                        more[k, 0], more[k, 1] = stack[k, 0], stack[k, 1]
                    stack = more
                stack[count, 0], stack[count, 1], stack[count + 1, 0], stack[count + 1, 1] = first, at, at, last
                count += 2
