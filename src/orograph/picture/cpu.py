"""The CPU backend: a scene becomes a picture with no graphics stack at all.

First one ray through each pixel's centre (depth, and most of the picture), in blocks over threads; then, only where the
picture has edges (silhouettes, shadows, shores), ``samples`` rays per pixel in a fixed low-discrepancy pattern. All
colour is linear light until the last step.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import NothingInViewError
from orograph.geovis.colour import linear_to_srgb
from orograph.parallel import map_ordered
from orograph.picture.doubts import doubts, looks_like_degrees
from orograph.picture.ground import LEAST_MEMORY, Ground, fixed_memory
from orograph.picture.memory import check_memory
from orograph.picture.result import Picture, plan_grid
from orograph.picture.scene import Scene
from orograph.picture.shading import Shader
from orograph.progress import SILENT, Progress
from orograph.tessellation import Tessellation

Array = NDArray[np.float64]
Colours = NDArray[np.float32]

EDGE = 11
"""Difference of neighbouring pixels (sRGB bytes, largest channel) from which both are antialiased."""

BLOCK = 1 << 15
"""Samples shaded at a time by a thread."""


def draw(scene: Scene, progress: Progress = SILENT, *, mesh: Tessellation | None = None) -> Picture:
    """Draw ``scene``.

    Args:
        scene: what is drawn.
        progress: hears of it.
        mesh: a tessellation of the scene's terrain to draw, instead of having the scene's engine make one.

    Raises:
        NothingInViewError: no valid terrain is in view; the message says what to change.
        UsageError: the picture's own arrays do not fit into memory.
        DamagedChunkError: a chunk that is needed fails its checksum.
    """
    clock = [time.perf_counter()]
    facts: dict[str, Any] = {}

    def lap(name: str) -> None:
        clock.append(time.perf_counter())
        facts.setdefault("seconds", {})[name] = round(clock[-1] - clock[-2], 4)

    check_memory((scene.view.width, scene.view.height))
    facts["warnings"] = doubts(scene)
    for warning in facts["warnings"]:
        progress.warn(warning)
    surface = None
    if scene.engine is not None or mesh is not None:
        from orograph.picture.surface import refined, surface_of

        mesh = refined(scene, progress) if mesh is None else mesh
        facts["mesh"] = mesh.stats
        surface = surface_of(mesh, scene.terrain, scene.max_memory)
        lap("mesh")
        scene = replace(scene, tolerance=0.0, terrain=scene.terrain if scene.wireframe else surface)
    with progress.task("Reading heights"):
        ground = Ground.load(scene, surface)
        if ground.tolerance > scene.pixel_tolerance:
            progress.warn(
                f"drawn within {ground.tolerance:.2g} pixels instead of {scene.pixel_tolerance:.2g}: more would not "
                "fit into --max-memory."
            )
    least = fixed_memory(scene) + LEAST_MEMORY
    if scene.max_memory is not None and scene.max_memory < least:
        progress.warn(f"a picture of this size takes about {least >> 20} MiB, more than --max-memory allows.")
    lap("heights")
    with progress.task("Casting rays"):
        t, window, veil = ground.rays.first()
    lap("rays")
    if not np.isfinite(t).any():
        raise NothingInViewError(_why_empty(scene), path=scene.terrain.name, remedy=_remedy(scene))
    facts["windows"] = [{"level": r.level, "rows": r.row1 - r.row0, "cols": r.col1 - r.col0} for r in ground.windows]
    facts["tolerance_px"] = ground.tolerance
    facts["hit_fraction"] = float(np.isfinite(t).mean())
    with progress.task("Light and colour", total=2 * t.size) as task:
        shader = Shader(scene, ground, t, progress)
        lap("light")
        view = scene.view
        linear = np.empty((view.height, view.width, 3), np.float32)
        flat, ft, fw, fv = linear.reshape(-1, 3), t.ravel(), window.ravel(), veil.ravel()

        def block(start: int) -> int:
            i = np.arange(start, min(start + BLOCK, len(ft)))
            px, py = (a.astype(np.float64) + 0.5 for a in (i % view.width, i // view.width))
            flat[i] = shader.colour(ground.rays.meet(px, py, ft[i], fw[i], fv[i]), px, py)
            return len(i)

        for n in map_ordered(block, range(0, len(ft), BLOCK), scene.jobs):
            task.advance(n)
        lap("colour")
        if scene.samples > 1:
            edges = np.flatnonzero(find_edges(encode(linear)).ravel())
            facts["edge_fraction"] = len(edges) / len(ft)
            offsets = pattern(scene.samples)

            def refine(start: int) -> int:
                chosen = edges[start : start + BLOCK // scene.samples]
                px = (chosen % view.width)[:, None] + offsets[None, :, 0]
                py = (chosen // view.width)[:, None] + offsets[None, :, 1]
                u, v = px.ravel(), py.ravel()
                colours = shader.colour(ground.rays.meet(u, v, *ground.rays.cast(u, v)), u, v)
                flat[chosen] = colours.reshape(len(chosen), scene.samples, 3).mean(1)
                return len(chosen)

            for n in map_ordered(refine, range(0, len(edges), max(1, BLOCK // scene.samples)), scene.jobs):
                task.advance(n * len(ft) / max(1, len(edges)))
            lap("antialiasing")
    if mesh is not None and scene.wireframe:
        from orograph.picture.wireframe import draw_edges

        with progress.task("Drawing edges"):
            draw_edges(linear, t, mesh, scene.terrain.grid, view, exaggeration=scene.exaggeration, jobs=scene.jobs)
        lap("edges")
    pixels = encode(linear)
    if scene.furniture:
        from orograph.picture.legend import decorate

        pixels = decorate(pixels, scene, shader, t, np.isfinite(veil))
        lap("furniture")
    facts["shader"] = shader.facts
    return Picture(pixels, t.astype(np.float32), scene.view, facts, plan_grid(scene.view, scene.terrain.grid.crs))


def encode(linear: Colours) -> NDArray[np.uint8]:
    """Linear light → sRGB in bytes, by a table of 2^14 steps (a quarter of a byte at the darkest)."""
    steps = np.clip(linear * np.float32(len(_ENCODED) - 1) + np.float32(0.5), 0, len(_ENCODED) - 1).astype(np.uint16)
    return np.asarray(_ENCODED[steps])


_ENCODED = np.round(linear_to_srgb(np.linspace(0, 1, 1 << 14)) * 255).astype(np.uint8)


def find_edges(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels (height, width) of which a channel differs from a neighbour's by more than ``EDGE``."""
    edges = np.zeros(picture.shape[:2], bool)
    for c in range(3):
        channel = picture[:, :, c].astype(np.int16)
        across = np.abs(channel[:, 1:] - channel[:, :-1]) > EDGE
        down = np.abs(channel[1:] - channel[:-1]) > EDGE
        edges[:, 1:] |= across
        edges[:, :-1] |= across
        edges[1:] |= down
        edges[:-1] |= down
    return edges


def pattern(n: int) -> Array:
    """n positions in a pixel (n, 2), evenly spread around its centre: the R2 sequence (Roberts 2018), the same for all.

    Steps are counted from the middle of the sequence, so that positions are symmetric and edges stay where they are.
    """
    g = 1.32471795724474602596
    k = (np.arange(n) - (n - 1) / 2)[:, None]
    return np.asarray((0.5 + k * np.array([1 / g, 1 / g**2])) % 1.0)


def _why_empty(scene: Scene) -> str:
    view, terrain = scene.view, scene.terrain
    col, row = (float(v) for v in terrain.grid.index(view.eye[0], view.eye[1]))
    inside = 0 <= col <= terrain.grid.cols - 1 and 0 <= row <= terrain.grid.rows - 1
    place = "above or under its area" if inside else "outside its area"
    return (
        f"Nothing of the terrain is in view: the eye at ({view.eye[0]:.0f}, {view.eye[1]:.0f}, {view.eye[2]:.0f}) is "
        f"{place} and looks towards ({view.target[0]:.0f}, {view.target[1]:.0f}, {view.target[2]:.0f})."
    )


def _remedy(scene: Scene) -> str:
    if looks_like_degrees(scene):
        return 'Do these numbers stand for longitude and latitude? Then add "crs": "EPSG:4326" to the view.'
    return "Leave the camera options away to see all of it."
