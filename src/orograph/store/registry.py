"""The kinds of derived data that a store can have: a new kind is a class and a line here."""

from __future__ import annotations

from typing import Any

from orograph.errors import UsageError
from orograph.store.chunked_kind import CHUNKED
from orograph.store.colors import COLORS
from orograph.store.derived import Derived
from orograph.store.diamond_table import DIAMONDS
from orograph.store.layers import LAYERS
from orograph.store.patches import PATCHES
from orograph.store.points import POINTS
from orograph.store.quadtin_kind import QUADTIN
from orograph.store.tin_kind import TINS

KINDS: dict[str, Derived[Any]] = {
    kind.name: kind for kind in (DIAMONDS, PATCHES, TINS, CHUNKED, POINTS, QUADTIN, COLORS, LAYERS)
}
"""Kinds by name, each after those that it needs."""


def kind_of(name: str) -> Derived[Any]:
    """The kind of that name.

    Raises:
        UsageError: there is none.
    """
    if name not in KINDS:
        raise UsageError(f"There are no derived data called {name!r}; the kinds are {', '.join(KINDS)}.")
    return KINDS[name]
