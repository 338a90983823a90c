"""Directions on the ground in users' forms: degrees clockwise from north, or points of the compass.

Loads quickly, for the command line.
"""

from __future__ import annotations

from orograph.errors import UsageError

POINTS = ("N", "NNE", "NE", "ENE", "E", "ESE", "SE", "SSE", "S", "SSW", "SW", "WSW", "W", "WNW", "NW", "NNW")
WORDS = {"north": "N", "northeast": "NE", "east": "E", "southeast": "SE", "south": "S", "southwest": "SW", "west": "W",
         "northwest": "NW"}  # fmt: skip

Bearing = float | str
"""Degrees clockwise from north, or a point of the compass: "NE", "north-east"."""


def bearing(given: Bearing) -> float:
    """Degrees clockwise from north.

    Raises:
        UsageError: it is neither a number nor one of the 16 points of the compass.
    """
    if not isinstance(given, str):
        return float(given)
    word = given.strip()
    point = WORDS.get(word.lower().replace("-", "").replace(" ", ""), word.upper())
    if point in POINTS:
        return POINTS.index(point) * 22.5
    try:
        return float(word)
    except ValueError:
        raise UsageError(
            f"{given!r} is not a direction.",
            remedy="Give degrees clockwise from north, or a point of the compass such as N, NE or SSW.",
        ) from None
