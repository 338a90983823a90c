"""A surface seen through a transparent one: ground with patches over its missing data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orograph.rendering.gbuffer import NONE, Area, GBuffer, Mark, Surface

Array = NDArray[np.float64]


TIE = 1e-9
"""Part of a depth by which a patch may lie in front of ground without being seen: where they meet they are one, however
depths round (``composited`` finds them in another frame)."""


class Layered:
    """``ground`` as the first layer, and in front of it ``over`` as the second.

    Args:
        ground, over: surfaces of the same camera.
        mark: what the samples of ``over`` are.
    """

    def __init__(self, ground: Surface, over: Surface, mark: Mark = Mark.VOID_FILL) -> None:
        self.ground, self.over, self.mark = ground, over, mark

    @property
    def side(self) -> int:
        return self.ground.side

    def draw(self, area: Area) -> GBuffer:
        return self._joined(self.ground.draw(area), self.over.draw(area))

    def at(self, px: Array, py: Array) -> GBuffer:
        return self._joined(self.ground.at(px, py), self.over.at(px, py))

    def _joined(self, ground: GBuffer, over: GBuffer) -> GBuffer:
        with np.errstate(invalid="ignore"):
            hidden = np.isnan(over.depth) | (ground.depth <= over.depth * (1 + TIE))
        return replace(
            ground,
            over=GBuffer(
                np.where(hidden, np.nan, over.depth),
                np.where(hidden, np.int32(NONE), over.objects),
                np.where(hidden, np.uint8(0), over.marks | np.uint8(self.mark)),
                over.values,
            ),
        )
