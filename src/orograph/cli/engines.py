"""Engines on the command line: the options of refinement, what of them contradicts, and the engine they describe.

``@engine_option(…)`` gives a verb ``engine``; ``@refine_options`` gives ``tolerance``, ``triangles``, ``error``,
``no_cull``, ``drape`` and ``color_tolerance`` (``REFINE``). ``make_engine`` makes an engine of them once the terrain is
known.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.options import FILE, F, FloatRange
from orograph.errors import UsageError
from orograph.lod import ENGINES, engine_of

if TYPE_CHECKING:
    from orograph.lod.engine import Engine
    from orograph.lod.field import ColorErrors
    from orograph.progress import Progress
    from orograph.store.terrain import Terrain

REFINE = ("tolerance", "triangles", "error", "no_cull", "drape", "color_tolerance")
"""What ``refine_options`` gives."""


def engine_option(**settings: Any) -> Callable[[F], F]:
    """``--engine``: the name of a method of refinement; ``settings`` are click's (required, help…)."""
    return click.option("--engine", type=click.Choice(list(ENGINES)), **settings)


def refine_options(function: F) -> F:
    """Give a verb the options that say how finely an engine is to refine, and by what errors."""
    for option in reversed(
        [
            click.option(
                "--tolerance",
                type=FloatRange(min=0),
                metavar="PX",
                help="Pixels by which the mesh may be off on the screen.  [default: 1]",
            ),
            click.option("--triangles", type=click.IntRange(min=2), metavar="N", help="Instead: at most so many."),
            click.option(
                "--error",
                type=click.Choice(["exact", "wedgie", "midpoint"]),
                default="exact",
                show_default=True,
                help="Object-space errors; midpoint bounds nothing.",
            ),
            click.option("--no-cull", is_flag=True, help="Refine what is out of view, too."),
            click.option(
                "--drape",
                type=FILE,
                metavar="IMAGE",
                help="The image whose colours --color-tolerance looks at, in any CRS.  [default: the tint of heights]",
            ),
            click.option(
                "--color-tolerance",
                type=FloatRange(min=0),
                metavar="ΔE",
                help="Refine also where coarser triangles would change colours by more (CIELAB; 2.3 is just seen).",
            ),
        ]
    ):
        function = option(function)
    return function


def goal_of(options: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """The one of the options ``names`` that is given, as keyword arguments of ``Engine.refine``.

    Raises:
        UsageError: more than one is.
    """
    given = {name: options[name] for name in names if options[name] is not None}
    if len(given) > 1:
        raise UsageError(f"Give one goal: {' or '.join(f'--{name}' for name in given)}.")
    return given or {"tolerance": 1.0}


def not_enough(budget: int, engine: str, made: int) -> str:
    """The warning about a mesh with more triangles than asked for."""
    return f"{budget:,} triangles are not enough for a sound mesh of this view by {engine}: it has {made:,}."


def check_colors(options: Mapping[str, Any]) -> None:
    """Raise UsageError where an image is given of which nothing is asked."""
    if options["drape"] is not None and options["color_tolerance"] is None:
        raise UsageError("--drape is looked at for --color-tolerance.", remedy="Say how much colours may change (ΔE).")


def color_errors(
    terrain: Terrain, options: Mapping[str, Any], max_memory: int, jobs: int | None, progress: Progress
) -> ColorErrors | None:
    """What colour differences engines are to heed, if any."""
    if options["color_tolerance"] is None:
        return None
    from orograph.geovis.color_errors import ColorErrors as Errors
    from orograph.geovis.color_store import stored

    found = stored(terrain, options["drape"], progress=progress)
    if found is not None:
        return found
    with progress.task("Colour errors"):
        return Errors(terrain, drape=options["drape"], max_memory=max_memory, jobs=jobs, progress=progress)


def make_engine(
    name: str, terrain: Terrain, options: Mapping[str, Any], *, color: ColorErrors | None, max_memory: int,
    jobs: int | None, metric: str | None = None, geomorph: bool = False,
) -> Engine:  # fmt: skip
    """The engine that the options describe.

    Raises:
        UsageError: as the engine, or it knows no geomorphs. StoreError: the store was built without these errors.
    """
    kind = engine_of(name)
    special: dict[str, Any] = {}
    if geomorph:
        if "geomorph" not in inspect.signature(kind).parameters:
            raise UsageError(f"{name} makes no geomorphs.", remedy="Use --engine soar or --engine batched.")
        special["geomorph"] = True
    return kind(
        terrain, error=options["error"], metric=metric, cull=not options["no_cull"],
        exaggeration=options["exaggeration"], color=color, color_tolerance=options["color_tolerance"],
        max_memory=max_memory // 2, jobs=jobs, **special,
    )  # fmt: skip
