"""An image over a terrain at any resolution: means of 2^k × 2^k of its pixels, whatever overviews the file has.

Texel (i, j) of level k is the mean of the pixels [i·2^k, (i+1)·2^k) × [j·2^k, (j+1)·2^k) of the file that exist, of
linear light weighted by opacity, in register with its upper left corner, as overviews are. Levels from ``base`` on are
made of one reading of the area and held in memory; what is finer is read from the file, or from its overviews, window
by window when it is asked for. Coarse levels of a large file without overviews are made once and kept (``coarse``).
Columns go on beyond the border of a file that goes once around the body. Every backend has its texels from here, so
that pictures agree. Units: pixels of the file, texels of a level.
"""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

from orograph.geovis import coarse, mipmap
from orograph.geovis.coarse import FINEST, CoarseLevels
from orograph.geovis.imagery import ImageWindow, read_into
from orograph.geovis.laying import Laid, empty
from orograph.progress import SILENT, Progress

Bytes = NDArray[np.uint8]


class Texels:
    """All levels of the part of an image that lies over a terrain.

    Attributes:
        laid: where it lies. base: the finest level that is held.
        window: the pixels that there are means of; every level begins at its corner. coarsest: the last level.
        kept: coarse levels of a large file without overviews; None: the file serves.
        pool, table: the levels that are held (see ``mipmap``), from ``base`` on; filled by ``hold``.
    """

    def __init__(self, laid: Laid, base: int) -> None:
        self.laid, self.base = laid, base
        self.window, self.coarsest = laid.aligned()
        self.pool, self.table = mipmap.pool_for(*self.shape(base))
        self.kept = CoarseLevels(laid) if coarse.wanted(laid) else None
        self._lock = threading.Lock()
        self._there = False

    def shape(self, k: int) -> tuple[int, int]:
        """Rows and columns of a level."""
        return shape_at(self.window, k)

    @property
    def held(self) -> bool:
        """Whether the levels from ``base`` on are in memory."""
        return self._there

    @property
    def hint(self) -> str:
        """What the user should know before coarse levels are made, a full sentence, or ""."""
        kept = self.kept
        if kept is None or kept.complete:
            return ""
        rows, cols = self.shape(0)
        return (
            f"{self.laid.layer.path} has no overviews: coarse levels are made from its {rows * cols / 1e6:,.0f} "
            f"million pixels, once, and kept in {kept.folder.parent} (gdaladdo makes overviews in the file itself)."
        )

    def hold(self, progress: Progress = SILENT) -> None:
        """Load the levels from ``base`` on into memory; safe from any thread.

        Raises:
            ReadError: the file cannot be read, or shows nothing there.
            StoreError: coarse levels cannot be kept.
        """
        with self._lock:
            if self._there:
                return
            w = self.window
            rows, cols = self.shape(self.base)
            finest = self.pool[: rows * cols].reshape(rows, cols, 4)
            if self.kept is not None and self.base >= FINEST:
                top, left = w.row0 >> self.base, w.col0 >> self.base
                finest[:] = self._made(self.kept, self.base, top, top + rows, left, left + cols, progress)
            else:
                window = ImageWindow(w.row0, w.row1, w.col0, w.col1, 1 << self.base)
                read_into(finest, self.laid.location, window, self.laid.bands)
            if not finest[..., 3].any():
                raise empty(self.laid.layer.path)
            mipmap.fill(self.pool, self.table)
            self._there = True

    def read(self, k: int, r0: int, r1: int, c0: int, c1: int) -> Bytes:
        """Texels [r0, r1) × [c0, c1) of a level, counted from the file's corner and within the file but for columns of
        one that goes around the body: (rows, cols, 4), sRGB and opacity. Beyond what is held its border goes on.

        Raises:
            ReadError: the file cannot be read there.
        """
        if k >= self.base:
            self.hold()
            base, rows, cols = (int(v) for v in self.table[k - self.base])
            level = self.pool[base : base + rows * cols].reshape(rows, cols, 4)
            i = np.clip(np.arange(r0, r1) - (self.window.row0 >> k), 0, rows - 1)
            j = np.clip(np.arange(c0, c1) - (self.window.col0 >> k), 0, cols - 1)
            return np.asarray(level[i[:, None], j[None, :]])
        if self.kept is not None and k >= FINEST:
            return self._made(self.kept, k, r0, r1, c0, c1)
        image = self.laid.placement.image
        last = c1 << k if self.laid.cyclic else min(c1 << k, image.cols)
        window = ImageWindow(r0 << k, min(r1 << k, image.rows), c0 << k, last, 1 << k)
        block = np.empty((*window.shape, 4), np.uint8)
        read_into(block, self.laid.location, window, self.laid.bands)
        return block

    @staticmethod
    def _made(
        kept: CoarseLevels, k: int, r0: int, r1: int, c0: int, c1: int, progress: Progress = SILENT
    ) -> Bytes:  # fmt: skip
        """Texels of a level that is kept; missing ones are made."""
        while True:
            kept.make(kept.under(k, r0, r1, c0, c1), progress)
            found, whole = kept.read(k, r0, r1, c0, c1)
            if whole:  # else a block was damaged
                return found

    def bounds(self) -> tuple[float, float, float, float]:
        """The first and last v and u of the image in pixels from the window's corner: beyond there is nothing."""
        placement, w = self.laid.placement, self.window
        if placement.stretched:
            return -np.inf, np.inf, -np.inf, np.inf
        across = (-np.inf, np.inf) if placement.cyclic else (-float(w.col0), float(placement.image.cols - w.col0))
        return -float(w.row0), float(placement.image.rows - w.row0), *across


def shape_at(window: ImageWindow, k: int) -> tuple[int, int]:
    """Rows and columns of texels of a level over a window of pixels."""
    return -(-(window.row1 - window.row0) >> k), -(-(window.col1 - window.col0) >> k)
