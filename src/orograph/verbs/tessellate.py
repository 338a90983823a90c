"""``orograph.tessellate``: the triangles that a method makes of a terrain for a view."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orograph._named import answering
from orograph.compiling import expect
from orograph.errors import NothingInViewError, UsageError
from orograph.folders import Amount, bytes_of
from orograph.lod.method import Resources
from orograph.lod.needs import kinds_of
from orograph.lod.registry import Choice
from orograph.mesh_files import mesh_format
from orograph.output import check_folder
from orograph.progress import Progress
from orograph.reporting import reporting
from orograph.scene.camera import view_of
from orograph.scene.diagnostics import LEAVE_CAMERA
from orograph.scene.methods import MEMORY, made
from orograph.scene.parts import check_exaggeration
from orograph.scene.sizes import Size
from orograph.store.opening import terrain as opened
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.verbs.goals import check_colors, choice_of, goal_of, not_enough
from orograph.viewpoint import Camera, View

if TYPE_CHECKING:
    from orograph.verify import Report

METHOD = "soar"
"""The method, unless another is asked for."""


@dataclass(frozen=True, slots=True)
class Triangulated:
    """A mesh and what it was made for.

    Attributes:
        choice: the method. terrain, view: what was triangulated, and for which camera.
        stats: what the method says of the selection. bound: the promised error in pixels; None: there is none.
        report: the referee's report, if requested.
    """

    mesh: Tessellation
    choice: Choice
    terrain: Terrain
    view: View
    stats: dict[str, Any]
    bound: float | None
    report: Report | None


@answering
def tessellate(
    terrain: Any,
    view: View | str | os.PathLike[str] | None = None,
    *,
    method: str = METHOD,
    tolerance: float | None = None,
    triangles: int | None = None,
    seconds: float | None = None,
    conservative: bool = False,
    drape: str | os.PathLike[str] | None = None,
    exaggeration: float = 1.0,
    size: Size = (1280, 720),
    check: bool = False,
    output: str | os.PathLike[str] | None = None,
    max_memory: Amount | None = None,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    **reading: Any,
) -> Tessellation:
    """Triangulate a terrain for a view, within a tolerance in pixels.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options (``reading``).
        view: the camera, "plan", or the path of a VIEW.json; None: all of the terrain, from the south.
        method: the method that makes the triangles: NAME[,key=value…] (``orograph.methods()``).
        tolerance: how far the mesh may be off on the screen, pixels; None: 1, unless another goal is given.
        triangles: instead: the maximum number of triangles. seconds: instead: the best mesh that this time allows.
        conservative: keep the tolerance for every sample in view: sets the options with which the method promises
            it, or refuses the method.
        drape: the image whose colours a method's color-tolerance looks at; None: the tint of heights.
        exaggeration: how heights are stretched on the screen. size: (width, height) if no view is given.
        check: let the referee measure the mesh against every sample in view; its report is ``stats["report"]``.
        output: also write it: .npz, .ply, .obj or .glb.
        max_memory: bytes that heights may take. jobs: threads. progress: gets progress reports; False: silent.

    Returns:
        the mesh; ``stats`` has the method's statistics, and ``bound``: the promised error in pixels, or None.

    Raises:
        UsageError: an option makes no sense, or the method makes no triangles. ReadError, StoreError: the terrain
            cannot be read. NothingInViewError: none of it is in view. OutputError: the file cannot be written.
    """
    made = triangulate(
        terrain, lambda ground: view_of(view, ground, size, exaggeration=exaggeration), method=method,
        goals={"tolerance": tolerance, "triangles": triangles, "seconds": seconds}, conservative=conservative,
        drape=drape, exaggeration=exaggeration, check=check, output=output, max_memory=bytes_of(max_memory), jobs=jobs,
        progress=reporting(progress), **reading,
    )  # fmt: skip
    made.mesh.stats["bound"] = made.bound
    if made.report is not None:
        made.mesh.stats["report"] = made.report.to_dict()
    return made.mesh


def triangulate(
    terrain: Any, view: Callable[[Terrain], View], *, method: str, goals: dict[str, Any], conservative: bool,
    drape: Any, exaggeration: float, check: bool, output: str | os.PathLike[str] | None, max_memory: int | None,
    jobs: int | None, progress: Progress, **reading: Any,
) -> Triangulated:  # fmt: skip
    """As ``tessellate``, but returns everything that there is to report.

    Args:
        view: makes the camera for the terrain. goals: of which one may be given (``goal_of``).
    """
    choice, goal = choice_of(method, conservative), goal_of(**goals)
    choice.check_triangles()
    choice.info.check_goal(goal.name)
    check_colors(drape, [choice])
    check_exaggeration(exaggeration)
    if output is not None:
        mesh_format(os.fspath(output))
        check_folder(Path(output))
    if choice.info.name == METHOD:  # whose kernels are known to be needed
        expect("tessellate")
    errors = kinds_of(choice.method.needs(choice.options))
    ground = opened(
        terrain, progress, max_memory=max_memory, jobs=jobs, errors=errors, called="tessellate", **reading
    )  # fmt: skip
    if conservative:
        choice.check_promise(ground)
    seen = view(ground)
    selects = made(choice, ground, Resources((max_memory or MEMORY) // 2, jobs, progress), drape)
    with progress.task(f"Selecting ({choice})"):
        selection = selects.select(Camera.over(ground.grid, seen, exaggeration), goal)
        mesh = replace(selection.tessellation(), grid=ground.grid)
    selects.close()
    if not len(mesh.triangles):
        raise NothingInViewError(
            "Nothing of the terrain is in view: there are no triangles.", path=ground.name, remedy=LEAVE_CAMERA
        )
    if conservative and goal.tolerance is not None:
        _check_kept(choice, selection.bound, goal.tolerance)
    if goal.triangles is not None and len(mesh.triangles) > goal.triangles:
        progress.warn(not_enough(goal.triangles, choice.info.name, len(mesh.triangles)))
    if output is not None:
        with progress.task("Writing"):
            mesh.save(output)
    report = None
    if check:
        from orograph import verify

        with progress.task("The referee"):
            report = verify.judge_mesh(mesh, ground, seen, exaggeration=exaggeration, jobs=jobs)
    return Triangulated(mesh, choice, ground, seen, selection.stats, selection.bound, report)


def _check_kept(choice: Choice, bound: float | None, tolerance: float) -> None:
    """Raise UsageError if the bound of a view exceeds the tolerance: the finest triangles are too coarse for it."""
    if bound is None or bound > tolerance:
        least = "no bound" if bound is None else f"a bound of {bound:.3g} pixels"
        raise UsageError(
            f"With {choice} this view has {least}, but `conservative` requires a tolerance of {tolerance:g}.",
            remedy=f"Give a larger tolerance, another method, or other options (orograph methods {choice.info.name}).",
        )
