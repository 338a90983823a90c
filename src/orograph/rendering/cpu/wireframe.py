"""The edges of a tessellation as thin antialiased lines over a picture, hidden where ground is in front of them.

A line's coverage of a pixel is that of a box of the line's width, from the distance between the pixel's centre and the
line: lines have the same width everywhere, whatever their direction. Where lines meet, the darker one counts, so joints
are no darker than lines. They fade with depth, as ridges do in haze.

Lines lie on the drawn surface, so their depth equals the picture's except for the surface's slope within a pixel. A
point of a line is hidden if it lies behind all four pixel centres around it: that tolerance is as large as the surface
is steep there, neither more (hidden lines would show through) nor less (visible ones would be broken); a line just
behind a ridge may show for a pixel.

Units: pixels; depth in metres along the viewing direction, as in the picture.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.geo.grid import Grid
from orograph.geovis.color import srgb_to_linear
from orograph.parallel import map_ordered
from orograph.tessellation import Tessellation
from orograph.viewpoint import View

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

INK = srgb_to_linear(np.array([0.07, 0.09, 0.15], np.float32))
OPACITY = 0.86
FADE, FADED = 6.0, 0.5
"""Ground this many times as far away as the nearest has lines of this part of their opacity."""

WIDTH = 1.0
"""Width of a line in a picture whose shorter side has up to ``USUAL`` pixels; larger pictures, for print, have wider
ones."""

USUAL = 900

DENSE, FAINT = 5.0, 0.3
"""Lines between triangles less than this many pixels high would make one dark area: they are fainter, down to FAINT."""

SPARED = 0.85
"""The part of lines that is omitted where labels are."""

BANDS = 16


def draw_edges(
    linear: Colors,
    depth: Array,
    tessellation: Tessellation,
    grid: Grid,
    view: View,
    *,
    exaggeration: float = 1.0,
    width: float | None = None,
    gaps: Colors | None = None,
    jobs: int | None = None,
) -> None:
    """Draw a tessellation's edges over a picture.

    Args:
        linear: (height, width, 3) float32, linear light; changed.
        depth: (height, width) of the surface at pixel centres, NaN where no ground is.
        grid, view: of the terrain and of the picture.
        exaggeration: as the picture's.
        width: of the lines in pixels (default: 1, more in very large pictures).
        gaps: (height, width), 0 to 1: how much of each pixel is kept free for labels.
        jobs: threads.
    """
    width = max(WIDTH, WIDTH * min(depth.shape) / USUAL) if width is None else width
    ends = project(tessellation.positions(grid), tessellation.triangles, view, exaggeration)
    near = float(np.nanmin(depth)) if np.isfinite(depth).any() else 1.0
    ink = np.zeros(depth.shape, np.float32)
    parallel = view.projection == "plan"
    tall = -(-depth.shape[0] // BANDS)

    def band(row: int) -> None:
        draw_lines(ends, depth, parallel, width / 2, near, row, min(row + tall, depth.shape[0]), ink)

    for _ in map_ordered(band, range(0, depth.shape[0], tall), jobs):
        pass
    if gaps is not None:
        ink *= 1 - np.float32(SPARED) * gaps
    cover = (ink * np.float32(OPACITY))[..., None]
    linear *= 1 - cover
    linear += cover * INK


def edges_of(triangles: NDArray[np.int32], room: Array) -> tuple[NDArray[np.int64], Array]:
    """The edges (k, 2) of triangles (m, 3), each once, and for each the larger of its triangles' ``room`` (m,)."""
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    keys = ends[:, 0] << 32 | ends[:, 1]
    order = np.argsort(keys)
    keys = keys[order]
    first = np.flatnonzero(np.diff(keys, prepend=-1))
    widest = np.maximum.reduceat(np.repeat(room, 3)[order], first) if len(first) else np.empty(0)
    return np.stack([keys[first] >> 32, keys[first] & 0xFFFFFFFF], -1), widest


def project(positions: Array, triangles: NDArray[np.int32], view: View, exaggeration: float = 1.0) -> Array:
    """The edges of triangles on the screen: (k, 7) float64, pixel x, y and q of both ends, and a strength in 0 to 1.

    q is linear along a line on the screen: 1/depth in perspective, depth itself in a plan. Edges are cut at the near
    plane; those wholly in front of it, or beyond one side of the picture, are left out.

    Args:
        positions: (n, 3) true places in the view's CRS, metres. triangles: (m, 3) indices.
    """
    stretch = np.array([1.0, 1.0, exaggeration])
    axes = np.stack(view.axes(exaggeration))
    space = ((positions - np.array(view.eye)) * stretch) @ axes.T
    parallel = view.projection == "plan"
    if parallel:
        space[:, :2] = ((positions - np.array(view.target)) * stretch) @ axes[:2].T
    near = view.near if parallel else max(view.near, 1e-6 * max(1.0, float(np.abs(space[:, 2]).max(initial=0.0))))

    def screen(p: Array) -> Array:
        scale = view.pixel_metres if parallel else view.pixel_slope * p[:, 2]
        q = p[:, 2] if parallel else 1 / p[:, 2]
        return np.stack([p[:, 0] / scale + view.width / 2, view.height / 2 - p[:, 1] / scale, q], -1)

    before = space[:, 2] < near
    placed = screen(np.where(before[:, None], np.nan, space))[:, :2]
    edges, room = edges_of(triangles, np.nan_to_num(heights(placed[triangles]), nan=DENSE))
    kept = ~(before[edges[:, 0]] & before[edges[:, 1]])
    a, b = space[edges[kept, 0]], space[edges[kept, 1]]
    for here, there in ((a, b), (b, a)):
        cut = here[:, 2] < near
        part = ((near - here[cut, 2]) / (there[cut, 2] - here[cut, 2]))[:, None]
        here[cut] += part * (there[cut] - here[cut])
    strength = np.clip(room[kept] / DENSE, FAINT, 1.0)
    ends = np.concatenate([screen(a), screen(b), strength[:, None]], 1)
    x, y = ends[:, [0, 3]], ends[:, [1, 4]]
    seen = (x.max(1) > -2) & (x.min(1) < view.width + 2) & (y.max(1) > -2) & (y.min(1) < view.height + 2)
    return np.asarray(ends[seen])


def heights(corners: Array) -> Array:
    """The heights of triangles (m, 3, 2) over their longest sides, (m,)."""
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.sqrt((sides**2).sum(-1)).max(-1)
    area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    return np.asarray(area / np.maximum(longest, 1e-9))


@kernel
def draw_lines(
    ends: Array, depth: Array, parallel: bool, half: float, near: float, row0: int, row1: int, ink: Colors
) -> None:
    """Draw lines into the rows [row0, row1) of ``ink`` (height, width), 0 to 1.

    Args:
        ends: of ``project``. half: half of a line's width. near: the depth from which on lines fade.
    """
    height, width = depth.shape
    reach = half + 0.5
    for k in range(len(ends)):
        x0, y0, q0 = ends[k, 0], ends[k, 1], ends[k, 2]
        dx, dy, dq = ends[k, 3] - x0, ends[k, 4] - y0, ends[k, 5] - q0
        long = math.sqrt(dx * dx + dy * dy)
        # The part [t0, t1] within the band of rows and the picture's columns (Liang & Barsky).
        t0, t1 = 0.0, 1.0
        for axis in range(2):
            p, d = (x0, dx) if axis == 0 else (y0, dy)
            low, high = (-reach, width + reach) if axis == 0 else (row0 - reach, row1 + reach)
            if d == 0.0:
                if p < low or p > high:
                    t1 = -1.0
                continue
            a, b = (low - p) / d, (high - p) / d
            t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        if t0 > t1:
            continue
        strength = ends[k, 6]
        steep = abs(dy) > abs(dx)
        # Go pixel by pixel along its longer axis, and across it as far as the line reaches.
        p, d, o, e = (y0, dy, x0, dx) if steep else (x0, dx, y0, dy)
        slope = e / d if d != 0.0 else 0.0
        wide = reach * math.sqrt(1.0 + slope * slope)
        first = math.floor(min(p + t0 * d, p + t1 * d) - reach)
        last = math.floor(max(p + t0 * d, p + t1 * d) + reach)
        first = max(first, row0 if steep else 0)
        last = min(last, (row1 if steep else width) - 1)
        for m in range(first, last + 1):
            middle = o + (m + 0.5 - p) * slope
            c0 = max(math.floor(middle - wide - 0.5), 0 if steep else row0)
            c1 = min(math.floor(middle + wide + 0.5), (width if steep else row1) - 1)
            for c in range(c0, c1 + 1):
                i, j = (m, c) if steep else (c, m)
                t = 0.0
                if long > 0.0:
                    t = ((j + 0.5 - x0) * dx + (i + 0.5 - y0) * dy) / (long * long)
                    t = min(max(t, 0.0), 1.0)
                x, y = x0 + t * dx, y0 + t * dy
                away = math.sqrt((j + 0.5 - x) ** 2 + (i + 0.5 - y) ** 2)
                cover = min(1.0, 2.0 * half, reach - away) * strength
                if cover <= ink[i, j]:
                    continue
                q = q0 + t * dq
                w = q if parallel else 1.0 / q
                farthest = 0.0
                for n in range(4):
                    u = min(max(math.floor(x - 0.5) + (n & 1), 0), width - 1)
                    v = min(max(math.floor(y - 0.5) + (n >> 1), 0), height - 1)
                    ground = depth[v, u]
                    farthest = max(farthest, np.inf if ground != ground else ground)
                if w > farthest * (1.0 + 1e-3):
                    continue
                if not parallel:
                    haze = min(max(math.log(max(w, 1e-300) / near) / math.log(FADE), 0.0), 1.0)
                    cover *= 1.0 - (1.0 - FADED) * haze
                ink[i, j] = max(ink[i, j], cover)
