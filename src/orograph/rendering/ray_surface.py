"""Heights as a camera sees them: the ray caster as a ``Surface`` whose objects are its windows.

In perspective the caster takes whole blocks of pixels at once, which are the same to the bit in every area; single
positions and plans are cast ray by ray. Units as in ``gbuffer``.
"""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import NDArray

from orograph.raycast.caster import Caster
from orograph.raycast.kernels import BLOCK_X, BLOCK_Y
from orograph.rendering.gbuffer import Area, GBuffer
from orograph.rendering.projection import Projection

Array = NDArray[np.float64]

FARTHEST = 1e13
"""The longest ray, metres."""

ROWS = 64
"""Pixels of a plan that are cast at a time."""


class RaySurface:
    """The heights of a caster seen by a camera.

    Args:
        caster: its number of threads is that of ``draw``.
        projection: of the whole picture.
    """

    side = BLOCK_X

    def __init__(self, caster: Caster, projection: Projection) -> None:
        self.caster, self.projection = caster, projection
        self._single = copy.copy(caster)
        self._single.jobs = 1
        self._far = min(projection.far, FARTHEST)

    def draw(self, area: Area) -> GBuffer:
        p = self.projection
        top, bottom, left, right = area
        if not p.perspective:
            return self._draw_plan(area)
        y0, x0 = top // BLOCK_Y * BLOCK_Y, left // BLOCK_X * BLOCK_X
        y1, x1 = min(-(-bottom // BLOCK_Y) * BLOCK_Y, p.height), min(-(-right // BLOCK_X) * BLOCK_X, p.width)
        t, window = self.caster.cast_pinhole(
            p.o, p.d + 0.5 * (p.du + p.dv), p.du, p.dv, (p.height, p.width), p.near, self._far, (y0, y1, x0, x1)
        )
        inner = slice(top - y0, bottom - y0), slice(left - x0, right - x0)
        return _buffer(np.ascontiguousarray(t[inner]), window[inner])

    def _draw_plan(self, area: Area) -> GBuffer:
        top, bottom, left, right = area
        out = GBuffer.empty((bottom - top, right - left))
        px = np.arange(left, right) + 0.5
        for row in range(top, bottom, ROWS):
            py = np.arange(row, min(row + ROWS, bottom)) + 0.5
            u, v = (a.ravel() for a in np.meshgrid(px, py))
            part = slice(row - top, row - top + len(py))
            t, window = self.caster.cast(*self.projection.rays(u, v), self.projection.near, self._far)
            out.depth[part], out.objects[part] = t.reshape(len(py), -1), window.reshape(len(py), -1)
        return out

    def at(self, px: Array, py: Array) -> GBuffer:
        return _buffer(*self._single.cast(*self.projection.rays(px, py), self.projection.near, self._far))


def _buffer(t: Array, window: NDArray[np.int8]) -> GBuffer:
    return GBuffer(t, window.astype(np.int32), np.zeros(t.shape, np.uint8))
