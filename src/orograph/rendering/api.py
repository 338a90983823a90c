"""``orograph.render``: from a terrain, a DEM or a path to a picture, in one call.

Its keyword arguments are the options of ``scene.parts``: their signature and their documentation are made from there.
"""

from __future__ import annotations

import difflib
import inspect
import os
import textwrap
from typing import Any, Literal

from orograph.dem.raster import Dem
from orograph.errors import UsageError
from orograph.lod.options import Described
from orograph.progress import SILENT, Progress
from orograph.rendering.backends import BACKENDS, draw
from orograph.rendering.memory import check_memory
from orograph.rendering.picture import Picture
from orograph.scene.parts import OPTIONS, check_options
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

CAMERA = ("azimuth", "pitch", "distance", "lonlat", "look_at", "fov", "fov_y", "projection", "eye", "target")
"""What the command line has options for, and here a view."""


def render(
    terrain: Terrain | Dem | str | os.PathLike[str],
    view: View | None = None,
    *,
    size: tuple[int, int] = (1280, 720),
    backend: Literal["cpu", "gpu"] = "cpu",
    progress: Progress = SILENT,
    **options: Any,
) -> Picture:
    """Draw a relief picture.

    Args:
        terrain: an opened terrain, a DEM in memory, or the path of a DEM or a store.
        view: the camera, made with ``orograph.View(eye, target)`` in the terrain's CRS, or for a terrain by
            ``orograph.camera`` (the module ``orograph.scene.camera``): ``whole(terrain, size)``,
            ``around(terrain, size, azimuth=225, pitch=30, distance=None)``, ``standing(terrain, size, (lon, lat,
            height), (lon, lat))`` or ``plan(terrain, size)``. None: all of the terrain, from the south.
        size: (width, height) in pixels where there is no view; with one, the view's own count. Default 1280 × 720.
        backend: "cpu", or "gpu": the same picture drawn by a graphics processor (or, with a warning, by the CPU where
            there is none). Default "cpu".
        progress: hears of what is being done, and of warnings. Default: nothing is said.
        options: see below.

    Returns:
        a ``Picture``: ``save(path)``, ``pixels`` (height, width, 3) uint8, ``depth`` (height, width) float32 metres.

    Raises:
        ReadError, StoreError: the path cannot be read.
        UsageError: an option is unknown or makes no sense, or the picture does not fit into memory.
        NothingInViewError: the picture would be empty.
    """
    for name in options:
        if name not in OPTIONS:
            raise _unknown(name)
    if backend not in BACKENDS:
        raise UsageError(f"There is no backend {backend!r}; there are {', '.join(BACKENDS)}.")
    max_memory, jobs = options.get("max_memory"), options.get("jobs")
    check_memory((view.width, view.height) if view is not None else size, max_memory)
    check_options(options)
    if isinstance(terrain, (str, os.PathLike)):
        from orograph.scene.prepare import prepare

        terrain = prepare([os.fspath(terrain)], max_memory=max_memory, jobs=jobs, progress=progress)
    elif isinstance(terrain, Dem):
        from orograph.store import terrain as in_memory

        terrain = in_memory(terrain)
    if view is None:
        from orograph.rendering.furniture.furnish import insets
        from orograph.scene.camera import NO_INSETS, whole

        view = whole(
            terrain, size, exaggeration=options.get("exaggeration", 1.0),
            insets=insets(size, "; ".join(terrain.attribution)) if options.get("furniture") else NO_INSETS,
        )  # fmt: skip
    return draw(Scene.of(terrain, view, **options), progress, backend=backend)


def _unknown(name: str) -> UsageError:
    """The error of an option that there is not, naming those that may be meant."""
    options = list(inspect.signature(render).parameters)
    if name in CAMERA:
        remedy = "Where to look from is said by a view: see orograph.camera, or orograph.View."
    elif close := difflib.get_close_matches(name, options, 3, 0.6):
        remedy = f"Did you mean {' or '.join(close)}?"
    else:
        remedy = f"There are {', '.join(options[1:])}."
    return UsageError(f"render has no option {name!r}.", remedy=remedy)


def _document() -> None:
    """Give ``render`` the signature and the documentation of a scene's options."""
    own = inspect.signature(render)
    *before, _ = own.parameters.values()
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=one.default, annotation=one.annotation)
        for name, one in OPTIONS.items()
    ]
    setattr(render, "__signature__", own.replace(parameters=[*before, *more]))  # noqa: B010
    if render.__doc__ is not None:  # (there is none with -OO)
        told = "".join(
            textwrap.fill(
                f"{name}: {_text(one)}", 120, initial_indent=" " * 8, subsequent_indent=" " * 12, break_on_hyphens=False
            ) + "\n"
            for name, one in OPTIONS.items()
        )  # fmt: skip
        render.__doc__ = render.__doc__.replace("        options: see below.\n", told)


def _text(one: Described) -> str:
    """An option's help, as Python has it, and its default."""
    default = one.shown or ("none" if one.default in (None, ()) else repr(one.default))
    takes = "" if one.given is None else f" {inspect.getdoc(one.given)}"
    return f"{one.help}{takes} Default: {default}.".replace("`", "``")


_document()
