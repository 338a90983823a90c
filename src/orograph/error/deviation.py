"""How far full-resolution samples lie from coarse triangles: the scans behind the ``exact`` error.

A diamond's coarse drawing is its two top triangles, which share the hypotenuse. Its *deviation* is the largest vertical
distance of a sample of its (closed) region from them; on the finest triangulation both surfaces are linear, so this is
the distance of the surfaces too. Diamonds inside the raster are scanned row by row with constant steps; those that
straddle the border of a raster that is not 2^n + 1 samples wide are *squeezed* (their outer vertices lie on the
border), and a general scan of triangles with integer corners serves them, as it serves diamonds that are larger than
the block of samples at hand.

Heights in metres, float32 in, float64 within; missing samples (NaN) do not count; indices are (row, col) of the window.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf


@inlined
def _off_row(z, row, col0, col1, base, slope, worst):
    """The larger of ``worst`` and the distances of ``z[row, col0..col1]`` from base + slope·(col − col0)."""
    for u in range(col1 - col0 + 1):
        d = abs(z[row, col0 + u] - (base + slope * u))
        worst = d if d > worst else worst
    return worst


@leaf
def edge_across(z, row, col, s):
    """Deviation of an edge diamond whose hypotenuse of length 2s runs along its row; one apex may be beyond ``z``."""
    a = np.float64(z[row, col - s])
    b = np.float64(z[row, col + s])
    middle = 0.5 * (a + b)
    slope = (b - a) / (2 * s)
    worst = abs(z[row, col] - middle)
    worst = worst if worst == worst else 0.0
    if s == 1:
        return worst
    worst = _off_row(z, row, col - s, col + s, a, slope, worst)
    if row - s >= 0:
        up = (z[row - s, col] - middle) / s
        for v in range(1, s):
            worst = _off_row(z, row - v, col - s + v, col + s - v, a + slope * v + up * v, slope, worst)
    if row + s < z.shape[0]:
        down = (z[row + s, col] - middle) / s
        for v in range(1, s):
            worst = _off_row(z, row + v, col - s + v, col + s - v, a + slope * v + down * v, slope, worst)
    return worst


@leaf
def edge_along(z, row, col, s):
    """Deviation of an edge diamond whose hypotenuse of length 2s runs along its column."""
    a = np.float64(z[row - s, col])
    b = np.float64(z[row + s, col])
    middle = 0.5 * (a + b)
    slope = (b - a) / (2 * s)
    worst = abs(z[row, col] - middle)
    worst = worst if worst == worst else 0.0
    if s == 1:
        return worst
    left = (z[row, col - s] - middle) / s if col - s >= 0 else np.nan
    right = (z[row, col + s] - middle) / s if col + s < z.shape[1] else np.nan
    for u in range(-s + 1, s):
        reach = s - abs(u)
        base = middle + slope * u
        if left == left:
            worst = _off_row(z, row + u, col - reach, col, base + left * reach, -left, worst)
        if right == right:
            worst = _off_row(z, row + u, col, col + reach, base, right, worst)
    return worst


@leaf
def square(z, row, col, s, falling):
    """Deviation of a square diamond of half side s, cut from north-west to south-east if ``falling``."""
    nw = np.float64(z[row - s, col - s])
    ne = np.float64(z[row - s, col + s])
    sw = np.float64(z[row + s, col - s])
    se = np.float64(z[row + s, col + s])
    scale = 1.0 / (2 * s)
    worst = 0.0
    if falling:
        for y in range(2 * s + 1):
            left = nw + (sw - nw) * (y * scale)
            diagonal = nw + (se - nw) * (y * scale)
            worst = _off_row(z, row - s + y, col - s, col - s + y, left, (se - sw) * scale, worst)
            worst = _off_row(z, row - s + y, col - s + y, col + s, diagonal, (ne - nw) * scale, worst)
    else:
        for y in range(2 * s + 1):
            left = nw + (sw - nw) * (y * scale)
            diagonal = ne + (sw - ne) * (y * scale)
            worst = _off_row(z, row - s + y, col - s, col + s - y, left, (ne - nw) * scale, worst)
            worst = _off_row(z, row - s + y, col + s - y, col + s, diagonal, (se - sw) * scale, worst)
    return worst


@leaf
def triangle(z, row0, col0, ay, ax, az, by, bx, bz, cy, cx, cz):
    """Deviation of the samples of a window from one triangle with integer corners (its closure).

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
    worst = 0.0
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
        for x in range(low, high + 1):
            d = abs(z[y - row0, x - col0] - (base + gx * (x - ax)))
            worst = d if d > worst else worst
    return worst


@leaf
def split_distance(ay, ax, az, by, bx, bz, py, px, pz, qy, qx, qz, my, mx, mz, only_middle):
    """Vertical distance of the two triangles (a, b, p), (a, b, q) from the four that meet in m, for squeezed diamonds.

    Both are linear on the pieces of their overlay, so it is the larger of the distances at m and where the hypotenuse
    crosses the edge from m to the apex on its other side (m is not on the hypotenuse where the border squeezes them).

    Args:
        ay, ax, az…: rows, columns and heights of the hypotenuse's ends a and b, the apexes p and q, and the centre m.
        only_middle: only the distance at m, ROAM's local error.
    """
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
