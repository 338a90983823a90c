"""Which windows a clipmap has: around the eye, as printed, or where a tolerance asks for them.

A window begins and ends at even samples of its level: its sides are then samples of the next coarser level, and windows
nest. It is cut to the raster; where a level's last sample is odd, one more stands for the raster's last row or column
(as the square of 2^n + 1 samples is squeezed onto the raster). Levels are any, stored or not; samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.lod.selection import Blend

Shape = tuple[int, int]


def whole(level: int, shape: Shape) -> Rectangle:
    """All of a raster of that shape, at a level."""
    last_row, last_col = (_last(side, level) for side in shape)
    return Rectangle(level, 0, last_row + 1, 0, last_col + 1)


def around(level: int, n: int, centre: tuple[float, float], shape: Shape) -> Rectangle:
    """The window of n × n samples of a level around a place, snapped to even samples and cut to the raster.

    Args:
        centre: row and column, full-resolution samples.
    """
    sides: list[int] = []
    for place, side in zip(centre, shape, strict=True):
        first = 2 * round((place / 2.0**level - (n - 1) / 2) / 2)
        sides += [max(first, 0), min(first + n - 1, _last(side, level)) + 1]
    return Rectangle(level, *sides)


def as_printed(
    n: int, centre: tuple[float, float], shape: Shape, finest: int, coarsest: int
) -> tuple[ClipStack, tuple[Blend, ...]]:
    """A window of every level from the finest to one that holds the raster, and their transitions (Losasso & Hoppe
    2004, section 3; the transition's formula is section 4.3's).

    Args:
        n: samples along a side. centre: row and column that windows lie around.
        coarsest: the level that holds all of the raster, wherever the eye is.
    """
    found: list[Rectangle] = []
    for level in range(finest, coarsest + 1):
        window = around(level, n, centre, shape) if level < coarsest else whole(level, shape)
        if min(window.shape) >= 2:
            found.append(window)
        if window == whole(level, shape):
            break
    stack = ClipStack(reversed(found))
    return stack, tuple(_blend_around(window.level, n, centre) for window in stack)


def nested(wanted: Mapping[int, Rectangle], width: int, shape: Shape, coarsest: int) -> tuple[ClipStack, list[Blend]]:
    """Windows that hold what is wanted of their levels, each with room for its transition around what the finer ones
    and the wish hold.

    Args:
        wanted: by level, finest to coarsest without gaps; the coarsest may lack.
        width: samples of a transition; 0: there are none.
    """
    found: list[Rectangle] = []
    for level in range(min(wanted, default=coarsest), coarsest + 1):
        room = [wanted[level].grown(width + 2)] if level in wanted else []
        room += [found[-1].around(level).grown(width + 2)] if found else []
        every = whole(level, shape)
        window = every
        if room and level < coarsest:
            grown = room[0].joined(room[-1])
            rows = max(grown.row0, 0) & ~1, min((grown.row1 & ~1) + 1, every.row1)
            cols = max(grown.col0, 0) & ~1, min((grown.col1 & ~1) + 1, every.col1)
            window = Rectangle(level, *rows, *cols)
        found.append(window)
        if window == every:
            break
    stack = ClipStack(reversed(found))
    return stack, [_blend_of(window, width, shape) for window in stack]


def borders(window: Rectangle, shape: Shape) -> tuple[bool, bool, bool, bool]:
    """Which sides (north, south, west, east) lie on the raster's border, beyond which there is nothing."""
    every = whole(window.level, shape)
    return window.row0 == 0, window.row1 == every.row1, window.col0 == 0, window.col1 == every.col1


def _last(side: int, level: int) -> int:
    """A level's last sample, made even."""
    last = -((1 - side) >> level)
    return last + (last & 1)


def _blend_around(level: int, n: int, centre: tuple[float, float]) -> Blend:
    width = n / 10
    row, col = (place / 2.0**level for place in centre)
    flat = (n - 1) / 2 - width - 1
    return Blend(row - flat, row + flat, col - flat, col + flat, width)


def _blend_of(window: Rectangle, width: int, shape: Shape) -> Blend:
    north, south, west, east = borders(window, shape)
    if width == 0:
        return NO_BLEND
    return Blend(
        -math.inf if north else window.row0 + width, math.inf if south else window.row1 - 1 - width,
        -math.inf if west else window.col0 + width, math.inf if east else window.col1 - 1 - width, width,
    )  # fmt: skip


NO_BLEND = Blend(-math.inf, math.inf, -math.inf, math.inf, 1.0)
"""Nowhere."""
