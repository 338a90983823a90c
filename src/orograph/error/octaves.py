"""Errors and radii of the diamonds of one octave, from the heights at its spacing and the octave below.

An octave holds the diamonds whose vertex is a multiple of s = 2^k samples and of no more: the *square* ones (row/s and
col/s odd) and the *edge* ones (exactly one odd). Arrays are windows of level k: entry (i, j) belongs to sample
(row0 + i·s, col0 + j·s). The children of a square diamond are the edge diamonds on its four sides, those of an edge
diamond the square diamonds of the octave below around it: within an octave edges come first, and the octave below is
complete before.

* ``midpoint``: height of the vertex above the middle of the hypotenuse (Lindstrom & Pascucci 2001, Blow 2000).
* ``wedgie``: the nested sum of Duchaineau et al. 1997, sec. 6: of each top triangle, its own local error plus the
  larger of its two children's sums; a diamond has the larger of its two triangles'.
* ``exact``: the largest deviation of any full-resolution sample (``deviation``).

All are then made monotonic: no less than the children's (``close``). Neighbours beyond the window are treated as
absent, as beyond the square's border; whoever works on a part gives it a margin and drops it afterwards.

Heights and errors in metres; arithmetic in float64; results are rounded up to float32.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel, leaf
from orograph.error.deviation import edge_across, edge_along, split_distance, square, triangle

MIDPOINT, WEDGIE, EXACT = 0, 1, 2


@inlined
def round_up(value):
    """float32, not less than the float64 ``value`` ≥ 0."""
    return np.float32(value * (1.0 + 2.0**-23))


@inlined
def is_falling(row, col, s):
    """Whether the square diamond at (row, col) is cut from north-west to south-east."""
    return ((row - s) // (2 * s) + (col - s) // (2 * s)) & 1 == 0


@leaf
def _corner(z, i, j, di, dj):
    """Height of a neighbour: NaN before the window, the last one beyond its end (there the border squeezes)."""
    y = i + di
    x = j + dj
    if y < 0 or x < 0:
        return np.nan
    return np.float64(z[min(y, z.shape[0] - 1), min(x, z.shape[1] - 1)])


@leaf
def _squeezed(fine, fine_row, fine_col, z, i, j, row, col, s, rows, cols, across, falling, kind):
    """The local error (MIDPOINT, WEDGIE) or deviation (EXACT) of a diamond that straddles the raster's border.

    Args:
        fine, fine_row, fine_col: the full-resolution window and its first sample (used for EXACT).
        z: heights at this octave's spacing; (i, j) the diamond's entry, (row, col) its sample, s its spacing.
        rows, cols: of the raster.
        across: 1 for an edge diamond with its hypotenuse along the row, 0 along the column, 2 for a square one.
        falling: how a square one is cut.
    """
    # a, b: ends of the hypotenuse; p, q: apexes.
    if across == 1:
        ai, aj, bi, bj, pi, pj, qi, qj = 0, -1, 0, 1, -1, 0, 1, 0
    elif across == 0:
        ai, aj, bi, bj, pi, pj, qi, qj = -1, 0, 1, 0, 0, -1, 0, 1
    elif falling:
        ai, aj, bi, bj, pi, pj, qi, qj = -1, -1, 1, 1, -1, 1, 1, -1
    else:
        ai, aj, bi, bj, pi, pj, qi, qj = -1, 1, 1, -1, -1, -1, 1, 1
    a = _corner(z, i, j, ai, aj)
    b = _corner(z, i, j, bi, bj)
    p = _corner(z, i, j, pi, pj)
    q = _corner(z, i, j, qi, qj)
    y = np.int64(rows - 1)
    x = np.int64(cols - 1)
    ay, ax = min(row + ai * s, y), min(col + aj * s, x)
    by, bx = min(row + bi * s, y), min(col + bj * s, x)
    py, px = min(row + pi * s, y), min(col + pj * s, x)
    qy, qx = min(row + qi * s, y), min(col + qj * s, x)
    my, mx = min(row, y), min(col, x)
    if kind == EXACT:
        # An apex that is not there (the square's border) makes its triangle's heights NaN: no distance.
        one = triangle(fine, fine_row, fine_col, ay, ax, a, by, bx, b, py, px, p)
        two = triangle(fine, fine_row, fine_col, ay, ax, a, by, bx, b, qy, qx, q)
        return max(one, two)
    d = split_distance(ay, ax, a, by, bx, b, py, px, p, qy, qx, q, my, mx, np.float64(z[i, j]), kind == MIDPOINT)
    return d if d == d else 0.0


@kernel
def local_errors(fine, z, row0, col0, k, rows, cols, kind, errors):
    """The raw error of every diamond of octave k in a window: MIDPOINT's or WEDGIE's local one, or EXACT's deviation.

    Args:
        fine: the full-resolution window (float32) that begins at sample (row0, col0).
        z: the heights at octave k's spacing, the same window.
        rows, cols: of the raster.
        errors: the result, float32 with z's shape; entries that are no diamonds of this octave are not touched.
    """
    s = np.int64(1) << k
    height, width = z.shape
    for i in range(height):
        row = row0 + i * s
        odd_row = (row >> k) & 1
        first = 0 if odd_row else 1 - ((col0 >> k) & 1)
        step = 1 if odd_row else 2
        for j in range(first, width, step):
            col = col0 + j * s
            odd_col = (col >> k) & 1
            across = 2 if odd_row and odd_col else (1 if odd_col else 0)
            down = across != 1
            right = across != 0
            falling = across == 2 and is_falling(row, col, s)
            if row + s > rows - 1 or col + s > cols - 1:
                e = _squeezed(fine, row0, col0, z, i, j, row, col, s, rows, cols, across, falling, kind)
                errors[i, j] = round_up(e)
                continue
            if (down and (i == 0 or i + 1 >= height)) or (right and (j == 0 or j + 1 >= width)):
                errors[i, j] = 0.0  # in the margin: the hypotenuse is not in the window
                continue
            if kind == EXACT:
                if across == 2:
                    e = square(fine, i * s, j * s, s, falling)
                elif across == 1:
                    e = edge_across(fine, i * s, j * s, s)
                else:
                    e = edge_along(fine, i * s, j * s, s)
            else:
                if across == 2:
                    if falling:
                        e = abs(z[i, j] - 0.5 * (np.float64(z[i - 1, j - 1]) + np.float64(z[i + 1, j + 1])))
                    else:
                        e = abs(z[i, j] - 0.5 * (np.float64(z[i - 1, j + 1]) + np.float64(z[i + 1, j - 1])))
                elif across == 1:
                    e = abs(z[i, j] - 0.5 * (np.float64(z[i, j - 1]) + np.float64(z[i, j + 1])))
                else:
                    e = abs(z[i, j] - 0.5 * (np.float64(z[i - 1, j]) + np.float64(z[i + 1, j])))
                e = e if e == e else 0.0
            errors[i, j] = round_up(e)


# ---- what passes from triangle to triangle: two per diamond, first the upper or left one, second the lower or right --


@leaf
def _half(halves, i, j, which):
    """A triangle's value in a window; 0 beyond it."""
    if i < 0 or j < 0 or i >= halves.shape[0] or j >= halves.shape[1]:
        return halves.dtype.type(0)
    return halves[i, j, which]


@inlined
def _children(same, below, i, j, is_square, odd_col, falling):
    """Values of the children of a diamond's two triangles: (two of the first, two of the second)."""
    if is_square:
        north, south = _half(same, i - 1, j, 1), _half(same, i + 1, j, 0)
        west, east = _half(same, i, j - 1, 1), _half(same, i, j + 1, 0)
        if falling:
            return north, east, west, south
        return north, west, south, east
    nw, ne = _half(below, 2 * i - 1, 2 * j - 1, 1), _half(below, 2 * i - 1, 2 * j + 1, 1)
    sw, se = _half(below, 2 * i + 1, 2 * j - 1, 0), _half(below, 2 * i + 1, 2 * j + 1, 0)
    if odd_col:
        return nw, ne, sw, se
    return nw, sw, ne, se


@kernel
def wedgie_sums(below, row0, col0, k, rows, cols, sums, errors):
    """ROAM's nested sums of the diamonds of octave k.

    Args:
        below: float32 (2·height, 2·width, 2) sums of the octave below, in a window that begins at the same sample.
        row0, col0: the window's first sample. rows, cols: of the raster.
        sums: float32 (height, width, 2), the result.
        errors: float32 (height, width); in: local errors; out: the larger of a diamond's two sums.
    """
    s = np.int64(1) << k
    height, width = errors.shape
    for both in range(2):  # edge diamonds, then square ones
        for i in range(height):
            row = row0 + i * s
            odd_row = (row >> k) & 1
            for j in range(width):
                col = col0 + j * s
                odd_col = (col >> k) & 1
                if (odd_row & odd_col) != both or not (odd_row | odd_col):
                    continue
                local = np.float64(errors[i, j])
                one = 0.0
                two = 0.0
                if k or both:
                    a, b, c, d = _children(sums, below, i, j, both, odd_col, both and is_falling(row, col, s))
                    one, two = np.float64(max(a, b)), np.float64(max(c, d))
                    if row + s > rows - 1 or col + s > cols - 1:  # squeezed: children need not lie in their parent
                        one = two = max(one, two)
                sums[i, j, 0] = round_up(local + one)
                sums[i, j, 1] = round_up(local + two)
                errors[i, j] = max(sums[i, j, 0], sums[i, j, 1])


NONE, WHOLE, HOLE, MIXED = 0, 1, 2, 3
"""Whether the unit triangles under a triangle exist: bits that are or-ed upwards (NONE: beyond the raster)."""


@leaf
def _unit(z, ai, aj, bi, bj, ci, cj):
    """The state of a unit triangle by its corners."""
    height, width = z.shape
    if min(ai, bi, ci) < 0 or min(aj, bj, cj) < 0 or max(ai, bi, ci) >= height or max(aj, bj, cj) >= width:
        return NONE
    total = z[ai, aj] + z[bi, bj] + z[ci, cj]
    return WHOLE if total == total else HOLE


@kernel
def states(z, below, row0, col0, k, out):
    """Which triangles of octave k's diamonds are NONE, WHOLE, HOLE or MIXED.

    Args:
        z: the full-resolution window (used for k = 0).
        below: uint8 (2·height, 2·width, 2), the states of the octave below.
        out: uint8 (height, width, 2), the result; 0 where there is no diamond of this octave.
    """
    s = np.int64(1) << k
    height, width = out.shape[:2]
    for both in range(2):
        for i in range(height):
            row = row0 + i * s
            odd_row = (row >> k) & 1
            for j in range(width):
                col = col0 + j * s
                odd_col = (col >> k) & 1
                if (odd_row & odd_col) != both or not (odd_row | odd_col):
                    continue
                if k or both:
                    a, b, c, d = _children(out, below, i, j, both, odd_col, both and is_falling(row, col, s))
                    out[i, j, 0] = a | b
                    out[i, j, 1] = c | d
                elif odd_col:
                    out[i, j, 0] = _unit(z, i, j - 1, i, j, i - 1, j) | _unit(z, i, j, i, j + 1, i - 1, j)
                    out[i, j, 1] = _unit(z, i, j - 1, i, j, i + 1, j) | _unit(z, i, j, i, j + 1, i + 1, j)
                else:
                    out[i, j, 0] = _unit(z, i - 1, j, i, j, i, j - 1) | _unit(z, i, j, i + 1, j, i, j - 1)
                    out[i, j, 1] = _unit(z, i - 1, j, i, j, i, j + 1) | _unit(z, i, j, i + 1, j, i, j + 1)


@kernel
def mark(state, row0, col0, k, errors, empty):
    """Give mixed diamonds an infinite error, empty ones 0 and ``empty`` = 1."""
    height, width = errors.shape
    for i in range(height):
        odd_row = ((row0 >> k) + i) & 1
        for j in range(width):
            if odd_row or ((col0 >> k) + j) & 1:
                both = state[i, j, 0] | state[i, j, 1]
                if both == MIXED:
                    errors[i, j] = np.inf
                elif both != WHOLE:
                    errors[i, j] = 0.0
                    empty[i, j] = 1


# ---- monotony and spheres -------------------------------------------------------------------------------------------


@leaf
def _of(values, i, j):
    """An entry of a window, 0 beyond it."""
    if i < 0 or j < 0 or i >= values.shape[0] or j >= values.shape[1]:
        return values.dtype.type(0)
    return values[i, j]


@kernel
def close(below, row0, col0, k, errors):
    """Make errors monotonic: each no less than its children's.

    Args:
        below: float32, the closed errors of the octave below, in a window that begins at the same sample.
        errors: float32 (height, width), changed in place.
    """
    height, width = errors.shape
    for both in range(2):
        for i in range(height):
            odd_row = ((row0 >> k) + i) & 1
            if both and not odd_row:
                continue
            first = (1 - ((col0 >> k) & 1)) if both or not odd_row else (col0 >> k) & 1
            for j in range(first, width, 2):
                e = errors[i, j]
                if both:
                    if 0 < i < height - 1 and 0 < j < width - 1:
                        e = max(
                            e, max(max(errors[i - 1, j], errors[i + 1, j]), max(errors[i, j - 1], errors[i, j + 1]))
                        )
                    else:
                        e = max(e, max(_of(errors, i - 1, j), _of(errors, i + 1, j)))
                        e = max(e, max(_of(errors, i, j - 1), _of(errors, i, j + 1)))
                elif k:
                    y = 2 * i
                    x = 2 * j
                    if y > 0 and x > 0 and y + 1 < below.shape[0] and x + 1 < below.shape[1]:
                        e = max(
                            e,
                            max(
                                max(below[y - 1, x - 1], below[y - 1, x + 1]),
                                max(below[y + 1, x - 1], below[y + 1, x + 1]),
                            ),
                        )
                    else:
                        e = max(e, max(_of(below, y - 1, x - 1), _of(below, y - 1, x + 1)))
                        e = max(e, max(_of(below, y + 1, x - 1), _of(below, y + 1, x + 1)))
                errors[i, j] = e


@leaf
def _reach(z, radii, nested, i, j, row, col, height, rows, cols, metric, mx, my):
    """Distance from a diamond's centre (mx, my, height) to the vertex of entry (i, j), plus its radius if ``nested``."""
    if i < 0 or j < 0 or (nested and (i >= z.shape[0] or j >= z.shape[1])):
        return 0.0
    y = min(row, rows - 1)
    x = min(col, cols - 1)
    dx = metric[0, 0] * (x - mx) + metric[0, 1] * (y - my)
    dy = metric[1, 0] * (x - mx) + metric[1, 1] * (y - my)
    dz = z[min(i, z.shape[0] - 1), min(j, z.shape[1] - 1)] - height
    r = np.sqrt(dx * dx + dy * dy + dz * dz)
    if nested:
        r += radii[i, j]
    return r


@kernel
def spheres(z, fine_z, below, row0, col0, k, rows, cols, metric, radii):
    """Radii of the nested spheres: around the corners of the region and the children's spheres.

    After Lindstrom & Pascucci 2001, sec. 3.2, except that a finest sphere has the corners of its region inside, so that
    whatever is drawn of the region, fine or coarse, lies within (frustum culling relies on it).

    Args:
        z, fine_z: heights without gaps at the spacings of octave k and k − 1, windows that begin at the same sample.
        below: float32, radii of the octave below (z's window of spacing k − 1).
        rows, cols: of the raster. metric: float64 (2, 2), metres of easting and northing per column and row.
        radii: float32, the result.
    """
    s = np.int64(1) << k
    h = s >> 1
    height, width = radii.shape
    for both in range(2):
        for i in range(height):
            row = row0 + i * s
            odd_row = (row >> k) & 1
            for j in range(width):
                col = col0 + j * s
                odd_col = (col >> k) & 1
                if (odd_row & odd_col) != both or not (odd_row | odd_col):
                    continue
                my = min(row, rows - 1)
                mx = min(col, cols - 1)
                m = np.float64(z[i, j])
                r = 0.0
                for side in range(4):
                    if side == 0:
                        di, dj = -1, 0
                    elif side == 1:
                        di, dj = 1, 0
                    elif side == 2:
                        di, dj = 0, -1
                    else:
                        di, dj = 0, 1
                    # On the sides: children of a square diamond, corners of an edge one.
                    r = max(
                        r,
                        _reach(
                            z, radii, both, i + di, j + dj, row + di * s, col + dj * s, m, rows, cols, metric, mx, my
                        ),
                    )
                    di, dj = di - dj, di + dj
                    # On the diagonals: corners of a square diamond, children of an edge one.
                    if both:
                        r = max(
                            r,
                            _reach(
                                z, radii, 0, i + di, j + dj, row + di * s, col + dj * s, m, rows, cols, metric, mx, my
                            ),
                        )
                    elif k:
                        r = max(
                            r,
                            _reach(
                                fine_z,
                                below,
                                1,
                                2 * i + di,
                                2 * j + dj,
                                row + di * h,
                                col + dj * h,
                                m,
                                rows,
                                cols,
                                metric,
                                mx,
                                my,
                            ),
                        )
                radii[i, j] = np.float32(r * (1.0 + 2.0**-22))
