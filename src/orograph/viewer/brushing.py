"""One selection of data and ground: ranges of variables (brushed in a histogram or a scatter plot) and an area.

A place is selected if every variable that it has is within its range, and it lies within the area. Ground is tested on
a lattice over the terrain for the plots, and texel by texel for the veil laid over unselected ground; standing things
are tested by their own value and by what is painted beneath them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.painting import image_grid
from orograph.geovis.layers import Layer
from orograph.measuring.ground import heights

if TYPE_CHECKING:
    from orograph.geovis.data.painting import Shown
    from orograph.geovis.data.standing import Things
    from orograph.store.terrain import Terrain
    from orograph.viewer.data import ShownData

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Range = tuple[float, float]

HEIGHT = "Height"

LATTICE, TEXELS = 128, 768
"""Places along the terrain's longer side in plots, and texels of the veil."""

VEIL, PALE = (246, 244, 239, 190), 0.72
"""The veil over unselected ground: sRGB and opacity; and how pale unselected things are."""


class Sampled(NamedTuple):
    """Places and their values.

    Attributes:
        x, y: (n,) in the terrain's CRS. values: of each variable (n,), NaN where it has none.
    """

    x: Array
    y: Array
    values: Mapping[str, Array]


class Brush:
    """The selection of a window.

    Attributes:
        ranges: of variables, by name. area: corners (x, y) in the terrain's CRS, of a polygon; () : everywhere.
        veil: the layer over what is not selected; None: all is selected.
    """

    def __init__(self) -> None:
        self.ranges: dict[str, Range] = {}
        self.area: tuple[tuple[float, float], ...] = ()
        self.veil: Layer | None = None
        self._key: Any = None
        self._ground: Sampled | None = None
        self._things: Sampled | None = None
        self._pale: tuple[Things, Things] | None = None

    @property
    def empty(self) -> bool:
        """Whether nothing is selected, so that everything is shown."""
        return not self.ranges and not self.area

    @property
    def chosen(self) -> tuple[Any, ...]:
        """What is selected, to be compared."""
        return tuple(self.ranges.items()), self.area

    def choose(self, ranges: Mapping[str, Sequence[float]] | None = None, area: Sequence[Any] | None = None) -> None:
        """Change the selection.

        Args:
            ranges, area: the new ones; None: unchanged.

        Raises:
            UsageError: ranges have no names; one is not two numbers, the lower first; an area has one or two corners.
        """
        made = dict(self.ranges)
        if ranges is not None:
            if not isinstance(ranges, Mapping):
                raise UsageError(f"Ranges must be given by name, {{'Height': (500, 900)}}, not {ranges!r}.")
            made = {str(name): _range(name, given) for name, given in ranges.items()}
        corners = self.area
        if area is not None:
            try:
                corners = tuple((float(point[0]), float(point[1])) for point in area)
            except (TypeError, ValueError, IndexError):
                raise UsageError("An area must be a list of corners (easting, northing).") from None
            if 0 < len(corners) < 3:
                raise UsageError(f"An area must have three corners or more, not {len(corners)}.")
        self.ranges, self.area = made, corners

    def ground(self, terrain: Terrain, shown: ShownData | None) -> Sampled:
        """The lattice of places for plots."""
        self._renew(terrain, shown)
        if self._ground is None:
            grid = terrain.grid
            cols, rows = _lattice(grid)
            self._ground = sampled(*grid.xy(cols, rows), terrain, shown)
        return self._ground

    def things(self, terrain: Terrain, shown: ShownData | None) -> Sampled | None:
        """The places and values of things that show a value; None: there are none."""
        self._renew(terrain, shown)
        if self._things is None and shown is not None and shown.things is not None:
            made = shown.things
            base = sampled(made.x, made.y, terrain, shown)
            own = {
                one.name: np.where(made.shown == k, made.values, np.nan) for k, one in enumerate(made.shows)
            }  # fmt: skip
            self._things = Sampled(made.x, made.y, {**base.values, **own})
        return self._things

    def stale(self, terrain: Terrain, shown: ShownData | None) -> bool:
        """Whether the data shown differ from those that the veil was made from."""
        return not self.empty and self._key != _key(terrain, shown)

    def _renew(self, terrain: Terrain, shown: ShownData | None) -> None:
        key = _key(terrain, shown)
        if key != self._key:
            self._key, self._ground, self._things = key, None, None

    def names(self, terrain: Terrain, shown: ShownData | None) -> list[str]:
        """The variables that can be plotted."""
        found = self.things(terrain, shown)
        names = dict.fromkeys([*self.ground(terrain, shown).values, *([] if found is None else found.values)])
        return list(names)

    def table(self, names: Sequence[str], terrain: Terrain, shown: ShownData | None) -> Sampled:
        """Where variables are plotted: places on the ground, or things if one of the variables is theirs."""
        ground = self.ground(terrain, shown)
        found = self.things(terrain, shown)
        return ground if found is None or all(name in ground.values for name in names) else found

    def holds(self, at: Sampled) -> Mask:
        """(n,) which places are selected."""
        held = np.ones(len(at.x), bool)
        for name, (low, high) in self.ranges.items():
            if name not in at.values:
                continue
            values = at.values[name]
            with np.errstate(invalid="ignore"):
                within = (values >= low) & (values <= high)
            if at is self._things and self._ground is not None and name not in self._ground.values:
                within |= np.isnan(values)  # (the variable belongs to other things)
            held &= within
        if self.area:
            held &= inside(at.x, at.y, np.array(self.area))
        return held

    def apply(self, terrain: Terrain, shown: ShownData | None) -> None:
        """Make the veil of the selection."""
        self._pale = None
        on_ground = self.area or any(name in self.ground(terrain, shown).values for name in self.ranges)
        if self.empty or not on_ground:
            self.veil = None
            return
        self.things(terrain, shown)
        over = image_grid(terrain.grid, TEXELS)
        col, row = np.meshgrid(np.arange(over.cols, dtype=np.float64), np.arange(over.rows, dtype=np.float64))
        x, y = over.xy(col.ravel(), row.ravel())
        held = self.holds(sampled(x, y, terrain, shown)).reshape(over.shape)
        if held.all():
            self.veil = None  # (an image with nothing in it is an error)
            return
        image = np.zeros((*over.shape, 4), np.uint8)
        image[...] = VEIL
        image[held, 3] = 0
        placed = over.crs is not None
        self.veil = Layer(image, name="not selected", transform=over.transform if placed else None,
                          crs=over.crs if placed else None)  # fmt: skip

    def seen(self, terrain: Terrain, shown: ShownData | None) -> Things | None:
        """Standing things, pale where not selected."""
        things = None if shown is None else shown.things
        if things is None or self.empty:
            return things
        if self._pale is None or self._pale[0] is not things:
            at = self.things(terrain, shown)
            assert at is not None
            less = ~self.holds(at) & (things.shown >= 0)
            paper = np.array([0.91, 0.9, 0.86], np.float32)
            rgb = np.where(less[:, None], things.rgb * (1 - PALE) + paper * PALE, things.rgb).astype(np.float32)
            self._pale = things, things.but(rgb=rgb)
        return self._pale[1]

    def places(self, terrain: Terrain, shown: ShownData | None) -> Array:
        """(n, 2) the selection in the terrain's CRS: things, else places on the ground."""
        found = self.things(terrain, shown)
        things = None if found is None or shown is None else shown.things
        if found is not None and things is not None:
            held = self.holds(found) & (things.shown >= 0)
            return np.stack([found.x, found.y], 1)[held]
        at = self.ground(terrain, shown)
        return np.stack([at.x, at.y], 1)[self.holds(at) & np.isfinite(at.values[HEIGHT])]

    def units(self, terrain: Terrain, shown: ShownData | None) -> dict[str, str]:
        """The unit of each variable that has one."""
        units = {HEIGHT: "m"}
        for one in () if shown is None else shown.painted:
            units |= {one.title: one.unit, f"± {one.title}": one.unit}
        for thing in () if shown is None or shown.things is None else shown.things.shows:
            units[thing.name] = thing.unit
        return units

    def describe(self, terrain: Terrain, shown: ShownData | None) -> str:
        """How much is selected, as text."""
        at, found = self.ground(terrain, shown), self.things(terrain, shown)
        known = np.isfinite(at.values[HEIGHT])
        part = float((self.holds(at) & known).sum() / max(known.sum(), 1))
        words = f"{100 * part:.3g} % of the ground" + (" within the measured area" if self.area else "")
        if found is not None and shown is not None and shown.things is not None:
            count = shown.things.shown >= 0
            words += f", {int((self.holds(found) & count).sum()):,} of {int(count.sum()):,} things"
        return words


def opened(given: Range, ends: Range) -> Range:
    """A range whose ends that reach those of a plot (or beyond) are open: a plot has only some of all places, and at
    another time values differ."""
    low, high = given
    near = 1e-6 * max(ends[1] - ends[0], *(abs(end) for end in ends))  # (numbers are typed in single precision)
    return -math.inf if low <= ends[0] + near else low, math.inf if high >= ends[1] - near else high


def _key(terrain: Terrain, shown: ShownData | None) -> Any:
    """What places are sampled from; compared by identity, and kept alive."""
    return terrain, None if shown is None else (*shown.painted, shown.things)


def _lattice(grid: Grid) -> tuple[Array, Array]:
    """Columns and rows (n,) of an even lattice over a terrain."""
    step = max(1.0, max(grid.shape) / LATTICE)
    cols, rows = np.arange(0.0, grid.cols - 0.5, step), np.arange(0.0, grid.rows - 0.5, step)
    found = np.meshgrid(cols, rows)
    return found[0].ravel(), found[1].ravel()


def sampled(x: Array, y: Array, terrain: Terrain, shown: ShownData | None) -> Sampled:
    """Heights, painted numbers and their standard deviations at places (n,); of two with the same name, the
    upper one."""
    grid = terrain.grid
    col, row = grid.index(x, y)
    here = (col >= 0) & (row >= 0) & (col <= grid.cols - 1) & (row <= grid.rows - 1)
    found = heights(terrain, np.clip(col, 0, grid.cols - 1), np.clip(row, 0, grid.rows - 1))
    values: dict[str, Array] = {HEIGHT: np.where(here, found, np.nan)}
    for one in () if shown is None else shown.painted:
        if one.square is None:
            values[one.title] = _of_painted(one, one.values, x, y)
            if one.sigma is not None:
                values[f"± {one.title}"] = _of_painted(one, one.sigma, x, y)
    return Sampled(x, y, values)


def _of_painted(one: Shown, values: NDArray[np.float32], x: Array, y: Array) -> Array:
    """Values (n,) of painted data (rows, cols) at places: those of the nearest texel."""
    col, row = (np.rint(v).astype(np.int64) for v in one.over.index(x, y))
    here = (row >= 0) & (row < one.over.rows) & (col >= 0) & (col < one.over.cols)
    row, col = np.where(here, row, 0), np.where(here, col, 0)
    there = here if one.cover is None else here & (one.cover[row, col] >= 0.5)
    return np.where(there, values[row, col].astype(np.float64), np.nan)


def inside(x: Array, y: Array, corners: Array) -> Mask:
    """(n,) which places lie within a polygon (m, 2), by the even-odd rule."""
    found = np.zeros(len(x), bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, 0)):
        if y0 == y1:
            continue
        crosses = (y0 > y) != (y1 > y)
        found ^= crosses & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
    return found


def _range(name: str, given: Sequence[float]) -> Range:
    try:
        low, high = (float(v) for v in given)
    except (TypeError, ValueError):
        low = high = math.nan
    if not low <= high:
        raise UsageError(f"A range of {name} must be two numbers, the lower first, not {given}.")
    return low, high
