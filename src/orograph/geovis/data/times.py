"""Times: of a raster's bands, how they are asked for (ISO 8601 in UTC, to the minute), moments of tracks,
trails, and ticks."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError

_SECONDS = {"second": 1, "sec": 1, "s": 1, "minute": 60, "min": 60, "hour": 3600, "hr": 3600, "h": 3600, "day": 86400,
            "d": 86400}  # fmt: skip
"""Seconds of CF's units of time."""

_FARTHEST = 1e14
"""Seconds from the start beyond which a time is none: three million years."""

CALENDARS = ("standard", "gregorian", "proleptic_gregorian", "noleap", "365_day")
"""CF's calendars whose days all are days of ours."""

_START = re.compile(
    r"(?i)(-?\d{1,4})-(\d{1,2})-(\d{1,2})(?:[T ]+(\d{1,2}):(\d{1,2})(?::(\d{1,2}(?:\.\d*)?))?)?"
    r"\s*(?:Z|UTC|GMT|[+-]0?0(?::?00)?)?"
)
_MONTHS = np.cumsum([0, 31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30])
"""Days before each month of a year that has no 29 February."""


def matches(time: str, asked: str) -> bool:
    """Whether a time, ISO 8601 in UTC, is asked for: by its beginning, by its hour (``T12``), or by a span."""
    if is_span(asked):
        first, last = _ends(asked)
        return bool(time) and first <= time and (not last or time <= last or time.startswith(last))
    return asked in time if asked.startswith("T") else time.startswith(asked.replace(" ", "T"))


def is_span(asked: str) -> bool:
    """Whether two times are asked for, and what lies between them: ``A..B``, ``A..``, ``..B``, ``..``."""
    return ".." in asked


def span_within(times: Sequence[str], asked: str) -> tuple[float, float]:
    """The moments, seconds since 1970, at the ends of a span: of A the first time that begins so, of B the last one,
    or the moments A and B themselves between times; an open end is that of the times.

    Args:
        times: those known, ISO 8601, in order.

    Raises:
        ReadError: an end is no moment, or lies outside of the times, or the first is not before the last, or there is
            only one time.
    """
    first, last = _ends(asked)
    begins = next((time for time in times if time.startswith(first)), first)
    ends = next((time for time in reversed(times) if time.startswith(last)), last)
    low, high = (float(value) for value in seconds_of([begins, ends], "", "span of times"))
    known = seconds_of([times[0], times[-1]], "", "")
    if known[0] == known[1]:
        raise ReadError(
            f"time={asked} asks for a span, but all of it is at one time, {times[0]}.",
            remedy="Omit time= to show everything.",
        )
    if not known[0] <= low < high <= known[1]:
        raise ReadError(
            f"time={asked} is no span within its times, which go from {times[0]} to {times[-1]}.",
            remedy="Give the earlier one first: time=A..B, or time=.. for all.",
        )
    return low, high


def _ends(asked: str) -> tuple[str, str]:
    first, _, last = asked.partition("..")
    return first.strip().replace(" ", "T"), last.strip().replace(" ", "T")


def times_of(file: Any) -> list[str]:
    """The times of a dataset's bands, ISO 8601 in UTC, to the minute; "" where one says none."""
    tags = file.tags()
    scale = re.fullmatch(r"(\w+?)s? since (.+)", tags.get("time#units", "").strip())
    calendar = tags.get("time#calendar", "standard").lower()
    found = []
    for band in range(1, file.count + 1):
        tags = file.tags(band)
        second = tags.get("GRIB_VALID_TIME", "").split()
        if second:
            moment: Any = np.datetime64(int(second[0]), "s")
        elif scale and "NETCDF_DIM_time" in tags and (unit := scale[1].lower()) in _SECONDS:
            moment = counted(scale[2].strip(), float(tags["NETCDF_DIM_time"]) * _SECONDS[unit], calendar)
            if moment is None:
                found.append("")
                continue
        else:
            found.append("")
            continue
        found.append(str(moment.astype("datetime64[m]")))
    return found


def counted(start: str, seconds: float, calendar: str) -> np.datetime64 | None:
    """The moment so many seconds after the start of CF's units; None: the units are not understood, or it is none."""
    told = _START.fullmatch(start)
    if told is None or calendar not in CALENDARS or not math.fabs(seconds) < _FARTHEST:
        return None
    year, month, day = (int(part) for part in told.group(1, 2, 3))
    seconds += sum(float(part or 0) * unit for part, unit in zip(told.group(4, 5, 6), (3600, 60, 1)))
    if calendar in ("noleap", "365_day"):
        days, seconds = divmod(round(seconds), 86400)
        years, days = divmod(year * 365 + int(_MONTHS[month - 1]) + day - 1 + int(days), 365)
        month = int(np.searchsorted(_MONTHS, days, "right"))
        text = f"{years:04d}-{month:02d}-{days - int(_MONTHS[month - 1]) + 1:02d}"
        return np.datetime64(text, "s") + np.timedelta64(round(seconds), "s")
    first = np.datetime64(f"{year:04d}-{month:02d}-{day:02d}", "s")
    if calendar != "proleptic_gregorian" and (year, month, day) < (1582, 10, 15):  # (days of the Julian calendar)
        y, m = year + 4800 - (month < 3), (month - 3) % 12
        number = 365 * y + y // 4 + (153 * m + 2) // 5 + day - 32083
        first = np.datetime64("1970-01-01", "s") + np.timedelta64(number - 2440588, "D")
    return first + np.timedelta64(round(seconds), "s")


def array_times(array: Any) -> list[str]:
    """The times of a DataArray, one for each along its dimension, ISO 8601 to the minute, "" where one is missing; none
    of a calendar whose days are not ours."""
    if "time" not in array.coords:
        return []
    values = np.atleast_1d(array.coords["time"].values)
    if values.dtype.kind != "O":  # (numbers are times that nobody has decoded)
        if values.dtype.kind != "M":
            return []
        return ["" if np.isnat(one) else str(one) for one in values.astype("datetime64[m]")]
    if not all(getattr(one, "calendar", "") in CALENDARS for one in values):
        return []
    return [f"{one.year:04d}-{one.month:02d}-{one.day:02d}T{one.hour:02d}:{one.minute:02d}" for one in values]


def neighbours(times: Sequence[str], asked: str) -> tuple[str, str, float] | None:
    """The times (ISO 8601, in order) before and after a moment between two of them, and how far it is from the one to
    the other, 0 to 1; None where one of them is meant, or it lies outside, or is not a time.
    """
    if len(times) < 2 or asked.startswith("T") or is_span(asked) or any(matches(time, asked) for time in times):
        return None
    try:
        second = seconds_of([asked], "", "")[0]
    except ReadError:
        return None
    known = seconds_of(times, "", "")
    if not known[0] < second < known[-1]:
        return None
    k = int(np.searchsorted(known, second)) - 1
    return times[k], times[k + 1], float((second - known[k]) / (known[k + 1] - known[k]))


def written(second: float) -> str:
    """A moment, ISO 8601 in UTC, to the minute, or to the second where it is none."""
    moment = datetime.fromtimestamp(round(second), UTC)
    return f"{moment:%Y-%m-%dT%H:%M}" + (f"{moment::%S}" if moment.second else "")


LONG_AGO = 1e11
"""Numbers of times above this are milliseconds since 1970, else seconds."""


def seconds_of(told: Iterable[Any], name: str, attribute: str) -> NDArray[np.float64]:
    """Moments as seconds since 1970 in UTC, NaN where none is told: ISO 8601 (without a zone in UTC), or numbers of
    seconds or milliseconds since 1970.

    Raises:
        ReadError: something is not a time.
    """
    found = []
    for value in told:
        text = str(value).strip()
        if value is None or text in ("", "nan", "NaT", "None"):
            found.append(np.nan)
            continue
        try:
            number = float(text)
            found.append(number / 1000 if abs(number) > LONG_AGO else number)
        except ValueError:
            found.append(_moment(text, name, attribute))
    return np.array(found, np.float64)


def _moment(text: str, name: str, attribute: str) -> float:
    for form in (text, text[:26]):  # (xarray and pandas write nanoseconds, which Python does not read)
        try:
            moment = datetime.fromisoformat(form)
        except ValueError:
            continue
        return (moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)).timestamp()
    raise ReadError(
        f"{text!r} in its {attribute} is not a time.", path=name,
        remedy="Write them as 2019-03-01T12:00:00Z, or as seconds since 1970.",
    )  # fmt: skip


UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86_400.0}
"""Seconds of units of a trail."""


def seconds_of_trail(text: str) -> float:
    """The seconds of a trail: a number with a unit, "6h".

    Raises:
        UsageError: it is none.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*(\w+)\s*", text)
    if found is None or found[2] not in UNITS or float(found[1]) <= 0:
        raise UsageError(
            f"A trail is a time, such as 6h or 2d, not {text!r}.", remedy=f"The units are {', '.join(UNITS)}."
        )
    return float(found[1]) * UNITS[found[2]]


def lasting(seconds: float) -> str:
    """A duration, in the largest unit that gives at least two."""
    unit = next((one for one in reversed(UNITS) if seconds >= 2 * UNITS[one]), "s")
    return f"{seconds / UNITS[unit]:.3g} {unit}"


STEPS = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10_800, 21_600, 43_200, 86_400, 172_800,
         432_000, 864_000, 1_728_000, 4_320_000, 8_640_000, 31_557_600)  # fmt: skip
"""Seconds from tick to tick of a time axis."""


def ticks(first: float, last: float, most: int = 8) -> tuple[NDArray[np.float64], list[str]]:
    """Round moments within a time, at most so many, and how they are written."""
    step = next((one for one in STEPS if (last - first) / one < most), (last - first) / (most - 1))
    at = np.arange(np.ceil(first / step), np.floor(last / step) + 1) * step
    words, day = [], ""
    for second in at:
        moment = datetime.fromtimestamp(second, UTC)
        date, clock = f"{moment.day} {moment:%b}" if step < 31_557_600 else f"{moment:%Y}", f"{moment:%H:%M}"
        clock += f":{moment:%S}" if step < 60 else ""
        words.append(date if step >= 86_400 else f"{date} {clock}" if date != day else clock)
        day = date
    return at, words
