"""Data in the window: what is painted and what stands, its priorities, its times, and what it says at a place.

The data of a session are read again when a priority or the time changes; colours keep their scale over all times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from orograph.errors import UsageError
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.derived import read_data
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.reading import read, times_in
from orograph.geovis.data.scales import PERCENTILES

if TYPE_CHECKING:
    from orograph.geovis.data.painting import Shown
    from orograph.geovis.data.standing import Things
    from orograph.store.terrain import Terrain

LOOKED_AT = 12
"""Times, evenly from all, whose values make the scale of a series."""


@dataclass(frozen=True, slots=True)
class Found:
    """What data say at a place.

    Attributes:
        name, unit: what it is. value: a number, or the name of a class. sigma: its standard deviation; None: not known.
    """

    name: str
    value: float | str
    sigma: float | None = None
    unit: str = ""

    @property
    def words(self) -> str:
        value = self.value if isinstance(self.value, str) else f"{self.value:.4g}"
        doubt = "" if self.sigma is None else f" ± {self.sigma:.2g}"
        return f"{self.name} {value}{doubt} {self.unit}".rstrip()


class ShownData:
    """The data of a window.

    Args:
        data: as given. priority: of terrain, data and uncertainty.

    Attributes:
        times: of the data that have any, ISO 8601 in UTC, in order. time: the one that is shown; "": as given.
        painted: what is painted, bottom to top. things: what stands, or None.
    """

    def __init__(self, data: tuple[Dataset, ...], priority: Priority) -> None:
        self.data, self.priority = data, priority
        self.times = sorted({time for one in data for time in times_in(one)})
        self.time = ""
        self.painted: tuple[Shown, ...] = ()
        self.things: Things | None = None
        self._spans: dict[int, tuple[float, float]] = {}

    def choose(self, time: str) -> None:
        """Choose the time that is shown; "": as given.

        Raises:
            UsageError: there is no such time.
        """
        if time and time not in self.times:
            told = f"from {self.times[0]} to {self.times[-1]}" if self.times else "none"
            raise UsageError(f"There is no time {time!r} of these data; there are {told}.")
        self.time = time

    def current(self, terrain: Terrain) -> tuple[Dataset, ...]:
        """The data of the chosen time. How members differ is not known of a series' single time."""
        return tuple(self._at_time(k, one, terrain) for k, one in enumerate(self.data))

    def _at_time(self, k: int, one: Dataset, terrain: Terrain) -> Dataset:
        if not self.time or self.time not in times_in(one):
            return one
        doubt = None if one.uncertainty is not None and one.uncertainty.of_members else one.uncertainty
        bare = one.but(time=self.time, uncertainty=doubt)
        if bare.derived and len(read(bare.but(value=None, exceeds=None, uncertainty=None), terrain.grid).values) == 1:
            range_ = None if one.exceeds is not None else one.range
            bare = bare.but(value=None, exceeds=None, range=range_)  # of a single time: what it is
        if bare.exceeds is not None:
            return bare
        if bare.range is not None or "+" in str(one.variable or one.band or ""):
            return bare
        if k not in self._spans:
            times = times_in(one)
            some = {times[round(i)] for i in np.linspace(0, len(times) - 1, LOOKED_AT)}
            values = np.concatenate(
                [read_data(bare.but(time=time, uncertainty=None), terrain.grid).shown.ravel() for time in sorted(some)]
            )
            low, high = (float(v) for v in np.nanpercentile(values, PERCENTILES))
            self._spans[k] = (low, high) if low < high else (low - 0.5, low + 0.5)
        return bare.but(range=self._spans[k])

    def at(self, x: float, y: float) -> tuple[Found, ...]:
        """What painted data say at a place in the terrain's CRS, the uppermost first."""
        found = []
        for one in reversed(self.painted):
            col, row = (round(float(v)) for v in one.over.index(x, y))
            if one.square is not None or not (0 <= row < one.over.rows and 0 <= col < one.over.cols):
                continue
            if one.cover is not None and one.cover[row, col] < 0.5:
                continue
            value = float(one.values[row, col])
            if math.isnan(value):
                continue
            sigma = None if one.sigma is None or math.isnan(one.sigma[row, col]) else float(one.sigma[row, col])
            told: Any = value if one.classes is None else one.classes[int(value)]
            found.append(Found(one.title, told, sigma, one.unit))
        return tuple(found)

    def of_thing(self, number: int) -> tuple[Found, ...]:
        """What a thing that stands shows, by its number."""
        if self.things is None or not 0 <= number < len(self.things) or not np.isfinite(self.things.values[number]):
            return ()
        scales = self.things.legend.scales
        name, unit = (scales[0].label, scales[0].unit) if len(scales) == 1 else ("value", "")
        return (Found(name, float(self.things.values[number]), None, unit),)
