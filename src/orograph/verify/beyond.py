"""What lies beyond the open edges of a mesh: missing ground, ground out of view, or ground that should be covered.

An edge of one triangle alone is looked at unit by unit on its other side, with integers.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel, leaf
from orograph.verify.ground import unit_in_view
from orograph.verify.strips import ceiling, corners

OF_MISSING, OF_HIDDEN, OF_SEEN = range(3)
"""What lies beyond an open edge: missing ground, ground out of view, ground (partly) in view."""


@leaf
def shares_length(x0, y0, x1, y1, column, row, half):
    """(whether an edge runs through or along a unit triangle for more than a point, cross products of its corners)."""
    c0, r0, c1, r1, c2, r2 = corners(column, row, half)
    dx, dy = x1 - x0, y1 - y0
    s0, s1, s2 = dx * (r0 - y0) - dy * (c0 - x0), dx * (r1 - y0) - dy * (c1 - x0), dx * (r2 - y0) - dy * (c2 - x0)
    turned = 1 if (c1 - c0) * (r2 - r0) - (c2 - c0) * (r1 - r0) > 0 else -1
    # The part [t0, t1] of the edge inside the three sides; parameters are fractions far more than 1e-12 apart.
    t0, t1 = 0.0, 1.0
    for k in range(3):
        ac, ar, bc, br = (c0, r0, c1, r1) if k == 0 else ((c1, r1, c2, r2) if k == 1 else (c2, r2, c0, r0))
        begin = turned * ((bc - ac) * (y0 - ar) - (br - ar) * (x0 - ac))
        end = turned * ((bc - ac) * (y1 - ar) - (br - ar) * (x1 - ac))
        if begin < 0 and end < 0:
            return False, s0, s1, s2
        if begin < 0 or end < 0:
            t = begin / np.float64(begin - end)
            if begin < 0:
                t0 = max(t0, t)
            else:
                t1 = min(t1, t)
    return t1 - t0 > 1e-12, s0, s1, s2


@kernel
def look_beyond(heights, top, west, rows, cols, band, edges, members, matrix, lens, findings):
    """Find what lies just beyond open edges, in the strips of a band.

    Args:
        heights, top, west, rows, band, matrix, lens: as for ``sweep``; cols: of the raster.
        edges: (n, 5) int64: columns and rows of both ends, and the sign of (end − begin) × (p − begin) for points p
            beyond the edge.
        members: the indices of the edges that touch the band.
        findings: (n, 3) uint8 flags, set to 1: OF_MISSING, OF_HIDDEN, OF_SEEN.
    """
    points, scratch = np.empty((16, 3), np.float64), np.empty((16, 3), np.float64)
    for e in members:
        x0, y0, x1, y1, beyond = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3], edges[e, 4]
        if y0 > y1:
            x0, y0, x1, y1, beyond = x1, y1, x0, y0, -beyond
        for row in range(max(y0 - 1, band[0]), min(y1, band[1], rows - 2) + 1):
            if y0 == y1:
                low, high = min(x0, x1), max(x0, x1)
            elif row < y0 or row >= y1:
                continue
            else:
                n, d = x0 * (y1 - y0) + (x1 - x0) * (row - y0), y1 - y0
                low, high = min(n // d, (n + x1 - x0) // d), max(ceiling(n, d), ceiling(n + x1 - x0, d))
            for column in range(max(low - 1, 0), min(high, cols - 2) + 1):
                for half in range(2):
                    shares, s0, s1, s2 = shares_length(x0, y0, x1, y1, column, row, half)
                    if not shares or max(beyond * s0, beyond * s1, beyond * s2) <= 0:
                        continue
                    c0, r0, c1, r1, c2, r2 = corners(column, row, half)
                    z = heights[r0 - top, c0 - west] + heights[r1 - top, c1 - west] + heights[r2 - top, c2 - west]
                    if z != z:
                        findings[e, OF_MISSING] = 1
                    elif unit_in_view(heights, top, west, column, row, half, matrix, lens, points, scratch):
                        findings[e, OF_SEEN] = 1
                    else:
                        findings[e, OF_HIDDEN] = 1
