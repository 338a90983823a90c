"""The upper convex hulls of eight lines side by side, for ``sweep_kernels``: in memory, and behind that in stacks.

Lines of a group take the same steps, so eight of them share vector instructions (``_lanes``). A hull is followed from
its nearest point; the two nearest ones are at hand as lanes, the others in rows of memory. Where a hull has no point,
one that is infinitely low stands for it: it hides nothing, and nothing hides it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._lanes import LANES, gather, load, scatter, some, spread, store, where, whole
from orograph._numba import inlined, kernel
from orograph.lighting.sweep_profiles import F32, F64, GROUP, I64

I32 = NDArray[np.int32]

PAGE = 32
"""Points in a page of the stacks' pool."""
_LOW = PAGE - 1
_SHIFT = PAGE.bit_length() - 1

ROW = 2 * LANES
"""Numbers of a point of each of eight hulls side by side."""
_ROW_SHIFT = ROW.bit_length() - 1
_NOWHERE = -4.0
"""The position of a point that is not there: in front of all lines, beyond every own cell's reach."""


class Stacks(NamedTuple):
    """The hulls of lines, in pages of one pool.

    Attributes:
        top: (1 + lines,) the place of the nearest point of each line's hull, −1: none; first of the line before the
            first.
        position, height: (pages · PAGE,) of the points. link: (pages,) the place of the point behind a page's first.
        free: (1 + pages,) the number of free pages, and which they are.
    """

    top: I64
    position: I32
    height: F64
    link: I64
    free: I64


class Working(NamedTuple):
    """Memory for a group of lines (``working``).

    Attributes:
        profile: (points, GROUP) metres.
        hull: ((points + 3) · ROW,) positions of a point of each of eight lines, then their heights, and so on.
        places: (8,) of the nearest points in ``hull``.
        slope: (steps, 1 + GROUP) of a line's samples, the line before the group first, which stays from the last one.
        found: (steps, GROUP) horizons of samples.
    """

    profile: F64
    hull: F64
    places: I64
    slope: F64
    found: F32


def working(steps: int, points: int) -> Working:
    """Memory for bands of so many steps, with so many points of a line in each."""
    return Working(
        np.empty((points * steps, GROUP)), np.empty((points * steps + 3) * ROW), np.zeros(LANES, np.int64),
        np.zeros((steps, 1 + GROUP)), np.empty((steps, GROUP), np.float32),
    )  # fmt: skip


@inlined
def pop(stacks, t):  # type: ignore[no-untyped-def]
    """The nearest point of a stack, at t, and the place of the one behind it."""
    if t < 0:
        return t, _NOWHERE, -np.inf
    page = t >> _SHIFT
    x, z = np.float64(stacks.position[t]), stacks.height[t]
    if t & _LOW:
        return t - 1, x, z
    stacks.free[0] += 1
    stacks.free[stacks.free[0]] = page
    return stacks.link[page], x, z


@inlined
def push(stacks, t, x, z):  # type: ignore[no-untyped-def]
    """Put a point on the stack whose nearest point is at t; returns its place."""
    u = t
    t += 1
    if u < 0 or not t & _LOW:
        page = stacks.free[stacks.free[0]]
        stacks.free[0] -= 1
        stacks.link[page] = u
        t = page << _SHIFT
    stacks.position[t], stacks.height[t] = np.int32(x), z
    return t


@kernel
def deepen(work: Working, line: int, apart: int, stacks: Stacks) -> None:
    """Where only one point of a line's hull is left in memory, fetch the next one from its stack.

    Args:
        work: its ``places`` are those of the nearest points.
    """
    hull, places = work.hull, work.places
    for b in range(LANES):
        if places[b] < ROW:
            hull[ROW + b], hull[ROW + LANES + b] = hull[b], hull[LANES + b]
            at = line + b * apart
            stacks.top[at], hull[b], hull[LANES + b] = pop(stacks, stacks.top[at])
            places[b] += ROW


@inlined
def uncovered(work, hull, line, apart, stacks, n, x1, z1, x2, z2, x, z):  # type: ignore[no-untyped-def]
    """Remove the points of hulls that lie below the line from a point at x to the one behind them.

    Args:
        n: places of the nearest points. x1, z1, x2, z2: the two nearest points.
        z: heights of the points at x; NaN removes nothing.
    """
    hidden = (z1 - z) * (x1 - x2) <= (z2 - z1) * (x - x1)
    while some(hidden):
        n = where(hidden, n - ROW, n)
        if some(n < ROW):
            store(work.places, 0, n)
            deepen(work, line, apart, stacks)
            n = load(work.places, 0)
        x1, z1 = where(hidden, x2, x1), where(hidden, z2, z1)
        x2, z2 = gather(hull, n - ROW), gather(hull, n - (ROW - LANES))
        hidden = hidden & ((z1 - z) * (x1 - x2) <= (z2 - z1) * (x - x1))
    return n, x1, z1, x2, z2


@inlined
def added(hull, there, n, x1, z1, x2, z2, x, z):  # type: ignore[no-untyped-def]
    """Put points at x on hulls, where they are there."""
    n = where(there, n + ROW, n)
    x2, z2 = where(there, x1, x2), where(there, z1, z2)
    x1, z1 = where(there, x, x1), where(there, z, z1)
    scatter(hull, n, x1)
    scatter(hull, n + LANES, z1)
    return n, x1, z1, x2, z2


@inlined
def passed(work, hull, line, apart, stacks, n, x1, z1, x2, z2, y, m, x, z):  # type: ignore[no-untyped-def]
    """Put points at y, with heights m, on hulls, but those below the line from the hull to the next points, z at x.

    These would be removed at once.
    """
    m = where((m - z) * (y - x1) <= (z1 - m) * (x - y), np.nan, m)
    there = m == m
    if some(there):
        n, x1, z1, x2, z2 = uncovered(work, hull, line, apart, stacks, n, x1, z1, x2, z2, y, m)
        n, x1, z1, x2, z2 = added(hull, there, n, x1, z1, x2, z2, y, m)
    return n, x1, z1, x2, z2


@inlined
def restored(end, undo, step, last, spare):  # type: ignore[no-untyped-def]
    """Undo what was noted of a step; returns the places of the last points.

    Args:
        spare: places for what nothing reads.
    """
    u = 4 * LANES * step
    place = load(undo, u)
    had = place >= 0.0
    k = where(had, whole(place), spare)
    scatter(end, k, load(undo, u + LANES))
    scatter(end, k + LANES, load(undo, u + 2 * LANES))
    return where(had, whole(load(undo, u + 3 * LANES)), last)


@inlined
def emptied(hull, lane):  # type: ignore[no-untyped-def]
    """Hulls without points: the place and the two nearest points of each, which are infinitely low."""
    x, z = spread(_NOWHERE), spread(-np.inf)
    for row in range(2):
        store(hull, row * ROW, x)
        store(hull, row * ROW + LANES, z)
    return lane + ROW, x, z, x, z


@inlined
def keep(slope, apart, lane, place, values):  # type: ignore[no-untyped-def]
    """Write the slopes of eight lines, ``apart`` from each other."""
    if apart == 1:
        store(slope, place, values)
    else:
        scatter(slope, lane + lane + place, values)


@inlined
def profiles(profile, apart, lane, place):  # type: ignore[no-untyped-def]
    """The heights of eight lines, ``apart`` from each other."""
    return load(profile, place) if apart == 1 else gather(profile, lane + lane + place)


@inlined
def highest(end, last, lane, x, z, own):  # type: ignore[no-untyped-def]
    """The points of hulls that are seen highest from x, beyond ``own``: slopes rise up to one, and fall behind it.

    Args:
        end: hulls, with the nearest point last and positions negated. last: places of the last points.

    Returns:
        position, height, and whether there is one.
    """
    k, size = lane + 2 * ROW, (last >> _ROW_SHIFT) - 1
    while some(size > 1):
        half = size >> 1
        m = k + half * ROW
        rises = (gather(end, m - (ROW - LANES)) - z) * (x + gather(end, m)) < (gather(end, m + LANES) - z) * (
            x + gather(end, m - ROW)
        )
        k = where(rises & (size > 1), m, k)
        size = size - half
    y = gather(end, k)
    close = x + y <= own
    if some(close):
        k = where(close, k + ROW, k)
        y = gather(end, k)
    return 0.0 - y, gather(end, k + LANES), k <= last
