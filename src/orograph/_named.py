"""Errors for unknown keywords of functions, classes and their methods; they name the right one where they can."""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, cast

from orograph.errors import UsageError

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

MEANT = {
    **dict.fromkeys(("cmap", "palette", "color", "colors", "color_map"), "colormap"),
    **dict.fromkeys(("vmin", "vmax", "clim", "limits"), "range"),
    **dict.fromkeys(("alpha", "transparency"), "opacity"),
    **dict.fromkeys(("label", "title"), "name"),
    **dict.fromkeys(("legend",), "key"),
    **dict.fromkeys(("units",), "unit"),
    **dict.fromkeys(("error", "sigma", "std"), "uncertainty"),
    **dict.fromkeys(("cellsize", "cell_size", "pixel_size", "cell"), "spacing"),
    "eye": "eye_height",
    "target": "target_height",
    "flat": "curvature",
}
"""Names of attributes elsewhere → here."""


def remedy(name: str, known: Iterable[str]) -> str:
    """What to use instead of a name that is not in ``known``."""
    names = list(dict.fromkeys(known))
    if MEANT.get(name) in names:
        return f"It is called {MEANT[name]} here."
    close = difflib.get_close_matches(name, names, 1)
    return f"Did you mean {close[0]}?" if close else f"There are {', '.join(names)}."


def answering(function: F, called: str = "", elsewhere: Mapping[str, str] | None = None) -> F:
    """Make a function answer an unknown keyword with a UsageError that names the right one.

    Args:
        called: what messages call it; "": its name, and that keywords are its options.
        elsewhere: remedies for keywords that other functions take.
    """
    parameters = list(inspect.signature(function).parameters.values())
    known = [one.name for one in parameters if one.kind in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY)]
    named = frozenset(known)
    listed = [name for name in known if name != "self"]
    said = f"{called} has no" if called else f"{function.__name__} has no option"

    @functools.wraps(function)
    def answers(*args: Any, **given: Any) -> Any:
        if not given.keys() <= named:
            name = next(name for name in given if name not in named)
            raise UsageError(f"{said} {name!r}.", remedy=(elsewhere or {}).get(name) or remedy(name, listed))
        return function(*args, **given)

    return cast(F, answers)


def named(called: str) -> Callable[[type[T]], type[T]]:
    """Make a class, and the methods that it defines, answer unknown keywords so.

    Args:
        called: the name of its objects in messages ("A layer").
    """

    def answer(cls: type[T]) -> type[T]:
        setattr(cls, "__init__", answering(cls.__init__, called))  # noqa: B010 (a method is no attribute to mypy)
        for name, found in list(vars(cls).items()):
            made = found.__func__ if isinstance(found, classmethod | staticmethod) else found
            if name.startswith("_") or not inspect.isfunction(made) or _takes_any(made):
                continue
            setattr(cls, name, answering(made) if made is found else type(found)(answering(made)))
        return cls

    return answer


def _takes_any(function: Callable[..., Any]) -> bool:
    """Whether a function takes any keyword, or none that could be misspelt."""
    kinds = [one.kind for one in inspect.signature(function).parameters.values()]
    return inspect.Parameter.VAR_KEYWORD in kinds or len(kinds) < 2
