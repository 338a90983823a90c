"""Imagery laid over the terrain: from a place in the terrain's CRS to the colour of an image in any CRS.

The image stays in its own projection; positions go to it (``placement``). Of the image the window over the terrain is
read once (``imagery``), made into a pyramid of area means (``mipmap``), and looked up at the level at which a pixel of
the picture covers one texel: no aliasing, and no more memory than a quarter of what is allowed.

Units: positions in the terrain's CRS, footprints in metres, image positions in pixels from its upper left corner.
"""

from __future__ import annotations

import math
import os

import numpy as np
from numpy.typing import NDArray

from orograph.dem.handles import HANDLES, locate
from orograph.errors import ReadError
from orograph.geo.grid import Grid
from orograph.geovis import mipmap
from orograph.geovis.imagery import Bands, Window, read_into, step_for
from orograph.geovis.placement import TOLERANCE, Lattice, Placement, extent, grid_of, interpolate

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Colours = NDArray[np.float32]

BUDGET = 1 << 30
"""Bytes for the pyramid where no limit is given."""


class Drape:
    """An image over a terrain.

    Attributes:
        path: the image. warnings: what a user should know, full sentences.
        pixel: the size of the finest texel held, in metres on the ground (median).
    """

    def __init__(
        self,
        path: str,
        placement: Placement,
        lattice: Lattice,
        window: Window,
        pyramid: tuple[Bytes, NDArray[np.int64]],
        warnings: list[str],
    ) -> None:
        """Use ``open``. ``pyramid``: of the window, see ``mipmap``."""
        self.path, self.warnings = path, warnings
        self._placement, self._lattice, self._window = placement, lattice, window
        self._pool, self._levels = pyramid
        self._density = lattice.density()
        self.pixel = 1.0 / (float(np.median(self._density)) / window.step or math.inf)

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        grid: Grid,
        max_memory: int | None = None,
        *,
        metres: float | None = None,
    ) -> Drape:
        """Read the part of an image that lies over a terrain.

        Args:
            path: anything GDAL reads: RGB, RGBA, a palette, one band as grey; any CRS, or none (then it is stretched
                over the terrain).
            grid: the terrain's.
            max_memory: bytes; the image takes at most a quarter. None: at most ``BUDGET``.
            metres: the least footprint that will be asked for; finer detail is not read.

        Raises:
            ReadError: the file is missing or broken, or lies beside the terrain.
            UsageError: its CRS cannot be reached from the terrain's.
        """
        name = os.fspath(path)
        location = locate(name)
        warnings: list[str] = []
        with HANDLES.borrow(location) as file:
            image = grid_of(file)
            Bands.of(file)
        placement = Placement.of(grid, image, name, warnings)
        lattice = Lattice.over(placement)
        bounds = lattice.bounds()
        area = None if bounds is None else _window(placement, bounds)
        if area is None:
            raise ReadError(
                f"The image does not overlap the terrain: it covers {extent(placement.image)}, and the terrain "
                f"{extent(grid)}.",
                path=name,
                remedy="Name an image of the same area, or mend its georeference (gdal_edit.py).",
            )
        budget = BUDGET if max_memory is None else max(max_memory // 4, 1 << 16)
        least = 1.0 if metres is None else metres * float(lattice.density().max())
        size = area[1] - area[0], area[3] - area[2]
        wanted, step = step_for(*size, math.inf, least), step_for(*size, budget, least)
        if step > wanted:
            warnings.append(
                f"{name} is drawn {step // wanted} times coarser than it could be: more would not fit into the memory "
                "allowed."
            )
        # Overviews are found by whole texels of theirs.
        row0, col0 = (first - first % step for first in (area[0], area[2]))
        window = Window(row0, area[1], col0, area[3], step)
        pool, levels = mipmap.pool_for(*window.shape)
        finest = pool[: window.shape[0] * window.shape[1]].reshape(*window.shape, 4)
        read_into(finest, location, window)
        if not finest[..., 3].any():
            raise ReadError(
                "The image has no valid pixel over the terrain (all is masked, transparent or nodata).",
                path=name,
                remedy="Name an image that covers it.",
            )
        mipmap.fill(pool, levels)
        return cls(name, placement, lattice, window, (pool, levels), warnings)

    @property
    def lattice(self) -> Lattice:
        """Image positions of nodes over the terrain, pixels from the image's upper left corner."""
        return self._lattice

    @property
    def window(self) -> Window:
        """The part of the image that is held, and how many of its pixels a texel is wide."""
        return self._window

    def levels(self) -> list[Bytes]:
        """The pyramid, finest first: (rows, cols, 4) sRGB and opacity, colours not multiplied by it (``mipmap``)."""
        return [self._pool[b : b + r * c].reshape(r, c, 4) for b, r, c in self._levels.tolist()]

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
        image = self._placement.image
        if not self._placement.stretched:
            # A thousandth of a pixel beyond the border is rounding.
            outside = ~((v >= -1e-3) & (v <= image.rows + 1e-3))
            if not self._placement.cyclic:
                outside |= ~((u >= -1e-3) & (u <= image.cols + 1e-3))
            u[outside] = np.nan
        step = self._window.step
        width = np.broadcast_to(footprint_metres, u.shape) * density / step
        u, v = (u - self._window.col0) / step, (v - self._window.row0) / step
        out = np.empty((len(u), 4), np.float32)
        mipmap.look_up(self._pool, self._levels, mipmap.curves()[0], u, v, width, out)
        return out


def _window(placement: Placement, bounds: tuple[float, float, float, float]) -> tuple[int, int, int, int] | None:
    """Pixels (row0, row1, col0, col1) of the image around ``bounds`` with a margin for its means, None if there are
    none. In a cyclic image columns may lie beyond its borders."""
    rows, cols = placement.image.shape
    u0, u1, v0, v1 = bounds
    if v1 <= 0 or v0 >= rows or not (placement.cyclic or (u1 > 0 and u0 < cols)):
        return None
    margin = 4 + 0.01 * max(u1 - u0, v1 - v0)
    row0, row1 = max(0, math.floor(v0 - margin)), min(rows, math.ceil(v1 + margin))
    col0, col1 = math.floor(u0 - margin), math.ceil(u1 + margin)
    if not placement.cyclic:
        return row0, row1, max(0, col0), min(cols, col1)
    return row0, row1, col0, min(col1, col0 + cols + 2 * math.ceil(margin))
