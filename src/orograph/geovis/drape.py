"""A layer laid over the terrain, in memory: from a place in the terrain's CRS to the colour of an image in any CRS.

The image stays in its own projection; positions go to it (``placement``). Of the image the window over the terrain is
read once (``imagery``), made into a pyramid of area means (``mipmap``), and looked up over the footprint of a pixel of
the picture: the ellipse that is the pixel's image on the ground. The level is chosen by the ellipse's minor axis and
several look-ups along its major axis are averaged (after Heckbert 1989, *Fundamentals of texture mapping and image
warping*, and McCormack et al. 1999, *Feline*): no aliasing, no blur at grazing angles, and no more memory than a
quarter of what is allowed.

Units: positions in the terrain's CRS, footprints in metres, image positions in pixels from its upper left corner.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orograph.geo.grid import Grid
from orograph.geovis import mipmap
from orograph.geovis.imagery import Window, read_into, step_for
from orograph.geovis.layers import Layer
from orograph.geovis.laying import Laid, empty
from orograph.geovis.placement import TOLERANCE, interpolate, slopes_into

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Colours = NDArray[np.float32]

BUDGET = 1 << 30
"""Bytes for the pyramid where no limit is given."""


class Drape:
    """An image over a terrain.

    Attributes:
        laid: where it lies. warnings: what a user should know, full sentences.
        pixel: the size of the finest texel held, in metres on the ground (median).
    """

    def __init__(
        self, laid: Laid, window: Window, pyramid: tuple[Bytes, NDArray[np.int64]], warnings: list[str]
    ) -> None:
        """Use ``open``. ``pyramid``: of the window, see ``mipmap``."""
        self.laid, self.warnings = laid, warnings
        self._placement, self._lattice, self._window = laid.placement, laid.lattice, window
        self._pool, self._levels = pyramid
        self._density = laid.lattice.density()
        self.pixel = 1.0 / (float(np.median(self._density)) / window.step or math.inf)

    @classmethod
    def open(
        cls,
        layer: Layer | str | os.PathLike[str],
        grid: Grid,
        max_memory: int | None = None,
        *,
        metres: float | None = None,
    ) -> Drape:
        """Read the part of an image that lies over a terrain.

        Args:
            layer: what is shown, or the path of an image.
            grid: the terrain's.
            max_memory: bytes; the image takes at most a quarter. None: at most ``BUDGET``.
            metres: the least footprint that will be asked for; finer detail is not read.

        Raises:
            ReadError: the file is missing or broken, or lies beside the terrain.
            UsageError: its CRS cannot be reached from the terrain's.
        """
        laid = Laid.open(layer if isinstance(layer, Layer) else Layer(os.fspath(layer)), grid)
        area, _ = laid.aligned()
        budget = BUDGET if max_memory is None else max(max_memory // 4, 1 << 16)
        least = 1.0 if metres is None else metres * float(laid.lattice.density().max())
        size = area.row1 - area.row0, area.col1 - area.col0
        wanted, step = step_for(*size, math.inf, least), step_for(*size, budget, least)
        warnings = list(laid.warnings)
        if step > wanted:
            warnings.append(
                f"{laid.layer.path} is drawn {step // wanted} times coarser than it could be: more would not fit into "
                "the memory allowed."
            )
        window = replace(area, step=step)
        pool, levels = mipmap.pool_for(*window.shape)
        finest = pool[: window.shape[0] * window.shape[1]].reshape(*window.shape, 4)
        read_into(finest, laid.location, window, laid.bands)
        if not finest[..., 3].any():
            raise empty(laid.layer.path)
        mipmap.fill(pool, levels)
        return cls(laid, window, (pool, levels), warnings)

    @property
    def path(self) -> str:
        """The image."""
        return self.laid.layer.path

    @property
    def window(self) -> Window:
        """The part of the image that is held, and how many of its pixels a texel is wide."""
        return self._window

    def positions(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Where places in the terrain's CRS (n,) lie in the image: u, v in pixels from its upper left corner, NaN where
        there is no such place, and image pixels per metre there."""
        x, y = np.ascontiguousarray(x, np.float64), np.ascontiguousarray(y, np.float64)
        u, v, density = np.empty(len(x)), np.empty(len(x)), np.empty(len(x))
        lattice = self._lattice
        interpolate(lattice.u, lattice.v, self._density, np.array(lattice.index[:6]), x, y, u, v, density)
        if lattice.error > TOLERANCE:
            u, v = self._placement.pixels(x, y)
        return u, v, density

    def sample(self, x: Array, y: Array, footprint_metres: Array) -> Colours:
        """The image's mean colours around positions; safe from any thread.

        Args:
            x, y: (n,) float64 in the terrain's CRS.
            footprint_metres: (n,) or one number: the width of the means on the ground.

        Returns:
            (n, 4) float32: linear RGB (not multiplied by opacity) and opacity, 0 where the image is not.
        """
        u, v, density = self.positions(x, y)
        self._leave_out(u, v)
        step = self._window.step
        width = np.broadcast_to(footprint_metres, u.shape) * density / step
        out = np.empty((len(u), 4), np.float32)
        mipmap.look_up(
            self._pool, self._levels, mipmap.curves()[0], *self._in_window(u, v), np.ascontiguousarray(width), out
        )
        return out

    def spread(self, x: Array, y: Array, ground: Array, least: Array) -> Colours:
        """The image's mean colours over the ground that pixels of a picture show; safe from any thread.

        Args:
            x, y: (n,) float64 in the terrain's CRS.
            ground: (n, 4) metres east and north that the ground moves by from a pixel to the next one right (0, 1) and
                to the next one below (2, 3): the axes of the footprint, whatever its shape.
            least: (n,) metres that the footprint's minor axis is taken to have at least.

        Returns:
            (n, 4) float32 as for ``sample``.
        """
        x, y = np.ascontiguousarray(x, np.float64), np.ascontiguousarray(y, np.float64)
        u, v, _ = self.positions(x, y)
        image, step = self._placement.image, float(self._window.step)
        axes, floor = np.empty((len(x), 4)), np.empty(len(x))
        slopes_into(
            self._lattice.u, self._lattice.v, np.array(self._lattice.index[:6]), x, y, ground, least, 1.0 / step, axes,
            floor,
        )  # fmt: skip
        inside = np.array([0.0, float(image.rows), 0.0, float(image.cols)])
        if self._placement.stretched:
            inside[:] = -np.inf, np.inf, -np.inf, np.inf
        elif self._placement.cyclic:
            inside[2:] = -np.inf, np.inf
        inside[:2], inside[2:] = (inside[:2] - self._window.row0) / step, (inside[2:] - self._window.col0) / step
        out = np.empty((len(u), 4), np.float32)
        mipmap.look_along(
            self._pool, self._levels, mipmap.curves()[0], *self._in_window(u, v), axes, floor, inside, out
        )
        return out

    def _in_window(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Positions in texels of the finest level held."""
        w = self._window
        return (u - w.col0) / w.step, (v - w.row0) / w.step

    def _leave_out(self, u: Array, v: Array) -> None:
        """Make positions beyond the image NaN."""
        image = self._placement.image
        if self._placement.stretched:
            return
        # A thousandth of a pixel beyond the border is rounding.
        outside = ~((v >= -1e-3) & (v <= image.rows + 1e-3))
        if not self._placement.cyclic:
            outside |= ~((u >= -1e-3) & (u <= image.cols + 1e-3))
        u[outside] = np.nan
