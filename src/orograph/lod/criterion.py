"""Whether a triangle is fine enough: the one criterion of methods that judge diamonds. They differ in how they walk.

A triangle is split at the vertex in the middle of its hypotenuse. What is known of that vertex, its *diamond*, decides
for both triangles that share it: height, error, radius of the nested sphere, color error (``lod.pages``), and place. A
triangle is

* left out if it has no surface, or if its sphere is outside the frustum;
* split if ground and missing ground share it (the error is infinite), if the bound of its error over its sphere exceeds
  the tolerance (``error.screen``), or if its colors are off by more than γ;
* drawn otherwise.

*Looking ahead* is an option. Near the eye the bound over a sphere is too large; ``lod.look_ahead`` takes such diamonds
apart and lists those that need no split all the same, which are *pruned*. Bits that triangles inherit say which planes
of the frustum they are inside of, and that they are far, where nothing is pruned. Metres, pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined
from orograph.error.screen import (
    ANISOTROPIC,
    CameraParameters,
    anisotropic_exceeds,
    color_exceeds,
    outside,
    sphere_bound,
    sphere_exceeds,
    to_camera,
)
from orograph.lod.pages import BEYOND, locate

DROP, LEAF, SPLIT = 0, 1, 2
"""What becomes of a triangle: left out (out of view, or no surface), drawn, or split."""

FAR_BIT = 64
"""Beside the six bits of planes (``screen.outside``): the sphere is far, and so are all in it."""

EVERYWHERE = 127
"""Bits of all six planes, and that the sphere is far: nothing is tested again."""

NEAR = 1.0 / 16.0
"""Radius of the sphere over its least depth; beyond it a diamond is near. (Twice that at 1 pixel and less, in between
from 1 to 2: where meshes are fine, the search would take longer than it is worth.)"""

UNBOUNDED = float(np.finfo(np.float64).max)
"""Priority of a triangle that may be off by any number of pixels. Only one that ground and missing ground share comes
before it, with infinity: it is split whatever the budget, for no mesh with it is sound."""

NOTHING = np.full(1, -1, np.int64)
"""The table that prunes nothing."""

NAN, ZERO = np.float32(np.nan), np.float32(0.0)


class Criterion(NamedTuple):
    """What decides, beside the numbers of a diamond.

    Attributes:
        camera: with the tolerance.
        metric: number of a metric on spheres.
        cull: whether what is out of view is left out.
        pruned: int64 (2^k,), the table of diamonds that looking ahead prunes (``look_ahead.gather``), or ``NOTHING``.
    """

    camera: CameraParameters
    metric: int
    cull: bool
    pruned: NDArray[np.int64]


@inlined
def place(key, size):
    """Where to begin to look for a key in a table of 2^k places."""
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return np.int64((mixed ^ mixed >> np.uint64(32)) & np.uint64(size - 1))


@inlined
def holds(table, key):
    """0 if a table does not hold a key; 1 if its diamond is pruned, 2 if both its triangles are out of view, too."""
    size = len(table)
    at = place(key, size)
    while table[at] >= 0 and table[at] >> 1 != key:
        at = (at + 1) & (size - 1)
    return 0 if table[at] < 0 else 1 + (table[at] & 1)


@inlined
def first_bits(criterion):
    """The bits of the roots: all are far for a criterion that does not look ahead."""
    return np.int64(FAR_BIT if len(criterion.pruned) == 1 else 0)


@inlined
def prune(pruned, key, w, r, exceeds, bits):
    """(whether a diamond whose sphere ``exceeds`` is split, whether out of view, its bits), for one not known as far.

    Args:
        pruned: the table. w, r: depth and (stretched) radius of its sphere.
    """
    out = False
    # (A hair nearer than where the table ends: roundings.)
    if r <= (NEAR * (1.0 - 1e-9)) * (w - r):
        bits |= FAR_BIT
    elif exceeds:
        kind = holds(pruned, key)
        exceeds, out = kind == 0, kind == 2
    return exceeds, out, bits


@inlined
def look_up(pages, key, octave):
    """(slot, height, error, radius, color) of a vertex, float32; slot as for ``pages.locate``.

    The radius of a vertex beyond all pages is negative. A vertex of an absent page passes for accurate.
    """
    slot, at = locate(pages, key >> 32, key & 0xFFFFFFFF, octave)
    z, e, r, c = NAN, ZERO, ZERO, ZERO
    if slot >= 0:
        index = np.uint64(at)
        z = pages.flat[index]
        e = pages.flat[index + np.uint64(1)]
        r = pages.flat[index + np.uint64(2)]
        c = pages.flat[index + np.uint64(3)]
    elif slot == BEYOND:
        r = np.float32(-1.0)
    return slot, z, e, r, c


@inlined
def place_of(pages, key):
    """(column, row) of a vertex on the raster, float64."""
    return np.float64(min(key & 0xFFFFFFFF, pages.edge[1])), np.float64(min(key >> 32, pages.edge[0]))


@inlined
def color_error(c):
    """The color error of a diamond; pages hold it as −1 − c where the vertex's own sample is missing."""
    return c if c >= ZERO else np.float32(-1.0) - c


@inlined
def exceeds(camera, metric, col, row, z, e, r):
    """(whether the bound of a vertex's diamond exceeds the tolerance, its depth)."""
    if metric == ANISOTROPIC:
        found, w = anisotropic_exceeds(camera, col, row, z, e, r)
    else:
        x, y, w = to_camera(camera, col, row, z)
        found = sphere_exceeds(camera, metric, x, y, w, e, r)
    return found, w


@inlined
def colored(camera, found, z, c, w, r):
    """What its colors add to whether a diamond is split; and its height, NaN if its own sample is missing."""
    if c != ZERO:
        if c < ZERO:
            c = np.float32(-1.0) - c
            z = NAN
        found |= color_exceeds(camera, np.float64(c), w, r)
    return found, z


@inlined
def judge(pages, criterion, key, z, e, r, c, bits):
    """What becomes of the triangles that share a diamond with these numbers: (state, its height, its bits)."""
    camera = criterion.camera
    col, row = place_of(pages, key)
    radius = np.float64(r) * camera.stretch
    out = r < ZERO
    if criterion.cull and bits != EVERYWHERE and not out:
        out, bits = outside(camera, col, row, np.float64(z), radius, bits)
    found, w = exceeds(camera, criterion.metric, col, row, np.float64(z), np.float64(e), radius)
    if bits < FAR_BIT:
        found, hidden, bits = prune(criterion.pruned, key, w, radius, found, bits)
        out |= hidden
    found, z = colored(camera, found, z, c, w, radius)
    return (DROP if out else SPLIT if found else LEAF), z, bits


@inlined
def weigh(pages, criterion, key, octave, bits):
    """``judge`` for the diamond at ``key``; one whose page is absent passes for accurate."""
    _, z, e, r, c = look_up(pages, key, octave)
    return judge(pages, criterion, key, z, e, r, c, bits)


@inlined
def weigh_both(pages, criterion, first, second, octave, bits):
    """``weigh`` for two diamonds of an octave, written so that the processor can do the same for both at once."""
    camera, metric = criterion.camera, criterion.metric
    _, z1, e1, r1, c1 = look_up(pages, first, octave)
    _, z2, e2, r2, c2 = look_up(pages, second, octave)
    col1, row1 = place_of(pages, first)
    col2, row2 = place_of(pages, second)
    radius1, radius2 = np.float64(r1) * camera.stretch, np.float64(r2) * camera.stretch
    out1, out2 = r1 < ZERO, r2 < ZERO
    bits1 = bits2 = bits
    if criterion.cull and bits != EVERYWHERE:
        if not out1:
            out1, bits1 = outside(camera, col1, row1, np.float64(z1), radius1, bits)
        if not out2:
            out2, bits2 = outside(camera, col2, row2, np.float64(z2), radius2, bits)
    found1, w1 = exceeds(camera, metric, col1, row1, np.float64(z1), np.float64(e1), radius1)
    found2, w2 = exceeds(camera, metric, col2, row2, np.float64(z2), np.float64(e2), radius2)
    if bits < FAR_BIT:
        found1, hidden, bits1 = prune(criterion.pruned, first, w1, radius1, found1, bits1)
        out1 |= hidden
        found2, hidden, bits2 = prune(criterion.pruned, second, w2, radius2, found2, bits2)
        out2 |= hidden
    found1, z1 = colored(camera, found1, z1, c1, w1, radius1)
    found2, z2 = colored(camera, found2, z2, c2, w2, radius2)
    state1 = DROP if out1 else SPLIT if found1 else LEAF
    state2 = DROP if out2 else SPLIT if found2 else LEAF
    return state1, z1, bits1, state2, z2, bits2


@inlined
def priority(mixed, colored, bound):
    """Priority of a triangle in view: infinite if it is mixed, else in pixels."""
    if mixed:
        return np.inf
    return UNBOUNDED if colored else min(bound, UNBOUNDED)


@inlined
def sphere_priority(pages, criterion, key, z, e, r, c):
    """``priority`` of a diamond in view by the bound over its sphere."""
    camera = criterion.camera
    col, row = place_of(pages, key)
    radius = np.float64(abs(r)) * camera.stretch
    x, y, w = to_camera(camera, col, row, np.float64(z))
    bound = sphere_bound(camera, criterion.metric, x, y, w, np.float64(e), radius)
    return priority(e == np.inf, color_exceeds(camera, np.float64(color_error(c)), w, radius), bound)
