"""Methods on the command line: ``--method NAME[,key=value…]``, and its goal.

``@method_option(…)`` gives a verb ``method`` and ``conservative``, ``@goal_options`` ``tolerance``, ``triangles``,
``drape`` and ``exaggeration`` (all are ``REFINE``), ``@terrain_options(…)`` the options about the terrain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.files import check_outputs
from orograph.cli.options import (
    FILE,
    F,
    Float,
    ParamType,
    grid_options,
    jobs_option,
    memory_option,
    source_options,
    vertical_options,
    with_options,
)
from orograph.scene.given import read_method
from orograph.verbs import goals

if TYPE_CHECKING:
    from orograph.error import ErrorKind
    from orograph.lod.registry import Choice

REFINE = ("tolerance", "triangles", "drape", "exaggeration", "conservative")
"""What ``goal_options`` and ``method_option`` add besides the method."""


class MethodText(ParamType):
    """NAME[,key=value…]: the name is checked at once, the options when the method is loaded."""

    name = "NAME[,key=value…]"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        try:
            return read_method(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


def conservative_option(function: F) -> F:
    """``--conservative``."""
    return click.option(
        "--conservative",
        is_flag=True,
        help="Keep the tolerance for every sample in view: sets the options with which the method promises it, or "
        "refuses the method.",
    )(function)


def method_option(help: str, **settings: Any) -> Callable[[F], F]:
    """``--method`` and ``--conservative``; ``settings`` are click's (default, multiple…)."""

    def add(function: F) -> F:
        more = " The methods and their options: orograph methods."
        return click.option("--method", type=MethodText(), help=help + more, **settings)(conservative_option(function))

    return add


def goal_options(function: F) -> F:
    """Give a verb the options that say how fine a mesh should be, and whose colours count."""
    return with_options(
        function,
        click.option(
            "--tolerance",
            type=click.FloatRange(min=0),
            metavar="PX",
            help="How far the mesh may be off on the screen, pixels.  [default: 1]",
        ),
        click.option("--triangles", type=click.IntRange(min=2), metavar="N", help="Instead: maximum number of "
                                                                                  "triangles."),
        click.option(
            "--drape",
            type=FILE,
            metavar="IMAGE",
            help="The image whose colours a method's color-tolerance uses, in any CRS.  [default: the tint of heights]",
        ),
        click.option(
            "--exaggeration", type=Float(), default=1.0, show_default=True, metavar="X",
            help="Stretch heights on the screen.",
        ),
    )  # fmt: skip


def terrain_options(doing: str) -> Callable[[F], F]:
    """Give a verb the options that say how to read the terrain, and ``max_memory`` and ``jobs``.

    Args:
        doing: as ``grid_options``.
    """

    def add(function: F) -> F:
        return with_options(function, grid_options(doing), source_options, vertical_options, memory_option, jobs_option)

    return add


def check_written(
    outputs: Mapping[str, str | None], paths: Sequence[str], options: Mapping[str, Any], **others: str | None
) -> None:
    """Raise UsageError if an output would overwrite what the verb reads.

    Args:
        outputs: as ``files.check_outputs``. paths: of the terrain. others: further files that are read, by what they
            are ("views": the file of --views).
    """
    read = {f"the file of --{name}": [path] for name, path in others.items()}
    check_outputs(
        outputs,
        {"the input": paths, "the image of --drape": [options["drape"]], "the grid of --geoid": [options["geoid"]],
         **read},
    )  # fmt: skip


choice_of = goals.choice_of


def error_kinds(choices: Sequence[Choice]) -> tuple[ErrorKind, ...]:
    """The kinds of diamond errors that methods need, for ``store.prepare``."""
    from orograph.lod.needs import kinds_of

    return kinds_of(need for choice in choices for need in choice.method.needs(choice.options))
