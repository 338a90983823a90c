"""The tiles of shading that a view wants: for each place in view, those of the level whose samples are a pixel large.

A tile is wanted if it is in the frustum and the tile above it is too coarse: its samples are larger than a pixel at
the nearest point. So the tiles of all coarser levels are wanted as
well, as the blend between levels needs them, and coarser ones come first. The boxes of all tiles are laid out once,
coarsest level first; a view is one pass over them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.raycast.finer import distance, in_view
from orograph.raycast.select import tile_boxes
from orograph.rendering.gpu.stream.tiles import Tables
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

Array = NDArray[np.float64]


@kernel
def _wanted(tiles, planes, eye, scale, per_metre, plan, most, grow, priority, out):
    """Write the indices of the wanted tiles to ``out``; return their number.

    Args:
        tiles: boxes (n, 6) west, east, north, south, low, high, NaN heights where a tile is empty; parents (n,), −1 at
            the top; sizes (n,) metres between the samples of a tile's level.
        planes: (m, 4) over column, row and height. eye: column, row, height. scale: metres per column and row, and the
            exaggeration.
        per_metre: pixels of a metre at unit distance, or anywhere in a plan. most: largest sample, pixels.
        grow: uint8 (n,), whether a tile is too coarse. priority: (n,) of those wanted.
    """
    boxes, parents, sizes = tiles
    count = 0
    for i in range(len(boxes)):
        grow[i] = 0
        p = parents[i]
        if p >= 0 and grow[p] == 0:
            continue
        west, east, north, south = boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3]
        low, high = boxes[i, 4], boxes[i, 5]
        if low != low:
            continue
        if not in_view(planes, west, east, north, south, low, high):
            continue
        if plan:
            pixels = sizes[i] * per_metre
        else:
            pixels = sizes[i] * per_metre / max(distance(eye, scale, west, east, north, south, low, high), 1e-9)
        grow[i] = 1 if pixels > most else 0
        priority[i] = 2.0 * pixels if p >= 0 else 1e9
        out[count] = i
        count += 1
    return count


class Tree:
    """Tiles of all levels over a terrain, examined in one pass.

    Args:
        terrain: the ground below them.
        boxes: (n, 6) west, east, north, south in sample coordinates, lowest and highest height (NaN: never wanted),
            coarsest level first. parents: (n,) places of the tiles above, −1 at the top. sizes: (n,) metres between the
            samples of a tile.
    """

    def __init__(self, terrain: Terrain, boxes: Array, parents: NDArray[np.int64], sizes: Array) -> None:
        self.terrain, self.boxes, self.parents, self._sizes = terrain, boxes, parents, sizes
        across, down = terrain.chart.least_steps
        self._steps = float(across), float(down)
        n = len(sizes)
        self._found: tuple[Any, tuple[NDArray[np.int64], Array]] | None = None
        self._grow, self._priority, self._out = np.zeros(n, np.uint8), np.zeros(n), np.zeros(n, np.int64)

    def of(self, view: View, exaggeration: float, *, pixels: float = 1.0) -> tuple[NDArray[np.int64], Array]:
        """The tiles wanted: which, and how many pixels their parents' samples are large; not to be written to.

        Args:
            pixels: allowed size of samples.
        """
        if self._found is not None and self._found[0] == (view, exaggeration, pixels):
            return self._found[1]
        planes = np.array(self.terrain.chart.planes(view.frustum(exaggeration).tolist(), exaggeration))
        col, row = self.terrain.grid.index(view.eye[0], view.eye[1])
        plan = view.projection == "plan"
        count = _wanted(
            (self.boxes, self.parents, self._sizes), planes, (float(col), float(row), view.eye[2]),
            (*self._steps, float(exaggeration)), 1.0 / (view.pixel_metres if plan else view.pixel_slope), plan, pixels,
            self._grow, self._priority, self._out,
        )  # fmt: skip
        found = self._out[:count].copy()
        self._found = (view, exaggeration, pixels), (found, self._priority[found])
        return self._found[1]


class SlopeTiles(Tree):
    """The slope tiles of a terrain.

    Attributes:
        index: (n,) int64, the places of all tiles in a page table (``tiles.Tables``), coarsest level first.
    """

    def __init__(self, terrain: Terrain) -> None:
        tables = Tables.of(terrain)
        boxes, parents, sizes, index = [], [], [], []
        begin, above = 0, 0
        spacing = max(terrain.grid.spacing)
        for level in range(terrain.levels - 1, -1, -1):
            b = tile_boxes(terrain, level)
            rows, cols = b.low.shape
            r, c = (a.ravel() for a in np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"))
            boxes.append(np.stack([a.ravel() for a in (b.west, b.east, b.north, b.south, b.low, b.high)], 1))
            if level == terrain.levels - 1:
                parents.append(np.full(len(r), -1))
            else:
                pr, pc = tables.shapes[level + 1]
                parents.append(above + np.minimum(r // 2, pr - 1) * pc + np.minimum(c // 2, pc - 1))
            sizes.append(np.full(len(r), spacing * 2.0**level))
            index.append(tables.offsets[level] + r * cols + c)
            above, begin = begin, begin + len(r)
        super().__init__(
            terrain, np.concatenate(boxes), np.concatenate(parents).astype(np.int64), np.concatenate(sizes)
        )
        self.index = np.concatenate(index).astype(np.int64)
