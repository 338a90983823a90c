"""A scene's camera and the surface it sees: what pixels show, and where that is on the ground.

Positions are sample coordinates (column, row, true height); depth is the rays' parameter, in metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.parallel import map_ordered
from orograph.rendering.gbuffer import Surface
from orograph.rendering.ray_kernels import PixelRays, ToSamples, ends
from orograph.scene.scene import Scene

Array = NDArray[np.float64]

BLOCK = 1 << 13
"""Positions that a thread queries at a time."""


@dataclass(frozen=True, slots=True)
class Hits:
    """Samples of a picture (n,), NaN where no ground was met.

    Attributes:
        t: (n,) view-space depth.
        points: (n, 3) sample coordinates and true height.
        rays: (n, 3) unit directions in stretched CRS space, of all samples.
        width: (n,) of a pixel on the ground, in samples.
        void_fill: (n,) depth of a patch over missing data in front of what was met, NaN where there is none.
    """

    t: Array
    points: Array
    rays: Array
    width: Array
    void_fill: Array


class Rays:
    """The rays of a scene's whole picture.

    Attributes:
        surface: what they meet. view: the whole picture's. pixels: the rays in the terrain's CRS. to_samples: from
            there to sample coordinates.
    """

    def __init__(self, scene: Scene, surface: Surface) -> None:
        self.scene, self.surface = scene, surface
        view, chart = scene.view.whole, scene.terrain.chart
        self.view = view
        parallel = view.projection == "plan"
        pixel = view.pixel_metres if parallel else view.pixel_slope
        exaggeration = scene.surface.exaggeration
        self.pixels = PixelRays(view.ray_basis(exaggeration), exaggeration, pixel, parallel)
        inverse = chart.grid.inverse
        linear = np.array([[inverse.a, inverse.b, 0.0], [inverse.d, inverse.e, 0.0], [0.0, 0.0, 1.0]])
        self.to_samples = ToSamples(linear, np.array([inverse.c, inverse.f, 0.0]), chart.spacing)

    def depths(self, px: Array, py: Array) -> Array:
        """Depths (n,) of the ground at pixel positions (n,), by all threads; NaN where there is none."""
        out = np.empty(len(px))

        def ask(start: int) -> None:
            part = slice(start, start + BLOCK)
            out[part] = self.surface.at(px[part], py[part]).depth

        for _ in map_ordered(ask, range(0, len(px), BLOCK), self.scene.budget.jobs):
            pass
        return out

    def meet(self, px: Array, py: Array, t: Array, void_fill: Array | None = None) -> Hits:
        """Where samples at pixel positions (n,) with depths t (n,) lie. ``void_fill``: see ``Hits``; None: nowhere."""
        points, rays, width = np.empty((len(px), 3)), np.empty((len(px), 3)), np.empty(len(px))
        ends(px, py, t, self.pixels, self.to_samples, points, rays, width)
        return Hits(t, points, rays, width, np.full(len(t), np.nan) if void_fill is None else void_fill)
