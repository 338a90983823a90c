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

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.error.screen import (
    ISOTROPIC,
    ISOTROPIC_PUBLISHED,
    CameraParameters,
    Frustum,
    color_exceeds,
    outside,
    plane_of,
    sphere_bound,
    to_camera,
)
from orograph.hierarchy.kernels import diamonds, triangles
from orograph.lod.criterion import color_error, look_up
from orograph.lod.criterion import place_of as place_of_diamond
from orograph.lod.pages import BEYOND

PATCHES, NODES, TOUCHED, SPLIT, ABSENT, BLOCKED = range(6)
"""Counts: patches put out; diamonds looked at; tiles wanted; diamonds split; pages that were not there; diamonds that
wait for tiles."""

LEAST = 1e-30
"""Pixels by which tiles count at least that only colours ask for; 0 is a tile that nothing asks for."""

DONE, GROW = 0, 1
"""What the kernel returns: all is done; an array was too small."""


class Bounds(NamedTuple):
    """What decides about a diamond, beside its numbers.

    Attributes:
        camera: with the planes to cull with. eye: its own; aside: whether those are others: what is not in view of the
            eye is then judged by its distance alone.
        metric: number of a metric on spheres. cull: whether patches outside the planes are left out.
        split_at, whole_at: pixels at which diamonds are split, and at which their geomorph is over.
        plan: pixels per metre in a plan, else 0.
        holes: float64 (2n + 1,), the longest edge of the triangles of a level's patches, metres.
        away: metres from which an error without a bound is taken to be seen, the same for all diamonds, so that none
            counts for more than its parents; 0: such a diamond is split whatever the tolerance.
    """

    camera: CameraParameters
    eye: Frustum
    aside: bool
    metric: int
    cull: bool
    split_at: float
    whole_at: float
    plan: float
    holes: NDArray[np.float64]
    away: float


class Tiles(NamedTuple):
    """The tiles of all levels in one row.

    Attributes:
        bases, widths: int64 (levels,), where a level's tiles begin, and how many are in a row.
        resident: uint8, for each tile whether it is there. slots: uint32, for each tile its slot + 1, or empty.
        priorities: float32, for each tile the pixels that it would take away, 0 before. touched: int64, as many: which
            tiles have got one.
    """

    bases: NDArray[np.int64]
    widths: NDArray[np.int64]
    resident: NDArray[np.uint8]
    slots: NDArray[np.uint32]
    priorities: NDArray[np.float32]
    touched: NDArray[np.int64]


class Front(NamedTuple):
    """The queue of diamonds.

    Attributes:
        table: int32 (2^m,): hash table of places in the queue.
        keys: int64, row << 32 | col. masks: int64, planes that its triangles are inside of, as bits. sides: uint8, bits
            of the parents on both sides: 1, 2 really split, 4, 8 ideally.
        morphs, bounds: float32 (:, 2), of the triangle on each side: its geomorph, and the rest of its bound, pixels.
        kids: int64 (4, 3), for a diamond's children: x, y, omega.
    """

    table: NDArray[np.int32]
    keys: NDArray[np.int64]
    masks: NDArray[np.int64]
    sides: NDArray[np.uint8]
    morphs: NDArray[np.float32]
    bounds: NDArray[np.float32]
    kids: NDArray[np.int64]


class Instances(NamedTuple):
    """The patches put out (``shape.INSTANCE``): int32 and float32 (:, 8), the same memory.

    spans: float32 (:, 2), metres between which all heights of each lie, infinite where that is not known.
    """

    words: NDArray[np.int32]
    floats: NDArray[np.float32]
    spans: NDArray[np.float32]


@inlined
def place_of(table, keys, key):
    """Where a diamond is in the hash table, or where it would be."""
    size = np.uint64(len(table) - 1)
    at = (np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20) & size
    while table[at] >= 0 and keys[table[at]] != key:
        at = (at + np.uint64(1)) & size
    return at


@leaf
def tile_of(x, y, L, omega, step, edge):
    """(level, tile row, tile col) of a triangle's patch; the level is −1 if it lies beyond the raster."""
    level = min(step, edge[2])
    ax, ay = triangles.apex(x, y, L, omega)
    lx, ly = triangles.left_end(x, y, L, omega)
    rx, ry = triangles.right_end(x, y, L, omega)
    row, col = min(ay, min(ly, ry)), min(ax, min(lx, rx))
    if row >= edge[0] or col >= edge[1]:
        return np.int64(-1), np.int64(0), np.int64(0)
    return level, row >> (level + 8), col >> (level + 8)


@inlined
def prism_outside(camera, x, y, L, omega, z, r, inside, edge):
    """Whether all that is over a triangle, at heights z ± r, is outside a plane. False where it is squeezed."""
    ax, ay = triangles.apex(x, y, L, omega)
    lx, ly = triangles.left_end(x, y, L, omega)
    rx, ry = triangles.right_end(x, y, L, omega)
    if max(ay, max(ly, ry)) > edge[0] or max(ax, max(lx, rx)) > edge[1]:
        return False
    for plane in range(6):
        if inside >> plane & 1:
            continue
        u, v, up, rest = plane_of(camera, plane)
        most = max(u * ax + v * ay, max(u * lx + v * ly, u * rx + v * ry))
        if most + up * z + abs(up) * r + rest < 0.0:
            return True
    return False


@leaf
def put(instances, tiles, edge, at, x, y, L, omega, step, flags, morph, pixels, z, r):
    """Write a patch of heights z ± r as row ``at`` of the instances; whether it is one (not beyond the raster)."""
    level, i, j = tile_of(x, y, L, omega, step, edge)
    if level < 0:
        return 0
    words, floats = instances.words, instances.floats
    ax, ay = triangles.apex(x, y, L, omega)
    tile = tiles.bases[level] + i * tiles.widths[level] + j
    words[at, 0] = ay
    words[at, 1] = ax
    words[at, 2] = omega | step << 8 | level << 16 | flags << 24
    words[at, 3] = i | j << 16
    floats[at, 4] = morph
    words[at, 5] = np.int32(tiles.slots[tile]) - 1 if len(tiles.slots) else -1
    floats[at, 6] = pixels
    words[at, 7] = 0
    instances.spans[at, 0], instances.spans[at, 1] = z - r, z + r
    return 1


@leaf
def has_no_ground(pages, row, col):
    """Whether a diamond has nothing to draw: then what is beside it need not conform to it, nor wait for it."""
    k = diamonds.octave(row, col)
    size = np.int64(1) << k
    if row - size >= pages.edge[0] or col - size >= pages.edge[1]:
        return True
    slot, _, _, r, _ = look_up(pages, row << 32 | col, k)
    return slot == BEYOND or (slot >= 0 and r < 0.0)


@inlined
def error_in_view(pages, bounds, key, level, z, e, r, c, inside):
    """(whether a diamond is in view, its bound in pixels, whether its colours ask for a split, its bits of planes).

    Args:
        e: its error, negative if ground and missing ground share it. c: its colour error.
    """
    camera = bounds.camera
    col, row = place_of_diamond(pages, key)
    if bounds.cull:
        out, inside = outside(camera, col, row, z, r * (1.0 + 1e-9), inside)
        if out:
            return False, 0.0, False, inside
    x, y, w = to_camera(camera, col, row, z)
    seen = True
    if bounds.aside:
        away, _ = outside(bounds.eye, col, row, z, r * (1.0 + 1e-9), 0)
        seen = not away
    pixels = sphere_bound(camera, bounds.metric if seen else ISOTROPIC_PUBLISHED, x, y, w, abs(e), r)
    if bounds.away > 0.0 and pixels == np.inf:
        pixels = camera.focal * abs(e) * camera.exaggeration / bounds.away
    if e < 0.0:
        # What is missing shows to the longest edge.
        edge = bounds.holes[level]
        hole = edge if bounds.plan == 0.0 else bounds.plan * edge
        if bounds.plan == 0.0 and edge < np.inf:
            hole = sphere_bound(camera, ISOTROPIC if seen else ISOTROPIC_PUBLISHED, x, y, w, edge, r)
        pixels = max(pixels, hole)
    return True, pixels, color_exceeds(camera, np.float64(color_error(c)), w, r), inside


@inlined
def parents_split(pages, front, at, row, col, n):
    """(whether all parents of a diamond with ground are really split, ideally; whether their geomorphs are over)."""
    may, might, ripe = True, True, True
    for side in range(2):
        bits = front.sides[at] >> side
        ripe = ripe and ((bits & 5) == 0 or front.morphs[at, side] >= 1.0)
        if bits & 5 == 5:
            continue
        pr, pc = diamonds.apex(row, col, side)
        if not diamonds.is_diamond(pr, pc, n) or has_no_ground(pages, pr, pc):
            continue
        may = may and (bits & 1) == 1
        might = might and (bits & 4) == 4
    return may, might, ripe


@inlined
def bear(tiles, front, edge, counts, row, col, L, step, error, n):
    """(how many children a diamond has, whether their tiles are there); each tile gets the error as its priority."""
    born = 0
    there = True
    for side in range(2):
        tx, ty, tL, around = diamonds.top(row, col, side)
        if not triangles.inside(tx, ty, tL, around, n):
            continue
        for half in range(2):
            x, y, _, omega = triangles.child(tx, ty, tL, around, half)
            front.kids[born, 0], front.kids[born, 1], front.kids[born, 2] = x, y, omega
            born += 1
            level, i, j = tile_of(x, y, L, omega, step, edge)
            if level < 0:
                continue
            tile = tiles.bases[level] + i * tiles.widths[level] + j
            if tiles.priorities[tile] == 0.0:
                tiles.touched[counts[TOUCHED]] = tile
                counts[TOUCHED] += 1
            tiles.priorities[tile] = max(tiles.priorities[tile], error)
            there = there and tiles.resident[tile] != 0
    return born, there


@inlined
def enqueue(front, size, x, y, omega, inside, split, morph, rest):
    """Tell the diamond of a child triangle what its parent knows; the length of the queue, which it may be new in.

    Args:
        split: whether the parent is really split.
    """
    key = np.int64(y) << 32 | np.int64(x)
    place = place_of(front.table, front.keys, key)
    at = front.table[place]
    if at < 0:
        at = np.int32(size)
        size += 1
        front.table[place] = at
        front.keys[at], front.masks[at], front.sides[at] = key, 0, 0
    side = omega >> 2
    front.masks[at] |= inside
    front.sides[at] |= (5 if split else 4) << side
    front.morphs[at, side] = morph
    front.bounds[at, side] = rest
    return size


@leaf
def put_roots(pages, tiles, instances, counts, n, step):
    """The patches of a raster that is no larger than a patch."""
    for k in range(2):
        x, y, L, omega = triangles.root(np.int64(k), n)
        counts[PATCHES] += put(
            instances, tiles, pages.edge, counts[PATCHES], x, y, L, omega, step, np.int64(1), 1.0, 0.0, 0.0, np.inf
        )  # fmt: skip


@leaf
def select_patches(pages, bounds, n, q, tiles, front, instances, counts):
    """The patches of a view; returns DONE or GROW.

    Args:
        pages: ``field.Pages`` of patch diamonds (``tables.PatchTerrain``). bounds: ``Bounds``.
        n, q: exponents of the padded square and of the segments along a leg.
        tiles: ``Tiles``. front: ``Front``. instances: ``Instances``. counts: int64 (6,).
    """
    camera, edge, keys = bounds.camera, pages.edge, front.keys
    finest = 2 * (n - q)  # level of the finest patches
    front.table[:] = -1
    counts[:] = 0
    middle = np.int64(1) << n >> 1
    if finest == 0:
        put_roots(pages, tiles, instances, counts, n, n - q)
        return DONE
    keys[0], front.masks[0], front.sides[0] = middle << 32 | middle, 0, 15
    front.morphs[0, 0], front.morphs[0, 1], front.bounds[0, 0], front.bounds[0, 1] = 1.0, 1.0, 0.0, 0.0
    size = 1
    front.table[place_of(front.table, keys, keys[0])] = 0
    at = -1
    while at + 1 < size:
        if size + 4 > len(keys) or counts[PATCHES] + 4 > len(instances.words) or 2 * (size + 4) > len(front.table):
            return GROW
        at += 1
        row, col = keys[at] >> 32, keys[at] & 0xFFFFFFFF
        k = diamonds.octave(row, col)
        shape = diamonds.kind(row, col)
        level = 2 * (n - 1 - k) + shape
        # 1. Is it in view, and how large is its error?
        slot, z32, e32, r32, c32 = look_up(pages, keys[at], k)
        known = slot >= 0
        if slot == BEYOND or (known and r32 < 0.0):
            continue  # nothing to draw
        z, e, r = np.float64(z32), np.float64(e32), np.float64(r32)
        flags, pixels, colored, inside = np.int64(1), 0.0, False, front.masks[at]
        if known:
            seen, pixels, colored, inside = error_in_view(
                pages, bounds, keys[at], level, z, e, r * camera.stretch, c32, inside
            )
            if not seen:
                continue
            flags = np.int64(1 if e < 0.0 else 0)
        else:
            z, r = np.float64(0.0), np.float64(np.inf)
            counts[ABSENT] += 1
        # 2. Is it split, really and ideally?
        may, might, ripe = parents_split(pages, front, at, row, col, n)
        might = might and ripe and known and (pixels > bounds.split_at or colored)
        may = may and might
        L = np.int64(1) << k  # (of its children, whichever kind it is)
        born = 0
        if might:
            born, there = bear(
                tiles, front, edge, counts, row, col, L, k - q, np.float32(min(max(pixels, LEAST), 1e30)), n
            )
            may = may and there
            counts[SPLIT if may else BLOCKED] += 1
        # 3. Its children, or what split parents left of it.
        morph, rest = 1.0, 0.0
        if pixels < bounds.whole_at and not colored:
            morph, rest = (pixels - bounds.split_at) / (bounds.whole_at - bounds.split_at), pixels
        for child in range(born):
            x, y, omega = front.kids[child, 0], front.kids[child, 1], front.kids[child, 2]
            if level + 1 < finest:
                size = enqueue(front, size, x, y, omega, inside, may, morph, rest)
            elif may and not (bounds.cull and prism_outside(camera, x, y, L, omega, z, r, inside, edge)):
                counts[PATCHES] += put(
                    instances, tiles, edge, counts[PATCHES], x, y, L, omega, k - q, flags, morph, rest, z, r
                )
        for side in range(0 if may else 2):
            x, y, tL, omega = diamonds.top(row, col, side)
            if not front.sides[at] >> side & 1 or not triangles.inside(x, y, tL, omega, n):
                continue
            if known and bounds.cull and prism_outside(camera, x, y, tL, omega, z, r, inside, edge):
                continue
            counts[PATCHES] += put(
                instances, tiles, edge, counts[PATCHES], x, y, tL, omega, k + 1 - shape - q, flags,
                front.morphs[at, side], max(np.float64(front.bounds[at, side]), pixels), z, r,
            )  # fmt: skip
    counts[NODES] = size
    return DONE
