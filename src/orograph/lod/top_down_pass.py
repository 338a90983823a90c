"""Top-down refinement: the kernel that judges triangles and splits them, and what it works on.

Triangles live in flat arrays by *slot*: keys of the corners (left end, right end, apex; ``row << 32 | col`` of the
padded square), their heights and that of the hypotenuse's middle, and four links: the slots of the neighbours at the
left leg, the right leg and the hypotenuse (−1: none), and the level. A split keeps the slot for the left half. Every
triangle is judged once, when it is made, with all that the judgement needs; pages may leave memory afterwards. Metres,
pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.error.screen import (
    LOCALISED,
    WEDGIE,
    color_exceeds,
    outside,
    sphere_bound,
    to_camera,
    triangle_bound,
)
from orograph.lod.bisection import copy_triangle, halve, has_area, has_heights, is_inside, squeezed
from orograph.lod.criterion import (
    NAN,
    ZERO,
    color_error,
    look_up,
    place_of,
    priority,
)
from orograph.lod.localise import localised_bound, prism_outside
from orograph.lod.pages import BEYOND
from orograph.lod.queues import (
    HEAD,
    LEVEL_SHIFT,
    TAIL,
    code_of,
    first_place,
    put_in,
    take_out,
)

DONE, MISSED, GROW, PAUSED, FULL = 0, 1, 2, 3, 4
"""Why the kernel returns: nothing is left to split; pages are missing; no room; enough for now; budget used up."""

MADE, DRAWN, SPLITS, STALLED = 0, 1, 4, 5
"""Counts, with ``queues.HEAD`` and ``TAIL``: triangles; those drawn; splits; triangles in a row that lacked a page."""

LEFT, RIGHT, BASE, LEVEL = 0, 1, 2, 3
"""Links of a triangle: its neighbours at the left leg, the right leg and the hypotenuse, −1: none; its level."""


class Limits(NamedTuple):
    """When a refinement ends.

    Attributes:
        ordered: largest error first (a heap), else a FIFO.
        low: triangles with errors up to this, in pixels, are accurate.
        budget: most triangles drawn, but for what splits of mixed ones take. splits: most splits in one call.
    """

    ordered: bool
    low: float
    budget: int
    splits: int


class Search(NamedTuple):
    """How far ``localised`` goes.

    Attributes:
        depth: halvings.
        near: the radius of a sphere over its least depth from which on it is used.
    """

    depth: int
    near: float


class Triangles(NamedTuple):
    """The triangles by slot; see the module.

    Attributes:
        corners: int64 (capacity, 3). heights: float32 (capacity, 4). links: int32 (capacity, 4). drawn: uint8
            (capacity,).
    """

    corners: NDArray[np.int64]
    heights: NDArray[np.float32]
    links: NDArray[np.int32]
    drawn: NDArray[np.uint8]


class Scratch(NamedTuple):
    """What one split works with.

    Attributes:
        chain: int64 (2n + 2,), the triangles whose splits force each other.
        corners: int64 (4, 3), heights: float32 (4, 4), errors: float64 (4,), drawn: uint8 (4,): the children.
        todo: float64 (depth + 2, STACK), of ``localised``.
    """

    chain: NDArray[np.int64]
    corners: NDArray[np.int64]
    heights: NDArray[np.float32]
    errors: NDArray[np.float64]
    drawn: NDArray[np.uint8]
    todo: NDArray[np.float64]


@inlined
def next_triangle(limits, triangles, queue, counts):
    """The first triangle in the queue that has not been split by force since, −1: none; it stays there."""
    found = np.int64(-1)
    while found < 0 and counts[HEAD] != counts[TAIL]:
        at = first_place(queue, counts, limits.ordered)
        t = queue.slots[at]
        if np.int64(triangles.links[t, LEVEL]) == queue.codes[at] >> LEVEL_SHIFT:
            found = t
        else:
            take_out(queue, counts, limits.ordered)
            if not limits.ordered:
                counts[STALLED] = 0
    return found


@inlined
def evaluate(pages, criterion, search, limits, level, leaf_level, scratch, i):
    """Evaluate child i of a level: its error in pixels (−1: accurate), and whether it is drawn.

    Returns: whether a page is missing.
    """
    camera, metric = criterion.camera, criterion.metric
    n = leaf_level >> 1
    er, ec, xr, xc, ar, ac = squeezed(scratch.corners, i, pages.edge)
    ez, xz, az = scratch.heights[i, 0], scratch.heights[i, 1], scratch.heights[i, 2]
    triangle = (er, ec, ez), (xr, xc, xz), (ar, ac, az)
    whole = is_inside(scratch.corners, i, pages.edge)
    seen = has_area(er, ec, xr, xc, ar, ac)
    missed = False
    error = -1.0
    scratch.heights[i, 3] = NAN
    if level == leaf_level:
        if criterion.cull and seen:
            seen = not prism_outside(camera, triangle[0], triangle[1], triangle[2], 0.0)
    else:
        key = (scratch.corners[i, 0] + scratch.corners[i, 1]) >> 1
        slot, z, e32, r32, c = look_up(pages, key, n - 1 - (level >> 1))
        if c >= ZERO:
            scratch.heights[i, 3] = z
        e, r = np.float64(e32), abs(np.float64(r32)) * camera.stretch
        col, row = place_of(pages, key)
        missed = slot < 0 and slot != BEYOND
        seen = seen and slot >= 0 and r32 >= ZERO
        if seen and criterion.cull:
            out, _ = outside(camera, col, row, np.float64(z), r, 0)
            # (A squeezed triangle cuts unit triangles: parts of them may be farther from it than its samples.)
            if whole and not out and e < np.inf:
                out = prism_outside(camera, triangle[0], triangle[1], triangle[2], e)
            seen = not out
        if seen:
            x, y, w = to_camera(camera, col, row, np.float64(z))
            mixed, colored = e == np.inf, color_exceeds(camera, np.float64(color_error(c)), w, r)
            if mixed or colored:
                error = priority(mixed, colored, 0.0)
            elif metric != WEDGIE and metric != LOCALISED:
                error = priority(False, False, sphere_bound(camera, metric, x, y, w, e, r))
            else:
                ex, ey, ew = to_camera(camera, ec, er, np.float64(ez))
                xx, xy, xw = to_camera(camera, xc, xr, np.float64(xz))
                ax, ay, aw = to_camera(camera, ac, ar, np.float64(az))
                error = triangle_bound(camera, ex, ey, ew, xx, xy, xw, ax, ay, aw, e)
                if metric == LOCALISED and whole and error > limits.low and r > search.near * (w - r):
                    enough = np.inf if limits.ordered else limits.low
                    bound, lacks = localised_bound(
                        pages, camera, triangle, level, leaf_level, e, z, limits.low, enough, criterion.cull,
                        search.depth, scratch.todo,
                    )  # fmt: skip
                    error = min(error, bound)
                    # What is known to be too much needs no further page.
                    missed = lacks and error <= enough
                error = priority(False, False, error)
    scratch.errors[i] = error
    scratch.drawn[i] = 1 if seen and has_heights(scratch.heights, i) else 0
    return missed


@inlined
def link_halves(links, s, b, made):
    """Link the halves of s and b (−1: none): each keeps its slot for the left half; ``made`` and the next are right."""
    for side in range(2):
        t = s if side == 0 else b
        if t >= 0:
            right = np.int64(links[t, RIGHT])
            other = made + side
            links[other, LEFT], links[other, RIGHT], links[other, BASE] = -1, t, right
            if right >= 0:
                for edge in range(3):
                    if links[right, edge] == t:
                        links[right, edge] = other
            links[t, BASE], links[t, LEFT], links[t, RIGHT] = links[t, LEFT], other, -1
    if b >= 0:  # around the new vertex
        links[s, RIGHT], links[made + 1, LEFT] = made + 1, s
        links[b, RIGHT], links[made, LEFT] = made, b


@inlined
def put_children(limits, level, leaf_level, triangles, queue, scratch, counts, s, b, made, many):
    """Write the children to their slots, and put those that are not accurate into the queue."""
    for i in range(many):
        t = np.int64(i)
        if s >= 0:
            t = (made if i == 1 else made + 1) if i & 1 else (s if i == 0 else b)
        copy_triangle(scratch.corners, scratch.heights, i, triangles.corners, triangles.heights, t)
        triangles.links[t, LEVEL] = level
        triangles.drawn[t] = scratch.drawn[i]
        if scratch.errors[i] > limits.low:
            code = code_of((scratch.corners[i, 0] + scratch.corners[i, 1]) >> 1, level, leaf_level >> 1)
            put_in(queue, counts, limits.ordered, scratch.errors[i], code, t)


@leaf
def refine_triangles(pages, criterion, search, limits, leaf_level, triangles, queue, scratch, counts):
    """Split triangles until none is left that should be, or something else ends it; returns why. Can be called again.

    Args:
        pages: ``field.Pages``. criterion: ``Criterion``, of any metric, that does not look ahead. search: ``Search``.
            limits: ``Limits``. leaf_level: 2n. triangles: ``Triangles``. queue: ``Queue``. scratch: ``Scratch``; at
            first its first two children are the roots.
        counts: int64 (6,).
    """
    links, drawn, chain = triangles.links, triangles.drawn, scratch.chain
    room = len(queue.codes)
    splits_before = counts[SPLITS]
    chained = 0
    while True:
        # 1. The diamond to split: triangle s and the one across its hypotenuse, b, if there is one.
        s, b, level = np.int64(-1), np.int64(-1), np.int64(0)
        many = 2
        if counts[MADE] > 0:
            if chained == 0:
                t = next_triangle(limits, triangles, queue, counts)
                if t < 0:
                    return DONE
                if counts[SPLITS] - splits_before >= limits.splits:
                    return PAUSED
                chain[0] = t
                chained = 1
            s = chain[chained - 1]
            b = np.int64(links[s, BASE])
            if b >= 0 and links[b, BASE] != s:
                chain[chained] = b
                chained += 1
                continue
            if counts[MADE] + 2 > len(drawn) or counts[TAIL] - counts[HEAD] + 5 > room:
                return GROW
            level = np.int64(links[s, LEVEL]) + 1
            halve(triangles.corners, triangles.heights, s, scratch.corners, scratch.heights, 0)
            if b >= 0:
                halve(triangles.corners, triangles.heights, b, scratch.corners, scratch.heights, 2)
                many = 4
        # 2. Evaluate the children.
        missed = False
        change = np.int64(0)
        for i in range(many):
            missed |= evaluate(pages, criterion, search, limits, level, leaf_level, scratch, i)
            change += scratch.drawn[i]
        if missed:
            if limits.ordered or counts[MADE] == 0:
                return MISSED
            # The triangle goes to the end of the queue; the others come first.
            code = queue.codes[counts[HEAD] % room]
            counts[HEAD] += 1
            put_in(queue, counts, False, 0.0, code, chain[0])
            counts[STALLED] += 1
            chained = 0
            if counts[STALLED] > counts[TAIL] - counts[HEAD]:
                counts[STALLED] = 0
                return MISSED
            continue
        # 3. The split.
        if s >= 0:
            change -= drawn[s]
        if b >= 0:
            change -= drawn[b]
        if s >= 0 and counts[DRAWN] + change > limits.budget and queue.priorities[0] < np.inf:
            return FULL
        counts[DRAWN] += change
        counts[STALLED] = 0
        made = counts[MADE]
        if s < 0:
            counts[MADE] = 2
            links[0, LEFT] = links[0, RIGHT] = links[1, LEFT] = links[1, RIGHT] = -1
            links[0, BASE], links[1, BASE] = 1, 0
        else:
            counts[MADE] += many >> 1
            counts[SPLITS] += 1
            chained -= 1
            link_halves(links, s, b, made)
        put_children(limits, level, leaf_level, triangles, queue, scratch, counts, s, b, made, many)
