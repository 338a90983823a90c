"""Horizons along lines: the kernels of ``sweep``, over one band of steps of a set of parallel lines.

Walking along a line away from the light, the upper convex hull of the passed points is kept as a stack; the horizon of
a point is its tangent to that hull, found by popping, so each point is pushed once and popped at most once: amortised
O(1), whatever the distance (Timonen & Westerholm 2010, "Scalable Height Field Self-Shadowing", Computer Graphics Forum
29(2), sec. 3). The stacks of many lines live in pages of one pool, linked backwards: between two bands they stay in
place, and take only as much memory as the hulls.

With a radius of R steps, the points within R are the end of one block of R points and the beginning of the next. The
beginning has a stack as above, new in each block. The end's hull is built backwards over its block, and each insertion
records what it overwrote; undoing them one by one gives the hull of each shorter end, and a binary search its tangent:
O(log h) for hulls of h points, exact. Blocks are counted from the line's first step, so bands make no difference.

On a round body heights are lowered by a parabola, x²/2r, x steps from the line's beginning. Hulls commute with that
shear: slopes between points of the bent profile differ from the slopes seen at x only by x/r, which is added back.

A sample's view of its own cell, up to one step, comes from the surface (``cell_slope``): interpolated lines are wrong
there by as much as cells are rough. So lines give the *far* horizon: if the next point of a line is the highest visible
one, its far horizon is that point's own horizon, the next one on the hull.

Eight lines are swept side by side (``sweep_hulls``). Where lines run along diagonals, every other one meets the middles
of cells, and takes twice as many points; so the eight are every other line of a group.

Positions are counted in steps from the light's end of the line; heights are metres, float64.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orograph._lanes import LANES, counted, gather, load, real, store, where, whole
from orograph._numba import inlined, kernel
from orograph.lighting.own_cell import OwnCell
from orograph.lighting.sweep_hulls import (
    PAGE,
    ROW,
    Stacks,
    Working,
    added,
    deepen,
    emptied,
    highest,
    keep,
    passed,
    pop,
    profiles,
    push,
    restored,
    uncovered,
)
from orograph.lighting.sweep_profiles import F64, GROUP, I64, Swath, fill, middles, sample_of
from orograph.lighting.sweep_samples import Target, horizons_of


class Course(NamedTuple):
    """How to look along lines.

    Attributes:
        backward: whether steps run against positions. origin: the position of step 0.
        scale: steps per metre. lowest: the smallest slope in results. bend: the body's curvature, per metre.
    """

    backward: bool
    origin: int
    scale: float
    lowest: float
    bend: float


@kernel
def _unlimited(
    work: Working, b: int, both: bool, first: int, last: int, course: Course, cell: OwnCell, line: int, stacks: Stacks
) -> None:
    """Far horizon slopes of steps [first, last) of eight lines of a group, b, b + ``points``, …, into ``slope``.

    Their stacks continue from ``top[line]``, … and are left there. There must be enough free pages. The points of this
    band wait in ``hull``, behind them two of the stack's. Where there is none, a point infinitely low hides nothing.

    Args:
        both: whether the lines have two points in each step; otherwise, one is left out.
    """
    profile, hull, slope = work.profile, work.hull, work.slope
    backward, origin, scale, lowest, bend = course
    drop, turn = 0.5 * bend / (scale * scale), bend / scale
    apart, lane = cell.points, whole(counted())
    for k in range(LANES):
        at, work.places[k] = line + k * apart, k
        stacks.top[at], hull[k], hull[LANES + k] = pop(stacks, stacks.top[at])
    deepen(work, line, apart, stacks)
    n = load(work.places, 0)
    x1, z1, x2, z2 = load(hull, ROW), load(hull, ROW + LANES), load(hull, 0), load(hull, LANES)
    i, ahead = (last - 1, -1) if backward else (first, 1)
    for _ in range(last - first):
        k = sample_of(i, cell)
        x = np.float64(origin + ahead * k)
        z = profiles(profile, apart, lane, k * GROUP + b) - drop * x * x
        if both:
            y = x - 1.0
            m = profiles(profile, apart, lane, (k - ahead) * GROUP + b) - drop * y * y
            n, x1, z1, x2, z2 = passed(work, hull, line, apart, stacks, n, x1, z1, x2, z2, y, m, x, z)
        n, x1, z1, x2, z2 = uncovered(work, hull, line, apart, stacks, n, x1, z1, x2, z2, x, z)
        far = x - x1 > cell.reach
        s = (where(far, z1, z2) - z) * scale / (x - where(far, x1, x2)) - x * turn
        keep(slope, apart, lane, i * (GROUP + 1) + b + 1, where(s > lowest, s, lowest))
        n, x1, z1, x2, z2 = added(hull, z == z, n, x1, z1, x2, z2, x, z)
        i += ahead
    store(work.places, 0, n)
    for first in range(LANES):
        at = line + first * apart
        t = stacks.top[at]
        for k in range(first, work.places[first] + 1, ROW):
            if hull[k + LANES] > -np.inf:
                t = push(stacks, t, hull[k], hull[k + LANES])
        stacks.top[at] = t


@kernel
def _limited(
    work: Working, b: int, both: bool, first: int, last: int, course: Course, cell: OwnCell, reach: int, end: F64,
    undo: F64, nothing: Stacks,
) -> None:  # fmt: skip
    """Like ``_unlimited``, among the points within ``reach`` points. Positions begin with a block (``_blocks``).

    Args:
        end: ((reach + 3) · ROW,) the hulls of the rest of the last block, in the form of ``hull``, behind two points
            that are not there. Its last row is for what nothing reads.
        undo: (reach · 4 · LANES,) the change by each insertion into ``end``: its place (-1: none), the old position
            and height there, and the place of the last point before.
        nothing: empty stacks.
    """
    profile, hull, slope = work.profile, work.hull, work.slope
    backward, origin, scale, lowest, bend = course
    drop, turn = 0.5 * bend / (scale * scale), bend / scale
    apart, own, lane = cell.points, cell.reach, whole(counted())
    beyond = lane + (reach + 2) * ROW
    direction = -1 if backward else 1
    x_first = origin - (apart * last - 1) if backward else origin + apart * first
    x_last = x_first + apart * (last - first)
    # Samples are the last points in their steps.
    stride = 1 if both else apart
    ends, x1, z1, x2, z2 = emptied(end, lane)
    for begin in range(x_first, x_last, reach):
        stop = min(begin + reach, x_last)
        n, x1, z1, x2, z2 = emptied(hull, lane)
        for at in range(begin + apart - 1, stop, apart):
            if begin > x_first:  # the farthest points go out of reach
                if at - begin >= apart:
                    ends = restored(end, undo, at - begin - apart, ends, beyond)
                if both:
                    ends = restored(end, undo, at - begin - 1, ends, beyond)
            i, x = (at - origin) * direction, np.float64(at)
            z = profiles(profile, apart, lane, i * GROUP + b) - drop * x * x
            if both:
                y = x - 1.0
                m = profiles(profile, apart, lane, (i - direction) * GROUP + b) - drop * y * y
                n, x1, z1, x2, z2 = passed(work, hull, 0, 1, nothing, n, x1, z1, x2, z2, y, m, x, z)
            n, x1, z1, x2, z2 = uncovered(work, hull, 0, 1, nothing, n, x1, z1, x2, z2, x, z)
            far = x - x1 > own
            s = (where(far, z1, z2) - z) * scale / (x - where(far, x1, x2)) - x * turn
            s = where(s > lowest, s, lowest)
            y, m, seen = highest(end, ends, lane, x, z, own)
            m = (m - z) * scale / (x - y) - x * turn
            s = where(seen & (m > s), m, s)
            keep(slope, apart, lane, i // apart * (GROUP + 1) + b + 1, s)
            n, x1, z1, x2, z2 = added(hull, z == z, n, x1, z1, x2, z2, x, z)
        if stop == x_last:
            return
        ends, x1, z1, x2, z2 = emptied(end, lane)
        for at in range(stop - 1, begin + stride - 2, -stride):
            x = np.float64(at)
            z = profiles(profile, apart, lane, (at - origin) * direction * GROUP + b) - drop * x * x
            there, before = z == z, ends
            ends, x1, z1, x2, z2 = uncovered(work, end, 0, 1, nothing, ends, x1, z1, x2, z2, 0.0 - x, z)
            u, k = 4 * LANES * (at - begin), ends + ROW
            store(undo, u, where(there, real(k), -1.0))
            store(undo, u + LANES, gather(end, k))
            store(undo, u + 2 * LANES, gather(end, k + LANES))
            store(undo, u + 3 * LANES, real(before))
            ends, x1, z1, x2, z2 = added(end, there, ends, x1, z1, x2, z2, 0.0 - x, z)


@kernel
def _range(shift: I64, lanes: int, line0: int, lines: int) -> tuple[int, int]:
    """The steps [first, last) at which any of these lines touches the raster; ``shift`` is monotonic."""
    first, last = 0, len(shift)
    while first < last and not (line0 + lines + shift[first] >= 0 and line0 + shift[first] < lanes):
        first += 1
    while first < last and not (line0 + lines + shift[last - 1] >= 0 and line0 + shift[last - 1] < lanes):
        last -= 1
    return first, last


@kernel
def sweep_lines(
    swath: Swath, course: Course, line0: int, lines: int, begin: int, stacks: Stacks, work: Working, target: Target
) -> int:
    """Sweep a band of ``len(shift)`` steps, without a radius, for the samples of ``lines`` lines from ``line0``.

    Samples lie on or just before these lines; every sample belongs to one line. ``lines`` is a multiple of GROUP.
    ``work`` is ``working(steps, points)`` for at least as many; it keeps a line's slopes from one group to the next.

    Returns:
        the number of finished lines; fewer than ``lines`` if the pool has too few free pages to continue: call again
        with ``begin`` set to it.
    """
    shift, lanes, cell = swath.shift, swath.lanes, swath.cell
    finer = _finer(course, cell.points)
    enough = (GROUP + 1) * (cell.points * len(shift) // PAGE + 2)
    while begin < lines:
        if stacks.free[0] < enough:
            return begin
        if begin == 0:
            first, last = _range(shift, lanes, line0 - 1, 1)
            # The line before the first is only used for interpolation.
            fill(swath, line0 - 1, 1, first, last, work.profile)
            _unlimited(work, 0, middles(swath, line0 - 1), first, last, finer, cell, 0, stacks)
            for i in range(first, last):
                work.slope[i, 0] = work.slope[i, 1]
        first, last = _range(shift, lanes, line0 + begin, GROUP)
        fill(swath, line0 + begin, GROUP, first, last, work.profile)
        for half in range(2):
            b = half * LANES if cell.points == 1 else half
            _unlimited(work, b, middles(swath, line0 + begin + b), first, last, finer, cell, begin + b + 1, stacks)
        horizons_of(work.slope, swath, line0 + begin, first, last, 0, work.found, target)
        begin += GROUP
    return begin


@kernel
def sweep_windows(
    swath: Swath, course: Course, line0: int, lines: int, reach: int, skip: int, own: int, work: Working, target: Target
) -> None:
    """Like ``sweep_lines``, but only among points within ``reach`` steps, for steps [skip, skip + own) of the band."""
    steps, cell = len(swath.shift), swath.cell
    finer = _finer(course, cell.points)
    points = reach * cell.points
    end, undo = np.empty((points + 3) * ROW), np.empty(points * 4 * LANES)
    nothing = Stacks(
        np.full(LANES, -1), np.empty(0, np.int32), np.empty(0), np.empty(0, np.int64), np.zeros(1, np.int64)
    )
    # The line before the first is only used for interpolation.
    first, last = _blocks(course.backward, steps, reach, *_range(swath.shift, swath.lanes, line0 - 1, 1))
    fill(swath, line0 - 1, 1, first, last, work.profile)
    _limited(work, 0, middles(swath, line0 - 1), first, last, finer, cell, points, end, undo, nothing)
    for i in range(first, last):
        work.slope[i, 0] = work.slope[i, 1]
    for begin in range(0, lines, GROUP):
        first, last = _range(swath.shift, swath.lanes, line0 + begin, GROUP)
        if first == last:
            continue
        first, last = _blocks(course.backward, steps, reach, first, last)
        fill(swath, line0 + begin, GROUP, first, last, work.profile)
        for half in range(2):
            b = half * LANES if cell.points == 1 else half
            both = middles(swath, line0 + begin + b)
            _limited(work, b, both, first, last, finer, cell, points, end, undo, nothing)
        first, last = max(first, skip), min(last, skip + own)
        horizons_of(work.slope, swath, line0 + begin, first, last, skip, work.found, target)


@inlined
def _blocks(backward, steps, reach, first, last):  # type: ignore[no-untyped-def]
    """The steps [first, last), from the light's end of a block on.

    Blocks of ``reach`` steps begin where the band does, or at the raster's border: lines are swept from there on.
    """
    if backward:
        return first, steps - (steps - last) // reach * reach
    return first // reach * reach, last


@inlined
def _finer(course, points):  # type: ignore[no-untyped-def]
    """The course for several points in each step: of two, the sample is the one farther from the light."""
    origin = points * course.origin + (points - 1 if course.backward else 0)
    return Course(course.backward, origin, points * course.scale, course.lowest, course.bend)
