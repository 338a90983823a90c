"""What other ground hides from the eye: a horizon over a polar grid around it, made in each frame.

The view's azimuths are divided into sectors, distances into rings: steps of a block, and from where a sector is wider
than that, steps in proportion. The ground along the arc of a ring in a sector is at least as high as the lowest of the
blocks under it, so whatever lies beyond that ring, in that sector, and under the slope at which that height is seen, is
hidden. A volume is **occluded** if in every sector that it touches its top lies under the steepest such slope before
it. The top of all that is drawn of a triangle lies in its volume (``volumes``), so what is hidden of the ground is
hidden of the mesh. Volumes nest, and so being hidden is monotonic down the tree; as it depends on the place of the eye
in every detail, what it decides is computed again in each frame. Distances in metres, slopes in true metres.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, leaf
from orograph.lod.roam.terms import (
    AROUND,
    BEGIN,
    COL,
    GROWTH,
    HEIGHT,
    KNEE,
    RINGS,
    ROW,
    SECTORS,
    STEP,
    Terms,
)
from orograph.lod.roam.volumes import seen_from
from orograph.viewpoint import Camera

ASIDE = 1e-3
"""Radians by which sectors reach beyond the picture: rounding leaves nothing out."""


def find_hidden(terms: Terms, camera: Camera, edge: NDArray[np.int64], everywhere: bool) -> None:
    """Lay the polar grid around a view's azimuths, or all of them, as far as there is ground; and find what is hidden.

    Args:
        edge: the raster's last row and column. everywhere: what is out of view counts, too.
    """
    view = camera.view
    right, up, (x, y, _) = view.axes(camera.exaggeration)
    _, _, width, height = view.frame
    top = math.tan(math.radians(view.fov_y) / 2.0)
    side = top * width / height
    turns = []
    for a, b in ((-side, -top), (-side, top), (side, -top), (side, top)):
        u, v = x + a * right[0] + b * up[0], y + a * right[1] + b * up[1]
        turns.append(math.atan2(x * v - y * u, x * u + y * v))
    begin, span = math.atan2(y, x) + min(turns) - ASIDE, max(turns) - min(turns) + 2.0 * ASIDE
    if everywhere or span >= math.pi or math.hypot(x, y) < 1e-9:  # (then straight up or down is in view)
        begin, span = 0.0, 2.0 * math.pi
    per_cell = terms.to_metres.reshape(2, 2)
    corners = np.array([(col, row) for col in (0, edge[1]) for row in (0, edge[0])], np.float64)
    reach = float(np.hypot(*(per_cell @ (corners - terms.eye[[COL, ROW]]).T)).max())
    step = float(np.hypot(*per_cell).max()) * (1 << terms.blocks.shift)
    growth = span / SECTORS
    while (1.0 + math.log(max(reach * growth / step, 1.0))) / growth > RINGS - 2:
        growth *= 1.1
    around = math.floor(2.0 * math.pi * SECTORS / span)
    terms.polar[[BEGIN, AROUND, STEP, GROWTH, KNEE]] = begin, around, step, 1.0 + growth, math.ceil(1.0 / growth)
    raise_horizon(terms, edge)


@leaf
def radius_of(polar, ring):
    """The distance of a ring."""
    knee = polar[KNEE]
    return polar[STEP] * (ring if ring <= knee else knee * polar[GROWTH] ** (ring - knee))


@leaf
def ring_before(polar, distance):
    """The last ring that is no farther than a distance."""
    ring = distance / polar[STEP]
    if ring > polar[KNEE]:
        ring = polar[KNEE] + np.log(ring / polar[KNEE]) / np.log(polar[GROWTH])
    ring = np.int64(min(ring + 1e-6, RINGS - 1.0))
    while ring > 0 and radius_of(polar, ring) > distance:
        ring -= 1
    return ring


@leaf
def lowest_under(blocks, edge, r0, r1, c0, c1, level):
    """(the lowest height of the blocks under a box, at most two of them each way; their level, from ``level`` on)."""
    if r0 < 0.0 or c0 < 0.0 or r1 > edge[0] or c1 > edge[1]:
        return -np.inf, level
    while level < len(blocks.base) - 1 and max(r1 - r0, c1 - c0) > 1 << (blocks.shift + level):
        level += 1
    size = np.float64(1 << (blocks.shift + level))
    i0, i1 = np.int64(np.floor(r0 / size)), np.int64(np.floor(r1 / size))
    j0, j1 = np.int64(np.floor(c0 / size)), np.int64(np.floor(c1 / size))
    width = blocks.width[level]
    i1, j1 = min(i1, blocks.height[level] - 1), min(j1, width - 1)
    least = np.inf
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            least = min(least, np.float64(blocks.values[blocks.base[level] + i * width + j, 4]))
    return least, level


@kernel
def raise_horizon(terms, edge):
    """Find the slopes that hide, ring by ring outwards."""
    polar, eye, to_metres = terms.polar, terms.eye, terms.to_metres
    determinant = to_metres[0] * to_metres[3] - to_metres[1] * to_metres[2]
    width = 2.0 * np.pi / polar[AROUND]
    ends = np.empty((3, 2))  # of the arc at a metre: (row, col) of its ends, and where its tangents there meet
    for k in range(SECTORS):
        for at in range(3):
            turn = polar[BEGIN] + (k + 0.5 * at) * width
            far = 1.0 / np.cos(0.5 * width) if at == 1 else 1.0
            x, y = far * np.cos(turn), far * np.sin(turn)
            ends[at, 0] = (to_metres[0] * y - to_metres[2] * x) / determinant
            ends[at, 1] = (to_metres[3] * x - to_metres[1] * y) / determinant
        r0, r1, c0, c1 = ends[:, 0].min(), ends[:, 0].max(), ends[:, 1].min(), ends[:, 1].max()
        steepest, level = -np.inf, 0
        terms.hidden[k, 0] = -np.inf
        for ring in range(1, RINGS):
            r = radius_of(polar, ring)
            least, level = lowest_under(
                terms.blocks, edge, eye[ROW] + r * r0, eye[ROW] + r * r1, eye[COL] + r * c0, eye[COL] + r * c1, level
            )
            slope = (least - eye[HEIGHT]) / r
            steepest = max(steepest, slope - 1e-6 * (1.0 + abs(slope)))
            terms.hidden[k, ring] = steepest


@leaf
def is_hidden(node, edge, terms):
    """Whether all of a volume is hidden, as far as it is in view."""
    near, far, middle, left, right = seen_from(node, edge, terms)
    if near <= 0.0:
        return False
    polar = terms.polar
    rise = np.float64(node.high) - terms.eye[HEIGHT]
    slope = rise / near if rise > 0.0 else rise / far
    ring = ring_before(polar, near)
    whole = np.int64(polar[AROUND])
    per_turn = polar[AROUND] / (2.0 * np.pi)
    begin = np.int64(np.floor((middle + left - polar[BEGIN]) * per_turn - 1e-6))
    end = np.int64(np.floor((middle + right - polar[BEGIN]) * per_turn + 1e-6))
    for k in range(begin, end + 1):
        sector = k % whole
        if sector < SECTORS and not slope < terms.hidden[sector, ring]:
            return False
    return True
