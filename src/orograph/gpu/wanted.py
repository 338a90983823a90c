"""Which slope tiles a view wants: for each place in view, those of the level whose samples are a pixel large there.

A tile is wanted if it is in the frustum and the tile above it is too coarse: its samples are larger than a pixel at the
nearest point. So the tiles of all coarser levels are wanted as well, as the blend between levels needs them, and
coarser ones come first. Boxes of tiles are computed once a level.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.tiles import Key
from orograph.raycast.select import Boxes, in_frustum, spacing_error, tile_boxes
from orograph.store.terrain import Terrain
from orograph.view import View


class SlopeTiles:
    """Asks a terrain's levels, coarsest first."""

    def __init__(self, terrain: Terrain) -> None:
        self.terrain = terrain
        self._boxes: dict[int, Boxes] = {}

    def of(self, view: View, exaggeration: float, *, pixels: float = 1.0) -> list[tuple[float, Key]]:
        """(priority, key) of the tiles wanted.

        Args:
            pixels: how large samples may be. Priorities are pixels that a tile's parent's samples are large.
        """
        out: list[tuple[float, Key]] = []
        top = self.terrain.levels - 1
        parents: NDArray[np.bool_] | None = None
        sizes: NDArray[np.float64] | None = None
        for level in range(top, -1, -1):
            boxes = self._level(level)
            shape = boxes.low.shape
            inside = in_frustum(self.terrain, view, exaggeration, boxes)
            if parents is not None and sizes is not None:
                r, c = np.arange(shape[0]) // 2, np.arange(shape[1]) // 2
                r, c = np.minimum(r, parents.shape[0] - 1), np.minimum(c, parents.shape[1] - 1)
                inside &= parents[np.ix_(r, c)]
                priority = sizes[np.ix_(r, c)]
            else:
                priority = np.full(shape, 1e6)
            rows, cols = np.nonzero(inside)
            out += [(float(p), (level, int(i), int(j))) for p, i, j in zip(priority[rows, cols], rows, cols)]
            sizes = spacing_error(self.terrain, view, exaggeration, level, boxes)
            parents = inside & (sizes > pixels)
            if not parents.any():
                break
        return out

    def _level(self, level: int) -> Boxes:
        if level not in self._boxes:
            self._boxes[level] = tile_boxes(self.terrain, level)
        return self._boxes[level]
