"""The CPU backend: draws a scene without any graphics stack.

First it casts one ray through each pixel's centre (depth, and most of the picture), in blocks over threads; then, only
where the picture has edges (silhouettes, shadows, shores), ``samples`` rays per pixel in a fixed low-discrepancy
pattern. All colour is linear light until the last step.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.compiling import expect
from orograph.errors import NothingInViewError, UsageError
from orograph.geovis.color import linear_to_srgb
from orograph.hierarchy.clip_stack import Rectangle
from orograph.memo import Memo
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress, Task
from orograph.rendering.cpu.ground import LEAST_MEMORY, Cast, Ground, fixed_memory
from orograph.rendering.cpu.shading import Shader
from orograph.rendering.describing import describe
from orograph.rendering.gbuffer import Area, Surface
from orograph.rendering.jitter import pattern
from orograph.rendering.lines.ground_grid import label, lay
from orograph.rendering.lines.silhouettes import Outlines, rim
from orograph.rendering.memory import check_memory
from orograph.rendering.picture import Picture, plan_grid
from orograph.rendering.projection import Projection
from orograph.rendering.survey import Survey
from orograph.scene.aids import interval_of
from orograph.scene.diagnostics import diagnose, what_to_do, why_empty
from orograph.scene.methods import mesh_choice
from orograph.scene.scene import Scene
from orograph.store.memory import MemoryTerrain
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import View

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

EDGE = 11
"""Difference of neighbouring pixels (sRGB bytes, largest channel) from which both are antialiased."""

BREAK = 6.0
"""Distance along the ray between the ground of adjacent pixels, in pixel widths, from which there is an edge: ground
seen at less than 10°, or a silhouette."""

BLOCK = 1 << 15
"""Samples that a thread shades at a time."""
EDGES = 1 << 12
"""The same for edges; smaller, so that all threads get some."""


def draw(
    scene: Scene, progress: Progress = SILENT, *, mesh: Tessellation | None = None, memo: Memo | None = None,
    cast: Cast | None = None,
) -> Picture:  # fmt: skip
    """Draw ``scene``. A tile of a view (``View.tile``) is drawn as it is in the whole picture, to the bit.

    Args:
        scene: to draw.
        progress: gets the progress.
        mesh: a tessellation of the scene's terrain to draw, instead of one made by the scene's method.
        memo: results of earlier pictures; pass the same one for all frames of a movie and all tiles of a picture.
        cast: makes the visible surface, if that is not done here (``sort_last``).

    Raises:
        NothingInViewError: no valid terrain is in view; the message says what to change.
        UsageError: the picture's own arrays do not fit into memory, or furniture or a mesh's edges are requested for a
            tile.
        DamagedChunkError: a chunk that is needed fails its checksum.
    """
    clock, view = _Clock(), scene.view
    methods = memo  # for a single picture, the method's tiles need not stay
    memo = Memo() if memo is None else memo
    if view.part is not None and (scene.annotations.furniture or scene.surface.wireframe):
        what = "furniture" if scene.annotations.furniture else "a wireframe"
        raise UsageError(f"A tile cannot have {what}: that belongs to the whole picture.")
    check_memory((view.width, view.height))
    facts: dict[str, Any] = {"warnings": diagnose(scene), "description": describe(scene)}
    for warning in facts["warnings"]:
        progress.warn(warning)
    if scene.surface.detail is not None:
        from orograph.rendering.detail import detailed

        scene, facts["detail"] = detailed(scene, memo, progress)
    subject = _Subject(scene)
    meshed = mesh is not None or mesh_choice(scene.surface.method, "cpu") is not None
    usual = "faces" if meshed and not scene.surface.wireframe else "computed"
    if scene.surface.normals not in ("auto", usual):
        raise UsageError(
            f"The CPU draws this with normals {usual!r}; `normals={scene.surface.normals!r}` needs the GPU.",
            remedy='Use `backend="gpu"`.',
        )
    if meshed:
        subject = _meshed(scene, mesh, memo, methods, progress)
        assert subject.mesh is not None
        if cast is not None:  # (from here on, the tolerance differs from the mesh's)
            cast = partial(_cast_mesh, cast, scene)
        facts["mesh"] = {
            "method": scene.surface.method, "triangles": len(subject.mesh.triangles), **subject.mesh.stats
        }  # fmt: skip
        clock.lap("mesh")
    expect("render", scene.lighting.light, *(["mesh"] if meshed else []))
    ground = _ground(subject, memo, progress, cast)
    clock.lap("heights")
    canvas = _Canvas(subject, ground, memo, progress, clock)
    facts |= canvas.facts
    pixels, depth, void_filled = canvas.finished()
    facts |= {"shader": canvas.shader.facts, "shown": canvas.shader.shown, "seconds": clock.seconds}
    place = plan_grid(view, scene.terrain.grid.crs)
    return Picture(
        pixels, depth.astype(np.float32), view, facts, place, void_filled if void_filled.any() else None,
        canvas.shader.tint, scene.terrain.grid.crs, scene.surface.exaggeration, scene.attribution,
    )  # fmt: skip


def _cast_mesh(
    cast: Cast, scene: Scene, _: Scene, windows: Sequence[Rectangle] | None, projection: Projection
) -> Surface:  # fmt: skip
    """The surface of the mesh that a scene's method makes."""
    return cast(scene, None, projection)


class _Clock:
    """Seconds of the parts of the work, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Add the time since the last call to a name."""
        now = time.perf_counter()
        self.seconds[name] = round(now - self._last, 4)
        self._last = now


@dataclass(frozen=True, slots=True)
class _Subject:
    """The subject of a picture.

    Attributes:
        scene: to draw. surface: a mesh's heights, if a mesh is drawn; bare: the scene of the terrain itself.
    """

    scene: Scene
    surface: Terrain | None = None
    bare: Scene | None = None
    mesh: Tessellation | None = None


def _meshed(
    scene: Scene, mesh: Tessellation | None, memo: Memo, methods: Memo | None, progress: Progress
) -> _Subject:  # fmt: skip
    """The subject when a mesh is drawn: the given mesh, or the one that the scene's method makes."""
    from orograph.rendering.cpu.mesh_surface import WINDOWS, refined, surface_of

    terrain = scene.terrain
    made = mesh or memo(
        "mesh", (scene.surface, scene.view.whole), lambda: refined(scene, progress, methods), terrain
    )  # fmt: skip
    bare = scene.but(tolerance=None, method="auto", triangles=None, mesh_view=None, wireframe=False, normals="auto")
    surface = memo("surface", id(terrain), lambda: surface_of(made, terrain, scene.budget.max_memory), made)
    drawn = scene.but(
        tolerance=0.0 if isinstance(surface, MemoryTerrain) else WINDOWS, triangles=None,
        terrain=terrain if scene.surface.wireframe else surface,
    )  # fmt: skip
    return _Subject(drawn, surface, bare, made)


def _ground(subject: _Subject, memo: Memo, progress: Progress, cast: Cast | None = None) -> Ground:
    """The ground of a picture, within its memory budget; warns if the budget is too small."""
    scene = subject.scene
    with progress.task("Reading heights" if scene.surface.detail is None else "Making detail"):
        # Edges of a mesh made for another camera are also drawn over ground that it leaves out.
        elsewhere = scene.surface.wireframe and scene.surface.mesh_view is not None
        ground = Ground.load(scene, subject.surface, memo, subject.bare, None if elsewhere else subject.mesh, cast)
        if ground.tolerance > scene.pixel_tolerance:
            progress.warn(
                f"drawn within {ground.tolerance:.2g} pixels instead of {scene.pixel_tolerance:.2g}: more would not "
                "fit into `max_memory`."
            )
    least = fixed_memory(scene) + LEAST_MEMORY
    if scene.budget.max_memory is not None and scene.budget.max_memory < least:
        progress.warn(f"a picture of this size takes about {least >> 20} MiB, more than `max_memory` allows.")
    return ground


class _Canvas:
    """A picture's pixels during drawing: cast, shaded, antialiased, outlined.

    Raises:
        NothingInViewError: no ground is in view.

    Attributes:
        shader: of the colours. facts: of the picture.
    """

    def __init__(self, subject: _Subject, ground: Ground, memo: Memo, progress: Progress, clock: _Clock) -> None:
        scene = subject.scene
        self.scene, self.mesh, self.ground, self.progress, self.clock = scene, subject.mesh, ground, progress, clock
        view, inner = scene.view, frame(scene)
        silhouettes = scene.annotations.silhouettes
        self.lines = silhouettes.fitted(view) if silhouettes and view.projection != "plan" else None
        # Antialiasing and silhouettes depend on surrounding pixels, so a tile is drawn with a rim.
        around = int(scene.surface.samples > 1 or interval_of(scene.annotations.aids, scene.view) is not None)
        rim_ = max(around, 0 if self.lines is None else rim(self.lines))
        self.area = area = _rimmed(inner, view.whole, rim_)
        self.own = slice(inner[0] - area[0], inner[1] - area[0]), slice(inner[2] - area[2], inner[3] - area[2])
        with progress.task("Casting rays"):
            survey = Survey.of(ground.rays)
            if survey is None:
                raise NothingInViewError(why_empty(scene), path=scene.terrain.name, remedy=what_to_do(scene))
            buffer = ground.rays.surface.draw(area)
        self.survey, self.depth, self.void_fill = survey, buffer.depth, buffer.void_fill
        clock.lap("rays")
        self.facts: dict[str, Any] = {
            "windows": [{"level": r.level, "rows": r.row1 - r.row0, "cols": r.col1 - r.col0} for r in ground.windows],
            "tolerance_px": ground.tolerance,
            "hit_fraction": float(np.isfinite(self.depth[self.own]).mean()),
        }
        self.linear = np.empty((*self.depth.shape, 3), np.float32)
        mine = np.zeros(self.depth.shape, bool)
        mine[self.own] = True
        self.counted = mine.ravel()
        with progress.task("Light and colour", total=2 * self.depth.size) as task:
            self.shader = Shader(scene, ground, survey, memo, progress)
            clock.lap("light")
            self.wet = np.zeros(self.depth.shape if self.shader.smooth else (0, 0), bool)
            self._shade(task)
            if scene.surface.samples > 1:
                self._antialias(task)
            if self.lines is not None:
                self._outline()
            drawn = view.whole.tile(area[2], area[0], area[3] - area[2], area[1] - area[0])
            lay(scene.but(view=drawn), self.linear, self.depth)

    def _shade(self, task: Task) -> None:
        """Colour all pixels with rays through their centres."""
        flat, depth, void_fill = self.linear.reshape(-1, 3), self.depth.ravel(), self.void_fill.ravel()
        shader, rays, area = self.shader, self.ground.rays, self.area
        wide, shores = area[3] - area[2], self.wet.ravel()

        def block(start: int) -> int:
            i = np.arange(start, min(start + BLOCK, len(depth)))
            px, py = (a.astype(np.float64) + 0.5 for a in (area[2] + i % wide, area[0] + i // wide))
            water = shores[i[0] : i[-1] + 1] if shader.smooth else None
            flat[i] = shader.color(rays.meet(px, py, depth[i], void_fill[i]), px, py, self.counted[i], water)
            return len(i)

        for n in map_ordered(block, range(0, len(depth), BLOCK), self.scene.budget.jobs):
            task.advance(n)
        self.clock.lap("color")

    def _antialias(self, task: Task) -> None:
        """Recolour the pixels at edges, with several rays each."""
        scene, shader, rays, area = self.scene, self.shader, self.ground.rays, self.area
        flat, wide, samples = self.linear.reshape(-1, 3), area[3] - area[2], scene.surface.samples
        found = find_edges(encode(self.linear))
        if shader.smooth:
            found &= find_depth_edges(self.depth, scene.view.whole, self.wet, np.isfinite(self.void_fill))
        edges = by_squares(np.flatnonzero(found.ravel() & self.counted), area, rays.surface.side)
        self.facts["edge_fraction"] = len(edges) / (scene.view.width * scene.view.height)
        offsets, few = pattern(samples), max(1, EDGES // samples)

        def refine(start: int) -> int:
            chosen = edges[start : start + few]
            px = (area[2] + chosen % wide)[:, None] + offsets[None, :, 0]
            py = (area[0] + chosen // wide)[:, None] + offsets[None, :, 1]
            u, v = px.ravel(), py.ravel()
            seen = rays.surface.at(u, v)
            colors = shader.color(rays.meet(u, v, seen.depth, seen.void_fill), u, v)
            flat[chosen] = colors.reshape(len(chosen), samples, 3).mean(1)
            return len(chosen)

        for n in map_ordered(refine, range(0, len(edges), few), scene.budget.jobs):
            task.advance(n * self.depth.size / max(1, len(edges)))
        self.clock.lap("antialiasing")

    def _outline(self) -> None:
        """Draw silhouettes."""
        assert self.lines is not None
        depths = self.scene.lighting.depths or self.survey.range
        seen = np.where(np.isfinite(self.void_fill), self.void_fill, self.depth)
        outlines = Outlines(self.lines, self.ground, self.area, depths)
        outlines.draw(self.linear, seen, pattern(self.scene.surface.samples), self.shader.air)
        self.clock.lap("silhouettes")

    def finished(self) -> tuple[NDArray[np.uint8], Array, NDArray[np.bool_]]:
        """The view's own pixels with edges of a mesh and furniture: bytes, depths, and where ground is missing."""
        scene, view = self.scene, self.scene.view
        linear, depth = self.linear[self.own], self.depth[self.own]
        void_filled = np.isfinite(self.void_fill[self.own])
        if self.mesh is not None and scene.surface.wireframe:
            from orograph.rendering.cpu.wireframe import draw_edges

            with self.progress.task("Drawing edges"):
                free = None if self.shader.lines is None else self.shader.lines.gaps()
                draw_edges(
                    linear, depth, self.mesh, scene.terrain.grid, view, exaggeration=scene.surface.exaggeration,
                    gaps=free, jobs=scene.budget.jobs,
                )  # fmt: skip
            self.clock.lap("edges")
        pixels = encode(linear)
        if scene.theme.things is not None:
            from orograph.rendering.standing import stand

            with self.progress.task("Drawing what stands on the ground"):
                pixels, depth = stand(scene.theme.things, pixels, depth, scene).reported(self.progress)
        pixels = label(scene, pixels)
        if scene.annotations.furniture:
            from orograph.rendering.furniture.furnish import furnish
            from orograph.rendering.furniture.legend import Drawn, furniture_of, sampled
            from orograph.rendering.inset import inset_of

            shader = self.shader
            seen = sampled(depth, *depth.shape), depth[:, depth.shape[1] // 2]
            drawn = Drawn(shader.tint, shader.shown, bool(shader.drapes), *seen)
            pieces = furniture_of(scene, drawn) | {"inset": inset_of(scene, draw)}
            pixels = furnish(pixels, **pieces, ground=np.isfinite(depth) | void_filled)
            self.clock.lap("furniture")
        return pixels, depth, void_filled


def session(cast: Cast | None = None) -> Callable[[Scene], Picture]:
    """A drawing function that keeps data shared by consecutive scenes (``memo``). ``cast``: as for ``draw``."""
    memo = Memo()
    return lambda scene: draw(scene, memo=memo, cast=cast)


def frame(scene: Scene) -> Area:
    """The pixels of the whole picture that a scene's view covers."""
    left, top, _, _ = scene.view.frame
    return top, top + scene.view.height, left, left + scene.view.width


def _rimmed(area: Area, whole: View, by: int) -> Area:
    top, bottom, left, right = area
    return max(top - by, 0), min(bottom + by, whole.height), max(left - by, 0), min(right + by, whole.width)


def by_squares(pixels: NDArray[np.intp], area: Area, side: int) -> NDArray[np.intp]:
    """Pixels of an area by place, in the order of squares of ``side`` pixels, which surfaces prefer."""
    row, col = np.divmod(pixels, area[3] - area[2])
    square = ((row + area[0]) // side) * (area[3] // side + 1) + (col + area[2]) // side
    return pixels[np.argsort(square, kind="stable")]


def encode(linear: Colors) -> NDArray[np.uint8]:
    """Linear light → sRGB in bytes, by a table of 2^14 steps (a quarter of a byte at the darkest)."""
    steps = np.clip(linear * np.float32(len(_ENCODED) - 1) + np.float32(0.5), 0, len(_ENCODED) - 1).astype(np.uint16)
    return np.asarray(_ENCODED[steps])


_ENCODED = np.round(linear_to_srgb(np.linspace(0, 1, 1 << 14)) * 255).astype(np.uint8)


def find_edges(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels (height, width) with a channel that differs from a neighbour's by more than ``EDGE``."""
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
    """Pixels (height, width) at depth edges.

    That is where the ground breaks off (by ``BREAK`` pixel widths along the ray), or where water, a void fill or the
    terrain begins; depths are NaN where there is no ground.
    """
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
