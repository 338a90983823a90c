"""Ways to make test terrain, and plain references of what the store computes, written from the definitions."""

from __future__ import annotations

import numpy as np
from affine import Affine
from pyproj import CRS

from orograph import store
from orograph.geo.grid import Grid


def grid_of(shape: tuple[int, int], crs: str | None = "EPSG:32611") -> Grid:
    return Grid(shape, Affine(30, 0, 500_000, 0, -30, 4_000_000), None if crs is None else CRS.from_user_input(crs))


def rough(shape: tuple[int, int], seed: int = 0, missing: float = 0.0, hole: bool = False) -> np.ndarray:
    """Hills with noise; some samples missing at random, and one large rectangle of nothing."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    heights = 800 + 300 * np.sin(x / 17) * np.cos(y / 23) + rng.normal(0, 5, shape)
    heights[rng.random(shape) < missing] = np.nan
    if hole:
        heights[shape[0] // 4 : shape[0] // 2, : 2 * shape[1] // 3] = np.nan
    return heights.astype(np.float32)


def source(heights: np.ndarray, crs: str | None = "EPSG:32611") -> store.ArraySource:
    return store.ArraySource(heights, grid_of(heights.shape, crs), "rough", "EGM96 height")


def nested(heights: np.ndarray, level: int) -> np.ndarray:
    """Level ``level`` by its definition: sample (i, j) is H[min(i·2^k, rows-1), min(j·2^k, cols-1)]."""
    rows, cols = heights.shape
    step = 2**level
    i = [min(i * step, rows - 1) for i in range(int(np.ceil((rows - 1) / step)) + 1)]
    j = [min(j * step, cols - 1) for j in range(int(np.ceil((cols - 1) / step)) + 1)]
    return heights[np.ix_(i, j)]


def box_means(heights: np.ndarray, level: int) -> np.ndarray:
    """The mean of the valid samples of each 2^level × 2^level block."""
    step = 2**level
    rows, cols = (int(np.ceil(side / step)) for side in heights.shape)
    means = np.full((rows, cols), np.nan)
    for i in range(rows):
        for j in range(cols):
            block = heights[i * step : (i + 1) * step, j * step : (j + 1) * step].astype(np.float64)
            if not np.isnan(block).all():
                means[i, j] = np.nanmean(block)
    return means


def largest_distances(heights: np.ndarray, level: int, tile: int = 256) -> np.ndarray:
    """Per tile, the largest distance of a sample from a level's triangles it lies in (borders included)."""
    rows, cols = heights.shape
    step = 2**level
    coarse = nested(heights, level).astype(np.float64)
    shape = [max(1, int(np.ceil((side - 1) / tile))) for side in coarse.shape]
    worst = np.zeros(shape)
    for i in range(coarse.shape[0] - 1):
        for j in range(coarse.shape[1] - 1):
            p00, p01, p10, p11 = (0, 0), (0, 1), (1, 0), (1, 1)
            if (i + j) % 2 == 0:
                triangles = [(p00, p10, p11), (p00, p01, p11)]
            else:
                triangles = [(p00, p01, p10), (p11, p01, p10)]
            r = np.arange(i * step, min((i + 1) * step, rows - 1) + 1)
            c = np.arange(j * step, min((j + 1) * step, cols - 1) + 1)
            v, u = np.meshgrid((r - i * step) / step, (c - j * step) / step, indexing="ij")
            for corners in triangles:
                matrix = np.array([[a, b, 1] for a, b in corners], float)
                values = np.array([coarse[i + a, j + b] for a, b in corners])
                weights = np.stack([v, u, np.ones_like(v)], -1) @ np.linalg.inv(matrix)  # barycentric
                inside = (weights >= -1e-9).all(axis=-1)
                distance = np.abs(heights[np.ix_(r, c)] - weights @ values)[inside]
                if not np.isnan(distance).all():
                    at = i // tile, j // tile
                    worst[at] = max(worst[at], np.nanmax(distance))
    return worst


def surface(heights: np.ndarray, level: int, y: float, x: float) -> float:
    """The height of a level's surface at sample coordinates inside a cell; NaN in a hole."""
    step = 2**level
    coarse = nested(heights, level).astype(np.float64)
    i, j = int(y // step), int(x // step)
    v, u = y / step - i, x / step - j
    a, b, c, d = coarse[i, j], coarse[i, j + 1], coarse[i + 1, j], coarse[i + 1, j + 1]
    if (i + j) % 2 == 0:
        return a + v * (c - a) + u * (d - c) if u < v else a + u * (b - a) + v * (d - b)
    return a + u * (b - a) + v * (c - a) if u + v < 1 else d + (1 - u) * (c - d) + (1 - v) * (b - d)
