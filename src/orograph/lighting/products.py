"""The products of light, by name: rasters on a terrain's grid, each made by blocks within a memory limit.

A ``Product`` defines the names and units of its bands, and has a function that makes it: given a ``Context`` (terrain,
options, threads, memory, progress, and the horizons as they are swept) it yields blocks ``(row0, col0, values (bands,
rows, cols) float32)``, in any order, that cover the raster once. A module that makes products lists them in its
``PRODUCTS``; it is imported when one of them is used (``_HOMES``).

Results do not depend on blocks, threads or memory, to the bit.
"""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from orograph.errors import UsageError

if TYPE_CHECKING:
    from orograph.lighting.gather import Sweep
    from orograph.lighting.raster import Band

from orograph.lighting.context import Blocks, Context, Options, Values

_HOMES = {
    "normal": "orograph.lighting.surface",
    "slope": "orograph.lighting.surface",
    "aspect": "orograph.lighting.surface",
    "hillshade": "orograph.lighting.surface",
    "horizon": "orograph.lighting.sky",
    "sky-view-factor": "orograph.lighting.sky",
    "sky-view-horizontal": "orograph.lighting.sky",
    "visible-sky": "orograph.lighting.sky",
    "openness": "orograph.lighting.openness_angles",
    "openness-negative": "orograph.lighting.openness_angles",
    "ambient-occlusion": "orograph.lighting.occlusion",
    "aperture": "orograph.lighting.aperture",
    "shadow": "orograph.lighting.shadow",
    "insolation": "orograph.lighting.energy",
    "sunshine": "orograph.lighting.sun_hours",
}
"""The module of each product, by the product's name."""


@dataclass(frozen=True, slots=True)
class Product:
    """One product.

    Attributes:
        name: as on the command line.
        bands: options → the names of its bands.
        unit: of its values ("degrees", "1"…).
        doc: a one-sentence description.
        make: context → blocks (row0, col0, values (bands, rows, cols)), in any order, covering the raster once; or a
            ``gather.Sweep``, for sums over horizons.
        byte: the values that 8-bit files show as 1 and as 255 (0 is missing).
        about: (band, options) → the specifics of a band: ``unit``, ``byte`` or ``codes`` of its ``Band``.
        check: raises UsageError if options make no sense, before there is a terrain; ``make`` does so too.
    """

    name: str
    bands: Callable[[Options], list[str]]
    unit: str
    doc: str
    make: Callable[[Context], Blocks | Sweep]
    byte: tuple[float, float] = (0.0, 1.0)
    about: Callable[[str, Options], dict[str, Any]] = lambda band, options: {}
    check: Callable[[Options], None] = lambda options: None

    def described(self, options: Options) -> tuple[Band, ...]:
        """The description of each band in a file."""
        from orograph.lighting.raster import Band

        known = {"unit": self.unit, "doc": self.doc, "byte": self.byte}
        return tuple(
            Band(name, **{**known, "long_name": self._titled(name), **self.about(name, options)})
            for name in self.bands(options)
        )

    def _titled(self, band: str) -> str:
        """A band's name for legends: "sky-view-factor", "insolation: global"."""
        return band if band.startswith(self.name) else f"{self.name}: {band}"

    def run(self, context: Context) -> Blocks:
        """Make it alone: blocks (row0, col0, values (bands, rows, cols)) that cover the raster once."""
        from orograph.lighting.gather import produce

        yield from ((row, col, values) for _, row, col, values in produce(context, [self]))


def names() -> list[str]:
    """The names of all products."""
    return list(_HOMES)


MEANT = {
    **dict.fromkeys(("svf", "skyview", "sky-view"), "sky-view-factor"),
    **dict.fromkeys(("ao", "occlusion"), "ambient-occlusion"),
    **dict.fromkeys(("shade", "relief", "shaded-relief", "shadedrelief"), "hillshade"),
    **dict.fromkeys(("positive-openness", "openness-positive"), "openness"),
    **dict.fromkeys(("negative-openness",), "openness-negative"),
    **dict.fromkeys(("gradient", "steepness"), "slope"),
    **dict.fromkeys(("exposition", "orientation"), "aspect"),
    **dict.fromkeys(("normals",), "normal"),
    **dict.fromkeys(("shadows", "cast-shadow"), "shadow"),
    **dict.fromkeys(("radiation", "solar", "irradiation"), "insolation"),
    **dict.fromkeys(("sun-hours", "sunshine-hours", "sunshine-duration", "sun-duration", "hours"), "sunshine"),
    **dict.fromkeys(("sun", "hours-of-sun", "direct-sun", "insolation-time", "duration"), "sunshine"),
}  # fmt: skip
"""Names of products in other tools, and their equivalents here."""


def product(name: str) -> Product:
    """A product by its name.

    Raises:
        UsageError: there is no such product, or no name.
    """
    if not name:
        raise UsageError(f"Say what to make: one of the products {', '.join(_HOMES)}.")
    if name not in _HOMES:
        plain = name.lower().replace("_", "-").replace(" ", "-")
        close = MEANT.get(plain) or next(iter(difflib.get_close_matches(plain, _HOMES, 1, 0.6)), None)
        remedy = f"Did you mean {close}?" if close else ""
        raise UsageError(f"There is no product {name!r}; the products are {', '.join(_HOMES)}.", remedy=remedy)
    found: Sequence[Product] = importlib.import_module(_HOMES[name]).PRODUCTS
    return next(p for p in found if p.name == name)


def compute(context: Context, *names: str) -> Values:
    """Products as a whole, in memory: (bands, rows, cols) float32; those with the same sweep share it."""
    from orograph.lighting.gather import produce, whole

    if len(names) == 1:
        return whole(context, product(names[0]))
    products = [product(name) for name in names]
    counts = [len(each.bands(context.options)) for each in products]
    out = np.empty((sum(counts), *context.shape), np.float32)
    for k, row, col, values in produce(context, products):
        first = sum(counts[:k])
        out[first : first + counts[k], row : row + values.shape[1], col : col + values.shape[2]] = values
    return out


def described(products: Sequence[Product], options: Options) -> list[Band]:
    """The bands of products; where there are several, each name includes its product's."""
    found: list[Band] = []
    for each in products:
        for band in each.described(options):
            own = len(products) == 1 or band.name.startswith(each.name)
            found.append(band if own else replace(band, name=f"{each.name} {band.name}"))
    return found
