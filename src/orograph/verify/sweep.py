"""One pass over a band of rows: every sample against the mesh, every strip between rows for overlaps and gaps.

A sweep (Wylie et al. 1967's scan lines, made exact): going down the rows, the triangles that meet the strip below a row
are kept from west to east. They overlap nowhere iff each lies east of its western neighbour at both rows of the strip;
where it does not touch it there is a gap, and the unit triangles of the full-resolution surface in the gap are not
covered. On the row itself each triangle spans an interval of samples; its height there is compared with theirs on the
screen. All decisions about overlap, gaps and edges are made with integers (``strips``), heights and pixels are float64.

Bands are independent, so that a terrain larger than memory is judged band by band, in any number of threads.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf
from orograph.verify.frustum import P0, P1, outcode, place, polygon_in_view
from orograph.verify.strips import BEND, C0, C1, C2, R0, R1, R2, ceiling, corners, extent, meets_unit, order, sides

SAMPLES, UNCOVERED, HOLES, BRIDGED, DUPLICATES, WRONG_HEIGHTS, COUNTS = range(7)
"""What a band counts."""

OF_MISSING, OF_HIDDEN, OF_SEEN = range(3)
"""What lies beyond an open edge: missing ground, ground out of view, ground (partly) in view."""


@kernel
def bucket(triangles, columns, rows, signs, size, bands):
    """The triangles with area that touch each band of ``size`` rows or the row below it, by their upper row and column.

    Returns:
        (start (bands + 1,), members): band b's are ``members[start[b]:start[b + 1]]``, ordered by the row, then the
        column of their first corner.
    """
    m = triangles.shape[0]
    last_row, last_col = 0, 0
    for i in range(rows.shape[0]):
        last_row, last_col = max(last_row, rows[i]), max(last_col, columns[i])
    top, left, bottom = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(m, np.int64)
    for t in range(m):
        top[t], left[t], bottom[t] = np.int64(1) << 62, 0, 0
        for k in range(3):
            v = triangles[t, k]
            if rows[v] < top[t] or (rows[v] == top[t] and columns[v] < left[t]):
                top[t], left[t] = rows[v], columns[v]
            bottom[t] = max(bottom[t], rows[v])
    by_column = np.empty(m, np.int64)
    place_at = np.zeros(last_col + 2, np.int64)
    for t in range(m):
        place_at[left[t] + 1] += 1
    for i in range(last_col + 1):
        place_at[i + 1] += place_at[i]
    for t in range(m):
        by_column[place_at[left[t]]] = t
        place_at[left[t]] += 1
    by_row = np.empty(m, np.int64)
    place_at = np.zeros(last_row + 2, np.int64)
    for t in range(m):
        place_at[top[t] + 1] += 1
    for i in range(last_row + 1):
        place_at[i + 1] += place_at[i]
    for i in range(m):
        t = by_column[i]
        by_row[place_at[top[t]]] = t
        place_at[top[t]] += 1
    start = np.zeros(bands + 1, np.int64)
    for t in range(m):
        if signs[t] != 0:
            for b in range(max(top[t] - 1, 0) // size, bottom[t] // size + 1):
                start[b + 1] += 1
    for b in range(bands):
        start[b + 1] += start[b]
    fill = start.copy()
    members = np.empty(start[bands], np.int64)
    for i in range(m):
        t = by_row[i]
        if signs[t] != 0:
            for b in range(max(top[t] - 1, 0) // size, bottom[t] // size + 1):
                members[fill[b]] = t
                fill[b] += 1
    return start, members


@inlined
def west_of(table, k, j, row):
    """Whether triangle k's west side lies west of j's in the middle of the strip below ``row``."""
    kn, kdx, kd, _, _, _ = sides(table, k, row)
    jn, jdx, jd, _, _, _ = sides(table, j, row)
    return (2 * kn + kdx) * jd < (2 * jn + jdx) * kd


@leaf
def sort_west_to_east(table, active, begin, end, row):
    """Insertion sort of ``active[begin:end]``, exact; quick where the order is nearly right."""
    for i in range(begin + 1, end):
        k, j = active[i], i
        while j > begin and west_of(table, k, active[j - 1], row):
            active[j] = active[j - 1]
            j -= 1
        active[j] = k


@leaf
def span_row(table, planes, k, row, west, lowest, highest):
    """Lower and raise the mesh's extremes at the samples of a row that triangle k spans."""
    wn, wd, en, ed = extent(table, k, row)
    first, last = ceiling(wn, wd), en // ed
    base = planes[k, 0] + planes[k, 2] * (row - table[k, R0])
    slope, from_column = planes[k, 1], table[k, C0]
    for c in range(first, last + 1):
        z = base + slope * (c - from_column)
        if z < lowest[c - west]:
            lowest[c - west] = z
        if z > highest[c - west]:
            highest[c - west] = z


@leaf
def find_junctions(table, k, row, west, vertex_at, before, junctions):
    """Flag the vertices of a row that lie inside an edge of triangle k; ``before`` counts vertices by column."""
    r0, r1, r2 = table[k, R0], table[k, R1], table[k, R2]
    if r0 < row < r2:
        wn, wd, en, ed = extent(table, k, row)
        bend = table[k, BEND] if row == r1 else 0
        if bend >= 0 and wn % wd == 0 and vertex_at[wn // wd - west] >= 0:
            junctions[vertex_at[wn // wd - west]] = 1
        if bend <= 0 and en % ed == 0 and vertex_at[en // ed - west] >= 0:
            junctions[vertex_at[en // ed - west]] = 1
    elif r0 == r1 == row or r1 == r2 == row:
        a, b = (table[k, C0], table[k, C1]) if r0 == r1 else (table[k, C1], table[k, C2])
        if before[b - west] > before[a + 1 - west]:
            for c in range(a + 1 - west, b - west):
                if vertex_at[c] >= 0:
                    junctions[vertex_at[c]] = 1


@leaf
def existing_units(heights, i, row, west, units):
    """The units that exist in each cell of the strip below row i of ``heights``: bit 0, bit 1; one cell to the right
    in ``units``, whose first and last entries stay 0. Returns how many are missing."""
    missing = 0
    for j in range(heights.shape[1] - 1):
        a, b, c, d = heights[i, j], heights[i, j + 1], heights[i + 1, j], heights[i + 1, j + 1]
        whole = a + b + c + d
        if whole == whole:
            units[j + 1] = 3
            continue
        bits = 0
        if (row + west + j) & 1 == 0:
            upper, lower = a + b + d, a + c + d
        else:
            upper, lower = a + b + c, b + c + d
        if upper == upper:
            bits |= 1
        else:
            missing += 1
        if lower == lower:
            bits |= 2
        else:
            missing += 1
        units[j + 1] = bits
    return missing


@inlined
def on_surface(over, under, j, odd):
    """Whether a sample lies on a unit triangle, given those of the strips above and below its row.

    A sample with an odd sum of column and row is a corner of one unit in each of its four cells, the one on its side.
    """
    if odd:
        return ((under[j] | under[j + 1]) & 1) | ((over[j] | over[j + 1]) & 2) != 0
    return (under[j] | under[j + 1] | over[j] | over[j + 1]) != 0


@leaf
def row_codes(heights, i, row, west, matrix, lens, codes):
    """The outcodes of a row of samples (255 where missing)."""
    for j in range(heights.shape[1]):
        h = heights[i, j]
        if h != h:
            codes[j] = 255
            continue
        x, y, w = place(matrix, west + j, row, np.float64(h))
        codes[j] = outcode(lens, x, y, w)


@leaf
def unit_in_view(heights, top, west, column, row, half, matrix, lens, points, scratch):
    """Whether an existing unit triangle reaches into the frustum."""
    c0, r0, c1, r1, c2, r2 = corners(column, row, half)
    for k in range(3):
        c, r = (c0, r0) if k == 0 else ((c1, r1) if k == 1 else (c2, r2))
        points[k, 0], points[k, 1], points[k, 2] = place(matrix, c, r, np.float64(heights[r - top, c - west]))
    return polygon_in_view(lens, points, 3, scratch)


@leaf
def squared_error(matrix, lens, x, y, w, drop):
    """Squared pixels between the point at (x, y, w) and the one ``drop`` metres above it, both projected."""
    far = lens[P0] + lens[P1] * (w + matrix[2, 2] * drop)
    if far <= 0.0:
        return np.inf  # the mesh passes beside or behind the eye
    near = lens[P0] + lens[P1] * w
    dx = (x + matrix[0, 2] * drop) / far - x / near
    dy = (y + matrix[1, 2] * drop) / far - y / near
    return dx * dx + dy * dy


@inlined
def note(counts, places, what, column, row):
    """Count a finding; the first one's place is kept."""
    if counts[what] == 0:
        places[what, 0], places[what, 1] = column, row
    counts[what] += 1


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


@kernel
def ordered(triangles, members, columns, lines, vertices):
    """The members as a table of triangles (``strips``), and their planes (k, 3) float64: the height at the first corner
    and its slopes along columns and rows."""
    count = members.shape[0]
    table, planes = np.empty((count, 7), np.int64), np.empty((count, 3), np.float64)
    for k in range(count):
        t = members[k]
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        order(columns, lines, a, b, c, table, k)
        if columns[b] == table[k, C0] and lines[b] == table[k, R0]:
            a, b = b, a
        elif columns[c] == table[k, C0] and lines[c] == table[k, R0]:
            a, c = c, a
        bx, by, cx, cy = columns[b] - columns[a], lines[b] - lines[a], columns[c] - columns[a], lines[c] - lines[a]
        bz, cz = vertices[b, 2] - vertices[a, 2], vertices[c, 2] - vertices[a, 2]
        area = np.float64(bx * cy - cx * by)
        planes[k, 0] = vertices[a, 2]
        planes[k, 1], planes[k, 2] = (bz * cy - cz * by) / area, (cz * bx - bz * cx) / area
    return table, planes


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


@kernel
def sweep(
    heights, top, west, rows, band, triangles, members, vertices, columns, lines, row_start, by_row, matrix, lens,
    junctions, overlapping,
):  # fmt: skip
    """Judge a band of the terrain.

    Args:
        heights: (h, w) float32, the samples [top, top + h) × [west, west + w): the band's, those of the rows beside it,
            and of all columns that its triangles or the view reach.
        rows: of the raster. band: (first, last) row; the strips are those below each of them.
        triangles, members: the mesh, and the indices of the triangles that touch the band, from ``bucket``.
        vertices, columns, lines: (n, 3) float64; their columns and rows as int64.
        row_start, by_row: the used vertices by row.
        matrix, lens: the camera.
        junctions (n,), overlapping (m,): uint8 flags, set to 1.

    Returns:
        (counts (COUNTS,), places (COUNTS, 2), worst squared error, its column and row, sum of squared errors)
    """
    n_members, width = members.shape[0], heights.shape[1]
    table, planes = ordered(triangles, members, columns, lines, vertices)
    counts, places = np.zeros(COUNTS, np.int64), np.zeros((COUNTS, 2), np.int64)
    worst, worst_column, worst_row, total = -1.0, -1, -1, 0.0
    active, merged = np.empty(n_members, np.int64), np.empty(n_members, np.int64)
    n = 0
    head = 0
    while head < n_members and table[head, R0] < band[0]:
        if table[head, R2] > band[0]:
            active[n] = head
            n += 1
        head += 1
    if n > 0:
        middle = np.empty(n, np.float64)
        for i in range(n):
            wn, wdx, wd, _, _, _ = sides(table, active[i], band[0])
            middle[i] = (2 * wn + wdx) / (2.0 * wd)
        active[:n] = active[:n][np.argsort(middle)]
        sort_west_to_east(table, active, 0, n, band[0])
    first_from_above = 0  # those that end on the band's first row
    lowest, highest = np.full(width, np.inf), np.full(width, -np.inf)
    vertex_at, before = np.full(width, -1, np.int64), np.zeros(width + 1, np.int64)
    over, under = np.zeros(width + 1, np.uint8), np.zeros(width + 1, np.uint8)
    above, below = np.zeros(width, np.uint8), np.zeros(width, np.uint8)
    marks = np.zeros(width, np.uint8)
    points, scratch = np.empty((16, 3), np.float64), np.empty((16, 3), np.float64)
    if band[0] > 0:
        existing_units(heights, band[0] - 1 - top, band[0] - 1, west, over)
    row_codes(heights, band[0] - top, band[0], west, matrix, lens, above)
    for row in range(band[0], band[1] + 1):
        i = row - top
        missing = 0
        under[:] = 0
        if row + 1 < rows:
            missing = existing_units(heights, i, row, west, under)
            row_codes(heights, i + 1, row + 1, west, matrix, lens, below)
        # The vertices of this row.
        for v in range(row_start[row], row_start[row + 1]):
            at = columns[by_row[v]] - west
            if vertex_at[at] >= 0:
                note(counts, places, DUPLICATES, at + west, row)
            vertex_at[at] = by_row[v]
            if vertices[by_row[v], 2] != np.float64(heights[i, at]):
                note(counts, places, WRONG_HEIGHTS, at + west, row)
        for j in range(width):
            before[j + 1] = before[j] + (1 if vertex_at[j] >= 0 else 0)
        # The triangles that touch this row: those of the strip above, and those that begin here.
        new = head
        while head < n_members and table[head, R0] == row:
            head += 1
        if row == band[0]:
            while first_from_above < new:
                if table[first_from_above, R2] == row:
                    span_row(table, planes, first_from_above, row, west, lowest, highest)
                    find_junctions(table, first_from_above, row, west, vertex_at, before, junctions)
                first_from_above += 1
        for j in range(n):
            span_row(table, planes, active[j], row, west, lowest, highest)
            find_junctions(table, active[j], row, west, vertex_at, before, junctions)
        for k in range(new, head):
            span_row(table, planes, k, row, west, lowest, highest)
            find_junctions(table, k, row, west, vertex_at, before, junctions)
        # The samples of this row.
        for j in range(width):
            if above[j] == 0 and on_surface(over, under, j, (row + west + j) & 1):
                note(counts, places, SAMPLES, west + j, row)
                if not lowest[j] <= highest[j]:
                    note(counts, places, UNCOVERED, west + j, row)
                else:
                    height = np.float64(heights[i, j])
                    x, y, w = place(matrix, west + j, row, height)
                    error = squared_error(matrix, lens, x, y, w, lowest[j] - height)
                    if highest[j] != lowest[j]:
                        error = max(error, squared_error(matrix, lens, x, y, w, highest[j] - height))
                    total += error
                    if error > worst:
                        worst, worst_column, worst_row = error, west + j, row
            lowest[j], highest[j] = np.inf, -np.inf
        for v in range(row_start[row], row_start[row + 1]):
            vertex_at[columns[by_row[v]] - west] = -1
        if row + 1 >= rows:
            break
        # The strip below: drop what ended, merge what began.
        fresh = n_members - (head - new)
        for k in range(new, head):  # at the end of ``merged``, as scratch
            merged[fresh + k - new] = k
        sort_west_to_east(table, merged, fresh, n_members, row)
        kept = 0
        for j in range(n):
            if table[active[j], R2] > row:
                active[kept] = active[j]
                kept += 1
        j, f, out = 0, fresh, 0
        while j < kept or f < n_members:
            if f == n_members or (j < kept and west_of(table, active[j], merged[f], row)):
                merged[out] = active[j]
                j += 1
            else:
                merged[out] = merged[f]
                f += 1
            out += 1
        active, merged, n = merged, active, out
        sweep_strip(table, members, active, n, row, west, under, missing, above, below, marks, overlapping)
        for j in range(width - 1):
            if marks[j] == 0:
                continue
            for half in range(2):
                if marks[j] >> half & 1 and unit_in_view(
                    heights, top, west, west + j, row, half, matrix, lens, points, scratch
                ):
                    note(counts, places, HOLES, west + j, row)
                if marks[j] >> half & 4:
                    note(counts, places, BRIDGED, west + j, row)
            marks[j] = 0
        over, under = under, over
        above, below = below, above
    return counts, places, worst, worst_column, worst_row, total


@leaf
def shares_length(x0, y0, x1, y1, column, row, half):
    """(whether an edge runs through or along a unit triangle for more than a point, cross products of its corners)."""
    c0, r0, c1, r1, c2, r2 = corners(column, row, half)
    dx, dy = x1 - x0, y1 - y0
    s0, s1, s2 = dx * (r0 - y0) - dy * (c0 - x0), dx * (r1 - y0) - dy * (c1 - x0), dx * (r2 - y0) - dy * (c2 - x0)
    turned = 1 if (c1 - c0) * (r2 - r0) - (c2 - c0) * (r1 - r0) > 0 else -1
    # The part [t0, t1] of the edge inside the three sides; parameters are fractions far more than 1e-12 apart.
    t0, t1 = 0.0, 1.0
    for k in range(3):
        ac, ar, bc, br = (c0, r0, c1, r1) if k == 0 else ((c1, r1, c2, r2) if k == 1 else (c2, r2, c0, r0))
        begin = turned * ((bc - ac) * (y0 - ar) - (br - ar) * (x0 - ac))
        end = turned * ((bc - ac) * (y1 - ar) - (br - ar) * (x1 - ac))
        if begin < 0 and end < 0:
            return False, s0, s1, s2
        if begin < 0 or end < 0:
            t = begin / np.float64(begin - end)
            if begin < 0:
                t0 = max(t0, t)
            else:
                t1 = min(t1, t)
    return t1 - t0 > 1e-12, s0, s1, s2


@kernel
def look_beyond(heights, top, west, rows, cols, band, edges, members, matrix, lens, findings):
    """Find what lies just beyond open edges, in the strips of a band.

    Args:
        heights, top, west, rows, band, matrix, lens: as for ``sweep``; cols: of the raster.
        edges: (n, 5) int64: columns and rows of both ends, and the sign of (end − begin) × (p − begin) for points p
            beyond the edge.
        members: the indices of the edges that touch the band.
        findings: (n, 3) uint8 flags, set to 1: OF_MISSING, OF_HIDDEN, OF_SEEN.
    """
    points, scratch = np.empty((16, 3), np.float64), np.empty((16, 3), np.float64)
    for e in members:
        x0, y0, x1, y1, beyond = edges[e, 0], edges[e, 1], edges[e, 2], edges[e, 3], edges[e, 4]
        if y0 > y1:
            x0, y0, x1, y1, beyond = x1, y1, x0, y0, -beyond
        for row in range(max(y0 - 1, band[0]), min(y1, band[1], rows - 2) + 1):
            if y0 == y1:
                low, high = min(x0, x1), max(x0, x1)
            elif row < y0 or row >= y1:
                continue
            else:
                n, d = x0 * (y1 - y0) + (x1 - x0) * (row - y0), y1 - y0
                low, high = min(n // d, (n + x1 - x0) // d), max(ceiling(n, d), ceiling(n + x1 - x0, d))
            for column in range(max(low - 1, 0), min(high, cols - 2) + 1):
                for half in range(2):
                    shares, s0, s1, s2 = shares_length(x0, y0, x1, y1, column, row, half)
                    if not shares or max(beyond * s0, beyond * s1, beyond * s2) <= 0:
                        continue
                    c0, r0, c1, r1, c2, r2 = corners(column, row, half)
                    z = heights[r0 - top, c0 - west] + heights[r1 - top, c1 - west] + heights[r2 - top, c2 - west]
                    if z != z:
                        findings[e, OF_MISSING] = 1
                    elif unit_in_view(heights, top, west, column, row, half, matrix, lens, points, scratch):
                        findings[e, OF_SEEN] = 1
                    else:
                        findings[e, OF_HIDDEN] = 1
