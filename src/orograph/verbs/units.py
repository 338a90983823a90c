"""The units of two DEMs that are compared: what the user says of each, and heights that look like another unit's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from orograph.errors import UsageError
from orograph.progress import Progress
from orograph.several import words

UNITS = {"ft": (3.28084, "feet"), "cm": (100.0, "centimetres"), "mm": (1000.0, "millimetres")}
"""By which factor heights in other units exceed those in metres, and what the units are called."""
CLOSE = 0.02
"""Tolerance of such a factor."""


def of_each(reading: Mapping[str, Any]) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """The options of reading for both; ``vertical_unit`` may name two units: ("ft", "m") or "ft,m".

    Raises:
        UsageError: it names more than two.
    """
    given = reading.get("vertical_unit")
    units = words(given) if given is not None else ()
    if len(units) < 2:
        return reading, reading
    if len(units) > 2:
        raise UsageError(f"`vertical_unit` must be one unit, or two: of the first and of the second, not {given!r}.")
    first, second = ({**reading, "vertical_unit": unit} for unit in units)
    return first, second


def warn_of_units(ratio: float, first: str, second: str, progress: Progress) -> None:
    """Warn if the heights of one seem to be in another unit.

    Args:
        ratio: how many times the heights of the first exceed those of the second.
    """
    for unit, (factor, called) in UNITS.items():
        for found, name, said in (
            (ratio, first, f"{unit},m"), (1 / ratio if ratio else 0.0, second, f"m,{unit}")
        ):  # fmt: skip
            if abs(found - factor) < CLOSE * factor:
                progress.warn(
                    f"The heights of {name} are {found:.3g} times those of the other: they may be in {called} (say so "
                    f"with `vertical_unit={said!r}`)."
                )
