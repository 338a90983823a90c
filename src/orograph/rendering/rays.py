"""Rays through the pixels of a scene's picture, and where they meet the ground.

Positions are sample coordinates (column, row, true height); depth is the rays' parameter, in metres.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.raycast.caster import Caster
from orograph.raycast.kernels import BLOCK_X, BLOCK_Y
from orograph.rendering.ray_kernels import beginnings, ends
from orograph.scene.scene import Scene

Array = NDArray[np.float64]

FARTHEST = 1e13
"""Metres that rays go at most."""

Area = tuple[int, int, int, int]
"""Pixels of the whole picture: the first row, that after the last, the first column, that after the last."""


@dataclass(frozen=True, slots=True)
class Hits:
    """Samples of a picture (n,), NaN where no ground was met.

    Attributes:
        t: (n,) view-space depth.
        points: (n, 3) sample coordinates and true height.
        rays: (n, 3) unit directions in stretched CRS space, of all samples.
        width: (n,) of a pixel on the ground, in samples.
        window: (n,) of the caster, −1 where no ground was met.
        veil: (n,) depth of a patch over missing data in front of what was met, NaN where there is none.
    """

    t: Array
    points: Array
    rays: Array
    width: Array
    window: NDArray[np.int8]
    void_fill: Array


class Rays:
    """A scene's camera against its caster."""

    def __init__(self, scene: Scene, caster: Caster, patches: Caster | None) -> None:
        self.scene, self.caster, self.patches = scene, caster, patches
        self.single = copy.copy(caster)
        self.single.jobs = 1
        view, grid = scene.view.whole, scene.terrain.grid
        self.view = view
        self.basis = view.ray_basis(scene.surface.exaggeration)
        inverse = ~grid.samples
        self.linear = np.array([[inverse.a, inverse.b, 0.0], [inverse.d, inverse.e, 0.0], [0.0, 0.0, 1.0]])
        self.offset = np.array([inverse.c, inverse.f, 0.0])
        self.spacing = math.sqrt(abs(grid.transform.determinant))
        self.far = min(view.far, FARTHEST)

    def first(self, area: Area) -> tuple[Array, NDArray[np.int8], Array]:
        """Depth, window and veil (see ``Hits``), each (rows, cols), of the rays through the pixel centres of an area of
        the whole picture."""
        t, window = self._pixels(self.caster, area)
        return t, window, self._veil(t, lambda: self._pixels(self.patches, area)[0])

    def cast(self, px: Array, py: Array) -> tuple[Array, NDArray[np.int8], Array]:
        """Depth, window and veil of rays through arbitrary pixel positions (n,), in the calling thread."""
        t, window = self._positions(px, py, self.single)
        return t, window, self._veil(t, lambda: self._positions(px, py, self.patches)[0])

    def positions(self, px: Array, py: Array) -> tuple[Array, NDArray[np.int8]]:
        """Depth and window of rays through arbitrary pixel positions (n,), by all threads."""
        return self._positions(px, py, self.caster)

    def _veil(self, t: Array, patch_depth: Callable[[], Array]) -> Array:
        if self.patches is None:
            return np.full(t.shape, np.nan)
        void_fill = patch_depth()
        void_fill[t <= void_fill] = np.nan  # false where nothing else was met
        return void_fill

    def _pixels(self, caster: Caster | None, area: Area) -> tuple[Array, NDArray[np.int8]]:
        assert caster is not None
        view = self.view
        top, bottom, left, right = area
        o0, _, _, d0, du, dv = self.basis
        if view.projection == "perspective":
            # Whole blocks of the caster are the same to the bit in every area.
            y0, x0 = top // BLOCK_Y * BLOCK_Y, left // BLOCK_X * BLOCK_X
            y1, x1 = min(-(-bottom // BLOCK_Y) * BLOCK_Y, view.height), min(-(-right // BLOCK_X) * BLOCK_X, view.width)
            t, window = caster.cast_pinhole(
                self.linear @ o0 + self.offset, self.linear @ (d0 + 0.5 * (du + dv)), self.linear @ du,
                self.linear @ dv, (view.height, view.width), view.near, self.far, (y0, y1, x0, x1),
            )  # fmt: skip
            inner = slice(top - y0, bottom - y0), slice(left - x0, right - x0)
            return np.ascontiguousarray(t[inner]), np.ascontiguousarray(window[inner])
        t, window = np.empty((bottom - top, right - left)), np.empty((bottom - top, right - left), np.int8)
        px = np.arange(left, right) + 0.5
        for row in range(0, bottom - top, 64):
            py = np.arange(top + row, min(top + row + 64, bottom)) + 0.5
            u, v = (a.ravel() for a in np.meshgrid(px, py))
            a, b = self._positions(u, v, caster)
            t[row : row + 64], window[row : row + 64] = a.reshape(len(py), -1), b.reshape(len(py), -1)
        return t, window

    def _positions(self, px: Array, py: Array, caster: Caster | None) -> tuple[Array, NDArray[np.int8]]:
        assert caster is not None
        origins, directions = np.empty((len(px), 3)), np.empty((len(px), 3))
        beginnings(px, py, *self.basis, self.linear, self.offset, origins, directions)
        return caster.cast(origins, directions, self.view.near, self.far)

    def meet(self, px: Array, py: Array, t: Array, window: NDArray[np.int8], void_fill: Array) -> Hits:
        """Positions of the samples at pixel positions (n,) with depths t (n,)."""
        view = self.view
        parallel = view.projection == "plan"
        points, rays, width = np.empty((len(px), 3)), np.empty((len(px), 3)), np.empty(len(px))
        ends(
            px, py, t, *self.basis, self.linear, self.offset, self.scene.surface.exaggeration,
            view.pixel_metres if parallel else view.pixel_slope, parallel, self.spacing, points, rays, width,
        )  # fmt: skip
        return Hits(t, points, rays, width, window, void_fill)
