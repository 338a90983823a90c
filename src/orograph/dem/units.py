"""Names of units of height, and their length in metres.

Band unit tags are free text (GDAL's ``GetUnitType``, netCDF's ``units``), so the usual spellings are listed. The two
feet differ by 2 parts in a million: 0.3048 m (international) and 1200/3937 m (US survey), as in EPSG units 9002 and
9003.
"""

from __future__ import annotations

US_SURVEY_FOOT = 1200 / 3937

_SPELLINGS: dict[float, tuple[str, ...]] = {
    1.0: ("m", "metre", "metres", "meter", "meters", "mtr", "metre(s)", "m a.s.l.", "masl", "gpm"),
    0.3048: (
        "ft",
        "foot",
        "feet",
        "international foot",
        "international feet",
        "foot (international)",
        "ift",
        "ft_intl",
    ),
    US_SURVEY_FOOT: (
        "us survey foot",
        "us survey feet",
        "us_survey_foot",
        "u.s. survey foot",
        "us foot",
        "us-ft",
        "us ft",
        "ftus",
        "ft_us",
        "foot_us",
        "sft",
        "survey foot",
        "foot (us survey)",
    ),
    0.01: ("cm", "centimetre", "centimetres", "centimeter", "centimeters"),
    0.1: ("dm", "decimetre", "decimetres", "decimeter", "decimeters"),
    0.001: ("mm", "millimetre", "millimetres", "millimeter", "millimeters"),
    1000.0: ("km", "kilometre", "kilometres", "kilometer", "kilometers"),
    0.0254: ("in", "inch", "inches"),
    0.9144: ("yd", "yard", "yards"),
    1.8288: ("fathom", "fathoms"),
}

METRES: dict[str, float] = {name: factor for factor, names in _SPELLINGS.items() for name in names}


def metres_per(unit: str) -> float | None:
    """Metres in one ``unit``, or None if that is not a name of a length (case and blanks do not matter)."""
    return METRES.get(" ".join(unit.replace("_", " ").split()).lower()) or METRES.get(unit.strip().lower())
