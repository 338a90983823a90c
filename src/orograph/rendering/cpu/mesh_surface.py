"""A tessellation as ground: the terrain that an engine shows, so that all that draws terrain can draw it.

The triangles of a hierarchy of right triangles are unions of the cells' own halves (``hierarchy``): a coarse triangle
interpolated at every sample it covers, and drawn by the finest triangulation, is that coarse triangle again, exactly.
So the surface of a mesh is a raster of the terrain's own size, and light, shadows and antialiasing need to know nothing
of meshes. (Where the raster is not 2^n + 1 samples a side, triangles squeezed onto its last row and column have slanted
edges, and these are true to a cell.)

A large terrain's mesh is read by windows instead (``mesh_terrain``), each as coarse as the picture allows.

What no triangle covers keeps the terrain's heights: that is ground out of view, left out by the engine, which still
casts its shadow into the picture; and holes stay holes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from orograph.memo import Memo
from orograph.progress import SILENT, Progress
from orograph.rendering.cpu.mesh_terrain import MeshTerrain, interpolate
from orograph.rendering.memory import available
from orograph.scene.scene import EXACT_SAMPLES, Scene
from orograph.store.memory import MemoryTerrain
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation

BYTES_PER_SAMPLE = 4 * (1 + 5 / 12) + 4
"""Of a mesh's surface while it is drawn: heights and their pyramids."""


TOLERANCE = 1.0
"""Pixels: what an engine is asked to keep unless the scene says."""

WINDOWS = 0.25
"""Pixels within which a large mesh is drawn as it is."""

ENGINE_MEMORY = 1 << 30
"""Bytes of tiles that an engine may hold where no limit is given."""


def refined(scene: Scene, progress: Progress = SILENT, memo: Memo | None = None) -> Tessellation:
    """What the scene's engine makes of its terrain for its view, or for its ``mesh_view``.

    Raises:
        UsageError: there is no such engine, it has no such metric, or one view needs more tiles than fit into memory.
        StoreError: the store was built without errors of diamonds.
    """
    from orograph.lod import engine_of

    asked, jobs = scene.surface, scene.budget.jobs
    assert asked.engine is not None
    memo = Memo() if memo is None else memo
    view = scene.view.whole if asked.mesh_view is None else asked.mesh_view
    if view.projection == "plan":
        progress.warn("in a plan no height moves a pixel: the coarsest mesh is as good as any.")
    make = engine_of(asked.engine)
    memory = ENGINE_MEMORY if scene.budget.max_memory is None else scene.budget.max_memory // 2
    with progress.task(f"Refining ({asked.engine})"):
        engine = memo(
            "engine", (asked.engine, asked.metric, asked.exaggeration, memory, jobs),
            lambda: make(
                scene.terrain, metric=asked.metric, exaggeration=asked.exaggeration, max_memory=memory, jobs=jobs
            ),
            scene.terrain,
        )  # fmt: skip
        mesh = engine.refine(view, **goal(scene))
    if asked.triangles is not None and len(mesh.triangles) > asked.triangles:
        progress.warn(
            f"{asked.triangles:,} triangles are not enough for a sound mesh of this view by {asked.engine}: it has "
            f"{len(mesh.triangles):,}."
        )
    return mesh


def goal(scene: Scene) -> dict[str, Any]:
    """What the scene's engine is asked for, as keyword arguments of ``Engine.refine``."""
    if scene.surface.triangles is not None:
        return {"triangles": scene.surface.triangles}
    return {"tolerance": TOLERANCE if scene.surface.tolerance is None else scene.surface.tolerance}


def surface_of(tessellation: Tessellation, terrain: Terrain, max_memory: int | None = None) -> Terrain:
    """The terrain as a tessellation of it shows it: at full resolution in memory, or, where that is large, by windows.

    Args:
        tessellation: triangles between samples of ``terrain``.
        max_memory: bytes; None: whatever the machine has free.

    Raises:
        DamagedChunkError: as ``terrain.read``.
    """
    rows, cols = terrain.grid.shape
    needed = int(rows * cols * BYTES_PER_SAMPLE)
    limits = [limit for limit in (max_memory, available()) if limit is not None]
    if rows * cols > EXACT_SAMPLES or (limits and needed > min(limits)):
        return MeshTerrain(tessellation, terrain)
    heights = np.array(terrain.read(0, 0, rows, 0, cols), np.float32)
    interpolate(tessellation.vertices, tessellation.triangles, 0, 0, 0, rows, cols, heights)
    return MemoryTerrain(heights, terrain.grid, terrain.name, terrain.vertical)
