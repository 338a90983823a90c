"""What the pictures of one scene share: under each of its priorities the same data are read and sampled, once.

Things are kept while a scene and its variants are made, and no longer, so that what changes later is read anew.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

T = TypeVar("T")

_HELD: ContextVar[dict[Hashable, tuple[Any, Any]] | None] = ContextVar("shared", default=None)


@contextmanager
def sharing() -> Iterator[None]:
    """Within it ``once`` makes a thing once; within another one the two share."""
    if _HELD.get() is not None:
        yield
        return
    token = _HELD.set({})
    try:
        yield
    finally:
        _HELD.reset(token)


def once(kind: str, of: Any, make: Callable[[], T]) -> T:
    """What was made of ``of`` before, or ``make()``; outside of ``sharing`` always the latter.

    Args:
        of: numbers, texts and data classes, which are told by their values; anything else is told by what it is, not by
            what it holds.
    """
    held = _HELD.get()
    if held is None:
        return make()
    key = kind, _named(of)
    if key not in held:
        held[key] = make(), of  # what is told by its id lives as long
    found: T = held[key][0]
    return found


def _named(value: Any) -> Hashable:
    """A value's name: the same for what is the same."""
    if isinstance(value, (tuple, list)):
        return (type(value), *map(_named, value))
    if is_dataclass(value) and not isinstance(value, type):
        return (type(value), *(_named(getattr(value, one.name)) for one in fields(value)))
    if value is None or isinstance(value, (str, int, float, bool)):
        return type(value), value
    return type(value), id(value)
