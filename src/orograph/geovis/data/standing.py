"""Values shown by things that stand on the ground at their places (A³ of Dübel et al. 2014).

Bars, cones and flags grow with the value, of spheres and discs the area does (Tufte's rule: ink by value); all have the
value's colour as well. Uncertainty stands as an error bar at the top, or makes colours pale. Sizes are metres of the
picture: what the terrain's heights are stretched by does not stretch what stands on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.color import linear_to_srgb
from orograph.geovis.data.dataset import Dataset, Standing, Uncertainty
from orograph.geovis.data.painted import SWATCHES, rounded
from orograph.geovis.data.points import Points
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.scales import ColorScale, doubted
from orograph.geovis.data.signs import INK, colored
from orograph.geovis.data.standing_marks import MARKS, swatch
from orograph.geovis.keys import Legend, Scale

Array = NDArray[np.float64]

ACROSS = {"bars": 14, "cones": 14, "flags": 16, "spheres": 30, "discs": 24}
"""How many of the largest stand side by side along the terrain's longer side, where no size is given (of what grows,
upright)."""

SLENDER = {"bars": 0.07, "cones": 0.13, "flags": 0.42}
"""Radius by height."""

LATTICE = 28
"""Things along the longer side that show a raster's values."""

ROUND = 0.6
"""Diameter of the largest sphere or disc on that lattice, as a part of the distance to its neighbours: rows do not
touch in a picture either that looks down by the usual 42°."""

PALER = ("saturation", "whiteness", "palette", "none")
"""Signs of uncertainty that change the colours of things."""

FADED = 0.75
"""How much of their colour points have lost when they disappear."""

FLOOR = 0.06
"""Of the largest, what the least value still is."""


class Kind(IntEnum):
    """Shapes, by the middle of their foot; a shadow lies on the ground, of what is straight above it; a
    panel is an upright rectangle from one height to another, seen unlit and from its left alone, a section one seen
    from both sides; a column is a cylinder from one height to another."""

    BAR = 0
    SPHERE = 1
    CONE = 2
    CYLINDER = 3
    FLAG = 4
    TUBE = 5
    WALL = 6
    SHADOW = 7
    PANEL = 8
    COLUMN = 9
    SECTION = 10


FLOATING = ("spheres", "discs")
"""Of points: the styles that can float. Their middles are at the height."""

KINDS = {"bars": Kind.BAR, "spheres": Kind.SPHERE, "cones": Kind.CONE, "discs": Kind.CYLINDER, "flags": Kind.FLAG}


class Mark(NamedTuple):
    """Words at a place in the terrain's CRS, and a height in metres, stretched as the ground is."""

    x: float
    y: float
    level: float
    words: str


class Variable(NamedTuple):
    """What values are: a name, a unit, and of classes their names."""

    name: str
    unit: str = ""
    classes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Things:
    """What stands on the ground.

    Attributes:
        kind: (n,) of ``Kind``. x, y: (n,) in the terrain's CRS. lift: (n,) metres of the picture above the ground.
        radius, height: (n,) metres of the picture. rgb: (n, 3) linear.
        values: (n,), what they show, NaN of parts that show none. sigma: (n,) standard deviations, NaN where unknown;
            None: unknown of all. legend: what it means.
        ends: (n, 4): the height of the foot, or of the one end, NaN where it is on the ground; of tubes, walls,
            shadows, columns, panels and sections x, y and height of the other end (of the last three of the upper
            one), else NaN; None: all stand on the ground.
        hidden: (n,) with which opacity each is seen through the ground that hides it; None: not at all.
        marks: words beside them.
        shows: what values are, and ``which``: (n,) the one of these that each shows, −1 of none; None: the first.
    """

    kind: NDArray[np.int8]
    x: Array
    y: Array
    lift: Array
    radius: Array
    height: Array
    rgb: NDArray[np.float32]
    values: Array
    legend: Legend
    ends: Array | None = None
    hidden: Array | None = None
    marks: tuple[Mark, ...] = ()
    shows: tuple[Variable, ...] = ()
    which: NDArray[np.int64] | None = None
    sigma: Array | None = None

    def __len__(self) -> int:
        return len(self.kind)

    @classmethod
    def plain(cls, legend: Legend) -> Things:
        """Nothing, with a legend: what ``but`` makes things of."""
        none = np.empty(0)
        return cls(none.astype(np.int8), none, none, none, none, none, np.empty((0, 3), np.float32), none, legend)

    @property
    def shown(self) -> NDArray[np.int64]:
        """(n,) which of ``shows`` each thing shows, −1 of none."""
        if self.which is not None:
            return self.which
        return np.where(np.isfinite(self.values) & (len(self.shows) > 0), 0, -1)

    def but(self, **changes: Any) -> Things:
        """The same with other attributes."""
        return replace(self, **changes)

    @classmethod
    def joined(cls, several: list[Things]) -> Things:
        """All of several."""
        arrays = {
            name: np.concatenate([getattr(one, name) for one in several])
            for name in ("kind", "x", "y", "lift", "radius", "height", "rgb", "values")
        }
        legends = [one.legend for one in several]
        upright = [np.full((len(one), 4), np.nan) if one.ends is None else one.ends for one in several]
        through = [np.zeros(len(one)) if one.hidden is None else one.hidden for one in several]
        doubts = [np.full(len(one), np.nan) if one.sigma is None else one.sigma for one in several]
        begins = np.cumsum([0, *(len(one.shows) for one in several)])
        which = [np.where(one.shown < 0, -1, one.shown + begin) for one, begin in zip(several, begins)]
        return cls(
            **arrays,
            shows=tuple(name for one in several for name in one.shows),
            which=np.concatenate(which),
            hidden=np.concatenate(through) if any(one.hidden is not None for one in several) else None,
            sigma=np.concatenate(doubts) if any(one.sigma is not None for one in several) else None,
            ends=np.concatenate(upright) if any(one.ends is not None for one in several) else None,
            marks=tuple(mark for one in several for mark in one.marks),
            legend=Legend(
                tuple(scale for one in legends for scale in one.scales),
                tuple(swatch for one in legends for swatch in one.swatches),
                tuple(named for one in legends for named in one.classes),
                note="; ".join(one.note for one in legends if one.note),
                title=", ".join(one.title for one in legends if one.classes and one.title),
            ),
        )


def stands(dataset: Dataset) -> bool:
    """Whether data are shown by things that stand, by their style."""
    return dataset.style in get_args(Standing)


def things_of(dataset: Dataset, points: Points, grid: Grid, priority: Priority, unit: str, note: str) -> Things:
    """What stands for values at points.

    Args:
        unit, note: what the legend says besides.
    """
    style = dataset.style or "spheres"
    if style not in KINDS:
        raise UsageError(
            f"There is no style {style} of points.",
            path=dataset.called,
            remedy=f"There are {', '.join(KINDS)}, columns and logs.",
        )
    if points.classes is None:
        scale = scale_of(dataset, points.values, priority)
    else:
        scale = ColorScale.of_classes(points.classes, dataset.colormap)
    if points.level is not None and style not in FLOATING:
        raise UsageError(
            f"{style.capitalize()} stand on the ground and do not float.", path=dataset.called,
            remedy=f"Omit height=, above= and depth=, or choose {' or '.join(FLOATING)}.",
        )  # fmt: skip
    order = np.argsort(points.values, kind="stable")  # (equal depths: the greater value is seen)
    x, y, values = points.x[order], points.y[order], points.values[order]
    sigma = None if points.sigma is None else points.sigma[order]
    part = np.maximum(np.clip((values - scale.low) / (scale.high - scale.low), 0, 1), FLOOR)
    if points.classes is not None:
        part = np.ones(len(values))  # names have no size
    elif scale.low > 0:
        note = ", ".join(filter(None, (note, f"sizes begin at {rounded(scale.low, scale.high)} {unit}".rstrip())))
    size = dataset.size if dataset.size is not None else longer(grid) / ACROSS[style]
    sign = _sign(dataset, priority, style) if sigma is not None else "none"
    doubt = doubted(sigma) if sigma is not None else (0.0, 1.0)
    if dataset.uncertainty is not None and dataset.uncertainty.range is not None:
        doubt = dataset.uncertainty.range
    u = np.zeros(len(values)) if sigma is None else np.clip((sigma - doubt[0]) / (doubt[1] - doubt[0]), 0, 1)
    radius, height = _shape(style, size, part)
    ends = None
    if points.level is not None:
        level = points.level.reshape(len(values), -1).mean(1)  # (of intervals, their middles)
        ends = np.column_stack([level[order], *[np.full(len(values), np.nan)] * 3])
    lift = np.zeros(len(values)) if ends is None else -height / 2
    rgb = colored(values, u, scale, sign)
    if points.ages is not None and sign in ("none", "errorbars"):  # (else paleness tells the uncertainty)
        rgb += (np.float32(FADED) * points.ages[order].astype(np.float32))[:, None] * (1 - rgb)
    main = Things(
        np.full(len(values), KINDS[style], np.int8), x, y, lift, radius, height, rgb, values,
        key_of(dataset, points.name, values, scale, unit, note, sign, doubt, points.classes), ends,
        None if ends is None or not dataset.through else np.full(len(values), dataset.through), sigma=sigma,
    )  # fmt: skip
    if sign != "errorbars" or sigma is None:
        return main
    return Things.joined([main, *_error_bars(main, sigma / (scale.high - scale.low) * size)])


def scale_of(dataset: Dataset, values: Array, priority: Priority) -> ColorScale:
    """The scale of numbers (n,): of classes where data are not prioritised."""
    classes = 0 if priority.data else dataset.classes
    return ColorScale.of(values, dataset.plain_colormap, dataset.range, classes, dataset.breaks)


def _sign(dataset: Dataset, priority: Priority, style: str) -> str:
    given = None if dataset.uncertainty is None else dataset.uncertainty.style
    high = style in ("bars", "cones")
    known = (*PALER, *["errorbars"] * high)
    if given is not None and given not in known:
        why = ": they grow with the value, but not evenly" if given == "errorbars" else ""
        raise UsageError(
            f"The uncertainty of {style} cannot be shown by {given}{why}.", path=dataset.called,
            remedy=f"There are {', '.join(known)}{'' if high else '; error bars are for bars and cones'}.",
        )  # fmt: skip
    return given or ("errorbars" if priority.uncertainty and high else "whiteness")


def _shape(style: str, size: float, part: Array) -> tuple[Array, Array]:
    """Radius and height, metres, of things whose values lie at ``part`` of their scale."""
    if style == "spheres":
        radius = size / 2 * np.sqrt(part)
        return radius, 2 * radius
    if style == "discs":
        radius = size / 2 * np.sqrt(part)
        return radius, np.full(len(part), size / 30)
    if style == "flags":
        return np.full(len(part), SLENDER[style] * size), size * (0.4 + 0.6 * part)
    return np.full(len(part), SLENDER[style] * size), size * part


def _error_bars(main: Things, half: Array) -> list[Things]:
    """Thin posts from one standard deviation, ``half`` (n,), below the top to one above it, with a plate at each end;
    none where it is unknown."""
    known = np.isfinite(half)
    half, height, radius = half[known], main.height[known], main.radius[known]
    n, thin = len(half), radius / 5
    low = np.maximum(height - half, 0)
    ink = np.broadcast_to(np.asarray(INK, np.float32), (n, 3))
    none = np.full(n, np.nan)

    def part(lift: Array, wide: Array, tall: Array) -> Things:
        kind = np.full(n, Kind.CYLINDER, np.int8)
        return Things(kind, main.x[known], main.y[known], lift, wide, tall, ink, none, Legend())

    at_low = np.where(main.kind[known] == Kind.CONE, radius * np.clip(1 - low / height, 0, 1), radius)
    return [part(low, thin, height + half - low), part(low, at_low + thin, thin),
            part(height + half, 0.5 * radius, thin)]  # fmt: skip


def longer(grid: Grid) -> float:
    """Metres along the longer side of a terrain."""
    across, down = grid.spacing
    return max(grid.cols * across, grid.rows * down)


def key_of(
    dataset: Dataset, name: str, values: Array, scale: ColorScale, unit: str, note: str, sign: str,
    doubt: tuple[float, float], classes: tuple[str, ...] | None = None,
) -> Legend:  # fmt: skip
    """What the colours of things mean."""
    title = dataset.name or name
    beyond = scale.exceeded(values, dataset.range)
    colors = Scale(scale.low, scale.high, linear_to_srgb(scale.colors), unit, title, *beyond)
    swatches: list[tuple[str, Any]] = []
    if sign not in ("none", "errorbars"):
        middle = np.full(len(SWATCHES), scale.telling)
        shades: Any = linear_to_srgb(colored(middle, np.array(SWATCHES), scale, sign))
        if sign in MARKS:
            shades = [swatch(scale.color(middle[:1])[0], part, sign) for part in SWATCHES]
        for part, shade in zip(SWATCHES, shades):
            sigma = doubt[0] + part * (doubt[1] - doubt[0])
            swatches.append((f"± {rounded(sigma, doubt[1])} {unit}".rstrip(), shade))
    if sign != "none" and isinstance(dataset.uncertainty, Uncertainty):
        bars = "error bars " if sign == "errorbars" else ""
        note = ", ".join(filter(None, (note, bars + dataset.uncertainty.words)))
    told = f"{title}: {note}" if note else ""
    if classes is None:
        return Legend((colors,), tuple(swatches), note=told)
    names = zip(classes, linear_to_srgb(scale.color(np.arange(len(classes), dtype=np.float64))))
    return Legend((), tuple(swatches), tuple(names), told, title=title)


def lattice_points(dataset: Dataset, grid: Grid) -> tuple[Array, Array, Dataset]:
    """Places, in the terrain's CRS, of things that show a raster's values, and the data with a size that suits them: a
    square lattice over the terrain.

    A size that is given sets the distance: half of it for what is upright, for what is round so much that neighbours
    do not touch (``ROUND``). Else the distance is that of ``LATTICE``, and what is round gets a size that suits it.
    """
    across, down = grid.spacing
    wide, size = dataset.style in FLOATING, dataset.size
    step = longer(grid) / LATTICE
    if size is not None:
        step = max(size / ROUND if wide else size / 2, longer(grid) / 200)
    cols = np.arange(step / 2 / across, grid.cols - 1, step / across)
    rows = np.arange(step / 2 / down, grid.rows - 1, step / down)
    x, y = grid.xy(*(v.ravel() for v in np.meshgrid(cols, rows)))
    return x, y, dataset.but(size=ROUND * step) if wide and size is None else dataset
