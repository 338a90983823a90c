"""The selection: from the root down the DAG of patch diamonds, level by level, to the patches that a view needs.

A diamond is *split* if the bound of its error exceeds the tolerance (and what its children need is there), and its DAG
parents are split; that is asked for, not inferred, so that whatever tiles are there the patches conform. Diamonds wait
in a queue, found again by their vertices in a hash table, each with what is known of its two top triangles: whether the
parent on that side is split, and how far the geomorph of its children is. Those that are not split put out the
triangles that split parents left them. As the DAG's arrows lead from one level to the next, the queue is in the order
of levels and all parents have been judged when a diamond's turn comes.

Two refinements go down at once: the *real* one, of tiles that are there, and the *ideal* one, of all; what only the
ideal one splits tells which tiles are wanted, and how many pixels of error they would take away. Pixels, samples.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf
from orograph.error.screen import outside, sphere_bound, to_camera
from orograph.hierarchy.kernels import diamonds, triangles
from orograph.lod.field import find
from orograph.lod.pages import BEYOND

PATCHES, NODES, TOUCHED, SPLIT, ABSENT, BLOCKED = range(6)
"""Counts: patches put out; diamonds looked at; tiles wanted; diamonds split; pages that were not there; diamonds that
wait for tiles."""

DONE, GROW = 0, 1
"""What the kernel returns: all is done; an array was too small."""


@inlined
def place_of(table, keys, key):
    """Where a diamond is in the hash table, or where it would be."""
    size = np.uint64(len(table) - 1)
    at = (np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20) & size
    while table[at] >= 0 and keys[table[at]] != key:
        at = (at + np.uint64(1)) & size
    return at


@leaf
def tile_of(x, y, L, omega, step, top, last_row, last_col):
    """(level, tile row, tile col) of a triangle's patch; the level is −1 if it lies beyond the raster."""
    level = min(step, top)
    ax, ay = triangles.apex(x, y, L, omega)
    lx, ly = triangles.left_end(x, y, L, omega)
    rx, ry = triangles.right_end(x, y, L, omega)
    row, col = min(ay, min(ly, ry)), min(ax, min(lx, rx))
    if row >= last_row or col >= last_col:
        return np.int64(-1), np.int64(0), np.int64(0)
    return level, row >> (level + 8), col >> (level + 8)


@leaf
def prism_outside(lens, x, y, L, omega, z, r, inside, last_row, last_col):
    """Whether all that is over a triangle, at heights z ± r, is outside a plane. False where it is squeezed."""
    ax, ay = triangles.apex(x, y, L, omega)
    lx, ly = triangles.left_end(x, y, L, omega)
    rx, ry = triangles.right_end(x, y, L, omega)
    if max(ay, max(ly, ry)) > last_row or max(ax, max(lx, rx)) > last_col:
        return False
    for plane in range(6):
        if inside >> plane & 1:
            continue
        at = 20 + 4 * plane
        u, v = lens[at], lens[at + 1]
        most = max(u * ax + v * ay, max(u * lx + v * ly, u * rx + v * ry))
        if most + lens[at + 2] * z + abs(lens[at + 2]) * r + lens[at + 3] < 0.0:
            return True
    return False


@leaf
def put(
    words, floats, at, places, bases, widths, x, y, L, omega, step, top, last_row, last_col, flags, morph, pixels
):  # fmt: skip
    """Write a patch as row ``at`` of the instances; whether it is one (not beyond the raster)."""
    level, i, j = tile_of(x, y, L, omega, step, top, last_row, last_col)
    if level < 0:
        return 0
    ax, ay = triangles.apex(x, y, L, omega)
    words[at, 0] = ay
    words[at, 1] = ax
    words[at, 2] = omega | step << 8 | level << 16 | flags << 24
    words[at, 3] = i | j << 16
    floats[at, 4] = morph
    words[at, 5] = np.int32(places[bases[level] + i * widths[level] + j]) - 1 if len(places) else -1
    floats[at, 6] = pixels
    words[at, 7] = 0
    return 1


@leaf
def has_no_ground(pages, row, col, last_row, last_col):
    """Whether a diamond has nothing to draw: then what is beside it need not conform to it, nor wait for it."""
    k = diamonds.octave(row, col)
    size = np.int64(1) << k
    if row - size >= last_row or col - size >= last_col:
        return True
    slot, u, v = find(pages, row, col, k)
    return slot == BEYOND or (slot >= 0 and pages.data[slot, u, v, 2] < 0.0)


@leaf
def select_patches(
    pages, lens, eye, metric, cull, n, q, tolerances, holes, resident, places, bases, widths, priorities, touched,
    table, keys, masks, sides, morphs, bounds, kids, words, floats, counts,
):  # fmt: skip
    """The patches of a view; returns DONE or GROW.

    Args:
        pages: ``field.Pages`` of patch diamonds (``tables.PatchTerrain``).
        lens: the camera, with the planes to cull with. metric: its number, of one on spheres.
        eye: the camera with its own planes if those of ``lens`` are another volume's, else empty: what is not in view
            of the eye is then judged by its distance alone.
        cull: whether patches outside the planes are left out.
        n, q: exponents of the padded square and of the segments along a leg.
        tolerances: float64 (3,): pixels at which diamonds are split; those at which their geomorph is over; pixels per
            metre in a plan, else 0.
        holes: float64 (2n + 1,), the longest edge of the triangles of a level's patches, metres.
        resident: uint8, for each tile whether it is there. places: uint32, for each tile its slot + 1, or empty.
        bases, widths: int64 (levels,), where a level's tiles begin in these, and how many are in a row.
        priorities: float32, as many, 0 before: the pixels that a tile would take away; touched: int64, as many: which
            tiles have got one.
        table: int32 (2^m,): hash table. keys, masks: int64, sides: uint8, morphs: float32 (:, 2), bounds: float32
            (:, 2), all of one length: the queue. kids: int64 (4, 3), for a diamond's children.
        words, floats: int32 and float32 (:, 8), the same memory: the instances (``shape.INSTANCE``).
        counts: int64 (6,).
    """
    last_row, last_col, top = pages.edge[0], pages.edge[1], pages.edge[2]
    finest = 2 * (n - q)  # level of the finest patches
    split_at, whole_at, plan = tolerances[0], tolerances[1], tolerances[2]
    table[:] = -1
    counts[:] = 0
    room, space = len(keys), len(words)
    middle = np.int64(1) << n >> 1
    if finest == 0:  # the raster is no larger than a patch
        for k in range(2):
            x, y, L, omega = triangles.root(np.int64(k), n)
            counts[0] += put(
                words, floats, counts[0], places, bases, widths, x, y, L, omega, n - q, top, last_row, last_col, 1,
                1.0, 0.0,
            )  # fmt: skip
        return 0
    keys[0], masks[0], sides[0] = middle << 32 | middle, 0, 15
    morphs[0, 0], morphs[0, 1], bounds[0, 0], bounds[0, 1] = 1.0, 1.0, 0.0, 0.0
    size = 1
    table[place_of(table, keys, keys[0])] = 0
    head = 0
    while head < size:
        if size + 4 > room or counts[0] + 4 > space or 2 * (size + 4) > len(table):
            return 1
        at = head
        head += 1
        row, col = keys[at] >> 32, keys[at] & 0xFFFFFFFF
        k = diamonds.octave(row, col)
        shape = diamonds.kind(row, col)
        level = 2 * (n - 1 - k) + shape
        # 1. Is it in view, and how large is its error?
        slot, u, v = find(pages, row, col, k)
        if slot == BEYOND:
            continue
        known = slot >= 0
        flags = 1
        pixels = 0.0
        inside = masks[at]
        z, e, r = np.float64(0.0), np.float64(0.0), np.float64(0.0)
        mixed = e < 0.0
        if known:
            z = np.float64(pages.data[slot, u, v, 0])
            e = np.float64(pages.data[slot, u, v, 1])
            r = np.float64(pages.data[slot, u, v, 2])
            if r < 0.0:
                continue  # nothing to draw; its sphere means nothing
            mixed = e < 0.0
            e = abs(e)
            reach = r * lens[15]
            mr, mc = min(row, last_row), min(col, last_col)
            if cull:
                out, inside = outside(lens, mc, mr, z, reach * (1.0 + 1e-9), inside)
                if out:
                    continue
            x, y, w = to_camera(lens, np.float64(mc), np.float64(mr), z)
            seen = len(eye) == 0
            if not seen:
                away, _ = outside(eye, mc, mr, z, reach * (1.0 + 1e-9), 0)
                seen = not away
            pixels = sphere_bound(lens, metric if seen else 3, x, y, w, e, reach)
            if mixed:
                # What is missing shows to the longest edge.
                edge = holes[level]
                hole = edge if plan == 0.0 else plan * edge
                if plan == 0.0 and edge < np.inf:
                    hole = sphere_bound(lens, 1 if seen else 3, x, y, w, edge, reach)
                pixels = max(pixels, hole)
            flags = 1 if mixed else 0
        else:
            counts[4] += 1
        # 2. Is it split? Bits of sides: 1, 2 parents really split, 4, 8 ideally.
        may, might = True, True
        for side in range(2):
            if sides[at] >> side & 5 == 5:
                continue
            pr, pc = diamonds.apex(row, col, side)
            if not diamonds.is_diamond(pr, pc, n) or has_no_ground(pages, pr, pc, last_row, last_col):
                continue
            may = may and (sides[at] >> side & 1) == 1
            might = might and (sides[at] >> side & 4) == 4
        ripe = True
        for side in range(2):
            ripe = ripe and ((sides[at] >> side & 5) == 0 or morphs[at, side] >= 1.0)
        might = might and ripe and known and pixels > split_at
        may = may and might
        born = 0
        L = np.int64(1) << k  # (of its children, whichever kind it is)
        if might:
            error = np.float32(min(pixels, 1e30))
            for side in range(2):
                tx, ty, tL, around = diamonds.top(row, col, side)
                if not triangles.inside(tx, ty, tL, around, n):
                    continue
                for half in range(2):
                    x, y, _, omega = triangles.child(tx, ty, tL, around, half)
                    kids[born, 0], kids[born, 1], kids[born, 2] = x, y, omega
                    born += 1
                    tile_level, i, j = tile_of(x, y, L, omega, k - q, top, last_row, last_col)
                    if tile_level < 0:
                        continue
                    tile = bases[tile_level] + i * widths[tile_level] + j
                    if priorities[tile] == 0.0:
                        touched[counts[2]] = tile
                        counts[2] += 1
                    priorities[tile] = max(priorities[tile], error)
                    may = may and resident[tile] != 0
            if not may:
                counts[5] += 1
        # 3. Its children, or what split parents left of it.
        if might:
            counts[3] += 1 if may else 0
            morph = 1.0
            if pixels < whole_at:
                morph = (pixels - split_at) / (whole_at - split_at)
            rest = pixels if pixels < whole_at else 0.0
            for child in range(born):
                x, y, omega = kids[child, 0], kids[child, 1], kids[child, 2]
                if level + 1 == finest:
                    if may:
                        if cull and prism_outside(lens, x, y, L, omega, z, r, inside, last_row, last_col):
                            continue
                        counts[0] += put(
                            words, floats, counts[0], places, bases, widths, x, y, L, omega, k - q, top, last_row,
                            last_col, flags, morph, rest,
                        )  # fmt: skip
                    continue
                name = np.int64(y) << 32 | np.int64(x)
                place = place_of(table, keys, name)
                other = table[place]
                if other < 0:
                    other = np.int32(size)
                    size += 1
                    table[place] = other
                    keys[other], masks[other], sides[other] = name, 0, 0
                side = omega >> 2
                masks[other] |= inside
                sides[other] |= (5 if may else 4) << side
                morphs[other, side] = morph
                bounds[other, side] = rest
        if not may:
            for side in range(2):
                if sides[at] >> side & 1:
                    x, y, tL, omega = diamonds.top(row, col, side)
                    if not triangles.inside(x, y, tL, omega, n):
                        continue
                    if known and cull and prism_outside(lens, x, y, tL, omega, z, r, inside, last_row, last_col):
                        continue
                    rest = max(np.float64(bounds[at, side]), pixels)
                    counts[0] += put(
                        words, floats, counts[0], places, bases, widths, x, y, tL, omega, k + 1 - shape - q, top,
                        last_row, last_col, flags, morphs[at, side], rest,
                    )  # fmt: skip
    counts[1] = size
    return 0
