"""``orograph.tessellate``: the triangles that a method makes of a terrain for a view."""

from __future__ import annotations

import os
from typing import Any

from orograph.lod.method import Resources
from orograph.lod.needs import kinds_of
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.scene.camera import view_of
from orograph.scene.methods import MEMORY, made
from orograph.scene.parts import check_exaggeration
from orograph.store.opening import terrain as opened
from orograph.tessellation import Tessellation
from orograph.verbs.goals import choice_of, goal_of
from orograph.viewpoint import Camera, View


def tessellate(
    terrain: Any,
    view: View | str | os.PathLike[str] | None = None,
    *,
    method: str = "soar",
    tolerance: float | None = None,
    triangles: int | None = None,
    seconds: float | None = None,
    conservative: bool = False,
    drape: str | os.PathLike[str] | None = None,
    exaggeration: float = 1.0,
    size: tuple[int, int] = (1280, 720),
    check: bool = False,
    output: str | os.PathLike[str] | None = None,
    max_memory: int | None = None,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    **reading: Any,
) -> Tessellation:
    """Triangulate a terrain for a view, within a tolerance in pixels.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options (``reading``).
        view: the camera, "plan", or the path of a VIEW.json; None: all of the terrain, from the south.
        method: what makes the triangles: NAME[,key=value…] (``orograph.methods()``).
        tolerance: pixels by which the mesh may be off on the screen; None: 1, unless another goal is given.
        triangles: instead: at most so many. seconds: instead: what can be done in so much time.
        conservative: refuse a method with which the tolerance is no promise.
        drape: the image whose colours a method's color-tolerance looks at; None: the tint of heights.
        exaggeration: how heights are stretched on the screen. size: (width, height) where there is no view.
        check: let the referee measure the mesh against every sample in view; its report is ``stats["report"]``.
        output: also write it: .npz, .ply, .obj or .glb.
        max_memory: bytes that heights may take. jobs: threads. progress: hears of it; False: nothing is said.

    Returns:
        the mesh; ``stats`` has what the method says of it, and ``bound``: the promise in pixels, or None.

    Raises:
        UsageError: an option makes no sense, or the method makes no triangles. ReadError, StoreError: the terrain
            cannot be read. NothingInViewError: it has no valid sample. OutputError: the file cannot be written.
    """
    heard = reporting(progress)
    choice, goal = choice_of(method, conservative), goal_of(tolerance=tolerance, triangles=triangles, seconds=seconds)
    choice.check_triangles()
    choice.info.check_goal(goal.name)
    check_exaggeration(exaggeration)
    if output is not None:
        from orograph.meshing import mesh_format

        mesh_format(os.fspath(output))
    errors = kinds_of(choice.method.needs(choice.options))
    ground = opened(
        terrain, heard, max_memory=max_memory, jobs=jobs, errors=errors, called="tessellate", **reading
    )  # fmt: skip
    view = view_of(view, ground, size, exaggeration=exaggeration)
    selects = made(choice, ground, Resources((max_memory or MEMORY) // 2, jobs, heard), drape)
    with heard.task(f"Selecting ({choice})"):
        selection = selects.select(Camera.over(ground.grid, view, exaggeration), goal)
        mesh = selection.tessellation()
    selects.close()
    mesh.stats["bound"] = selection.bound
    if check:
        from orograph import verify

        with heard.task("The referee"):
            mesh.stats["report"] = verify.judge_mesh(mesh, ground, view, exaggeration=exaggeration, jobs=jobs).to_dict()
    if output is not None:
        from orograph.meshing import write

        write(mesh, ground.grid, os.fspath(output))
    return mesh
