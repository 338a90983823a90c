"""Optional terms of ROAM's priorities: what else makes a triangle worth more or less than its error on the screen.

Paper sec. 6 names them; here each is monotonic down the tree, so that the mesh still depends on the view alone.

*Demands* do not depend on the view: ``pinned`` triangles are split whatever is seen. Under an **object** every diamond
is split whose error exceeds the tolerance in metres. Along a **line of sight** every triangle is split that may decide:
over whose bounding box the line meets the heights of its volume, as long as it has an error. Each triangle that is left
is below the line all along, or above it all along, with all of its ground, or is the ground itself; so the line is
blocked by the mesh iff it is by the full-resolution surface.

*Facing.* With h the height over (column, row) and d from a point of the ground to the eye, the ground faces the eye iff
v = d_z − h_c·d_c − h_r·d_r > 0. Interval arithmetic over a triangle's volume and the gradients under it (extrema over
blocks of 32 × 32 cells and the mip pyramid above them) gives [least, most] for v: all **back-facing** if most < 0; a
**silhouette** may run through if the sign is open (the cone of normals is tangential to some line of sight). v changes
by at most (1/exaggeration + the largest slope) per metre that the eye moves: that is the slack.

*Outside.* What is out of view has no bound on the screen; it counts as if it lay in the middle of the screen at its
least distance D from the eye, f·e·|u| / D, times the factor. What is in view counts for no less than that.

*Occlusion.* Around the eye lie 720 sectors, in each the rings of distance 2^(i/4) times the block's size. A block whose
lowest ground rises by a slope from the eye hides whatever lies behind it, in the sectors that it spans wholly, and
lower than that slope; a volume is **occluded** if it is hidden in all the sectors that it touches. The table is made in
each frame, and what it decides is computed again in each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import leaf
from orograph.store.terrain import Terrain

SHIFT = 5
SECTORS = 720
RINGS = 128
OBJECT, LINE = 0.0, 1.0

BACK_FACING, SILHOUETTE, OCCLUDED, OUTSIDE = range(4)
"""Factors: of priorities that are back-facing, a silhouette, occluded, out of view."""

COL, ROW, HEIGHT, CELLS, STEEPNESS, BLOCK = range(6)
"""The eye: column, row, height; cells per metre at most; 1 / exaggeration; metres along a block."""


class Terms(NamedTuple):
    """What kernels get of the terms.

    Attributes:
        demands: float64 (m, 7): OBJECT, column, row, radius (cells), metres; or LINE, column, row, height of its ends.
        blocks: float32 (blocks of all levels, 6): least and most h_c, h_r, height; base, width: int64, where each level
            begins and how many blocks it is wide.
        hidden: float32 (SECTORS, RINGS): the slope up to which what lies beyond a ring is hidden.
        factors: float64 (4,), see ``BACK_FACING`` and following. eye: float64 (6,), see ``COL`` and following.
        to_metres: float64 (4,): easting and northing by column and row.
    """

    demands: NDArray[np.float64]
    blocks: NDArray[np.float32]
    base: NDArray[np.int64]
    width: NDArray[np.int64]
    hidden: NDArray[np.float32]
    factors: NDArray[np.float64]
    eye: NDArray[np.float64]
    to_metres: NDArray[np.float64]


# ---- demands ---------------------------------------------------------------------------------------------------------


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


# ---- facing ----------------------------------------------------------------------------------------------------------


@leaf
def facing(node, edge, terms):
    """(least, most) of v over a volume, and the largest slope under it."""
    r0, r1 = min(node.r0, min(node.r1, node.r2)), min(max(node.r0, max(node.r1, node.r2)), edge[0])
    c0, c1 = min(node.c0, min(node.c1, node.c2)), min(max(node.c0, max(node.c1, node.c2)), edge[1])
    level = 0
    while level < len(terms.base) - 1 and max(r1 - r0, c1 - c0) >> (SHIFT + level) > 0:
        level += 1
    shift = SHIFT + level
    width = terms.width[level]
    height = (terms.base[level + 1] if level + 1 < len(terms.base) else len(terms.blocks)) - terms.base[level]
    height //= width
    gc0 = gr0 = np.inf
    gc1 = gr1 = -np.inf
    for i in range(r0 >> shift, min((max(r1, r0 + 1) - 1) >> shift, height - 1) + 1):
        for j in range(c0 >> shift, min((max(c1, c0 + 1) - 1) >> shift, width - 1) + 1):
            at = terms.base[level] + i * width + j
            gc0, gc1 = min(gc0, terms.blocks[at, 0]), max(gc1, terms.blocks[at, 1])
            gr0, gr1 = min(gr0, terms.blocks[at, 2]), max(gr1, terms.blocks[at, 3])
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


# ---- occlusion -------------------------------------------------------------------------------------------------------


@leaf
def metres(terms, row, col):
    """Easting and northing from the eye."""
    r, c = row - terms.eye[ROW], col - terms.eye[COL]
    return terms.to_metres[0] * c + terms.to_metres[1] * r, terms.to_metres[2] * c + terms.to_metres[3] * r


@leaf
def view_of(terms, r0, r1, c0, c1):
    """Of a box, seen from the eye: least and most distance (metres), direction of its middle, angles from there."""
    near, far = np.inf, 0.0
    x, y = metres(terms, 0.5 * (r0 + r1), 0.5 * (c0 + c1))
    xm, ym = x, y
    left, right = np.inf, -np.inf
    px, py = metres(terms, r0, c1)
    for k in range(4):  # round the box
        x, y = metres(terms, r1 if k == 1 or k == 2 else r0, c1 if k >= 2 else c0)
        far = max(far, np.sqrt(x * x + y * y))
        turn = np.arctan2(xm * y - ym * x, xm * x + ym * y)
        left, right = min(left, turn), max(right, turn)
        ex, ey = x - px, y - py
        t = min(max(-(px * ex + py * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
        qx, qy = px + t * ex, py + t * ey
        near = min(near, np.sqrt(qx * qx + qy * qy))
        px, py = x, y
    inside = r0 <= terms.eye[ROW] <= r1 and c0 <= terms.eye[COL] <= c1
    return 0.0 if inside else near, far, np.arctan2(ym, xm), left, right


@leaf
def around(node, edge, terms, camera, low, high):
    """(the bound in pixels at a volume's least distance, the motion for which it stays out of (low, high))."""
    e = np.float64(node.error) * camera.focal * camera.exaggeration
    if not 0.0 < e < np.inf:
        return 0.0, np.inf
    r0, r1 = min(node.r0, min(node.r1, node.r2)), min(max(node.r0, max(node.r1, node.r2)), edge[0])
    c0, c1 = min(node.c0, min(node.c1, node.c2)), min(max(node.c0, max(node.c1, node.c2)), edge[1])
    flat = view_of(terms, r0, r1, c0, c1)[0]
    up = max(max(node.low - terms.eye[HEIGHT], terms.eye[HEIGHT] - node.high), 0.0) / terms.eye[STEEPNESS]
    d = np.sqrt(flat * flat + up * up)
    bound = e / d if d > 0.0 else np.inf
    if bound <= low:
        return bound, d - e / low
    return bound, e / high - d if bound > high and high > 0.0 else (np.inf if bound > high else 0.0)


@leaf
def ring_of(terms, distance):
    """The ring a distance lies in."""
    return min(max(int(4.0 * np.log2(max(distance / terms.eye[BLOCK], 1e-9))), 0), RINGS - 1)


@leaf
def hide_behind(terms, edge):
    """Make the table of what is hidden from the eye."""
    for k in range(SECTORS):
        for ring in range(RINGS):
            terms.hidden[k, ring] = -np.inf
    width = terms.width[0]
    count = terms.base[1] if len(terms.base) > 1 else len(terms.blocks)
    size = 1 << SHIFT
    for at in range(count):
        i, j = at // width, at % width
        z = terms.blocks[at, 4]
        if not z > -np.inf:
            continue
        near, far, middle, left, right = view_of(
            terms, i * size, min((i + 1) * size, edge[0]), j * size, min((j + 1) * size, edge[1])
        )
        if near <= 0.0:
            continue
        rise = z - terms.eye[HEIGHT]
        slope = rise / far if rise > 0.0 else rise / near
        # Sectors wholly between the block's sides: every ray in them crosses it.
        begin = int(np.ceil((middle + left) / (2.0 * np.pi) * SECTORS))
        end = int(np.floor((middle + right) / (2.0 * np.pi) * SECTORS))
        ring = ring_of(terms, far) + 1
        if ring < RINGS:
            for k in range(begin, end):
                terms.hidden[k % SECTORS, ring] = max(terms.hidden[k % SECTORS, ring], np.float32(slope - 1e-6))
    for k in range(SECTORS):
        for ring in range(1, RINGS):
            terms.hidden[k, ring] = max(terms.hidden[k, ring], terms.hidden[k, ring - 1])


@leaf
def is_hidden(node, edge, terms):
    """Whether all of a volume is hidden."""
    r0, r1 = min(node.r0, min(node.r1, node.r2)), min(max(node.r0, max(node.r1, node.r2)), edge[0])
    c0, c1 = min(node.c0, min(node.c1, node.c2)), min(max(node.c0, max(node.c1, node.c2)), edge[1])
    near, far, middle, left, right = view_of(terms, r0, r1, c0, c1)
    if near <= 0.0:
        return False
    rise = node.high - terms.eye[HEIGHT]
    slope = rise / near if rise > 0.0 else rise / far
    ring = ring_of(terms, near)
    begin = int(np.floor((middle + left) / (2.0 * np.pi) * SECTORS))
    end = int(np.floor((middle + right) / (2.0 * np.pi) * SECTORS))
    for k in range(begin, end + 1):  # noqa: SIM110 (as the kernel has it)
        if not slope < terms.hidden[k % SECTORS, ring]:
            return False
    return True


# ---- blocks ----------------------------------------------------------------------------------------------------------


def blocks_of(terrain: Terrain) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.int64]]:
    """(blocks, base, width) of ``Terms``: gradients and heights under blocks of 32 × 32 cells and their pyramid.

    A block's gradients are those of its unit triangles that exist, and 0 where ground is missing, which hides nothing.
    """
    rows, cols = terrain.grid.shape
    size = 1 << SHIFT
    down, across = -(-(rows - 1) // size), -(-(cols - 1) // size)
    table = np.zeros((down, across, 6), np.float32)
    for i in range(down):
        z = terrain.read(0, i * size, min((i + 1) * size, rows - 1) + 1, 0, cols)
        across_edges, down_edges = np.diff(z, axis=1), np.diff(z, axis=0)
        for j in range(across):
            c = slice(j * size, min((j + 1) * size, cols - 1))
            corners = z[:, c.start : c.stop + 1]
            for at, g in ((0, across_edges[:, c]), (2, down_edges[:, c.start : c.stop + 1])):
                g = np.where(np.isnan(g), 0.0, g)
                table[i, j, at : at + 2] = g.min(), g.max()
            table[i, j, 4] = -np.inf if np.isnan(corners).any() else corners.min()
            table[i, j, 5] = np.inf if np.isnan(corners).any() else corners.max()
    parts, widths = [table], [across]
    while max(table.shape[:2]) > 1:
        even = np.pad(table, [(0, table.shape[0] % 2), (0, table.shape[1] % 2), (0, 0)], mode="edge")
        four = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2, 6)
        table = np.where(np.arange(6) % 2 == 0, four.min((1, 3)), four.max((1, 3)))
        parts.append(table)
        widths.append(table.shape[1])
    base = np.cumsum([0] + [p.shape[0] * p.shape[1] for p in parts[:-1]])
    flat = np.concatenate([p.reshape(-1, 6) for p in parts]).astype(np.float32)
    return flat, base.astype(np.int64), np.array(widths, np.int64)
