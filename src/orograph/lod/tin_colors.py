"""How much the TINs of diamonds change colours: the largest of each diamond, made monotonic.

As for the diamonds of the regular hierarchy (``geovis.color_errors``), but with the TINs' own triangles: with eL, ea
and eb the largest differences of the three channels of CIELAB between the samples in both patches and the colours
interpolated between the corners of their triangles, no sample's colour is off by more than sqrt(eL² + ea² + eb²). Then
errors are made no less than those of the diamonds below. The finest patches are the samples themselves. ΔE*ab.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from orograph.lod.quadtin_colors import Window, largest_changes
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress
from orograph.store.patches import by_level, octave_shape, saturate
from orograph.store.terrain import Heights, Terrain
from orograph.store.tin_diamonds import Workplace, tins_of
from orograph.store.tins import Tins, octaves

BLOCK = 512
"""Minimum samples along the side of a block of diamonds whose colours are looked at together."""


def color_errors(
    terrain: Terrain, tins: Tins, window: Window, *, jobs: int, progress: Progress = SILENT
) -> list[Heights]:
    """Color errors of all diamonds with TINs, in the layout of ``diamond_table``; 0 elsewhere.

    Args:
        terrain, tins: the ground. window: colours of its samples. jobs: threads. progress: gets reports on blocks.
    """
    found: dict[int, Heights] = {}
    workplace, below = Workplace(), None
    todo = {k: blocks_of(terrain, tins, k) for k in octaves(terrain.grid.shape, tins.legs)}

    def measured(block: NDArray[np.int64]) -> NDArray[np.float32]:
        return changes(terrain, tins, block, window, workplace)

    with progress.task("Colors of TINs", sum(map(len, todo.values()))) as task:
        for k, blocks in todo.items():
            here = np.zeros(octave_shape(terrain, k), np.float32)
            for block, errors in zip(blocks, map_ordered(measured, blocks, jobs), strict=True):
                here[block[:, 0] >> k, block[:, 1] >> k] = errors
                task.advance()
            saturate(here, below, 1.0)
            found[k] = below = here
    return by_level(terrain, found)


def blocks_of(terrain: Terrain, tins: Tins, octave: int) -> list[NDArray[np.int64]]:
    """The diamonds of an octave that have TINs, (d, 2) rows and columns, by blocks of the raster."""
    level = min(octave, terrain.levels - 1)
    step = 1 << (octave - level)
    rows, cols = octave_shape(terrain, octave)
    errors, radii = (
        part[::step, ::step] for part in tins.read(level, 0, (rows - 1) * step + 1, 0, (cols - 1) * step + 1)
    )
    i, j = np.nonzero((errors >= 0) & (radii >= 0))
    own = ((i | j) & 1).astype(bool)  # others are of coarser octaves
    places = np.stack([i[own], j[own]], -1).astype(np.int64) << octave
    side = max(BLOCK, 2 << octave)
    block = places // side
    ends = block.max(0, initial=-1) + 1
    parts = [places[(block == at).all(1)] for at in product(*map(range, ends.tolist()))]
    return [part for part in parts if len(part)]


def changes(
    terrain: Terrain, tins: Tins, block: NDArray[np.int64], window: Window, workplace: Workplace
) -> NDArray[np.float32]:  # fmt: skip
    """The color errors (d,) of diamonds, before they are made monotonic."""
    vertices, corners, owner, count = [], [], [], 0
    for d, (row, col) in enumerate(block.tolist()):
        own, *patches = tins_of(terrain, tins, row, col, workplace)
        for patch in patches:
            corners.append(patch.reshape(-1, 3).astype(np.int32) + count)
            owner.append(np.full(len(corners[-1]), d, np.int32))
        vertices.append(own)
        count += len(own)
    places = np.concatenate(vertices)
    first, last = (f(places[:, :2], 0).astype(np.int64)[::-1].tolist() for f in (np.min, np.max))
    places[:, :2] -= first[::-1]

    def colors(row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
        return window(row0 + first[0], row1 + first[0], col0 + first[1], col1 + first[1])

    shape = last[0] - first[0] + 1, last[1] - first[1] + 1
    return largest_changes(places, np.concatenate(owner), np.concatenate(corners), len(block), shape, colors)
