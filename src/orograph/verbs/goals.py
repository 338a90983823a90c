"""The goals of meshes: by which method, how fine. Loads quickly, for the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from orograph.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from orograph.lod.method import Goal
    from orograph.lod.registry import Backend, Choice


def goal_of(**given: Any) -> Goal:
    """The one goal that is given; by default a tolerance of 1 pixel.

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
        UsageError: there is no such method; or, with ``conservative``, its options do not promise the tolerance.
    """
    from orograph.lod.registry import chosen, promised

    return promised(text, backend) if conservative else chosen(text, backend)


def check_colors(drape: Any, choices: Sequence[Choice]) -> None:
    """Raise UsageError if an image is given that nothing uses."""
    if drape is not None and all(getattr(choice.options, "color_tolerance", None) is None for choice in choices):
        raise UsageError(
            "`drape` is only used with a method's color-tolerance.",
            remedy="Give the colour tolerance (ΔE): soar,color-tolerance=2.3.",
        )


def not_enough(budget: int, method: str, made: int) -> str:
    """Warn about a mesh with more triangles than the budget."""
    return f"{budget:,} triangles are not enough for a sound mesh of this view by {method}: it has {made:,}."
