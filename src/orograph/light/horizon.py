"""Horizon angles and sky-view factors of a raster by sweeping: every sample, one azimuth after the other.

For an azimuth the raster is cut into parallel lines that advance one row (or column) a step and cross the other axis at
fractional positions, so that each sample lies on exactly one line when positions are rounded and the line's profile is
interpolated between its two neighbours. Walking along a line away from the light, the points that can still form a
horizon are the upper convex hull of what has been passed; it is kept as a stack, and each sample is pushed and popped at
most once: O(1) a sample, unlimited distance (Timonen & Westerholm 2010, *Scalable height field self-shadowing*, §3).

Slopes are rise over run, both in metres; the affine part of the grid may be anything. Missing samples (NaN) let light
through and have no horizon of their own.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.parallel import cpu_count, map_ordered

Heights = NDArray[np.float32]
Array = NDArray[np.float64]


@kernel
def _sweep(heights, drift, run, down, first, last, out):
    """Horizon slopes of all samples on lines [first, last) of a sweep along rows.

    Line k crosses row r (counted along the walk) at column k + drift·r, |drift| ≤ 1; the samples it owns are those it
    rounds to. ``run``: metres from row to row along the line. ``down``: rows are walked from first to last, light
    coming from before. ``out`` receives the slope from the sample's own height to the hull of the line before it.
    """
    rows, cols = heights.shape
    hull_at = np.empty(rows, np.float64)
    hull_z = np.empty(rows, np.float64)
    for line in range(first, last):
        size = 0
        for step in range(rows):
            x = line + drift * step
            j = np.int64(np.floor(x))
            if x < 0.0 or x > cols - 1:
                continue
            r = step if down else rows - 1 - step
            f = x - j
            j1 = min(j + 1, cols - 1)
            a, b = np.float64(heights[r, j]), np.float64(heights[r, j1])
            z = a + f * (b - a) if f > 0.0 else a
            at = run * step
            owner = np.int64(np.floor(x + 0.5))
            own = np.float64(heights[r, owner])
            # The horizon from the sample's own height: the hull's tangent from (at, own).
            k = size - 1
            if k >= 0:
                best = (hull_z[k] - own) / (at - hull_at[k])
                while k > 0:
                    other = (hull_z[k - 1] - own) / (at - hull_at[k - 1])
                    if other < best:
                        break
                    best = other
                    k -= 1
                out[r, owner] = best if own == own else np.nan
            else:
                out[r, owner] = -np.inf if own == own else np.nan
            if z == z:
                # What lies under the line from the new point to the one before the last will never be a horizon again.
                while size >= 2 and (hull_z[size - 1] - z) * (at - hull_at[size - 2]) <= (hull_z[size - 2] - z) * (
                    at - hull_at[size - 1]
                ):
                    size -= 1
                hull_at[size] = at
                hull_z[size] = z
                size += 1


def horizon_slope(heights: Heights, linear: Array, azimuth: float, jobs: int | None = None) -> Heights:
    """Slope (tan of the angle) from each sample up to its horizon in one azimuth.

    Args:
        heights: (rows, cols) float32 metres, NaN where missing.
        linear: (2, 2) float64, metres east and north per column and row: ``[[a, b], [d, e]]`` of the geotransform.
        azimuth: degrees clockwise from north, towards the horizon.

    Returns:
        (rows, cols) float32; −inf where nothing lies that way, NaN where the sample is missing. Exact for the profile
        that is linear between the line's crossings of the rows (or columns), taken from the sample's own height.
    """
    a = math.radians(azimuth)
    dc, dr = np.linalg.inv(linear) @ [math.sin(a), math.cos(a)]  # samples per metre towards the light
    rows, cols = heights.shape
    along_rows = abs(dr) >= abs(dc)
    field = heights if along_rows else np.ascontiguousarray(heights.T)
    major, minor = (dr, dc) if along_rows else (dc, dr)
    n, m = field.shape
    drift = -minor / abs(major)  # walking away from the light
    run = 1.0 / abs(major)
    down = major < 0
    # Ties at half a sample round away from each other for opposite lines: the drift is nudged off exact halves.
    out = np.full(field.shape, -np.inf, np.float32)
    out[np.isnan(field)] = np.nan
    low = min(0.0, -drift * (n - 1))
    high = max(0.0, -drift * (n - 1))
    first, last = math.floor(low) - 1, m + math.ceil(high) + 1
    jobs = jobs or cpu_count()
    step = max(64, -(-(last - first) // (jobs * 4)))
    spans = [(k, min(k + step, last)) for k in range(first, last, step)]
    for _ in map_ordered(lambda span: _sweep(field, drift, run, down, span[0], span[1], out), spans, jobs):
        pass
    return out if along_rows else np.ascontiguousarray(out.T)


def sky_view(heights: Heights, linear: Array, azimuths: int = 16, *, jobs: int | None = None) -> Heights:
    """The part of the light of a uniform sky that reaches level ground at each sample: mean of cos² of the horizon angle.

    Cosine-weighted over the upper hemisphere: 1 − mean sin² h over azimuths, h the horizon angle (≥ 0).

    Args: as ``horizon_slope``; ``azimuths``: how many, evenly spaced from north.

    Returns:
        (rows, cols) float32 in [0, 1], NaN where the sample is missing.
    """
    total = np.zeros(heights.shape, np.float32)
    for k in range(azimuths):
        s = np.maximum(horizon_slope(heights, linear, 360.0 * k / azimuths, jobs), 0)
        total += s * s / (1 + s * s)
    return 1 - total / azimuths
