"""Methods for scenes: which one makes the mesh of a picture, and a method made with all that it uses.

What draws can draw the terrain by itself: the CPU by rays, the GPU by patches that it streams (``registry.AUTO``). A
scene whose method is that has no mesh; every other's selection is drawn as triangles, on the GPU that of rays by rays.
"""

from __future__ import annotations

import os
from dataclasses import fields, replace
from typing import Any

from orograph.errors import UsageError
from orograph.lod.method import Goal, Method, Resources
from orograph.lod.registry import AUTO, Backend, Choice, chosen
from orograph.store.terrain import Terrain

TOLERANCE = 1.0
"""Pixels: what a method is asked to keep unless the scene says."""

MEMORY = 1 << 30
"""Bytes of tiles that a method may hold where no limit is given."""

ALWAYS = ("cull", "geomorph")
"""Options of patches that the GPU leaves open: it leaves out what is out of view, and lets vertices grow."""


def mesh_choice(method: str, backend: Backend, triangles: int | None = None) -> Choice | None:
    """The method whose selection is drawn; None where the backend draws the terrain by itself.

    Args:
        method: as ``--method`` has it. triangles: a budget, which what the GPU streams does not know.

    Raises:
        UsageError: as ``registry.chosen``; or the backend cannot draw what the method selects.
    """
    if method == "auto":
        return None
    choice = chosen(method, backend)
    own = choice.info.name == AUTO[backend]
    if choice.info.kind == "rays" and backend == "cpu":
        if own and choice.options == choice.info.options():
            return None
        raise UsageError(
            f"{choice} cannot be drawn so: the CPU draws the rays of {AUTO['cpu']} alone, at the exact surface.",
            remedy='Draw it by the GPU (`backend="gpu"`), or choose another.',
        )
    if own and backend == "gpu" and triangles is None:
        usual = choice.info.options()
        there = {f.name for f in fields(usual)}
        same = {name: getattr(usual, name) for name in ALWAYS if name in there}
        if replace(choice.options, **same) == usual:
            return None
    return choice


def check_promise(method: str, backend: Backend) -> None:
    """Raise UsageError unless a tolerance is a promise with a scene's method."""
    if method != "auto":
        chosen(method, backend).check_promise()


def goal_of(tolerance: float | None, triangles: int | None) -> Goal:
    """What a scene's method is asked for."""
    if triangles is not None:
        return Goal(triangles=triangles)
    return Goal(TOLERANCE if tolerance is None else tolerance)


def made(
    choice: Choice, terrain: Terrain, resources: Resources, drape: str | os.PathLike[str] | None = None
) -> Method:  # fmt: skip
    """A method for a terrain, with color errors if its options ask for them.

    Args:
        drape: the image whose colours count; None: the tint of heights.

    Raises:
        UsageError, StoreError: as ``Choice.make``. ReadError: the image cannot be read.
    """
    if getattr(choice.options, "color_tolerance", None) is not None and resources.color is None:
        from orograph.geovis.color_errors import ColorErrors, Colors
        from orograph.geovis.color_store import stored
        from orograph.lod.registry import method_of

        progress = resources.progress
        color: Any
        if method_of(choice.info.name).samples_colored:
            color = Colors(terrain, drape=drape, max_memory=resources.max_memory, progress=progress)
        elif (color := stored(terrain, drape, progress=progress)) is None:
            with progress.task("Colour errors"):
                color = ColorErrors(
                    terrain, drape=drape, max_memory=resources.max_memory, jobs=resources.jobs, progress=progress
                )
        resources = replace(resources, color=color)
    return choice.make(terrain, resources)
