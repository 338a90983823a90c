"""A place that is typed: degrees with their hemispheres, as the read-out has them, or easting and northing."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from orograph.errors import UsageError
from orograph.measuring import Places

if TYPE_CHECKING:
    from orograph.store.terrain import Terrain

NUMBER = r"([-+]?\d+(?:\.\d*)?)"
DEGREES = re.compile(rf"{NUMBER}\s*°?\s*([NSEW])\s*,?\s*{NUMBER}\s*°?\s*([NSEW])", re.IGNORECASE)
PLAIN = re.compile(rf"E?\s*{NUMBER}\s*[,\s]\s*N?\s*{NUMBER}", re.IGNORECASE)
SPACED = re.compile(r"(?<=\d)[ \u2009\u202f](?=\d{3}(?:\D|$))")
"""Spaces between thousands."""


def place_of(text: str, terrain: Terrain) -> tuple[float, float]:
    """A place (easting, northing) in the terrain's CRS, of "53.35 N 6.26 W" or "277836.6 5939482".

    Raises:
        UsageError: it is not written so, or does not lie on the terrain.
    """
    places, said = Places(terrain), text.strip().replace("\u2212", "-")
    found = DEGREES.fullmatch(said)
    if found is not None:
        at: dict[str, float] = {}
        for number, side in ((found[1], found[2].upper()), (found[3], found[4].upper())):
            at["lat" if side in "NS" else "lon"] = float(number) * (-1.0 if side in "SW" else 1.0)
        if len(at) == 2:
            (point,) = places.points([(at["lon"], at["lat"])], what="The place", lonlat=True)
            return float(point[0]), float(point[1])
    plain = PLAIN.fullmatch(SPACED.sub("", said) if "N" in said.upper() else said)
    if plain is None:
        raise UsageError(
            f"There is no place {text!r}.", remedy="Type it as 53.35 N 6.26 W, or as easting and northing."
        )
    (point,) = places.points(np.array([[float(plain[1]), float(plain[2])]]), what="The place")
    return float(point[0]), float(point[1])
