"""The priority of a triangle, monotonic down the tree, and for how long it stays on its side of the threshold.

*Volume.* All ground under a triangle, and every mesh over it that splits it further, lies over its footprint between
two heights: those of its parent, and if tighter its corners' ± its error (if the error is a bound), and the vertex of
its diamond ± the radius of the nested sphere. So the volumes of a triangle's descendants lie inside its own, which the
paper gets from nested wedgies; with the ``exact`` error, much smaller, prisms around the triangles' planes do not nest.
(A triangle across the raster's border is squeezed; the footprint is its bounding box there, for its halves need not lie
inside it.)

*Priority* (sec. 6.1, 6.2). 0 if the volume is wholly outside a plane of the frustum; infinite if part of it is surface
and part hole; else, with the metric ``wedgie``, the paper's bound in pixels,

    f · e · max N / (a · b),    N = |(a_u·w − c_u·x, b_u·w − c_u·y)|, which does not change along a vertical,

with N at the footprint's corners, a the least depth of the volume (of a sample that is seen: at least ``near``), b that
of the mesh (at least a − e·|c_u|). Everything in it can only grow from a triangle to its parent: priorities are
monotonic, so the mesh in which no triangle exceeds the tolerance, and no merge is left that would not make one, is
unique. With a sphere metric the bound is ``sphere_bound``'s (of the anisotropic one
``loose_bound``); the published metrics promise nothing.

*Slack* (sec. 5.3). A camera motion changes each depth, each distance to a plane of the frustum, and N / |u|, by at most
x = s + D·θ (see ``queues``), u the vertical unit. With m the depth and E = f·e: a bound that is below a threshold t
stays so while E·(N + |u|·x) ≤ t·(m − g − x)², g what the metric takes off; one above while E·(N − |u|·x) > t·(m + x)²:
quadratics in x. What is outside a plane by d stays so while x < d, what is not while x < its distance from leaving.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.error.screen import color_exceeds, loose_bound, sphere_bound
from orograph.lod.field import find
from orograph.lod.roam.mesh import (
    COMPUTED,
    EMPTY,
    EXCEEDS,
    FRAME,
    LABELS,
    LOADED,
    OUT,
    PENDING,
    PINNED,
    WAITING,
)
from orograph.lod.roam.queues import PER_OCTAVE, class_of, reach_of
from orograph.lod.roam.terms import around, factor_of, is_hidden, is_pinned

# State.options
TOLERANCE, LOW, HIGH, CULL, EVERY, BOUND, METRIC, N, RATE, LEAST, MOST = range(11)
"""Pixels that have priority 1; the thresholds, pixels, below and above which nothing is computed again; whether what is
out of view is left out; whether everything is computed in every frame; whether errors are bounds; the metric's number;
the exponent of the square; how many priority units a color error of γ is worth; between which pixels all priorities are
known (``LOW`` and ``HIGH``, but for a while after those have changed)."""
OPTIONS = 16

STALE = 2.0 ** (1.0 / PER_OCTAVE) - 1.0
"""How far, as a share of it, a priority between the thresholds may have moved before it is computed again: the width of
a bucket, within which the order is any."""
NAN = np.float32(np.nan)
LARGEST = float(np.finfo(np.float32).max)
"""The largest priority of what is no hole."""


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
def frustum(node, edge, lens, known, work):
    """Where a volume lies relative to the frustum.

    Args:
        known: the planes it is known to be wholly inside of, as bits.
        work: receives [0] how far it is outside (−1: it is not), [1] how far it is from being outside of a plane that
            was tested, [2] how far from any change of a label.

    Returns:
        the planes it is wholly inside of.
    """
    gap, room, label = -1.0, np.inf, np.inf
    count = 4 if straddles(node, edge) else 3
    for plane in range(6):
        if known >> plane & 1:
            continue
        at = 20 + 4 * plane
        if lens[at + 3] == np.inf:
            known |= 1 << plane
            continue
        most, least = -np.inf, np.inf
        for k in range(count):
            row, col = corner(node, edge, k)
            d = lens[at] * col + lens[at + 1] * row
            most, least = max(most, d), min(least, d)
        c = lens[at + 2]
        most += c * (node.high if c > 0.0 else node.low) + lens[at + 3]
        least += c * (node.low if c > 0.0 else node.high) + lens[at + 3]
        if most < 0.0:
            gap = max(gap, -most)
        room = min(room, most)
        label = min(label, min(abs(most), abs(least)))
        if least >= 0.0:
            known |= 1 << plane
    work[0], work[1], work[2] = gap, room, label
    return known


@leaf
def distance(node, edge, lens):
    """At least the distance of the eye from the farthest point of a volume, stretched metres."""
    middle = 0.5 * (np.float64(node.low) + np.float64(node.high))
    most = 0.0
    count = 4 if straddles(node, edge) else 3
    for k in range(count):
        row, col = corner(node, edge, k)
        x = lens[0] * col + lens[1] * row + lens[2] * middle + lens[3]
        y = lens[4] * col + lens[5] * row + lens[6] * middle + lens[7]
        w = lens[8] * col + lens[9] * row + lens[10] * middle + lens[11]
        most = max(most, x * x + y * y + w * w)
    return np.sqrt(most) * (1.0 + 1e-12) + (np.float64(node.high) - middle) * lens[16]


@leaf
def inherited(nodes, pages, lens, clock, counts, stack, work, i):
    """The planes node i's parent is wholly inside of and for how much motion they last; labels are renewed on the way.

    A label is computed again only when the camera has moved so far that it can have changed.
    """
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
        known = frustum(node, pages.edge, lens, known, work)
        lasts = min(lasts, work[2])
        k = class_of(distance(node, pages.edge, lens))
        if k >= 0:
            lasts = min(lasts, 0.999 * reach_of(k) / 8.0)
            node.inside, node.label_class, node.label_until = known, k, clock[k] + lasts
            counts[LABELS] += 1
    return known, lasts


@leaf
def below(e, n, m, up, t):
    """The motion for which e·(n + up·x) ≤ t·(m − x)² with x ≤ m goes on to hold, if it does now."""
    if not m > 0.0:
        return 0.0
    c = t * m * m - e * n
    if not c > 0.0:
        return 0.0
    b = 2.0 * t * m + e * up
    return 2.0 * c / (b + np.sqrt(max(b * b - 4.0 * t * c, 0.0)))


@leaf
def above(e, n, m, up, t):
    """The motion for which e·(n − up·x) > t·(m + x)² goes on to hold, if it does now."""
    if e == np.inf:
        return np.inf
    c = e * n - t * m * m
    if not c > 0.0:
        return 0.0
    b = 2.0 * t * m + e * up
    return 2.0 * c / (b + np.sqrt(b * b + 4.0 * t * c))


@leaf
def priority_of(nodes, pages, lens, clock, counts, options, terms, stack, work, waiting, i):
    """Compute node i's priority, whether it is in view and over the tolerance, and when it is due again.

    A triangle out of view does not need its diamond; one in view whose page is absent waits for it.
    """
    node = nodes[i]
    counts[COMPUTED] += 1
    node.frame = counts[FRAME]
    edge = pages.edge
    node.flags &= ~np.uint8(OUT | EXCEEDS)
    node.priority = 0.0
    known, lasts = inherited(nodes, pages, lens, clock, counts, stack, work, i)
    inside = frustum(node, edge, lens, known, work)
    if not node.flags & LOADED and (
        work[0] < 0.0
        or options[CULL] == 0.0
        or terms.factors[3] > 0.0
        or (len(terms.demands) > 0 and is_pinned(node, edge, terms, np.inf))
    ):
        if not load(nodes, pages, options, terms, i):
            if not node.flags & PENDING:
                node.flags |= PENDING
                waiting[counts[WAITING]] = i
                counts[WAITING] += 1
            node.due = np.inf
            return
        inside = frustum(node, edge, lens, known, work)
    gap, room, label = work[0], work[1], work[2]
    if gap < 0.0 and lasts < 0.25 * room:
        # What is inherited lasts too briefly to wait for.
        inside = frustum(node, edge, lens, 0, work)
        gap, room, label, lasts = work[0], work[1], work[2], np.inf
    room = min(room, lasts)
    far = distance(node, edge, lens)
    k = class_of(far)
    if k >= 0:
        node.inside, node.label_class = inside, k
        node.label_until = clock[k] + min(min(label, lasts), reach_of(k) / 8.0) * 0.999
    factor, lasting = factor_of(node, edge, terms)
    if gap >= 0.0:
        node.flags |= OUT
        factor *= terms.factors[3]
        room = gap
    if factor > 0.0:
        if gap < 0.0:
            bound, slack = screen(node, edge, lens, options, options[LOW] / factor, options[HIGH] / factor)
            if terms.factors[3] > 0.0:
                # It counts for no less than it would out of view: else a child that is could count for more.
                low, high = options[LOW] / (factor * terms.factors[3]), options[HIGH] / (factor * terms.factors[3])
                aside, lasting_aside = around(node, edge, terms, lens, low, high)
                if bound <= options[HIGH] / factor:
                    slack = lasting_aside if aside > high else min(slack, lasting_aside)
                bound = max(bound, aside * terms.factors[3])
        else:
            bound, slack = around(node, edge, terms, lens, options[LOW] / factor, options[HIGH] / factor)
        bound *= factor
        if terms.factors[2] < 1.0 and bound > options[LOW]:
            slack = 0.0
            if is_hidden(node, edge, terms):
                bound *= terms.factors[2]
    else:
        bound, slack = 0.0, np.inf
    slack = min(slack, min(lasting, room))
    if node.flags & PINNED:
        bound, slack = np.inf, room
    drawn = node.flags & LOADED and (options[CULL] == 0.0 or gap < 0.0)
    is_mixed = drawn and node.error == np.inf and not node.flags & EMPTY
    if is_mixed:
        bound = np.inf  # whatever the factors: a hole's edge is kept in what is drawn
    if node.flags & EMPTY:
        bound = 0.0
    tolerance = options[TOLERANCE]
    if bound > tolerance:
        node.flags |= EXCEEDS
        node.priority = max(
            np.float32(min(bound / tolerance if tolerance > 0.0 else LARGEST, LARGEST)),
            np.nextafter(np.float32(1.0), np.float32(2.0)),
        )
        if is_mixed:
            node.priority = np.float32(np.inf)
    else:
        node.priority = min(np.float32(bound / tolerance if tolerance > 0.0 else 0.0), np.float32(1.0))
    if k < 0 or options[EVERY] > 0.0:
        node.reach, node.due = max(k, 0), -1.0
    else:
        node.reach, node.due = k, clock[k] + min(slack, reach_of(k) / 8.0) * 0.999


@leaf
def screen(node, edge, lens, options, low, high):
    """(the bound in pixels over a node's volume, the motion for which it does not come to lie between low and high).

    If it lies there, the motion for which it stays within ``STALE`` of what it is.
    """
    if not node.flags & LOADED or node.flags & EMPTY:
        return 0.0, np.inf
    e = np.float64(node.error)
    focal, near, up = lens[12], lens[14], lens[16]
    metric = int(options[METRIC])
    if e == np.inf:
        return np.inf, np.inf
    bound, slack = 0.0, np.inf
    if metric != 2 or node.color > 0.0 or node.color < -1.0:
        row = np.float64(min((node.r0 + node.r1) >> 1, edge[0]))
        col = np.float64(min((node.c0 + node.c1) >> 1, edge[1]))
        z, r = np.float64(node.height), np.float64(node.radius) * lens[15]
        x = lens[0] * col + lens[1] * row + lens[2] * z + lens[3]
        y = lens[4] * col + lens[5] * row + lens[6] * z + lens[7]
        w = lens[8] * col + lens[9] * row + lens[10] * z + lens[11]
    if e > 0.0 and focal > 0.0:
        if metric == 2:
            depth, numerator = np.inf, 0.0
            z = np.float64(node.low if lens[10] > 0.0 else node.high)
            count = 4 if straddles(node, edge) else 3
            for k in range(count):
                row_k, col_k = corner(node, edge, k)
                px = lens[0] * col_k + lens[1] * row_k + lens[2] * z + lens[3]
                py = lens[4] * col_k + lens[5] * row_k + lens[6] * z + lens[7]
                pw = lens[8] * col_k + lens[9] * row_k + lens[10] * z + lens[11]
                depth = min(depth, pw)
                p, q = lens[2] * pw - lens[10] * px, lens[6] * pw - lens[10] * py
                numerator = max(numerator, p * p + q * q)
            numerator = np.sqrt(numerator)
            nearest, taken = max(depth, near), 0.0
            moved = max(depth, nearest - e * abs(lens[10]))
            bound = focal * e * numerator / (nearest * moved) if moved > 0.0 else np.inf
        else:
            bound = loose_bound(lens, x, y, w, e, r) if metric == 0 else sphere_bound(lens, metric, x, y, w, e, r)
            depth = w - r
            nearest, taken = max(depth, near), e * up
            if metric == 0:
                p, q = lens[2] * w - lens[10] * x, lens[6] * w - lens[10] * y
                numerator = np.sqrt(p * p + q * q) + r * up
            else:
                numerator = up * (np.sqrt(x * x + y * y + w * w) + r)
        if metric > 2:
            slack = 0.0  # not bounds: nothing is known of how they change
        elif bound <= low:
            slack = below(focal * e, numerator, depth - taken, up, low)
            if near > e * up and focal * e * numerator <= low * near * (near - e * up):
                # Never nearer than ``near``, whatever the depth.
                slack = max(slack, low * near * (near - e * up) / (focal * e * up) - numerator / up)
        elif bound > high:
            slack = max(above(focal * e, numerator, max(nearest, 0.0), up, high), -depth if near == 0.0 else 0.0)
        else:
            more, less = bound * (1.0 + STALE), bound / (1.0 + STALE)
            slack = below(focal * e, numerator, depth - taken, up, more)
            slack = min(slack, above(focal * e, numerator, max(nearest, 0.0), up, less))
    if node.color > 0.0 or node.color < -1.0:
        c = np.float64(node.color)
        c = -1.0 - c if c < 0.0 else c
        if c > lens[44]:
            slack = min(slack, abs(w - r - r / lens[45]))
            if color_exceeds(lens, c, w, r):
                bound = max(bound, options[RATE] * c / max(lens[44], 1e-6))
    return bound, slack
