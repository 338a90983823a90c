"""Contour lines: their heights, and how much of a pixel a line covers.

Each pixel computes a line's coverage from its own height: the change of height from pixel to pixel on the ground's
tangent plane (its slope averaged over the pixel, as for the light) gives the distance to the line. So lines are equally
thin at any distance, and no line is traced. Where lines would run together they fade, first the plain ones, then the
index contours. Level ground and water have no lines.

The automatic interval follows the cartographers' rule (Imhof 1965): lines must remain distinct on the steepest common
slopes, so it is tan α of those slopes times the smallest distance between lines, rounded to 1, 2 or 5 times a power of
ten. Where the relief is low for the scale it is less, so that some lines remain.

Units: metres, pixels; colours are sRGB from 0 to 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from orograph._named import named
from orograph.errors import UsageError
from orograph.lod.options import check, option

if TYPE_CHECKING:  # help of the command line uses these fields before anything is loaded
    from orograph.memo import Memo
    from orograph.store.terrain import Terrain
    from orograph.viewpoint import View

APART = 5.0
"""Pixels between lines on the steepest common slopes, for an automatic interval."""

STEEP = 0.9
"""The part of the ground that is less steep than these slopes."""

WORKING = 512
"""Maximum samples per side for measuring slopes."""

FEWEST = 3
"""Contour lines, at least, between the lowest ground and the highest, for an automatic interval."""

GENTLE, LEAST = 0.25, 0.02
"""See ``Contours.finer``."""

LEVEL = 2e-4
"""Slopes below this (usually water) do not count."""

CASING = 0.8
"""Width of the light casing to each side of a line, pixels."""

USUAL = 1100
"""Pixels of a picture's shorter side beyond which lines and labels grow with it: such pictures are for print."""


@named("orograph.Contours")
@dataclass(frozen=True, slots=True)
class Contours:
    """How contour lines are drawn.

    Attributes:
        interval: metres of height between lines; None: suited to the relief and the scale.
        index, opacity, labels: see their help.
        width: of plain lines in pixels (index contours are twice as wide); larger in pictures for print (``USUAL``).
        color: sRGB, 0 to 1.
        casing: opacity of a light casing around lines and labels, which keeps them legible over dark colours; None:
            suited to what is below (data have one, plain ground has none).
        type_size: of the labels, pixels; as ``width``.
        fading: labels fade in and out as the camera moves, for films; otherwise each is either drawn or not.

    Raises:
        UsageError: a number is out of its range.
    """

    interval: float | None = None
    index: int = option(
        5, "Every how many contour lines there is a thick one; 0: none.", least=0, flag="contour-index", metavar="N"
    )
    width: float = 1.0
    opacity: float = option(0.7, "Opacity of the lines.", least=0, most=1, flag="contour-opacity")
    color: tuple[float, float, float] = (0.38, 0.30, 0.22)
    casing: float | None = None
    labels: bool = option(True, "Whether thick contour lines are labelled with their height.", flag="contour-labels")
    type_size: float = 12.0
    fading: bool = False

    def __post_init__(self) -> None:
        check(self)
        if self.interval is not None and not 0 < self.interval < math.inf:
            raise UsageError(
                f"The interval of contour lines (`contours`) must be more than 0 metres, not {self.interval:g}."
            )
        if not 0 < self.width < math.inf or not 0 < self.type_size < math.inf:
            raise UsageError("The width of contour lines and the size of their labels must be more than 0 pixels.")
        if self.casing is not None and not 0 <= self.casing <= 1:
            raise UsageError(f"The opacity of the casing of contour lines must be from 0 to 1, not {self.casing:g}.")
        if len(self.color) != 3 or not all(0 <= c <= 1 for c in self.color):
            raise UsageError(f"The colour of contour lines must be three numbers from 0 to 1, not {self.color}.")

    def fitted(self, terrain: Terrain, view: View, memo: Memo) -> Contours:
        """These options for one picture: with an interval, and sizes that suit its number of pixels."""
        _, _, width, height = view.frame
        large = max(1.0, min(width, height) / USUAL)
        interval = self.interval
        if interval is None:
            low, high = terrain.height_range
            interval = suitable(memo("steepness", (), lambda: steepness(terrain), terrain), view, high - low)
        return replace(self, interval=interval, width=self.width * large, type_size=self.type_size * large)

    def finer(self, terrain: Terrain, view: View, memo: Memo) -> float:
        """The part of a tolerance by which the ground may be displaced so that lines stay in place.

        A height error e moves a line by e / slope over the ground, and on the screen by that times the sine of the
        viewing angle; the height itself moves by its cosine. Slopes down to ``GENTLE`` of the steep ones meet this.
        """
        slope = GENTLE * memo("steepness", (), lambda: steepness(terrain), terrain)
        if view.projection == "plan":
            return float(min(max(slope, LEAST), 1.0))
        down = math.atan2(view.eye[2] - view.target[2], math.dist(view.eye[:2], view.target[:2]))
        return float(min(max(slope / max(math.tan(min(max(down, 0.0), 1.4)), 1e-6), LEAST), 1.0))

    @property
    def step(self) -> float:
        """Metres between index contours; 0: there are none."""
        return 0.0 if self.interval is None else self.interval * self.index


def suitable(steep: float, view: View, relief: float = math.inf) -> float:
    """The interval (metres) for ground whose steepest common slopes are ``steep``, at the scale of a view's middle.

    Args:
        relief: from the lowest ground to the highest, metres: at least ``FEWEST`` lines are between them.
    """
    interval = round_number(max(APART * view.pixel_metres * steep, 1e-3))
    while relief > 0 and interval > relief / FEWEST:
        interval = round_number(interval / 2.2)  # the next one down: 5, 2, 1, 0.5…
    return interval


def round_number(least: float) -> float:
    """The nearest, by ratio, of 1, 2 and 5 times the powers of ten."""
    power = 10.0 ** math.floor(math.log10(least))
    return float(min((m * power for m in (1.0, 2.0, 5.0, 10.0)), key=lambda v: abs(math.log(v / least))))


def steepness(terrain: Terrain) -> float:
    """tan of the slope that ``STEEP`` of a terrain does not exceed, on box means of ``WORKING`` samples a side."""
    import numpy as np

    level = 0
    while level < terrain.levels - 1 and max(terrain.mean_shape(level)) > WORKING:
        level += 1
    rows, cols = terrain.mean_shape(level)
    heights = terrain.read_mean(level, 0, rows, 0, cols).astype(np.float64)
    slope = np.zeros(0)
    if min(heights.shape) >= 2:
        to_world = np.linalg.inv(terrain.grid.linear * 2.0**level).T
        down, across = heights[1:, :-1] - heights[:-1, :-1], heights[:-1, 1:] - heights[:-1, :-1]
        gx = to_world[0, 0] * across + to_world[0, 1] * down
        gy = to_world[1, 0] * across + to_world[1, 1] * down
        slope = np.hypot(gx, gy)
        slope = slope[np.isfinite(slope) & (slope > LEVEL)]
    return float(np.quantile(slope, STEEP)) if slope.size else 0.1
