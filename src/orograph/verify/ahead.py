"""The program that compiles the referee's kernels while those of what it will judge are compiled.

``python -m orograph.verify.ahead mesh`` judges every fourth sample of a small hill as a mesh (see ``compiling``).
"""

from __future__ import annotations

from orograph._compiler import hasten

SIDE, STEP = 33, 4
"""Samples of the hill along a side, and from one vertex of the mesh to the next."""


def judge_a_hill() -> None:
    """Judge a coarse mesh of a small hill."""
    import numpy as np
    from affine import Affine

    from orograph.geo.grid import Grid
    from orograph.store.memory import MemoryTerrain
    from orograph.tessellation import Tessellation
    from orograph.verify.judge import judge_mesh
    from orograph.viewpoint import View

    x = np.linspace(-2, 2, SIDE)
    heights = (300 * np.exp(-np.add.outer(x * x, x * x))).astype(np.float32)
    terrain = MemoryTerrain(heights, Grid(heights.shape, Affine.scale(30, -30)), "hill")
    rows, cols = np.mgrid[:SIDE:STEP, :SIDE:STEP]
    vertices = np.stack([cols, rows, heights[rows, cols]], -1).reshape(-1, 3).astype(np.float64)
    places = np.arange(len(vertices), dtype=np.int32).reshape(rows.shape)
    a, b, c, d = places[:-1, :-1], places[:-1, 1:], places[1:, :-1], places[1:, 1:]
    triangles = np.stack([a, c, d, a, d, b], -1).reshape(-1, 3)
    judge_mesh(Tessellation(vertices, triangles), terrain, View((480, -1500, 700), (480, -480, 0)), jobs=1)


if __name__ == "__main__":
    hasten()
    judge_a_hill()
