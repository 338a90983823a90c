"""Answers to keywords that a description of data does not have: the one that is meant, where that can be told."""

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
"""What attributes are called elsewhere, and here."""


def remedy(name: str, known: Iterable[str]) -> str:
    """What to use instead of a name that is none of ``known``."""
    names = list(known)
    if MEANT.get(name) in names:
        return f"It is called {MEANT[name]} here."
    close = difflib.get_close_matches(name, names, 1)
    return f"Did you mean {close[0]}?" if close else f"There are {', '.join(names)}."


def named(called: str) -> Callable[[type[T]], type[T]]:
    """Have a class answer a keyword that it does not take with a UsageError that names the right one.

    Args:
        called: what its objects are called in messages ("A layer").
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
