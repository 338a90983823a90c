"""Water, found by what only water is: exactly level over a large connected area.

Elevation models are given lakes and seas of one value. Plains of whole metres have level patches too, but small and
ragged ones, as often above their surroundings as below. So a level area is water if it is large, much of it lies well
inside, and its surroundings are banks; and away from the sea, if its level is a whole number of metres (which is where
plains are level), its banks must soon rise by more than the metre that rounding makes. Ground that was clipped at a
round height is the lowest of its raster; in a model of a city houses stand in it, with walls for banks. Dry lake beds
and salt pans that lie beneath steep slopes are still taken for lakes. The sea, at height 0, goes on beyond the borders
of the raster, and into inlets too narrow to be level all around. Resampling and averaging keep constant areas
exactly constant, so equality is the test. Heights are metres; sizes are in samples, for what cannot be seen cannot be
told apart either.

A raster that is a part cut out of a larger one shows some areas in part only. ``judge`` tells these apart, for the
caller to judge them where they are whole.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel, read_only

LEAST_SAMPLES = 120
"""Level samples (whose eight neighbours have their height) that an area must have."""

LEAST_INSIDE = 0.4
"""Least part of them whose 24 neighbours have their height: ragged patches have little inside."""

BANKS = 3.0
"""Ground around it must be higher this many times as often as lower: a plateau or a step of a plain is no lake."""

RISE, REACH, RISING = 1.5, 400.0, 0.5
"""Of the ground ``REACH`` metres around water that may be a plain, at least ``RISING`` is ``RISE`` metres higher."""

SMALL, RISING_SMALL = 500, 0.62
"""Areas of fewer samples, which a plain has by chance, need banks on more sides: dry Owens Lake has one of 0.58, while
of the small lakes of Vermont and California each has more than 0.64."""

ROUND, HOUSES, WALL, WALLED = 10.0, 3, 0.5, 0.5
"""The lowest level, if it is a multiple of ``ROUND`` metres, is clipped ground where more than ``HOUSES`` islands
stand in its areas and at least ``WALLED`` of what adjoins them is higher by more than ``WALL`` of a step, as
natural shores are not."""


INLET = 16
"""Samples that narrow inlets reach from where the sea is wide."""

DIP = 0.5
"""Metres: what heights in whole metres do not tell."""

TOUCHED, MOST_TOUCHED = 3.0, 0.4
"""Factor on the smoothed mask of still ground at height 0 (``still``), and the most that this adds to the field of
water: less than any water has, and more than beside which the line of height 0 is left out
(``rendering.lookup.BESIDE``)."""


@kernel
def _grown(heights, level, lowest):
    """The areas at ``lowest`` with their shores, and how many they are."""
    rows, cols = heights.shape
    grown = np.zeros(heights.shape, np.bool_)
    for r in range(rows):
        for c in range(cols):
            if level[r, c] and heights[r, c] == lowest:
                for i in range(max(r - 1, 0), min(r + 2, rows)):
                    for j in range(max(c - 1, 0), min(c + 2, cols)):
                        grown[i, j] = heights[i, j] == lowest or grown[i, j]
    left, stack, parts = grown.copy(), [0], 0
    for seed in range(rows * cols):
        if not left[seed // cols, seed % cols]:
            continue
        parts += 1
        left[seed // cols, seed % cols] = False
        stack.append(seed)
        while len(stack) > 1:
            at = stack.pop()
            r, c = at // cols, at % cols
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, cols)):
                    if left[i, j]:
                        left[i, j] = False
                        stack.append(i * cols + j)
    return grown, parts


@kernel
def _islands(area):
    """Islands in an area, less its connected parts: from the corners of its outline (Gray 1971)."""
    rows, cols = area.shape
    turns = 0
    for i in range(rows + 1):
        for j in range(cols + 1):
            nw = i > 0 and j > 0 and area[i - 1, j - 1]
            ne = i > 0 and j < cols and area[i - 1, j]
            sw = i < rows and j > 0 and area[i, j - 1]
            se = i < rows and j < cols and area[i, j]
            count = int(nw) + int(ne) + int(sw) + int(se)
            turns += int(count == 3) - int(count == 1) + 2 * int(count == 2 and nw == se)
    return turns // 4


@kernel
def _walled(heights, inner, area, spacing):
    """Part of the samples higher than ``area`` (flat indices) and next to its shore that a wall lifts there."""
    rows, cols = heights.shape
    level = heights[area[0] // cols, area[0] % cols]
    around = walls = 0
    for k in range(len(area)):
        r, c = area[k] // cols, area[k] % cols
        if inner[r, c]:
            continue
        for i in range(max(r - 2, 0), min(r + 3, rows)):
            for j in range(max(c - 2, 0), min(c + 3, cols)):
                higher = heights[i, j] > level
                around += higher
                walls += higher and heights[i, j] > level + WALL * spacing
    return walls / max(around, 1)


@kernel
def _rises(heights, inner, area, reach):
    """Part of the ground ``reach`` samples from the rim of ``area`` (flat indices) that is ``RISE`` metres above it."""
    rows, cols = heights.shape
    around = high = 0
    for k in range(len(area)):
        r, c = area[k] // cols, area[k] % cols
        if inner[r, c]:
            continue
        for i in range(max(r - reach, 0), min(r + reach + 1, rows), reach):
            for j in range(max(c - reach, 0), min(c + reach + 1, cols), reach):
                around += heights[i, j] == heights[i, j] and heights[i, j] != heights[r, c]
                high += heights[i, j] > heights[r, c] + RISE
    return high / max(around, 1)


@kernel
def _flood(heights, level, inner, clipped, reach, cut, verdict, open_area):
    """Judge the connected level areas (see ``judge``); ``level`` is used up. Returns the verdicts on open areas."""
    rows, cols = heights.shape
    stack = np.empty(rows * cols, np.int64)
    verdicts = [np.int8(0)]
    for seed in range(rows * cols):
        if not level[seed // cols, seed % cols]:
            continue
        level[seed // cols, seed % cols] = False
        stack[0] = seed
        size, read, deep, higher, lower = 1, 0, 0, 0, 0
        is_open = north = south = west = east = False
        while read < size:  # what was pushed stays: it is the area
            at = stack[read]
            read += 1
            r, c = at // cols, at % cols
            is_open |= (
                (cut[0] and r == 0) or (cut[1] and r == rows - 1) or (cut[2] and c == 0) or (cut[3] and c == cols - 1)
            )
            north |= r == 0
            south |= r == rows - 1
            west |= c == 0
            east |= c == cols - 1
            deep += inner[r, c]
            if not inner[r, c]:  # near the shore: what lies behind it?
                for i in range(max(r - 2, 0), min(r + 3, rows)):
                    for j in range(max(c - 2, 0), min(c + 3, cols)):
                        higher += heights[i, j] > heights[r, c]
                        lower += heights[i, j] < heights[r, c]
            for i in range(max(r - 1, 0), min(r + 2, rows)):
                for j in range(max(c - 1, 0), min(c + 2, cols)):
                    if level[i, j] and heights[i, j] == heights[r, c]:
                        level[i, j] = False
                        stack[size] = i * cols + j
                        size += 1
        is_open = (
            is_open and 8 * size >= LEAST_SAMPLES
        )  # less than that is out of sight, beyond the edge of the picture
        found = np.int8(0)
        height = heights[seed // cols, seed % cols]
        ends = (
            int(north and not cut[0]) + int(south and not cut[1]) + int(west and not cut[2]) + int(east and not cut[3])
        )
        likely = size << ends if height == 0.0 else size  # the sea goes on beyond the raster: mirrored at its borders
        if likely >= LEAST_SAMPLES and deep >= LEAST_INSIDE * size:
            plain = height != 0.0 and height == np.round(height)
            rising = RISING if size >= SMALL else RISING_SMALL
            wet = higher >= BANKS * lower and not (plain and _rises(heights, inner, stack[:size], reach) < rising)
            found = np.int8(1 if wet and height != clipped else -1)
        if is_open:
            verdicts.append(found)
        elif found == 0:
            continue
        for k in range(size):
            r, c = stack[k] // cols, stack[k] % cols
            for i in range(max(r - 1, 0), min(r + 2, rows)):  # out to the shore, whose samples are level too
                for j in range(max(c - 1, 0), min(c + 2, cols)):
                    if heights[i, j] == heights[r, c]:
                        if is_open:
                            open_area[i, j] = len(verdicts) - 1
                        else:
                            verdict[i, j] = found
    return np.array(verdicts)


def judge(
    heights: NDArray[np.float32], spacing: float, cut: tuple[bool, bool, bool, bool], lowest: float
) -> tuple[NDArray[np.int8], NDArray[np.int32], NDArray[np.int8]]:
    """What the level areas are.

    Args:
        heights: (rows, cols) float32 metres, NaN where missing. spacing: metres between samples.
        cut: whether the raster's top, bottom, left and right are not those of the whole.
        lowest: height of the whole, metres; NaN where it has none.

    Returns:
        verdict: (rows, cols) 1 water, −1 a level area that is none, 0 neither or too small to tell.
        open_area: (rows, cols) numbers from 1 of the areas that reach a cut, 0 elsewhere; their verdict is left at 0.
        verdicts: (number + 1,) how the open areas look, as far as they can be seen.
    """
    level = level_in(heights, np.isfinite(heights))
    verdict, open_area = np.zeros(heights.shape, np.int8), np.zeros(heights.shape, np.int32)
    verdicts = np.zeros(1, np.int8)
    if level.any():
        reach = min(max(round(REACH / spacing) + 1, 4), 8)  # from the rim, one sample inside the shore
        inner = level_in(heights, level)
        heights = read_only(np.ascontiguousarray(heights))
        clipped = lowest if _is_clipped(heights, level, inner, spacing, lowest) else np.nan
        verdicts = _flood(heights, level, inner, clipped, reach, cut, verdict, open_area)
    return verdict, open_area, verdicts


def _is_clipped(
    heights: NDArray[np.float32], level: NDArray[np.bool_], inner: NDArray[np.bool_], spacing: float, lowest: float
) -> bool:
    """Whether what is at the lowest height is ground that was clipped there, not water: houses stand in it. All of its
    areas are looked at together, for none of them alone need have many."""
    if lowest == 0.0 or lowest % ROUND != 0.0:
        return False
    grown, parts = _grown(heights, level, lowest)
    if not parts or _islands(grown) + parts <= HOUSES:
        return False
    area = np.flatnonzero(level & (heights == lowest))
    return bool(_walled(heights, inner, area, spacing) >= WALLED)


def find_water(heights: NDArray[np.float32], spacing: float = 100.0) -> NDArray[np.bool_]:
    """Samples that are water.

    Args:
        heights: (rows, cols) float32 metres, NaN where missing. spacing: metres between samples.
    """
    known = heights[np.isfinite(heights)]
    lowest = float(known.min()) if known.size else np.nan
    return with_inlets(heights, judge(heights, spacing, (False, False, False, False), lowest)[0] > 0)


def with_inlets(heights: NDArray[np.float32], water: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Water with the samples at height 0 that are joined to the sea in at most ``INLET`` steps over such samples; not
    those on a step of a plain, with more lower neighbours than higher ones."""
    sea = water & (heights == 0)
    if not sea.any():
        return water
    around = np.pad(heights, 1, mode="edge")
    rows, cols = heights.shape
    balance = np.zeros(heights.shape, np.int8)
    for i in range(3):
        for j in range(3):
            beside = around[i : i + rows, j : j + cols]
            balance += (beside > 0).astype(np.int8) - (beside < 0).astype(np.int8)
    may = (heights == 0) & (balance >= 0)
    for _ in range(INLET):
        grown: NDArray[np.bool_] = sea | (_spread(sea) & may)
        if (grown == sea).all():
            break
        sea = grown
    return np.asarray(water | sea)


def _spread(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask and its eight neighbours."""
    for axis in (0, 1):
        a, b = [slice(None)] * 2, [slice(None)] * 2
        a[axis], b[axis] = slice(1, None), slice(None, -1)
        wide = mask.copy()
        wide[tuple(a)] |= mask[tuple(b)]
        wide[tuple(b)] |= mask[tuple(a)]
        mask = wide
    return mask


def still(heights: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Samples at height 0 that no neighbour is lower than by more than ``DIP``: the ground touches that height there
    and does not cross it, so that a contour would be no more than the outline of samples."""
    return np.asarray((heights == 0) & ~_spread(np.asarray(heights < -DIP)))


class Means(Protocol):
    """A terrain's pyramid of box means (``store.Terrain``)."""

    @property
    def levels(self) -> int: ...

    @property
    def height_range(self) -> tuple[float, float]: ...

    def mean_shape(self, level: int) -> tuple[int, int]: ...

    def read_mean(self, level: int, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]: ...


def water_in(
    terrain: Means, spacing: float, level: int, row0: int, col0: int, heights: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Water in a window of a level of a terrain's means, judged beyond the window where it goes on.

    Args:
        spacing: metres between the terrain's samples.
        heights: (rows, cols) of the window, whose first sample is (row0, col0).
    """
    rows, cols = heights.shape
    if not (heights == 0).any():
        return _verdicts(terrain, spacing, level, row0, col0, heights) > 0
    all_rows, all_cols = terrain.mean_shape(level)  # inlets may be joined to the sea beyond the window
    r0, r1 = max(row0 - INLET, 0), min(row0 + rows + INLET, all_rows)
    c0, c1 = max(col0 - INLET, 0), min(col0 + cols + INLET, all_cols)
    around = heights if (r1 - r0, c1 - c0) == heights.shape else terrain.read_mean(level, r0, r1, c0, c1)
    found = with_inlets(around, _verdicts(terrain, spacing, level, r0, c0, around) > 0)
    return found[row0 - r0 : row0 - r0 + rows, col0 - c0 : col0 - c0 + cols]


def _verdicts(
    terrain: Means, spacing: float, level: int, row0: int, col0: int, heights: NDArray[np.float32]
) -> NDArray[np.int8]:
    """Verdicts (see ``judge``) on a window. What reaches its border is what it is in a window of the next coarser level
    that is about twice as large and so on, up to the whole terrain; what is too small there is as it looks here."""
    rows, cols = heights.shape
    all_rows, all_cols = terrain.mean_shape(level)
    row1, col1 = row0 + rows, col0 + cols
    cut = (row0 > 0, row1 < all_rows, col0 > 0, col1 < all_cols)
    verdict, open_area, verdicts = judge(heights, spacing * 2.0**level, cut, terrain.height_range[0])
    if len(verdicts) == 1:
        return verdict
    last = terrain.levels - 1
    above = min(level + 1, last)
    step = 2 ** (above - level)
    r0, c0, (r1, c1) = 0, 0, terrain.mean_shape(above)
    if level < last:
        r0, c0 = max((row0 - rows // 2) // step, 0), max((col0 - cols // 2) // step, 0)
        r1, c1 = min((row1 + rows // 2) // step + 1, r1), min((col1 + cols // 2) // step + 1, c1)
    around = _verdicts(terrain, spacing, above, r0, c0, terrain.read_mean(above, r0, r1, c0, c1))
    r, c = np.nonzero(open_area)
    number = open_area[r, c]
    votes = np.bincount(number, around[(r + row0) // step - r0, (c + col0) // step - c0], len(verdicts))
    verdicts = np.where(votes == 0, verdicts, np.sign(votes)).astype(np.int8)
    return np.where(open_area > 0, verdicts[open_area], verdict)


def shore(water: NDArray[np.bool_], quiet: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
    """A field (rows, cols) whose contour at 0.5, interpolated, is the shore with the steps of samples smoothed out.

    It is the mask under the binomial filter 1 4 6 4 1 each way, the border repeated. Away from water it is more than 0
    (at most ``MOST_TOUCHED``) where no line of height 0 is wanted.

    Args:
        quiet: (rows, cols) such ground, as ``still`` has it.
    """
    field = _smoothed(water)
    if quiet is None:
        return field
    hushed = np.minimum(TOUCHED * _smoothed(quiet), MOST_TOUCHED)
    return np.where(_spread(water), field, np.maximum(field, hushed)).astype(np.float32)


def _smoothed(water: NDArray[np.bool_]) -> NDArray[np.float32]:
    """A mask under the binomial filter."""
    field = np.pad(water.astype(np.float32), 2, mode="edge")
    for axis in (0, 1):
        n = water.shape[axis]
        a, b, c, d, e = (field[(slice(None),) * axis + (slice(k, k + n),)] for k in range(5))
        field = (a + e + 4 * (b + d) + 6 * c) / np.float32(16)
    return np.asarray(field, np.float32)


def level_in(heights: NDArray[np.float32], where: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples in ``where`` whose eight neighbours (those inside the raster) are in ``where`` and have their height."""
    level = where
    for axis in (0, 1):
        a, b = [slice(None)] * 2, [slice(None)] * 2
        a[axis], b[axis] = slice(1, None), slice(None, -1)
        equal = (heights[tuple(a)] == heights[tuple(b)]) & level[tuple(a)] & level[tuple(b)]
        level = level.copy()
        level[tuple(a)] &= equal
        level[tuple(b)] &= equal
    return level
