"""How silhouettes are drawn: the lines where a ridge stands in front of another or of the sky, and creases.

Their definition and how they are found: ``rendering.lines.silhouettes``. Units: pixels; colours are sRGB from 0 to 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from orograph._named import named
from orograph.errors import UsageError
from orograph.lod.options import check, option
from orograph.scene.contours import CASING

if TYPE_CHECKING:  # help of the command line uses these fields before anything is loaded
    import numpy as np
    from numpy.typing import NDArray

    from orograph.viewpoint import View

USUAL = 1100
"""Pixels of a picture's shorter side beyond which lines are wider: such pictures are for print."""


@named("orograph.Silhouettes")
@dataclass(frozen=True, slots=True)
class Silhouettes:
    """How silhouettes are drawn.

    Attributes:
        width: in pixels; more in pictures for print (``USUAL``). opacity: of the nearest ones, 0 to 1.
        color: sRGB, 0 to 1. casing: as that of ``Contours``.
        creases: see its help; relative to lines where ground hides something.

    Raises:
        UsageError: a number is out of its range.
    """

    width: float = option(
        2.0, "Width of the nearest lines; farther ones are thinner.", unit="pixels", least=0.25, most=32,
        flag="silhouette-width", metavar="PX",
    )  # fmt: skip
    opacity: float = 0.8
    color: tuple[float, float, float] = (0.20, 0.18, 0.20)
    casing: float | None = None
    creases: float = option(
        0.6,
        "Weight of silhouettes where ground turns away and back but hides nothing; 0: not drawn.", least=0, most=1,
        flag="creases",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check(self)
        if not 0 <= self.opacity <= 1:
            raise UsageError(f"The opacity of silhouettes must be from 0 to 1, not {self.opacity:g}.")
        if self.casing is not None and not 0 <= self.casing <= 1:
            raise UsageError(f"The opacity of the casing of silhouettes must be from 0 to 1, not {self.casing:g}.")
        if len(self.color) != 3 or not all(0 <= c <= 1 for c in self.color):
            raise UsageError(f"The colour of silhouettes must be three numbers from 0 to 1, not {self.color}.")

    def fitted(self, view: View) -> Silhouettes:
        """These options for one picture: with a width that suits its number of pixels."""
        _, _, width, height = view.frame
        return replace(self, width=min(self.width * max(1.0, min(width, height) / USUAL), 32.0))

    @property
    def ink(self) -> NDArray[np.float32]:
        """The colour (3,), linear light."""
        import numpy as np

        from orograph.geovis.color import srgb_to_linear

        return np.asarray(srgb_to_linear(np.array(self.color, np.float32)), np.float32)

    @property
    def reach(self) -> int:
        """Distance from a line within which it or its casing may cover a pixel, pixels."""
        return math.ceil(self.width / 2 + (CASING if self.casing else 0.0) + 0.5)
