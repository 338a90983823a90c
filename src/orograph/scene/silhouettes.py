"""How silhouettes are drawn: the lines where one ridge stands before another or before the sky, and creases.

What they are and how they are found: ``rendering.lines.silhouettes``. Units: pixels; colours are sRGB from 0 to 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geovis.color import srgb_to_linear
from orograph.viewpoint import View

Colors = NDArray[np.float32]

USUAL = 1100
"""Pixels of a picture's shorter side beyond which lines are wider: such pictures are for print."""


@dataclass(frozen=True, slots=True)
class Silhouettes:
    """How silhouettes are drawn.

    Attributes:
        width: of the nearest ones, pixels; more in pictures for print (``USUAL``). opacity: of those, 0 to 1.
        colour: sRGB, 0 to 1. creases: how heavy lines are where ground turns away and back but hides nothing, as a part
            of those where it hides something; 0: none.

    Raises:
        UsageError: a number is out of its range.
    """

    width: float = 2.0
    opacity: float = 0.8
    color: tuple[float, float, float] = (0.20, 0.18, 0.20)
    creases: float = 0.6

    def __post_init__(self) -> None:
        if not 0 < self.width <= 32:
            raise UsageError(f"Silhouettes are a number of pixels wide, more than 0 and at most 32, not {self.width}.")
        if not 0 <= self.opacity <= 1:
            raise UsageError(f"The opacity of silhouettes is from 0 to 1, not {self.opacity:g}.")
        if not 0 <= self.creases <= 1:
            raise UsageError(f"Creases are a part of silhouettes from 0 to 1, not {self.creases:g}.")
        if len(self.color) != 3 or not all(0 <= c <= 1 for c in self.color):
            raise UsageError(f"The colour of silhouettes is three numbers from 0 to 1, not {self.color}.")

    def fitted(self, view: View) -> Silhouettes:
        """These lines for one picture: with a width for its number of pixels."""
        _, _, width, height = view.frame
        return replace(self, width=min(self.width * max(1.0, min(width, height) / USUAL), 32.0))

    @property
    def ink(self) -> Colors:
        """The colour (3,), linear light."""
        return np.asarray(srgb_to_linear(np.array(self.color, np.float32)), np.float32)

    @property
    def reach(self) -> int:
        """Pixels from a line within which a pixel may be covered by it."""
        return math.ceil(self.width / 2 + 0.5)
