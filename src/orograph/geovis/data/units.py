"""Units in which standard deviations may be given: differences of 1.8 °F and 1 K are the same, and so are 1 °C."""

from __future__ import annotations

from orograph.geovis.keys import written_unit

KINDS: tuple[dict[str, float], ...] = (
    {"K": 1.0, "°C": 1.0, "°F": 5 / 9},
    {"m": 1.0, "km": 1000.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "feet": 0.3048},
    {"hPa": 1.0, "Pa": 0.01, "kPa": 10.0},
    {"m/s": 1.0, "km/h": 1 / 3.6, "kn": 1852 / 3600, "kt": 1852 / 3600, "knots": 1852 / 3600},
)
"""Units of one kind, each in the first of them."""


def ratio(unit: str, of: str) -> float | None:
    """What a difference of 1 in a unit is in another; 1 where either is not known, None: they measure other things."""
    one, other = ((written_unit(told), _kind(written_unit(told))) for told in (unit, of))
    if one[1] is None or other[1] is None:
        return 1.0
    return one[1][one[0]] / other[1][other[0]] if one[1] is other[1] else None


def _kind(unit: str) -> dict[str, float] | None:
    return next((units for units in KINDS if unit in units), None)
