"""Which bands, times, members and levels of a source a user means."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from orograph.errors import UsageError
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.times import CALENDARS, is_span, matches, times_of
from orograph.geovis.data.vertical import levels_of
from orograph.geovis.keys import written_unit


def chosen_bands(file: Any, given: Dataset | Uncertainty) -> tuple[list[int], str]:
    """Bands that are meant, from 1, and in words which of several they are.

    Raises:
        UsageError: there are none such.
    """
    bands = list(range(1, file.count + 1))
    words: list[str] = []
    if given.time is not None:
        times = times_of(file)
        if not any(times):
            calendar = file.tags().get("time#calendar", "standard")
            what = "no times" if calendar in CALENDARS else f"times in the calendar {calendar}, whose days are not ours"
            raise UsageError(f"Its bands have {what}.", path=str(given.source), remedy="Choose by band=.")
        bands = [band for band in bands if matches(times[band - 1], given.time)]
        if not bands:
            raise no_time(given.time, times, str(given.source))
        words.append(time_words(given.time, [times[band - 1] for band in bands]))
    if given.level is not None:
        own = levels_of(file, getattr(given, "vertical", None))
        bands = [band for band in bands if own is not None and is_level(own.values[band - 1], given.level)]
        if not bands:
            values = [] if own is None else np.unique(own.values[np.isfinite(own.values)]).tolist()
            known = ", ".join(f"{value:g}" for value in values) or "none"
            raise UsageError(f"It has no level {given.level}; its levels are: {known}.", path=str(given.source))
        words.append(f"at {float(given.level):g} {written_unit(own.axis.unit) if own is not None else ''}".rstrip())
    for what, asked in (("band", given.band), ("member", given.member)):
        if asked is not None:
            bands = picked(bands, str(asked), str(given.source), what)
    wanted = wants_members(given)
    if given.time is None and given.band is None and given.member is None and not wanted:
        bands = bands[:1]
    if len(bands) > 1:
        words.insert(0, f"mean of {len(bands)}")
    elif given.member is not None:
        words.insert(0, f"member {given.member}")
    elif file.count > 1 and not words:
        words.append(file.descriptions[bands[0] - 1] or f"band {bands[0]}")
    return bands, " ".join(words)


def no_time(asked: str, times: Sequence[str], path: str | None = None) -> UsageError:
    """That none of the times, "" where one is missing, is the one that is asked for."""
    how = (
        "an earlier and a later time: A..B"
        if is_span(asked)
        else "the beginning of a time, or an hour of all days: T12"
    )
    return UsageError(
        f"It has no time {asked}; its times go from {min(filter(None, times), default='none')} to {max(times)}.",
        path=path, remedy=f"Give {how}.",
    )  # fmt: skip


def time_words(asked: str, times: Sequence[str]) -> str:
    """Times that were asked for, in words; ``times``: those found, in order."""
    if asked.startswith("T"):
        return f"at {asked[1:]} h"
    first, last = (time.replace("T", " ") for time in (times[0], times[-1]))
    if first != last:
        return f"from {first} to {last}"
    return first if len(times) == 1 else f"at {first}"


def is_level(value: float, asked: str | float) -> bool:
    """Whether a level is the one asked for.

    Raises:
        UsageError: what is asked for is no number.
    """
    try:
        return math.isclose(value, float(asked), rel_tol=1e-5)
    except ValueError:
        raise UsageError(f"A level must be a number, not {asked!r}.") from None


def wants_members(given: Dataset | Uncertainty) -> bool:
    """Whether all members are meant where none are named."""
    if not isinstance(given, Dataset):
        return False
    doubt = given.uncertainty
    by_sigma = given.exceeds is not None and doubt is not None and not doubt.of_members
    return (given.derived and not by_sigma) or (doubt is not None and doubt.of_members)


def picked(bands: Sequence[int], asked: str, name: str, what: str = "band") -> list[int]:
    """Of the bands at hand those at positions ``3``, ``1-13`` or ``all``, from 1; ``what`` one is called."""
    if asked.lower() == "all":
        return list(bands)
    found = re.fullmatch(r"(\d+)(?:-(\d+))?", asked.strip())
    if found is None:
        raise UsageError(f"{what.capitalize()}s must be like 3, 1-13 or all, not {asked!r}.", path=name)
    first, last = int(found[1]), int(found[2] or found[1])
    if not 1 <= first <= last <= len(bands):
        known = f"{what.capitalize()}s are numbered from 1 to {len(bands)} here"
        known = known if len(bands) > 1 else f"It has only one {what}"
        raise UsageError(f"{known}; there is no {asked}.", path=name)
    return list(bands[first - 1 : last])
