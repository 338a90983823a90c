"""The GPU backend of pictures: draw a scene off screen with all tiles, and read it back.

The same scene as the CPU caster's (``rendering.cpu.draw``), the same light and colours (the shader follows it line by
line): depth differs by no more than the tolerance, colours by what docs/gpu.md states. Pictures with more pixels than a
device draws at once are drawn in tiles (``rendering.large``), which share the whole picture's properties
(``overview``).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import NothingInViewError, UsageError
from orograph.geovis.layers import drawn as visible
from orograph.gpu.device import Device, open_device
from orograph.memo import Memo
from orograph.progress import SILENT, Progress
from orograph.rendering.describing import describe
from orograph.rendering.furniture.furnish import furnish
from orograph.rendering.furniture.legend import Drawn, furniture_of, sampled
from orograph.rendering.gpu.frame import PLAIN, FrameStats, Overlay
from orograph.rendering.gpu.overview import rimmed
from orograph.rendering.gpu.renderer import ATLASES, Renderer
from orograph.rendering.gpu.shade.tracing import casts
from orograph.rendering.inset import inset_of
from orograph.rendering.lines.ground_grid import label, lay_on_bytes
from orograph.rendering.memory import DRIVER, TILED
from orograph.rendering.picture import Picture, plan_grid
from orograph.scene.diagnostics import diagnose, what_to_do, why_empty
from orograph.scene.methods import mesh_choice
from orograph.scene.scene import Scene
from orograph.viewpoint import View

TOLERANCE = 1.0
"""Default tolerance, pixels."""
LEAST = 64 << 20
"""Minimum bytes for a method's tables and for textures of tiles, however little memory is allowed."""


def _check(scene: Scene, device: Device, around: View) -> None:
    """Raise UsageError for what the GPU cannot draw.

    Args:
        around: the view with the rim that is drawn around it.
    """
    view = scene.view
    if view.part is not None and scene.annotations.furniture:
        raise UsageError("A tile cannot have furniture: that belongs to the whole picture.")
    most = largest(device)
    if max(around.width, around.height) > most:
        raise UsageError(
            f"{device.adapter.name} draws at most {most} × {most} pixels at a time, not {view.width} × {view.height}.",
            remedy="Draw it in tiles: orograph render, or rendering.large.draw_large.",
        )


def draw(
    scene: Scene,
    progress: Progress = SILENT,
    *,
    device: Device | None = None,
    renderer: Renderer | None = None,
    overlay: Overlay = PLAIN,
    memo: Memo | None = None,
) -> Picture:
    """Draw ``scene`` on a GPU.

    Args:
        scene: what is drawn.
        progress: gets the progress.
        device: where to draw; None: the best available.
        renderer: of the scene's terrain, reusable for several pictures; None: one for this picture.
        overlay: drawn in addition.
        memo: keeps detail beyond the data; a renderer for it has that terrain (``ground_of``).

    Raises:
        NoAdapterError: there is no GPU.
        NothingInViewError: no ground is in view.
        UsageError: the picture is larger than the device can draw, or the scene's method is unknown.
    """
    # (One function, though long: its own renderer is closed whatever part of the work fails.)
    begun = time.perf_counter()
    device = device or open_device()
    view, whole = scene.view, scene.view.part is None
    around, own_pixels = rimmed(scene)
    _check(scene, device, around)
    warnings = diagnose(scene.but(view=around)) if around.frame[:2] == (0, 0) else []  # for tiles, the first one
    description = describe(scene)
    scene, detail = ground_of(scene, device, Memo() if memo is None else memo, progress)
    scene = scene.but(view=around)
    if scene.surface.tolerance is None and scene.surface.triangles is None:
        scene = scene.but(tolerance=TOLERANCE)
    other = mesh_choice(scene.surface.method, "gpu", scene.surface.triangles)
    if other is not None and other.info.kind != "rays" and not scene.surface.wireframe:
        overlay = replace(overlay, normals="faces")  # as the CPU lights a mesh
    if scene.surface.normals != "auto":
        overlay = replace(overlay, normals=scene.surface.normals)
    allowed = scene.budget.max_memory
    if not whole and device.adapter.software and allowed is not None and allowed < TILED:
        warnings.append(f"A software driver takes about {TILED >> 20} MiB, more than `max_memory` allows.")
    for warning in warnings:
        progress.warn(warning)
    if renderer is not None and renderer.terrain is not scene.terrain:
        renderer = None  # of the data, where there is detail
    own = renderer is None
    renderer = renderer or renderer_of(device, scene)
    renderer.imagery.progress = progress
    try:
        by_rays = casts(scene)
        with progress.task(f"Drawing on {device.adapter.name}", total=1.0 if by_rays else None) as task:
            texture = device.texture((around.width, around.height), "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
            target = texture.create_view()
            # If light takes long, find what is visible without it.
            first = scene.but(light="none", lamps=(), discs=()) if by_rays else scene
            stats = renderer.draw(target, "rgba8unorm", first, overlay=overlay, wait=True, samples=1)
            notes = [*stats.notes, *_coarser(scene, stats, renderer)]
            for warning in notes:
                progress.warn(warning)
            warnings += notes
            depth, void_filled = renderer.depth(), renderer.void_filled()
            if not np.isfinite(depth).any() and (whole or renderer.overview(scene)[1] is None):
                raise NothingInViewError(why_empty(scene), path=scene.terrain.name, remedy=what_to_do(scene))
            if scene.surface.samples > 1 or by_rays:
                stats = renderer.draw(
                    target,
                    "rgba8unorm",
                    scene,
                    overlay=overlay,
                    wait=True,
                    samples=scene.surface.samples,
                    advance=task.advance,
                )
            pixels = device.read_texture(texture, np.uint8, 4)[..., :3].copy()
            lay_on_bytes(scene, pixels, depth)
            pixels = pixels[own_pixels].copy()
            depth, void_filled, scene = depth[own_pixels], void_filled[own_pixels], scene.but(view=view)
            shown = renderer.shown(scene, depth, void_filled)
            pixels, depth = _adorned(scene, renderer, shown, pixels, depth, void_filled, progress)
    finally:
        if own:
            renderer.close()
    facts: dict[str, Any] = {
        "backend": "gpu", "adapter": device.adapter.name, "patches": stats.patches, "triangles": stats.triangles,
        "tolerance_px": scene.surface.tolerance, "light": renderer.light, "tiles": stats.tiles_resident,
        "warnings": warnings, "description": description,
        "shown": shown, "hit_fraction": float(np.isfinite(depth).mean()),
        "seconds": {"all": round(time.perf_counter() - begun, 4)},
    }  # fmt: skip
    mesh = renderer.mesh if renderer.resident is None else renderer.resident.tessellation()
    if mesh is not None:
        facts["mesh"] = {"method": scene.surface.method, "triangles": len(mesh.triangles), **mesh.stats}
    if renderer.windows is not None:
        facts["rays"] = renderer.windows.stats
    if detail:
        facts["detail"] = detail
    place = plan_grid(view, scene.terrain.grid.crs)
    return Picture(
        pixels, depth, view, facts, place, void_filled if void_filled.any() else None, renderer.tint,
        scene.terrain.grid.crs, scene.surface.exaggeration, scene.attribution,
    )  # fmt: skip


def ground_of(scene: Scene, device: Device, memo: Memo, progress: Progress = SILENT) -> tuple[Scene, dict[str, Any]]:
    """A scene over the terrain that is drawn, and facts about its detail beyond the data; {} without.

    Raises: as ``rendering.detail.detailed``.
    """
    if scene.surface.detail is None:
        return scene, {}
    from orograph.rendering.detail import detailed

    return detailed(scene, memo, progress, device)


def _adorned(
    scene: Scene, renderer: Renderer, shown: dict[str, int], pixels: NDArray[np.uint8], depth: NDArray[np.float32],
    void_filled: NDArray[np.bool_], progress: Progress,
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:  # fmt: skip
    """Pixels and depth with standing things and furniture."""
    if scene.theme.things is not None:
        from orograph.rendering.standing import stand

        pixels, stood = stand(scene.theme.things, pixels, depth, scene).reported(progress)
        depth = stood.astype(np.float32)
    pixels = label(scene, pixels)
    if scene.annotations.furniture:
        drawn = Drawn(
            renderer.tint, shown, bool(visible(scene.data.layers)), sampled(depth, *depth.shape),
            depth[:, scene.view.width // 2].astype(np.float64),
        )  # fmt: skip
        inset = inset_of(scene, lambda flat: draw(flat, device=renderer.device))
        pixels = furnish(pixels, **furniture_of(scene, drawn), inset=inset, ground=np.isfinite(depth) | void_filled)
    return pixels, depth


def _coarser(scene: Scene, stats: FrameStats, renderer: Renderer) -> list[str]:
    """Warnings about what is drawn coarser than requested because memory is too small."""
    found = []
    if renderer.tree is not None and renderer.tree.full:
        slots = renderer.tree.tree.slots
        found.append(
            f"The ground is coarser than requested: the tree has room for {slots:,} triangles (more: its option "
            f"slots={2 * slots})."
        )
    elif (
        scene.surface.tolerance is not None and stats.error_px is not None
        and stats.error_px > scene.surface.tolerance * (1 + 1e-6)
    ):  # fmt: skip
        off = (
            f"up to {stats.error_px:.2g} pixels off"
            if stats.error_px < np.inf
            else "off by an unknown number of pixels"
        )
        found.append(
            f"The ground is {off}, not {scene.surface.tolerance:g}: more tiles do not fit into the GPU's memory."
        )
    if renderer.imagery.full:
        found.append("Layers are coarser than they could be: more would not fit into the GPU's memory.")
    return found


def renderer_of(device: Device, scene: Scene) -> Renderer:
    """A renderer of the scene's terrain within its budget; a software driver uses the process's memory."""
    allowed = scene.budget.max_memory
    share: dict[str, int] = {}
    if allowed is not None:
        share["memory"] = max(allowed // 8, LEAST)
        if device.adapter.software:
            share["gpu_memory"] = max(min((allowed - DRIVER) // 3, ATLASES), LEAST)
    return Renderer(device, scene.terrain, jobs=scene.budget.jobs, **share)


def largest(device: Device) -> int:
    """Pixels a side that a device can draw at once."""
    return int(device.handle.limits["max-texture-dimension-2d"])


def session() -> Callable[[Scene], Picture]:
    """Draws scene after scene with one renderer, as long as their terrain is the same; each waits for all its tiles.

    Raises:
        NoAdapterError: there is no GPU.
    """
    device = open_device()
    held: list[Renderer] = []
    memo = Memo()

    def drawn(scene: Scene) -> Picture:
        ground, _ = ground_of(scene, device, memo)
        if not held or held[0].terrain is not ground.terrain:
            for renderer in held:
                renderer.close()
            held[:] = [renderer_of(device, ground)]
        return draw(scene, device=device, renderer=held[0], memo=memo)

    return drawn
