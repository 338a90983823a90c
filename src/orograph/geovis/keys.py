"""What colours mean, for a legend: scales of values, and swatches of classes and signs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Scale:
    """What the colours of heights, or of a layer's values, mean.

    Attributes:
        low, high: values at the ends of the colour table.
        colors: (n, 3), from low to high, sRGB: uint8, or float in [0, 1].
        unit: of the values; ``label``: what they are.
        below, above: whether there are values beyond an end of the table, in the end's colour: a triangle says so.
    """

    low: float
    high: float
    colors: NDArray[Any]
    unit: str = "m"
    label: str = "Height"
    below: bool = False
    above: bool = False

    @property
    def words(self) -> str:
        """The heading above it."""
        return f"{self.label} ({self.unit})" if self.unit else self.label


@dataclass(frozen=True, slots=True, eq=False)
class Square:
    """What the colours of two things in one picture mean.

    Attributes:
        colors: (rows, cols, 3) linear, of classes of the one along the columns, of the other along the rows, from the
            lowest. across, up: what they are, with units. across_edges, up_edges: the ends of the classes.
    """

    colors: NDArray[Any]
    across: str
    up: str
    across_edges: tuple[float, ...]
    up_edges: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Legend:
    """What the colours of a picture mean.

    Attributes:
        scales: one below the other.
        swatches: (words, colour) of signs, of water and of ground without data: sRGB (uint8 or float); a tile
            (rows, cols, 3) is a pattern, repeated pixel by pixel.
        classes: the same of classes of data. squares: of two things in one colour.
        note: what else a reader must know. title: what the classes are.
    """

    scales: tuple[Scale, ...] = ()
    swatches: tuple[tuple[str, Any], ...] = ()
    classes: tuple[tuple[str, Any], ...] = ()
    note: str = ""
    squares: tuple[Square, ...] = ()
    title: str = ""

    @property
    def entries(self) -> tuple[tuple[str, Any], ...]:
        """Classes below their title, which has no colour (None), and swatches."""
        heading = ((self.title, None),) if self.title and self.classes else ()
        return (*heading, *self.classes, *self.swatches)

    @property
    def words(self) -> str:
        """All text in it, except numbers."""
        named = [words for words, _ in self.entries]
        both = [words for one in self.squares for words in (one.across, one.up)]
        return " ".join([*(scale.words for scale in self.scales), *both, *named])


def minus(number: str) -> str:
    """A number's text with a true minus sign."""
    return number.replace("-", "−")


UNITS = {"metre": "m", "meter": "m", "metres": "m", "meters": "m", "c": "°C", "degc": "°C", "deg_c": "°C",
         "celsius": "°C", "degree_c": "°C", "degrees_c": "°C", "degree_celsius": "°C", "degrees_celsius": "°C",
         "degrees celsius": "°C", "degf": "°F", "deg_f": "°F", "fahrenheit": "°F", "degree_f": "°F", "degrees_f": "°F",
         "degree_fahrenheit": "°F", "degrees_fahrenheit": "°F", "degrees fahrenheit": "°F", "kelvin": "K", "degk": "K",
         "percent": "%", "m s**-1": "m/s",
         "m s-1": "m/s", "1": "", "millibars": "hPa", "millibar": "hPa", "mbar": "hPa", "mb": "hPa"}  # fmt: skip


def written_unit(told: str) -> str:
    """A file's unit as people write it: Wh/m2 and Wh m-2 as Wh/m²."""
    bare = told.strip().strip("[]")
    known = UNITS.get(bare.lower(), bare)
    known = re.sub(r"^(\S+) m(?:\*\*|\^)?-([23])$", r"\1/m\2", known)
    return re.sub(r"(?<=m)\^?([23])(?!\d)", lambda found: {"2": "²", "3": "³"}[found[1]], known)
