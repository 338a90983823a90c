"""What every pixel sees of the full-resolution surface, by brute force: each ray walks from cell to cell.

A cell holds two unit triangles, cut by its diagonal; while the ray is over one of them its height above it is linear.
Where that changes its sign the ray meets the surface, from whichever side. Rounding may show two signs at an edge that
two units share: that counts as a hit there, so that no ray slips through. Terrain is read tile by tile, nearer tiles
first, each for the pixels on which its box falls. Depths are metres along the viewing direction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph._numba import inlined, kernel, leaf, read_only
from orograph.parallel import for_each, map_ordered
from orograph.store.terrain import TILE, Terrain
from orograph.verify.frustum import Camera
from orograph.verify.ground import Ground, exists
from orograph.verify.strips import corners
from orograph.viewpoint import View

ROWS = 32
"""Rows of pixels that a thread takes at once."""


class Rays(NamedTuple):
    """The rays of a picture: at pixel position (px, py) and depth t the place in sample coordinates is

    start + (px, py)·across + t·(forward + (px, py)·turn), with vectors of (column, row, height); depths near … far.
    """

    start: NDArray[np.float64]
    across: NDArray[np.float64]
    forward: NDArray[np.float64]
    turn: NDArray[np.float64]
    near: float
    far: float

    @classmethod
    def of(cls, camera: Camera, view: View) -> Rays:
        """The rays of a camera, from its matrix."""
        lens = camera.lens
        inverse = np.linalg.inv(lens.matrix[:, :3])
        pixels = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]) @ inverse.T  # what a pixel to the right and down adds
        middle = -view.width / 2 * pixels[0] - view.height / 2 * pixels[1]
        start = lens.p0 * middle - inverse @ lens.matrix[:, 3]
        return cls(start, lens.p0 * pixels, inverse[:, 2] + lens.p1 * middle, lens.p1 * pixels, lens.near, lens.far)

    def places(self, depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where the pixels' centres are at the depths (h, w) of an image: (h, w, 3)."""
        y, x = np.indices(depth.shape) + 0.5
        pixels = np.stack([x, y], -1)
        return np.asarray(self.start + pixels @ self.across + depth[..., None] * (self.forward + pixels @ self.turn))


class Span(NamedTuple):
    """Pixels [left, right) × [top, bottom), and the heights between which ground lies there."""

    left: int
    top: int
    right: int
    bottom: int
    low: float
    high: float


def true_depth(terrain: Terrain, camera: Camera, view: View, jobs: int | None) -> NDArray[np.float64]:
    """The depth (h, w) at which each pixel's ray first meets the full-resolution surface; NaN where it does not."""
    rays = Rays.of(camera, view)
    best = np.full((view.height, view.width), np.inf)

    def read(tile: tuple[int, int, Span]) -> tuple[Ground, Span]:
        i, j, span = tile
        rows, cols = terrain.grid.shape
        top, west = max(i * TILE - 1, 0), max(j * TILE - 1, 0)
        bottom, east = min((i + 1) * TILE + 2, rows), min((j + 1) * TILE + 2, cols)
        heights = read_only(np.ascontiguousarray(terrain.read(0, top, bottom, west, east)))
        return Ground(heights, top, west, rows, cols), span

    for ground, span in map_ordered(read, tiles(terrain, camera, view), jobs):
        if min(ground.heights.shape) > 1:
            parts = [
                span._replace(top=a, bottom=min(a + ROWS, span.bottom)) for a in range(span.top, span.bottom, ROWS)
            ]
            for_each(partial(walk, ground, rays, best), parts, jobs)
    return np.where(np.isfinite(best), best, np.nan)


def tiles(terrain: Terrain, camera: Camera, view: View) -> Iterator[tuple[int, int, Span]]:
    """The tiles that may be seen, nearer ones first: row and column of each, and the pixels on which it may fall."""
    table, lens = terrain.tiles(0), camera.lens
    i, j = np.nonzero(table.valid)
    low = np.stack([j * TILE - 1, i * TILE - 1, table.minimum[i, j]], -1).astype(np.float64)
    high = np.stack([(j + 1) * TILE + 1, (i + 1) * TILE + 1, table.maximum[i, j]], -1).astype(np.float64)
    slack = 1e-6 * (1.0 + np.abs(low[:, 2]) + np.abs(high[:, 2]))
    low[:, 2] -= slack
    high[:, 2] += slack
    pick = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)], bool)
    boxes = np.where(pick, high[:, None], low[:, None])  # (n, 8, 3)
    x, y, w = np.moveaxis(boxes @ lens.matrix[:, :3].T + lens.matrix[:, 3], -1, 0)
    before = (w > 0).all(1) | (lens.p1 == 0)
    scale = np.where(before[:, None], lens.p0 + lens.p1 * w, 1.0)
    px, py = x / scale + view.width / 2, view.height / 2 - y / scale
    missed = camera.misses(low, high)
    for k in np.argsort(w.min(1)):
        span = Span(0, 0, view.width, view.height, float(low[k, 2]), float(high[k, 2]))
        if before[k]:
            left, right = np.clip([px[k].min() - 1, px[k].max() + 2], 0, view.width).astype(int).tolist()
            top, bottom = np.clip([py[k].min() - 1, py[k].max() + 2], 0, view.height).astype(int).tolist()
            span = span._replace(left=left, top=top, right=right, bottom=bottom)
        if not missed[k] and span.left < span.right and span.top < span.bottom:
            yield int(i[k]), int(j[k]), span


@leaf
def clip(origin, step, low, high, near, far):
    """The part [near, far] of a ray along which one of its coordinates is between two values."""
    if step == 0.0:
        return (near, far) if low <= origin <= high else (np.inf, -np.inf)
    a, b = (low - origin) / step, (high - origin) / step
    return max(near, min(a, b)), min(far, max(a, b))


@inlined
def above(ground, column, row, half, x, y, z):
    """How far a point lies above the plane of a unit triangle."""
    c0, r0, c1, r1, c2, r2 = corners(column, row, half)
    heights, top, west = ground.heights, ground.top, ground.west
    h0 = np.float64(heights[r0 - top, c0 - west])
    h1, h2 = np.float64(heights[r1 - top, c1 - west]) - h0, np.float64(heights[r2 - top, c2 - west]) - h0
    bx, by, cx, cy = c1 - c0, r1 - r0, c2 - c0, r2 - r0
    area = bx * cy - cx * by
    u, v = (x - c0) * cy - (y - r0) * cx, (y - r0) * bx - (x - c0) * by
    return z - h0 - (u * h1 + v * h2) / area


@leaf
def first_hit(ground, ox, oy, oz, dx, dy, dz, near, far):
    """The least t in [near, far], over a window, at which the ray meets the surface; infinite if it does not."""
    west, top = ground.west, ground.top
    last_column, last_row = west + ground.heights.shape[1] - 2, top + ground.heights.shape[0] - 2
    t, before = near, np.nan
    column = min(max(np.int64(math.floor(ox + t * dx)), west), last_column)
    row = min(max(np.int64(math.floor(oy + t * dy)), top), last_row)
    while True:
        tx = ((column + (dx > 0.0)) - ox) / dx if dx != 0.0 else np.inf
        ty = ((row + (dy > 0.0)) - oy) / dy if dy != 0.0 else np.inf
        end = max(min(tx, ty, far), t)
        even = (column + row) & 1 == 0
        # Which side of the diagonal: of unit 0 it is the positive one.
        ax, ay, bx, by = ox + t * dx - column, oy + t * dy - row, ox + end * dx - column, oy + end * dy - row
        p, q = (ax - ay, bx - by) if even else (1.0 - ax - ay, 1.0 - bx - by)
        cut = t + (end - t) * (p / (p - q)) if (p > 0.0 and q < 0.0) or (p < 0.0 and q > 0.0) else end
        for part in range(2 if cut < end else 1):
            a, b = (t, cut) if part == 0 else (cut, end)
            side = p + q if cut >= end else (p if part == 0 else q)
            half = 0 if side >= 0.0 else 1
            if not exists(ground, column, row, half):
                before = np.nan
                continue
            at_a = above(ground, column, row, half, ox + a * dx, oy + a * dy, oz + a * dz)
            at_b = above(ground, column, row, half, ox + b * dx, oy + b * dy, oz + b * dz)
            if at_a == 0.0 or (before > 0.0 and at_a < 0.0) or (before < 0.0 and at_a > 0.0):
                return a
            if at_b == 0.0 or (at_a > 0.0 and at_b < 0.0) or (at_a < 0.0 and at_b > 0.0):
                return a + (b - a) * (at_a / (at_a - at_b))
            before = at_b
        if end >= far:
            return np.inf
        if tx <= ty:
            column += 1 if dx > 0.0 else -1
        else:
            row += 1 if dy > 0.0 else -1
        if column < west or column > last_column or row < top or row > last_row:
            return np.inf
        t = end


@kernel
def walk(ground, rays, best, span):
    """Lower ``best``, (h, w) depths, to those at which rays meet the surface in a window."""
    west, top = np.float64(ground.west), np.float64(ground.top)
    east, bottom = west + ground.heights.shape[1] - 1, top + ground.heights.shape[0] - 1
    for py in range(span.top, span.bottom):
        for px in range(span.left, span.right):
            x, y = px + 0.5, py + 0.5
            ox = rays.start[0] + x * rays.across[0, 0] + y * rays.across[1, 0]
            oy = rays.start[1] + x * rays.across[0, 1] + y * rays.across[1, 1]
            oz = rays.start[2] + x * rays.across[0, 2] + y * rays.across[1, 2]
            dx = rays.forward[0] + x * rays.turn[0, 0] + y * rays.turn[1, 0]
            dy = rays.forward[1] + x * rays.turn[0, 1] + y * rays.turn[1, 1]
            dz = rays.forward[2] + x * rays.turn[0, 2] + y * rays.turn[1, 2]
            near, far = clip(oz, dz, span.low, span.high, rays.near, min(rays.far, best[py, px]))
            near, far = clip(ox, dx, west, east, near, far)
            near, far = clip(oy, dy, top, bottom, near, far)
            if near <= far:
                best[py, px] = min(best[py, px], first_hit(ground, ox, oy, oz, dx, dy, dz, near, far))
