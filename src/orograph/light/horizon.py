"""How high the horizon stands around every sample of a raster, and how much of the sky is left above it.

For one azimuth the raster is covered by parallel lines in that direction, one sample apart. A line steps along the axis
it is closer to (its *major* axis: columns for light from the east, rows from the north) one sample at a time; across it
heights are interpolated linearly between the two samples on either side. Walking along a line away from the light, the
upper convex hull of what has been passed is kept as a flat stack; the horizon of a point is its tangent to that hull,
found by popping, so each point is pushed once and popped at most once: amortised O(1), whatever the distance
(Timonen & Westerholm 2010, "Scalable Height Field Self-Shadowing", Computer Graphics Forum 29(2), sec. 3).

Exact is the horizon at each point of such a line for the profile through that line's points. A sample lies between two
lines, on the same major step and less than one sample from either; its horizon is interpolated linearly between theirs
(on a plane that is exact again, which the nearest line alone would not be). Where a line runs through the samples
themselves (azimuths along rows, columns and diagonals) there is nothing to interpolate. Missing samples (NaN) are
transparent; beside one, the other sample stands for both.

Slopes are tangents of elevation angles above the plane the raster lies in. The terrain ends at the raster's border, and
behind it lies a level horizon. Azimuths are degrees clockwise from (grid) north towards the light.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph._numba import inlined, kernel
from orograph.errors import UsageError
from orograph.parallel import cpu_count, map_ordered
from orograph.progress import SILENT, Progress

Heights = NDArray[np.float32]
Measure = Literal["sky-view", "sky-view-slope", "visible-sky"]

_MODES: dict[str, int] = {"sky-view-slope": 0, "visible-sky": 1, "sky-view": 2}
"""What a sweep leaves: 0 replaces by the slope, 1 adds sin h, 2 adds sin² h."""
_LINES = 16
"""Lines swept together: as many samples as a cache line holds, so that sweeps across memory use all they fetch."""
_TIE = 1e-6
"""A line this close (in samples) to a sample goes through it: rounding must not decide which two it lies between."""


@inlined
def _profile(a, b, f):
    """Height between two samples, ``f`` from a to b; a missing one is replaced by the other."""
    if a != a:
        return np.float64(b)
    if b != b:
        return np.float64(a)
    return np.float64(a) + (np.float64(b) - np.float64(a)) * f


@kernel
def _gather(heights, lane_stride, step_stride, lanes, shift, part, line0, first, last, profile):
    """Heights at steps [first, last) of the lines ``line0``…: profile (lines, steps), NaN outside the raster."""
    lines = profile.shape[0]
    nan = np.float32(np.nan)
    if lane_stride == 1:  # neighbouring lines lie beside each other in memory
        for i in range(first, last):
            lane0, f = line0 + shift[i], part[i]
            base = lane0 + i * step_stride
            if lane0 >= 0 and lane0 + lines < lanes:
                if f == 0.0:
                    for b in range(lines):
                        profile[b, i] = heights[base + b]
                else:
                    for b in range(lines):
                        profile[b, i] = _profile(heights[base + b], heights[base + b + 1], f)
            else:
                for b in range(lines):
                    j = lane0 + b
                    p = heights[base + b] if 0 <= j < lanes else nan
                    q = heights[base + b + 1] if f > 0.0 and 0 <= j + 1 < lanes else nan
                    profile[b, i] = _profile(p, q, f)
        return
    for b in range(lines):
        for i in range(first, last):
            j, f = line0 + b + shift[i], part[i]
            k = j * lane_stride + i * step_stride
            p = heights[k] if 0 <= j < lanes else nan
            q = heights[k + lane_stride] if f > 0.0 and 0 <= j + 1 < lanes else nan
            profile[b, i] = _profile(p, q, f)


@kernel
def _hull(profile, first, last, towards, scale, lowest, position, height, slope):
    """Horizon slopes along one line: profile (steps,) → slope (steps,), at least ``lowest``; the light is at the end of
    increasing steps if ``towards`` > 0. ``position`` and ``height`` are the stack; ``scale`` is steps per metre."""
    size = 0
    i = last - 1 if towards > 0 else first
    for n in range(last - first):
        z = profile[i]
        if z == z:
            x = np.float64(n)
            # The top lies under the line from here to the one below it: it is hidden from here on.
            while size >= 2 and (height[size - 1] - z) * (position[size - 1] - position[size - 2]) <= (
                height[size - 2] - height[size - 1]
            ) * (x - position[size - 1]):
                size -= 1
            s = lowest
            if size > 0:
                s = max((height[size - 1] - z) * scale / (x - position[size - 1]), lowest)
            slope[i] = s
            position[size] = x
            height[size] = z
            size += 1
        i -= towards


@kernel
def _weigh(mode, slope, first, last):
    """Horizon slopes → what they take of the sky, in place: sin h or sin² h."""
    one = np.float32(1.0)
    for b in range(slope.shape[0]):
        if mode == 1:
            for i in range(first, last):
                slope[b, i] /= np.sqrt(one + slope[b, i] * slope[b, i])
        elif mode == 2:
            for i in range(first, last):
                slope[b, i] *= slope[b, i] / (one + slope[b, i] * slope[b, i])


@kernel
def _scatter(values, lane_stride, step_stride, lanes, shift, part, begin, end, first, last, keep, out):
    """Interpolate values (lines, steps) of lines begin − 1 … end − 1 at the samples between: out ← keep·out + value."""
    one = np.float32(1.0)
    if lane_stride == 1:
        for i in range(first, last):
            lane0, f = begin + shift[i], part[i]
            base = lane0 + i * step_stride
            for b in range(max(-lane0, 0), min(lanes - lane0, end - begin)):
                v = values[b + 1, i]
                if f > 0:
                    v = v * (one - f) + values[b, i] * f
                out[base + b] = out[base + b] * keep + v
        return
    for b in range(end - begin):
        for i in range(first, last):
            j = begin + b + shift[i]
            if 0 <= j < lanes:
                k = j * lane_stride + i * step_stride
                v = values[b + 1, i]
                if part[i] > 0:
                    v = v * (one - part[i]) + values[b, i] * part[i]
                out[k] = out[k] * keep + v


@kernel
def _sweep(heights, lane_stride, step_stride, lanes, steps, shift, part, tilt, towards, scale, lowest, first_line,
           last_line, mode, out):  # fmt: skip
    """Sweep the samples that lie on or just before lines [first_line, last_line); every sample belongs to one line."""
    profile = np.empty((_LINES + 1, steps), np.float64)
    slope = np.zeros((_LINES + 1, steps), np.float32)
    position, height = np.empty(steps, np.float64), np.empty(steps, np.float64)
    keep = np.float32(0.0 if mode == 0 else 1.0)
    for begin in range(first_line, last_line, _LINES):
        line0 = begin - 1  # the line before the first takes part in interpolation
        first, last = 0, steps
        if tilt != 0.0:  # where −1 < line + tilt·step < lanes for any of the lines
            p, q = (-2.0 - line0 - _LINES) / tilt, (lanes + 1.0 - line0) / tilt
            first = min(max(np.int64(min(p, q)), 0), steps)
            last = max(min(np.int64(max(p, q)) + 2, steps), first)
        _gather(heights, lane_stride, step_stride, lanes, shift, part, line0, first, last, profile)
        for b in range(_LINES + 1):
            _hull(profile[b], first, last, towards, scale, lowest, position, height, slope[b])
        _weigh(mode, slope, first, last)
        end = min(begin + _LINES, last_line)
        _scatter(slope, lane_stride, step_stride, lanes, shift, part, begin, end, first, last, keep, out)


@kernel
def _incline(slope, gx, gy, east, north, first, last, out):
    """Add to ``out`` the share of sky over inclined samples [first, last) towards the azimuth (east, north)."""
    for k in range(first, last):
        x, y = np.float64(gx[k]), np.float64(gy[k])
        rise = x * east + y * north
        t = max(np.float64(slope[k]), rise)  # a slope hides the sky behind itself
        zenith = np.pi / 2 - np.arctan(t)
        square = 1.0 / (1.0 + t * t)
        out[k] += np.float32((square - rise * (zenith - t * square)) / np.sqrt(1.0 + x * x + y * y))


def _azimuth(
    heights: Heights,
    linear: NDArray[np.float64],
    azimuth: float,
    mode: int,
    lowest: float,
    out: Heights,
    jobs: int | None,
) -> None:
    """Sweep the whole raster in one azimuth, its lines shared out over threads."""
    rows, cols = heights.shape
    east, north = direction(azimuth)
    across, down = (float(v) for v in np.linalg.solve(linear, [east, north]))  # samples per metre towards the light
    if abs(across) >= abs(down):
        lanes, steps, lane_stride, step_stride, major, minor = rows, cols, cols, 1, across, down
    else:
        lanes, steps, lane_stride, step_stride, major, minor = cols, rows, 1, cols, down, across
    tilt = minor / major
    if abs(tilt) * steps < _TIE:
        tilt = 0.0
    offset = tilt * np.arange(steps, dtype=np.float64)
    near = np.round(offset)
    offset = np.where(np.abs(offset - near) < _TIE, near, offset)
    shift = np.floor(offset).astype(np.int64)
    part = (offset - shift).astype(np.float32)
    # Sample (lane, step) belongs to line lane − shift[step].
    first_line, last_line = -int(shift.max()), lanes - int(shift.min())
    share = max(_LINES, -(-(last_line - first_line) // (8 * (jobs or cpu_count()))))
    share += -share % _LINES
    flat, result = heights.reshape(-1), out.reshape(-1)

    def run(begin: int) -> None:
        _sweep(flat, lane_stride, step_stride, lanes, steps, shift, part, tilt, 1 if major > 0 else -1, abs(major),
               np.float32(lowest), begin, min(begin + share, last_line), mode, result)  # fmt: skip

    for _ in map_ordered(run, range(first_line, last_line, share), jobs):
        pass


def direction(azimuth: float) -> tuple[float, float]:
    """Unit vector (east, north) of an azimuth in degrees."""
    a = math.radians(azimuth % 360.0)
    return math.sin(a), math.cos(a)


def _checked(heights: ArrayLike, linear: ArrayLike) -> tuple[Heights, NDArray[np.float64]]:
    surface = np.ascontiguousarray(heights, np.float32)
    cells = np.asarray(linear, np.float64)
    if surface.ndim != 2 or surface.size == 0:
        raise UsageError(f"Horizons need heights of shape (rows, cols), not {surface.shape}.")
    if cells.shape != (2, 2) or not np.isfinite(cells).all() or abs(np.linalg.det(cells)) == 0:
        raise UsageError("Horizons need the 2 × 2 linear part of a geotransform, in metres, that can be inverted.")
    return surface, cells


def horizon(
    heights: ArrayLike, linear: ArrayLike, azimuth: float, *, lowest: float = 0.0, jobs: int | None = None
) -> Heights:
    """The slope of the horizon seen from every sample in one azimuth.

    Args:
        heights: (rows, cols), metres, NaN where missing.
        linear: (2, 2) linear part of the geotransform [[a, b], [d, e]]: metres east and north per column and per row.
        azimuth: degrees clockwise from north.
        lowest: slopes are at least this: 0 is a level horizon, -inf keeps what looks down (-inf at the border).
        jobs: threads; None: all processors.

    Returns:
        (rows, cols) float32, tangent of the elevation angle; NaN where heights are.

    Raises:
        UsageError: the shapes are wrong, or the cells degenerate.
    """
    surface, cells = _checked(heights, linear)
    out = np.zeros(surface.shape, np.float32)
    _azimuth(surface, cells, azimuth, 0, lowest, out, jobs)
    out[np.isnan(surface)] = np.nan
    return out


def sky_view(
    heights: ArrayLike,
    linear: ArrayLike,
    azimuths: int = 16,
    *,
    measure: Measure = "sky-view",
    jobs: int | None = None,
    progress: Progress = SILENT,
) -> Heights:
    """How much sky every sample sees: a mean over ``azimuths`` horizons, evenly spread, the first in the north.

    Memory: 4 bytes per sample beside the heights (16 for ``"sky-view-slope"``), whatever the azimuths.

    Args:
        heights: (rows, cols), metres, NaN where missing.
        linear: (2, 2) linear part of the geotransform [[a, b], [d, e]]: metres east and north per column and per row.
        azimuths: how many, at least 3.
        measure: with h the elevation angle of the horizon (at least 0):
            ``"sky-view"``: the sky-view factor of a horizontal surface, 1 − mean sin² h: the share of
            the light of a uniform sky that falls on it, each direction weighted by its cosine;
            ``"sky-view-slope"``: the sky-view factor of the inclined surface itself (Dozier & Frew 1990, eq. 7b), the
            sky being what lies above both its horizon and its own plane; (1 + cos slope) / 2 on an endless plane;
            ``"visible-sky"``: the visible share of the hemisphere's solid angle, 1 − mean sin h, unweighted.
        jobs: threads; None: all processors. The result does not depend on it.

    Returns:
        (rows, cols) float32 in [0, 1]; NaN where heights are.

    Raises:
        UsageError: the shapes are wrong, the cells degenerate, too few azimuths, or an unknown measure.
    """
    surface, cells = _checked(heights, linear)
    if azimuths < 3:
        raise UsageError(f"A sky view needs at least three azimuths, not {azimuths}.")
    if measure not in _MODES:
        raise UsageError(f"There is no measure {measure!r}; there are {', '.join(_MODES)}.")
    inclined = measure == "sky-view-slope"
    out = np.zeros(surface.shape, np.float32)
    slope = np.zeros(surface.shape, np.float32) if inclined else out
    if inclined:
        from orograph.light.normal import gradient

        gx, gy = (g.reshape(-1) for g in gradient(surface, cells, jobs))
    with progress.task("Sweeping horizons", total=azimuths) as task:
        for k in range(azimuths):
            _azimuth(surface, cells, 360.0 * k / azimuths, _MODES[measure], 0.0, slope, jobs)
            if inclined:
                east, north = direction(360.0 * k / azimuths)
                size, share = surface.size, 1 << 18

                def add(begin: int) -> None:
                    _incline(slope.reshape(-1), gx, gy, east, north, begin, min(begin + share, size), out.reshape(-1))  # noqa: B023

                for _ in map_ordered(add, range(0, size, share), jobs):
                    pass
            task.advance()
    out /= np.float32(azimuths)
    if not inclined:
        np.subtract(np.float32(1.0), out, out=out)
    np.clip(out, 0.0, 1.0, out=out)
    out[np.isnan(surface)] = np.nan
    return out
