"""A survey of the whole picture before it is drawn: which ground is in view, and how far away.

Rays through some forty thousand pixel centres, evenly spread over the whole picture, whatever part of it (a tile) is
wanted: what depends on all that is seen (maps of light, haze, exaggerated relief) is the same in every tile.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orograph.rendering.rays import Hits, Rays

Array = NDArray[np.float64]

RAYS = 40_000


class Survey:
    """What the survey's rays met.

    Attributes:
        hits: of the rays that met ground, at least one. px, py: their pixel positions.
        range: metres of depth from the nearest to the farthest.
    """

    def __init__(self, hits: Hits, px: Array, py: Array) -> None:
        self.hits, self.px, self.py = hits, px, py
        self.range = float(hits.t.min()), float(hits.t.max())

    @classmethod
    def of(cls, rays: Rays) -> Survey | None:
        """Survey a picture; None if it shows no ground (or less than a forty-thousandth that no pixel centre meets)."""
        height, width = rays.view.height, rays.view.width
        step = stride(height, width)
        rows, cols = np.meshgrid(np.arange(0, height, step), np.arange(0, width, step), indexing="ij")
        found = cls._met(rays, rows.ravel(), cols.ravel())
        if found is not None or step == 1:
            return found
        for row in range(0, height, 64):  # a grain of ground between those: every pixel is asked
            rows, cols = np.mgrid[row : min(row + 64, height), :width].reshape(2, -1)
            found = cls._met(rays, rows, cols)
            if found is not None:
                return found
        return None

    @classmethod
    def _met(cls, rays: Rays, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> Survey | None:
        px, py = (a.astype(np.float64) + 0.5 for a in (cols, rows))
        t = rays.depths(px, py)
        met = np.isfinite(t)
        if not met.any():
            return None
        t, px, py = t[met], px[met], py[met]
        return cls(rays.meet(px, py, t), px, py)


def stride(height: int, width: int) -> int:
    """Pixels from one surveyed pixel to the next, along rows and columns."""
    return max(1, int(math.sqrt(height * width / RAYS)))
