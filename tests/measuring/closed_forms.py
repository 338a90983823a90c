"""Terrain whose measures are known, and the plain way to find those of any other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.geo.grid import Grid
from orograph.store import MemoryTerrain

Array = NDArray[np.float64]

SQUARE = Affine(30, 0, 500_000, 0, -30, 4_000_000)
RECTANGULAR = Affine(20, 0, 500_000, 0, -35, 4_000_000)
ROTATED = Affine.translation(500_000, 4_000_000) @ Affine.rotation(25) @ Affine.scale(25, -40)


def terrain_of(
    heights: NDArray[np.float32] | Array, transform: Affine = SQUARE, crs: str | None = None
) -> MemoryTerrain:
    grid = Grid(heights.shape, transform, None if crs is None else CRS.from_user_input(crs))
    return MemoryTerrain(np.asarray(heights, np.float32), grid, "ground")


def of_function(
    shape: tuple[int, int],
    function: Callable[[Array, Array], Array],
    transform: Affine = SQUARE,
    crs: str | None = None,
) -> MemoryTerrain:
    """Heights as a function of easting and northing."""
    x, y = Grid(shape, transform).xy(*np.meshgrid(np.arange(shape[1]), np.arange(shape[0])))
    return terrain_of(function(x, y), transform, crs)


def rough(shape: tuple[int, int], seed: int = 0, holes: bool = False) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    h = 500 + 150 * np.sin(x / 9 + seed) * np.cos(y / 7) + rng.normal(0, 8, shape)
    if holes:
        h[shape[0] // 3 : shape[0] // 3 + 3, shape[1] // 4 : shape[1] // 2] = np.nan
        h[rng.random(shape) < 0.02] = np.nan
    return h.astype(np.float32)


def points_in(terrain: MemoryTerrain, rng: np.random.Generator, n: int) -> Array:
    """Random points of the surface."""
    rows, cols = terrain.grid.shape
    return np.stack(terrain.grid.xy(rng.uniform(0, cols - 1, n), rng.uniform(0, rows - 1, n)), axis=-1)
