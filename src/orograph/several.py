"""One or several values of a kind, as users give them: a sequence, a single value, or a text with commas."""

from __future__ import annotations

from collections.abc import Iterable
from numbers import Real

from orograph.errors import UsageError

Numbers = float | str | Iterable[float]
"""One number, several, or their text: 30, (30, 60), "30,60"."""


def words(value: str | Iterable[str]) -> tuple[str, ...]:
    """The words of "a,b" or of a sequence; "none" gives no words."""
    if isinstance(value, str):
        return () if value == "none" else tuple(word.strip() for word in value.split(","))
    return tuple(value)


def numbers(value: Numbers, called: str) -> tuple[float, ...]:
    """Convert numbers given in any of these ways.

    Args:
        called: the argument, for errors.

    Raises:
        UsageError: it holds something else.
    """
    try:
        if isinstance(value, Real):
            return (float(value),)
        return tuple(float(one) for one in (value.split(",") if isinstance(value, str) else value))  # type: ignore[union-attr]
    except (TypeError, ValueError):
        raise UsageError(f"`{called}` must be one or several numbers, not {value!r}.") from None
