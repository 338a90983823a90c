"""What pictures of the same data share: what was read and sampled, once.

``once`` serves the pictures of one scene: things are kept while it and its variants are made, and no longer. ``Kept``
serves windows and films, whose scenes follow each other: it keeps what was read of sources, told by their state on the
disk, so that what changes is read anew. Units: bytes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
from affine import Affine
from pyproj import CRS

T = TypeVar("T")

MOST = 256 << 20
"""Bytes that are kept of what was read."""

_HELD: ContextVar[dict[Hashable, tuple[Any, Any]] | None] = ContextVar("shared", default=None)
_KEPT: ContextVar[Kept | None] = ContextVar("kept", default=None)


class Kept:
    """What was read, the last used of it. May be used by several threads.

    Args:
        most: bytes; a thing of more than a quarter of them is not kept.
    """

    def __init__(self, most: int = MOST) -> None:
        self.most = most
        self._held: dict[Hashable, tuple[Any, Any, int]] = {}
        self._lock = threading.Lock()

    def __call__(self, key: Hashable, of: Any, make: Callable[[], T]) -> T:
        """What was made under this key before, or ``make()``; ``of`` lives as long."""
        with self._lock:
            if key in self._held:
                self._held[key] = self._held.pop(key)  # the last one used goes to the end
                found: T = self._held[key][0]
                return found
        made = make()
        size = _bytes(made)
        if 4 * size <= self.most:
            with self._lock:
                self._held[key] = made, of, size
                while sum(one[2] for one in self._held.values()) > self.most:
                    del self._held[next(iter(self._held))]
        return made


@contextmanager
def sharing(kept: Kept | None = None) -> Iterator[None]:
    """Within it ``once`` makes a thing once; within another one the two share. ``kept``: where ``reading_once`` keeps
    what is read."""
    if _HELD.get() is not None:
        yield
        return
    token, other = _HELD.set({}), _KEPT.set(kept)
    try:
        yield
    finally:
        _HELD.reset(token)
        _KEPT.reset(other)


def reading_once(kind: str, of: Any, make: Callable[[], T]) -> T:
    """What was read under ``of`` before (named as in ``once``), where it is kept; else ``make()``. Nobody may change
    it."""
    kept = _KEPT.get()
    return make() if kept is None else kept((kind, _named(of)), of, make)


def _bytes(made: Any) -> int:
    """The size of arrays, alone or in containers."""
    if isinstance(made, np.ndarray):
        each = sum(len(str(one)) for one in made.flat) if made.dtype == object else 0
        return made.nbytes + each
    if isinstance(made, dict):
        return _bytes(list(made.values()))
    if is_dataclass(made) and not isinstance(made, type):
        return sum(_bytes(getattr(made, one.name)) for one in fields(made))
    return 64 + sum(map(_bytes, made)) if isinstance(made, (list, tuple)) else 64


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
    if isinstance(value, CRS):
        return CRS, value.to_wkt()
    if isinstance(value, Affine):
        return Affine, tuple(value)
    return type(value), id(value)
