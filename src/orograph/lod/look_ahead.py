"""Looking ahead: the metric ``localised`` for engines that ask one question for a whole diamond.

The bound over a diamond's nested sphere is too large where the sphere is large beside its distance: it puts the largest
error of all at the place from which it looks worst. ``lod.localise`` takes the two triangles of a diamond apart instead
and finds B, as tight as one likes; but B is not monotonic, and these engines need it to be. So B is *closed*:

    a diamond d is active  ⟺  S(d) > τ, and it is far, or B(d) > τ, or any of its children in the diamond DAG is active,

S being the bound over the sphere, and *far* that its radius is less than ``NEAR`` of the sphere's distance from the
eye's plane, where S is tight. If a child is active then S(child) > τ, hence S(d) > τ, hence d is active: monotonic by
definition. It depends on the diamond and the view alone, so both triangles of a diamond agree. And it is conservative:
who is not active has S ≤ τ or B ≤ τ. (docs/metrics.md)

Spheres nest, so who is far has far children only. The others, the *near* diamonds with S > τ, are few: those within
some sixteen radii of the eye, level by level, a number that does not depend on the size of the mesh. They are collected
from the root down, each once, and decided from the finest up, so that B is asked only of those that have no active
child. What comes out is a small table of the diamonds that are *pruned*: S > τ and yet inactive. Engines look up near
diamonds there, and are else what they were.

Mixed diamonds, those whose colours are off by too much and those that straddle the border of a raster that is not 2^n +
1 samples wide are active as S says, or at once. Roundings: here S is compared with a τ smaller by 10^-9, so that no
engine, whatever its order of operations, finds a diamond active whose parents are pruned.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.error.screen import FOCAL, TOLERANCE, color_exceeds, outside, sphere_exceeds, to_camera
from orograph.hierarchy.kernels import diamonds
from orograph.lod.field import Field
from orograph.lod.localise import STACK, diamond_exceeds
from orograph.lod.pages import BEYOND, locate

NEAR = 1.0 / 16.0
"""Radius of the sphere over its least depth; beyond it a diamond is near. (Twice that at 1 pixel and less, in between
from 1 to 2: where meshes are fine, the search would take longer than it is worth.)"""

DEPTH = 6
"""Halvings by which triangles are taken apart."""

FAR_BIT = 64
"""Beside the six bits of planes (``screen.outside``): the sphere is far, and so are all in it."""

NOTHING = np.full(1, -1, np.int64)
"""The table in which there is nothing."""

NONE, FAR, ACTIVE, OPEN, MISSING = range(5)
"""Of a diamond: it is accurate, or out of view; far and active; near and active anyway; near; its page is missing."""

DONE, MISSED, ROOM = range(3)
"""Why kernels return."""

PATIENCE = 16
"""How many times as many pages as memory holds may be read; then memory is too small for the search, and spheres decide
alone."""


def nearness(tolerance: float) -> float:
    """The radius of a sphere over its least depth from which on it is near, at a tolerance in pixels."""
    return NEAR * min(max(1.0, 2.0 / tolerance), 2.0)


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
def foresee(pruned, key, w, r, exceeds, bits):
    """(whether a diamond whose sphere ``exceeds`` is active, whether out of view, its bits), for one not known as far.

    Args:
        pruned: the table of ``Ahead.pruned``. w, r: depth and (stretched) radius of its sphere.
        bits: of a triangle's sphere, six of planes and ``FAR_BIT``.
    """
    out = False
    # (A hair nearer than where the table ends: roundings.)
    if r <= (NEAR * (1.0 - 1e-9)) * (w - r):
        bits |= 64
    elif exceeds:
        kind = holds(pruned, key)
        exceeds, out = kind == 0, kind == 2
    return exceeds, out, bits


@inlined
def what(pages, lens, near, cull, row, col, octave, bits):
    """(NONE, FAR, ACTIVE, OPEN or MISSING, of the diamond at (row, col); its bits of planes)."""
    slot, at = locate(pages, row, col, octave)
    kind = np.uint8(0 if slot == BEYOND or slot >= 0 else 4)
    if slot >= 0:
        x, y = np.float64(min(col, pages.edge[1])), np.float64(min(row, pages.edge[0]))
        z, e = np.float64(pages.flat[np.uint64(at)]), np.float64(pages.flat[np.uint64(at + 1)])
        r, c = np.float64(pages.flat[np.uint64(at + 2)]), np.float64(pages.flat[np.uint64(at + 3)])
        empty = r < 0.0
        r = abs(r) * lens[15]
        out = False
        if cull and bits != 63:
            out, bits = outside(lens, x, y, z, r, bits)
        if not out:
            cx, cy, cw = to_camera(lens, x, y, z)
            c = c if c >= 0.0 else -1.0 - c
            sure = e == np.inf or color_exceeds(lens, c, cw, r)
            if sure or sphere_exceeds(lens, 0, cx, cy, cw, e, r):
                kind = np.uint8(1 if r <= near * (cw - r) else 2 if sure or empty else 3)
    return kind, bits


@leaf
def collect(pages, slack, near, cull, n, ahead, found, state, kids, keys, values, counts):
    """Collect the near diamonds whose sphere exceeds the tolerance, level by level.

    Args:
        slack: the camera, with a tolerance a hair smaller.
        near: the ratio from which on spheres are near, at least ``NEAR``.
        ahead: whether to ask for the pages of those that come after one that lacks its page, too.
        found: int64 (capacity, 3), rows, columns, bits of planes; out. state: uint8 (capacity,), 1 if surely active;
            out.
        kids: int32 (capacity, 4), where their children are in ``found``, −1: nowhere.
        keys: int64 (2^k,), all −1; values: int32 (2^k,): a table of those met, and where they are in ``found``, or −1
            (accurate), −2 (far and active).
        counts: int64 (5,): how many were found; of them done; children of the next that are; how many were met; all 0
            at first.

    Returns: DONE; or MISSED or ROOM, and it can be called again.
    """
    size, room = len(keys), len(found)
    side = np.int64(1) << n
    half = side >> 1
    missed = False
    if counts[0] == 0:
        kind, bits = what(pages, slack, near, cull, half, half, n - 1, 0)
        if kind == 4:
            return 1
        if kind >= 2:
            found[0, 0], found[0, 1], found[0, 2], state[0] = half, half, bits, kind == 2
            counts[0] = 1
    done, first = counts[1], counts[2]
    while done < counts[0]:
        if counts[0] + 4 > room or 2 * (counts[3] + 4) > size:
            return 2
        row, col, bits = found[done, 0], found[done, 1], found[done, 2]
        octave = np.int64(diamonds.octave(row, col))
        s = np.int64(1) << octave
        square = (row >> octave) & (col >> octave) & 1
        # The children of a square are the edges s up and down, left and right; of an edge, squares a half s aside.
        if not square:
            s >>= 1
            octave -= 1
        for k in range(first, 4):
            if not missed:
                kids[done, k] = -1
            r, c = row, col
            if square:
                if k < 2:
                    r += s if k else -s
                else:
                    c += s if k & 1 else -s
            else:
                r += s if k & 1 else -s
                c += s if k & 2 else -s
            if s == 0 or min(r, c) < 0 or max(r, c) > side:
                continue
            key = r << 32 | c
            at = place(key, size)
            while keys[at] >= 0 and keys[at] != key:
                at = (at + 1) & (size - 1)
            if keys[at] < 0:
                kind, inside = what(pages, slack, near, cull, r, c, octave, bits)
                if kind == 4 and not missed:
                    missed = True
                    counts[1], counts[2] = done, k
                    if not ahead:
                        return 1
                if missed:
                    continue
                keys[at], values[at] = key, -1
                counts[3] += 1
                if kind == 1:
                    values[at] = -2
                elif kind >= 2:
                    to = counts[0]
                    values[at] = to
                    found[to, 0], found[to, 1], found[to, 2], state[to] = r, c, inside, kind == 2
                    counts[0] += 1
            if missed:
                continue
            if values[at] == -2:
                state[done] = 1
            else:
                kids[done, k] = values[at]
        done += 1
        first = 0
    if missed:
        return 1
    counts[1], counts[2], counts[4] = done, 0, done
    return 0


@leaf
def decide(pages, lens, depth, cull, n, ahead, found, state, kids, counts, todo):
    """Decide, from the finest up, which of those that were collected are active: 1 in ``state``, else 0 or 2.

    Args:
        lens: the camera. ahead: as for ``collect``. todo: scratch of ``diamond_exceeds``.
        counts: its last number is how many are left.
    """
    missed = np.int64(0)
    at = counts[4]
    while at > 0 and missed < 64:
        at -= 1
        sure = state[at] == 1
        for k in range(4):
            sure = sure or (kids[at, k] >= 0 and state[kids[at, k]] == 1)
        verdict, lacks = np.int64(1), False
        if not sure:
            verdict, lacks = diamond_exceeds(pages, lens, cull, depth, found[at, 0], found[at, 1], n, todo)
        if lacks and not ahead:
            return 1
        if lacks or missed > 0:
            missed += 1
            continue
        state[at] = verdict
        counts[4] = at
    return 1 if missed > 0 else 0


@leaf
def gather(found, state, count, table):
    """Put the inactive ones of the first ``count`` into a table, int64 (2^k,), all −1."""
    size = len(table)
    for at in range(count):
        if state[at] != 1:
            key = found[at, 0] << 32 | found[at, 1]
            i = place(key, size)
            while table[i] >= 0:
                i = (i + 1) & (size - 1)
            table[i] = key << 1 | (state[at] >> 1)


class Ahead:
    """What is pruned for a view.

    Attributes:
        near: diamonds that were decided for the last view, pruned: how many of them are.
    """

    def __init__(self) -> None:
        self.near = self.pruned = 0
        self._last: tuple[bytes, bool] | None = None
        self._table = NOTHING
        self._todo = np.empty((DEPTH + 2, STACK))
        self._room(1 << 11)

    def _room(self, capacity: int) -> None:
        self._found, self._state = np.empty((capacity, 3), np.int64), np.empty(capacity, np.uint8)
        self._kids = np.empty((capacity, 4), np.int32)
        self._keys, self._values = np.empty(4 * capacity, np.int64), np.empty(4 * capacity, np.int32)

    def table(self, field: Field, lens: NDArray[np.float64], cull: bool) -> NDArray[np.int64]:
        """The diamonds that need not be split though the bound over their spheres exceeds the tolerance.

        None in a plan, at no tolerance, and where memory is too small for the search.

        Args:
            field: the terrain, with errors that are bounds.
            lens: the camera, with the tolerance. cull: whether what is out of view does not count.

        Returns: int64 (2^k,), key << 1 | whether both triangles are out of view, at its ``place`` or behind; else −1.
        """
        this = lens.tobytes(), cull
        if this != self._last:
            self.near = self.pruned = 0
            self._table = NOTHING
            if lens[FOCAL] > 0.0 and lens[TOLERANCE] > 0.0 and field.n:
                self._table = self._look(field, lens, cull)
            self._last = this
        return self._table

    def _look(self, field: Field, lens: NDArray[np.float64], cull: bool) -> NDArray[np.int64]:
        slack = lens.copy()
        slack[TOLERANCE] *= 1.0 - 1e-9
        near = nearness(float(lens[TOLERANCE]))
        counts, before, stalls = self._begin(), (), 0
        most = field.tiles_read + PATIENCE * len(field.pages.used)
        while True:
            field.begin()
            why = collect(
                field.pages, slack, near, cull, field.n, stalls == 0, self._found, self._state, self._kids,
                self._keys, self._values, counts,
            )  # fmt: skip
            if why == ROOM:
                self._room(4 * len(self._found))
                counts = self._begin()
                continue
            if why == DONE:
                why = decide(
                    field.pages, lens, DEPTH, cull, field.n, stalls == 0, self._found, self._state, self._kids, counts,
                    self._todo,
                )  # fmt: skip
            if why == DONE:
                break
            stalls = stalls + 1 if before == (before := tuple(counts)) else 0
            if field.tiles_read > most:
                return NOTHING
            field.fetch(resumes=True)
        self.near = int(counts[0])
        self.pruned = int((self._state[: self.near] != 1).sum())
        if not self.pruned:
            return NOTHING
        table = np.full(1 << (4 * self.pruned - 1).bit_length(), -1, np.int64)
        gather(self._found, self._state, self.near, table)
        return table

    def _begin(self) -> NDArray[np.int64]:
        """The counts of ``collect`` and an empty table."""
        self._keys.fill(-1)
        return np.zeros(5, np.int64)
