"""The hierarchy of a QuadTIN: right triangles in topology, whose split points lie where the points do.

Two triangles cover the domain; each is split at a point near the middle of its *base*, together with the one across it
(a *diamond*), and so on: the topology is that of a restricted quadtree, with irregular vertices. A triangle is
split while it is further than ``finest`` from the *truth*, a triangulated surface; first whatever must be split so
that no triangle has a vertex inside a side (newest-vertex bisection, as in ROAM's forced splits).

The split point is not exactly the midpoint, so a diamond could fold. Candidates are the truth's vertices that strictly
see all four corners, by orientation tests that are exact in int64 (the lattice of ``dem.delaunay``), and that leave
each half at least ``LEAST`` of its share. The one nearest to the middle is taken. If there is none, the middle itself
becomes a vertex on the truth (a Steiner point). Each triangle has a list of the truth's triangles that overlap it, so
its deviation, extreme at the truth's vertices within and where edges cross, is exact. Lattice units; metres.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf
from orograph.store.quadtin_geometry import apart, covers, crossing, enters, height_on, orient

DEAD, LIVE, MIXED = 0, 1, 2
"""States of triangles: no ground, ground everywhere, both."""

TRIANGLES, VERTICES, QUEUE, POOL, STEINER, STUCK = range(6)
"""Counts: triangles; vertices; triangles examined; entries of lists; Steiner points; triangles that cannot be split."""

LEAST = 0.25
"""The least area of a half, as a fraction of half its triangle, for a split point that is not a Steiner point."""

DONE, TRIANGLES_FULL, POOL_FULL = range(3)

RIM = 1e-9
"""Relative excess over deviations, for rounding."""


@leaf
def measure(tree, truth, t):
    """Find a triangle's state, its error and its heights from its list."""
    begin, end = tree.lists[t, 0], tree.lists[t, 1]
    a, b, c = tree.corners[t, 0], tree.corners[t, 1], tree.corners[t, 2]
    low, high, worst = np.inf, -np.inf, 0.0
    state = DEAD if begin == end else LIVE
    for i in range(begin, end):
        s = tree.pool[i]
        for k in range(3):
            p, q = truth.triangles[s, k], truth.triangles[s, (k + 1) % 3]
            low, high = min(low, truth.z[p]), max(high, truth.z[p])
            if truth.rim[s] >> k & 1 and enters(tree, truth, t, p, q):
                state = MIXED
            if covers(tree.x, tree.y, a, b, c, truth.x[p], truth.y[p]):
                worst = max(worst, abs(height_on(tree.x, tree.y, tree.z, a, b, c, truth.x[p], truth.y[p]) - truth.z[p]))
            if p < q or truth.rim[s] >> k & 1:
                worst = max(worst, crossing(tree, truth, a, b, p, q))
                worst = max(worst, crossing(tree, truth, b, c, p, q))
                worst = max(worst, crossing(tree, truth, c, a, p, q))
    tree.state[t], tree.low[t], tree.high[t] = state, low, high
    tree.error[t] = worst * (1 + RIM) if state == LIVE else 0.0


@inlined
def fits(tree, t, u, x, y, least):
    """Whether a diamond can be split at a point: it sees all corners, and no half is too small."""
    p, q, a = tree.corners[t, 0], tree.corners[t, 1], tree.corners[t, 2]
    xs, ys = tree.x, tree.y
    left, right = orient(xs[a], ys[a], xs[p], ys[p], x, y), orient(xs[q], ys[q], xs[a], ys[a], x, y)
    share = least * 0.5 * orient(xs[p], ys[p], xs[q], ys[q], xs[a], ys[a])
    if left <= 0 or right <= 0 or left < share or right < share:
        return False
    if u < 0:
        return orient(xs[p], ys[p], xs[q], ys[q], x, y) == 0
    b = tree.corners[u, 2]
    left, right = orient(xs[p], ys[p], xs[b], ys[b], x, y), orient(xs[b], ys[b], xs[q], ys[q], x, y)
    share = least * 0.5 * orient(xs[q], ys[q], xs[p], ys[p], xs[b], ys[b])
    return left > 0 and right > 0 and left >= share and right >= share


@inlined
def choose(tree, truth, t, u, by_deviation):
    """The truth's vertex at which to split a diamond, −1: none."""
    p, q = tree.corners[t, 0], tree.corners[t, 1]
    x2, y2 = tree.x[p] + tree.x[q], tree.y[p] + tree.y[q]
    best, found = np.inf, -1
    for half in range(1 if u < 0 else 2):
        h = t if half == 0 else u
        a, b, c = tree.corners[h, 0], tree.corners[h, 1], tree.corners[h, 2]
        for i in range(tree.lists[h, 0], tree.lists[h, 1]):
            for k in range(3):
                v = truth.triangles[tree.pool[i], k]
                x, y = truth.x[v], truth.y[v]
                if by_deviation:
                    if not covers(tree.x, tree.y, a, b, c, x, y):
                        continue
                    score = -abs(height_on(tree.x, tree.y, tree.z, a, b, c, x, y) - truth.z[v])
                else:
                    dx, dy = np.float64(2 * x - x2), np.float64(2 * y - y2)
                    score = dx * dx + dy * dy
                if (score < best or (score == best and v < found)) and fits(tree, t, u, x, y, LEAST):
                    best, found = score, v
    return found


@inlined
def on_truth(tree, truth, t, x, y):
    """The height of the truth at a point in a triangle; NaN where there is none."""
    for i in range(tree.lists[t, 0], tree.lists[t, 1]):
        s = tree.pool[i]
        a, b, c = truth.triangles[s, 0], truth.triangles[s, 1], truth.triangles[s, 2]
        if covers(truth.x, truth.y, a, b, c, x, y):
            return height_on(truth.x, truth.y, truth.z, a, b, c, x, y)
    return np.nan


@inlined
def side_of(tree, outline, p, q):
    """The side of the outline that two vertices lie on."""
    if tree.x[p] == tree.x[q]:
        return 0 if tree.x[p] == outline.bounds[0] else 1
    return 2 if tree.y[p] == outline.bounds[2] else 3


@inlined
def on_side(tree, truth, outline, side, p, q):
    """The vertex that halves an edge on an inner side.

    Column, row, height, whether it is a Steiner point, and whether there is room for it.
    """
    upright = side < 2
    one, two = (tree.y[p], tree.y[q]) if upright else (tree.x[p], tree.x[q])
    low, high = min(one, two), max(one, two)
    at, sample = (low + high) >> 1, False
    if outline.unit > 0:
        nearest = (at + (outline.unit >> 1)) // outline.unit * outline.unit
        if low < nearest < high:
            at, sample = nearest, True
    x, y = (tree.x[p], at) if upright else (at, tree.y[p])
    z = np.nan
    if sample:
        row, col = y // outline.unit - outline.row0, x // outline.unit - outline.col0
        z = truth.z[row * outline.width + col]
    elif outline.unit == 0:
        for i in range(outline.near_at[side], outline.near_at[side + 1]):
            s = outline.near[i]
            a, b, c = truth.triangles[s, 0], truth.triangles[s, 1], truth.triangles[s, 2]
            if covers(truth.x, truth.y, a, b, c, x, y):
                z = height_on(truth.x, truth.y, truth.z, a, b, c, x, y)
                break
    steiner = not sample or np.isnan(z)
    if np.isnan(z):
        z = 0.5 * (tree.z[p] + tree.z[q])
    return x, y, z, steiner, low < at < high


@inlined
def asked(tree, outline, t):
    """Whether a vertex of the tree beyond the outline lies inside a side of a triangle."""
    for k in range(3):
        if tree.beside[t, k] >= 0:
            continue
        p, q = tree.corners[t, k], tree.corners[t, (k + 1) % 3]
        side = side_of(tree, outline, p, q)
        one, two = (tree.y[p], tree.y[q]) if side < 2 else (tree.x[p], tree.x[q])
        low, high = min(one, two), max(one, two)
        first, end = outline.forced_at[side], outline.forced_at[side + 1]
        while first < end:
            middle = (first + end) >> 1
            if outline.forced[middle] <= low:
                first = middle + 1
            else:
                end = middle
        if first < outline.forced_at[side + 1] and outline.forced[first] < high:
            return True
    return False


@inlined
def new_vertex(tree, truth, outline, t, u, by_deviation):
    """The vertex that splits a diamond, −1: it cannot be split."""
    v = tree.counts[VERTICES]
    if u < 0:
        p, q = tree.corners[t, 0], tree.corners[t, 1]
        side = side_of(tree, outline, p, q)
        if outline.inner[side]:
            x, y, z, steiner, there = on_side(tree, truth, outline, side, p, q)
            if not there:
                return -1
            tree.x[v], tree.y[v], tree.z[v], tree.steiner[v] = x, y, z, steiner
            tree.counts[STEINER] += steiner
            tree.counts[VERTICES] = v + 1
            return v
    found = choose(tree, truth, t, u, by_deviation)
    if found >= 0:
        tree.x[v], tree.y[v], tree.z[v], tree.steiner[v] = truth.x[found], truth.y[found], truth.z[found], 0
    else:
        p, q = tree.corners[t, 0], tree.corners[t, 1]
        x, y = (tree.x[p] + tree.x[q]) >> 1, (tree.y[p] + tree.y[q]) >> 1
        if not fits(tree, t, u, x, y, 0.0):
            return -1
        z = on_truth(tree, truth, t, x, y)
        if np.isnan(z) and u >= 0:
            z = on_truth(tree, truth, u, x, y)
        if np.isnan(z):
            z = 0.5 * (tree.z[p] + tree.z[q])
        tree.x[v], tree.y[v], tree.z[v], tree.steiner[v] = x, y, z, 1
        tree.counts[STEINER] += 1
    tree.counts[VERTICES] = v + 1
    return v


@inlined
def new_triangle(tree, truth, parent, other, a, b, c):
    """Add a triangle.

    It inherits from its parent's list, and from that of the triangle across the parent's base, into which it may reach
    because the split point need not lie on the base.
    """
    t = tree.counts[TRIANGLES]
    tree.counts[TRIANGLES] = t + 1
    tree.corners[t, 0], tree.corners[t, 1], tree.corners[t, 2] = a, b, c
    tree.child[t] = tree.node[t] = -1
    at = tree.counts[POOL]
    tree.lists[t, 0] = at
    for i in range(tree.lists[parent, 0], tree.lists[parent, 1]):
        s = tree.pool[i]
        if not apart(tree, truth, t, s):
            tree.pool[at] = s
            at += 1
    if other >= 0:
        for i in range(tree.lists[other, 0], tree.lists[other, 1]):
            s = tree.pool[i]
            if not apart(tree, truth, t, s) and apart(tree, truth, parent, s):
                tree.pool[at] = s
                at += 1
    tree.lists[t, 1] = tree.counts[POOL] = at
    measure(tree, truth, t)
    return t


@inlined
def halve(tree, truth, t, u, m):
    """Make the children of a triangle; their neighbours across its base are not yet known."""
    p, q, a = tree.corners[t, 0], tree.corners[t, 1], tree.corners[t, 2]
    one = new_triangle(tree, truth, t, u, a, p, m)
    two = new_triangle(tree, truth, t, u, q, a, m)
    tree.child[t], tree.node[t] = one, m
    tree.beside[one, 0], tree.beside[one, 1], tree.beside[one, 2] = tree.beside[t, 2], -1, two
    tree.beside[two, 0], tree.beside[two, 1], tree.beside[two, 2] = tree.beside[t, 1], one, -1
    for new in (one, two):
        other = tree.beside[new, 0]
        if other >= 0:
            for k in range(3):
                if tree.beside[other, k] == t:
                    tree.beside[other, k] = new
    return one


@inlined
def split(tree, truth, outline, t, by_deviation):
    """Split a diamond; return whether that was possible."""
    u = tree.beside[t, 0]
    m = new_vertex(tree, truth, outline, t, u, by_deviation)
    if m < 0:
        return False
    tree.owners[m, 0], tree.owners[m, 1] = t, u
    one = halve(tree, truth, t, u, m)
    if u >= 0:
        other = halve(tree, truth, u, t, m)
        tree.beside[one, 1], tree.beside[other + 1, 2] = other + 1, one
        tree.beside[one + 1, 2], tree.beside[other, 1] = other, one + 1
    return True


@inlined
def wanted(tree, outline, t, finest, smallest):
    """Whether a leaf is too far from the truth, too large for partial ground, or must be split for a neighbour."""
    if tree.child[t] >= 0:
        return False
    if asked(tree, outline, t):
        return True
    if tree.state[t] == MIXED:
        p, q = tree.corners[t, 0], tree.corners[t, 1]
        dx, dy = np.float64(tree.x[p] - tree.x[q]), np.float64(tree.y[p] - tree.y[q])
        return dx * dx + dy * dy > smallest * smallest
    return tree.error[t] > finest or t < 2


@kernel
def grow(tree, truth, outline, finest, smallest, by_deviation):
    """Split all triangles that need it; resume where it stopped. Return DONE, or what is full.

    Args:
        finest: metres. smallest: lattice units.
    """
    stack = np.empty(256, np.int32)
    while tree.counts[QUEUE] < tree.counts[TRIANGLES]:
        t = tree.counts[QUEUE]
        depth = 0
        if wanted(tree, outline, t, finest, smallest):
            stack[0], depth = t, 1
        while depth:
            if tree.counts[TRIANGLES] + 4 > len(tree.child) or tree.counts[VERTICES] + 1 > len(tree.x):
                return TRIANGLES_FULL
            s = stack[depth - 1]
            u = tree.beside[s, 0]
            if u >= 0 and tree.beside[u, 0] != s:
                if depth == len(stack):
                    tree.counts[STUCK] += 1
                    break
                stack[depth], depth = u, depth + 1
                continue
            size = tree.lists[s, 1] - tree.lists[s, 0]
            if u >= 0:
                size += tree.lists[u, 1] - tree.lists[u, 0]
            if tree.counts[POOL] + 4 * size > len(tree.pool):
                return POOL_FULL
            if not split(tree, truth, outline, s, by_deviation):
                tree.counts[STUCK] += 1
                break
            depth -= 1
        tree.counts[QUEUE] += 1
    return DONE


@kernel
def gather_lists(tree, pool):
    """Copy the lists of leaves into another pool; return the number of entries."""
    at = 0
    for t in range(tree.counts[TRIANGLES]):
        begin, end = tree.lists[t, 0], tree.lists[t, 1]
        if tree.child[t] >= 0:
            tree.lists[t, 0] = tree.lists[t, 1] = 0
            continue
        tree.lists[t, 0] = at
        for i in range(begin, end):
            pool[at] = tree.pool[i]
            at += 1
        tree.lists[t, 1] = at
    tree.counts[POOL] = at
    return at
