"""What SOAR makes of a triangle: left out, drawn or split, by the numbers of its diamond; two at a time where it can.

What ``lod.look_ahead`` knows is asked of near diamonds only: bits that triangles inherit say which planes of the
frustum they are inside of, and that they are far.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined
from orograph.error.screen import anisotropic_exceeds, color_exceeds, outside, sphere_exceeds, to_camera
from orograph.lod.look_ahead import FAR_BIT, foresee
from orograph.lod.pages import BEYOND, locate, prefetch

DROP, LEAF, SPLIT = 0, 1, 2
"""What becomes of a triangle: left out (out of view, or no surface), drawn, or split."""

EVERYWHERE = 127
"""Bits of all six planes, and that the sphere is far: nothing is tested again."""

NAN, ZERO = np.float32(np.nan), np.float32(0.0)


@inlined
def look_up(pages, key, octave):
    """The four numbers of a vertex. Of one beyond all pages the radius is negative; a page that is absent is asked for,
    and its vertices pass for accurate: this pass is not the last one."""
    slot, at = locate(pages, key >> 32, key & 0xFFFFFFFF, octave)
    z, e, r, c = NAN, ZERO, ZERO, ZERO
    if slot >= 0:
        place = np.uint64(at)
        z = pages.flat[place]
        e = pages.flat[place + np.uint64(1)]
        r = pages.flat[place + np.uint64(2)]
        c = pages.flat[place + np.uint64(3)]
    elif slot == BEYOND:
        r = np.float32(-1.0)
    return z, e, r, c


@inlined
def place_of(pages, key):
    """(column, row) of a vertex on the raster, float64."""
    return np.float64(min(key & 0xFFFFFFFF, pages.edge[1])), np.float64(min(key >> 32, pages.edge[0]))


@inlined
def exceeds(lens, metric, col, row, z, e, r):
    """(whether the bound of a vertex's diamond exceeds the tolerance, its depth)."""
    if metric == 0:
        found, w = anisotropic_exceeds(lens, col, row, z, e, r)
    else:
        x, y, w = to_camera(lens, col, row, z)
        found = sphere_exceeds(lens, metric, x, y, w, e, r)
    return found, w


@inlined
def colored(lens, found, z, c, w, r):
    """What its colours add to whether a diamond is split; and its height, NaN if its own sample is missing."""
    if c != ZERO:
        if c < ZERO:
            c = np.float32(-1.0) - c
            z = NAN
        found |= color_exceeds(lens, np.float64(c), w, r)
    return found, z


@inlined
def weigh(pages, lens, metric, cull, pruned, key, octave, mask):
    """What becomes of the triangles that share the diamond at ``key``: (state, its height, its bits)."""
    z, e, r, c = look_up(pages, key, octave)
    col, row = place_of(pages, key)
    radius = np.float64(r) * lens[15]
    out = r < ZERO
    if cull and mask != EVERYWHERE and not out:
        out, mask = outside(lens, col, row, np.float64(z), radius, mask)
    found, w = exceeds(lens, metric, col, row, np.float64(z), np.float64(e), radius)
    if mask < FAR_BIT:
        found, hidden, mask = foresee(pruned, key, w, radius, found, mask)
        out |= hidden
    found, z = colored(lens, found, z, c, w, radius)
    return (DROP if out else SPLIT if found else LEAF), z, mask


@inlined
def weigh_both(pages, lens, metric, cull, pruned, first, second, octave, mask):
    """``weigh`` for two diamonds of an octave, written so that the processor can do the same for both at once."""
    z1, e1, r1, c1 = look_up(pages, first, octave)
    z2, e2, r2, c2 = look_up(pages, second, octave)
    col1, row1 = place_of(pages, first)
    col2, row2 = place_of(pages, second)
    radius1, radius2 = np.float64(r1) * lens[15], np.float64(r2) * lens[15]
    out1, out2 = r1 < ZERO, r2 < ZERO
    mask1 = mask2 = mask
    if cull and mask != EVERYWHERE:
        if not out1:
            out1, mask1 = outside(lens, col1, row1, np.float64(z1), radius1, mask)
        if not out2:
            out2, mask2 = outside(lens, col2, row2, np.float64(z2), radius2, mask)
    found1, w1 = exceeds(lens, metric, col1, row1, np.float64(z1), np.float64(e1), radius1)
    found2, w2 = exceeds(lens, metric, col2, row2, np.float64(z2), np.float64(e2), radius2)
    if mask < FAR_BIT:
        found1, hidden, mask1 = foresee(pruned, first, w1, radius1, found1, mask1)
        out1 |= hidden
        found2, hidden, mask2 = foresee(pruned, second, w2, radius2, found2, mask2)
        out2 |= hidden
    found1, z1 = colored(lens, found1, z1, c1, w1, radius1)
    found2, z2 = colored(lens, found2, z2, c2, w2, radius2)
    state1 = DROP if out1 else SPLIT if found1 else LEAF
    state2 = DROP if out2 else SPLIT if found2 else LEAF
    return state1, z1, mask1, state2, z2, mask2


@inlined
def call(pages, key, octave):
    """Have the diamond at ``key``, a square, ready in the cache, and those on its edges."""
    prefetch(pages, key >> 32, key & 0xFFFFFFFF, octave)


@inlined
def draws(ek, xk, ak, ez, xz, az, last_row, last_col, squeezed):
    """Whether a leaf is there: no corner is missing, and it does not lie wholly beyond the raster."""
    total = ez + xz + az
    there = total == total
    if squeezed and there:
        there = min(ek, min(xk, ak)) >> 32 < last_row and (
            min(ek & 0xFFFFFFFF, min(xk & 0xFFFFFFFF, ak & 0xFFFFFFFF)) < last_col
        )
    return there
