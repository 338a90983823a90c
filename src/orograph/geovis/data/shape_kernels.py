"""Polygons and lines as coverage of texels. Positions are in texels, x along the columns, texel (i, j) being the square
from (j, i) to (j + 1, i + 1)."""

from __future__ import annotations

import numpy as np

from orograph._numba import kernel

LINES = 4
"""Rows of samples in a texel, along which coverage by polygons is exact."""


@kernel
def fill(x, y, first, owner, which, best, total):
    """Fill polygons, one after another, by the even-odd rule.

    Args:
        x, y: (n,) of all rings, each closed. first: (rings + 1,) where each ring begins. owner: (rings,) its feature,
            in rising order.
        which: (rows, cols) the feature seen, −1 where none is. best: (rows, cols) how much of a texel that one covers.
        total: (rows, cols) how much of it all cover: what lies later lies above, and neighbours leave no seam.
    """
    rows, cols = which.shape
    ring, rings = 0, len(owner)
    while ring < rings:
        last = ring
        while last < rings and owner[last] == owner[ring]:
            last += 1
        low, high = np.inf, -np.inf
        for n in range(first[ring], first[last]):
            low, high = min(low, y[n]), max(high, y[n])
        row0, row1 = max(0, int(np.floor(low))), min(rows, int(np.floor(high)) + 1)
        if row1 > row0:
            counts = np.zeros((row1 - row0) * LINES + 1, np.int64)
            crossings = np.empty(0)
            for turn in range(2):  # count, then keep
                if turn == 1:
                    counts = np.cumsum(counts)
                    crossings = np.empty(counts[-1])
                    place = counts[:-1].copy()
                for k in range(ring, last):
                    for n in range(first[k], first[k + 1] - 1):
                        xa, ya, xb, yb = x[n], y[n], x[n + 1], y[n + 1]
                        if ya > yb:
                            xa, ya, xb, yb = xb, yb, xa, ya
                        # Lines at row0 + (s + 1/2) / LINES with ya <= line < yb.
                        s0 = max(0, int(np.ceil((ya - row0) * LINES - 0.5)))
                        s1 = min(len(counts) - 1, int(np.ceil((yb - row0) * LINES - 0.5)))
                        for s in range(s0, s1):
                            if turn == 0:
                                counts[s + 1] += 1
                            else:
                                line = row0 + (s + 0.5) / LINES
                                crossings[place[s]] = xa + (xb - xa) * (line - ya) / (yb - ya)
                                place[s] += 1
            covered = np.zeros(cols)
            for row in range(row0, row1):
                left, right = cols, -1
                for s in range((row - row0) * LINES, (row - row0 + 1) * LINES):
                    ends = np.sort(crossings[counts[s] : counts[s + 1]])
                    for k in range(0, len(ends) - 1, 2):
                        a, b = max(ends[k], 0.0), min(ends[k + 1], float(cols))
                        if b <= a:
                            continue
                        c0, c1 = int(a), min(int(b), cols - 1)
                        left, right = min(left, c0), max(right, c1)
                        for c in range(c0, c1 + 1):
                            covered[c] += (min(b, c + 1.0) - max(a, float(c))) / LINES
                for c in range(left, right + 1):
                    part = min(covered[c], 1.0)
                    covered[c] = 0.0
                    if part <= 0.0:
                        continue
                    total[row, c] = min(total[row, c], 1.0 - part) + part
                    if part >= 0.5 or part > best[row, c]:
                        which[row, c], best[row, c] = owner[ring], part
        ring = last


@kernel
def stroke(x, y, first, owner, half, tall, which, cover):
    """Draw lines, one after another.

    Args:
        x, y, first, owner, which: as of ``fill``. half: half their width, texels along a row. tall: height of a texel
            by its width. cover: (rows, cols) how much of a texel they cover.
    """
    rows, cols = which.shape
    for k in range(len(owner)):
        for n in range(first[k], first[k + 1] - 1):
            xa, ya, dx, dy = x[n], y[n], x[n + 1] - x[n], (y[n + 1] - y[n]) * tall
            size = dx * dx + dy * dy
            wide, high = half + 1.0, (half + 1.0) / tall
            c0, c1 = max(0, int(np.floor(min(xa, x[n + 1]) - wide))), min(cols - 1, int(max(xa, x[n + 1]) + wide))
            r0, r1 = max(0, int(np.floor(min(ya, y[n + 1]) - high))), min(rows - 1, int(max(ya, y[n + 1]) + high))
            for row in range(r0, r1 + 1):
                py = (row + 0.5 - ya) * tall
                for col in range(c0, c1 + 1):
                    px = col + 0.5 - xa
                    t = min(max((px * dx + py * dy) / size, 0.0), 1.0) if size > 0 else 0.0
                    away = np.hypot(px - t * dx, py - t * dy)
                    part = min(max(half + 0.5 - away, 0.0), 1.0)
                    if part > 0.0 and (part >= 0.5 or part > cover[row, col]):
                        which[row, col] = owner[k]
                    cover[row, col] = max(cover[row, col], part)


@kernel
def crossed(x, y, first, most):
    """Whether any two edges of rings, each closed, cross each other properly (touching does not count).

    Args:
        x, y, first: as of ``fill``, of one polygon. most: comparisons after which it is taken to be sound.
    """
    count = 0
    for k in range(len(first) - 1):
        count += first[k + 1] - first[k] - 1
    begin, k = np.empty(count, np.int64), 0
    for ring in range(len(first) - 1):
        for n in range(first[ring], first[ring + 1] - 1):
            begin[k] = n
            k += 1
    left = np.empty(count)
    for k in range(count):
        left[k] = min(x[begin[k]], x[begin[k] + 1])
    order, done = np.argsort(left), 0
    for i in range(count):
        n = begin[order[i]]
        right = max(x[n], x[n + 1])
        for j in range(i + 1, count):
            m = begin[order[j]]
            if left[order[j]] > right:
                break
            done += 1
            if done > most:
                return False
            a = (x[n + 1] - x[n]) * (y[m] - y[n]) - (y[n + 1] - y[n]) * (x[m] - x[n])
            b = (x[n + 1] - x[n]) * (y[m + 1] - y[n]) - (y[n + 1] - y[n]) * (x[m + 1] - x[n])
            c = (x[m + 1] - x[m]) * (y[n] - y[m]) - (y[m + 1] - y[m]) * (x[n] - x[m])
            d = (x[m + 1] - x[m]) * (y[n + 1] - y[m]) - (y[m + 1] - y[m]) * (x[n + 1] - x[m])
            if a * b < 0 and c * d < 0:
                return True
    return False
