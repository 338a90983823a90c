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

Positions are counted in steps from the light's end of the line; heights are metres, float64.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.lighting.own_cell import cell_slope
from orograph.lighting.sweep_profiles import F32, F64, I64, Swath, fill

I32 = NDArray[np.int32]

PAGE = 32
"""Points in a page of the stacks' pool."""
GROUP = 16
"""Lines swept together: as many as a cache line has samples, so that sweeps across memory use all of it."""

_LOW = PAGE - 1
_SHIFT = PAGE.bit_length() - 1


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


class Target(NamedTuple):
    """The output of horizons: ``values`` (samples,), with strides from lane to lane and from step to step."""

    values: F32
    lane: int
    step: int


def working(steps: int) -> tuple[F64, F32]:
    """Profiles and slopes of a group of lines, for ``sweep_lines``.

    A cache line is added to each row, because rows a power of two apart would share cache sets.
    """
    return np.empty((GROUP, steps + 8)), np.zeros((GROUP + 1, steps + 16), np.float32)


@kernel
def _unlimited(
    profile: F64, first: int, last: int, course: Course, own: float, line: int, stacks: Stacks, slope: F32
) -> None:
    """Far horizon slopes of one line's steps [first, last), beyond ``own`` steps.

    Its stack continues from ``top[line]`` and is left there. There must be enough free pages.
    """
    backward, origin, scale, lowest, bend = course
    top, position, height, link, free = stacks
    drop, turn = 0.5 * bend / (scale * scale), bend / scale
    t = top[line]  # slot of the nearest point of the hull, u of the one behind it; -1: none
    u = np.int64(-1)
    x1 = z1 = x2 = z2 = 0.0
    if t >= 0:
        x1, z1 = np.float64(position[t]), height[t]
        u = t - 1 if t & _LOW else link[t >> _SHIFT]
        if u >= 0:
            x2, z2 = np.float64(position[u]), height[u]
    i, ahead = (last - 1, -1) if backward else (first, 1)
    for _ in range(last - first):
        z = profile[i]
        if z == z:
            x = np.float64(origin - i if backward else origin + i)
            z -= drop * x * x
            # The top lies below the line from here to the one behind it: it is hidden from now on.
            while u >= 0 and (z1 - z) * (x1 - x2) <= (z2 - z1) * (x - x1):
                if not t & _LOW:
                    free[0] += 1
                    free[free[0]] = t >> _SHIFT
                t, x1, z1 = u, x2, z2
                u = t - 1 if t & _LOW else link[t >> _SHIFT]
                if u >= 0:
                    x2, z2 = np.float64(position[u]), height[u]
            s = lowest
            if t >= 0 and x - x1 > own:
                s = max((z1 - z) * scale / (x - x1) - x * turn, lowest)
            elif u >= 0:
                s = max((z2 - z) * scale / (x - x2) - x * turn, lowest)
            slope[i] = s
            u, x2, z2 = t, x1, z1
            t += 1
            if u < 0 or not t & _LOW:
                page = free[free[0]]
                free[0] -= 1
                link[page] = u
                t = page << _SHIFT
            position[t], height[t] = np.int32(x), z
            x1, z1 = x, z
        i += ahead
    top[line] = t


@kernel
def _limited(
    profile: F64, first: int, last: int, course: Course, own: float, reach: int, near: F64, end: F64, undo: F64,
    slope: F32,
) -> None:  # fmt: skip
    """Far horizon slopes of one line's steps [first, last) among the points within ``reach`` steps.

    Positions begin at a multiple of ``reach``. ``near`` and ``end`` (reach, 2) are stacks of (position, height);
    ``undo`` (reach, 4) is the change by each insertion into ``end``: its place (-1: none), the old content, and the
    size.
    """
    backward, origin, scale, lowest, bend = course
    drop, turn = 0.5 * bend / (scale * scale), bend / scale
    step = -1 if backward else 1
    x_first = origin - (last - 1) if backward else origin + first
    x_last = x_first + (last - first)
    ends = 0  # size of ``end``: the hull of the rest of the last block
    for j in range(reach):
        undo[j, 0] = -1.0
    for begin in range(x_first, x_last, reach):
        stop = min(begin + reach, x_last)
        nears = 0
        for at in range(begin, stop):
            if at > begin:  # the farthest point goes out of reach
                j = at - begin - 1
                k = int(undo[j, 0])
                if k >= 0:
                    ends = int(undo[j, 3])
                    end[k, 0], end[k, 1] = undo[j, 1], undo[j, 2]
            i = (at - origin) * step
            z = profile[i]
            if z != z:
                continue
            x = np.float64(at)
            z -= drop * x * x
            while nears >= 2 and (near[nears - 1, 1] - z) * (near[nears - 1, 0] - near[nears - 2, 0]) <= (
                near[nears - 2, 1] - near[nears - 1, 1]
            ) * (x - near[nears - 1, 0]):
                nears -= 1
            s = lowest
            k = nears - 1
            if k >= 0 and x - near[k, 0] <= own:
                k -= 1
            if k >= 0:
                s = max((near[k, 1] - z) * scale / (x - near[k, 0]) - x * turn, lowest)
            if ends > 0:  # slopes rise along the hull up to the tangent, and fall behind it
                low, high = 0, ends - 1
                while low < high:
                    mid = (low + high) >> 1
                    if (end[mid, 1] - z) * (x - end[mid + 1, 0]) < (end[mid + 1, 1] - z) * (x - end[mid, 0]):
                        low = mid + 1
                    else:
                        high = mid
                if x - end[low, 0] <= own:
                    low += 1
                if low < ends:
                    s = max((end[low, 1] - z) * scale / (x - end[low, 0]) - x * turn, s)
            slope[i] = s
            near[nears, 0], near[nears, 1] = x, z
            nears += 1
        if stop == x_last:
            return
        ends = 0
        for j in range(reach):
            undo[j, 0] = -1.0
        for at in range(stop - 1, begin - 1, -1):
            z = profile[(at - origin) * step]
            if z != z:
                continue
            x = np.float64(at)
            z -= drop * x * x
            before = ends
            while ends >= 2 and (end[ends - 1, 1] - z) * (end[ends - 2, 0] - end[ends - 1, 0]) <= (
                end[ends - 2, 1] - end[ends - 1, 1]
            ) * (end[ends - 1, 0] - x):
                ends -= 1
            j = at - begin
            undo[j, 0], undo[j, 1], undo[j, 2], undo[j, 3] = ends, end[ends, 0], end[ends, 1], before
            end[ends, 0], end[ends, 1] = x, z
            ends += 1


@inlined
def _horizon(heights, k, ahead, aside, odd, cell, one, other, f):  # type: ignore[no-untyped-def]
    """The horizon of sample k: of its own cell, or the lines on both sides beyond theirs; NaN at NaN.

    Args:
        ahead, aside: offsets to the sample one step towards the light, and to that at its side; 0: none.
        one, other: the lines' horizons. f: the second one's share.
    """
    nan = np.float32(np.nan)
    z, near = heights[k], nan
    if ahead != 0:
        both, minor = (heights[k + ahead + aside], heights[k + aside]) if aside != 0 else (nan, nan)
        near = cell_slope(z, heights[k + ahead], both, minor, odd, cell)
    a = near if near > one else one
    b = near if near > other else other
    v = a * (np.float32(1.0) - f) + b * f if f > 0 else a
    return v if z == z else nan


@kernel
def _scatter(
    values: F32, swath: Swath, begin: int, lines: int, first: int, last: int, skip: int, target: Target
) -> None:
    """Horizons of samples from values (1 + lines, steps · ``cell.points``), of lines begin − 1 …, and own cells.

    NaN where heights are. ``skip`` steps of the heights have no place in the target.
    """
    heights, start, lanes, shift, part, cell = (
        swath.heights, swath.start, swath.lanes, swath.shift, swath.part, swath.cell,
    )  # fmt: skip
    lane_stride, step_stride, out_lane, out = swath.lane, swath.step, target.lane, target.values
    for i in range(first, last):
        lane0, f = begin + shift[i], part[i]
        b0, b1 = max(-lane0, 0), min(lanes - lane0, lines)
        ahead = 0 if cell.reach == 0.0 or i == cell.edge else cell.toward * step_stride
        # Lanes with a neighbour to the side.
        s0 = min(max(b0, 1 - lane0), b1) if cell.side < 0 else b0
        s1 = max(min(b1, lanes - 1 - lane0), s0) if cell.side > 0 else b1
        base, place = start + lane0 * lane_stride + i * step_stride, lane0 * out_lane + (i - skip) * target.step
        k = i if cell.points == 1 else 2 * i + (1 if cell.toward < 0 else 0)
        aside, odd = cell.side * lane_stride, cell.odd + lane0 + i
        for b in range(b0, s0):
            out[place + b * out_lane] = _horizon(
                heights, base + b * lane_stride, ahead, 0, odd + b, cell, values[b + 1, k], values[b, k], f
            )
        for b in range(s0, s1):
            out[place + b * out_lane] = _horizon(
                heights, base + b * lane_stride, ahead, aside, odd + b, cell, values[b + 1, k], values[b, k], f
            )
        for b in range(s1, b1):
            out[place + b * out_lane] = _horizon(
                heights, base + b * lane_stride, ahead, 0, odd + b, cell, values[b + 1, k], values[b, k], f
            )


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
    swath: Swath, course: Course, line0: int, lines: int, begin: int, stacks: Stacks, profile: F64, slope: F32,
    target: Target,
) -> int:  # fmt: skip
    """Sweep a band of ``len(shift)`` steps, without a radius, for the samples of ``lines`` lines from ``line0``.

    Samples lie on or just before these lines; every sample belongs to one line. ``profile`` and ``slope`` are
    ``working(steps)``; the latter keeps a line's slopes from one group to the next.

    Returns:
        the number of finished lines; fewer than ``lines`` if the pool has too few free pages to continue: call again
        with
        ``begin`` set to it.
    """
    shift, lanes, own = swath.shift, swath.lanes, swath.cell.reach
    steps, points = len(shift), swath.cell.points
    finer = _finer(course, points)
    enough = (GROUP + 1) * (points * steps // PAGE + 2)
    while begin < lines:
        if stacks.free[0] < enough:
            return begin
        count = min(GROUP, lines - begin)
        if begin == 0:
            first, last = _range(shift, lanes, line0 - 1, 1)
            fill(swath, line0 - 1, 1, first, last, profile)
            _unlimited(profile[0], points * first, points * last, finer, own, 0, stacks, slope[0])
        first, last = _range(shift, lanes, line0 + begin, count)
        fill(swath, line0 + begin, count, first, last, profile)
        for b in range(count):
            _unlimited(profile[b], points * first, points * last, finer, own, begin + b + 1, stacks, slope[b + 1])
        _scatter(slope, swath, line0 + begin, count, first, last, 0, target)
        for i in range(points * first, points * last):
            slope[0, i] = slope[count, i]
        begin += count
    return begin


@kernel
def sweep_windows(
    swath: Swath, course: Course, line0: int, lines: int, reach: int, skip: int, own: int, target: Target
) -> None:
    """Like ``sweep_lines``, but only among points within ``reach`` steps, for steps [skip, skip + own) of the band."""
    steps, points = len(swath.shift), swath.cell.points
    finer = _finer(course, points)
    reach *= points
    # Rows a power of two apart would share cache sets.
    profile = np.empty((GROUP, points * steps + 8), np.float64)
    slope = np.zeros((GROUP + 1, points * steps + 16), np.float32)
    near, end, undo = np.empty((reach, 2)), np.empty((reach, 2)), np.empty((reach, 4))
    for begin in range(-1, lines, GROUP):
        count = min(GROUP, lines - begin)
        first, last = _range(swath.shift, swath.lanes, line0 + begin, count)
        if first == last:
            continue
        first, last = 0, steps  # blocks of ``reach`` points begin where the band does, or at the raster's border
        fill(swath, line0 + begin, count, first, last, profile)
        for b in range(count):
            _limited(
                profile[b], points * first, points * last, finer, swath.cell.reach, reach, near, end, undo,
                slope[b + 1],
            )  # fmt: skip
        # The very first line is only used for interpolation.
        a = 1 if begin < 0 else 0
        _scatter(slope[a:], swath, line0 + begin + a, count - a, skip, skip + own, skip, target)
        slope[0] = slope[count]


@inlined
def _finer(course, points):  # type: ignore[no-untyped-def]
    """The course for several points in each step: of two, the sample is the one farther from the light."""
    origin = points * course.origin + (points - 1 if course.backward else 0)
    return Course(course.backward, origin, points * course.scale, course.lowest, course.bend)
