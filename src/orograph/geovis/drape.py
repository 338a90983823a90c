"""A layer over the terrain, as the CPU draws it: from a place in the terrain's CRS to the colour of an image in any
CRS.

The image stays in its own projection; positions go to it (``placement``). What is seen of it is looked up over the
footprint of a pixel of the picture: the ellipse that is the pixel's image on the ground. Of means at all resolutions
(``texels``) the level is chosen by the ellipse's minor axis, and several look-ups along its major axis are averaged
(after Heckbert 1989, *Fundamentals of texture mapping and image warping*, and McCormack et al. 1999, *Feline*): no
aliasing and no blur at grazing angles. Where a quarter of the memory allowed holds all that is wanted, it is read once;
else only coarse levels are held, and tiles of finer ones are read where the picture looks (``image_tiles``).

Units: positions in the terrain's CRS, footprints in metres, image positions in pixels from its upper left corner.
"""

from __future__ import annotations

import math
import os

import numpy as np
from numpy.typing import NDArray

from orograph.geo.grid import Grid
from orograph.geovis import mipmap
from orograph.geovis.coarse import FINEST, wanted
from orograph.geovis.image_tiles import BYTES, ImageTiles
from orograph.geovis.imagery import step_for
from orograph.geovis.layers import IMAGES, Layer
from orograph.geovis.laying import Laid
from orograph.geovis.placement import TOLERANCE, interpolate, slopes_into
from orograph.geovis.texels import Texels
from orograph.progress import SILENT, Progress

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

BUDGET = 1 << 30
"""Default bytes of texels."""

WHOLE = 4
"""Of the bytes of an image that does not fit, the part (one of so many) that holds coarse levels of all of it."""

FEW = 1 << 20
"""The same in bytes, at most, where holding them takes a reading of the whole file."""

ROOM = 0.75
"""The part of memory for tiles that those of a picture may fill, as some of its pixels tell: others want a few more."""


class Drape:
    """An image over a terrain.

    Attributes:
        laid: where it lies. warnings: what a user should know, full sentences.
        texels: the levels that are held. tiles: finer ones, read where they are looked up; None: none are wanted.
        step: pixels along the side of the finest texels. pixel: the size of one in metres on the ground (median).
        coarser: levels by which everything is looked up coarser, so that a picture's tiles fit into memory.
    """

    def __init__(self, texels: Texels, tiles: ImageTiles | None) -> None:
        """Use ``open``."""
        self.laid, self.texels, self.tiles = texels.laid, texels, tiles
        self.warnings = list(self.laid.warnings)
        self._placement, self._lattice = self.laid.placement, self.laid.lattice
        self._density = self._lattice.density()
        self.step = 1 if tiles is not None else 1 << texels.base
        self.pixel = 1.0 / (float(np.median(self._density)) / self.step or math.inf)
        self.coarser = 0.0

    @classmethod
    def open(
        cls,
        layer: Layer | str | os.PathLike[str],
        grid: Grid,
        max_memory: int | None = None,
        *,
        metres: float | None = None,
    ) -> Drape:
        """Lay an image over a terrain, and read it if it fits into the allowed memory.

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
        return cls.of(laid, *cls.plan(laid, max_memory, metres))

    @staticmethod
    def plan(laid: Laid, max_memory: int | None = None, metres: float | None = None) -> tuple[int, int]:
        """The finest level to hold of an image, and bytes for tiles of finer ones (0: none are wanted)."""
        window, _ = laid.aligned()
        budget = BUDGET if max_memory is None else max(max_memory // IMAGES, 1 << 16)
        least = 1.0 if metres is None else metres * float(laid.lattice.density().max())
        size = window.row1 - window.row0, window.col1 - window.col0
        if laid.layer.asks:  # a server is asked for what the picture shows
            return step_for(*size, FEW, 1.0).bit_length() - 1, budget
        step = step_for(*size, budget, least)
        if step == step_for(*size, math.inf, least):
            return step.bit_length() - 1, 0
        # To hold levels of all of a file without overviews all of it is read once: as few as can be.
        held = FEW if wanted(laid) else budget / WHOLE
        return step_for(*size, min(held, budget / WHOLE), 1.0).bit_length() - 1, budget - budget // WHOLE

    @classmethod
    def of(cls, laid: Laid, base: int, memory: int, progress: Progress = SILENT) -> Drape:
        """An image held as ``plan`` says.

        Raises:
            ReadError: the file cannot be read, or shows nothing over the terrain.
            StoreError: its coarse levels cannot be kept.
        """
        texels = Texels(laid, base)
        if texels.kept is None or not memory:
            if texels.hint and base >= FINEST:
                progress.warn(texels.hint)
            texels.hold(progress)
        return cls(texels, ImageTiles(texels, memory) if memory else None)

    def prepare(
        self, x: Array, y: Array, ground: Array, least: Array, *, progress: Progress = SILENT, jobs: int | None = None
    ) -> None:  # fmt: skip
        """Be ready for a picture, of which these are footprints spread evenly over all of it (see ``spread``).

        Coarse levels that it looks up and that the file does not have are made. If its tiles are more than memory
        holds, footprints are taken to be wider until they are not: else each would be read again and again.

        Raises:
            ReadError: the file cannot be read. StoreError: its coarse levels cannot be kept.
        """
        if self.tiles is None:
            return
        u, v, axes, floor, inside = self._footprints(x, y, ground, least)
        room = ROOM * self.tiles.capacity
        self.coarser = 0.0
        keys, coarse = self.tiles.wanted(u, v, axes, floor, inside)
        while len(keys) > room and self.coarser < len(self.texels.table) + self.texels.base:
            self.coarser += 0.5
            keys, coarse = self.tiles.wanted(u, v, axes, self._widened(axes, floor), inside)
        if self.coarser:
            progress.warn(
                f"{self.path} is drawn {2**self.coarser:.1f} times coarser than it could be: more of its pixels are in "
                f"view than the {self.tiles.capacity * BYTES / 2**20:.0f} MiB for it hold (`max_memory`)."
            )
        kept = self.texels.kept
        if kept is None:
            return
        windows = [self.tiles.window(key) for key in keys.tolist() if key >> 56 >= FINEST]
        blocks = kept.blocks if coarse else sorted({b for window in windows for b in kept.under(*window)})
        if kept.missing(blocks):
            progress.warn(self.texels.hint)
            kept.make(blocks, progress, jobs)
        if coarse:
            self.texels.hold(progress)

    @property
    def path(self) -> str:
        """The image."""
        return str(self.laid.layer.path)

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

    def sample(self, x: Array, y: Array, footprint_metres: Array) -> Colors:
        """The image's mean colours around positions; safe from any thread.

        Args:
            x, y: (n,) float64 in the terrain's CRS.
            footprint_metres: (n,) or one number: the width of the means on the ground.

        Returns:
            (n, 4) float32: linear RGB (not multiplied by opacity) and opacity, 0 where the image is not.
        """
        u, v, density = self.positions(x, y)
        self._leave_out(u, v)
        step = self.step
        width = np.ascontiguousarray(np.broadcast_to(footprint_metres, u.shape) * density / step)
        out = np.empty((len(u), 4), np.float32)
        u, v = self._in_window(u, v)
        if self.tiles is None:
            mipmap.look_up(self.texels.pool, self.texels.table, mipmap.curves()[0], u, v, width, out)
            return out
        axes = np.zeros((len(u), 4))
        axes[:, 0] = axes[:, 3] = width
        self.tiles.look_along(
            u, v, axes, self._widened(axes, np.zeros(len(u))), np.array([-np.inf, np.inf, -np.inf, np.inf]), out
        )
        return out

    def spread(self, x: Array, y: Array, ground: Array, least: Array) -> Colors:
        """The image's mean colours over the ground that pixels of a picture show; safe from any thread.

        Args:
            x, y: (n,) float64 in the terrain's CRS.
            ground: (n, 4) metres east and north that the ground moves by from a pixel to the next one right (0, 1) and
                to the next one below (2, 3): the axes of the footprint, whatever its shape.
            least: (n,) metres that the footprint's minor axis is taken to have at least.

        Returns:
            (n, 4) float32 as for ``sample``.
        """
        u, v, axes, floor, inside = self._footprints(x, y, ground, least)
        out = np.empty((len(u), 4), np.float32)
        if self.tiles is None:
            mipmap.look_along(
                self.texels.pool, self.texels.table, mipmap.curves()[0], u, v, axes, floor, inside, out
            )  # fmt: skip
        else:
            self.tiles.look_along(u, v, axes, self._widened(axes, floor), inside, out)
        return out

    def _footprints(
        self, x: Array, y: Array, ground: Array, least: Array
    ) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
        """What ``mipmap.look_along`` asks for: u, v, axes, floor, inside."""
        x, y = np.ascontiguousarray(x, np.float64), np.ascontiguousarray(y, np.float64)
        u, v, _ = self.positions(x, y)
        axes, floor = np.empty((len(x), 4)), np.empty(len(x))
        slopes_into(
            self._lattice.u, self._lattice.v, np.array(self._lattice.index[:6]), x, y, ground, least,
            1.0 / self.step, axes, floor,
        )  # fmt: skip
        return *self._in_window(u, v), axes, floor, np.array(self.texels.bounds()) / self.step

    def _widened(self, axes: Array, floor: Array) -> Array:
        """The least minor axis (n,) of footprints that are ``coarser``."""
        if not self.coarser:
            return floor
        p, r = axes[:, 0] ** 2 + axes[:, 2] ** 2, axes[:, 1] ** 2 + axes[:, 3] ** 2
        q = axes[:, 0] * axes[:, 1] + axes[:, 2] * axes[:, 3]
        major = np.sqrt(0.5 * (p + r + np.sqrt((p - r) ** 2 + 4 * q * q)))
        area = np.abs(axes[:, 0] * axes[:, 3] - axes[:, 1] * axes[:, 2])
        minor = np.maximum(np.maximum(area / np.maximum(major, 1e-30), floor), major / mipmap.TAPS)
        return np.asarray(np.maximum(minor, 1.0) * 2.0**self.coarser)

    def _in_window(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Positions in texels of the finest level there is, from the window's corner."""
        w = self.texels.window
        return (u - w.col0) / self.step, (v - w.row0) / self.step

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
