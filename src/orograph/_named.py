"""Arguments of functions, classes and their methods: what is wrong with them is said before the work begins.

An unknown keyword is answered with the right one where there is one. Numbers and switches must be of the kind that the
signature names.
"""

from __future__ import annotations

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
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
    **dict.fromkeys(("method", "for_"), "methods"),
    **dict.fromkeys(("bounds", "aoi"), "bbox"),
    **dict.fromkeys(("extent", "affine", "geotransform"), "transform"),
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


def _whole(value: Any) -> bool:
    return hasattr(value, "__index__") and getattr(value, "ndim", 0) == 0 and not isinstance(value, bool)


def _number(value: Any) -> bool:
    """Whether a value is one number: Python's, NumPy's, or the only element of an array without dimensions."""
    return hasattr(value, "__float__") and getattr(value, "ndim", 0) == 0 and not isinstance(value, bool)


KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "int": ("a whole number", _whole),
    "float": ("a number", _number),
    "bool": ("True or False", lambda value: not isinstance(value, str)),
}
"""By annotation: what a value must be, in words, and whether it is."""

NAMED = ("band",)
"""Numbers of things with names: who knows these answers a name with its number."""


def simple(annotations: Mapping[str, str]) -> dict[str, tuple[str, bool]]:
    """The arguments that are a number or a switch: their ``KINDS``, and whether they may be None."""
    found = {}
    for name, annotation in annotations.items():
        kind, _, more = annotation.partition(" | ")
        if kind in KINDS and more in ("", "None") and name not in NAMED:
            found[name] = kind, bool(more)
    return found


def check_simple(kinds: Mapping[str, tuple[str, bool]], given: Iterable[tuple[str, Any]]) -> None:
    """Raise UsageError if one of the given arguments is not of its kind (``simple``)."""
    for name, value in given:
        if name in kinds:
            kind, optional = kinds[name]
            words, fits = KINDS[kind]
            if not (optional if value is None else fits(value)):
                raise UsageError(f"`{name}` must be {words}{', or none' if optional else ''}, not {value!r}.")


def checking(function: Callable[..., Any]) -> Callable[[Sequence[Any], Mapping[str, Any]], None]:
    """``check_simple`` for a function's arguments by position and by keyword, from its signature."""
    parameters = inspect.signature(function).parameters
    kinds = simple({name: str(one.annotation) for name, one in parameters.items()})
    names = tuple(parameters)
    if not kinds:
        return lambda args, given: None
    return lambda args, given: check_simple(kinds, (*zip(names, args), *given.items()))


def answering(function: F, called: str = "", elsewhere: Mapping[str, str] | None = None) -> F:
    """Make a function check its arguments: what it does not know or cannot take is a UsageError with the right one.

    Args:
        called: what messages call it; "": its name, and that keywords are its options.
        elsewhere: remedies for keywords that other functions take.
    """
    parameters = list(inspect.signature(function).parameters.values())
    check, any_name = checking(function), any(one.kind is one.VAR_KEYWORD for one in parameters)
    known = [one.name for one in parameters if one.kind in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY)]
    named = frozenset(known)
    listed = [name for name in known if name != "self"]
    said = f"{called} has no" if called else f"{function.__name__} has no option"

    @functools.wraps(function)
    def answers(*args: Any, **given: Any) -> Any:
        if not any_name and not given.keys() <= named:
            name = next(name for name in given if name not in named)
            raise UsageError(f"{said} {name!r}.", remedy=(elsewhere or {}).get(name) or remedy(name, listed))
        check(args, given)
        return function(*args, **given)

    return cast(F, answers)


def named(called: str) -> Callable[[type[T]], type[T]]:
    """Make a class, and the methods that it defines, check their arguments so.

    Args:
        called: the name of its objects in messages ("A layer").
    """

    def answer(cls: type[T]) -> type[T]:
        setattr(cls, "__init__", answering(cls.__init__, called))  # noqa: B010 (a method is no attribute to mypy)
        for name, found in list(vars(cls).items()):
            made = found.__func__ if isinstance(found, classmethod | staticmethod) else found
            if name.startswith("_") or not inspect.isfunction(made) or len(inspect.signature(made).parameters) < 2:
                continue
            setattr(cls, name, answering(made) if made is found else type(found)(answering(made)))
        return cls

    return answer
