"""Blow's kernels: which triangles are split, how long each of those on the front may wait, and what is put out.

Two trees of triangles hold the mesh. Their leaves, and the nodes with two leaves below them, wait for the camera: for
the eye to have moved so far or the axis of view to have turned so far that what was decided may no longer hold. With
the isotropic metrics that is the eye's distance from the threshold sphere. With ``anisotropic`` the boundary depends on
the direction of view and has no closed form; ``stays`` proves for a motion x that it is not crossed, and bisection
finds a large one.

*Motion.* A camera that moves by s and turns by φ moves a point at distance D by at most x = s + (D + s)·φ in camera
coordinates. Depth, the distance from each plane of the frustum and (over U = |(a, b, c)|) the vector N of
``error.screen`` change by at most x, c by at most U·φ, the lean in the picture's corner by U·φ/cos θ. Put the worst of
each into the bound, and it holds for the whole motion. docs/metrics.md has the steps.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf
from orograph.error.screen import (
    ANISOTROPIC,
    color_exceeds,
    color_slack,
    image_motion,
    outside,
    plane_distance,
    sphere_exceeds,
    to_camera,
)
from orograph.lod.bisection import halve, has_heights
from orograph.lod.criterion import FAR_BIT, NAN, color_error, first_bits, look_up, place_of, prune
from orograph.lod.pages import BEYOND
from orograph.lod.radix_heap import PENDING, WHERE, WORK, link, list_of, unlink
from orograph.lod.threshold_spheres_trees import (
    CHILD,
    COLOR,
    DONE,
    ERROR,
    FREE,
    GROW,
    LEVEL,
    MERGES,
    MISSED,
    NOW,
    PARENT,
    PAUSED,
    RADIANS,
    RADIUS,
    REACH,
    SPLITS,
    STEPS,
    TOP,
    TURNED,
    VISITS,
    X,
    Y,
    Z,
)


@inlined
def _least(camera, col, row, z):
    """The least signed distance of a vertex from the planes of the frustum, inside positive."""
    least = np.inf
    for plane in range(6):
        least = min(least, plane_distance(camera, plane, col, row, z))
    return least


@leaf
def stays(camera, n, d, w, e, r, secant, exceeds, x, turn):
    """Whether the anisotropic bound stays on its side of the tolerance for every motion x with a turn of ``turn``.

    Args:
        n: |(a·w − c·x, b·w − c·y)| of the vertex now; d: its distance from the eye; w: its depth.
        secant: 1 / cos of the angle of the picture's corner.
        exceeds: whether the bound exceeds the tolerance now.
    """
    steep = camera.exaggeration * turn
    up = abs(camera.depth[2])
    pixels = camera.focal * e
    if exceeds:
        depth = w + x - r
        moved = max(depth, camera.near) - e * max(up - steep, 0.0)
        if not moved > 0.0:
            return True
        lean = camera.largest_lean - steep * secant
        if depth > 0.0:
            size = r * max(up - steep, 0.0) * max(d - x, 0.0) / depth
            lean = min(lean, (max(n - camera.exaggeration * x, 0.0) + size) / (w + x))
        return pixels * lean > camera.tolerance * moved * (1.0 + 1e-9)
    depth = w - x - r
    moved = (max(depth, camera.near) - e * (up + steep)) * (1.0 - 1e-9)
    if not moved > 0.0:
        return False
    lean = camera.largest_lean + steep * secant
    if depth > 0.0:
        lean = min(lean, (n + camera.exaggeration * x + r * (up + steep) * (d + x) / depth) / (w - x))
    return pixels * lean <= camera.tolerance * moved


@inlined
def _turn(share, x, d):
    """How far the axis may turn while the eye moves by a ``share`` of x and a point at distance d by x in all."""
    return (1.0 - share) * x / (d + share * x)


@leaf
def decide(camera, cull, col, row, z, e, r, c, secant, share):
    """(whether a diamond is split, the motion x for which that does not change) by the anisotropic metric."""
    x, y, w = to_camera(camera, col, row, z)
    d = np.sqrt(x * x + y * y + w * w)
    least = np.inf
    if cull:
        out, _ = outside(camera, col, row, z, r, 0)
        least = _least(camera, col, row, z)
        if out:
            return False, -r - least
    colored = color_exceeds(camera, c, w, r)
    slack = color_slack(camera, c, w, r)
    exceeds = sphere_exceeds(camera, ANISOTROPIC, x, y, w, e, r)
    motion = np.inf
    if e < np.inf and e > 0.0 and camera.focal > 0.0:
        p, q = image_motion(camera, x, y, w)
        n = np.sqrt(p * p + q * q)
        # From no motion and one too large towards each other.
        low, high = 0.0, 2.0 * d
        for _ in range(14):
            middle = 0.5 * (low + high) if low > 0.0 else 0.25 * high
            if stays(camera, n, d, w, e, r, secant, exceeds, middle, _turn(share, middle, d)):
                low = middle
            else:
                high = middle
            if low > 0.8 * high:
                break
        motion = low
    if exceeds and colored:
        motion = max(motion, slack)
    elif exceeds == colored:
        motion = min(motion, slack)
    elif colored:
        motion = slack  # whatever the error does
    if exceeds or colored:
        return True, min(motion, least + r)
    # (What is in view and accurate stays so in view, and what leaves it is so, too.)
    return False, motion


@inlined
def leave_lists(nodes, lists, v):
    """Take a node out of the lists in which it waits."""
    unlink(nodes.links, lists.ways, v)
    unlink(nodes.turning, lists.turns, v)


@inlined
def take_due(nodes, lists):
    """Put into the list of work what is due by a turn, and what lacked a page."""
    while lists.turns[WORK] >= 0:
        v = np.int64(lists.turns[WORK])
        leave_lists(nodes, lists, v)
        link(nodes.links, lists.ways, v, WORK)
    while lists.ways[PENDING] >= 0:
        v = np.int64(lists.ways[PENDING])
        unlink(nodes.links, lists.ways, v)
        link(nodes.links, lists.ways, v, WORK)


@inlined
def load(pages, criterion, frame, nodes, v, leaf_level):
    """Write what the diamond of a new node says into its numbers; whether its page is there."""
    camera, numbers = criterion.camera, nodes.numbers
    level = np.int64(nodes.links[v, LEVEL])
    key = (nodes.corners[v, 0] + nodes.corners[v, 1]) >> 1
    slot, z, e, r, c = np.int64(BEYOND), NAN, 0.0, -1.0, 0.0
    if level < leaf_level:
        slot, z, e32, r32, c32 = look_up(pages, key, (leaf_level >> 1) - 1 - (level >> 1))
        e, r, c = np.float64(e32), np.float64(r32), np.float64(c32)
        if slot < 0 and slot != BEYOND:
            return False
    if slot < 0:
        numbers[v, RADIUS], numbers[v, REACH] = 0.0, -1.0
        nodes.shown[v] = level == leaf_level
        return True
    nodes.heights[v, 3] = z if c >= 0.0 else NAN
    nodes.shown[v] = r >= 0.0
    c = color_error(c)
    r = abs(r) * camera.stretch
    reach = -1.0
    slack = frame.slack * (leaf_level - level)
    if e == np.inf:
        reach = np.inf  # (in a plan λ is 0, and 0 · ∞ no number)
    elif criterion.metric == ANISOTROPIC:
        reach = 1.0 if e > 0.0 or c > camera.color_tolerance else -1.0
    elif e > 0.0 and frame.reach > 0.0:
        reach = frame.reach * e + r + slack
    if criterion.metric != ANISOTROPIC and c > camera.color_tolerance:
        if camera.focal > 0.0:
            reach = max(reach, frame.color_reach * r + slack)
        elif color_exceeds(camera, c, 0.0, r):
            reach = np.inf
    col, row = place_of(pages, key)
    numbers[v, X] = frame.affine[0] * col + frame.affine[1] * row + frame.origin[0]
    numbers[v, Y] = frame.affine[2] * col + frame.affine[3] * row + frame.origin[1]
    numbers[v, Z] = camera.exaggeration * np.float64(z)
    numbers[v, RADIUS], numbers[v, REACH], numbers[v, ERROR], numbers[v, COLOR] = r, reach, e, c
    return True


@inlined
def boundary(pages, criterion, frame, nodes, v):
    """(whether node v is split, the motion for which that does not change, its distance, the share of moving in it)."""
    numbers = nodes.numbers
    x, y, h = numbers[v, X] - frame.eye[0], numbers[v, Y] - frame.eye[1], numbers[v, Z] - frame.eye[2]
    away = np.sqrt(x * x + y * y + h * h)
    if criterion.metric != ANISOTROPIC:
        reach = numbers[v, REACH]
        return away < reach, abs(away - reach), away, 1.0
    col, row = place_of(pages, (nodes.corners[v, 0] + nodes.corners[v, 1]) >> 1)
    # The slack goes to moving and turning in the proportion of late.
    share = min(max((frame.moved + 1e-30) / (frame.moved + frame.turned * away + 2e-30), 0.1), 0.9)
    inside, motion = decide(
        criterion.camera, criterion.cull, col, row, numbers[v, Z] / criterion.camera.exaggeration, numbers[v, ERROR],
        numbers[v, RADIUS], numbers[v, COLOR], frame.secant, share,
    )  # fmt: skip
    return inside, max(motion, 0.0) * (1.0 - 1e-9), away, share


@inlined
def schedule(frame, turns, nodes, lists, counts, v, motion, away, share):
    """Look at node v again when the eye has come as far as the boundary is now, less what roundings may do.

    Args:
        turns: whether the boundary depends on the axis of view, too.
    """
    at = np.int64(min((frame.way + share * motion) / frame.unit - 2.0, 1e18))
    nodes.due[v, 0] = max(at, counts[NOW])
    link(nodes.links, lists.ways, v, list_of(nodes.due[v, 0], counts[NOW]))
    if turns:
        at = np.int64(min((frame.turn + _turn(share, min(motion, 1e30), away)) / RADIANS - 2.0, 1e18))
        nodes.due[v, 1] = max(at, counts[TURNED])
        link(nodes.turning, lists.turns, v, list_of(nodes.due[v, 1], counts[TURNED]))


@inlined
def merge(nodes, lists, counts, v):
    """Remove the two leaves below node v, and have its parent looked at."""
    links = nodes.links
    child, parent = np.int64(links[v, CHILD]), np.int64(links[v, PARENT])
    for k in range(2):
        leave_lists(nodes, lists, child + k)
    nodes.free[counts[FREE]] = child
    counts[FREE] += 1
    counts[MERGES] += 1
    links[v, CHILD] = -1
    if parent >= 0:
        leave_lists(nodes, lists, parent)
        link(links, lists.ways, parent, WORK)


@inlined
def split_leaf(nodes, lists, counts, v):
    """Give leaf v its two halves, which are looked at next; its parent waits no more."""
    links = nodes.links
    counts[FREE] -= 1
    counts[SPLITS] += 1
    child, parent = np.int64(nodes.free[counts[FREE]]), np.int64(links[v, PARENT])
    links[v, CHILD] = child
    if parent >= 0:
        leave_lists(nodes, lists, parent)
    halve(nodes.corners, nodes.heights, v, nodes.corners, nodes.heights, child)
    for t in range(child, child + 2):
        links[t, PARENT], links[t, CHILD], links[t, LEVEL], links[t, WHERE] = v, -1, links[v, LEVEL] + 1, -1
        nodes.turning[t, WHERE] = -1
        nodes.numbers[t, REACH] = np.nan
        link(links, lists.ways, t, WORK)


@leaf
def update(pages, criterion, frame, nodes, lists, stack, counts, leaf_level, most):
    """Look at what is to be looked at, and at what is always split in view; returns why it stops. It can be called
    again.

    Args:
        pages: ``field.Pages``.
        criterion: ``Criterion`` that does not look ahead. What is out of view stays whole if it culls: with the
            isotropic metrics what is always split in view, else all.
        frame: ``Frame``. nodes: ``Nodes``. lists: ``Lists``.
        stack: int32 (4n + 8,), the nodes to look at that are always split in view. counts: int64 (8,). leaf_level: 2n.
        most: steps (``STEPS``) after which it pauses. What is left waits among the work, wherever the camera goes.
    """
    links, numbers = nodes.links, nodes.numbers
    spheres = criterion.metric != ANISOTROPIC
    take_due(nodes, lists)
    while True:
        v = np.int64(lists.ways[WORK])
        split = False
        if counts[STEPS] >= most:
            return PAUSED
        if v >= 0:
            if counts[FREE] < 1:
                return GROW
            counts[STEPS] += 1
            leave_lists(nodes, lists, v)
            if numbers[v, REACH] != numbers[v, REACH] and not load(pages, criterion, frame, nodes, v, leaf_level):
                link(links, lists.ways, v, PENDING)
                continue
            reach = numbers[v, REACH]
            if not reach > 0.0 or (spheres and reach == np.inf):
                continue  # never split; or always in view: see below
            child = np.int64(links[v, CHILD])
            if child >= 0 and (links[child, CHILD] >= 0 or links[child + 1, CHILD] >= 0):
                continue  # its turn comes when those below are gone
            counts[VISITS] += 1
            inside, motion, away, share = boundary(pages, criterion, frame, nodes, v)
            if child < 0:
                split = inside
            elif not inside:
                merge(nodes, lists, counts, v)
            schedule(frame, not spheres, nodes, lists, counts, v, motion, away, share)
        elif counts[TOP] > 0:
            # Through what is always split in view.
            if counts[FREE] < 1:
                return GROW
            v = np.int64(stack[counts[TOP] - 1])
            counts[TOP] -= 1
            if numbers[v, REACH] != np.inf:
                continue
            if criterion.cull:
                col, row = place_of(pages, (nodes.corners[v, 0] + nodes.corners[v, 1]) >> 1)
                z = numbers[v, Z] / criterion.camera.exaggeration
                out, _ = outside(criterion.camera, col, row, z, numbers[v, RADIUS], 0)
                if out:
                    continue
            child = np.int64(links[v, CHILD])
            if child >= 0:
                stack[counts[TOP]], stack[counts[TOP] + 1] = child, child + 1
                counts[TOP] += 2
            else:
                # (What was split before is passed without a step, so that each call comes farther.)
                split = True
                counts[STEPS] += 1
                stack[counts[TOP]] = v
                counts[TOP] += 1
        else:
            return DONE if lists.ways[PENDING] < 0 else MISSED
        if split:
            split_leaf(nodes, lists, counts, v)


@leaf
def put_out(pages, criterion, nodes, stack, keys, zs):
    """Write the leaves that are in view and return how many; −1 if there is no room for them.

    Args:
        pages: ``field.Pages``.
        criterion: ``Criterion``; what it prunes is put out as it is, though its boundary is crossed.
        nodes: ``Nodes``. stack: int64 (2n + 4, 2), scratch. keys: int64 (capacity, 3), zs: float32 (capacity, 3).
    """
    camera = criterion.camera
    corners, heights, numbers, links = nodes.corners, nodes.heights, nodes.numbers, nodes.links
    count = np.int64(0)
    bits = first_bits(criterion)
    stack[0, 0], stack[0, 1], stack[1, 0], stack[1, 1] = 0, bits, 1, bits
    top = 2
    while top > 0:
        top -= 1
        v, inside = stack[top, 0], stack[top, 1]
        key = (corners[v, 0] + corners[v, 1]) >> 1
        col, row = place_of(pages, key)
        z = numbers[v, Z] / camera.exaggeration
        if criterion.cull and numbers[v, RADIUS] > 0.0:
            out, inside = outside(camera, col, row, z, numbers[v, RADIUS], inside)
            if out:
                continue
        child = np.int64(links[v, CHILD])
        split = child >= 0
        if split and inside < FAR_BIT:
            _, _, w = to_camera(camera, col, row, z)
            split, hidden, inside = prune(criterion.pruned, key, w, numbers[v, RADIUS], True, inside)
            if hidden:
                continue
        if split:
            stack[top, 0], stack[top, 1], stack[top + 1, 0], stack[top + 1, 1] = child, inside, child + 1, inside
            top += 2
            continue
        if nodes.shown[v] and has_heights(heights, v):
            if count == len(keys):
                return -1
            for k in range(3):
                keys[count, k], zs[count, k] = corners[v, k], heights[v, k]
            count += 1
    return count
