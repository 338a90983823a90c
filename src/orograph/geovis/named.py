"""Errors for unknown keywords of a description of data; they name the intended keyword where they can."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from orograph.errors import UsageError

T = TypeVar("T")

MEANT = {
    **dict.fromkeys(("cmap", "palette", "color", "colors", "color_map"), "colormap"),
    **dict.fromkeys(("vmin", "vmax", "clim", "limits"), "range"),
    **dict.fromkeys(("alpha", "transparency"), "opacity"),
    **dict.fromkeys(("label", "title"), "name"),
    **dict.fromkeys(("legend",), "key"),
    **dict.fromkeys(("units",), "unit"),
    **dict.fromkeys(("error", "sigma", "std"), "uncertainty"),
}
"""Names of attributes elsewhere → here."""


def remedy(name: str, known: Iterable[str]) -> str:
    """What to use instead of a name that is not in ``known``."""
    names = list(known)
    if MEANT.get(name) in names:
        return f"It is called {MEANT[name]} here."
    close = difflib.get_close_matches(name, names, 1)
    return f"Did you mean {close[0]}?" if close else f"There are {', '.join(names)}."


def by_class(text: str) -> dict[str, str]:
    """What the command line gives for classes: ``11:Open water;21:Town``.

    Raises:
        UsageError: a part has no colon.
    """
    pairs = [part.strip().partition(":") for part in text.split(";") if part.strip()]
    if not pairs or any(not colon or not value.strip() for _, colon, value in pairs):
        raise UsageError(f"{text!r} is not a list of classes.", remedy="Write CLASS:VALUE;CLASS:VALUE….")
    return {key.strip(): value.strip() for key, _, value in pairs}


def named(called: str) -> Callable[[type[T]], type[T]]:
    """Make a class answer an unknown keyword with a UsageError that names the right one.

    Args:
        called: the name of its objects in messages ("A layer").
    """

    def answering(cls: type[T]) -> type[T]:
        make: Any = cls.__init__
        known = list(inspect.signature(make).parameters)[1:]

        @functools.wraps(make)
        def init(self: T, *args: Any, **given: Any) -> None:
            for name in given:
                if name not in known:
                    raise UsageError(f"{called} has no {name!r}.", remedy=remedy(name, known))
            make(self, *args, **given)

        setattr(cls, "__init__", init)  # noqa: B010 (a method is no attribute to mypy)
        return cls

    return answering
