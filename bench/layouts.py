"""How much a refinement reads on a flight, by the order of vertices in memory or on disk.

    python bench/layouts.py [--size 4097] [--frames 120] [--tolerance 1] [--seed 7]

A flight at 60 frames per second and 240 m/s, 300 m above the ground of a synthetic terrain (``orograph synth``). Every
frame collects the vertices that SOAR looks at: those of the mesh, and the diamonds of its leaves. The table counts the
*tiles* of 65,536 entries of 16 bytes (1 MiB, the unit that the field reads) and the *blocks* of 256 entries (4 KiB, a
page of memory) that hold them, for three orders of the same entries:

* rows: one array, row by row;
* tiles: tiles of 256 × 256 samples of the full-resolution grid, blocks of 16 × 16 of them;
* hierarchical: the same by level, each level's vertices together (``orograph.lod.pages``).

``at once``: what a frame touches, the mean over the frames; ``new``: the part that the frame before did not touch.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orograph.lod.method import Goal
from orograph.lod.soar import Soar
from orograph.viewpoint import Camera, View
from synthetic import synthetic

Index = NDArray[np.int64]


def looked_at(keys: Index, n: int) -> tuple[Index, Index]:
    """(row, col) of the vertices of a strip and of the diamonds of its leaves, each once."""
    row, col = keys >> 32, keys & 0xFFFFFFFF
    found = [keys]
    sides = [slice(k, len(keys) - 2 + k) for k in range(3)]
    pairs = ((0, 1), (1, 2), (2, 0))
    squares = [(row[sides[a]] - row[sides[b]]) ** 2 + (col[sides[a]] - col[sides[b]]) ** 2 for a, b in pairs]
    longest = np.max(squares, axis=0)
    real = (np.min(squares, axis=0) > 0) & (longest > 2)  # no repeated vertices, no finest leaves
    for (a, b), square in zip(pairs, squares):
        these = real & (square == longest)
        found.append((keys[sides[a]][these] + keys[sides[b]][these]) >> 1)
    every = np.unique(np.concatenate(found))
    every = every[((every >> 32) % (1 << n) != 0) | ((every & 0xFFFFFFFF) % (1 << n) != 0)]  # corners are not diamonds
    return every >> 32, every & 0xFFFFFFFF


def rows_of(side: int) -> Callable[[Index, Index, int], Index]:
    return lambda row, col, entries: (row * side + col) // (entries * entries)


def tiles_of(row: Index, col: Index, entries: int) -> Index:
    return (row // entries) << 32 | col // entries


def hierarchical(top: int) -> Callable[[Index, Index, int], Index]:
    def place(row: Index, col: Index, entries: int) -> Index:
        lowest = (row | col) & -(row | col)
        level = np.minimum(np.log2(lowest).astype(np.int64), top)
        return level << 56 | ((row >> level) // entries) << 28 | (col >> level) // entries

    return place


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=4097)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--tolerance", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()
    terrain = synthetic(given.size, given.seed)
    grid, heights = terrain.grid, terrain.heights
    method = Soar(terrain)
    orders = {"rows": rows_of(terrain.side), "tiles": tiles_of, "hierarchical": hierarchical(terrain.levels - 1)}
    sizes = {"tiles": 256, "blocks": 16}
    touched: dict[tuple[str, str], list[int]] = {(o, s): [] for o in orders for s in sizes}
    new: dict[tuple[str, str], list[int]] = {(o, s): [] for o in orders for s in sizes}
    before: dict[tuple[str, str], Index] = {}
    triangles, vertices = [], []
    for frame in range(given.frames):
        col, row = 0.2 * given.size + 4 / 30 * frame, 0.7 * given.size - 2 / 30 * frame
        ahead = col + 200.0, row - 100.0
        eye = (*map(float, grid.xy(col, row)), float(heights[round(row), round(col)]) + 300.0)
        view = View(eye, (*map(float, grid.xy(*ahead)), eye[2] - 800.0), fov_y=60, width=1280, height=720)
        mesh, _ = method.mesh(Camera.over(terrain.grid, view), Goal(given.tolerance))
        r, c = looked_at(mesh.keys, terrain.n)
        triangles.append(mesh.triangles)
        vertices.append(len(r))
        for order, place in orders.items():
            for name, entries in sizes.items():
                places = np.unique(place(r, c, entries))
                touched[order, name].append(len(places))
                if frame:
                    new[order, name].append(len(np.setdiff1d(places, before[order, name], assume_unique=True)))
                before[order, name] = places
    print(
        f"{given.size}², {given.frames} frames, {given.tolerance:g} px: {np.mean(triangles):,.0f} triangles and "
        f"{np.mean(vertices):,.0f} vertices looked at per frame"
    )
    print(f"{'':14}{'tiles at once':>14}{'new':>8}{'blocks at once':>16}{'new':>8}")
    for order in orders:
        cells = [(np.mean(touched[order, s]), np.mean(new[order, s])) for s in sizes]
        print(f"{order:14}{cells[0][0]:14.1f}{cells[0][1]:8.2f}{cells[1][0]:16.0f}{cells[1][1]:8.1f}")


if __name__ == "__main__":
    main()
