"""Profiles of lines over a raster: the heights that ``sweep_kernels`` walks along, for one band of steps.

Heights are metres, NaN where missing. A line crosses a step between two samples, or through one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel
from orograph.lighting.own_cell import OwnCell

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class Swath(NamedTuple):
    """A band of steps of an azimuth's parallel lines, over a raster.

    Attributes:
        heights: (samples,) metres. start: the sample in lane 0 at step 0; the step nearer to the light is there, too.
        lane, step: samples from one lane, and from one step, to the next. lanes: their number.
        shift: (steps,) the lane of line 0 at each step; monotonic. part: (steps,) its fraction to the next lane, 0 to
            1.
        cell: how samples find the corners of their own cells.
    """

    heights: F32
    start: int
    lane: int
    step: int
    lanes: int
    shift: I64
    part: F32
    cell: OwnCell


@inlined
def _profile(a: np.float32, b: np.float32, f: np.float32) -> np.float64:
    """Height between two samples, ``f`` from a to b; a missing one is replaced by the other."""
    if a != a:
        return np.float64(b)
    if b != b:
        return np.float64(a)
    return np.float64(a) + (np.float64(b) - np.float64(a)) * f


@kernel
def _gather(swath: Swath, line0: int, lines: int, first: int, last: int, profile: F64) -> None:
    """Heights at steps [first, last) of ``lines`` lines from ``line0``: profile (lines, steps), NaN off the raster."""
    nan = np.float32(np.nan)
    heights, start, lanes, shift, part = swath.heights, swath.start, swath.lanes, swath.shift, swath.part
    lane_stride, step_stride = swath.lane, swath.step
    if lane_stride == 1:  # neighbouring lines are adjacent in memory
        for i in range(first, last):
            lane0, f = line0 + shift[i], part[i]
            base = start + lane0 + i * step_stride
            if lane0 >= 0 and lane0 + lines < lanes:
                if f == 0.0:
                    for b in range(lines):
                        profile[b, i] = heights[base + b]
                else:
                    for b in range(lines):
                        profile[b, i] = _profile(heights[base + b], heights[base + b + 1], f)
            else:
                for b in range(lines):
                    j = lane0 + b
                    p = heights[base + b] if 0 <= j < lanes else nan
                    q = heights[base + b + 1] if f > 0.0 and 0 <= j + 1 < lanes else nan
                    profile[b, i] = _profile(p, q, f)
        return
    for b in range(lines):
        for i in range(first, last):
            j, f = line0 + b + shift[i], part[i]
            k = start + j * lane_stride + i * step_stride
            p = heights[k] if 0 <= j < lanes else nan
            q = heights[k + lane_stride] if f > 0.0 and 0 <= j + 1 < lanes else nan
            profile[b, i] = _profile(p, q, f)


@kernel
def _gather_diagonal(swath: Swath, line0: int, lines: int, first: int, last: int, profile: F64) -> None:
    """Like ``_gather``, for lines along cells' diagonals: profile (lines, 2 · steps), samples and points in between.

    On the light's side of a sample of odd row + column, that is the middle of its cell; for others it is NaN, because
    the surface is straight there.
    """
    nan = np.float32(np.nan)
    heights, start, lanes, shift, cell = swath.heights, swath.start, swath.lanes, swath.shift, swath.cell
    lane_stride, step_stride = swath.lane, swath.step
    at, between = (0, 1) if cell.toward > 0 else (1, 0)
    for b in range(lines):
        for i in range(first, last):
            j = line0 + b + shift[i]
            k = start + j * lane_stride + i * step_stride
            inside, beside = 0 <= j < lanes, 0 <= j + cell.side < lanes
            profile[b, 2 * i + at] = heights[k] if inside else nan
            middle = np.float64(nan)
            if inside and beside and i != cell.edge and (cell.odd + j + i) & 1:
                middle = _profile(
                    heights[k + cell.side * lane_stride], heights[k + cell.toward * step_stride], np.float32(0.5)
                )
            profile[b, 2 * i + between] = middle


@inlined
def fill(swath, line0, lines, first, last, profile):  # type: ignore[no-untyped-def]
    """The profiles of lines, with ``cell.points`` places for each step."""
    if swath.cell.points == 1:
        _gather(swath, line0, lines, first, last, profile)
    else:
        _gather_diagonal(swath, line0, lines, first, last, profile)
