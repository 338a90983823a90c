"""The inner loops of silhouettes (``silhouettes``): where ground breaks off, and what lines there cover."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel

HIDDEN = 0.012, 0.06
"""What is hidden, as a part of the depth, where lines begin, and where they have their whole weight."""

ACROSS, BESIDE = 2.0, 0.5
"""Steps of the flatter and of the steeper side that a step between two pixels may have without a break."""

FAINT, THIN = 0.35, 0.6
"""Parts of opacity and of width that lines at the farthest ground keep."""

WALK = 6
"""Pixels to both sides within which n · v has to rise for a crease."""

PROMINENT = 0.10, 0.24
"""By how much n · v has to rise to both sides where creases begin, and where they have their whole weight."""

NEARBY = 3
"""Pixels from a break within which no crease runs beside it."""

GRAZING = 0.12, 0.34
"""n · v up to which creases have their whole weight, and from which on they have none."""


class Border(NamedTuple):
    """Where a terrain ends.

    Attributes:
        last_col, last_row: of the raster. away, step: ``silhouettes.terrain_ends``.
    """

    last_col: float
    last_row: float
    away: NDArray[np.float32]
    step: int


@inlined
def farness(z, depths):
    """0 at the nearest ground, 1 at the farthest, by the logarithm of the depth."""
    near, far = depths
    return min(max(np.log(z / near) / np.log(far / near), 0.0), 1.0)


@kernel
def _broken(w0, w1, w2, w3):
    """Weight of the break between two pixels of inverse depths w1 and w2; w0, w3: those beyond them, 0: nothing."""
    a = abs(w1 - w0) if w0 > 0.0 else -1.0
    b = abs(w3 - w2) if w3 > 0.0 else -1.0
    if a < 0.0:
        a = max(b, 0.0)
    if b < 0.0:
        b = a
    hidden = (abs(w2 - w1) - ACROSS * min(a, b) - BESIDE * max(a, b)) / max(w1, w2)
    t = min(max((hidden - HIDDEN[0]) / (HIDDEN[1] - HIDDEN[0]), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@kernel
def _hides(depth, i, j, di, dj):
    """Weight of the break between a pixel and the next one along an axis; 1 beside nothing."""
    rows, cols = depth.shape
    if i < 0 or j < 0 or i + di >= rows or j + dj >= cols:
        return 0.0
    z1, z2 = depth[i, j], depth[i + di, j + dj]
    if not (z1 == z1 and z2 == z2):
        return 1.0
    w0 = w3 = 0.0
    if i - di >= 0 and j - dj >= 0:
        z0 = depth[i - di, j - dj]
        w0 = 1.0 / z0 if z0 == z0 else 0.0
    if i + 2 * di < rows and j + 2 * dj < cols:
        z3 = depth[i + 2 * di, j + 2 * dj]
        w3 = 1.0 / z3 if z3 == z3 else 0.0
    return _broken(w0, 1.0 / z1, 1.0 / z2, w3)


@kernel
def breaks(depth, left, top, pixels, to_samples, border, depths, strong, nearest):
    """Weights of the breaks between each pixel and the next one to the right (0) and below (1).

    Args:
        depth: (rows, cols), NaN: nothing. left, top: pixel position of the first one.
        pixels: ``PixelRays``, in perspective. to_samples: ``ToSamples``. border: ``Border``.
        depths: the nearest and the farthest in view, metres.
        strong, nearest: out (2, rows, cols): weights, and the depth of the nearer side.
    """
    rows, cols = depth.shape
    o0, _, _, d0, du, dv = pixels.basis
    linear, offset, spacing = to_samples
    away, step = border.away, border.step
    for i in range(rows):
        for j in range(cols):
            for k in range(2):
                di, dj = (0, 1) if k == 0 else (1, 0)
                strong[k, i, j], nearest[k, i, j] = 0.0, np.inf
                if i + di >= rows or j + dj >= cols:
                    continue
                z1, z2 = depth[i, j], depth[i + di, j + dj]
                one, two = z1 == z1, z2 == z2
                if not (one or two):
                    continue
                z = min(z1, z2) if one and two else (z1 if one else z2)
                weight = 1.0
                if one and two:
                    weight = _hides(depth, i, j, di, dj)
                else:
                    # Against nothing: unless the terrain ends there.
                    px, py = left + j + (0 if one else dj), top + i + (0 if one else di)
                    x = o0[0] + z * (d0[0] + px * du[0] + py * dv[0])
                    y = o0[1] + z * (d0[1] + px * du[1] + py * dv[1])
                    col = linear[0, 0] * x + linear[0, 1] * y + offset[0]
                    row = linear[1, 0] * x + linear[1, 1] * y + offset[1]
                    # A pixel's ground may reach as far as that of the one before it.
                    y0, x0 = (i - di, j - dj) if one else (i + 2 * di, j + 2 * dj)
                    before = depth[y0, x0] if 0 <= y0 < rows and 0 <= x0 < cols else z
                    reach = 2.0 * abs(z - before) / spacing if before == before else 0.0
                    margin = 2.0 + 3.0 * pixels.pixel * z / spacing + reach
                    y0 = min(max(int(row / step + 0.5), 0), away.shape[0] - 1)
                    x0 = min(max(int(col / step + 0.5), 0), away.shape[1] - 1)
                    inner = away[y0, x0] - 1.75 * (step - 1)
                    if min(col, row, border.last_col - col, border.last_row - row, inner) < margin:
                        weight = 0.0
                if weight > 0.0:
                    strong[k, i, j] = weight * (1.0 - (1.0 - FAINT) * farness(z, depths))
                    nearest[k, i, j] = z


@kernel
def _prominence(facing, i, j, di, dj):
    """By how much n · v rises to both sides of a pixel along an axis before it falls below the pixel's; the lesser."""
    low = facing[i, j]
    least = np.float32(2.0)
    for side in (-1, 1):
        top = low
        for k in range(1, WALK + 1):
            r, c = i + side * k * di, j + side * k * dj
            if r < 0 or c < 0 or r >= facing.shape[0] or c >= facing.shape[1]:
                break
            here = facing[r, c]
            if not here >= low:
                break
            top = max(top, here)
        least = min(least, top - low)
    return least


@kernel
def creases(facing, depth, depths, weight, strong, nearest):
    """Add to ``strong`` and ``nearest`` (``breaks``) the lines where ground turns away and back.

    Args:
        facing: (rows, cols) float32, n · v, NaN where there is no ground. weight: of whole ones.
    """
    rows, cols = facing.shape
    for i in range(rows):
        for j in range(cols):
            low = facing[i, j]
            if not low < GRAZING[1]:
                continue
            for k in range(2):
                di, dj = (0, 1) if k == 0 else (1, 0)
                if i < di or j < dj or i + di >= rows or j + dj >= cols:
                    continue
                before, after = facing[i - di, j - dj], facing[i + di, j + dj]
                if not (before >= low and after >= low):
                    continue
                t = (_prominence(facing, i, j, di, dj) - PROMINENT[0]) / (PROMINENT[1] - PROMINENT[0])
                if t <= 0.0:
                    continue
                t = min(t, 1.0)
                u = min(max((GRAZING[1] - low) / (GRAZING[1] - GRAZING[0]), 0.0), 1.0)
                s = weight * t * t * (3.0 - 2.0 * t) * u * u * (3.0 - 2.0 * u)
                beside = 0.0
                for n in range(-NEARBY, NEARBY):
                    beside = max(beside, _hides(depth, i + n * di, j + n * dj, di, dj))
                z = depth[i, j]
                s *= (1.0 - beside) * (1.0 - (1.0 - FAINT) * farness(z, depths))
                # On the side of the lower neighbour: the valley's floor is there.
                r, c = (i, j) if after <= before else (i - di, j - dj)
                if s > strong[k, r, c]:
                    strong[k, r, c], nearest[k, r, c] = s, z


@kernel
def gather(strong, nearest, depths, width, casing, reach, cover, depth):
    """Coverage (rows, cols) of pixels by lines on breaks, and the depth of the line that covers most.

    Args:
        width: of the nearest lines, pixels. casing: pixels more to each side. reach: pixels to look around.
    """
    rows, cols = cover.shape
    for i in range(rows):
        for j in range(cols):
            best, z = np.float32(0.0), np.inf
            for r in range(max(i - reach, 0), min(i + reach + 1, rows)):
                for c in range(max(j - reach, 0), min(j + reach + 1, cols)):
                    for k in range(2):
                        s = strong[k, r, c]
                        if s <= best:
                            continue
                        # From this pixel's centre to the border between the two pixels, a segment of unit length.
                        if k == 0:
                            dx, dy = c + 0.5 - j, max(abs(r - i) - 0.5, 0.0)
                        else:
                            dx, dy = max(abs(c - j) - 0.5, 0.0), r + 0.5 - i
                        f = farness(nearest[k, r, c], depths)
                        half = 0.5 * width * (1.0 - (1.0 - THIN) * f) + casing
                        s *= min(max(half + 0.5 - np.sqrt(dx * dx + dy * dy), 0.0), min(2.0 * half, 1.0))
                        if s > best:
                            best, z = s, nearest[k, r, c]
            cover[i, j], depth[i, j] = best, z
