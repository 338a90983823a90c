"""Units that formats fix, and those of standard deviations, of which only differences count: 1 K is 1 °C or 1.8 °F."""

from __future__ import annotations

from orograph.geovis.keys import written_unit

KINDS: tuple[dict[str, float], ...] = (
    {"K": 1.0, "°C": 1.0, "°F": 5 / 9},
    {"m": 1.0, "km": 1000.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "feet": 0.3048},
    {"hPa": 1.0, "Pa": 0.01, "kPa": 10.0},
    {"m/s": 1.0, "km/h": 1 / 3.6, "kn": 1852 / 3600, "kt": 1852 / 3600, "knots": 1852 / 3600},
)
"""Units that measure the same thing, and how many of the first of them each is."""

FIXED: dict[str, tuple[str, frozenset[str]]] = {
    "BAG": ("m", frozenset(("elevation", "uncertainty", "nominal_elevation"))),
}
"""By GDAL's name of a format: the unit that its standard fixes, and for which bands. (Bathymetric Attributed Grid: Open
Navigation Surface Working Group, *Format Specification Document*: metres.)"""


def fixed_unit(driver: str, band: str | None) -> str:
    """The unit that a format's standard fixes for a band of this description; "": none."""
    unit, bands = FIXED.get(driver, ("", frozenset()))
    return unit if (band or "").strip().lower() in bands else ""


def ratio(unit: str, of: str) -> float | None:
    """A difference of one ``unit`` in the unit ``of``; 1 if either is unknown, None if they differ in kind."""
    unit, of = written_unit(unit), written_unit(of)
    kinds = [units for units in KINDS if unit in units or of in units]
    if any(unit in units and of in units for units in kinds):
        return kinds[0][unit] / kinds[0][of]
    return 1.0 if len(kinds) < 2 else None
