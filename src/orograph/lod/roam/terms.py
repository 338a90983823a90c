"""Optional terms of ROAM's priorities: what else makes a triangle worth more or less than its error on the screen.

Paper sec. 6 names them; here each is monotonic down the tree, so that the mesh still depends on the view alone. Factors
weigh ground that faces away from the eye and silhouettes (``facing``), ground hidden behind other ground (``horizon``),
and ground out of view.

*Demands* do not depend on the view: ``pinned`` triangles are split whatever is seen. Under an **object** every diamond
is split whose error exceeds the tolerance in metres. Along a **line of sight** every triangle is split that may decide:
over whose bounding box the line meets the heights of its volume, as long as it has an error. Each triangle that is left
is below the line all along, or above it all along, with all of its ground, or is the ground itself; so the line is
blocked by the mesh iff it is by the full-resolution surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import leaf
from orograph.lod.roam.blocks import Blocks

SECTORS = 512
RINGS = 1024
OBJECT, LINE = 0.0, 1.0

BACK_FACING, SILHOUETTE, OCCLUDED, OUTSIDE = range(4)
"""Factors: of priorities that are back-facing, a silhouette, occluded, out of view."""

COL, ROW, HEIGHT, CELLS, STEEPNESS = range(5)
"""The eye: column, row, height; cells per metre at most; 1 / exaggeration."""

BEGIN, AROUND, STEP, GROWTH, KNEE = range(5)
"""The horizon's polar grid: the azimuth where it begins (radians, from east to north), and how many of its sectors go
around it all; the step between rings (metres) up to ring ``KNEE``, and the factor between those beyond."""


class Terms(NamedTuple):
    """What kernels get of the terms.

    Attributes:
        demands: float64 (m, 7): OBJECT, column, row, radius (cells), metres; or LINE, column, row, height of its ends.
        blocks: slopes and heights of the ground.
        hidden: float32 (SECTORS, RINGS): the slope up to which what lies beyond a ring is hidden.
        polar: float64 (5,): where sectors and rings are, see ``BEGIN`` and following.
        factors: float64 (4,), see ``BACK_FACING`` and following. eye: float64 (5,), see ``COL`` and following.
        to_metres: float64 (4,): easting and northing by column and row.
    """

    demands: NDArray[np.float64]
    blocks: Blocks
    hidden: NDArray[np.float32]
    polar: NDArray[np.float64]
    factors: NDArray[np.float64]
    eye: NDArray[np.float64]
    to_metres: NDArray[np.float64]


@leaf
def touches(demands, k, r0, r1, c0, c1, low, high):
    """Whether a demand concerns a volume over a bounding box."""
    if demands[k, 0] == OBJECT:
        col, row = demands[k, 1], demands[k, 2]
        dc, dr = max(c0 - col, max(col - c1, 0.0)), max(r0 - row, max(row - r1, 0.0))
        return dc * dc + dr * dr <= demands[k, 3] * demands[k, 3]
    begin, end = 0.0, 1.0
    for axis in range(2):
        p, d = demands[k, 1 + axis], demands[k, 4 + axis] - demands[k, 1 + axis]
        least, most = (r0, r1) if axis else (c0, c1)
        if d == 0.0:
            if p < least or p > most:
                return False
        else:
            s, t = (least - p) / d, (most - p) / d
            begin, end = max(begin, min(s, t) - 1e-12), min(end, max(s, t) + 1e-12)
    if begin > end:
        return False
    z, dz = demands[k, 3], demands[k, 6] - demands[k, 3]
    a, b = z + begin * dz, z + end * dz
    return min(a, b) <= high and max(a, b) >= low


@leaf
def is_pinned(node, edge, terms, error):
    """Whether a demand wants a triangle of that error split; infinity asks whether any can concern it."""
    for k in range(len(terms.demands)):
        if error > (terms.demands[k, 4] if terms.demands[k, 0] == OBJECT else 0.0):
            r0, r1 = min(node.r0, min(node.r1, node.r2)), max(node.r0, max(node.r1, node.r2))
            c0, c1 = min(node.c0, min(node.c1, node.c2)), max(node.c0, max(node.c1, node.c2))
            if touches(
                terms.demands, k, min(r0, edge[0]), min(r1, edge[0]), min(c0, edge[1]), min(c1, edge[1]),
                np.float64(node.low), np.float64(node.high),
            ):  # fmt: skip
                return True
    return False
