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

GROUP = 16
"""Lines swept together: as many as a cache line has samples, so that sweeps across memory use all of it."""


class Swath(NamedTuple):
    """A band of steps of an azimuth's parallel lines, over a raster.

    Attributes:
        heights: (samples,) metres, neighbouring lanes side by side. start: the sample in lane 0 at step 0; the step
            nearer to the light is there, too.
        step: samples from one step to the next. lanes: their number.
        shift: (steps,) the lane of line 0 at each step; monotonic. part: (steps,) its fraction to the next lane, 0 to
            1.
        cell: how samples find the corners of their own cells.
    """

    heights: F32
    start: int
    step: int
    lanes: int
    shift: I64
    part: F32
    cell: OwnCell


@kernel
def turn(heights: F32, stride: int, rows: int, cols: int, out: F32, wide: int) -> None:
    """Put columns one after the other: out[col · wide + row] = heights[row · stride + col], in tiles for the cache."""
    for row0 in range(0, rows, GROUP):
        for col0 in range(0, cols, GROUP):
            for row in range(row0, min(row0 + GROUP, rows)):
                for col in range(col0, min(col0 + GROUP, cols)):
                    out[col * wide + row] = heights[row * stride + col]


@inlined
def _profile(a: np.float32, b: np.float32, f: np.float32) -> np.float64:
    """Height between two samples, ``f`` from a to b; a missing one is replaced by the other."""
    p, q = np.float64(a), np.float64(b)
    z = p + (q - p) * f
    z = z if a == a else q
    return z if b == b else p


@inlined
def sample_of(i, cell):  # type: ignore[no-untyped-def]
    """The place of step i's samples in a profile: of two points in a step, the one farther from the light."""
    return i if cell.points == 1 else 2 * i + (1 if cell.toward < 0 else 0)


@kernel
def fill(swath: Swath, line0: int, lines: int, first: int, last: int, profile: F64) -> None:
    """Heights at steps [first, last) of the first ``lines`` lines of a group, from ``line0``; NaN elsewhere.

    Args:
        profile: (``cell.points`` · steps, GROUP). With two points, the one on the light's side of a sample is the
            middle of its cell, whichever way that is cut (``middles``).
    """
    nan = np.float32(np.nan)
    heights, lanes, part, cell = swath.heights, swath.lanes, swath.part, swath.cell
    for i in range(first, last):
        lane0, f, k = line0 + swath.shift[i], part[i], sample_of(i, cell)
        base = swath.start + lane0 + i * swath.step
        if lines == GROUP and lane0 >= 0 and lane0 + GROUP < lanes:
            # Unsigned indices, and a number of lines that LLVM knows, make vector instructions.
            for b in range(GROUP):
                h = np.uint64(base + b)
                z = np.float64(heights[h])
                profile[k, b] = _profile(heights[h], heights[h + np.uint64(1)], f) if f > 0.0 else z
        else:
            for b in range(GROUP):
                j = lane0 + b
                p = heights[base + b] if b < lines and 0 <= j < lanes else nan
                q = heights[base + b + 1] if b < lines and f > 0.0 and 0 <= j + 1 < lanes else nan
                profile[k, b] = _profile(p, q, f)
    if cell.points == 2:
        _fill_middles(swath, line0, lines, first, last, profile)


@kernel
def _fill_middles(swath: Swath, line0: int, lines: int, first: int, last: int, profile: F64) -> None:
    """The middles of cells on the light's side of samples; NaN where there are none."""
    nan, half = np.float32(np.nan), np.float32(0.5)
    heights, lanes, cell = swath.heights, swath.lanes, swath.cell
    ahead = cell.toward * swath.step
    for i in range(first, last):
        lane0, k = line0 + swath.shift[i], sample_of(i, cell) + cell.toward
        base, edge = swath.start + lane0 + i * swath.step, i == cell.edge
        if lines == GROUP and not edge and lane0 + min(cell.side, 0) >= 0 and lane0 + GROUP < lanes:
            for b in range(GROUP):
                profile[k, b] = _profile(
                    heights[np.uint64(base + b + cell.side)], heights[np.uint64(base + b + ahead)], half
                )
        else:
            for b in range(GROUP):
                j, h = lane0 + b, base + b
                inside = b < lines and not edge and 0 <= j < lanes and 0 <= j + cell.side < lanes
                p, q = (heights[h + cell.side], heights[h + ahead]) if inside else (nan, nan)
                profile[k, b] = _profile(p, q, half)


@inlined
def middles(swath, line):  # type: ignore[no-untyped-def]
    """Whether a line meets sides of triangles in the middles of cells: they are cut the other way."""
    return swath.cell.points == 2 and (swath.cell.odd + line + swath.shift[0]) & 1 == 1
