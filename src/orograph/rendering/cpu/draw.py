"""The CPU backend: a scene becomes a picture with no graphics stack at all.

First one ray through each pixel's centre (depth, and most of the picture), in blocks over threads; then, only where the
picture has edges (silhouettes, shadows, shores), ``samples`` rays per pixel in a fixed low-discrepancy pattern. All
colour is linear light until the last step.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import NothingInViewError, UsageError
from orograph.geovis.color import linear_to_srgb
from orograph.memo import Memo
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress
from orograph.rendering.cpu.ground import LEAST_MEMORY, Ground, fixed_memory
from orograph.rendering.cpu.shading import Shader
from orograph.rendering.gbuffer import Area
from orograph.rendering.jitter import pattern
from orograph.rendering.lines.silhouettes import Outlines, rim
from orograph.rendering.memory import check_memory
from orograph.rendering.picture import Picture, plan_grid
from orograph.rendering.survey import Survey
from orograph.scene.diagnostics import diagnose, what_to_do, why_empty
from orograph.scene.methods import mesh_choice
from orograph.scene.scene import Scene
from orograph.store.memory import MemoryTerrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import View

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

EDGE = 11
"""Difference of neighbouring pixels (sRGB bytes, largest channel) from which both are antialiased."""

BREAK = 6.0
"""Widths of a pixel from one pixel's ground to the next one's, along the ray, from which on there is an edge: ground
seen at less than 10°, or a silhouette."""

BLOCK = 1 << 15
"""Samples shaded at a time by a thread."""
EDGES = 1 << 12
"""The same of edges: where a picture has few, all threads have some."""


def draw(
    scene: Scene, progress: Progress = SILENT, *, mesh: Tessellation | None = None, memo: Memo | None = None
) -> Picture:
    """Draw ``scene``. A tile of a view (``View.tile``) is drawn as it is in the whole picture, to the bit.

    Args:
        scene: what is drawn.
        progress: hears of it.
        mesh: a tessellation of the scene's terrain to draw, instead of having the scene's method make one.
        kept: what earlier pictures left: give the same for all frames of a movie and all tiles of a picture.

    Raises:
        NothingInViewError: no valid terrain is in view; the message says what to change.
        UsageError: the picture's own arrays do not fit into memory, or a tile is to have what only wholes can have:
            furniture, or a mesh's edges.
        DamagedChunkError: a chunk that is needed fails its checksum.
    """
    clock = [time.perf_counter()]
    facts: dict[str, Any] = {}
    methods = memo  # of a single picture, the method's tiles need not stay
    memo = Memo() if memo is None else memo

    def lap(name: str) -> None:
        clock.append(time.perf_counter())
        facts.setdefault("seconds", {})[name] = round(clock[-1] - clock[-2], 4)

    view = scene.view
    if view.part is not None and (scene.annotations.furniture or scene.surface.wireframe):
        what = "furniture" if scene.annotations.furniture else "a wireframe"
        raise UsageError(f"A tile has no {what}: that belongs to the whole picture.")
    check_memory((view.width, view.height))
    facts["warnings"] = diagnose(scene)
    for warning in facts["warnings"]:
        progress.warn(warning)
    surface = bare = None
    if mesh is not None or mesh_choice(scene.surface.method, "cpu") is not None:
        from orograph.rendering.cpu.mesh_surface import WINDOWS, refined, surface_of

        if mesh is None:
            asked = scene.surface, view.whole
            mesh = memo("mesh", asked, lambda: refined(scene, progress, methods), scene.terrain)
        made, terrain = mesh, scene.terrain
        bare = scene.but(tolerance=None, method="auto", triangles=None, mesh_view=None, wireframe=False
        )  # fmt: skip
        facts["mesh"] = {"method": scene.surface.method, "triangles": len(mesh.triangles), **mesh.stats}
        surface = memo("surface", id(terrain), lambda: surface_of(made, terrain, scene.budget.max_memory), mesh)
        lap("mesh")
        scene = scene.but(tolerance=0.0 if isinstance(surface, MemoryTerrain) else WINDOWS, triangles=None,
            terrain=scene.terrain if scene.surface.wireframe else surface,
        )  # fmt: skip
    with progress.task("Reading heights"):
        # Edges of a mesh that was made for another camera are drawn over the ground that it leaves out, too.
        elsewhere = scene.surface.wireframe and scene.surface.mesh_view is not None
        ground = Ground.load(scene, surface, memo, bare, None if elsewhere else mesh)
        if ground.tolerance > scene.pixel_tolerance:
            progress.warn(
                f"drawn within {ground.tolerance:.2g} pixels instead of {scene.pixel_tolerance:.2g}: more would not "
                "fit into `max_memory`."
            )
    least = fixed_memory(scene) + LEAST_MEMORY
    if scene.budget.max_memory is not None and scene.budget.max_memory < least:
        progress.warn(f"a picture of this size takes about {least >> 20} MiB, more than `max_memory` allows.")
    lap("heights")
    inner = frame(scene)
    lines = (
        scene.annotations.silhouettes.fitted(view)
        if scene.annotations.silhouettes and view.projection != "plan"
        else None
    )
    # What is antialiased depends on the pixels around, and silhouettes do: a tile is drawn with a rim, left out then.
    area = _rimmed(inner, view.whole, max(int(scene.surface.samples > 1), 0 if lines is None else rim(lines)))
    with progress.task("Casting rays"):
        survey = Survey.of(ground.rays)
        if survey is None:
            raise NothingInViewError(why_empty(scene), path=scene.terrain.name, remedy=what_to_do(scene))
        buffer = ground.rays.surface.draw(area)
        t, void_fill = buffer.depth, buffer.void_fill
    lap("rays")
    facts["windows"] = [{"level": r.level, "rows": r.row1 - r.row0, "cols": r.col1 - r.col0} for r in ground.windows]
    facts["tolerance_px"] = ground.tolerance
    own = slice(inner[0] - area[0], inner[1] - area[0]), slice(inner[2] - area[2], inner[3] - area[2])
    facts["hit_fraction"] = float(np.isfinite(t[own]).mean())
    with progress.task("Light and colour", total=2 * t.size) as task:
        shader = Shader(scene, ground, survey, memo, progress)
        lap("light")
        wide = area[3] - area[2]
        linear = np.empty((*t.shape, 3), np.float32)
        flat, ft, fv = linear.reshape(-1, 3), t.ravel(), void_fill.ravel()
        mine = np.zeros(t.shape, bool)
        mine[own] = True
        counted = mine.ravel()
        wet = np.zeros(t.shape if shader.smooth else (0, 0), bool)
        shores = wet.ravel()

        def block(start: int) -> int:
            i = np.arange(start, min(start + BLOCK, len(ft)))
            px, py = (a.astype(np.float64) + 0.5 for a in (area[2] + i % wide, area[0] + i // wide))
            water = shores[i[0] : i[-1] + 1] if shader.smooth else None
            flat[i] = shader.color(ground.rays.meet(px, py, ft[i], fv[i]), px, py, counted[i], water)
            return len(i)

        for n in map_ordered(block, range(0, len(ft), BLOCK), scene.budget.jobs):
            task.advance(n)
        lap("color")
        if scene.surface.samples > 1:
            found = find_edges(encode(linear))
            if shader.smooth:
                found &= find_depth_edges(t, view.whole, wet, np.isfinite(void_fill))
            edges = by_squares(np.flatnonzero(found.ravel() & counted), area, ground.rays.surface.side)
            facts["edge_fraction"] = len(edges) / (view.width * view.height)
            offsets = pattern(scene.surface.samples)
            few = max(1, EDGES // scene.surface.samples)

            def refine(start: int) -> int:
                chosen = edges[start : start + few]
                px = (area[2] + chosen % wide)[:, None] + offsets[None, :, 0]
                py = (area[0] + chosen // wide)[:, None] + offsets[None, :, 1]
                u, v = px.ravel(), py.ravel()
                seen = ground.rays.surface.at(u, v)
                colors = shader.color(ground.rays.meet(u, v, seen.depth, seen.void_fill), u, v)
                flat[chosen] = colors.reshape(len(chosen), scene.surface.samples, 3).mean(1)
                return len(chosen)

            for n in map_ordered(refine, range(0, len(edges), few), scene.budget.jobs):
                task.advance(n * len(ft) / max(1, len(edges)))
            lap("antialiasing")
        if lines is not None:
            outlines = Outlines(lines, ground, area, scene.lighting.depths or survey.range)
            outlines.draw(
                linear, np.where(np.isfinite(void_fill), void_fill, t), pattern(scene.surface.samples), shader.air
            )
            lap("silhouettes")
    linear, t, void_filled = linear[own], t[own], np.isfinite(void_fill[own])
    if mesh is not None and scene.surface.wireframe:
        from orograph.rendering.cpu.wireframe import draw_edges

        with progress.task("Drawing edges"):
            free = None if shader.lines is None else shader.lines.gaps()
            draw_edges(
                linear,
                t,
                mesh,
                scene.terrain.grid,
                view,
                exaggeration=scene.surface.exaggeration,
                gaps=free,
                jobs=scene.budget.jobs,
            )
        lap("edges")
    pixels = encode(linear)
    if scene.annotations.furniture:
        from orograph.rendering.furniture.furnish import furnish
        from orograph.rendering.furniture.legend import Drawn, furniture_of, sampled

        drawn = Drawn(shader.tint, shader.shown, bool(shader.drapes), sampled(t, *t.shape), t[:, t.shape[1] // 2])
        pixels = furnish(pixels, **furniture_of(scene, drawn), ground=np.isfinite(t) | void_filled)
        lap("furniture")
    facts["shader"] = shader.facts
    facts["shown"] = shader.shown
    place = plan_grid(scene.view, scene.terrain.grid.crs)
    return Picture(
        pixels, t.astype(np.float32), scene.view, facts, place, void_filled if void_filled.any() else None, shader.tint
    )


def session() -> Callable[[Scene], Picture]:
    """Draws scene after scene, and keeps what they have in common (``memo``)."""
    memo = Memo()
    return lambda scene: draw(scene, memo=memo)


def frame(scene: Scene) -> Area:
    """The pixels that a scene's view is of the whole picture."""
    left, top, _, _ = scene.view.frame
    return top, top + scene.view.height, left, left + scene.view.width


def _rimmed(area: Area, whole: View, by: int) -> Area:
    top, bottom, left, right = area
    return max(top - by, 0), min(bottom + by, whole.height), max(left - by, 0), min(right + by, whole.width)


def by_squares(pixels: NDArray[np.intp], area: Area, side: int) -> NDArray[np.intp]:
    """Pixels of an area, by their places in it, in the order of squares of ``side`` pixels: so surfaces like them."""
    row, col = np.divmod(pixels, area[3] - area[2])
    square = ((row + area[0]) // side) * (area[3] // side + 1) + (col + area[2]) // side
    return pixels[np.argsort(square, kind="stable")]


def encode(linear: Colors) -> NDArray[np.uint8]:
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


def find_depth_edges(
    depth: Array, view: View, wet: NDArray[np.bool_], void_filled: NDArray[np.bool_]
) -> NDArray[np.bool_]:  # fmt: skip
    """Pixels (height, width) beside which the ground breaks off (by ``BREAK`` widths of a pixel along the ray), water,
    a void fill or the terrain begins; depths are NaN where no ground is."""
    far = np.where(np.isnan(depth), np.inf, depth)
    pixel = np.full((), view.pixel_metres) if view.projection == "plan" else view.pixel_slope * far
    kind = wet.astype(np.int8) + 2 * void_filled + 4 * np.isinf(far)
    out = np.zeros(depth.shape, bool)
    for a, b in (((slice(None), slice(1, None)), (slice(None), slice(-1))), ((slice(1, None),), (slice(-1),))):
        with np.errstate(invalid="ignore"):
            near = np.minimum(far[a], far[b])
            step = np.abs(far[a] - far[b]) > BREAK * (pixel if pixel.ndim == 0 else view.pixel_slope * near)
        step |= kind[a] != kind[b]
        out[a] |= step
        out[b] |= step
    return out
