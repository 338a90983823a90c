"""Members of an ensemble in turn in the window: what all agree on stays, what is uncertain moves.

A member stays for at least a third of a second, however fast frames are (``dataset.FASTEST``), and longer where frames
take longer. Colours keep one scale, over all members.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.series import OneScale
from orograph.geovis.data.standing import stands
from orograph.touring.playing import RATE, members_of

LOOKED_AT = 12
"""Members, evenly from all, whose values make the scale."""


class Turns:
    """The members of one of a window's data.

    Args:
        of_data: its number among the data. rate: changes a second. on: whether they take turns.

    Attributes:
        member: the one that is shown, from 1; members: all of those that are shown in turn, none until they are known.
    """

    def __init__(self, of_data: int, rate: float, on: bool) -> None:
        self.of_data, self.rate, self.on = of_data, rate, on
        self.members: tuple[int, ...] = ()
        self._at, self._seconds = 0, 0.0
        self._of: tuple[Dataset, tuple[int, ...], OneScale | None] | None = None

    @classmethod
    def of(cls, data: tuple[Dataset, ...]) -> Turns | None:
        """Of the first data with an uncertainty that is their members'; None: there are none."""
        for k, one in enumerate(data):
            doubt = one.uncertainty
            if isinstance(doubt, Uncertainty) and doubt.of_members and not stands(one) and not one.derived:
                return cls(k, doubt.rate or RATE, doubt.style == "members")
        return None

    @property
    def member(self) -> int:
        """The number of the member that is shown; 0: none."""
        return self.members[self._at % len(self.members)] if self.on and self.members else 0

    def over(self, one: Dataset, grid: Grid) -> Dataset:
        """Data as they are to be shown: a member, or all of them."""
        doubt = one.uncertainty
        if isinstance(doubt, Uncertainty) and doubt.style == "members":
            one = one.but(uncertainty=replace(doubt, style=None, rate=None))
        if not self.on:
            return one
        bare = one.but(uncertainty=None)
        if self._of is None or self._of[0] != bare:
            self._of = (bare, *_looked_at(bare, grid))
        _, self.members, scale = self._of
        return one if scale is None else scale.over(bare.but(member=str(self.member)))

    def advance(self, seconds: float) -> bool:
        """Let time pass; returns whether it is another member's turn."""
        if not self.on or not self.members:
            return False
        self._seconds += seconds
        if self._seconds < 1 / self.rate:
            return False
        # (What is left over is dropped: after a slow frame the next member must stay as long as any other.)
        self._at, self._seconds = (self._at + 1) % len(self.members), 0.0
        return True


def _looked_at(bare: Dataset, grid: Grid) -> tuple[tuple[int, ...], OneScale | None]:
    """The members of data, and the scale of all; of a single time without any: none."""
    try:
        members = members_of(bare, grid)
    except UsageError:
        return (), None
    some = [members[round(k)] for k in np.linspace(0, len(members) - 1, min(LOOKED_AT, len(members)))]
    return members, OneScale.of(bare, [bare.but(member=str(number)) for number in some], grid)
