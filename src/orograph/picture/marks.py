"""What is drawn on the ground besides its colour: contour lines, as ``picture.contours`` says them.

Lines lie on the ground: haze comes before them, and ground before them hides them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.colour import srgb_to_linear
from orograph.picture.contour_kernels import line_cover
from orograph.picture.contours import Contours
from orograph.picture.ground import Ground, Hits
from orograph.picture.kept import Kept
from orograph.picture.mapgrid import MapGrid
from orograph.picture.scene import Scene

Array = NDArray[np.float64]
Colours = NDArray[np.float32]


def ink(contours: Contours) -> Colours:
    """The lines' colour (3,), linear light."""
    return np.asarray(srgb_to_linear(np.array(contours.colour, np.float32)), np.float32)


class Lines:
    """The contour lines of one picture.

    Attributes:
        contours: with an interval. facts: what the picture tells of them.
    """

    def __init__(self, scene: Scene, ground: Ground, maps: MapGrid, kept: Kept) -> None:
        assert scene.contours is not None
        self.ground, self.maps = ground, maps
        self.contours = scene.contours.fitted(scene.terrain, scene.view, kept)
        self.ink = ink(self.contours)
        self.facts = {"interval_m": self.contours.interval, "index": self.contours.index}
        self._basis = np.array(ground.rays.basis)

    def draw(self, hits: Hits, px: Array, py: Array, out: Colours) -> None:
        """Draw over the colours (n, 3) of hits at pixel positions (n,) of the whole picture."""
        c, maps = self.contours, self.maps
        cover = np.empty(len(hits.t), np.float32)
        gradient = self.ground.relief.gradient(hits.points, hits.width)
        line_cover(
            px, py, hits.t, hits.points, gradient, maps.water, maps.scale, maps.row0, maps.col0, self.ground.to_world,
            self._basis, float(c.interval or 1.0), c.index, c.width, cover,
        )  # fmt: skip
        cover *= np.float32(c.opacity)
        some = np.flatnonzero(cover > 0)
        out[some] += cover[some, None] * (self.ink - out[some])
