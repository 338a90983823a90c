"""The columns of a stack's tables, one row for each window (see ``stack.Stack``)."""

from __future__ import annotations

BASE, STRIDE, CELLS_X, CELLS_Y, MIP_FIRST, MIP_COUNT = range(6)
"""Integers: offset of its heights in the pool, samples per row, cells each way, its first mip level, their number."""

ORIGIN_X, ORIGIN_Y, SCALE, WEST, NORTH, EAST, SOUTH, INVERSE = range(8)
"""Floats, in sample coordinates: its first sample, 2^level, the limits of its ground, 2^−level."""
