"""Data that change during a film: over a span of times, or members in turn.

Moments go evenly from one end of the span to the other; between two times of a series, values are interpolated linearly
in time (classes: those of the nearer time), and so are places of tracks. Members are shown one after the other, again
and again, each for as many frames as limit changes to ``Uncertainty.rate`` a second. All frames share one scale of
colours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.choosing import picked
from orograph.geovis.data.dataset import Dataset, Uncertainty, datasets_of
from orograph.geovis.data.events import events_span, trail_of
from orograph.geovis.data.listing import times_in
from orograph.geovis.data.reading import has_classes, read
from orograph.geovis.data.series import OneScale, doubt_of
from orograph.geovis.data.times import is_span, lasting, span_within, written
from orograph.geovis.data.tracks import span_of
from orograph.progress import Progress
from orograph.store.terrain import Terrain

RATE = 2.0
"""Default number of members a second."""

LOOKED_AT = 24
"""Number of evenly spaced frames whose values make the scale."""

LOOKS = ("value", "exceeds", "style", "colormap", "range", "classes", "breaks", "hidden", "size", "opacity", "unit",
         "name", "uncertainty")  # fmt: skip
"""Properties of a raster that apply to its values, however they are found."""

Key = tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class Played:
    """One dataset of a film.

    Attributes:
        whole: as given, with the uncertainty that all frames share.
        span: the first and the last moment, seconds since 1970; None: time does not change.
        members: numbers of those shown in turn; none otherwise. hold: frames for which each is shown.
        scale: that all frames share; None: frames have the same scale anyway.
        words: for rasters, their members, and how values between times are found; "": none are read ahead.
        facts: for the reader (``Playing.facts``).
    """

    whole: Dataset
    span: tuple[float, float] | None = None
    members: tuple[int, ...] = ()
    hold: int = 1
    scale: OneScale | None = None
    words: str = ""
    facts: Mapping[str, Any] | None = None

    def key(self, number: int, last: int) -> tuple[str, int]:
        """The moment and the member of a frame numbered 0 to ``last``; "" and 0: none."""
        moment = ""
        if self.span is not None:
            first, end = self.span
            moment = written(first + (end - first) * number / max(last, 1))
        return moment, self.members[number // self.hold % len(self.members)] if self.members else 0

    def at(self, key: tuple[str, int], grid: Grid) -> Dataset:
        """The data of a moment and a member.

        Rasters are read, with a description that changes as little as possible from frame to frame.
        """
        one = self.bare(key)
        if self.words:
            field = read(one, grid)
            which = f"member {key[1]}" if key[1] else f"mean of {len(field.values)}" if len(field.values) > 1 else ""
            own = " ".join(filter(None, (which, key[0][:16].replace("T", " ")))) if key[0] else field.chosen
            chosen = f"{own}, {self.words}"
            looks = {name: getattr(one, name) for name in LOOKS}
            one = Dataset(replace(field, chosen=chosen), **looks)
        return one if self.scale is None else self.scale.over(one)

    def bare(self, key: tuple[str, int]) -> Dataset:
        """The same, unread and without a scale."""
        moment, member = key
        one = self.whole
        if moment:
            one = one.but(time=moment)
            doubt = one.uncertainty
            if doubt is not None and doubt.time is not None and is_span(doubt.time):
                one = one.but(uncertainty=replace(doubt, time=moment))
        if member:
            one = one.but(member=str(member), uncertainty=None)
        return one


class Playing(NamedTuple):
    """The data of a film, of which some change.

    Attributes:
        options: of the film's scene, its data as given. data: how each is played. last: the number of the last frame.
        fps: frames a second.
    """

    options: Mapping[str, Any]
    data: tuple[Played, ...]
    last: int
    fps: float

    @classmethod
    def of(cls, options: Mapping[str, Any], terrain: Terrain, frames: int, fps: float) -> Playing | None:
        """The changing data of a film with so many frames; None: nothing changes.

        Raises:
            UsageError: there is no such span, or there are no members. Others: as ``reading.read``.
        """
        given = datasets_of(options.get("data"))
        if not any(changes(one) for one in given):
            return None
        return cls(options, tuple(_played(one, terrain.grid, frames, fps) for one in given), frames - 1, fps)

    def key(self, number: int) -> Key:
        """What is shown in a frame, in short: frames of the same key show the same data."""
        return tuple(one.key(number, self.last) for one in self.data)

    def at(self, key: Key, grid: Grid) -> dict[str, Any]:
        """The scene's options in a frame."""
        return {**self.options, "data": tuple(one.at(part, grid) for one, part in zip(self.data, key))}

    def widest(self, grid: Grid) -> dict[str, Any]:
        """The scene's options at the film's beginning, but with all points that ever happen in it."""
        first = self.at(self.key(0), grid)
        data = (
            one.whole if one.facts and "trail_s" in one.facts else made for one, made in zip(self.data, first["data"])
        )
        return {**first, "data": tuple(data)}

    @property
    def facts(self) -> list[dict[str, Any]]:
        """Of each dataset that changes: ``name``; of a span ``from``, ``to``, ``times`` (how many are known) and
        ``between``, how values are found between them ("linear" or "nearest"; "events": points are seen for
        ``trail_s`` seconds after their time); of members in turn ``members``, and
        ``changes_per_second``."""
        return [dict(one.facts) for one in self.data if one.facts is not None]

    def tell(self, progress: Progress) -> None:
        """Note in words what is played."""
        for fact in self.facts:
            words = []
            if "from" in fact:
                some = f"its {fact['times']} times" if fact["times"] else "its samples"
                how = f"{fact['between']} between {some}"
                if "trail_s" in fact:
                    how = f"each point is seen for {lasting(fact['trail_s'])} after its time"
                words.append(f"{fact['from']} to {fact['to']}, {how}")
            if "members" in fact:
                words.append(f"{fact['members']} members in turn, {fact['changes_per_second']:.3g} a second")
                needed = fact["members"] / fact["changes_per_second"]
                if (self.last + 1) / self.fps < needed - 1e-6:
                    progress.warn(f"Not every member of {fact['name']} is seen: that takes {needed:.3g} s.")
            progress.note(f"{fact['name']}: {'; '.join(words)}")


def changes(one: Dataset) -> bool:
    """Whether data change during a film: over a span of times, or by members."""
    return _spans(one) or _in_turn(one)


def _spans(one: Dataset) -> bool:
    return one.time is not None and is_span(one.time)


def _in_turn(one: Dataset) -> bool:
    return one.uncertainty is not None and one.uncertainty.style == "members"


def _played(one: Dataset, grid: Grid, frames: int, fps: float) -> Played:
    if not changes(one):
        return Played(one)
    if not times_in(one) and not _in_turn(one):
        if (moving := span_of(one, grid)) is not None:
            return _track(one, moving)
        if (moving := events_span(one, grid)) is not None:
            return _events(one, moving)
    facts: dict[str, Any] = {}
    words: list[str] = []
    made = Played(one)
    if _spans(one):
        made = replace(made, span=_span(one))
    bare = made.bare((made.key(0, 1)[0], 0)).but(uncertainty=None)
    if _in_turn(one):
        made = _turning(made, bare, grid, fps)
        facts |= {"members": len(made.members), "changes_per_second": fps / made.hold}
        words.append(f"of {len(made.members)} in turn")
    else:
        made = replace(made, whole=one.but(uncertainty=doubt_of(one, made.bare(made.key(0, 1)), grid)))
    alone = "+" not in str(one.variable or one.band or "") and one.style not in ("curtains", "walls")
    field = read(bare, grid) if alone else None
    classes = field is not None and has_classes(one, field)
    facts["name"] = one.name or (field.name if field is not None else str(one.variable or one.band))
    if made.span is not None:
        first, last = (written(moment) for moment in made.span)
        known = [time for time in times_in(one) if first <= time <= last]
        facts |= _span_text(made.span, len(known), "nearest" if classes else "linear")
        words.append("nearest of its times" if classes else "linear between its times")
    if not classes:
        keys = {made.key(round(k), frames - 1) for k in np.linspace(0, frames - 1, LOOKED_AT)}
        made = replace(made, scale=OneScale.of(made.whole, [made.bare(key) for key in sorted(keys)], grid))
    return replace(made, facts=facts, words=", ".join(words) if alone else "")


def _turning(made: Played, bare: Dataset, grid: Grid, fps: float) -> Played:
    """Data whose members are shown in turn; ``bare``: those of the first moment.

    Raises:
        UsageError: there is one member, or a statistic of several is asked for.
    """
    one, doubt = made.whole, made.whole.uncertainty
    if one.derived:
        raise UsageError(
            "Members in turn are shown one by one, and value= or exceeds= is taken over several.",
            path=one.called, remedy="Leave it out, or choose another style of uncertainty.",
        )  # fmt: skip
    rate = doubt.rate if isinstance(doubt, Uncertainty) and doubt.rate is not None else RATE
    return replace(made, members=members_of(bare, grid), hold=max(1, math.ceil(fps / rate - 1e-9)))


def _track(one: Dataset, moving: tuple[float, float]) -> Played:
    """Tracks, with a scale from all their samples at any moment."""
    span = span_within([written(moment) for moment in moving], str(one.time))
    name = one.name or one.variable or "tracks"
    return Played(one, span, facts={"name": name, **_span_text(span, 0, "linear")})


def _events(one: Dataset, moving: tuple[float, float]) -> Played:
    """Point events: each is shown for a while after its time."""
    span = span_within([written(moment) for moment in moving], str(one.time))
    trail = trail_of(one, span)
    facts = {"name": one.name or one.variable or "points", **_span_text(span, 0, "events"), "trail_s": trail}
    return Played(one.but(trail=f"{trail:.10g}s"), span, facts=facts)


def _span_text(span: tuple[float, float], times: int, between: str) -> dict[str, Any]:
    return {"from": written(span[0]), "to": written(span[1]), "times": times, "between": between}


def _span(one: Dataset) -> tuple[float, float]:
    times = times_in(one)
    if len(times) < 2:
        raise UsageError("It has no series of times.", path=one.called, remedy="Leave out time=.")
    try:
        return span_within(times, str(one.time))
    except ReadError as error:
        raise UsageError(error.what, path=one.called, remedy=error.remedy) from None


def members_of(one: Dataset, grid: Grid) -> tuple[int, ...]:
    """The members, from 1, of a dataset of one moment: all if it names none.

    Raises:
        UsageError: there is one.
    """
    count = len(read(one.but(member="all"), grid).values)
    numbers = picked(range(1, count + 1), str(one.member or "all"), one.called)
    if len(numbers) < 2:
        raise UsageError(
            "Members in turn are of an ensemble, and it has one member.", path=one.called,
            remedy="Name data with several (band=all, member=all), or another style of uncertainty.",
        )  # fmt: skip
    return tuple(numbers)
