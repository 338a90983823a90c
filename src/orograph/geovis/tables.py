"""Colour maps without a name: those of matplotlib and ``cmap``, with norms, and tables of classes.

A norm is folded into the table, whose entries are evenly spaced, so that drawing code knows one kind of map.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError

DISTINCT = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#555555", "#7f3c8d",
            "#a5aa99", "#80ba5a", "#8c510a")  # fmt: skip
"""Colours of classes without an order, at most twelve: Okabe & Ito's (2008), which colour-blind readers tell apart,
then others."""

ENTRIES, FINE = 1024, 65536
"""Of a table: of a map alone, and of one into which a norm is folded, whose steps may lie anywhere."""


@dataclass(frozen=True, slots=True, repr=False)
class Table:
    """Colours from the lowest to the highest value.

    Attributes:
        name: what to call it.
        rgba: (n, 4) uint8 sRGB and opacity, row by row.
        span: the values of the first and the last entry; None: the coloured data decides.
        classes: whether each entry is a class of its own.
    """

    name: str
    rgba: bytes
    span: tuple[float, float] | None = None
    classes: bool = False

    def __repr__(self) -> str:
        return f"<Table {self.name}>"

    def __str__(self) -> str:
        return self.name

    @property
    def colors(self) -> NDArray[np.uint8]:
        """(n, 4) uint8."""
        return np.frombuffer(self.rgba, np.uint8).reshape(-1, 4)

    @classmethod
    def of(cls, given: Any, norm: Any = None) -> Table:
        """A table from what a user gives.

        Args:
            given: matplotlib's or cmap's colour map; its name, with a norm; or classes: colours (names, "#rrggbb", or 3
                or 4 numbers up to 1) by whole numbers. Values without a class are transparent.
            norm: matplotlib's, with its ends (``vmin`` and ``vmax``).

        Raises:
            UsageError: it is none of these.
        """
        if isinstance(given, Mapping):
            if norm is not None:
                raise UsageError("A table of classes takes no norm: it gives the colour of each value.")
            return _classes(given)
        colors = _callable(given)
        name = str(getattr(given, "name", given)).rpartition(":")[2]
        if norm is None:
            return cls(name, _bytes(colors(np.linspace(0, 1, ENTRIES))))
        low, high = getattr(norm, "vmin", None), getattr(norm, "vmax", None)
        if not callable(norm) or low is None or high is None or not low < high:
            raise UsageError(f"A norm must be one of matplotlib's, with vmin and vmax, not {norm!r}.")
        places = np.ma.getdata(norm(np.linspace(low, high, FINE)))
        if isinstance(places.flat[0], np.integer):  # BoundaryNorm gives indices of colours
            colors = given if callable(given) else colors
        found = np.asarray(colors(places))
        return cls(name, _bytes(found), (float(low), float(high)))


def by_class(text: str) -> dict[str, str]:
    """What the command line gives for classes: ``11:Open water;21:Town``.

    Raises:
        UsageError: a part has no colon.
    """
    pairs = [part.strip().partition(":") for part in text.split(";") if part.strip()]
    if not pairs or any(not colon or not value.strip() for _, colon, value in pairs):
        raise UsageError(f"{text!r} is not a list of classes.", remedy="Write CLASS:VALUE;CLASS:VALUE….")
    return {key.strip(): value.strip() for key, _, value in pairs}


def quiet_colormap(given: Any) -> Any:
    """``cmap.Colormap``, silent where it takes the first of several maps of one name."""
    import cmap

    logger = logging.getLogger("cmap")
    logger.addFilter(_not_of_aliases)
    try:
        return cmap.Colormap(given)
    finally:
        logger.removeFilter(_not_of_aliases)


def _not_of_aliases(record: logging.LogRecord) -> bool:
    return "is an alias for" not in record.getMessage()


def _callable(given: Any) -> Any:
    """A function from numbers in [0, 1] to colours."""
    if callable(given) and hasattr(given, "N"):
        return given
    try:
        return quiet_colormap(given)
    except (ValueError, TypeError, KeyError) as error:
        raise UsageError(
            f"{given!r} is not a colour map.",
            remedy="Give a name, a colour map of matplotlib or cmap, or colours by value: {1: 'green', 2: '#08f'}.",
        ) from error


def _classes(given: Mapping[Any, Any]) -> Table:
    if not given or not all(isinstance(v, Real) and float(v).is_integer() for v in given):
        raise UsageError(f"Classes must be colours by integers, {{1: 'green', 2: '#08f'}}, not {given!r}.")
    low, high = int(min(given)), int(max(given))
    if high - low >= FINE:
        raise UsageError(f"Classes must lie within {FINE} of each other, not from {low} to {high}.")
    low, high = low - 1, high + 1  # transparent, as are all values beyond, which take the colours of the ends
    colors = np.zeros((high - low + 1, 4), np.uint8)
    for value, color in given.items():
        try:
            red, green, blue, opacity = _color(color).rgba
        except (ValueError, TypeError) as error:
            raise UsageError(f"{color!r}, of class {value}, is not a colour.") from error
        colors[int(value) - low] = np.round(np.array([red, green, blue, opacity]) * 255)
    return Table("classes", colors.tobytes(), (float(low), float(high)), True)


def _bytes(colors: Any) -> bytes:
    """Colours from 0 to 1 as bytes (n, 4)."""
    found = np.asarray(colors, np.float64)
    return np.round(np.clip(found, 0, 1) * 255).astype(np.uint8).tobytes()


def _color(given: Any) -> Any:
    """A colour from a name, or from numbers in [0, 1]."""
    import cmap

    return cmap.Color(given if isinstance(given, str) else np.array(given, np.float64))
