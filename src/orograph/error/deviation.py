"""How far full-resolution samples lie from coarse triangles: the scans behind the ``exact`` error.

A diamond's coarse drawing is its two top triangles, which share the hypotenuse. Its *deviation* is the largest
vertical distance of the full-resolution surface from them. Both surfaces are linear on the finest triangles, so the
distance is largest at a sample. Diamonds inside the raster are scanned row by row with constant steps, without the
samples on their sides: a side is the hypotenuse of a child, whose deviation counts as well once errors are monotonic.
Diamonds that straddle the border of a raster that is not 2^n + 1 samples wide are *squeezed* (their outer vertices
lie on the border), and a general scan of triangles with integer corners serves them, as it serves diamonds that are
larger than the block of samples at hand. The slanted sides of squeezed triangles cut through finest triangles, so
where such a side crosses a side of a finest triangle counts, too.

Heights in metres, float32 in, float64 within; missing samples (NaN) do not count; indices are (row, col) of the window.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf

NOTHING = np.int64(0)
"""The distance 0 as bits."""


@inlined
def bits(d):
    """A distance ≥ 0 as an integer that sorts alike (0 for NaN): the compiler may take maxima of those in any order."""
    return np.float64(d if d == d else 0.0).view(np.int64)


@inlined
def distance(worst):
    """The distance whose ``bits`` are ``worst``."""
    return np.int64(worst).view(np.float64)


@inlined
def _off_row(z, row, first, count, base, slope, worst):
    """The larger of ``worst`` and the distances (as bits) of ``z[row, first + u]`` from base + slope·u, u < count."""
    start = np.uint64(first)  # unsigned: no index counts from the end
    for u in range(count):
        worst = max(
            worst, bits(abs(z[np.uint64(row), start + np.uint64(u)] - (base + slope * np.float64(np.int32(u)))))
        )
    return worst


@leaf
def edge_across(z, row, col, s):
    """Deviation of the samples inside an edge diamond whose hypotenuse of length 2s runs along its row."""
    a = np.float64(z[row, col - s])
    b = np.float64(z[row, col + s])
    middle = 0.5 * (a + b)
    slope = (b - a) / (2 * s)
    up = (z[row - s, col] - middle) / s
    down = (z[row + s, col] - middle) / s
    worst = _off_row(z, row, col - s + 1, 2 * s - 1, a + slope, slope, NOTHING)
    for v in range(1, s):
        reach = s - v - 1
        base = middle - slope * reach
        worst = _off_row(z, row - v, col - reach, 2 * reach + 1, base + up * v, slope, worst)
        worst = _off_row(z, row + v, col - reach, 2 * reach + 1, base + down * v, slope, worst)
    return distance(worst)


@leaf
def edge_along(z, row, col, s):
    """Deviation of the samples inside an edge diamond whose hypotenuse of length 2s runs along its column."""
    a = np.float64(z[row - s, col])
    b = np.float64(z[row + s, col])
    middle = 0.5 * (a + b)
    slope = (b - a) / (2 * s)
    left = (middle - z[row, col - s]) / s
    right = (z[row, col + s] - middle) / s
    worst = NOTHING
    for u in range(-s + 1, s):
        reach = s - abs(u) - 1
        base = middle + slope * u
        worst = _off_row(z, row + u, col - reach, reach + 1, base - left * reach, left, worst)
        worst = _off_row(z, row + u, col + 1, reach, base + right, right, worst)
    return distance(worst)


@leaf
def square(z, row, col, s, falling):
    """Deviation of the samples inside a square diamond of half side s, cut from north-west to south-east or not."""
    nw = np.float64(z[row - s, col - s])
    ne = np.float64(z[row - s, col + s])
    sw = np.float64(z[row + s, col - s])
    se = np.float64(z[row + s, col + s])
    scale = 1.0 / (2 * s)
    down = (sw - nw) * scale
    if falling:
        lower, upper = (se - sw) * scale, (ne - nw) * scale
        start, along = nw, (se - nw) * scale
    else:
        lower, upper = (ne - nw) * scale, (se - sw) * scale
        start, along = ne, (sw - ne) * scale
    worst = NOTHING
    for y in range(1, 2 * s):
        on = y if falling else 2 * s - y  # the column of the diagonal
        worst = _off_row(z, row - s + y, col - s + 1, on, nw + down * y + lower, lower, worst)
        worst = _off_row(z, row - s + y, col - s + on + 1, 2 * s - 1 - on, start + along * y + upper, upper, worst)
    return distance(worst)


@inlined
def _off_side(z, row0, col0, y, x, down, across, f, on):
    """Distance (bits) of a height from a point on a side of a finest triangle; 0 if the side is not in the window.

    Args:
        y, x: the sample where the side begins. down, across: from it to where the side ends, −1, 0 or 1.
        f: the point's share of the way. on: the height.
    """
    i, j = y - row0, x - col0
    rows, cols = z.shape
    if min(i, i + down) < 0 or min(j, j + across) < 0 or max(i, i + down) >= rows or max(j, j + across) >= cols:
        return NOTHING
    here, there = np.float64(z[i, j]), np.float64(z[i + down, j + across])
    return bits(abs(here + f * (there - here) - on))


@inlined
def _within(low, high, first, last, p, d):
    """The part of low … high (shares of a way from p to p + d) that lies between first and last."""
    if d == 0:
        return low, high
    a, b = (first - p) / d, (last - p) / d
    return max(low, min(a, b)), min(high, max(a, b))


@leaf
def off_crossings(z, row0, col0, py, px, pz, qy, qx, qz):
    """Deviation (as bits) of a window's surface from a straight side p, q where that crosses sides of finest triangles.

    Crossings at samples are left out. The finest triangles' hypotenuses alternate: that of a cell falls (to the
    south-east) if row + column of its north-western sample is even.
    """
    dy, dx = qy - py, qx - px
    along = (py + px) & 1 == 0  # of a diagonal side: whether it is made of hypotenuses (its points are all alike)
    if dy == 0 or dx == 0 or (abs(dy) == abs(dx) and along):
        return NOTHING  # it is made of such sides
    low, high = _within(0.0, 1.0, row0, row0 + z.shape[0] - 1, py, dy)
    low, high = _within(low, high, col0, col0 + z.shape[1] - 1, px, dx)
    worst = NOTHING
    # Rows, columns, falling and rising diagonals are where y, x, x − y and x + y are whole numbers c.
    for family in range(4):
        first = py if family == 0 else px if family == 1 else px - py if family == 2 else px + py
        span = dy if family == 0 else dx if family == 1 else dx - dy if family == 2 else dx + dy
        step, count = (1 if span > 0 else -1), abs(span)
        for k in range(max(1, int(low * count)), min(count, int(high * count) + 2)):
            c = first + k * step
            on = pz + (qz - pz) * (k / count)
            # The other coordinate (of diagonals: y) is whole + rest / count.
            reach = (dx if family == 0 else dy) * k
            whole = reach // count
            rest = reach - whole * count
            if rest == 0:
                continue
            f = rest / count
            if family == 0:
                worst = max(worst, _off_side(z, row0, col0, c, px + whole, 0, 1, f, on))
            elif family == 1:
                worst = max(worst, _off_side(z, row0, col0, py + whole, c, 1, 0, f, on))
            else:
                y = py + whole
                x = c + y if family == 2 else c - y
                # A rising line meets row y at x and runs through the cell on x's left.
                falls = (y + (x if family == 2 else x - 1)) & 1 == 0
                if falls == (family == 2):
                    worst = max(worst, _off_side(z, row0, col0, y, x, 1, 1 if family == 2 else -1, f, on))
    return worst


@leaf
def triangle(z, row0, col0, ay, ax, az, by, bx, bz, cy, cx, cz):
    """Deviation of a window's surface from one triangle with integer corners (its closure).

    Args:
        z: the window; its first sample is sample (row0, col0).
        ay, ax, az…: the corners' row, column (int64) and height.

    Returns:
        the largest distance; 0 if the triangle has no area or no sample in the window.
    """
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if area == 0:
        return 0.0
    # The plane: az + gx·(x − ax) + gy·(y − ay).
    gx = ((bz - az) * (cy - ay) - (cz - az) * (by - ay)) / area
    gy = ((cz - az) * (bx - ax) - (bz - az) * (cx - ax)) / area
    rows, cols = z.shape
    first = max(min(ay, by, cy), row0)
    last = min(max(ay, by, cy), row0 + rows - 1)
    worst = NOTHING
    for y in range(first, last + 1):
        low = np.int64(col0)
        high = np.int64(col0 + cols - 1)
        # Each edge bounds the row from one side: the triangle is where all three edge functions have the area's sign.
        for edge in range(3):
            if edge == 0:
                py, px, qy, qx = ay, ax, by, bx
            elif edge == 1:
                py, px, qy, qx = by, bx, cy, cx
            else:
                py, px, qy, qx = cy, cx, ay, ax
            dy = qy - py
            dx = qx - px
            if area < 0:
                dy = -dy
                dx = -dx
            # inside: dx·(y − py) − dy·(x − px) ≥ 0
            known = dx * (y - py)
            if dy > 0:
                high = min(high, px + known // dy)
            elif dy < 0:
                low = max(low, px - (known // -dy))
            elif known < 0:
                high = low - 1
        base = az + gy * (y - ay)
        worst = _off_row(z, y - row0, low - col0, high + 1 - low, base + gx * (low - ax), gx, worst)
    worst = max(worst, off_crossings(z, row0, col0, ay, ax, az, by, bx, bz))
    worst = max(worst, off_crossings(z, row0, col0, by, bx, bz, cy, cx, cz))
    worst = max(worst, off_crossings(z, row0, col0, cy, cx, cz, ay, ax, az))
    return distance(worst)


@leaf
def split_distance(a, b, p, q, m, only_middle):
    """Vertical distance of the two triangles (a, b, p), (a, b, q) from the four that meet in m, for squeezed diamonds.

    Both are linear on the pieces of their overlay, so it is the larger of the distances at m and where the hypotenuse
    crosses the edge from m to the apex on its other side (m is not on the hypotenuse where the border squeezes them).

    Args:
        a, b, p, q, m: (row, column, height) of the hypotenuse's ends, of the apexes, and of the centre.
        only_middle: only the distance at m, ROAM's local error.
    """
    (ay, ax, az), (by, bx, bz), (py, px, pz), (qy, qx, qz), (my, mx, mz) = a, b, p, q, m
    dy = by - ay
    dx = bx - ax
    length = dx * dx + dy * dy
    if length == 0:
        return 0.0
    side_m = dx * (my - ay) - dy * (mx - ax)
    side_p = dx * (py - ay) - dy * (px - ax)
    side_q = dx * (qy - ay) - dy * (qx - ax)
    along = (dx * (mx - ax) + dy * (my - ay)) / length
    coarse = az + along * (bz - az)
    if side_m == 0:
        return abs(mz - coarse)
    # The apex on m's side, and the other one.
    if (side_m > 0) == (side_p > 0) and side_p != 0:
        ny, nx, nz, side_n, oy, ox, oz, side_o = py, px, pz, side_p, qy, qx, qz, side_q
    else:
        ny, nx, nz, side_n, oy, ox, oz, side_o = qy, qx, qz, side_q, py, px, pz, side_p
    worst = 0.0
    if side_n != 0:
        share = side_m / side_n
        along_n = (dx * (nx - ax) + dy * (ny - ay)) / length
        foot = az + along_n * (bz - az)
        coarse = az + along * (bz - az) + share * (nz - foot)
        d = abs(mz - coarse)
        worst = d if d > worst else worst
    if not only_middle and side_o != side_m:
        t = side_m / (side_m - side_o)
        x = mx + t * (ox - mx)
        y = my + t * (oy - my)
        along = (dx * (x - ax) + dy * (y - ay)) / length
        d = abs(mz + t * (oz - mz) - (az + along * (bz - az)))
        worst = d if d > worst else worst
    return worst
