"""A second process that compiles what a first picture needs last, while the first compiles what it needs first.

Numba compiles one kernel at a time in a process. A picture needs its ray caster, and after that the kernels of light
and colour, which take as long: ``while_compiling`` starts this module as a program at the first kernel that is compiled,
and it colours a small hill by depths that need no caster. Each finds the other's kernels in Numba's cache.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from orograph.compiling import COMPILING

SIDE = 33
"""Samples of the hill along a side."""


@contextlib.contextmanager
def while_compiling(light: str) -> Iterator[None]:
    """Within it, the first kernel that has to be compiled starts the second process, for a picture in ``light``.

    On one core, in a program that is not Python itself (its executable would start that program), or where
    ``OROGRAPH_COMPILE_AHEAD`` is 0, there is none.
    """

    def start() -> None:
        COMPILING.changed.remove(start)
        _start(light)

    if not _worthwhile():
        yield
        return
    COMPILING.changed.append(start)
    try:
        yield
    finally:
        if start in COMPILING.changed:
            COMPILING.changed.remove(start)


def _worthwhile() -> bool:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    wanted = os.environ.get("OROGRAPH_COMPILE_AHEAD", "1") != "0" and not _STARTED
    return wanted and cores > 1 and Path(sys.executable or "").stem.startswith("python")


def _start(light: str) -> None:
    silent = subprocess.DEVNULL
    command = [sys.executable, "-P", "-m", __name__, light]  # -P: modules of the folder one is in are not ours
    with contextlib.suppress(OSError):  # one process compiles all, then
        _STARTED.append(subprocess.Popen(command, stdin=silent, stdout=silent, stderr=silent))


_STARTED: list[subprocess.Popen[bytes]] = []
"""The second process: one is enough, and it ends by itself."""


def color_a_hill(light: str) -> None:
    """Light and colour a small hill, seen where no ray was cast."""
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
    heights[20:28, 20:28] = heights[20:28, 20:28].min()  # a lake, that water is looked for
    terrain = MemoryTerrain(heights, Grid(heights.shape, Affine.translation(0, 0) @ Affine.scale(30, -30)), "hill")
    view = whole(terrain, (SIDE, SIDE))
    scene = Scene.of(terrain, view, light=light)
    ground = Ground.load(scene)
    px, py = (np.linspace(0.5, SIDE - 0.5, SIDE) for _ in range(2))
    depths = np.full(SIDE, np.linalg.norm(np.subtract(view.target, view.eye)))
    hits = ground.rays.meet(px, py, depths)
    shader = Shader(scene, ground, Survey(hits, px, py), Memo())
    shader.color(hits, px, py, np.ones(SIDE, bool), np.zeros(SIDE, bool))


if __name__ == "__main__":
    color_a_hill(sys.argv[1])
