"""How the ground under a triangle faces the eye: a factor where all of it faces away, or where a silhouette can run.

With h the height over (column, row) and d from a point of the ground to the eye, the ground faces the eye iff
v = d_z − h_c·d_c − h_r·d_r > 0. A triangle's cone of normals is the box of the gradients under it, from the pyramid of
``blocks``; interval arithmetic over it and the triangle's volume gives [least, most] for v: all **back-facing** if
most < 0; a **silhouette** may run through if the sign is open (the cone is tangential to some line of sight). Cones and
volumes nest, so both are monotonic. v changes by at most (1/exaggeration + the largest slope) per metre that the eye
moves: that is the slack.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.lod.roam.terms import BACK_FACING, CELLS, COL, HEIGHT, ROW, SILHOUETTE, STEEPNESS


@leaf
def facing(node, edge, terms):
    """(least, most) of v over a volume, and the largest slope under it."""
    r0, r1 = min(node.r0, min(node.r1, node.r2)), min(max(node.r0, max(node.r1, node.r2)), edge[0])
    c0, c1 = min(node.c0, min(node.c1, node.c2)), min(max(node.c0, max(node.c1, node.c2)), edge[1])
    blocks = terms.blocks
    level = 0
    # Blocks as large as the shorter side of the footprint's box, of which a triangle has two at most.
    while level < len(blocks.base) - 1 and (
        (min(r1 - r0, c1 - c0) - 1) >> (blocks.shift + level) > 0
        or (max(r1 - r0, c1 - c0) - 1) >> (blocks.shift + level) > 3
    ):
        level += 1
    shift, width, height = blocks.shift + level, blocks.width[level], blocks.height[level]
    gc0 = gr0 = np.inf
    gc1 = gr1 = -np.inf
    for i in range(r0 >> shift, min((max(r1, r0 + 1) - 1) >> shift, height - 1) + 1):
        for j in range(c0 >> shift, min((max(c1, c0 + 1) - 1) >> shift, width - 1) + 1):
            at = blocks.base[level] + i * width + j
            gc0, gc1 = min(gc0, blocks.values[at, 0]), max(gc1, blocks.values[at, 1])
            gr0, gr1 = min(gr0, blocks.values[at, 2]), max(gr1, blocks.values[at, 3])
    if not (gc0 <= gc1 and gr0 <= gr1):
        return -np.inf, np.inf, 0.0
    dc0, dc1 = terms.eye[COL] - c1, terms.eye[COL] - c0
    dr0, dr1 = terms.eye[ROW] - r1, terms.eye[ROW] - r0
    a = max(max(gc0 * dc0, gc0 * dc1), max(gc1 * dc0, gc1 * dc1))
    b = max(max(gr0 * dr0, gr0 * dr1), max(gr1 * dr0, gr1 * dr1))
    least = terms.eye[HEIGHT] - node.high - a - b
    a = min(min(gc0 * dc0, gc0 * dc1), min(gc1 * dc0, gc1 * dc1))
    b = min(min(gr0 * dr0, gr0 * dr1), min(gr1 * dr0, gr1 * dr1))
    most = terms.eye[HEIGHT] - node.low - a - b
    return least, most, max(abs(gc0), abs(gc1)) + max(abs(gr0), abs(gr1))


@leaf
def factor_of(node, edge, terms):
    """(the factor on a node's priority for how its ground faces the eye, the motion for which it lasts)."""
    if terms.factors[BACK_FACING] == 1.0 and terms.factors[SILHOUETTE] == 1.0:
        return 1.0, np.inf
    least, most, slope = facing(node, edge, terms)
    slack = min(abs(least), abs(most)) / (terms.eye[STEEPNESS] + slope * terms.eye[CELLS])
    if most < 0.0:
        return terms.factors[BACK_FACING], slack
    return (terms.factors[SILHOUETTE] if least <= 0.0 else 1.0), slack
