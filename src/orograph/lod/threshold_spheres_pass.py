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
from orograph.error.screen import ANISOTROPIC, color_exceeds, outside, sphere_exceeds, to_camera
from orograph.lod.field import find
from orograph.lod.look_ahead import foresee
from orograph.lod.pages import BEYOND
from orograph.lod.radix_heap import link, list_of, unlink

DONE, MISSED, GROW = 0, 1, 2
"""Why kernels return."""

PARENT, CHILD, LEVEL = 3, 4, 5
"""Links of a triangle, behind those of ``waiting``: above; the first of two below, −1: none; level."""

TOP, FREE, NOW, TURNED, VISITS, SPLITS, MERGES = range(7)
"""Counts: height of the stack; free pairs; the way and the turn, in units; triangles looked at, splits, merges."""

X, Y, Z, RADIUS, REACH, ERROR, COLOR, NUMBERS = range(8)
"""Of a triangle's diamond: its vertex (stretched metres); radius of its nested sphere; of its threshold sphere (∞:
mixed, −1: never split, NaN: not yet known; 1 if the metric has no such spheres); its errors."""

EYE, LAMBDA, UNIT, WAY, GAMMA, COLORED, SLACK, EAST, NORTH, UP, AFFINE, TURN, MOVED, ROTATED, SECANT, FRAME = (
    0, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 16, 17, 18, 19, 20,
)  # fmt: skip
"""What a frame is about: eye (3, stretched metres); λ for metres of height; metres per unit of way; the way so far,
metres; γ; reach of coloured diamonds in radii; slack per level, metres; the first sample's easting and northing; the
exaggeration; metres east per column and row, north per column and row; the turn so far, radians; by how much the camera
has moved and turned since the last frame; 1 / cos of the angle of the picture's corner."""

RADIANS = 2.0**-34
"""Radians per unit of turn."""

FAR = np.int64(1) << 60
"""The way at which what never changes is due."""


@inlined
def _least(lens, col, row, z):
    """The least signed distance of a vertex from the planes of the frustum, inside positive."""
    least = np.inf
    for plane in range(6):
        at = 20 + 4 * plane
        least = min(least, lens[at] * col + lens[at + 1] * row + lens[at + 2] * z + lens[at + 3])
    return least


@leaf
def stays(lens, n, d, w, e, r, secant, exceeds, x, turn):
    """Whether the anisotropic bound stays on its side of the tolerance for every motion x with a turn of ``turn``.

    Args:
        n: |(a·w − c·x, b·w − c·y)| of the vertex now; d: its distance from the eye; w: its depth.
        secant: 1 / cos of the angle of the picture's corner.
        exceeds: whether the bound exceeds the tolerance now.
    """
    steep = lens[16] * turn
    up = abs(lens[10])
    pixels = lens[12] * e
    if exceeds:
        depth = w + x - r
        moved = max(depth, lens[14]) - e * max(up - steep, 0.0)
        if not moved > 0.0:
            return True
        lean = lens[52] - steep * secant
        if depth > 0.0:
            size = r * max(up - steep, 0.0) * max(d - x, 0.0) / depth
            lean = min(lean, (max(n - lens[16] * x, 0.0) + size) / (w + x))
        return pixels * lean > lens[13] * moved * (1.0 + 1e-9)
    depth = w - x - r
    moved = (max(depth, lens[14]) - e * (up + steep)) * (1.0 - 1e-9)
    if not moved > 0.0:
        return False
    lean = lens[52] + steep * secant
    if depth > 0.0:
        lean = min(lean, (n + lens[16] * x + r * (up + steep) * (d + x) / depth) / (w - x))
    return pixels * lean <= lens[13] * moved


@inlined
def _turn(share, x, d):
    """How far the axis may turn while the eye moves by a ``share`` of x and a point at distance d by x in all."""
    return (1.0 - share) * x / (d + share * x)


@leaf
def decide(lens, cull, col, row, z, e, r, c, secant, share):
    """(whether a diamond is split, the motion x for which that does not change) by the anisotropic metric."""
    x, y, w = to_camera(lens, col, row, z)
    d = np.sqrt(x * x + y * y + w * w)
    least = np.inf
    if cull:
        out, _ = outside(lens, col, row, z, r, 0)
        least = _least(lens, col, row, z)
        if out:
            return False, -r - least
    colored = color_exceeds(lens, c, w, r)
    # A motion for which colours stay what they are.
    slack = abs(w - r - r / lens[45]) if c > lens[44] and lens[45] < np.inf else np.inf
    exceeds = sphere_exceeds(lens, 0, x, y, w, e, r)
    motion = np.inf
    if e < np.inf and e > 0.0 and lens[12] > 0.0:
        p, q = lens[2] * w - lens[10] * x, lens[6] * w - lens[10] * y
        n = np.sqrt(p * p + q * q)
        # From no motion and one too large towards each other.
        low, high = 0.0, 2.0 * d
        for _ in range(14):
            middle = 0.5 * (low + high) if low > 0.0 else 0.25 * high
            if stays(lens, n, d, w, e, r, secant, exceeds, middle, _turn(share, middle, d)):
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


@leaf
def update(
    pages, lens, metric, cull, way, corners, heights, numbers, due, shown, links, turning, free, heads, turns, stack,
    counts, leaf_level,
):  # fmt: skip
    """Look at what is to be looked at, and at mixed diamonds in view; returns why it stops. It can be called again.

    Args:
        pages: ``field.Pages``. lens: the camera. metric: its number.
        cull: whether what is out of view stays whole: with the isotropic metrics mixed diamonds, else all.
        way: float64 (20,), see ``EYE`` and following.
        corners: int64 (places, 3): left end, right end, apex; heights: float32 (places, 4), theirs and the middle's.
        numbers: float64 (places, 7): the diamond (X …); REACH is NaN before it is known.
        due: int64 (places, 2), the way and the turn at which to look again. shown: uint8 (places,).
        links: int32 (places, 6), of those that wait for a way; turning: int32 (places, 3), for a turn.
        free: int32 (places / 2,), first places of pairs not in use. heads, turns: int32 (67,).
        stack: int32 (4n + 8,). counts: int64 (7,). leaf_level: 2n.
    """
    n = leaf_level >> 1
    spheres = metric != ANISOTROPIC
    while turns[66] >= 0:
        v = np.int64(turns[66])
        unlink(turning, turns, v)
        unlink(links, heads, v)
        link(links, heads, v, 66)
    while heads[65] >= 0:
        v = np.int64(heads[65])
        unlink(links, heads, v)
        link(links, heads, v, 66)
    last_row, last_col = pages.edge[0], pages.edge[1]
    while True:
        v = np.int64(heads[66])
        split = False
        if v >= 0:
            if counts[1] < 1:
                return 2
            unlink(links, heads, v)
            unlink(turning, turns, v)
            level = np.int64(links[v, 5])
            if numbers[v, 4] != numbers[v, 4]:
                # New: what its diamond says.
                er, ec = corners[v, 0] >> 32, corners[v, 0] & 0xFFFFFFFF
                xr, xc = corners[v, 1] >> 32, corners[v, 1] & 0xFFFFFFFF
                if level == leaf_level:
                    numbers[v, 3], numbers[v, 4] = 0.0, -1.0
                    shown[v] = 1
                else:
                    slot, i, j = find(pages, (er + xr) >> 1, (ec + xc) >> 1, n - 1 - (level >> 1))
                    if slot == BEYOND:
                        numbers[v, 3], numbers[v, 4], shown[v] = 0.0, -1.0, 0
                        continue
                    if slot < 0:
                        link(links, heads, v, 65)
                        continue
                    row, col = min((er + xr) >> 1, last_row), min((ec + xc) >> 1, last_col)
                    z = pages.data[slot, i, j, 0]
                    e = np.float64(pages.data[slot, i, j, 1])
                    r = np.float64(pages.data[slot, i, j, 2])
                    c = np.float64(pages.data[slot, i, j, 3])
                    heights[v, 3] = z if c >= 0.0 else np.float32(np.nan)
                    c = c if c >= 0.0 else -1.0 - c
                    shown[v] = r >= 0.0
                    r = abs(r) * lens[15]
                    reach = -1.0
                    numbers[v, 5], numbers[v, 6] = e, c
                    if e == np.inf:
                        reach = np.inf  # (in a plan λ is 0, and 0 · ∞ no number)
                    elif not spheres:
                        reach = 1.0 if e > 0.0 or c > way[6] else -1.0
                    elif e > 0.0 and way[3] > 0.0:
                        reach = way[3] * e + r + way[8] * (leaf_level - level)
                    if spheres and c > way[6]:
                        reach = max(reach, way[7] * r + way[8] * (leaf_level - level))
                    numbers[v, 0] = way[12] * col + way[13] * row + way[9]
                    numbers[v, 1] = way[14] * col + way[15] * row + way[10]
                    numbers[v, 2] = way[11] * np.float64(z)
                    numbers[v, 3], numbers[v, 4] = r, reach
            reach = numbers[v, 4]
            if not reach > 0.0 or (spheres and reach == np.inf):
                continue  # never split; or mixed: see below
            child = np.int64(links[v, 4])
            if child >= 0 and (links[child, 4] >= 0 or links[child + 1, 4] >= 0):
                continue  # its turn comes when those below are gone
            counts[4] += 1
            x, y, h = numbers[v, 0] - way[0], numbers[v, 1] - way[1], numbers[v, 2] - way[2]
            away = np.sqrt(x * x + y * y + h * h)
            share = 1.0
            if spheres:
                inside, motion = away < reach, abs(away - reach)
            else:
                key = (corners[v, 0] + corners[v, 1]) >> 1
                # The slack goes to moving and turning in the proportion of late.
                share = min(max((way[17] + 1e-30) / (way[17] + way[18] * away + 2e-30), 0.1), 0.9)
                inside, motion = decide(
                    lens, cull, min(key & 0xFFFFFFFF, last_col), min(key >> 32, last_row), numbers[v, 2] / way[11],
                    numbers[v, 5], numbers[v, 3], numbers[v, 6], way[19], share,
                )  # fmt: skip
                motion = max(motion, 0.0) * (1.0 - 1e-9)
            if child >= 0:
                if not inside:
                    for k in range(2):
                        unlink(links, heads, child + k)
                        unlink(turning, turns, child + k)
                    free[counts[1]] = child
                    counts[1] += 1
                    counts[6] += 1
                    links[v, 4] = -1
                    parent = np.int64(links[v, 3])
                    if parent >= 0:
                        unlink(links, heads, parent)
                        unlink(turning, turns, parent)
                        link(links, heads, parent, 66)
            elif inside:
                split = True
            # Look again when the eye has come as far as the boundary is now, less what roundings may do.
            at = np.int64(min((way[5] + share * motion) / way[4] - 2.0, 1e18))
            due[v, 0] = max(at, counts[2])
            link(links, heads, v, list_of(due[v, 0], counts[2]))
            if not spheres:
                at = np.int64(min((way[16] + _turn(share, min(motion, 1e30), away)) / RADIANS - 2.0, 1e18))
                due[v, 1] = max(at, counts[3])
                link(turning, turns, v, list_of(due[v, 1], counts[3]))
        elif counts[0] > 0:
            # Through mixed diamonds in view.
            if counts[1] < 1:
                return 2
            v = np.int64(stack[counts[0] - 1])
            counts[0] -= 1
            if numbers[v, 4] != np.inf:
                continue
            if cull:
                key = (corners[v, 0] + corners[v, 1]) >> 1
                row, col = min(key >> 32, last_row), min(key & 0xFFFFFFFF, last_col)
                out, _ = outside(lens, col, row, numbers[v, 2] / way[11], numbers[v, 3], 0)
                if out:
                    continue
            child = np.int64(links[v, 4])
            if child >= 0:
                stack[counts[0]], stack[counts[0] + 1] = child, child + 1
                counts[0] += 2
            else:
                split = True
                stack[counts[0]] = v
                counts[0] += 1
        else:
            return 0 if heads[65] < 0 else 1
        if split:
            counts[1] -= 1
            counts[5] += 1
            child = np.int64(free[counts[1]])
            links[v, 4] = child
            parent = np.int64(links[v, 3])
            if parent >= 0:
                unlink(links, heads, parent)
                unlink(turning, turns, parent)
            m = (corners[v, 0] + corners[v, 1]) >> 1
            for half in range(2):
                t = child + half
                corners[t, 0] = corners[v, 2] if half == 0 else corners[v, 1]
                corners[t, 1] = corners[v, 0] if half == 0 else corners[v, 2]
                corners[t, 2] = m
                heights[t, 0] = heights[v, 2] if half == 0 else heights[v, 1]
                heights[t, 1] = heights[v, 0] if half == 0 else heights[v, 2]
                heights[t, 2] = heights[v, 3]
                links[t, 3], links[t, 4], links[t, 5], links[t, 2] = v, -1, links[v, 5] + 1, -1
                turning[t, 2] = -1
                numbers[t, 4] = np.nan
                link(links, heads, t, 66)


@leaf
def put_out(lens, cull, pruned, edge, scale, corners, heights, numbers, shown, links, stack, keys, zs):
    """Write the leaves that are in view and return how many; −1 if there is no room for them.

    Args:
        pruned: int64, the table of diamonds whose triangles are put out as they are, though the boundary of the bound
            over their spheres is crossed (``lod.look_ahead``).
        edge: as in ``field.Pages``. scale: the exaggeration.
        stack: int64 (2n + 4, 2), scratch. keys: int64 (capacity, 3), zs: float32 (capacity, 3).
    """
    count = np.int64(0)
    bits = np.int64(64 if len(pruned) == 1 else 0)
    stack[0, 0], stack[0, 1], stack[1, 0], stack[1, 1] = 0, bits, 1, bits
    top = 2
    while top > 0:
        top -= 1
        v, inside = stack[top, 0], stack[top, 1]
        key = (corners[v, 0] + corners[v, 1]) >> 1
        row, col = min(key >> 32, edge[0]), min(key & 0xFFFFFFFF, edge[1])
        if cull and numbers[v, 3] > 0.0:
            out, inside = outside(lens, col, row, numbers[v, 2] / scale, numbers[v, 3], inside)
            if out:
                continue
        child = np.int64(links[v, 4])
        split = child >= 0
        if split and inside < 64:
            w = lens[8] * col + lens[9] * row + lens[10] * (numbers[v, 2] / scale) + lens[11]
            split, hidden, inside = foresee(pruned, key, w, numbers[v, 3], True, inside)
            if hidden:
                continue
        if split:
            stack[top, 0], stack[top, 1], stack[top + 1, 0], stack[top + 1, 1] = child, inside, child + 1, inside
            top += 2
            continue
        total = heights[v, 0] + heights[v, 1] + heights[v, 2]
        if shown[v] and total == total:
            if count == len(keys):
                return -1
            for k in range(3):
                keys[count, k], zs[count, k] = corners[v, k], heights[v, k]
            count += 1
    return count
