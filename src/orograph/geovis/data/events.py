"""Points that happened at a time: earthquakes, strikes of lightning, sightings.

At a moment those are seen that happened before it, within the trail (``Dataset.trail``): a new one has its colour in
full, and becomes paler as time passes. Of a span of times all are seen, unchanged. Nothing is interpolated between
points: each is itself. Colours and sizes keep the scale of all points, whatever the moment. Units: seconds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.points import Points, is_points, seconds_in
from orograph.geovis.data.scales import Shared, doubted, spanned
from orograph.geovis.data.standing import KINDS
from orograph.geovis.data.times import is_span, lasting, seconds_of, seconds_of_trail, span_within, written

TRAIL = 1 / 12
"""The trail, as a part of all time, where none is given."""


def is_eventful(given: Dataset) -> bool:
    """Whether data are shown as points that stand or float, which may happen at a time."""
    return given.style is None or given.style in KINDS


def events_span(given: Dataset, grid: Grid) -> tuple[float, float] | None:
    """The first and the last moment of points, seconds since 1970, UTC; None: they are no points, or say no times."""
    if not is_eventful(given) or not is_points(given, grid):
        return None
    seconds = seconds_in(given, grid)
    known = seconds[np.isfinite(seconds)] if seconds is not None else np.empty(0)
    return (float(known.min()), float(known.max())) if len(known) else None


def trail_of(given: Dataset, span: tuple[float, float]) -> float:
    """For how many seconds a point is seen after its time, of data of a span of times."""
    return seconds_of_trail(given.trail) if given.trail is not None else max(TRAIL * (span[1] - span[0]), 1.0)


def happened(given: Dataset, points: Points) -> tuple[Dataset, Points, str]:
    """Data as they are at the time that they choose: those points, on the scales of all, and what a reader must know.

    Raises:
        UsageError: nothing says when the points happened. ReadError: the time is none of theirs.
    """
    if given.time is None:
        return given, points, ""
    name, seconds = str(given.source) if isinstance(given.source, str) else "points", points.seconds
    known = np.empty(0) if seconds is None else np.sort(np.round(seconds[np.isfinite(seconds)]))
    if seconds is None or not len(known):
        raise UsageError(
            "Nothing says when its points happened.", path=name, remedy="Name it: when=NAME; or leave out time=."
        )
    ages = None
    if is_span(given.time):
        low, high = span_within([written(one) for one in known], given.time)
        some = (np.round(seconds) >= low) & (np.round(seconds) <= high)
        words = f"{_clock(low)} to {_clock(high)}"
    else:
        moment = float(seconds_of([given.time], name, "time=")[0])
        if not np.isfinite(moment):
            raise ReadError(f"{given.time!r} is not a moment.", path=name, remedy="Write 2019-03-01T12:00.")
        trail = trail_of(given, (float(known[0]), float(known[-1])))
        ages = (moment - np.round(seconds)) / trail
        some = (ages >= 0) & (ages < 1)
        words = f"{_clock(moment)}, each seen for {lasting(trail)} after its time"
    unknown = int((~np.isfinite(seconds)).sum())
    words += f", {unknown} without a time left out" if unknown else ""
    if points.classes is None and given.range is None:
        given = given.but(range=Shared(spanned(points.values, None)))
    doubt = given.uncertainty
    if isinstance(doubt, Uncertainty) and doubt.range is None and points.sigma is not None:
        given = given.but(uncertainty=replace(doubt, range=doubted(points.sigma)))
    return given, replace(points.some(some), ages=None if ages is None else ages[some]), words


def _clock(second: float) -> str:
    return written(second).replace("T", " ")
