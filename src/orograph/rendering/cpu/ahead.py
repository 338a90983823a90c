"""The program that compiles the kernels of light and colour while a first picture's ray caster compiles.

``python -m orograph.rendering.cpu.ahead LIGHT`` colours a small hill from depths that need no caster (see
``compiling``).
"""

from __future__ import annotations

import sys

from orograph._compiler import hasten

SIDE = 33
"""Samples of the hill along a side."""


def color_a_hill(light: str) -> None:
    """Light and colour a small hill without casting rays."""
    import numpy as np
    from affine import Affine

    from orograph.geo.grid import Grid
    from orograph.memo import Memo
    from orograph.rendering.cpu.ground import Ground
    from orograph.rendering.cpu.shading import Shader
    from orograph.rendering.survey import Survey
    from orograph.scene.camera import whole
    from orograph.scene.scene import Scene
    from orograph.store.memory import MemoryTerrain

    x = np.linspace(-2, 2, SIDE)
    heights = (300 * np.exp(-np.add.outer(x * x, x * x))).astype(np.float32)
    heights[20:28, 20:28] = heights[20:28, 20:28].min()  # a lake, so that the search for water is compiled
    terrain = MemoryTerrain(heights, Grid(heights.shape, Affine.scale(30, -30)), "hill")
    view = whole(terrain, (SIDE, SIDE))
    scene = Scene.of(terrain, view, light=light)
    ground = Ground.load(scene)
    px, py = (np.linspace(0.5, SIDE - 0.5, SIDE) for _ in range(2))
    depths = np.full(SIDE, np.linalg.norm(np.subtract(view.target, view.eye)))
    hits = ground.rays.meet(px, py, depths)
    shader = Shader(scene, ground, Survey(hits, px, py), Memo())
    shader.color(hits, px, py, np.ones(SIDE, bool), np.zeros(SIDE, bool))


if __name__ == "__main__":
    hasten()
    color_a_hill(sys.argv[1])
