"""Data as users name them: a source, which part of it, and how it is shown; and with it, how uncertain it is.

On the command line ``--data FILE[,KEY=VALUE…]`` and after it ``--uncertainty FILE|spread|ci90[,KEY=VALUE…]``; in Python
``Dataset("era5.grib", time="T12", uncertainty="spread")``. Units are the data's own.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, Self, TypeVar, get_args

from orograph._named import named, remedy
from orograph.errors import UsageError
from orograph.geovis.data.statistics import check_statistic
from orograph.geovis.data.times import seconds_of_trail
from orograph.geovis.layers import keyed
from orograph.geovis.tables import by_class

Style = Literal[
    "continuous", "segmented", "isolines", "isobands", "cells", "hatching", "stipple", "arrows", "lic", "bivariate",
    "classes",
]  # fmt: skip
"""Ways of showing values on the surface (A² of Dübel et al. 2014)."""

Standing = Literal[
    "bars", "spheres", "cones", "discs", "flags", "tubes", "paths", "curtains", "columns", "logs", "walls"
]  # fmt: skip
"""Ways of showing values at places by things that stand on the ground (A³), or in it."""

Vertical = Literal["height", "above", "depth", "pressure"]
"""What a vertical dimension counts: metres above the heights' zero, above or below the ground, or hPa."""

Sign = Literal[
    "transparency", "noise", "blur", "saturation", "whiteness", "palette", "glyphs", "hatching", "errorbars", "members",
    "none",
]  # fmt: skip
"""Ways of showing uncertainty; the first six are intrinsic. "members": one after the other, in films."""

FASTEST = 3.0
"""Changes a second that nobody is harmed by (WCAG 2.2, criterion 2.3.1: three flashes)."""

LEVELS = ("height", "above", "depth")
"""Options that say how high points are."""

BELOW = 0.65
"""The default opacity with which things below the ground show through it."""

Measure = Literal["spread", "ci90"]
"""Uncertainties of the members of an ensemble: their standard deviation (n − 1), or half the width between their 5 %
and 95 % quantiles (linear between members)."""

MEASURES = {"spread": "standard deviation", "ci90": "half of the central 90 %"}
"""What uncertainties of members are, in words."""

T = TypeVar("T")

Breaks = Literal["quantiles", "equal", "jenks"]

Geometry = Literal["points", "lines", "polygons"]
"""Kinds of features."""


@named("An uncertainty")
@dataclass(frozen=True, slots=True)
class Uncertainty:
    """How uncertain data are.

    Attributes:
        source: "spread" or "ci90", of the data's own members; else one standard deviation in the data's unit: a raster,
            or an array, or for points the name of an attribute.
        variable, band, time, member, level: as of a ``Dataset``.
        style: see ``Sign``; None: what the priority says.
        range: the uncertainties at the ends of its scale; None: from 0 to the 98th percentile.
        rate: of members in turn, how many are shown a second, at most 3; None: 2.

    Raises:
        UsageError: a value makes no sense.
    """

    source: Any
    variable: str | None = None
    band: str | int | None = None
    time: str | None = None
    member: str | int | None = None
    level: str | float | None = None
    style: Sign | None = None
    range: tuple[float, float] | None = None
    rate: float | None = None

    def __post_init__(self) -> None:
        _check_choice("style of an uncertainty", self.style, get_args(Sign))
        _check_range(self.range, "uncertainties")
        if self.style == "members" and not self.of_members:
            raise UsageError("Members in turn are those of the data.", remedy='Say "spread" instead of a source.')
        if self.rate is None:
            return
        if self.style != "members":
            raise UsageError("rate= is of members in turn.", remedy="Give it with style=members.")
        if not 0 < self.rate <= FASTEST:
            raise UsageError(
                f"Members change more than 0 and at most {FASTEST:g} times a second, not {self.rate:g}: faster "
                "flicker harms some people.",
                remedy="Leave out rate=, or give 3 or less.",
            )

    @property
    def of_members(self) -> bool:
        """Whether it follows from the data's own members."""
        return isinstance(self.source, str) and self.source in get_args(Measure)

    @property
    def words(self) -> str:
        """What it is, in words."""
        return "± " + MEASURES[self.source if self.of_members else "spread"]

    @classmethod
    def parse(cls, text: str) -> Self:
        """An uncertainty from the command line.

        Raises:
            UsageError: a key is unknown or its value makes no sense.
        """
        return _parsed(cls, text, {"range": _range, "rate": _number})


@named("A dataset")
@dataclass(frozen=True, slots=True)
class Dataset:
    """Data to be shown on a terrain.

    Attributes:
        source: a raster, or a file of points, lines or polygons, in any CRS; a ``DataArray`` (with dimensions ``time``
            and ``member``, if it has them); a mapping of columns, a table with places in its columns, or GeoJSON; what
            has ``__geo_interface__`` (GeoDataFrames).
        variable: of several (NetCDF, HDF5), or the attribute of features that is shown; for arrows and lic two,
            "u10+v10": the components to the east and to the north (or so the band).
        band: of a raster, from 1: ``3``, ``1-13``, ``all``. time: of a series: the beginning of a time
            (``2019-03-01T12``), an hour of all days (``T12``), or a span (``2019-03-01..2019-03-03``; ``..``: all),
            which films play. member: as ``band``, of an ensemble.
            Where several are chosen their mean is shown.
        value: what is shown of several members or times instead of their mean: "median", "min", "max", "spread", or a
            quantile, "p90". exceeds: instead of values, how probably they are above this one: the part of the members,
            by the normal law where the uncertainty is a raster of standard deviations.
        level: of a variable with a vertical dimension, the one that is meant ("850"); curtains and walls show all.
        vertical: what its vertical dimension is, where the source does not say it: see ``Vertical``.
        along: where curtains through a volume run: a file of lines (or GeoJSON), or "lon:lat:lon:lat…" (x:y in a
            terrain without a CRS); None: along the row and the column through the terrain's middle.
        layer: of a file of features with several. geometry: "points", "lines" or "polygons", where it mixes them.
        style: see ``Style`` and ``Standing``; None: what the priority says, of points spheres.
        colormap: any name of the cmap catalogue; of classes colours by name or number, {"Water": "#56b4e9", 42:
            "green"}. names: of classes of a raster, names by number, {42: "Evergreen forest"}, besides its own.
        range: the values at its ends; None: the 2nd and the 98th percentile.
        classes, breaks: of segments: how many (2 to 12), and where they begin: quantiles, equal steps, Jenks' natural
            breaks, or the values themselves.
        height, above, depth: of points, the attribute that says how high they are, in metres above the heights' zero,
            or above or below the ground ("z": the height of a feature's own place; "z:km", "z:ft" in other units); of
            columns and logs also two, the ends of an interval ("from+to").
        group: of columns, logs, tubes and paths, the attribute that says which borehole, ascent or track a row belongs
            to. None: rows of a borehole are at one place; all are one track.
        when: of tracks and points, the attribute that says when; None: time, timestamp, datetime or date.
        trail: of points with times, for how long each is seen after its time ("6h"; s, min, h, d); None: a twelfth of
            the time that they span.
        hidden: with which opacity (0 to 1) what the ground hides is seen through it. None: 0.65 of what has a depth,
            else 0.
        size: metres on the ground from sign to sign, or of a cell; of what stands, its height or diameter at the upper
            end of the range; of columns their diameter, of logs the height of the deepest. None: what suits the
            terrain.
        width: of lines, and of the outlines of polygons: pixels of a picture that shows the whole terrain, or metres
            on the ground ("30m"). None: 3 pixels, outlines 1; 0: no outlines.
        opacity: 0 to 1. unit, name: what the legend says instead of what the source says.
        uncertainty: how uncertain they are.

    Raises:
        UsageError: a value makes no sense.
    """

    source: Any
    variable: str | None = None
    band: str | int | None = None
    time: str | None = None
    member: str | int | None = None
    value: str | None = None
    exceeds: float | None = None
    level: str | float | None = None
    vertical: Vertical | None = None
    along: Any = None
    layer: str | None = None
    geometry: Geometry | None = None
    style: Style | Standing | None = None
    colormap: str | Mapping[str, str] | Mapping[int, str] = "viridis"
    names: Mapping[int, str] | Mapping[str, str] | None = None
    range: tuple[float, float] | None = None
    classes: int = 5
    breaks: Breaks | tuple[float, ...] = "quantiles"
    height: str | None = None
    above: str | None = None
    depth: str | None = None
    group: str | None = None
    when: str | None = None
    trail: str | None = None
    hidden: float | None = None
    size: float | None = None
    width: float | str | None = None
    opacity: float = 1.0
    unit: str | None = None
    name: str | None = None
    uncertainty: Uncertainty | Any | None = None

    def __post_init__(self) -> None:
        from orograph.geovis.color import color_table

        if isinstance(self.source, os.PathLike):
            object.__setattr__(self, "source", os.fspath(self.source))
        if self.source is None or (isinstance(self.source, str) and not self.source):
            raise UsageError(
                "A dataset has no source.", remedy="Name a raster, or a file of points, lines or polygons."
            )
        _check_choice("style", self.style, (*get_args(Style), *get_args(Standing)))
        _check_range(self.range, "values")
        if isinstance(self.colormap, str):
            color_table(self.colormap, 2)
        else:
            _check_colors(self.colormap)
        for number in self.names or {}:
            if not re.fullmatch(r"-?\d+", str(number)):
                raise UsageError(f"Names of classes are by number, not by {number!r}.")
        if not 2 <= self.classes <= 12:
            raise UsageError(f"The number of classes must be 2 to 12, not {self.classes}.")
        if isinstance(self.breaks, str):
            _check_choice("way of finding breaks", self.breaks, get_args(Breaks))
        elif len(self.breaks) < 3 or any(not a < b for a, b in zip(self.breaks, self.breaks[1:])):
            raise UsageError(f"Breaks must be at least three increasing values, not {self.breaks}.")
        if self.size is not None and not 0 < self.size < math.inf:
            raise UsageError(f"A size must be in metres, above 0, not {self.size}.")
        for opacity in (self.opacity, 0.0 if self.hidden is None else self.hidden):
            if not 0 <= opacity <= 1:
                raise UsageError(f"The opacity must be a number from 0 to 1, not {opacity:g}.")
        _check_choice("vertical dimension", self.vertical, get_args(Vertical))
        _check_choice("kind of geometry", self.geometry, get_args(Geometry))
        if self.trail is not None:
            seconds_of_trail(self.trail)
        if self.width is not None:
            object.__setattr__(self, "width", _width(self.width))
        self._check_derived()
        given = [f"{name}=" for name in LEVELS if getattr(self, name) is not None]
        if len(given) > 1:
            raise UsageError(f"{' and '.join(given)} all give the height of points.", remedy="Give one of them.")
        doubt: Any = self.uncertainty
        if doubt is not None and not isinstance(doubt, Uncertainty):
            object.__setattr__(self, "uncertainty", Uncertainty(doubt))

    @classmethod
    def parse(cls, text: str) -> Self:
        """Data from the command line: ``FILE[,KEY=VALUE…]``.

        Raises:
            UsageError: a key is unknown or its value makes no sense.
        """
        return _parsed(
            cls, text, {"range": _range, "classes": _whole, "breaks": _breaks, "size": _number, "opacity": _number,
                         "exceeds": _number, "hidden": _number, "names": by_class, "colormap": _colors},
            without=("uncertainty",),
        )  # fmt: skip

    def _check_derived(self) -> None:
        if self.value is not None:
            check_statistic(self.value)
        if self.exceeds is None:
            return
        if not math.isfinite(self.exceeds):
            raise UsageError(f"A value to exceed must be a number, not {self.exceeds}.")
        if self.value is not None:
            raise UsageError("value= and exceeds= exclude each other.", remedy="Give one of the two.")

    @property
    def called(self) -> str:
        """What messages call its source."""
        return self.source if isinstance(self.source, str) else "the data"

    @property
    def leveled(self) -> str | None:
        """Which of height=, above= and depth= is given: its name."""
        return next((name for name in LEVELS if getattr(self, name) is not None), None)

    @property
    def through(self) -> float:
        """With which opacity what the ground hides is seen."""
        return (BELOW if self.depth is not None else 0.0) if self.hidden is None else self.hidden

    @property
    def derived(self) -> bool:
        """Whether a statistic of members is shown, or a probability."""
        return self.value is not None or self.exceeds is not None

    @property
    def plain_colormap(self) -> str:
        """Its colour map, of numbers.

        Raises:
            UsageError: there are colours by name.
        """
        if isinstance(self.colormap, str):
            return self.colormap
        raise UsageError("Colours by name are for classes, but these values are numbers.", remedy="Name a colormap.")

    def but(self, **changes: Any) -> Dataset:
        """The same with other attributes."""
        return replace(self, **changes)


def datasets_of(given: Any) -> tuple[Dataset, ...]:
    """Data of what a user may give: one or several, each a ``Dataset`` or its source."""
    if given is None:
        return ()
    several = given if isinstance(given, list | tuple) else [given]
    return tuple(one if isinstance(one, Dataset) else Dataset(one) for one in several)


def _parsed(kind: type[T], text: str, readers: Mapping[str, Any], without: tuple[str, ...] = ()) -> T:
    source, values = keyed(text)
    known = [f.name for f in fields(kind) if f.name not in ("source", *without)]  # type: ignore[arg-type]
    made: dict[str, Any] = {}
    for key, value in values.items():
        if key not in known:
            raise UsageError(f"There is no {key!r} of data.", path=source, remedy=remedy(key, known))
        made[key] = readers.get(key, str)(value)
    try:
        return kind(source, **made)  # type: ignore[call-arg]
    except UsageError as error:
        raise UsageError(error.what, path=source, remedy=error.remedy) from None


def _number(text: str) -> float:
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise UsageError(f"{text!r} is not a number.")
    return found


def _whole(text: str) -> int:
    found = _number(text)
    if found != int(found):
        raise UsageError(f"{text!r} is not an integer.")
    return int(found)


def _colors(text: str) -> str | dict[str, str]:
    """A name, or colours by class: 41:#1a7f37;Water:blue. (Names of maps have a colon, too: crameri:batlow.)"""
    first, _, color = text.partition(";")[0].partition(":")
    one = color.startswith("#") or first.strip().lstrip("-").isdigit()
    return by_class(text) if ";" in text or one else text


def _check_colors(given: Mapping[Any, str]) -> None:
    from PIL import ImageColor

    for name, color in given.items():
        try:
            ImageColor.getrgb(color)
        except (ValueError, AttributeError):
            raise UsageError(f"The colour of {name!r} is a name or #rrggbb, not {color!r}.") from None


def _width(given: float | str) -> float | str:
    """Pixels, or metres as "30m"."""
    text = str(given).strip()
    number = _number(text.removesuffix("m"))
    if number < 0:
        raise UsageError(f"A width must be in pixels, or in metres (30m), 0 or more: {text}.")
    return text if text.endswith("m") else number


def _range(text: str) -> tuple[float, float]:
    parts = [_number(part) for part in text.split(":")]
    if len(parts) != 2:
        raise UsageError(f"A range must be LOW:HIGH, not {text!r}.")
    return parts[0], parts[1]


def _breaks(text: str) -> Any:
    return tuple(_number(part) for part in text.split(":")) if ":" in text else text


def _check_choice(what: str, value: Any, known: tuple[str, ...]) -> None:
    if value is not None and value not in known:
        raise UsageError(f"There is no {what} {value!r}.", remedy=remedy(str(value), known))


def _check_range(given: tuple[float, float] | None, what: str) -> None:
    if given is not None and not -math.inf < given[0] < given[1] < math.inf:
        raise UsageError(
            f"A range of {what} must go from a lower to a higher value, not from {given[0]:g} to {given[1]:g}."
        )
