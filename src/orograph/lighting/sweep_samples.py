"""Horizons of samples, from those of the lines beside them and of their own cells: the end of a sweep over a band."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orograph._numba import inlined, kernel
from orograph.lighting.own_cell import cell_slope
from orograph.lighting.sweep_profiles import F32, F64, GROUP, Swath


class Target(NamedTuple):
    """The output of horizons: ``values`` (samples,), with strides from lane to lane and from step to step."""

    values: F32
    lane: int
    step: int


@inlined
def _between(z, near, one, other, f):  # type: ignore[no-untyped-def]
    """The horizon of a sample: of its own cell, or the lines on both sides beyond theirs; NaN at NaN.

    Args:
        z: height of the sample. near: the horizon of its own cell, NaN: nothing.
        one, other: the lines' horizons. f: the second one's share.
    """
    one, other = np.float32(one), np.float32(other)
    a = near if near > one else one
    b = near if near > other else other
    v = a * (np.float32(1.0) - f) + b * f if f > 0 else a
    return v if z == z else np.float32(np.nan)


@kernel
def _at_border(slope: F64, swath: Swath, i: int, lane0: int, found: F32) -> None:
    """Horizons at step i of samples in GROUP lanes from ``lane0``, some of which lack neighbours."""
    nan = np.float32(np.nan)
    heights, cell, f = swath.heights, swath.cell, swath.part[i]
    ahead = cell.toward * swath.step
    for b in range(max(-lane0, 0), min(swath.lanes - lane0, GROUP)):
        lane = lane0 + b
        k, near = swath.start + lane + i * swath.step, nan
        if cell.reach > 0.0 and i != cell.edge:
            both, minor = nan, nan
            if 0 <= lane + cell.side < swath.lanes:
                both, minor = heights[k + ahead + cell.side], heights[k + cell.side]
            near = cell_slope(heights[k], heights[k + ahead], both, minor, cell.odd + lane + i, cell)
        found[i, b] = _between(heights[k], near, slope[i, b + 1], slope[i, b], f)


@kernel
def _horizons(slope: F64, swath: Swath, begin: int, first: int, last: int, found: F32) -> None:
    """Horizons of the samples just before GROUP lines from ``begin``: found (steps, GROUP)."""
    nan = np.float32(np.nan)
    heights, lanes, cell = swath.heights, swath.lanes, swath.cell
    ahead = cell.toward * swath.step
    for i in range(first, last):
        lane0, f = begin + swath.shift[i], swath.part[i]
        base = swath.start + lane0 + i * swath.step
        # Unsigned indices, and a number of lines that LLVM knows, make vector instructions.
        if lane0 < 1 or lane0 + GROUP >= lanes or (cell.reach > 0.0 and i == cell.edge):
            _at_border(slope, swath, i, lane0, found)
        elif cell.reach == 0.0:
            for b in range(GROUP):
                found[i, b] = _between(heights[np.uint64(base + b)], nan, slope[i, b + 1], slope[i, b], f)
        else:
            for b in range(GROUP):
                k = base + b
                z = heights[np.uint64(k)]
                near = cell_slope(
                    z, heights[np.uint64(k + ahead)], heights[np.uint64(k + ahead + cell.side)],
                    heights[np.uint64(k + cell.side)], cell.odd + lane0 + i + b, cell,
                )  # fmt: skip
                found[i, b] = _between(z, near, slope[i, b + 1], slope[i, b], f)


@kernel
def horizons_of(
    slope: F64, swath: Swath, begin: int, first: int, last: int, skip: int, found: F32, target: Target
) -> None:
    """Horizons of samples on or just before GROUP lines from ``begin``, at steps [first, last); NaN where heights are.

    Args:
        slope: (steps, 1 + GROUP) of the lines, and of the one before them; the last one's become the first ones.
        skip: steps of the heights that have no place in the target.
        found: (steps, GROUP) memory.
    """
    _horizons(slope, swath, begin, first, last, found)
    for i in range(len(swath.shift)):
        slope[i, 0] = slope[i, GROUP]
    out, lanes, shift = target.values, swath.lanes, swath.shift
    if target.lane == 1:
        for i in range(first, last):
            lane0 = begin + shift[i]
            place = lane0 + (i - skip) * target.step
            for b in range(max(-lane0, 0), min(lanes - lane0, GROUP)):
                out[place + b] = found[i, b]
        return
    for b in range(GROUP):
        for i in range(first, last):
            lane = begin + b + shift[i]
            if 0 <= lane < lanes:
                out[lane * target.lane + (i - skip) * target.step] = found[i, b]
