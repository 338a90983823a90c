"""The ground beyond the open edges of a mesh: missing, out of view, or ground that should be covered.

The other side of an edge with a single triangle is examined unit by unit, with integers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import leaf
from orograph.verify.ground import exists, unit_in_view
from orograph.verify.strips import ceiling, compare, corners

OF_MISSING, OF_HIDDEN, OF_SEEN = range(3)
"""Ground beyond an open edge: missing, out of view, (partly) in view."""


class OpenEdges(NamedTuple):
    """Open edges, in ticks.

    Attributes:
        ends: (n, 5) int64: columns and rows of both ends, and the sign of (end − begin) × (p − begin) for points p
            beyond the edge.
        shift: 2^shift ticks to a cell.
    """

    ends: NDArray[np.int64]
    shift: int


@leaf
def shares_length(x0, y0, x1, y1, column, row, half, shift):
    """(whether an edge runs through or along a unit triangle for more than a point, cross products of its corners)."""
    c0, r0, c1, r1, c2, r2 = corners(column, row, half)
    dx, dy = x1 - x0, y1 - y0
    s0 = dx * ((r0 << shift) - y0) - dy * ((c0 << shift) - x0)
    s1 = dx * ((r1 << shift) - y0) - dy * ((c1 << shift) - x0)
    s2 = dx * ((r2 << shift) - y0) - dy * ((c2 << shift) - x0)
    turned = 1 if (c1 - c0) * (r2 - r0) - (c2 - c0) * (r1 - r0) > 0 else -1
    # The part of the edge inside the three sides, from fraction t0/d0 of its length to t1/d1.
    t0, d0, t1, d1 = 0, 1, 1, 1
    for k in range(3):
        ac, ar, bc, br = (c0, r0, c1, r1) if k == 0 else ((c1, r1, c2, r2) if k == 1 else (c2, r2, c0, r0))
        begin = turned * ((bc - ac) * (y0 - (ar << shift)) - (br - ar) * (x0 - (ac << shift)))
        end = turned * ((bc - ac) * (y1 - (ar << shift)) - (br - ar) * (x1 - (ac << shift)))
        if begin < 0 and end < 0:
            return False, s0, s1, s2
        if begin < 0:
            if compare(-begin, end - begin, t0, d0) > 0.0:
                t0, d0 = -begin, end - begin
        elif end < 0 and compare(begin, begin - end, t1, d1) < 0.0:
            t1, d1 = begin, begin - end
    return compare(t0, d0, t1, d1) < 0.0, s0, s1, s2


@leaf
def look_beyond(ground, first, last, edges, members, lens, points, scratch, findings):
    """Classify the ground directly beyond open edges, in the cells below the rows of a band.

    Args:
        ground, lens: as for ``sweep``. first, last: rows of the band.
        members: the indices of the edges that touch the band. points, scratch: (16, 3) float64, polygons.
        findings: (n, 3) uint8 flags, set to 1: OF_MISSING, OF_HIDDEN, OF_SEEN.
    """
    ends, shift = edges.ends, edges.shift
    for e in members:
        x0, y0, x1, y1, beyond = ends[e, 0], ends[e, 1], ends[e, 2], ends[e, 3], ends[e, 4]
        if y0 > y1:
            x0, y0, x1, y1, beyond = x1, y1, x0, y0, -beyond
        for row in range(max(ceiling(y0, 1 << shift) - 1, first), min(y1 >> shift, last, ground.rows - 2) + 1):
            upper, lower = max(y0, row << shift), min(y1, (row + 1) << shift)
            if y0 == y1:
                low, high = min(x0, x1), max(x0, x1)
            elif upper >= lower:
                continue
            else:
                d = y1 - y0
                n, m = x0 * d + (x1 - x0) * (upper - y0), x0 * d + (x1 - x0) * (lower - y0)
                low, high = min(n // d, m // d), max(ceiling(n, d), ceiling(m, d))
            for column in range(max((low >> shift) - 1, 0), min(high >> shift, ground.columns - 2) + 1):
                for half in range(2):
                    shares, s0, s1, s2 = shares_length(x0, y0, x1, y1, column, row, half, shift)
                    if not shares or max(beyond * s0, beyond * s1, beyond * s2) <= 0:
                        continue
                    if not exists(ground, column, row, half):
                        findings[e, OF_MISSING] = 1
                    elif unit_in_view(ground, column, row, half, lens, points, scratch):
                        findings[e, OF_SEEN] = 1
                    else:
                        findings[e, OF_HIDDEN] = 1
