"""Data at the places that were picked: values with their uncertainty, and by how much two places differ.

The members of an ensemble (or the times of a series) are compared one by one, because what makes one place warmer often
makes the other warmer, too: the difference is as uncertain as the members' differences vary. Errors that are given as
standard deviations count as independent.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from orograph.geovis.data.sampling import values_at
from orograph.viewer.data import Found, ShownData

if TYPE_CHECKING:
    from collections.abc import Sequence

    from orograph.geo.grid import Grid
    from orograph.geovis.data.painting import Shown
    from orograph.viewpoint import Point


class Difference(NamedTuple):
    """How the second of two places differs from the first.

    Attributes:
        name, unit: of the data. value: second less first. sigma: its uncertainty, as that of the data is measured;
            None: unknown. agreeing, members: how many members differ in the same direction, of how many; 0: no members.
    """

    name: str
    unit: str
    value: float
    sigma: float | None = None
    agreeing: int = 0
    members: int = 0

    @property
    def words(self) -> list[str]:
        """One line, and a second one if the uncertainty is known."""
        said = Found("", abs(self.value), self.sigma, self.unit).words.strip()
        first = f"{said} {'higher' if self.value > 0 else 'lower'} here" if self.value else f"none ({said})"
        if self.sigma is None:
            return [first]
        than = "more" if abs(self.value) > self.sigma else "less"
        counted = f", so in {self.agreeing} of {self.members}" if self.members and self.value else ""
        return [first, f"{than} than its uncertainty{counted}"]


def rows(shown: ShownData | None, grid: Grid, points: Sequence[Point]) -> list[tuple[str, str]]:
    """(name, text) of the data at the last point, and if there are two how it differs from the first.

    Args:
        grid: the terrain's. points: one or two, in its CRS.
    """
    if shown is None or not points:
        return []
    at = [shown.at(*point[:2]) for point in points[-2:]]
    said = []
    for one in at[-1]:
        said.append((one.name, one.value_words))
        other = next((before for before in at[0] if before.name == one.name), None)
        if len(points) < 2 or other is None:
            continue
        said.append(("at the first place", other.value_words))
        differs = difference(shown, grid, points, other, one)
        said += zip(("difference", ""), [] if differs is None else differs.words)
    return said


def difference(shown: ShownData, grid: Grid, points: Sequence[Point], first: Found, second: Found) -> Difference | None:
    """How data differ between two points where they have these values; None: names have no difference."""
    if isinstance(first.value, str) or isinstance(second.value, str):
        return None
    painted = next((one for one in reversed(shown.painted) if one.title == second.name), None)
    paired = None if painted is None else _paired(painted, grid, points)
    if paired is not None:
        return paired
    sigma = None
    if first.sigma is not None and second.sigma is not None:
        sigma = math.hypot(first.sigma, second.sigma)
    return Difference(second.name, second.unit, second.value - first.value, sigma)


def _paired(one: Shown, grid: Grid, points: Sequence[Point]) -> Difference | None:
    """The difference member by member; None without members."""
    doubt, field = one.dataset.uncertainty, one.field
    if doubt is None or not doubt.of_members or len(field.values) < 2 or field.statistic != "mean":
        return None
    x, y = np.array([point[:2] for point in points], np.float64).T
    at = np.array([values_at(member, field, grid, x, y) for member in field.values])
    apart = at[:, 1] - at[:, 0]
    apart = apart[np.isfinite(apart)]
    if len(apart) < 2:
        return None
    value = float(apart.mean())
    sigma = replace(field, values=apart[:, None, None].astype(np.float32)).uncertainty(str(doubt.source))
    agreeing = int((np.sign(apart) == np.sign(value)).sum())
    return Difference(one.title, one.unit, value, float(sigma[0, 0]), agreeing, len(apart))
