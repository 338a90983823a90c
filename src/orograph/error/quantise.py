"""Errors and radii as one byte each, rounded up: bounds still hold after quantisation.

*Errors*: code 0 is 0, code 255 is +inf (mixed), codes 1 to 254 are ``lowest · step^(code − 1)``, equal ratios between a
millionth or so of the terrain's height range and the largest error possible. A monotonic map keeps errors monotonic.

*Radii*: seven bits say how much larger a sphere is than that of the same diamond on a plain, ``nominal · (1 + t)``: t
is next to 0, or ``first · step^(code − 1)``, so that the usual radii, little above nominal, are met closely; the eighth
bit says that the diamond is empty. Spheres must be nested after rounding as well, so that they are rounded octave by
octave, and parents are put around rounded children (``diamonds``).

Tables are made by multiplication and square roots in float64 alone, whose results IEEE 754 fixes: readers everywhere
decode the same float32 numbers. Only NumPy is needed to decode; ``encode`` has the way back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Codes = NDArray[np.uint8]

EMPTY = 0x80
"""The bit of a radius code that marks an empty diamond."""
DEPTH = 2.0**-18
"""The lowest code but 0 for errors, as a part of the terrain's height range."""
FIRST = 2.0**-9
"""How much larger than nominal a radius of code 1 is."""


def _ratio(low: float, high: float, steps: int) -> float:
    """The factor that leads from ``low`` to no less than ``high`` in so many multiplications."""
    ratio = math.exp(math.log(high / low) / steps)
    while _powers(low, ratio, steps + 1)[-1] < high:
        ratio = math.nextafter(ratio, math.inf)
    return ratio


def _powers(low: float, ratio: float, count: int) -> NDArray[np.float64]:
    """low, low·ratio, low·ratio·ratio…"""
    powers: NDArray[np.float64] = np.multiply.accumulate(np.array([low] + [ratio] * (count - 1), np.float64))
    return powers


def _up(values: NDArray[np.float64]) -> Floats:
    """float32, not less."""
    near = values.astype(np.float32)
    return np.where(near < values, np.nextafter(near, np.float32(np.inf)), near)


@dataclass(frozen=True)
class ErrorCode:
    """The coding of errors.

    Attributes:
        lowest: metres, code 1.
        step: ratio of neighbouring codes; a decoded error is less than ``step`` times the true one, or ``lowest``.
    """

    lowest: float
    step: float

    @classmethod
    def of(cls, height_range: float, kind: str, n: int) -> ErrorCode:
        """The code for a terrain.

        Args:
            height_range: highest less lowest sample, metres (0 or NaN: it is flat, or empty).
            kind: of error. No deviation exceeds the height range, no sum 2n of them.
            n: exponent of the enclosing square.
        """
        if not height_range > 0:
            return cls(1.0, 1.0)
        largest = height_range * (1 + 1e-5) * (2 * max(n, 1) if kind == "wedgie" else 1)
        lowest = height_range * DEPTH
        return cls(lowest, _ratio(lowest, largest, 253))

    @cached_property
    def table(self) -> Floats:
        """The 256 decoded values, in order."""
        return np.array([0, *_up(_powers(self.lowest, self.step, 254)), np.inf], np.float32)

    def decode(self, codes: Codes) -> Floats:
        """Errors in metres."""
        return self.table[codes]

    def to_json(self) -> dict[str, Any]:
        return {"lowest": self.lowest, "step": self.step}


@dataclass(frozen=True)
class RadiusCode:
    """The coding of radii.

    Attributes:
        nominal: for each octave the radii of edge diamonds and of square ones on a plain, metres.
        step: ratio of neighbouring codes' t.
    """

    nominal: tuple[tuple[float, float], ...]
    step: float

    @classmethod
    def of(cls, height_range: float, metric: NDArray[np.float64], n: int) -> RadiusCode:
        """The code for a terrain.

        Args:
            height_range: as for ``ErrorCode``.
            metric: (2, 2), metres of easting and northing per column and row.
        """
        nominal = nominal_radii(metric, n)
        # A sphere exceeds that of its children by their distance: by at most the height range more than on a plain.
        # Nominal radii double every second time, so that all that was rounded up before adds less than is allowed here.
        largest = 4 * height_range / nominal[0][0] if n and height_range > 0 else 0.0
        return cls(nominal, _ratio(FIRST, max(largest, 2 * FIRST), 126))

    @cached_property
    def tables(self) -> Floats:
        """Decoded radii (octaves, 2, 128): of edge diamonds and of square ones."""
        growth = np.array([2.0**-16, *_powers(FIRST, self.step, 127)])
        return _up(np.array(self.nominal).reshape(-1, 2, 1) * (1 + growth))

    def decode(self, codes: Codes, row: int, col: int, octave: int) -> Floats:
        """Radii in metres, negative where empty, of a window of an octave's diamonds.

        Args:
            codes: (height, width).
            row, col: the window's first entry in the octave. Entries that are no diamonds of it become 0.
        """
        edges, squares = (np.concatenate([table, -table]) for table in self.tables[octave])
        radii = np.zeros(codes.shape, np.float32)
        i, j = 1 - row % 2, 1 - col % 2  # the first odd entries
        radii[i::2, j::2] = squares[codes[i::2, j::2]]
        radii[i::2, 1 - j :: 2] = edges[codes[i::2, 1 - j :: 2]]
        radii[1 - i :: 2, j::2] = edges[codes[1 - i :: 2, j::2]]
        return radii

    def to_json(self) -> dict[str, Any]:
        return {"step": self.step}


def nominal_radii(metric: NDArray[np.float64], n: int) -> tuple[tuple[float, float], ...]:
    """The nested spheres' radii on a plain, of the edge and the square diamonds of the octaves 0 to n − 1."""
    (a, b), (d, e) = ([float(v) for v in row] for row in metric)
    side = math.sqrt(max(a * a + d * d, b * b + e * e))
    diagonal = math.sqrt(max((a + b) * (a + b) + (d + e) * (d + e), (a - b) * (a - b) + (d - e) * (d - e)))
    radii: list[tuple[float, float]] = []
    for k in range(n):
        s = float(1 << k)
        edge = max(s * side, s / 2 * diagonal + radii[-1][1]) if radii else side
        radii.append((edge, max(s * diagonal, s * side + edge)))
    return tuple(radii)
