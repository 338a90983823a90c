"""Blocks in view by their boxes: the bound of a box in pixels, and the range of errors that boxes allow.

A box is (west, east, north, south, low, high), in sample coordinates and metres. Ranges and their thresholds are those
of ``lod.smart_blocks``.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf
from orograph.error.screen import larger_than_pixel


@inlined
def nearest(camera, box, away, cosine, e):
    """At most the depth of what is in view of a box, and within e metres of its heights.

    Of a point in view the depth is at least its distance times the cosine of the picture's corner.

    Args:
        box: (west, east, north, south, low, high). away: at least the distance of the box from the eye, stretched
            metres. cosine: of the angle between the view's axis and the picture's corner.
    """
    west, east, north, south, low, high = box
    right, down, up = camera.depth[0], camera.depth[1], camera.depth[2]
    w = camera.depth[3] + right * (west if right > 0 else east) + down * (north if down > 0 else south)
    w += up * (low - e if up > 0 else high + e)
    return max(max(w, (away - e * camera.exaggeration) * cosine), camera.near)


@inlined
def box_bound(camera, box, away, cosine, e):
    """The bound in pixels for displacements of e metres of what is in view of a box, and within e of its heights.

    The displacement times depth² is convex over the footprint and does not change along the vertical. See ``nearest``
    for the arguments.
    """
    west, east, north, south, _, _ = box
    w = nearest(camera, box, away, cosine, e)
    moved = w - e * abs(camera.depth[2])
    if not moved > 0.0:
        return np.inf
    most = 0.0
    for k in range(4):
        col, row = east if k & 1 else west, south if k & 2 else north
        p = camera.motion_x[0] * col + camera.motion_x[1] * row + camera.motion_x[2]
        q = camera.motion_y[0] * col + camera.motion_y[1] * row + camera.motion_y[2]
        most = max(most, p * p + q * q)
    return camera.focal * e * min(camera.largest_lean, np.sqrt(most) / w) / moved


@leaf
def weigh_boxes(camera, ends, boxes, away, cosine, ranges):
    """Lower ranges where boxes allow it.

    All samples of a block that is drawn in a range lie within its threshold of the heights of the vertices.

    Args:
        boxes: float64 (k, 6) and away (k,), as ``box_bound`` has them. ranges: int16 (k,), of ``weigh``; in and out.
    """
    for i in range(len(ranges)):
        box = (boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3], boxes[i, 4], boxes[i, 5])
        low, high = np.int64(0), np.int64(ranges[i])
        while low < high:
            middle = (low + high) >> 1
            if box_bound(camera, box, away[i], cosine, ends[middle]) > camera.tolerance:
                low = middle + 1
            else:
                high = middle
        ranges[i] = low


@leaf
def weigh_colors(camera, ends, boxes, away, cosine, last, ranges):
    """Raise ranges until they leave out no vertex whose colours count (``screen.color_exceeds``).

    A vertex that is left out has a radius within the threshold. One out of view whose sphere is in view may be nearer
    than all of its block that is in view, by a radius.

    Args:
        boxes: float64 (k, 6) and away (k,), as ``nearest`` has them. last: uint8 (k,), of ``Kept``.
        ranges: int16 (k,); in and out.
    """
    for i in range(len(ranges)):
        box = (boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3], boxes[i, 4], boxes[i, 5])
        w = nearest(camera, box, away[i], cosine, 0.0)
        while ranges[i] < last[i]:
            r = ends[ranges[i]] * camera.stretch
            if not larger_than_pixel(camera, w - 2.0 * r, r):
                break
            ranges[i] += 1
