"""Neighbours in a strip: overlaps, gaps between them, and missing ground that they cover.

Without overlaps, each triangle lies east of its western neighbour at both rows of the strip. If it does not touch the
neighbour, there is a gap, whose existing units are marked; missing units that are covered are bridged.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.verify.spans import sort_west_to_east
from orograph.verify.strips import ceiling, compare, meets_unit, sides


@leaf
def mark_gap(wn, wstep, wd, en, estep, ed, strip, west, units, codes, i, marks):
    """Mark the existing units in a gap between triangles, unless all their corners are beyond one side of the view."""
    shift = strip.shift
    first = max(min(wn // wd, (wn + wstep) // wd) >> shift, west)
    last = min((max(ceiling(en, ed), ceiling(en + estep, ed)) - 1) >> shift, west + codes.shape[1] - 2)
    for c in range(first, last + 1):
        j = c - west
        bits = units[j + 1]
        if bits == 0:
            continue
        even = (c + strip.row) & 1 == 0
        for half in range(2):
            if bits >> half & 1 == 0:
                continue
            if even:
                shared = codes[i, j] & codes[i + 1, j + 1] & (codes[i, j + 1] if half == 0 else codes[i + 1, j])
            else:
                shared = codes[i, j + 1] & codes[i + 1, j] & (codes[i, j] if half == 0 else codes[i + 1, j + 1])
            if shared == 0 and meets_unit(wn, wstep, wd, en, estep, ed, c, half, strip):
                marks[j] |= 1 << half


@leaf
def mark_bridge(wn, wstep, wd, en, estep, ed, strip, west, units, marks):
    """Mark the missing units that a triangle covers, wholly or in part: bits 2 and 3."""
    shift = strip.shift
    first = max(min(wn // wd, (wn + wstep) // wd) >> shift, west)
    last = min((max(ceiling(en, ed), ceiling(en + estep, ed)) - 1) >> shift, west + marks.shape[0] - 2)
    for c in range(first, last + 1):
        bits = units[c - west + 1]
        if bits != 3:
            for half in range(2):
                if bits >> half & 1 == 0 and meets_unit(wn, wstep, wd, en, estep, ed, c, half, strip):
                    marks[c - west] |= 4 << half


@leaf
def sweep_strip(table, members, active, n, strip, west, units, missing, codes, i, marks, overlapping):
    """Compare neighbours in a strip, mark gaps and bridges in ``marks``, flag overlaps.

    Args:
        table: of the triangles. active: the n of them that meet the strip, from west to east.
        west: the window's first column. units, missing: from ``existing_units``; codes[i], codes[i + 1]: the outcodes
            of the samples above and below.
    """
    zero, one = np.int64(0), np.int64(1)  # (typed: Numba compiles a function once more for each constant)
    for attempt in range(2):
        disordered = False
        pn, pstep, pd, previous = west << strip.shift, zero, one, -1
        for a in range(n):
            k = active[a]
            wn, wstep, wd, en, estep, ed = sides(table, k, strip.y0, strip.y1)
            upper, lower = compare(pn, pd, wn, wd), compare(pn + pstep, pd, wn + wstep, wd)
            if previous >= 0 and (upper > 0.0 or lower > 0.0):
                if attempt == 0:
                    disordered = True  # perhaps because of an overlap further up: repeat it, in order
                    break
                overlapping[members[k]] = 1
                overlapping[members[previous]] = 1
            elif upper < 0.0 or lower < 0.0:
                mark_gap(pn, pstep, pd, wn, wstep, wd, strip, west, units, codes, i, marks)
            if missing > 0:
                mark_bridge(wn, wstep, wd, en, estep, ed, strip, west, units, marks)
            if previous < 0 or compare(2 * en + estep, ed, 2 * pn + pstep, pd) > 0.0:
                pn, pstep, pd, previous = en, estep, ed, k
        if not disordered:
            end = (west + codes.shape[1] - 1) << strip.shift
            if compare(pn, pd, end, 1) < 0.0 or compare(pn + pstep, pd, end, 1) < 0.0:
                mark_gap(pn, pstep, pd, end, zero, one, strip, west, units, codes, i, marks)
            return
        sort_west_to_east(table, active, 0, n, strip.y0, strip.y1)
