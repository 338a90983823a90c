"""Colours of heights: hypsometric tints, any ``cmap`` name, and the span of heights they are stretched over.

Tables are linear RGB, ready to be lit. Our own tints are given by a few stops in sRGB and interpolated in OKLab
(Ottosson 2020), where equal steps look equal; they are light and grey enough for shading to read on them (Imhof 1965,
*Kartographische Geländedarstellung*, ch. 13).
"""

from __future__ import annotations

import difflib
import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geovis.tables import Table, quiet_colormap
from orograph.store.terrain import Terrain

Colors = NDArray[np.float32]

TINTS: dict[str, list[tuple[float, str]]] = {
    # Position 0–1, colour. Lowland greens, ochre slopes, brown-grey heights, pale summits.
    "alpine": [(0.0, "#8ba884"), (0.12, "#a8bc92"), (0.27, "#cecda6"), (0.44, "#dccca4"), (0.60, "#cab195"),
               (0.76, "#b9aa9e"), (0.89, "#d6d1cb"), (1.0, "#f5f4f1")],
    "sea": [(0.0, "#4f7fa5"), (0.45, "#7aa7c2"), (0.8, "#a5c9d6"), (1.0, "#c6dfe3")],
    "mars": [(0.0, "#6e4a3c"), (0.35, "#a0694a"), (0.65, "#c99468"), (0.85, "#dfbf98"), (1.0, "#f2e6d2")],
    "grey": [(0.0, "#a9a9a9"), (1.0, "#dedede")],
}  # fmt: skip

DEFAULT = "alpine"

ELEVATIONS: dict[str, list[tuple[float, float]]] = {
    # Metres above the sea, position in the tint.
    "alpine": [(0, 0.0), (150, 0.12), (450, 0.27), (1000, 0.44), (1800, 0.60), (2700, 0.76), (3600, 0.89), (4800, 1.0)],
    "sea": [(-8000, 0.0), (-4000, 0.2), (-1000, 0.45), (-200, 0.75), (0, 1.0)],
}  # fmt: skip
"""Tints of which a color stands for a height, so that snow lies on mountains only. A picture shows the part between its
lowest and highest ground, or as much around it as ``LEAST`` of the tint, so that gentle land has colors, too."""

LEAST = 0.35

TINTS_VERSION = 2
"""Of what stored errors of colors were made with. 2: by elevation."""

DEEP = -450.0
"""Metres: no land lies as deep as that."""

SHORED = frozenset({"cmocean:topo", "crameri:oleron", "crameri:bukavu", "crameri:fes"})
"""Colour maps of the catalogue made of a sea half and a land half that meet at a shore: their break, at one half, is
pinned to 0 m. All others are stretched linearly over the land's heights."""

SEA_DEPTH, SEA_COAST = -20.0, 20.0
"""Metres that the sea's floor must reach down to and the land up to for heights to be those of land and sea. What
stays within is a shallow polder, a lagoon, or no height of ground at all."""

NO_GROUND = re.compile(r"geoid|undulation|(^|[^a-z])(egm|eigen|xgm)[-_]?\d\d", re.IGNORECASE)
"""Names of rasters that hold no heights of ground: geoid models, whose 0 m is no shore."""

SEA_FLOOR = re.compile(r"bathy|gebco|emodnet|sea.?floor", re.IGNORECASE)
"""Names of rasters of the floor of a sea, which may be shallow."""

_M1 = np.array([[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566],
                [0.0883024619, 0.2817188376, 0.6299787005]])  # fmt: skip
_M2 = np.array([[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099],
                [0.0259040371, 0.7827717662, -0.8086757660]])  # fmt: skip


def srgb_to_linear(color: NDArray[Any]) -> Colors:
    """sRGB in [0, 1] → linear light."""
    c = np.asarray(color, np.float32)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def linear_to_srgb(color: NDArray[Any]) -> Colors:
    """Linear light → sRGB, both in [0, 1]; what lies outside is clipped."""
    x = np.clip(np.asarray(color, np.float32), 0.0, 1.0)
    power = np.power(np.maximum(x, 0.0031308), np.float32(1 / 2.4))
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * power - 0.055).astype(np.float32)


def color_table(name: str | Table | None = None, n: int = 1024) -> Colors:
    """A table (n, 3) float32 of linear colours from the lowest to the highest.

    Args:
        name: one of ``TINTS`` or a name of the ``cmap`` catalogue, or a table; None is the default tint.

    Raises:
        UsageError: there is no such colour map; names like it are suggested.
    """
    name = name or DEFAULT
    if isinstance(name, Table):
        colors = name.colors[np.linspace(0, len(name.colors) - 1, n).round().astype(int), :3]
        return srgb_to_linear(colors / np.float32(255))
    if name in TINTS:
        at = np.array([p for p, _ in TINTS[name]])
        stops = np.array([[int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)] for _, c in TINTS[name]])
        lab = np.cbrt(srgb_to_linear(stops).astype(np.float64) @ _M1.T) @ _M2.T
        x = np.linspace(0, 1, n)
        smooth = np.stack([np.interp(x, at, lab[:, k]) for k in range(3)], 1)
        linear: Colors = (((smooth @ np.linalg.inv(_M2).T) ** 3) @ np.linalg.inv(_M1).T).astype(np.float32)
        return np.clip(linear, 0, 1)
    return srgb_to_linear(np.asarray(_catalogued(name)(np.linspace(0, 1, n)))[:, :3])


def _catalogued(name: str) -> Any:
    """The colour map of this name in the ``cmap`` catalogue."""
    import cmap

    try:
        return quiet_colormap(name)
    except (ValueError, TypeError, KeyError) as error:
        known = [*TINTS, *(str(k) for k in cmap.Colormap.catalog().unique_keys())]
        short = {k.split(":")[-1]: k for k in known}
        close = [short[m] for m in difflib.get_close_matches(name.split(":")[-1], list(short), 4)]
        hint = f"Did you mean {', '.join(close)}?" if close else "Try alpine, viridis, gist_earth or cmocean:topo."
        raise UsageError(f"There is no colour map {name!r}.", remedy=hint) from error


def shored_tables(name: str | Table | None) -> tuple[Colors, Colors] | None:
    """The sea half (128, 3), ending at the shore, and the land half (128, 3) of a map in ``SHORED``; None for others.

    Raises:
        UsageError: there is no such colour map.
    """
    if not isinstance(name, str) or name in TINTS:
        return None
    found = _catalogued(name)
    if found.name not in SHORED:
        return None
    table = srgb_to_linear(np.asarray(found((np.arange(256) + 0.5) / 256))[:, :3])
    return table[:128], table[128:]


def elevation_table(name: str | Table | None, low: float, high: float, n: int = 1024) -> Colors:
    """The colors (n, 3), linear, of heights from ``low`` to ``high`` metres, evenly.

    Of a tint in ``ELEVATIONS`` they are the part that stands for those heights; any other is stretched over them.

    Raises: as ``color_table``.
    """
    table = color_table(name, n)
    known = None if isinstance(name, Table) else ELEVATIONS.get(name or DEFAULT)
    if known is None:
        return table
    at = np.interp(np.linspace(low, high, n), *np.array(known).T)
    span = at[-1] - at[0]
    if span < LEAST:  # more of the tint than there are heights: upwards from the lowest, or downwards from the summits
        even = (at - at[0]) / span if span > 0 else np.linspace(0.0, 1.0, n)
        at = min(at[0], 1.0 - LEAST) + LEAST * even
    whole = np.linspace(0.0, 1.0, n)
    return np.stack([np.interp(at, whole, table[:, k]) for k in range(3)], 1).astype(np.float32)


class Tint(NamedTuple):
    """How heights become colours.

    Attributes:
        low, high: metres at the ends of ``land``.
        land: (n, 3) float32 linear colours.
        floor: metres at the deep end of ``sea``; its other end is 0 m.
        sea: (m, 3), or (0, 3) where what lies below 0 m is land like any other.
        below, above: whether some ground lies visibly beyond the lower or upper end of ``scale`` and has its colour.
    """

    low: float
    high: float
    land: Colors
    floor: float
    sea: Colors
    below: bool = False
    above: bool = False

    def scale(self, n: int = 256) -> tuple[float, float, Colors]:
        """Both ends and one table (n, 3) of colours for a legend."""
        if not len(self.sea):
            return self.low, self.high, self.land
        z = np.linspace(self.floor, self.high, n)
        land = np.clip((z - self.low) / (self.high - self.low) * (len(self.land) - 1), 0, len(self.land) - 1)
        sea = np.clip(z / self.floor * -(len(self.sea) - 1) + len(self.sea) - 1, 0, len(self.sea) - 1)
        return self.floor, self.high, np.where((z < 0)[:, None], self.sea[sea.astype(int)], self.land[land.astype(int)])


def _radius(terrain: Terrain) -> float | None:
    """The planet's equatorial radius, metres; None where no CRS tells."""
    crs = terrain.grid.crs
    ellipsoid = None if crs is None else crs.ellipsoid
    return None if ellipsoid is None else float(ellipsoid.semi_major_metre)


def tint_of(
    terrain: Terrain, name: str | Table | None = None, sea: bool | None = None,
    span: tuple[float, float] | None = None,
) -> Tint:  # fmt: skip
    """The tint a terrain is drawn with.

    The ends leave out the lowest and the highest half hundredth of the heights, so that a spike or a pit does not wash
    out the rest; they are taken on the coarsest level and never coincide.

    Args:
        name: see ``color_table``; None: the default tint, or one for the planet.
        span: heights at the ends, metres, instead of the terrain's own.
        sea: whether ground below 0 m is the floor of a sea. None: it is, if at least a tenth of the ground lies deeper
            than 2 m and some higher (a basin on land, like Death Valley, is less of its surroundings), it reaches
            ``SEA_DEPTH`` and the land ``SEA_COAST``, or if all of it lies below the sea and some as deep as ``DEEP``
            or its name is one of ``SEA_FLOOR``;
            the name is not a geoid's (``NO_GROUND``), and the planet is the
            Earth. With a map in ``SHORED``: it is, if more than half a hundredth reaches ``SEA_DEPTH``; where there is
            no sea, the land half alone is stretched over the land.
    """
    radius = _radius(terrain)
    halves = shored_tables(name)
    if name is None and radius is not None and not 6.3e6 < radius < 6.4e6:
        name, sea = "mars" if 3.3e6 < radius < 3.5e6 else "grey", False
    level = terrain.levels - 1
    rows, cols = terrain.shape(level)
    heights = terrain.read(level, 0, rows, 0, cols)
    valid = heights[np.isfinite(heights)]
    if valid.size == 0:
        valid = np.array(terrain.height_range, np.float32)
    if sea is None:
        bottom, top = (float(v) for v in np.percentile(valid, [0.5, 99.5]))
        if halves is not None:
            sea = bottom <= SEA_DEPTH
        else:
            split = float((valid < -2).mean()) >= 0.1 and float((valid > 2).mean()) >= 0.01
            coast = split and bottom <= SEA_DEPTH and top >= SEA_COAST
            floor_alone = top <= 0 and (bottom <= DEEP or SEA_FLOOR.search(terrain.name) is not None)
            sea = name is None and (coast or floor_alone)
            sea = sea and NO_GROUND.search(terrain.name) is None
    floor, low, high = _ends(valid, sea) if span is None else (min(span[0], -1.0), *span)
    if sea:
        low, high = 0.0, max(high, 1.0)
    table = halves[1] if halves is not None else elevation_table(name, low, high)
    floors = np.empty((0, 3), np.float32)
    if sea:
        floors = halves[0] if halves is not None else elevation_table("sea", floor, 0.0, 256)
    # What differs by less than a step of a printed scale is not worth a sign.
    least, most = terrain.height_range
    end = floor if sea else low
    slight = 0.01 * (high - end)
    return Tint(low, high, table, floor, floors, below=least < end - slight, above=most > high + slight)


def _ends(valid: NDArray[np.float32], sea: bool) -> tuple[float, float, float]:
    """Metres at the deep end of a sea, and at the ends of the land's colors, of heights (n,)."""
    floor = float(np.percentile(valid[valid < 0], 1)) if sea and (valid < 0).any() else -1.0
    land = valid[valid >= 0] if sea and (valid >= 0).any() else valid
    low, high = (float(v) for v in np.percentile(land, [0.5, 99.5]))
    return (floor, low, high) if high - low > 1e-6 else (floor, low - 0.5, high + 0.5)
