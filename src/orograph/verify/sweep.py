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
from orograph.verify.frustum import P0, P1, place
from orograph.verify.gaps import sweep_strip
from orograph.verify.ground import existing_units, on_surface, row_codes, unit_in_view
from orograph.verify.spans import find_junctions, ordered, sort_west_to_east, span_row, west_of
from orograph.verify.strips import R0, R2, sides

SAMPLES, UNCOVERED, HOLES, BRIDGED, DUPLICATES, WRONG_HEIGHTS, COUNTS = range(7)
"""What a band counts."""


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
