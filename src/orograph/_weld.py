"""Weld corners to vertices: triangles name their corners by grid position; each position becomes one vertex, at the
speed of reading the corners.

Positions are int64 keys ``row << 32 | col`` of the padded square of 2^n + 1 samples, squeezed onto the raster on the
way: (min(row, rows − 1), min(col, cols − 1)). Squeezing is monotone along both axes, so no triangle flips; triangles
beyond the raster lose their area and are dropped. Vertices are found again in a hash table with open addressing and
linear probing (Knuth, *The Art of Computer Programming*, vol. 3, §6.4), half empty, multiplicative (Fibonacci) hashing;
key and index lie side by side, so that a corner costs one cache line. Heights are metres.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, linked

FIBONACCI = np.uint64(0x9E3779B97F4A7C15)
EMPTY = np.int64(-1)
LOW = np.int64(0xFFFFFFFF)


@inlined
def squeeze(key, last_row, last_col):
    """The key of the sample that a vertex of the padded square is squeezed onto."""
    return (min(key >> 32, last_row) << 32) | min(key & LOW, last_col)


@inlined
def doubled_area(a, b, c):
    """Twice the signed area of a triangle of keys in (col, row), exact: positive if clockwise with rows downwards."""
    ar, ac = a >> 32, a & LOW
    return ((b & LOW) - ac) * ((c >> 32) - ar) - ((c & LOW) - ac) * ((b >> 32) - ar)


@inlined
def slot_of(table, shift, key):
    """The slot of ``key`` in the table, or the empty slot where it belongs."""
    mask = table.shape[0] - 1
    slot = np.int64((np.uint64(key) * FIBONACCI) >> shift)
    while table[slot, 0] != EMPTY and table[slot, 0] != key:
        slot = (slot + 1) & mask
    return slot


@linked
def doubled_table(table, shift):
    """The table with twice the room, and its shift."""
    size = 2 * table.shape[0]
    larger = np.empty((size, 2), np.int64)
    larger[:, 0] = EMPTY
    shift -= np.uint64(1)
    for i in range(table.shape[0]):
        key = table[i, 0]
        if key != EMPTY:
            slot = slot_of(larger, shift, key)
            larger[slot, 0] = key
            larger[slot, 1] = table[i, 1]
    return larger, shift


@linked
def new_table(expected):
    """An empty table with room for ``expected`` vertices, and its shift."""
    bits = 10
    while (1 << bits) < 2 * expected:
        bits += 1
    table = np.empty((1 << bits, 2), np.int64)
    table[:, 0] = EMPTY
    return table, np.uint64(64 - bits)


@linked
def longer(vertices, n, size):
    """The first ``n`` vertices in an array of ``size``, copied one by one: slices take seconds to compile."""
    larger = np.empty((size, 3), np.float64)
    for i in range(n):
        for axis in range(3):
            larger[i, axis] = vertices[i, axis]
    return larger


@kernel
def weld_triangles(keys, heights, rows, cols, flip):
    """Triangles (m, 3) of keys with a height for every corner → (vertices (n, 3) float64, triangles (t, 3) int32).

    Those without area are left out; ``flip`` turns the others over.
    """
    last_row, last_col = np.int64(rows - 1), np.int64(cols - 1)
    table, shift = new_table(keys.shape[0] // 2 + 16)
    vertices = np.empty((table.shape[0] // 2, 3), np.float64)
    triangles = np.empty((keys.shape[0], 3), np.int32)
    first, second, third = 0, (2 if flip else 1), (1 if flip else 2)
    n, t = 0, 0
    for i in range(keys.shape[0]):
        a = squeeze(keys[i, 0], last_row, last_col)
        b = squeeze(keys[i, 1], last_row, last_col)
        c = squeeze(keys[i, 2], last_row, last_col)
        if doubled_area(a, b, c) == 0:
            continue
        if n + 3 > vertices.shape[0]:
            table, shift = doubled_table(table, shift)
            vertices = longer(vertices, n, table.shape[0] // 2)
        for corner in range(3):
            key = a if corner == 0 else (b if corner == 1 else c)
            slot = slot_of(table, shift, key)
            if table[slot, 0] == EMPTY:
                table[slot, 0] = key
                table[slot, 1] = n
                vertices[n, 0], vertices[n, 1], vertices[n, 2] = key & LOW, key >> 32, heights[i, corner]
                n += 1
            place = first if corner == 0 else (second if corner == 1 else third)
            triangles[t, place] = table[slot, 1]
        t += 1
    return vertices[:n].copy(), triangles[:t].copy()


@kernel
def weld_strip(keys, heights, rows, cols, flip):
    """A generalised strip (k,) of keys → (vertices (n, 3), strip (k or k + 1,) int32, its triangles (t, 3) int32).

    Triangle i of a strip joins its vertices i, i + 1, i + 2 and every second one is turned over; a strip is turned over
    as a whole (``flip``) by repeating its first vertex.
    """
    last_row, last_col = np.int64(rows - 1), np.int64(cols - 1)
    table, shift = new_table(keys.shape[0] // 4 + 16)
    vertices = np.empty((table.shape[0] // 2, 3), np.float64)
    lead = 1 if flip and keys.shape[0] > 0 else 0
    strip = np.empty(keys.shape[0] + lead, np.int32)
    triangles = np.empty((max(keys.shape[0] - 2, 0), 3), np.int32)
    n, t = 0, 0
    a, b = np.int64(0), np.int64(0)
    for i in range(keys.shape[0]):
        if n + 1 > vertices.shape[0]:
            table, shift = doubled_table(table, shift)
            vertices = longer(vertices, n, table.shape[0] // 2)
        c = squeeze(keys[i], last_row, last_col)
        slot = slot_of(table, shift, c)
        if table[slot, 0] == EMPTY:
            table[slot, 0] = c
            table[slot, 1] = n
            vertices[n, 0], vertices[n, 1], vertices[n, 2] = c & LOW, c >> 32, heights[i]
            n += 1
        strip[i + lead] = table[slot, 1]
        if i >= 2 and doubled_area(a, b, c) != 0:
            odd = (i + lead) & 1
            triangles[t, 0] = strip[i + lead - 2]
            triangles[t, 1 + odd] = strip[i + lead - 1]
            triangles[t, 2 - odd] = strip[i + lead]
            t += 1
        a, b = b, c
    if lead:
        strip[0] = strip[1]
    return vertices[:n].copy(), strip, triangles[:t].copy()
