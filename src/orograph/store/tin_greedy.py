"""Choosing the vertices of a diamond's TINs: greedy insertion (Garland & Heckbert 1995, algorithm III).

The vertices on the legs are given and stay; those on the hypotenuse lie on it. Then the sample with the largest error
becomes a vertex, until the requested number of triangles is reached. After an insertion, only the triangles around the
new vertex are examined again. A tournament tree of the triangles has the largest error at its root. The vertices have
only one triangulation (``mesh``), so the TINs are what ``triangulate`` makes of the marks, and their error is
measured at once. Heights are metres; columns and rows are samples from the window's first.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf
from orograph.store.tin_kernels import start_cut, start_whole
from orograph.store.tin_windows import Window, across, is_whole, legs_of, place
from orograph.triangulation.deviation import FUZZ, worst_between, worst_sample
from orograph.triangulation.mesh import TRIANGLES, VERTICES, after, before, insert, turn_of


@leaf
def find_candidates(w, heights, candidates):
    """The heights of the samples of a window that may become vertices, NaN for others."""
    rows, cols = heights.shape
    for i in range(rows):
        y = place(i, w.step, w.height)
        away = abs(y - w.cy)
        reach = w.s - 1 - away if w.shape == 1 else w.s - 1 if away < w.s else -1
        for j in range(cols):
            x = place(j, w.step, w.width)
            candidates[i, j] = heights[i, j] if abs(x - w.cx) <= reach else np.float32(np.nan)
        if w.sparse > 1:
            for j in range(cols):
                thinned = (w.first_i + i) % w.sparse or (w.first_j + j) % w.sparse
                if thinned and across(w, place(j, w.step, w.width), y, 1) == 0:
                    candidates[i, j] = np.float32(np.nan)


@inlined
def worst(w, shift, least, m, candidates, t):
    """The candidate with the largest error in a triangle: error, row and column.

    Args:
        shift: log2 of the lattice's step. least: twice the area of a triangle without samples besides its corners.
    """
    a, b, c = m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2]
    if m.y[b] < m.y[a] and m.y[b] <= m.y[c]:
        a, b, c = b, c, a
    elif m.y[c] < m.y[a]:
        a, b, c = c, a, b
    x0, y0, x1, y1 = np.int64(m.x[a]), np.int64(m.y[a]), np.int64(m.x[b]), np.int64(m.y[b])
    x2, y2 = np.int64(m.x[c]), np.int64(m.y[c])
    largest, at_i, at_j = 0.0, np.int64(-1), np.int64(-1)
    det = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    if det <= least:
        return largest, at_i, at_j
    if det == 2 * least and least == 1 and shift == 0:  # one sample, in the middle of a side (Pick's theorem)
        if not ((x0 ^ x1) | (y0 ^ y1)) & 1:
            at_i, at_j, z = (y0 + y1) >> 1, (x0 + x1) >> 1, m.z[a] + m.z[b]
        elif not ((x1 ^ x2) | (y1 ^ y2)) & 1:
            at_i, at_j, z = (y1 + y2) >> 1, (x1 + x2) >> 1, m.z[b] + m.z[c]
        else:
            at_i, at_j, z = (y2 + y0) >> 1, (x2 + x0) >> 1, m.z[c] + m.z[a]
        off = abs(0.5 * z - candidates[at_i, at_j])
        return (off if off > 0.0 else 0.0), at_i, at_j
    (rows, cols), one = candidates.shape, np.int64(1)
    z0, part = m.z[a], 1.0 / det
    z1, z2 = m.z[b] - z0, m.z[c] - z0
    right = (z1 * (y2 - y0) - z2 * (y1 - y0)) * part
    down = (z2 * (x1 - x0) - z1 * (x2 - x0)) * part
    # sides as columns by rows: from a down to c on the left, to b on the right; below the upper of b and c, from b to c
    left_x, left_y, left = np.float64(x0), y0, (x2 - x0) / max(y2 - y0, one)
    right_x, right_y, slope = np.float64(x0), y0, (x1 - x0) / max(y1 - y0, one)
    turn, last = min(y1, y2), max(y1, y2) - (y1 != y2)  # a lone corner is left out
    i = (y0 + (turn > y0) + w.step - 1) >> shift
    while i < rows:
        y = min(i << shift, w.height)
        if y > last:
            break
        if y >= turn:
            turn = w.height + 1
            if y1 <= y2:
                right_x, right_y, slope = np.float64(x1), y1, (x2 - x1) / max(y2 - y1, one)
            else:
                left_x, left_y, left = np.float64(x2), y2, (x1 - x2) / (y1 - y2)
        low = left_x + left * (y - left_y)
        high = np.int64(right_x + slope * (y - right_y) + FUZZ)
        plane = z0 + down * (y - y0) - right * x0
        j = min((np.int64(low + (1.0 - FUZZ)) + w.step - 1) >> shift, cols - 1)
        end = high >> shift if high < w.width else cols - 1
        while j <= end:
            off = abs(plane + right * min(j << shift, w.width) - candidates[i, j])
            if off > largest:
                largest, at_i, at_j = off, i, j
            j += 1
        i += 1
    return largest, at_i, at_j


@leaf
def look_at(w, shift, least, work, candidates, count, leaves):
    """Find the worst candidate of each triangle in ``work.star``, and update the tournament where it has changed."""
    for k in range(count):
        t = work.star[k]
        off, i, j = worst(w, shift, least, work.mesh, candidates, t)
        work.sample[t] = i * candidates.shape[1] + j
        at = leaves + t
        work.errors[at] = off
        while at > 1:
            larger = max(work.errors[at], work.errors[at ^ 1])
            at >>= 1
            if work.errors[at] == larger:
                break
            work.errors[at] = larger


@inlined
def winner(work, leaves):
    """The triangle with the worst candidate; the first one of several."""
    at = np.int64(1)
    while at < leaves:
        at *= 2
        if work.errors[at] < work.errors[at + 1]:
            at += 1
    return at - leaves


@leaf
def find_star(work, v):
    """Put the triangles in patches around a vertex into ``work.star``; return their number."""
    m, count = work.mesh, 0
    h = np.int64(m.out[v])
    while True:
        if m.live[h // 3]:
            work.star[count] = h // 3
            count += 1
        h = np.int64(m.twin[before(h)])
        if h == m.out[v]:
            return count
        if h < 0:
            break
    h = np.int64(m.twin[m.out[v]])  # for a vertex on the outline: the other way, too
    while h >= 0:
        if m.live[h // 3]:
            work.star[count] = h // 3
            count += 1
        h = np.int64(m.twin[after(h)])
    return count


@kernel
def simplify(w, work, heights, ends, marks, wanted, limit):
    """Mark more samples until the requested number of triangles is reached, or all samples are within the limit.

    Args:
        w, work, heights, ends: as ``triangulate``. marks: uint8, the vertices on the legs; more are set here.
        wanted: triangles of a diamond that lies wholly on the raster. limit: metres.

    Returns: the number of triangles, −1 on failure; and the largest deviation at candidates.
    """
    rows, cols = heights.shape
    m, candidates = work.mesh, work.candidates[:rows, :cols]
    find_candidates(w, heights, candidates)
    whole = is_whole(w)
    if whole:
        start_whole(w, work, heights, marks)
    elif not start_cut(w, work, heights, ends, marks):
        return -1, 0.0
    count, area = np.int64(0), np.int64(0)
    for t in range(m.counts[TRIANGLES]):
        if m.live[t]:
            work.star[count] = t
            count += 1
            area += turn_of(m, m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2])
    wanted = np.int64(np.ceil(wanted * (area / ((8 if w.shape == 0 else 4) * w.s * w.s))))
    shift = np.int64(0)
    while (1 << shift) < w.step:
        shift += 1
    least = w.step * w.step if whole else 1
    leaves = 1
    while leaves < m.counts[TRIANGLES] + max(wanted - count, 0) + 2:
        leaves *= 2
    work.errors[: 2 * leaves] = 0.0
    look_at(w, shift, least, work, candidates, count, leaves)
    while count < wanted and work.errors[1] > limit and m.counts[VERTICES] + 4 < len(m.x):
        t = winner(work, leaves)
        i, j = work.sample[t] // cols, work.sample[t] % cols
        slots = m.counts[TRIANGLES]
        v = insert(m, t, place(j, w.step, w.width), place(i, w.step, w.height), np.float64(heights[i, j]), work.stack)
        marks[i, j], candidates[i, j] = 1, np.float32(np.nan)
        count += m.counts[TRIANGLES] - slots
        look_at(w, shift, least, work, candidates, find_star(work, v), leaves)
    return count, work.errors[1]


@leaf
def along(m, heights, h):
    """The largest deviation on an edge, except at its ends."""
    a, b = m.corner[h], m.corner[after(h)]
    x, y, dx, dy = np.int64(m.x[a]), np.int64(m.y[a]), np.int64(m.x[b] - m.x[a]), np.int64(m.y[b] - m.y[a])
    long = max(abs(dx), abs(dy))
    if long == 1 and (dx == 0 or dy == 0 or (x + y) & 1 == 0):  # an edge of the surface itself
        return 0.0
    largest, z, dz = 0.0, m.z[a], m.z[b] - m.z[a]
    if dx == 0 or dy == 0 or abs(dx) == abs(dy):
        step_x, step_y = dx // long, dy // long
        for k in range(1, long):
            largest = max(largest, abs(z + k * dz / long - heights[y + k * step_y, x + k * step_x]))
    return max(largest, worst_between(heights, x, y, dx, dy, z, dz)[0])


@kernel
def deviation(m, heights, known):
    """The largest deviation of the patches from the surface: at samples, and where edges cross the surface's edges.

    Args:
        heights: float32 of all samples of the window, row by row. known: the largest deviation at samples between the
            edges of the hierarchy; negative: not known.
    """
    largest = known
    for t in range(m.counts[TRIANGLES]):
        if m.live[t]:
            if known < 0:
                off = worst_sample(heights, m, m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2])[0]
                largest = max(largest, off)
            for k in range(3):
                h = 3 * t + k
                if m.twin[h] < h or not m.live[m.twin[h] // 3]:
                    largest = max(largest, along(m, heights, h))
    return largest


@kernel
def sizes(m):
    """The number of triangles of both patches, and of full resolution in their place."""
    first, second, area = 0, 0, np.int64(0)
    for t in range(m.counts[TRIANGLES]):
        if m.live[t]:
            first += m.live[t] == 1
            second += m.live[t] == 2
            area += turn_of(m, m.corner[3 * t], m.corner[3 * t + 1], m.corner[3 * t + 2])
    return first, second, area


@inlined
def beside(w, axis, first_i, first_j):
    """The window of another uncut diamond of the level."""
    return Window(w.cx, w.cy, w.s, w.shape, axis, w.width, w.height, w.step, w.sparse, first_i, first_j)


@kernel
def make_row(w, work, first_j, axes, heights, given, bit, wanted, limit):
    """Make the TINs of some uncut diamonds of a row, on the lattice of all samples.

    Args:
        w: ``Window`` of the first one. first_j, axes: (d,) int64, as in ``Window``, of all.
        heights, given: (rows, cols) float32 and uint8, of the samples from the first one's window to the last one's:
            heights, and the marks below, of which ``bit`` marks those on legs (0: all). wanted, limit: as ``simplify``.

    Returns: (d, 6) float64, as ``tin_diamonds.NUMBERS``, the error before rounding; (d, bytes) uint8, which samples are
        vertices, as bits.
    """
    count, rows, cols = len(first_j), w.height + 1, w.width + 1
    numbers, chosen = np.zeros((count, 6)), np.zeros((count, (rows * cols + 7) // 8), np.uint8)
    own, marks = np.empty((rows, cols), np.float32), np.empty((rows, cols), np.uint8)
    ends = np.empty((5, 2), np.float32)  # of cut edges: there are none
    for d in range(count):
        at = first_j[d] - first_j[0]
        for i in range(rows):
            for j in range(cols):
                own[i, j], marks[i, j] = heights[i, at + j], 0
        legs_of(beside(w, axes[d], 0, at), given, 1, bit, marks)
        for i in range(rows):
            for j in range(cols):
                numbers[d, 3] += marks[i, j]
        known = simplify(beside(w, axes[d], w.first_i, first_j[d]), work, own, ends, marks, wanted, limit)[1]
        numbers[d, 0] = deviation(work.mesh, own, known)
        numbers[d, 1], numbers[d, 2], numbers[d, 5] = sizes(work.mesh)
        for i in range(rows):
            for j in range(cols):
                if marks[i, j]:
                    k = i * cols + j
                    chosen[d, k >> 3] |= np.uint8(128 >> (k & 7))
                    numbers[d, 4] += 1
    return numbers, chosen


@kernel
def put_marks(marks, windows, chosen, bit):
    """Set a bit where samples of windows are vertices; windows: (d, 4) rows and columns, half-open; ``Made.chosen``."""
    begin = 0
    for d in range(len(windows)):
        i0, i1, j0, j1 = windows[d]
        cols = j1 - j0
        count = (i1 - i0) * cols
        for k in range((count + 7) // 8):
            byte = chosen[begin + k]
            if byte:
                for b in range(8):
                    if byte & (128 >> b):
                        marks[i0 + (8 * k + b) // cols, j0 + (8 * k + b) % cols] |= bit
        begin += (count + 7) // 8
