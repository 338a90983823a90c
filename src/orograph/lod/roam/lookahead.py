"""Looking ahead: the metric ``localised`` for triangles whose verdict has to last while the camera moves.

The bound over a volume puts the largest error of all at the place from which it looks worst, which is far too much for
a triangle that is large beside its distance from the eye. ``localised`` (``lod.localise``) takes a triangle T apart
instead and finds B(T), as tight as one likes, but not monotonic: a child may ask for a split that its parent would not.
So B is closed over the bintree. With W the bound over the volume, T is

    active  ⟺  W(T) > τ, and T is far, or B(T) > τ, or a child of T is active.

If a child is active then W(child) > τ, hence W(T) > τ (volumes nest), hence T is active: monotonic by definition, and
what a neighbour needs is forced as ever. It depends on the triangle and the view alone, so splits and merges end in the
same mesh from wherever they begin. And it is conservative: T is not active only if W ≤ τ or B ≤ τ. *Far* means what it
means to the other engines (``lod.look_ahead``): there W is tight.

*For how long.* Every part of T is within the tolerance by some margin, or out of view by some distance, or the one
sample that is not gives the verdict; each of these lasts for a motion x that follows from the same three facts as in
``bounds``. The verdict lasts for the least of them. (After less than that, every part that was put aside would be put
aside again; so what was halved then holds what is halved now, and so it is with descendants.) Metres, pixels.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.error.screen import color_exceeds, color_slack, image_motion, plane_distance, plane_of, to_camera
from orograph.lod.criterion import color_error
from orograph.lod.field import find
from orograph.lod.localise import plane_through, push_halves, put, take
from orograph.lod.look_ahead import DEPTH
from orograph.lod.roam.bounds import above, screen
from orograph.lod.roam.mesh import NEARNESS, N, begin_pair
from orograph.lod.roam.queues import SPREAD, reach_of
from orograph.lod.roam.volumes import GAP, ROOM, frustum, load, straddles

PRUNED, ACTIVE, ABSENT = range(3)
"""Of a triangle whose bound exceeds the tolerance: it need not be split; it must be; a page is absent."""

FITS, SEEN, OPEN, LACKS = range(4)
"""Of a triangle by itself: within the tolerance; a sample in view is not; perhaps not; a page is absent."""


@leaf
def within(e, n, a, b, up, lean, t):
    """The motion x for which e·(n + up·x) ≤ t·(a − x)·(b − (1 + lean)·x), both depths positive, if it holds now."""
    c = t * a * b - e * n
    if not (a > 0.0 and b > 0.0 and c > 0.0):
        return 0.0
    q = t * (a * (1.0 + lean) + b) + e * up
    return 2.0 * c / (q + np.sqrt(max(q * q - 4.0 * t * (1.0 + lean) * c, 0.0)))


@leaf
def by_itself(pages, camera, node, n, t, known, reach, todo):
    """(FITS, SEEN, OPEN or LACKS; the motion for which that holds): whether B of a triangle exceeds t.

    ``lod.localise.localised_bound`` with a verdict in place of a value.

    Args:
        node: with its values, inside the raster, all surface. n: exponent of the square. t: pixels.
        known: the planes of the frustum that it is wholly inside of, as bits; while it is, for those.
        reach: metres; the motion is that of points within this distance.
        todo: float64 (DEPTH + 2, STACK), triangles that wait, as in ``lod.localise``.
    """
    focal, rise, up = camera.focal, camera.depth[2], camera.exaggeration
    e = np.float64(node.error)
    level = np.int64(node.level)
    first = np.float64(node.r0), np.float64(node.c0), np.float64(node.z0)
    second = np.float64(node.r1), np.float64(node.c1), np.float64(node.z1)
    apex = np.float64(node.r2), np.float64(node.c2), np.float64(node.z2)
    base, down, across = plane_through(first, second, apex)
    put(todo, 0, first, second, apex, 0.0)
    top = 1
    lasts, halved = np.inf, np.inf  # what was put aside so far stays there; what was not does not come there
    absent = False
    while top > 0:
        top -= 1
        left, right, over, at = take(todo, top)
        (br, bc, bz), (dr, dc, dz), (fr, fc, fz) = left, right, over
        finest = level + at == 2 * n
        hz, error = np.float64(node.height), e
        if finest:
            error = np.float64(0.0)  # it is the ground
        elif at > 0:
            slot, i, j = find(pages, np.int64(br + dr) >> 1, np.int64(bc + dc) >> 1, n - 1 - ((level + at) >> 1))
            if slot < 0:
                absent = True
                continue
            hz, error = np.float64(pages.data[slot, i, j, 0]), np.float64(pages.data[slot, i, j, 1])
        out, room = -1.0, np.inf
        for plane in range(6):
            if not known >> plane & 1:
                u, v, c, rest = plane_of(camera, plane)
                d = max(u * bc + v * br + c * bz, max(u * dc + v * dr + c * dz, u * fc + v * fr + c * fz))
                d = d + rest + error * abs(c)
                out, room = max(out, -d), min(room, d)
        # (1e-9: roundings of the plane's heights must not make the bound smaller)
        tb, td, tf = base + down * br + across * bc, base + down * dr + across * dc, base + down * fr + across * fc
        off = max(abs(bz - tb), max(abs(dz - td), abs(fz - tf)))
        length = e if at == 0 else min(e, (error + off) * (1.0 + 1e-9))
        if length <= 0.0:
            continue
        depth, most = np.inf, 0.0
        for k in range(3):
            if k == 0:
                x, y, w = to_camera(camera, bc, br, tb)
            elif k == 1:
                x, y, w = to_camera(camera, dc, dr, td)
            else:
                x, y, w = to_camera(camera, fc, fr, tf)
            p, q = image_motion(camera, x, y, w)
            depth, most = min(depth, w), max(most, p * p + q * q)
        most = np.sqrt(most)
        moved = depth - length * abs(rise)
        fits = moved > 0.0 and focal * length * most <= t * depth * moved
        if fits:
            out = max(out, within(focal * length, most, depth, moved, up, length * up / reach, t))
        if fits or out >= 0.0:
            lasts = min(lasts, out)
            continue
        halved = min(halved, min(room, above(focal * length, most, max(depth, 0.0), up, t)))
        if at >= DEPTH or finest:
            return OPEN, halved
        # The middle is a sample: what it is displaced by, if it is in view.
        mr, mc = 0.5 * (br + dr), 0.5 * (bc + dc)
        on = base + down * mr + across * mc
        x, y, w = to_camera(camera, mc, mr, hz)
        out, room = -w, np.inf
        for plane in range(6):
            if not known >> plane & 1:
                d = plane_distance(camera, plane, mc, mr, hz)
                out, room = max(out, -d), min(room, d)
        moved = w + (on - hz) * rise
        p, q = image_motion(camera, x, y, w)
        numerator, length = np.sqrt(p * p + q * q), abs(on - hz) * (1.0 + 1e-9)
        fits = w > 0.0 and moved > 0.0 and focal * length * numerator <= t * w * moved
        if not fits and out <= 0.0:
            stays = above(focal * length, numerator, max(w, moved), up, t)
            return SEEN, min(min(room, w), stays if moved > 0.0 else max(stays, -moved))
        if fits:
            out = max(out, within(focal * length, numerator, w, moved, up, 0.0, t))
        lasts = min(lasts, out)
        top = push_halves(todo, top, left, right, over, (mr, mc, hz), at + 1.0)
    return (LACKS if absent else FITS), lasts


@leaf
def foresee(root, pages, camera, options, terms, scratch, t, known, steady, slack, k):
    """(PRUNED, ACTIVE or ABSENT; the motion for which that holds) of a node, whose bound exceeds t pixels.

    Args:
        scratch: ``Scratch``; those below the node are laid down in its ``family``.
        known: the planes of the frustum it is inside of, as bits; steady: for how much motion.
        slack: the motion for which its bound goes on to exceed t. k: the class of its distance.
    """
    edge, n = pages.edge, int(options[N])
    stack, work, family, todo = scratch
    reach = SPREAD * reach_of(k)
    family[0] = root
    lasts, absent = np.inf, False
    stack[0] = 0
    top = 1
    while top > 0:
        top -= 1
        j = np.int64(stack[top])
        node = family[j]
        if j > 0:
            if not load(family, pages, options, terms, j):
                absent = True
                continue
            frustum(node, edge, camera, known, work)
            if work[GAP] >= 0.0:
                lasts = min(lasts, work[GAP])
                continue
            room = work[ROOM]
            bound, slack = screen(node, edge, camera, options, t, t)
            if bound <= t:
                lasts = min(lasts, slack)
                continue
            slack = min(slack, room)
        if node.error == np.inf or straddles(node, edge):
            return ACTIVE, min(slack, steady)
        row, col = np.float64((node.r0 + node.r1) >> 1), np.float64((node.c0 + node.c1) >> 1)
        _, _, w = to_camera(camera, col, row, np.float64(node.height))
        r = np.float64(node.radius) * camera.stretch
        c = color_error(np.float64(node.color))
        nearer = r / options[NEARNESS] - (w - r)
        if nearer <= 0.0 or color_exceeds(camera, c, w, r):
            return ACTIVE, min(min(slack, steady), -nearer if nearer <= 0.0 else np.inf)
        lasts = min(lasts, min(nearer, color_slack(camera, c, w, r)))
        kind, holds = by_itself(pages, camera, node, n, t, known, reach, todo)
        if kind == SEEN:
            return ACTIVE, min(holds, steady)
        if kind == OPEN:
            return ACTIVE, min(min(holds, slack), steady)
        absent = absent or kind == LACKS
        lasts = min(lasts, holds)
        if node.level + 1 < 2 * n:
            first = j + 1 + j % 2  # on the level below, in the place of those before
            begin_pair(family, first, j, node.height)
            stack[top], stack[top + 1] = first, first + 1
            top += 2
    return (ABSENT if absent else PRUNED), lasts
