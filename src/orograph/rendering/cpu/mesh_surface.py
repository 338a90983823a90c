"""A tessellation as ground: the terrain that a mesh represents, so that all terrain drawing can draw it.

The triangles of a hierarchy of right triangles are unions of the cells' own halves (``hierarchy``): a coarse triangle
interpolated at every sample it covers, and drawn by the finest triangulation, is that coarse triangle again, exactly.
So the surface of a mesh is a raster of the terrain's own size, and light, shadows and antialiasing need not know about
meshes. (If the raster is not 2^n + 1 samples a side, triangles squeezed onto its last row and column have slanted
edges, which are accurate only to a cell.)

A large terrain's mesh is instead read by windows (``mesh_terrain``), each as coarse as the picture allows.

Samples that no triangle covers keep the terrain's heights: the method omits them because they are out of view, but
they still cast shadows into the picture; holes stay holes.
"""

from __future__ import annotations

import numpy as np

from orograph.lod.method import Resources
from orograph.memo import Memo
from orograph.progress import SILENT, Progress
from orograph.rendering.cpu.mesh_terrain import MeshTerrain, interpolate
from orograph.rendering.memory import available
from orograph.scene.methods import MEMORY, goal_of, made, mesh_choice
from orograph.scene.scene import Scene
from orograph.store.memory import MemoryTerrain
from orograph.store.terrain import EXACT_SAMPLES, Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera

BYTES_PER_SAMPLE = 4 * (1 + 5 / 12) + 4
"""Bytes per sample of a mesh's surface during drawing: heights and their pyramids."""


WINDOWS = 0.25
"""Tolerance within which a large mesh is drawn exactly, pixels."""


def refined(scene: Scene, progress: Progress = SILENT, memo: Memo | None = None) -> Tessellation:
    """The mesh that the scene's method makes for its view, or for its ``mesh_view``.

    Raises:
        UsageError: there is no such method, it has no such option, or one view needs more tiles than fit into memory.
        StoreError: the store was built without errors of diamonds.
    """
    choice = mesh_choice(scene.surface.method, "cpu")
    assert choice is not None
    surface = scene.surface
    memo = Memo() if memo is None else memo
    view = scene.view.whole if surface.mesh_view is None else surface.mesh_view
    if view.projection == "plan":
        progress.warn("in a plan heights do not move pixels: the coarsest mesh is as good as any.")
    memory = MEMORY if scene.budget.max_memory is None else scene.budget.max_memory // 2
    with progress.task(f"Selecting ({choice})"):
        method = memo(
            "method", (str(choice), memory, scene.budget.jobs),
            lambda: made(choice, scene.terrain, Resources(memory, scene.budget.jobs, progress)), scene.terrain,
        )  # fmt: skip
        camera = Camera.over(scene.terrain.grid, view, scene.surface.exaggeration)
        mesh: Tessellation = method.select(
            camera, goal_of(scene.surface.tolerance, scene.surface.triangles)
        ).tessellation()
    if surface.triangles is not None and len(mesh.triangles) > surface.triangles:
        progress.warn(
            f"{surface.triangles:,} triangles are not enough for a sound mesh of this view by {choice.info.name}: it "
            f"has {len(mesh.triangles):,}."
        )
    return mesh


def surface_of(tessellation: Tessellation, terrain: Terrain, max_memory: int | None = None) -> Terrain:
    """The terrain as its tessellation represents it: at full resolution in memory or, if that is large, by windows.

    Args:
        tessellation: triangles between samples of ``terrain``.
        max_memory: bytes; None: the machine's free memory.

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
    return MemoryTerrain(heights, terrain.grid, terrain.name, terrain.vertical, terrain.attribution)
