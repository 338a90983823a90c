"""Methods for scenes: choose the method that makes the mesh of a picture, and create it with all that it needs.

Each backend can draw the terrain by itself: the CPU by rays, the GPU by patches that it streams (``registry.AUTO``). A
scene with that method has no mesh; the selection of any other method is drawn as triangles, or on the GPU as rays if it
selects rays.
"""

from __future__ import annotations

import os
from dataclasses import fields, replace
from typing import Any

from orograph.errors import UsageError
from orograph.lod.method import Goal, Method, Resources
from orograph.lod.registry import AUTO, Backend, Choice, chosen, promised
from orograph.store.terrain import Terrain

TOLERANCE = 1.0
"""The tolerance that a method keeps unless the scene sets one, pixels."""

MEMORY = 1 << 30
"""Bytes of tiles that a method may hold if no limit is given."""

ALWAYS = ("cull", "geomorph")
"""Options of patches that are fixed on the GPU: it culls, and lets vertices grow."""


def mesh_choice(method: str, backend: Backend, triangles: int | None = None) -> Choice | None:
    """The method whose selection is drawn; None if the backend draws the terrain by itself.

    Args:
        method: as for ``--method``. triangles: a budget, which streamed patches do not support.

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
            f"{choice} cannot be drawn by the CPU: it draws only the rays of {AUTO['cpu']}, at the exact surface.",
            remedy='Draw it on the GPU (`backend="gpu"`), or choose another.',
        )
    if own and backend == "gpu" and triangles is None:
        usual = choice.info.options()
        there = {f.name for f in fields(usual)}
        same = {name: getattr(usual, name) for name in ALWAYS if name in there}
        if replace(choice.options, **same) == usual:
            return None
    return choice


def conservative_method(method: str, backend: Backend) -> str:
    """A scene's method with the options that promise its tolerance (``registry.promised``)."""
    return method if method == "auto" else str(promised(method, backend))


def check_promise(method: str, backend: Backend, terrain: Terrain) -> None:
    """Raise UsageError if a ``conservative_method`` cannot promise its tolerance for a terrain."""
    if method != "auto":
        promised(method, backend).check_promise(terrain)


def goal_of(tolerance: float | None, triangles: int | None) -> Goal:
    """The goal of a scene's method."""
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
    return choice.make(terrain, colored(choice, terrain, resources, drape))


def colored(
    choice: Choice, terrain: Terrain, resources: Resources, drape: str | os.PathLike[str] | None = None
) -> Resources:  # fmt: skip
    """Resources with color errors if a method's options ask for them; arguments and errors as for ``made``."""
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
    return resources
