"""Geomorphs: heights of a mesh's vertices that move continuously with the view, and keep the tolerance.

Lindstrom & Pascucci (TVCG 2002, sec. 5.3) let a vertex start in the middle of its edge and reach its height as its
error's bound grows, each vertex by itself. Where a chain of vertices moves at once, that is not sure to keep the
tolerance. Here the surface is the *mean of the meshes M(u)* of all tolerances u between half the tolerance and the
whole. Each of them errs by u or less, so their mean errs by less than the tolerance; it is linear on the triangles of
the finest, M(τ/2), and changes continuously with the view, as every diamond's bound does.

The mean at a vertex v with bound b (cut to [τ/2, τ]) has two parts: for u < b the vertex is in M(u), at its own height
z; for u ≥ b it lies in the middle of its edge, between the vertices l and r, which M(u) has or has not in turn. With
H(v) = ∫ M(u) du from b to τ, and G(v, b) = z(v) · (b(v) − b) + H(v) for b ≤ b(v):

    H(v) = ½ (G(l, b) + G(r, b)),    height = (z · (b − τ/2) + H(v)) / (τ/2)

Bounds are monotonic, so b(l), b(r) ≥ b. Diamonds that a squeezed border touches, and all above them, do not morph:
there the vertex is not the middle of its edge. Nor do those whose colours call for them, nor mixed ones. Heights are
metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.error.screen import CameraParameters, color_exceeds, sphere_bound, to_camera
from orograph.lod.criterion import color_error
from orograph.lod.field import Field
from orograph.lod.pages import locate


def morph(
    field: Field, camera: CameraParameters, metric: int, keys: NDArray[np.int64], heights: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Heights of the vertices of a mesh that was refined to *half* the tolerance.

    Args:
        field: the terrain, with all pages of the refinement.
        camera: of half the tolerance.
        metric: a metric of spheres, by its number.
        keys: int64, row << 32 | col of the mesh's vertices, in any number and order.
        heights: float32, theirs.

    Returns: float32, the same shape: metres.
    """
    result = heights.copy()
    if camera.tolerance == 0.0:
        return result
    size = 1 << max(8, 2 * int(keys.size) - 1).bit_length()
    while True:
        slots, known = np.full(size, -1, np.int64), np.empty((size, 3), np.float64)
        waiting = np.empty(4 * field.n + 8, np.int64)
        if morph_heights(
            field.pages,
            camera,
            metric,
            field.n,
            field.corners,
            keys.reshape(-1),
            result.reshape(-1),
            slots,
            known,
            waiting,
        ):
            return result
        size *= 2


@inlined
def place_of(slots, key):
    """Where a key is in the hash table, or where it would be."""
    size = np.uint64(len(slots) - 1)
    at = (np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20) & size
    while slots[at] != -1 and slots[at] != key:
        at = (at + np.uint64(1)) & size
    return at


@leaf
def morph_heights(pages, camera, metric, n, corners, keys, heights, slots, known, waiting):
    """Replace heights by morphed ones; whether the hash table sufficed.

    Args:
        corners: float32 (2, 2), heights of the square's corners, which are no diamonds.
        slots: int64 (2^k,), −1: keys of the vertices known; known: float64 (2^k, 3): height z, bound b, H.
        waiting: int64 (4n + 8,), vertices that wait for the ends of their edges.
    """
    half = camera.tolerance
    whole = 2.0 * half
    last_row, last_col = pages.edge[0], pages.edge[1]
    side = np.int64(1) << n
    filled = 0
    for index in range(len(keys)):
        top = 1
        waiting[0] = keys[index]
        while top:
            key = waiting[top - 1]
            at = place_of(slots, key)
            if slots[at] == key:
                top -= 1
                continue
            row, col = key >> 32, key & 0xFFFFFFFF
            both = row | col
            z, b, total = np.float64(corners[row >> n, col >> n]), whole, 0.0
            if both & (side - 1):
                step = both & -both
                octave = 0
                while step >> octave > 1:
                    octave += 1
                slot, entry = locate(pages, row, col, octave)
                if slot >= 0:
                    z = np.float64(pages.flat[entry])
                    e = np.float64(pages.flat[entry + 1])
                    r = abs(np.float64(pages.flat[entry + 2])) * camera.stretch
                    c = np.float64(pages.flat[entry + 3])
                    square = (row & step) != 0 and (col & step) != 0
                    reach = step * (3 if square else 2)
                    x, y, w = to_camera(camera, np.float64(min(col, last_col)), np.float64(min(row, last_row)), z)
                    colored = color_exceeds(camera, color_error(c), w, r)
                    beyond = (last_row < side and row + reach > last_row) or (
                        last_col < side and col + reach > last_col
                    )
                    if e < np.inf and not colored and not beyond:
                        b = min(max(sphere_bound(camera, metric, x, y, w, e, r), half), whole)
                    if b < whole:
                        # The ends of the edge whose middle the vertex is.
                        if square:
                            turned = ((row - step) // (2 * step) + (col - step) // (2 * step)) & 1
                            down, right = step, -step if turned else step
                        else:
                            down, right = (step, 0) if row & step else (0, step)
                        left = (row - down) << 32 | (col - right)
                        other = (row + down) << 32 | (col + right)
                        i, j = place_of(slots, left), place_of(slots, other)
                        if slots[i] != left or slots[j] != other:
                            if slots[i] != left:
                                waiting[top] = left
                                top += 1
                            if slots[j] != other:
                                waiting[top] = other
                                top += 1
                            continue
                        total = 0.5 * (
                            known[i, 0] * (known[i, 1] - b)
                            + known[i, 2]
                            + known[j, 0] * (known[j, 1] - b)
                            + known[j, 2]
                        )
            if 4 * filled > 3 * len(slots):
                return False
            slots[at] = key
            known[at, 0], known[at, 1], known[at, 2] = z, b, total
            filled += 1
            top -= 1
        at = place_of(slots, keys[index])
        if known[at, 1] < whole:
            heights[index] = (known[at, 0] * (known[at, 1] - half) + known[at, 2]) / half
    return True
