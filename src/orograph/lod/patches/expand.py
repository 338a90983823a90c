"""Patches as triangles, the slow way without a GPU: for the referee, for files, and as the reference for drawing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.lod.patches.shape import STEPS, patch_indices, patch_vertices
from orograph.store.terrain import TILE, Heights, Terrain


def expand(terrain: Terrain, instances: NDArray[Any], legs: int) -> tuple[NDArray[np.int64], Heights]:
    """The triangles of patches, geomorphs applied; those with a missing corner are left out.

    Args:
        instances: (k,) of ``shape.INSTANCE``.
        legs: L.

    Returns:
        keys: (m, 3) int64, ``row << 32 | col`` on the padded square. heights: (m, 3) float32, metres.
    """
    points = patch_vertices(legs).astype(np.int64)
    triangles = patch_indices(legs).astype(np.int64)
    e1, e2 = STEPS[instances["omega"]].astype(np.int64).transpose(1, 0, 2)
    step = instances["step"].astype(np.int64)[:, None]
    rows = instances["row"][:, None] + ((points[:, 0] * e1[:, :1] + points[:, 1] * e2[:, :1]) << step)
    cols = instances["col"][:, None] + ((points[:, 0] * e1[:, 1:] + points[:, 1] * e2[:, 1:]) << step)
    own = heights_of(terrain, instances, rows, cols)
    at = -np.ones((legs + 1, legs + 1), np.int64)
    at[points[:, 0], points[:, 1]] = np.arange(len(points))
    new = np.flatnonzero((points.sum(1) % 2 == 1) & (points.sum(1) < legs))  # none, if a patch is one triangle
    odd = points[new] % 2
    before, after = (at[tuple((points[new] + sign * odd).T)] for sign in (-1, 1))
    last_row, last_col = terrain.grid.rows - 1, terrain.grid.cols - 1
    inside = (rows <= last_row) & (cols <= last_col)
    middle = (own[:, before] + own[:, after]) * np.float32(0.5)
    moves = inside[:, before] & inside[:, after] & ~np.isnan(middle)
    morph = instances["morph"][:, None]
    drawn = own.copy()
    drawn[:, new] = np.where(moves, middle + (own[:, new] - middle) * morph, own[:, new])
    drawn[:, new] = np.where(moves & (morph < 1.0), drawn[:, new], own[:, new])
    keys = (rows << 32 | cols)[:, triangles].reshape(-1, 3)
    heights = drawn[:, triangles].reshape(-1, 3)
    whole = ~np.isnan(heights).any(1)
    return keys[whole], heights[whole]


def heights_of(terrain: Terrain, instances: NDArray[Any], rows: NDArray[np.int64], cols: NDArray[np.int64]) -> Heights:
    """Heights of the patches' lattice points (k, points), tile by tile; NaN where missing."""
    result = np.empty(rows.shape, np.float32)
    names = np.stack([instances[name].astype(np.int64) for name in ("level", "tile_row", "tile_col")], 1)
    tiles, which = np.unique(names, axis=0, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    ends = np.searchsorted(which.ravel()[order], np.arange(len(tiles) + 1))
    for number, (level, i, j) in enumerate(tiles.tolist()):
        here = order[ends[number] : ends[number + 1]]
        high, wide = terrain.shape(level)
        row0, col0 = i * TILE, j * TILE
        tile = terrain.read(level, row0, min(row0 + TILE + 1, high), col0, min(col0 + TILE + 1, wide))
        r = np.minimum((rows[here] >> level) - row0, tile.shape[0] - 1)
        c = np.minimum((cols[here] >> level) - col0, tile.shape[1] - 1)
        result[here] = tile[r, c]
    return result
