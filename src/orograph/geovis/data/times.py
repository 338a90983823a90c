"""Times of a series: of a raster's bands, and how they are asked for. ISO 8601 in UTC, to the minute."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

_SECONDS = {"second": 1, "sec": 1, "minute": 60, "min": 60, "hour": 3600, "hr": 3600, "day": 86400}
"""Seconds of CF's units of time."""


def matches(time: str, asked: str) -> bool:
    """Whether a time, ISO 8601 in UTC, is the one asked for: by its beginning, or (``T12``) by its hour."""
    return asked in time if asked.startswith("T") else time.startswith(asked.replace(" ", "T"))


def times_of(file: Any) -> list[str]:
    """The times of a dataset's bands, ISO 8601 in UTC, to the minute; "" where one says none."""
    scale = re.fullmatch(r"(\w+?)s? since (.+)", file.tags().get("time#units", "").strip())
    found = []
    for band in range(1, file.count + 1):
        tags = file.tags(band)
        second = tags.get("GRIB_VALID_TIME", "").split()
        if second:
            moment: Any = np.datetime64(int(second[0]), "s")
        elif scale and "NETCDF_DIM_time" in tags and scale[1] in _SECONDS:
            start = np.datetime64(scale[2].strip().replace(" ", "T").rstrip("Z"), "s")
            moment = start + np.timedelta64(round(float(tags["NETCDF_DIM_time"]) * _SECONDS[scale[1]]), "s")
        else:
            found.append("")
            continue
        found.append(str(moment.astype("datetime64[m]")))
    return found
