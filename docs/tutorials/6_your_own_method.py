"""
Your own method
===============

A method is a class that selects triangles for a camera. Once it is registered, every verb knows it. (For details see
`How to add a method <../methods/adding.html>`_.)
"""

# %%
# This one takes a grid of every k-th sample, the same for every view: simple, but with no promised error.

from dataclasses import dataclass

import numpy as np

import orograph
from orograph.lod.method import EVERYTHING, Method, MethodInfo
from orograph.lod.options import check, option
from orograph.lod.registry import register
from orograph.lod.selection import TriangleMesh
from orograph.sample import jacksboro
from orograph.tessellation import Tessellation, turn


@dataclass(frozen=True, slots=True, kw_only=True)
class EveryOptions:
    """Options of ``every``."""

    step: int = option(8, "Samples from vertex to vertex.", least=1, most=256)

    def __post_init__(self) -> None:
        check(self)


class Every(Method):
    """Every k-th sample."""

    info = MethodInfo(
        "every", "every k-th sample, whatever the view", "a tutorial", "triangles", EveryOptions, lambda options: False,
        goals=("tolerance",),
    )  # fmt: skip

    def select(self, camera, goal, ready=EVERYTHING):
        rows, cols = self.terrain.grid.shape
        step = self.options.step
        r, c = (np.unique([*range(0, n, step), n - 1]) for n in (rows, cols))
        heights = self.terrain.read(0, 0, rows, 0, cols)[np.ix_(r, c)]
        col, row = np.meshgrid(c, r)
        vertices = np.stack([col, row, heights], -1, dtype=np.float64).reshape(-1, 3)
        i, j = np.mgrid[: len(r) - 1, : len(c) - 1].reshape(2, -1)
        nw, sw = i * len(c) + j, (i + 1) * len(c) + j
        triangles = np.concatenate([np.stack([nw, sw, sw + 1], -1), np.stack([nw, sw + 1, nw + 1], -1)])
        triangles = triangles[~np.isnan(vertices[triangles, 2]).any(1)]
        if turn(self.terrain.grid) > 0:
            triangles = triangles[:, ::-1]
        mesh = Tessellation(vertices, triangles.astype(np.int32), None, {"method": "every"})
        return TriangleMesh(method="every", bound=None, stats={"method": "every"}, mesh=mesh)


register(Every)

# %%
# From now on it is a method like any other:

terrain = orograph.terrain(jacksboro(), progress=False)
picture = orograph.render(terrain, size=(960, 540), method="every,step=12", wireframe=True, exaggeration=1.5)

# %%
# The referee shows how good it is:

orograph.compare(terrain, methods=["every,step=12", "soar"], tolerance=2, size=(640, 360), progress=False)
