"""Sizes of pictures as users give them: pixels, or centimetres, millimetres or inches of paper. Loads quickly."""

from __future__ import annotations

import re
from numbers import Integral
from typing import Any

from orograph.errors import UsageError

Size = tuple[int, int] | int | str
"""A picture's size: (width, height) in pixels, or a text such as "1280x720", or "20x15cm@300" on paper. A width alone
(2400, "30cm") has a height of 9/16 of it."""

SHAPE = 9 / 16
"""Height over width where only the width is given."""

DPI = 300.0
"""Default dots per inch of a size on paper."""

INCHES = {"cm": 1 / 2.54, "mm": 1 / 25.4, "in": 1.0}

SPELT = re.compile(r"(\d+(?:\.\d+)?)\s*(?:[x×]\s*(\d+(?:\.\d+)?))?\s*(cm|mm|in)?\s*(?:@\s*(\d+(?:\.\d+)?))?")


class Pixels(tuple[int, int]):
    """A size in pixels, (width, height), to be printed at ``dpi`` dots per inch; None: unspecified."""

    dpi: float | None = None

    @classmethod
    def of(cls, width: float, height: float, unit: str | None, dpi: float | None) -> Pixels:
        """From pixels (None), "cm", "mm" or "in"; rounded to whole pixels."""
        dpi = DPI if unit is not None and dpi is None else dpi
        scale = 1.0 if unit is None or dpi is None else dpi * INCHES[unit]
        made = cls((round(width * scale), round(height * scale)))
        made.dpi = dpi
        return made


def dpi_of(size: tuple[int, int] | None) -> float | None:
    """The resolution given with a size."""
    return size.dpi if isinstance(size, Pixels) else None


def read_size(text: str) -> Pixels:
    """Parse a size.

    Raises:
        ValueError: it is not a size, or less than a pixel.
    """
    found = SPELT.fullmatch(text.strip().lower())
    if found is None or (found[3] is None and "." in found[1] + (found[2] or "")):
        raise ValueError(f"{text!r} is not a size such as 1280x720 (pixels), 2400 or 20x15cm@300 (cm, mm or in).")
    dpi = None if found[4] is None else float(found[4])
    width = float(found[1])
    size = Pixels.of(width, width * SHAPE if found[2] is None else float(found[2]), found[3], dpi)
    if min(size) < 1:
        raise ValueError(f"{text!r} is less than a pixel.")
    return size


def size_of(size: Any) -> tuple[int, int]:
    """(width, height) in pixels of what a user gave (``Size``).

    Raises:
        UsageError: it is not a size.
    """
    if isinstance(size, str):
        try:
            return read_size(size)
        except ValueError as error:
            raise UsageError(str(error)) from None
    if isinstance(size, Integral):
        size = (size, max(1, round(int(size) * SHAPE)))
    whole_numbers = isinstance(size, tuple | list) and all(isinstance(n, Integral) and int(n) > 0 for n in size)
    if not whole_numbers or len(size) != 2:
        raise UsageError(f"A size must be (width, height) in pixels, such as (1280, 720), or '1280x720', not {size!r}.")
    return size if isinstance(size, Pixels) else (int(size[0]), int(size[1]))
