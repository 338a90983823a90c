"""Nested spheres of the diamonds of one octave: around the corners of the region and the children's spheres.

After Lindstrom & Pascucci 2001, sec. 3.2, except that a finest sphere has the corners of its region inside, so that
whatever is drawn of the region, fine or coarse, lies within (frustum culling relies on it). Since an octave's vertices
are a constant step apart, inside the raster only differences of height vary.

Arrays are windows of an octave as in ``octaves``. Metres; float64 within, rounded up to float32.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf, linked
from orograph.error.holes import MIXED, RUN, WHOLE
from orograph.error.octaves import inner


@inlined
def _rounded(radius):
    """float32, more than the float64 ``radius`` and its own rounding errors."""
    return np.float32(radius * (1.0 + 2.0**-22))


@inlined
def _around(level_distance, dz, nested):
    """Radius around a point that is ``level_distance`` away in the plane and ``dz`` in height, with its own radius."""
    return np.sqrt(level_distance * level_distance + dz * dz) + nested


@inlined
def _apart(m, a, b):
    """The larger difference of height between m and a or b."""
    return max(abs(m - np.float64(a)), abs(m - np.float64(b)))


@leaf
def _reach(z, radii, nested, i, j, row, col, rows, cols, metric, centre):
    """Distance from a diamond's ``centre``, (row, column, height), to the vertex (i, j), plus that one's radius if
    ``nested``."""
    if i < 0 or j < 0 or (nested and (i >= z.shape[0] or j >= z.shape[1])):
        return 0.0
    my, mx, height = centre
    y = min(row, rows - 1) - my
    x = min(col, cols - 1) - mx
    easting = metric[0, 0] * x + metric[0, 1] * y
    northing = metric[1, 0] * x + metric[1, 1] * y
    dz = z[min(i, z.shape[0] - 1), min(j, z.shape[1] - 1)] - height
    r = np.sqrt(easting * easting + northing * northing + dz * dz)
    return r + radii[i, j] if nested else r


@leaf
def _on_rim(z, fine, below, row0, col0, k, rows, cols, metric, radii, i, j):
    """The radius of any diamond, squeezed or not."""
    s = np.int64(1) << k
    h = s >> 1
    row, col = row0 + i * s, col0 + j * s
    my, mx = min(row, rows - 1), min(col, cols - 1)
    centre = my, mx, np.float64(z[i, j])
    square = i & j & 1
    r = 0.0
    for side in range(4):
        di = (side == 1) - (side == 0)
        dj = (side == 3) - (side == 2)
        # On the sides: children of a square diamond, corners of an edge one.
        y, x = row + di * s, col + dj * s
        r = max(r, _reach(z, radii, square, i + di, j + dj, y, x, rows, cols, metric, centre))
        di, dj = di - dj, di + dj
        # On the diagonals: corners of a square diamond, children of an edge one.
        if square:
            y, x = row + di * s, col + dj * s
            r = max(r, _reach(z, radii, 0, i + di, j + dj, y, x, rows, cols, metric, centre))
        elif k:
            y, x = row + di * h, col + dj * h
            r = max(r, _reach(fine, below, 1, 2 * i + di, 2 * j + dj, y, x, rows, cols, metric, centre))
    return r


@linked
def _rim(z, fine, below, row0, col0, k, rows, cols, metric, radii, squares):
    """The rim's edge diamonds, or its square ones."""
    height, width = radii.shape
    i_end, j_end = inner(row0, k, rows, height), inner(col0, k, cols, width)
    for i in range(squares, height, 1 + squares):
        whole_row = i == 0 or i >= i_end
        for j in range(1 if squares else 1 - (i & 1), width, 2):
            if whole_row or j == 0 or j >= j_end:
                r = _on_rim(z, fine, below, row0, col0, k, rows, cols, metric, radii, i, j)
                radii[i, j] = _rounded(r)


@inlined
def _edge(m, west, east, north, south, across, down):
    """Radius around the corners of an edge diamond, which lie in its row and in its column."""
    x = _apart(m, west, east)
    y = _apart(m, north, south)
    return np.sqrt(max(across * across + x * x, down * down + y * y))


@linked
def _edges(z, i, j_end, across, down, r):
    """The finest edge diamonds of a row: the corners of their regions."""
    north, here, south = z[i - 1], z[i], z[i + 1]
    odd = np.uint64(1 - (i & 1))
    # All entries of the row, square diamonds found later too: the compiler makes vectors of what is without gaps.
    for u in range(np.uint64(j_end - 1)):
        j, east = u + np.uint64(1), u + np.uint64(2)
        m = np.float64(here[j])
        found = _rounded(_edge(m, here[u], here[east], north[j], south[j], across, down))
        r[j] = found if j & np.uint64(1) == odd else np.float32(0.0)


@linked
def _edges_and_children(z, fine, below, i, j_end, across, down, falling, rising, r):
    """The edge diamonds of a row: the corners of their regions and the square diamonds of the octave below."""
    first = 1 + (i & 1)
    north, here, south = z[i - 1], z[i], z[i + 1]
    upper, lower, r_upper, r_lower = fine[2 * i - 1], fine[2 * i + 1], below[2 * i - 1], below[2 * i + 1]
    for u in range((j_end - first + 1) >> 1):
        j = 2 * u + first
        x = 2 * j
        m = np.float64(here[j])
        a = _around(0.5 * falling, upper[x - 1] - m, r_upper[x - 1])
        b = _around(0.5 * rising, upper[x + 1] - m, r_upper[x + 1])
        c = _around(0.5 * rising, lower[x - 1] - m, r_lower[x - 1])
        d = _around(0.5 * falling, lower[x + 1] - m, r_lower[x + 1])
        e = _edge(m, here[j - 1], here[j + 1], north[j], south[j], across, down)
        r[j] = _rounded(max(e, max(max(a, b), max(c, d))))
        r[j + 1] = 0.0


@linked
def _squares(z, radii, i, j_end, across, down, falling, rising, found):
    """The square diamonds of a row: the corners of their regions and the edge diamonds on their sides."""
    north, here, south = z[i - 1], z[i], z[i + 1]
    r_north, r_here, r_south = radii[i - 1], radii[i], radii[i + 1]
    for u in range(j_end >> 1):
        j = 2 * u + 1
        m = np.float64(here[j])
        a = _around(down, north[j] - m, r_north[j])
        b = _around(down, south[j] - m, r_south[j])
        c = _around(across, here[j - 1] - m, r_here[j - 1])
        d = _around(across, here[j + 1] - m, r_here[j + 1])
        f = _apart(m, north[j - 1], south[j + 1])
        g = _apart(m, north[j + 1], south[j - 1])
        e = np.sqrt(max(falling * falling + f * f, rising * rising + g * g))
        found[u] = _rounded(max(e, max(max(a, b), max(c, d))))
    for u in range(j_end >> 1):
        r_here[2 * u + 1] = found[u]


@inlined
def _steps(metric, k):
    """Distances in the plane between neighbours of octave k: in a row, in a column, along either diagonal."""
    s = np.float64(np.int64(1) << k)
    across = s * np.hypot(metric[0, 0], metric[1, 0])
    down = s * np.hypot(metric[0, 1], metric[1, 1])
    falling = s * np.hypot(metric[0, 0] + metric[0, 1], metric[1, 0] + metric[1, 1])
    rising = s * np.hypot(metric[0, 0] - metric[0, 1], metric[1, 0] - metric[1, 1])
    return across, down, falling, rising


@kernel
def edge_spheres(z, fine, below, row0, col0, k, rows, cols, metric, radii):
    """Radii of the nested spheres of an octave's edge diamonds.

    Args:
        z, fine: heights without gaps at the spacings of octave k and k − 1, windows that begin at the same sample.
        below: float32, radii of the octave below (``fine``'s shape; nothing for k = 0).
        rows, cols: of the raster. metric: float64 (2, 2), metres of easting and northing per column and row.
        radii: float32 with z's shape, the result; other entries become 0.
    """
    height, width = radii.shape
    i_end, j_end = inner(row0, k, rows, height), inner(col0, k, cols, width)
    across, down, falling, rising = _steps(metric, k)
    radii[:] = 0
    for i in range(1, i_end):
        if k:
            _edges_and_children(z, fine, below, i, j_end, across, down, falling, rising, radii[i])
        else:
            _edges(z, i, j_end, across, down, radii[i])
    _rim(z, fine, below, row0, col0, k, rows, cols, metric, radii, 0)


@kernel
def square_spheres(z, row0, col0, k, rows, cols, metric, radii):
    """Radii of the nested spheres of an octave's square diamonds, around those that ``edge_spheres`` has found."""
    height, width = radii.shape
    i_end, j_end = inner(row0, k, rows, height), inner(col0, k, cols, width)
    across, down, falling, rising = _steps(metric, k)
    row = np.empty(width, np.float32)
    for i in range(1, i_end, 2):
        _squares(z, radii, i, j_end, across, down, falling, rising, row)
    _rim(z, z, radii, row0, col0, k, rows, cols, metric, radii, 1)


@kernel
def fill(z, row0, col0, k, rows, cols, lowest, filled):
    """Heights without gaps: missing ones replaced by the lowest of their tile of 256 cells.

    Args:
        z: heights of octave k, a window; row0, col0, rows, cols: as in ``edge_spheres``.
        lowest: float32 (tile rows, tile cols). filled: float32 with z's shape, the result.
    """
    height, width = z.shape
    for i in range(height):
        here, found = z[i], filled[i]
        missing = 0
        for j in range(np.uint64(width)):
            found[j] = here[j]
            missing += here[j] != here[j]
        if missing:
            tiles = lowest[min(min(row0 + (i << k), rows - 1) >> 8, lowest.shape[0] - 1)]
            for j in range(width):
                if here[j] != here[j]:
                    found[j] = tiles[min(min(col0 + (j << k), cols - 1) >> 8, lowest.shape[1] - 1)]


@kernel
def tell_empty(found, seen, none, radii):
    """Make the radii of a window's empty diamonds negative (``none`` instead of 0); arguments as of ``holes.mark``."""
    for i in range(len(found)):
        state, r = found[i], radii[i]
        for run in range(seen.shape[1] - 2):
            if seen[i, run + 1]:
                for j in range(run * RUN, min(run * RUN + RUN, len(r))):
                    if state[j] != WHOLE and state[j] != MIXED:
                        r[j] = min(-r[j], none)
