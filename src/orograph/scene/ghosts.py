"""Ghosted surfaces: another, transparent surface over or under the terrain, such as a second DEM or a water table.

It is drawn separately, in one colour with light and shadow, and composited with the terrain's picture pixel by pixel:
where it is nearer than the ground it covers it with ``opacity``; where the ground hides it, it shows through with
``hidden``. So ground below it stays visible, and what lies underground appears paler. Heights are metres, as the
terrain's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from orograph._named import named
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.focus import Weight
from orograph.geovis.layers import keyed
from orograph.store.opening import terrain as opened
from orograph.store.terrain import Terrain

if TYPE_CHECKING:
    from orograph.geovis.tables import Table

Array = NDArray[np.float64]

COLOR = "#2f7fd1"
KEYS = ("color", "opacity", "hidden", "name", "band", "vertical_unit")


@named("A ghost")
@dataclass(frozen=True, slots=True)
class Ghost:
    """A transparent surface.

    Attributes:
        source: whatever ``orograph.terrain`` takes: a DEM in any CRS, a ``Terrain``; or an array (rows, cols) of the
            terrain's samples.
        color: a name or #rrggbb. opacity: in front of the ground, 0 to 1; hidden: behind it. name: in the legend; None:
            the file's.
        band, vertical_unit: as for ``orograph.terrain``.

    Raises:
        UsageError: a value makes no sense.
    """

    source: Any
    color: str = COLOR
    opacity: float = 0.75
    hidden: float = 0.25
    name: str | None = None
    band: int | None = None
    vertical_unit: str | None = None

    def __post_init__(self) -> None:
        _rgb(self.color)
        for what in ("opacity", "hidden"):
            if not 0 <= getattr(self, what) <= 1:
                raise UsageError(f"{what} must be a number from 0 to 1, not {getattr(self, what)}.")

    @classmethod
    def parse(cls, text: str) -> Self:
        """A ghost from the command line: ``DEM[,KEY=VALUE…]``.

        Raises:
            UsageError: a key is unknown or its value makes no sense.
        """
        source, keys = keyed(text)
        made: dict[str, Any] = dict(keys)
        for key, value in keys.items():
            if key not in KEYS:
                raise UsageError(f"A ghost has no key {key!r}.", path=source, remedy=f"The keys are {', '.join(KEYS)}.")
            if key in ("opacity", "hidden", "band"):
                try:
                    made[key] = int(value) if key == "band" else float(value)
                except ValueError:
                    raise UsageError(f"{key} must be a number, not {value!r}.", path=source) from None
        return cls(source, **made)

    def over(self, terrain: Terrain) -> Terrain:
        """Its surface, in the CRS of a terrain.

        Raises:
            ReadError, UsageError: it cannot be read, lies elsewhere, or in another CRS.
        """
        grid, given = terrain.grid, {"band": self.band, "vertical_unit": self.vertical_unit}
        options: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        if grid.crs is not None:
            options["crs"] = grid.crs.to_wkt()
        if isinstance(self.source, np.ndarray):
            if self.source.shape != grid.shape:
                raise UsageError(
                    f"A ghost must have the terrain's {grid.rows} × {grid.cols} samples, not {self.source.shape}."
                )
            options |= {"transform": grid.transform, "name": self.name or "surface"}
        found = self.source if isinstance(self.source, Terrain) else opened(self.source, False, **options)
        if found.grid.crs != grid.crs:
            raise UsageError(
                f"{found.name} is in a different CRS from the terrain.", remedy="Open it in the terrain's CRS (`crs`)."
            )
        west, south, east, north = grid.bounds()
        a, b, c, d = found.grid.bounds()
        if a >= east or c <= west or b >= north or d <= south or math.isnan(found.height_range[0]):
            raise UsageError(
                f"{found.name} has no heights over the terrain.", remedy="Give a surface of the same area."
            )
        return found

    @property
    def table(self) -> Table:
        """Its colour, the same for all heights."""
        from orograph.geovis.tables import Table

        return Table("ghost", bytes((*_rgb(self.color), 255)) * 2)

    @property
    def rgb(self) -> tuple[int, int, int]:
        return _rgb(self.color)


@dataclass(frozen=True, slots=True, eq=False)
class Seen(Weight):
    """The weight of a ghost, from which of the two is nearer; nothing outside a terrain with this grid."""

    grid: Grid
    opacity: float
    hidden: float

    def __call__(self, eye: Array, places: Array, pixels: tuple[Array, Array], aspect: float) -> Array:
        return np.ones(places.shape[:2])

    def of_depths(self, ground: NDArray[Any], ghost: NDArray[Any], places: Array) -> Array:
        """(rows, cols), 0 to 1, from two pictures' depths, NaN where they show nothing; ``places``: of the ghost."""
        before = ~(ghost > ground)
        with np.errstate(invalid="ignore"):
            col, row = self.grid.index(places[..., 0], places[..., 1])
            there = (col >= 0) & (row >= 0) & (col <= self.grid.cols - 1) & (row <= self.grid.rows - 1)
        return np.where(there, np.where(before, self.opacity, self.hidden), 0.0)


def _rgb(color: str) -> tuple[int, int, int]:
    from PIL import ImageColor

    try:
        red, green, blue = ImageColor.getrgb(color)[:3]
    except ValueError:
        raise UsageError(f"The colour of a ghost must be a name or #rrggbb, not {color!r}.") from None
    return red, green, blue
