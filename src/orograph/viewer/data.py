"""Data in the window: what is painted and what stands, priorities, times, and values at a place.

Data are read again when a priority or the time changes; colours keep their scale over all times.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from orograph.errors import ReadError, UsageError
from orograph.geovis.data.bivariate import classes_of
from orograph.geovis.data.dataset import Breaks, Dataset
from orograph.geovis.data.derived import read_data
from orograph.geovis.data.events import events_span, is_eventful, trail_of
from orograph.geovis.data.features import has_features
from orograph.geovis.data.listing import times_in
from orograph.geovis.data.points import is_table
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.reading import read
from orograph.geovis.data.scales import PERCENTILES, Shared, shared_breaks
from orograph.geovis.data.standing import stands
from orograph.geovis.data.times import is_span, neighbours, seconds_of, span_within, written
from orograph.geovis.data.tracks import span_of
from orograph.viewer.turns import Turns

if TYPE_CHECKING:
    from orograph.geo.grid import Grid
    from orograph.geovis.data.painting import Shown
    from orograph.geovis.data.standing import Things
    from orograph.store.terrain import Terrain

LOOKED_AT = 12
"""Number of times, evenly spread, whose values define the scale of a series and its classes."""


WHOLE_MINUTES = 7200.0
"""Spans longer than this many seconds have moments in whole minutes."""


@dataclass(frozen=True, slots=True)
class Found:
    """A value of data at a place.

    Attributes:
        name, unit: what it is. value: a number, or the name of a class. sigma: its standard deviation; None: unknown.
    """

    name: str
    value: float | str
    sigma: float | None = None
    unit: str = ""

    @property
    def words(self) -> str:
        return f"{self.name} {self.value_words}"

    @property
    def value_words(self) -> str:
        """The value in its unit, to the second digit of its standard deviation if that is known."""
        if isinstance(self.value, str):
            return self.value
        if self.sigma is None or not 0 < self.sigma < math.inf:
            said = f"{self.value:.4g}" + ("" if self.sigma is None else f" ± {self.sigma:g}")
        else:
            places = max(1 - math.floor(math.log10(float(f"{self.sigma:.1e}"))), 0)
            said = f"{self.value:.{places}f} ± {self.sigma:.{places}f}"
        return f"{said} {self.unit}".rstrip()


class ShownData:
    """The data of a window.

    Args:
        data: as given. priority: of terrain, data and uncertainty. grid: the terrain's.

    Attributes:
        times: of the data that have any, ISO 8601 in UTC, in order. span: their first and last moment, including
            tracks and points, seconds since 1970; None: no times. limits: the part of it that is played: by default the
            span that the data choose (``time=A..B``). time: the time that is shown; "": as given.
        playing: whether time passes. waited: seconds for which it has passed since what is shown was chosen.
        turns: the members in turn, or None.
        exceeds: show the probability that the first raster's values exceed this one;
            None: show its values.
        painted: what is painted, bottom to top. things: what stands, or None.
    """

    def __init__(self, data: tuple[Dataset, ...], priority: Priority, grid: Grid | None = None) -> None:
        self.data, self.priority = data, priority
        self.times = sorted({time for one in data for time in times_in(one)})
        self._moving: dict[int, tuple[float, float]] = {}
        for k, one in enumerate(data):
            span = None if grid is None or times_in(one) else span_of(one, grid) or events_span(one, grid)
            if span is not None and span[0] < span[1]:
                self._moving[k] = span
        ends = [end for span in self._moving.values() for end in span]
        ends += seconds_of(self.times[:1] + self.times[-1:], "", "").tolist()
        self.span = (min(ends), max(ends)) if len(self.times) > 1 or self._moving else None
        self.limits = self._chosen()
        self.time, self.playing, self.waited = "", False, 0.0
        self.turns = Turns.of(data)
        self.exceeds: float | None = None
        self._settled = self._chosen_now
        self.painted: tuple[Shown, ...] = ()
        self.things: Things | None = None
        self._spans: dict[int, tuple[tuple[float, float], Breaks | tuple[float, ...]]] = {}

    def _chosen(self) -> tuple[float, float] | None:
        """The span that the first data with one choose, else all."""
        for k, one in enumerate(self.data):
            if one.time is not None and is_span(one.time) and self.span is not None:
                known = [written(end) for end in self._moving[k]] if k in self._moving else times_in(one)
                return span_within(known, one.time) if len(known) > 1 else self.span
        return self.span

    @property
    def _chosen_now(self) -> tuple[Priority, str, float | None, bool]:
        return self.priority, self.time, self.exceeds, self.turns is not None and self.turns.on

    def settle(self) -> None:
        """What is chosen is shown."""
        self._settled = self._chosen_now

    def revert(self) -> None:
        """Choose what is shown: what was chosen cannot be."""
        self.priority, self.time, self.exceeds, on = self._settled
        if self.turns is not None:
            self.turns.on = on

    @property
    def changing(self) -> bool:
        """Whether what is shown changes by itself: time passes, or members take turns."""
        return self.playing or (self.turns is not None and self.turns.on)

    def play(self, part: float) -> str:
        """The moment that follows after a part (0 to 1) of the played span; after its end it begins again."""
        assert self.span is not None and self.limits is not None
        low, high = self.limits
        now = float(seconds_of([self.time], "", "")[0]) if self.time else low
        after = low + (now - low + part * (high - low)) % (high - low) if low <= now <= high else low
        return self.at_part((after - self.span[0]) / max(self.span[1] - self.span[0], 1e-9))

    def limit(self, first: str | None = None, last: str | None = None) -> None:
        """Play from or to a moment; neither: everything.

        Raises:
            UsageError: nothing would be left to play.
        """
        assert self.span is not None and self.limits is not None
        low, high = self.limits if first or last else self.span
        low = float(seconds_of([first], "", "")[0]) if first else low
        high = float(seconds_of([last], "", "")[0]) if last else high
        if not low < high:
            raise UsageError("What is played must end later than it begins.", remedy="Choose another time.")
        self.limits = low, high

    def choose(self, time: str) -> None:
        """Choose the time to show, one of the data's times or a moment between them; "": as given.

        Raises:
            UsageError: there is no such time.
        """
        if time and time not in self.times and not self._within(time):
            told = f"from {self.times[0]} to {self.times[-1]}" if self.times else "none"
            raise UsageError(f"These data have no time {time!r}; they have {told}.")
        self.time = time

    def _within(self, time: str) -> bool:
        try:
            second = seconds_of([time], "", "")[0]
        except ReadError:
            return False
        return self.span is not None and bool(self.span[0] - 60 <= second <= self.span[1] + 60)

    def at_part(self, part: float) -> str:
        """The moment at a part (0 to 1) of the span, ISO 8601 in UTC: to the minute if the span is long enough."""
        if self.span is None:
            return ""
        first, last = self.span
        second = first + part * (last - first)
        return written(round(second / 60) * 60 if last - first > WHOLE_MINUTES else second)

    @property
    def part(self) -> float:
        """The chosen time as a part of the span; 0 if none is chosen."""
        if self.span is None or not self.time:
            return 0.0
        first, last = self.span
        return float(np.clip((seconds_of([self.time], "", "")[0] - first) / max(last - first, 1e-9), 0, 1))

    @property
    def time_text(self) -> str:
        """The chosen time as text, and how values between two times are found."""
        if not self.time:
            return "as given"
        around = neighbours(self.times, self.time)
        between = "" if around is None else f", linear between {_clock(around[0])} and {_clock(around[1])}"
        return self.time.replace("T", " ") + between

    def current(self, terrain: Terrain) -> tuple[Dataset, ...]:
        """The data of the chosen time. A single time of a series says nothing about the differences between members."""
        made = [self._at_time(k, one, terrain) for k, one in enumerate(self.data)]
        if self.turns is not None and self.exceeds is None:
            made[self.turns.of_data] = self.turns.over(made[self.turns.of_data], terrain.grid)
        k = self.doubtful
        if self.exceeds is not None and k is not None:
            doubt = made[k].uncertainty
            own = None if doubt is None or doubt.of_members else doubt
            made[k] = made[k].but(exceeds=self.exceeds, value=None, range=None, uncertainty=own)
        return tuple(made)

    @property
    def doubtful(self) -> int | None:
        """The index of the first data with a probability of exceeding a value: a raster with an uncertainty, or with
        such a probability; None: there are none."""
        for k, one in enumerate(self.data):
            raster = not (has_features(one.source) or is_table(one.source) or stands(one))
            if raster and (one.uncertainty is not None or one.exceeds is not None):
                return k
        return None

    @property
    def exceeding(self) -> Shown | None:
        """The painted data of ``doubtful``; None: they are not painted yet."""
        k = self.doubtful
        asked = None if k is None else self.data[k]
        return next((one for one in self.painted if asked is not None and one.dataset.source is asked.source
                     and (one.dataset.variable, one.dataset.band) == (asked.variable, asked.band)), None)  # fmt: skip

    def _at_time(self, k: int, one: Dataset, terrain: Terrain) -> Dataset:
        if not self.time:
            return one
        times = times_in(one)
        if k in self._moving and is_eventful(one) and self.limits is not None:
            return one.but(time=self.time, trail=one.trail or f"{trail_of(one, self.limits):.10g}s")
        if k in self._moving:
            return one.but(time=self.time)
        if self.time not in times and neighbours(times, self.time) is None:
            return one
        doubt = None if one.uncertainty is not None and one.uncertainty.of_members else one.uncertainty
        bare = one.but(time=self.time, uncertainty=doubt)
        if bare.derived and len(read(bare.but(value=None, exceeds=None, uncertainty=None), terrain.grid).values) == 1:
            range_ = None if one.exceeds is not None else one.range
            bare = bare.but(value=None, exceeds=None, range=range_)  # of a single time: as it is
        given = bare.range is not None and (isinstance(bare.breaks, tuple) or bare.breaks == "equal")
        if given or bare.exceeds is not None or "+" in str(one.variable or one.band or ""):
            return bare
        if k not in self._spans:
            self._spans[k] = _of_all(bare, times, terrain.grid)
        span, breaks = self._spans[k]
        return bare.but(range=span, breaks=breaks)

    def at(self, x: float, y: float) -> tuple[Found, ...]:
        """Painted data at a place in the terrain's CRS, the uppermost first."""
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
        """The value of a standing thing, by its number, and its standard deviation where it is known."""
        if self.things is None or not 0 <= number < len(self.things) or not np.isfinite(self.things.values[number]):
            return ()
        which = int(self.things.shown[number])
        if which < 0:
            return ()
        name, unit, classes = self.things.shows[which]
        value = float(self.things.values[number])
        doubt = float("nan") if self.things.sigma is None else float(self.things.sigma[number])
        return (Found(name, classes[int(value)] if classes else value, None if math.isnan(doubt) else doubt, unit),)


def _of_all(bare: Dataset, times: list[str], grid: Grid) -> tuple[tuple[float, float], Breaks | tuple[float, ...]]:
    """The ends of the scale of a series, and the breaks of its classes: of the values at ``LOOKED_AT`` of its times."""
    some = sorted({times[round(i)] for i in np.linspace(0, len(times) - 1, LOOKED_AT)})
    fields = [read_data(bare.but(time=time, uncertainty=None), grid).shown.ravel() for time in some]
    values = np.concatenate(fields)
    span = bare.range
    if span is None:
        low, high = (float(v) for v in np.nanpercentile(values, PERCENTILES))
        span = Shared((low, high) if low < high else (low - 0.5, low + 0.5))
    return span, shared_breaks(values, classes_of(bare), bare.breaks, span)


def _clock(time: str) -> str:
    """A time as short text: its hour, or its day at midnight."""
    day, _, hour = time.partition("T")
    return hour if hour != "00:00" else day
