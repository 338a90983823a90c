"""The program that compiles the other verbs' kernels once a first verb has compiled its own.

``python -m orograph.verbs.ahead`` does on a small hill, in a temporary folder, what people do next: build, tessellate,
measure, map light, draw a map, triangulate. It discards the results; Numba keeps the kernels (see ``compiling``).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine

from orograph._compiler import hasten
from orograph.folders import temporary

SIDE = 300
"""Samples along a side of the hill: more than one tile."""


def write_hills(folder: Path) -> tuple[Path, Path]:
    """Write a hill with a hole and level ground, once as whole metres in degrees and once as fractions of metres in
    metres."""
    import rasterio

    x = np.linspace(-2, 2, SIDE)
    heights = 900 * np.exp(-np.add.outer(x * x, x * x)) + 20 * np.sin(9 * np.add.outer(x, -x))
    heights[40:60, 200:240] = heights[50, 220]
    heights[200:220, 40:60] = -32768
    shape = {"driver": "GTiff", "width": SIDE, "height": SIDE, "count": 1, "nodata": -32768}
    degrees, metres = folder / "degrees.tif", folder / "metres.tif"
    for path, dtype, crs, transform in (
        (degrees, "int16", "EPSG:4326", Affine(1 / 1200, 0, -84, 0, -1 / 1200, 36)),
        (metres, "float32", "EPSG:32617", Affine(90, 0, 300000, 0, -90, 4000000)),
    ):
        with rasterio.open(path, "w", dtype=dtype, crs=crs, transform=transform, **shape) as file:
            file.write(heights.astype(dtype), 1)
    return degrees, metres


def steps(folder: Path) -> list[Callable[[], Any]]:
    """What people do after a first picture or build, the most usual first; from rasters and from stores, whose heights
    have another array type for Numba."""
    import orograph
    from orograph.rendering.gpu.draw import draw
    from orograph.scene.scene import Scene

    degrees, metres = write_hills(folder)
    store, size = folder / "hill.oro", (640, 360)
    line = np.array([[310000.0, 3990000.0], [322000.0, 3979000.0]])
    corners = np.vstack([line, [[310500.0, 3979500.0]]])
    measure = orograph.measure

    def on_gpu(path: Path) -> None:
        terrain = orograph.terrain(path)
        draw(Scene.of(terrain, orograph.camera.whole(terrain, size)))

    def measured() -> None:
        for path in (metres, store):
            terrain = orograph.terrain(path)
            measure.profile(terrain, line)
            measure.area(terrain, [corners])
            measure.viewshed(terrain, line[0], radius=2000.0)

    return [
        lambda: orograph.render(degrees, size=size, furniture=True),
        lambda: orograph.build(degrees, folder / "degrees.oro"),
        lambda: orograph.build(metres, store),
        lambda: on_gpu(metres),
        lambda: on_gpu(store),
        lambda: orograph.render(store, "plan", size=size, contours="auto", silhouettes=True),
        *(lambda path=path: orograph.tessellate(path, tolerance=2) for path in (metres, store)),
        lambda: orograph.light(metres, "sky-view-factor"),
        measured,
        lambda: orograph.tin(metres, max_error=5),
    ]


def compile_verbs() -> None:
    """Compile the kernels of the usual verbs; skip those whose extras are missing."""
    if hasattr(os, "nice"):
        os.nice(19)
    with temporary() as folder:
        for step in steps(Path(folder)):
            with contextlib.suppress(Exception):  # nobody reads this: the verb itself will report what is wrong
                step()


if __name__ == "__main__":
    hasten()
    compile_verbs()
