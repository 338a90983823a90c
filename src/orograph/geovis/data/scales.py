"""From values to colours: continuous scales, classes, and palettes in which what is uncertain loses its colour.

Colours are linear RGB (n, 3) float32, as everywhere before they are shown.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ImageColor

from orograph.errors import UsageError
from orograph.geovis.color import color_table, linear_to_srgb, srgb_to_linear
from orograph.geovis.data.dataset import Breaks
from orograph.geovis.tables import DISTINCT

Colors = NDArray[np.float32]
Array = NDArray[np.float64]

PERCENTILES = (2.0, 98.0)
"""The default ends of a scale, from the values over a terrain."""

ALIKE = 1e-7
"""Of their size, differences between values that float32 hardly tells apart."""

MOST_NAMED = 12
"""Classes that a message lists."""

JENKS_SAMPLES = 4096
"""Values that natural breaks are found among, evenly from all that are sorted."""

PALE = (0.86, 0.86, 0.86)
"""Linear grey: what nothing is known of, in a value-suppressing palette."""

GREYISH = 0.2
"""Range of the channels of a colour, below which it is nearly grey."""

LEVELS = 4
"""Of uncertainty in such a palette: 8 classes of values where they are certain, then 4, 2 and 1."""


@dataclass(frozen=True, slots=True, eq=False)
class ColorScale:
    """What colour a value has.

    Attributes:
        low, high: its ends. table: (n, 3) colours from ``low`` to ``high``.
        edges: of classes, from the lowest value to the highest; None: it is continuous.
    """

    low: float
    high: float
    table: Colors
    edges: tuple[float, ...] | None = None

    @classmethod
    def of(
        cls, values: NDArray[Any], colormap: str, span: tuple[float, float] | None, classes: int = 0,
        breaks: Breaks | tuple[float, ...] = "quantiles",
    ) -> ColorScale:  # fmt: skip
        """The scale of values, ignoring NaN.

        Args:
            span: its ends; None: percentiles of the values. classes: how many; 0: it is continuous.

        Raises:
            UsageError: there is no such colour map.
        """
        low, high = spanned(values, span)
        table = color_table(colormap, 1024)
        if not classes:
            return cls(low, high, table)
        if isinstance(breaks, tuple):
            edges = breaks
        else:
            inside = values[np.isfinite(values) & (values >= low) & (values <= high)]
            edges = (low, *class_breaks(inside, classes, breaks, low, high), high)
        middle = (np.arange(len(edges) - 1) + 0.5) / (len(edges) - 1)
        return cls(edges[0], edges[-1], table[np.round(middle * 1023).astype(int)], edges)

    @classmethod
    def of_classes(cls, names: tuple[str, ...], colors: Any) -> ColorScale:
        """Of classes without an order, numbered from 0, at most twelve; ``colors``: by name, where it is a mapping."""
        own = {str(name): color for name, color in colors.items()} if isinstance(colors, Mapping) else {}
        if own and not any(name in own for name in names):
            raise UsageError(
                f"None of the classes that have colours occurs: {', '.join(own)}.",
                remedy=f"There are {', '.join(names[:MOST_NAMED])}.",
            )
        rest = iter(DISTINCT)
        rgb = np.array([ImageColor.getrgb(own.get(name) or next(rest))[:3] for name in names], np.float32) / 255
        edges = tuple(k - 0.5 for k in range(len(names) + 1))
        return cls(edges[0], edges[-1], srgb_to_linear(rgb).astype(np.float32), edges)

    def place(self, values: NDArray[Any]) -> Array:
        """Of a value, how far it lies along the table: 0 to 1, or the index of its class."""
        with np.errstate(invalid="ignore"):
            if self.edges is None:
                return np.clip((np.asarray(values, np.float64) - self.low) / (self.high - self.low), 0, 1)
            return np.searchsorted(np.asarray(self.edges[1:-1]), values, side="right").astype(np.float64)

    @property
    def colors(self) -> Colors:
        """(256, 3) at even steps of the values: what a legend shows."""
        return self.color(np.linspace(self.low, self.high, 256))

    @property
    def telling(self) -> float:
        """A value whose colour shows best how it fades: the middle, unless that is grey or white, as in diverging maps;
        then the one of the strongest colour."""
        shades = np.linspace(self.low, self.high, 256)
        chroma = np.ptp(linear_to_srgb(self.color(shades)), axis=1)
        middle = (self.low + self.high) / 2
        weak = chroma[len(chroma) // 2] < GREYISH < chroma.max()
        return float(shades[np.argmax(chroma)]) if weak else middle

    def exceeded(self, values: NDArray[Any], given: tuple[float, float] | None) -> tuple[bool, bool]:
        """Whether there are values below and above its ends, more than rounding; of one that several pictures share,
        in any of them.

        Args:
            given: the range that was asked for.
        """
        if isinstance(given, Shared):
            return True, True
        slack = 1e-6 * (self.high - self.low)
        return bool((values < self.low - slack).any()), bool((values > self.high + slack).any())

    def color(self, values: NDArray[Any]) -> Colors:
        """Colours (…, 3); those of NaN mean nothing."""
        at = np.nan_to_num(self.place(values))
        scaled = at * (len(self.table) - 1) if self.edges is None else at
        return self.table[np.clip(np.rint(scaled), 0, len(self.table) - 1).astype(np.intp)]


class Shared(tuple[float, float]):
    """The ends of a scale that several pictures share, such as a film's: percentiles of the values of all."""


def spanned(values: NDArray[Any], span: tuple[float, float] | None) -> tuple[float, float]:
    """The ends of a scale: those given, or percentiles of the values, which never coincide."""
    if span is not None:
        return span
    known = values[np.isfinite(values)]
    if not len(known):
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(known, PERCENTILES))
    if low == high:
        low, high = float(known.min()), float(known.max())
    alike = high - low <= ALIKE * max(abs(low), abs(high))  # (by rounding only)
    return (low - 0.5, low + 0.5) if alike else (low, high)


def doubted(sigma: NDArray[Any]) -> tuple[float, float]:
    """The ends of a scale of uncertainties: 0 and the 98th percentile (1 if all are 0 or unknown)."""
    known = sigma[np.isfinite(sigma)]
    high = float(np.percentile(known, PERCENTILES[1]) or known.max()) if len(known) else 0.0
    return 0.0, high or 1.0


def class_breaks(values: NDArray[Any], classes: int, way: str, low: float, high: float) -> tuple[float, ...]:
    """Where all classes but the first begin, increasing; fewer than asked for where values coincide.

    Args:
        way: "equal" steps, "quantiles" (as many values in each), or "jenks": natural breaks, the least sum of squared
            differences from the classes' means (Jenks 1967; found exactly by dynamic programming, Fisher 1958).
    """
    if way == "equal" or not len(values):
        found = np.linspace(low, high, classes + 1)[1:-1]
    elif way == "quantiles":
        found = np.quantile(values, np.arange(1, classes) / classes)
    else:
        found = _natural(np.sort(values.astype(np.float64)), classes)
    return tuple(float(v) for v in np.unique(found) if low < v < high)


def shared_breaks(
    pooled: NDArray[Any], classes: int, breaks: Breaks | tuple[float, ...], span: tuple[float, float]
) -> Breaks | tuple[float, ...]:
    """One set of breaks for several pictures: those that ``class_breaks`` finds among the values of all, so that
    colours mean the same in each.

    Args:
        pooled: values of all pictures, NaN where there are none. span: the ends of their scale.
    """
    if isinstance(breaks, tuple) or breaks == "equal":
        return breaks
    inside = pooled[np.isfinite(pooled) & (pooled >= span[0]) & (pooled <= span[1])]
    edges = (float(span[0]), *class_breaks(inside, classes, breaks, *span), float(span[1]))
    return edges if len(edges) > 2 else "equal"


def _natural(ordered: Array, classes: int) -> Array:
    """Natural breaks of sorted values: the first value of each class but the first."""
    if len(ordered) > JENKS_SAMPLES:
        ordered = ordered[np.linspace(0, len(ordered) - 1, JENKS_SAMPLES).round().astype(int)]
    n, classes = len(ordered), min(classes, len(ordered))
    middle = ordered - ordered.mean()
    sums, squares = np.concatenate([[0], np.cumsum(middle)]), np.concatenate([[0], np.cumsum(middle**2)])

    def cost(first: NDArray[np.intp], last: int) -> Array:
        """Squared differences of values [first, last) from their mean."""
        total = sums[last] - sums[first]
        return np.asarray(squares[last] - squares[first] - total**2 / np.maximum(last - first, 1))

    best = np.array([cost(np.array([0]), last)[0] for last in range(n + 1)])
    starts: list[NDArray[np.intp]] = []
    for count in range(2, classes + 1):
        found, start = np.full(n + 1, np.inf), np.zeros(n + 1, np.intp)
        for last in range(count, n + 1):
            first = np.arange(count - 1, last)
            all_costs = best[first] + cost(first, last)
            k = int(np.argmin(all_costs))
            found[last], start[last] = all_costs[k], first[k]
        best = found
        starts.append(start)
    breaks, last = [], n
    for start in reversed(starts):
        last = int(start[last])
        breaks.append(ordered[last])
    return np.array(breaks[::-1])


def suppressed(scale: ColorScale, values: NDArray[Any], u: Array) -> Colors:
    """Colours of a value-suppressing palette (Correll, Moritz & Heer 2018): a tree of bins that merge, and pale,
    towards the uncertain.

    Args:
        u: uncertainty, 0 (certain) to 1.
    """
    level = np.clip(np.nan_to_num(u, nan=1.0) * LEVELS, 0, LEVELS - 1).astype(int)
    bins = 2 ** (LEVELS - 1 - level)
    at = np.nan_to_num(np.clip((values - scale.low) / (scale.high - scale.low), 0, 1))
    middle = (np.minimum(np.floor(at * bins), bins - 1) + 0.5) / bins
    colors = scale.table[np.rint(middle * (len(scale.table) - 1)).astype(int)]
    pale = (level / LEVELS)[..., None].astype(np.float32)
    return np.asarray(colors * (1 - pale) + np.asarray(PALE, np.float32) * pale, np.float32)
