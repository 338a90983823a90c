"""What meshes are asked for: by which method, how fine. Loads quickly, for the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from orograph.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from orograph.lod.method import Goal
    from orograph.lod.registry import Backend, Choice


def goal_of(**given: Any) -> Goal:
    """The one goal that is given; else a tolerance of 1 pixel.

    Raises:
        UsageError: more than one is.
    """
    from orograph.lod.method import Goal

    said = {name: value for name, value in given.items() if value is not None}
    if len(said) > 1:
        raise UsageError(f"Give one goal: {' or '.join(f'`{name}`' for name in said)}.")
    return Goal(**(said or {"tolerance": 1.0}))


def choice_of(text: str, conservative: bool, backend: Backend = "cpu") -> Choice:
    """The method that a text describes, NAME[,key=value…].

    Raises:
        UsageError: it is none; or, with ``conservative``, a tolerance is no promise with its options.
    """
    from orograph.lod.registry import chosen

    choice = chosen(text, backend)
    if conservative:
        choice.check_promise()
    return choice


def check_colors(drape: Any, choices: Sequence[Choice]) -> None:
    """Raise UsageError where an image is given that nothing uses."""
    if drape is not None and all(getattr(choice.options, "color_tolerance", None) is None for choice in choices):
        raise UsageError(
            "`drape` is looked at for a method's color-tolerance.",
            remedy="Say how much colours may change (ΔE): soar,color-tolerance=2.3.",
        )


def not_enough(budget: int, method: str, made: int) -> str:
    """The warning about a mesh with more triangles than asked for."""
    return f"{budget:,} triangles are not enough for a sound mesh of this view by {method}: it has {made:,}."
