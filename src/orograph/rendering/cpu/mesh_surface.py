"""A tessellation as ground: the terrain that a mesh shows, so that all that draws terrain can draw it.

The triangles of a hierarchy of right triangles are unions of the cells' own halves (``hierarchy``): a coarse triangle
interpolated at every sample it covers, and drawn by the finest triangulation, is that coarse triangle again, exactly.
So the surface of a mesh is a raster of the terrain's own size, and light, shadows and antialiasing need to know nothing
of meshes. (Where the raster is not 2^n + 1 samples a side, triangles squeezed onto its last row and column have slanted
edges, and these are true to a cell.)

A large terrain's mesh is read by windows instead (``mesh_terrain``), each as coarse as the picture allows.

What no triangle covers keeps the terrain's heights: that is ground out of view, left out by the method, which still
casts its shadow into the picture; and holes stay holes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.lod.method import Resources
from orograph.memo import Memo
from orograph.progress import SILENT, Progress
from orograph.rendering.memory import available
from orograph.scene.methods import MEMORY, goal_of, made, mesh_choice
from orograph.scene.scene import EXACT_SAMPLES, Scene
from orograph.store.memory import MemoryTerrain
from orograph.store.terrain import Heights, Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera

BYTES_PER_SAMPLE = 4 * (1 + 5 / 12) + 4
"""Of a mesh's surface while it is drawn: heights and their pyramids."""


WINDOWS = 0.25
"""Pixels within which a large mesh is drawn as it is."""


def refined(scene: Scene, progress: Progress = SILENT, memo: Memo | None = None) -> Tessellation:
    """What the scene's method makes of its terrain for its view, or for its ``mesh_view``.

    Raises:
        UsageError: there is no such method, it has no such option, or one view needs more tiles than fit into memory.
        StoreError: the store was built without errors of diamonds.
    """
    choice = mesh_choice(scene.method, "cpu")
    assert choice is not None
    memo = Memo() if memo is None else memo
    view = scene.view.whole if scene.mesh_view is None else scene.mesh_view
    if view.projection == "plan":
        progress.warn("in a plan no height moves a pixel: the coarsest mesh is as good as any.")
    memory = MEMORY if scene.max_memory is None else scene.max_memory // 2
    with progress.task(f"Selecting ({choice})"):
        method = memo(
            "method", (str(choice), memory, scene.jobs),
            lambda: made(choice, scene.terrain, Resources(memory, scene.jobs, progress)), scene.terrain,
        )  # fmt: skip
        camera = Camera.over(scene.terrain.grid, view, scene.exaggeration)
        mesh: Tessellation = method.select(camera, goal_of(scene.tolerance, scene.triangles)).tessellation()
    if scene.triangles is not None and len(mesh.triangles) > scene.triangles:
        progress.warn(
            f"{scene.triangles:,} triangles are not enough for a sound mesh of this view by {choice.info.name}: it has "
            f"{len(mesh.triangles):,}."
        )
    return mesh


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
        from orograph.rendering.cpu.mesh_terrain import MeshTerrain

        return MeshTerrain(tessellation, terrain)
    heights = np.array(terrain.read(0, 0, rows, 0, cols), np.float32)
    fill_triangles(tessellation.vertices, tessellation.triangles, heights)
    return MemoryTerrain(heights, terrain.grid, terrain.name, terrain.vertical)


@kernel
def fill_triangles(vertices: NDArray[np.float64], triangles: NDArray[np.int32], heights: Heights) -> None:
    """Interpolate triangles at the samples they cover.

    Args:
        vertices: (n, 3) float64, column, row (whole numbers), height in metres.
        triangles: (m, 3) int32.
        heights: (rows, cols) float32, overwritten where a triangle is.
    """
    for k in range(len(triangles)):
        a, b, c = vertices[triangles[k, 0]], vertices[triangles[k, 1]], vertices[triangles[k, 2]]
        ax, ay, bx, by, cx, cy = int(a[0]), int(a[1]), int(b[0]), int(b[1]), int(c[0]), int(c[1])
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0:
            continue
        across = ((b[2] - a[2]) * (cy - ay) - (c[2] - a[2]) * (by - ay)) / area
        down = ((c[2] - a[2]) * (bx - ax) - (b[2] - a[2]) * (cx - ax)) / area
        turned = 1 if area > 0 else -1
        for y in range(min(ay, by, cy), max(ay, by, cy) + 1):
            for x in range(min(ax, bx, cx), max(ax, bx, cx) + 1):
                if (
                    turned * ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) >= 0
                    and turned * ((cx - bx) * (y - by) - (x - bx) * (cy - by)) >= 0
                    and turned * ((ax - cx) * (y - cy) - (x - cx) * (ay - cy)) >= 0
                ):
                    heights[y, x] = a[2] + across * (x - ax) + down * (y - ay)
    for k in range(len(triangles)):  # to the bit
        for corner in range(3):
            v = vertices[triangles[k, corner]]
            heights[int(v[1]), int(v[0])] = v[2]
