"""Neighbours in the strip below a row: overlaps, gaps between them, and missing ground that they cover.

Triangles that overlap nowhere lie each east of its western neighbour at both rows of the strip. Where one does not
touch it there is a gap, whose existing units are marked; units that do not exist and are covered are bridged.
"""

from __future__ import annotations

from orograph._numba import leaf
from orograph.verify.spans import sort_west_to_east
from orograph.verify.strips import ceiling, meets_unit, sides


@leaf
def mark_gap(wn, wdx, wd, en, edx, ed, row, west, units, above, below, marks):
    """Mark the existing units in a gap between triangles, unless all their corners are beyond one side of the view."""
    first = max(min(wn // wd, (wn + wdx) // wd), west)
    last = min(max(ceiling(en, ed), ceiling(en + edx, ed)) - 1, west + above.shape[0] - 2)
    for c in range(first, last + 1):
        j = c - west
        bits = units[j + 1]
        if bits == 0:
            continue
        even = (c + row) & 1 == 0
        for half in range(2):
            if bits >> half & 1 == 0:
                continue
            if even:
                shared = above[j] & below[j + 1] & (above[j + 1] if half == 0 else below[j])
            else:
                shared = above[j + 1] & below[j] & (above[j] if half == 0 else below[j + 1])
            if shared == 0 and meets_unit(wn, wdx, wd, en, edx, ed, c, row, half):
                marks[j] |= 1 << half


@leaf
def mark_bridge(wn, wdx, wd, en, edx, ed, row, west, units, marks):
    """Mark the missing units that a triangle covers, wholly or in part: bits 2 and 3."""
    first = min(wn // wd, (wn + wdx) // wd)
    last = max(ceiling(en, ed), ceiling(en + edx, ed)) - 1
    for c in range(first, last + 1):
        bits = units[c - west + 1]
        if bits != 3:
            for half in range(2):
                if bits >> half & 1 == 0 and meets_unit(wn, wdx, wd, en, edx, ed, c, row, half):
                    marks[c - west] |= 4 << half


@leaf
def sweep_strip(table, members, active, n, row, west, units, missing, above, below, marks, overlapping):
    """Compare neighbours in the strip below ``row``, mark gaps and bridges in ``marks``, flag overlaps."""
    columns = above.shape[0]
    for attempt in range(2):
        disordered = False
        pn, pdx, pd, previous = west, 0, 1, -1
        for i in range(n):
            k = active[i]
            wn, wdx, wd, en, edx, ed = sides(table, k, row)
            upper, lower = pn * wd - wn * pd, (pn + pdx) * wd - (wn + wdx) * pd
            if previous >= 0 and (upper > 0 or lower > 0):
                if attempt == 0:
                    disordered = True  # by an overlap further up, perhaps: once more, in order
                    break
                overlapping[members[k]] = 1
                overlapping[members[previous]] = 1
            elif upper < 0 or lower < 0:
                mark_gap(pn, pdx, pd, wn, wdx, wd, row, west, units, above, below, marks)
            if missing > 0:
                mark_bridge(wn, wdx, wd, en, edx, ed, row, west, units, marks)
            if previous < 0 or (2 * en + edx) * pd > (2 * pn + pdx) * ed:
                pn, pdx, pd, previous = en, edx, ed, k
        if not disordered:
            end = west + columns - 1
            if pn < end * pd or pn + pdx < end * pd:
                mark_gap(pn, pdx, pd, end, 0, 1, row, west, units, above, below, marks)
            return
        sort_west_to_east(table, active, 0, n, row)
