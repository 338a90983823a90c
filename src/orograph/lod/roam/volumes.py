"""The volume of a triangle, all that is known of where its ground lies, and where it is relative to the frustum.

All ground under a triangle, and every mesh over it that splits it further, lies over its footprint between two heights:
those of its parent, and if tighter its corners' ± its error (if the error is a bound), and the vertex of its diamond ±
the radius of the nested sphere. So the volumes of a triangle's descendants lie inside its own, which the paper (ROAM,
sec. 6) gets from nested wedgies; with the ``exact`` error, much smaller, prisms around the triangles' planes do not
nest. (A triangle across the raster's border is squeezed; the footprint is its bounding box there, for its halves need
not lie inside it.)

Frustum labels (sec. 5.1): the planes that a volume is wholly inside of, inherited down the tree, each with the motion
of the camera for which it lasts (``queues``). Rows and columns; heights in metres; distances in stretched metres.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.error.screen import plane_of, to_camera
from orograph.lod.field import find
from orograph.lod.roam.mesh import BOUND, EMPTY, LABELS, LOADED, PINNED, N
from orograph.lod.roam.queues import class_of, reach_of
from orograph.lod.roam.terms import COL, ROW, is_pinned

GAP, ROOM, LABEL = range(3)
"""What ``frustum`` leaves in ``Scratch.work``."""


@leaf
def corner(node, edge, k):
    """(row, col) of corner k of a footprint: three of the triangle, or four of its squeezed bounding box."""
    if edge[0] >= max(node.r0, max(node.r1, node.r2)) and edge[1] >= max(node.c0, max(node.c1, node.c2)):
        if k == 0:
            return np.float64(node.r0), np.float64(node.c0)
        if k == 1:
            return np.float64(node.r1), np.float64(node.c1)
        return np.float64(node.r2), np.float64(node.c2)
    row = max(node.r0, max(node.r1, node.r2)) if k & 1 else min(node.r0, min(node.r1, node.r2))
    col = max(node.c0, max(node.c1, node.c2)) if k & 2 else min(node.c0, min(node.c1, node.c2))
    return np.float64(min(row, edge[0])), np.float64(min(col, edge[1]))


@leaf
def straddles(node, edge):
    """Whether a triangle reaches beyond the raster's last row or column."""
    return edge[0] < max(node.r0, max(node.r1, node.r2)) or edge[1] < max(node.c0, max(node.c1, node.c2))


@leaf
def is_beyond(node, edge):
    """Whether a triangle lies wholly beyond the raster's last row or column, and is squeezed to nothing."""
    return min(node.r0, min(node.r1, node.r2)) >= edge[0] or min(node.c0, min(node.c1, node.c2)) >= edge[1]


@leaf
def down(x):
    """The largest float32 that is certainly not above x."""
    return np.float32(x - abs(x) * 2.0**-23 - 1e-30)


@leaf
def load(nodes, pages, options, terms, i):
    """Copy the values of node i's diamond from its page, and tighten its heights; False if the page is absent.

    A triangle without surface wants nothing, whatever its diamond has on the other side, and neither does what becomes
    of it (``mesh.begin_node``): it could else keep a split that its parent, which is empty, would not ask for.
    """
    node = nodes[i]
    if is_beyond(node, pages.edge):
        node.flags |= EMPTY
    n = int(options[N])
    row, col = np.int64((node.r0 + node.r1) >> 1), np.int64((node.c0 + node.c1) >> 1)
    octave = n - 1 - (np.int64(node.level) >> 1)
    if node.level == 2 * n or row - (1 << octave) >= pages.edge[0] or col - (1 << octave) >= pages.edge[1]:
        # A unit triangle has no error; what lies beyond the raster has no area.
        node.height = node.error = node.radius = node.color = 0.0
        if not node.z0 + node.z1 + node.z2 < np.inf or straddles(node, pages.edge):
            node.flags |= EMPTY
    else:
        slot, a, b = find(pages, row, col, octave)
        if slot < 0:
            return False
        node.height = pages.data[slot, a, b, 0]
        node.error = pages.data[slot, a, b, 1]
        node.radius = pages.data[slot, a, b, 2]
        node.color = pages.data[slot, a, b, 3]
        if node.radius < 0.0:
            node.flags |= EMPTY
            node.radius = -node.radius
            node.error = 0.0
    node.flags |= LOADED
    if node.level < 2 * n and not node.flags & EMPTY:
        node.low = max(node.low, down(np.float64(node.height) - np.float64(node.radius)))
        node.high = min(node.high, -down(-(np.float64(node.height) + np.float64(node.radius))))
    z = node.z0 + node.z1 + node.z2
    if options[BOUND] > 0.0 and z == z and node.error < np.inf and not straddles(node, pages.edge):
        e = np.float64(node.error)
        node.low = max(node.low, down(min(node.z0, min(node.z1, node.z2)) - e))
        node.high = min(node.high, -down(-(max(node.z0, max(node.z1, node.z2)) + e)))
    if not node.flags & EMPTY and is_pinned(node, pages.edge, terms, np.float64(node.error)):
        node.flags |= PINNED
    return True


@leaf
def frustum(node, edge, camera, known, work):
    """Where a volume lies relative to the frustum.

    Args:
        known: the planes it is known to be wholly inside of, as bits.
        work: receives at GAP how far it is outside (−1: it is not), at ROOM how far it is from being outside of a plane
            that was tested, at LABEL how far from any change of a label.

    Returns:
        the planes it is wholly inside of.
    """
    gap, room, label = -1.0, np.inf, np.inf
    count = 4 if straddles(node, edge) else 3
    for plane in range(6):
        if known >> plane & 1:
            continue
        across, down, c, rest = plane_of(camera, plane)
        if rest == np.inf:
            known |= 1 << plane
            continue
        most, least = -np.inf, np.inf
        for k in range(count):
            row, col = corner(node, edge, k)
            d = across * col + down * row
            most, least = max(most, d), min(least, d)
        most += c * (node.high if c > 0.0 else node.low) + rest
        least += c * (node.low if c > 0.0 else node.high) + rest
        if most < 0.0:
            gap = max(gap, -most)
        room = min(room, most)
        label = min(label, min(abs(most), abs(least)))
        if least >= 0.0:
            known |= 1 << plane
    work[GAP], work[ROOM], work[LABEL] = gap, room, label
    return known


@leaf
def distance(node, edge, camera):
    """At least the distance of the eye from the farthest point of a volume, stretched metres."""
    middle = 0.5 * (np.float64(node.low) + np.float64(node.high))
    most = 0.0
    count = 4 if straddles(node, edge) else 3
    for k in range(count):
        row, col = corner(node, edge, k)
        x, y, w = to_camera(camera, col, row, middle)
        most = max(most, x * x + y * y + w * w)
    return np.sqrt(most) * (1.0 + 1e-12) + (np.float64(node.high) - middle) * camera.exaggeration


@leaf
def seen_from(node, edge, terms):
    """Of a footprint, seen from the eye: least and most distance, direction of its middle, angles from there.

    The least distance is 0 where the eye is over it.
    """
    eye, to_metres = terms.eye, terms.to_metres
    count = 4 if straddles(node, edge) else 3
    xm = ym = 0.0
    for k in range(count):
        row, col = corner(node, edge, k)
        xm += to_metres[0] * (col - eye[COL]) + to_metres[1] * (row - eye[ROW])
        ym += to_metres[2] * (col - eye[COL]) + to_metres[3] * (row - eye[ROW])
    near, far, left, right, px, py = np.inf, 0.0, np.inf, -np.inf, 0.0, 0.0
    for at in range(count + 1):  # round it, and back to where it began
        k = at % count
        row, col = corner(node, edge, k ^ k >> 1 if count == 4 else k)
        x = to_metres[0] * (col - eye[COL]) + to_metres[1] * (row - eye[ROW])
        y = to_metres[2] * (col - eye[COL]) + to_metres[3] * (row - eye[ROW])
        if at:
            ex, ey = x - px, y - py
            t = min(max(-(px * ex + py * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
            near = min(near, (px + t * ex) ** 2 + (py + t * ey) ** 2)
        far = max(far, x * x + y * y)
        turn = np.arctan2(xm * y - ym * x, xm * x + ym * y)
        left, right = min(left, turn), max(right, turn)
        px, py = x, y
    over = right - left >= np.pi or (xm == 0.0 and ym == 0.0)
    return 0.0 if over else np.sqrt(near), np.sqrt(far), np.arctan2(ym, xm), left, right


@leaf
def inherited(nodes, pages, camera, clock, counts, scratch, i):
    """The planes node i's parent is wholly inside of and for how much motion they last; labels are renewed on the way.

    A label is computed again only when the camera has moved so far that it can have changed.
    """
    stack, work = scratch.stack, scratch.work
    j = nodes[i].parent
    depth = 0
    while j >= 0 and not clock[nodes[j].label_class] < nodes[j].label_until:
        stack[depth] = j
        depth += 1
        j = nodes[j].parent
    known, lasts = np.int64(0), np.inf
    if j >= 0:
        known, lasts = np.int64(nodes[j].inside), nodes[j].label_until - clock[nodes[j].label_class]
    while depth:
        depth -= 1
        node = nodes[stack[depth]]
        known = frustum(node, pages.edge, camera, known, work)
        lasts = min(lasts, work[LABEL])
        k = class_of(distance(node, pages.edge, camera))
        if k >= 0:
            lasts = min(lasts, 0.999 * reach_of(k) / 8.0)
            node.inside, node.label_class, node.label_until = known, k, clock[k] + lasts
            counts[LABELS] += 1
    return known, lasts
