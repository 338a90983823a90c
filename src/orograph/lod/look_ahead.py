"""Looking ahead: the metric ``localised`` for methods that ask one question for a whole diamond.

The bound over a diamond's nested sphere is too large where the sphere is large beside its distance: it puts the largest
error of all at the place from which it looks worst. ``lod.localise`` takes the two triangles of a diamond apart instead
and finds B, as tight as one likes; but B is not monotonic, and these methods need it to be. So B is *closed*:

    a diamond d is active  ⟺  S(d) > τ, and it is far, or B(d) > τ, or any of its children in the diamond DAG is active,

S being the bound over the sphere, and *far* that its radius is less than ``NEAR`` of the sphere's distance from the
eye's plane, where S is tight. If a child is active then S(child) > τ, hence S(d) > τ, hence d is active: monotonic by
definition. It depends on the diamond and the view alone, so both triangles of a diamond agree. And it is conservative:
who is not active has S ≤ τ or B ≤ τ. (docs/metrics.md)

Spheres nest, so who is far has far children only. The others, the *near* diamonds with S > τ, are few: those within
some sixteen radii of the eye, level by level, a number that does not depend on the size of the mesh. They are collected
from the root down, each once, and decided from the finest up, so that B is asked only of those that have no active
child. What comes out is a small table of the diamonds that are *pruned*: S > τ and yet inactive. Methods look up near
diamonds there, and are else what they were.

Mixed diamonds, those whose colours are off by too much and those that straddle the border of a raster that is not 2^n +
1 samples wide are active as S says, or at once. Roundings: here S is compared with a τ smaller by 10^-9, so that no
method, whatever its order of operations, finds a diamond active whose parents are pruned.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, leaf
from orograph.error.screen import ANISOTROPIC, CameraParameters, color_exceeds, to_camera
from orograph.hierarchy.kernels import diamonds
from orograph.lod.criterion import (
    FAR_BIT,
    NEAR,
    NOTHING,
    SPLIT,
    Criterion,
    color_error,
    judge,
    look_up,
    place,
    place_of,
)
from orograph.lod.field import Field
from orograph.lod.localise import STACK, diamond_exceeds
from orograph.lod.pages import BEYOND

DEPTH = 6
"""Halvings by which triangles are taken apart."""

FOUND, LOOKED_AT, NEXT_CHILD, MET, UNDECIDED = range(5)
"""Counts: diamonds found; those of them whose children were looked at; the next child of the next one; diamonds met;
those found that are yet to be decided."""

ACCURATE, FAR_ACTIVE = -1, -2
"""Values of diamonds that were met but are not among those found."""

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
def classify(pages, criterion, near, row, col, octave, bits):
    """(NONE, FAR, ACTIVE, OPEN or MISSING, of the diamond at (row, col); its bits of planes).

    Args:
        criterion: ``Criterion`` that does not look ahead. near: the ratio from which on spheres are near.
    """
    key = row << 32 | col
    camera = criterion.camera
    slot, z, e, r, c = look_up(pages, key, octave)
    kind = np.uint8(NONE if slot == BEYOND or slot >= 0 else MISSING)
    if slot >= 0:
        state, _, bits = judge(pages, criterion, key, z, e, r, c, bits | FAR_BIT)
        if state == SPLIT:
            x, y = place_of(pages, key)
            _, _, w = to_camera(camera, x, y, np.float64(z))
            radius = np.float64(r) * camera.stretch
            sure = e == np.inf or color_exceeds(camera, np.float64(color_error(c)), w, radius)
            kind = np.uint8(FAR if radius <= near * (w - radius) else ACTIVE if sure else OPEN)
    return kind, bits & (FAR_BIT - 1)


class Diamonds(NamedTuple):
    """The near diamonds of a view, level by level.

    Attributes:
        found: int64 (capacity, 3), rows, columns, bits of planes. state: uint8 (capacity,): 1 active, 0 inactive, 2
            inactive and out of view.
        kids: int32 (capacity, 4), where their children are in ``found``, −1: nowhere.
        keys: int64 (2^k,), all −1 at first; values: int32 (2^k,): a table of those met, and where they are in
            ``found``, or ACCURATE, or FAR_ACTIVE.
        counts: int64 (5,), see ``FOUND`` and following; all 0 at first.
    """

    found: NDArray[np.int64]
    state: NDArray[np.uint8]
    kids: NDArray[np.int32]
    keys: NDArray[np.int64]
    values: NDArray[np.int32]
    counts: NDArray[np.int64]


@inlined
def child_of(row, col, octave, square, k):
    """(row, col) of the k-th child in the diamond DAG, perhaps beyond the square."""
    # The children of a square are the edges s up and down, left and right; of an edge, squares a half s aside.
    s = np.int64(1) << octave
    if square:
        return (row + (s if k else -s), col) if k < 2 else (row, col + (s if k & 1 else -s))
    s >>= 1
    return row + (s if k & 1 else -s), col + (s if k & 2 else -s)


@leaf
def collect(pages, criterion, near, n, read_on, diamonds_near):
    """Collect the near diamonds whose sphere exceeds the tolerance, level by level.

    Args:
        pages: ``field.Pages``.
        criterion: ``Criterion`` that does not look ahead, with a tolerance a hair smaller.
        near: the ratio from which on spheres are near, at least ``NEAR``.
        read_on: whether to ask for the pages of those that come after one that lacks its page, too.
        diamonds_near: ``Diamonds``; out.

    Returns: DONE; or MISSED or ROOM, and it can be called again.
    """
    found, state, kids = diamonds_near.found, diamonds_near.state, diamonds_near.kids
    keys, values, counts = diamonds_near.keys, diamonds_near.values, diamonds_near.counts
    size, room = len(keys), len(found)
    side = np.int64(1) << n
    half = side >> 1
    missed = False
    if counts[FOUND] == 0:
        kind, bits = classify(pages, criterion, near, half, half, n - 1, np.int64(0))
        if kind == MISSING:
            return MISSED
        if kind >= ACTIVE:
            found[0, 0], found[0, 1], found[0, 2], state[0] = half, half, bits, kind == ACTIVE
            counts[FOUND] = 1
    done, first = counts[LOOKED_AT], counts[NEXT_CHILD]
    while done < counts[FOUND]:
        if counts[FOUND] + 4 > room or 2 * (counts[MET] + 4) > size:
            return ROOM
        row, col, bits = found[done, 0], found[done, 1], found[done, 2]
        octave = np.int64(diamonds.octave(row, col))
        square = (row >> octave) & (col >> octave) & 1
        octave_below = octave if square else octave - 1
        for k in range(first, 4):
            if not missed:
                kids[done, k] = -1
            r, c = child_of(row, col, octave, square, k)
            if octave_below < 0 or min(r, c) < 0 or max(r, c) > side:
                continue
            key = r << 32 | c
            at = place(key, size)
            while keys[at] >= 0 and keys[at] != key:
                at = (at + 1) & (size - 1)
            if keys[at] < 0:
                kind, inside = classify(pages, criterion, near, r, c, octave_below, bits)
                if kind == MISSING and not missed:
                    missed = True
                    counts[LOOKED_AT], counts[NEXT_CHILD] = done, k
                    if not read_on:
                        return MISSED
                if missed:
                    continue
                keys[at], values[at] = key, ACCURATE
                counts[MET] += 1
                if kind == FAR:
                    values[at] = FAR_ACTIVE
                elif kind != NONE:
                    to = counts[FOUND]
                    values[at] = to
                    found[to, 0], found[to, 1], found[to, 2], state[to] = r, c, inside, kind == ACTIVE
                    counts[FOUND] += 1
            if missed:
                continue
            if values[at] == FAR_ACTIVE:
                state[done] = 1
            else:
                kids[done, k] = values[at]
        done += 1
        first = 0
    if missed:
        return MISSED
    counts[LOOKED_AT], counts[NEXT_CHILD], counts[UNDECIDED] = done, 0, done
    return DONE


@leaf
def decide(pages, camera, depth, cull, n, read_on, diamonds_near, todo):
    """Decide, from the finest up, which of those that were collected are active.

    Args:
        camera: ``CameraParameters``. read_on, diamonds_near: as for ``collect``. todo: scratch of ``diamond_exceeds``.

    Returns: DONE or MISSED.
    """
    found, state, kids, counts = diamonds_near.found, diamonds_near.state, diamonds_near.kids, diamonds_near.counts
    missed = np.int64(0)
    at = counts[UNDECIDED]
    while at > 0 and missed < 64:
        at -= 1
        sure = state[at] == 1
        for k in range(4):
            sure = sure or (kids[at, k] >= 0 and state[kids[at, k]] == 1)
        verdict, lacks = np.int64(1), False
        if not sure:
            verdict, lacks = diamond_exceeds(pages, camera, cull, depth, found[at, 0], found[at, 1], n, todo)
        if lacks and not read_on:
            return MISSED
        if lacks or missed > 0:
            missed += 1
            continue
        state[at] = verdict
        counts[UNDECIDED] = at
    return MISSED if missed > 0 else DONE


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
        self._last: tuple[Any, ...] | None = None
        self._table = NOTHING
        self._todo = np.empty((DEPTH + 2, STACK))
        self._room(1 << 11)

    def _room(self, capacity: int) -> None:
        self._diamonds = Diamonds(
            np.empty((capacity, 3), np.int64), np.empty(capacity, np.uint8), np.empty((capacity, 4), np.int32),
            np.empty(4 * capacity, np.int64), np.empty(4 * capacity, np.int32), np.zeros(5, np.int64),
        )  # fmt: skip

    def table(self, field: Field, camera: CameraParameters, cull: bool) -> NDArray[np.int64]:
        """The diamonds that need not be split though the bound over their spheres exceeds the tolerance.

        None in a plan, at no tolerance, and where memory is too small for the search.

        Args:
            field: the terrain, with errors that are bounds.
            camera: the camera, with the tolerance. cull: whether what is out of view does not count.

        Returns: int64 (2^k,), key << 1 | whether both triangles are out of view, at its ``place`` or behind; else −1.
        """
        this = camera[:-1], camera.planes.tobytes(), cull
        if this != self._last:
            self.near = self.pruned = 0
            self._table = NOTHING
            if camera.focal > 0.0 and camera.tolerance > 0.0 and field.n:
                self._table = self._look(field, camera, cull)
            self._last = this
        return self._table

    def _look(self, field: Field, camera: CameraParameters, cull: bool) -> NDArray[np.int64]:
        slack = camera._replace(tolerance=camera.tolerance * (1.0 - 1e-9))
        criterion = Criterion(slack, ANISOTROPIC, cull, NOTHING)
        near = nearness(camera.tolerance)
        before, stalls = (), 0
        self._begin()
        most = field.tiles_read + PATIENCE * len(field.pages.used)
        while True:
            field.begin()
            why = collect(field.pages, criterion, near, field.n, stalls == 0, self._diamonds)
            if why == ROOM:
                self._room(4 * len(self._diamonds.found))
                self._begin()
                continue
            if why == DONE:
                why = decide(field.pages, camera, DEPTH, cull, field.n, stalls == 0, self._diamonds, self._todo)
            if why == DONE:
                break
            stalls = stalls + 1 if before == (before := tuple(self._diamonds.counts)) else 0
            if field.tiles_read > most:
                return NOTHING
            field.fetch(resumes=True)
        self.near = int(self._diamonds.counts[FOUND])
        self.pruned = int((self._diamonds.state[: self.near] != 1).sum())
        if not self.pruned:
            return NOTHING
        table = np.full(1 << (4 * self.pruned - 1).bit_length(), -1, np.int64)
        gather(self._diamonds.found, self._diamonds.state, self.near, table)
        return table

    def _begin(self) -> None:
        """Forget all diamonds."""
        self._diamonds.keys.fill(-1)
        self._diamonds.counts.fill(0)
