"""An image laid over the ground: its colours at positions in the terrain's CRS, filtered to the size of a pixel there.

Positions are brought to the image's CRS by interpolation in a lattice of exactly projected nodes over the terrain, as
fine as ``TOLERANCE`` demands; where no lattice is fine enough each position is projected by itself. Colours are
bilinear in the two levels of the image's pyramid that enclose the pixel's footprint and blended between them
(trilinear, Williams 1983), in linear light, weighted by opacity. An image without georeference is stretched over the
terrain's raster.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.errors import UsageError
from orograph.geo.grid import Grid, compose
from orograph.geo.transform import transformer
from orograph.geovis.image import LINEAR, Image

Array = NDArray[np.float64]
Colours = NDArray[np.float32]

TOLERANCE = 0.05
"""Image pixels by which the lattice may misplace a position."""

LEAST, LARGEST = 32 << 20, 256 << 20
"""Bytes that tiles of the image may take."""

LARGEST_WINDOW = 8 << 20
"""Pixels put together at once to sample from; positions that need more are halved."""


@kernel
def _between(nodes: Array, i: Array, j: Array, u: Array, v: Array) -> None:
    """Bilinear interpolation of nodes (rows, cols, 2) at (i, j) → u, v; NaN stays NaN."""
    rows, cols = nodes.shape[0], nodes.shape[1]
    for k in range(len(i)):
        if not (i[k] == i[k] and j[k] == j[k]):
            u[k] = v[k] = np.nan
            continue
        r = min(max(np.int64(np.floor(i[k])), 0), rows - 2)
        c = min(max(np.int64(np.floor(j[k])), 0), cols - 2)
        a, b = i[k] - r, j[k] - c
        for axis in range(2):
            low = nodes[r, c, axis] * (1 - b) + nodes[r, c + 1, axis] * b
            high = nodes[r + 1, c, axis] * (1 - b) + nodes[r + 1, c + 1, axis] * b
            if axis == 0:
                u[k] = low * (1 - a) + high * a
            else:
                v[k] = low * (1 - a) + high * a


@kernel
def _add(window, row0, col0, u, v, share, chosen, linear, out):  # type: ignore[no-untyped-def]
    """Add ``share`` of the bilinear colour at (u, v) of a level to ``out`` (n, 4), light times opacity."""
    rows, cols = window.shape[0], window.shape[1]
    for n in range(len(chosen)):
        k = chosen[n]
        x = min(max(u[n] - col0, 0.0), cols - 1.0)
        y = min(max(v[n] - row0, 0.0), rows - 1.0)
        j, i = np.int64(x), np.int64(y)
        fx, fy = x - j, y - i
        for a in range(2):
            for b in range(2):
                w = (fy if a else 1.0 - fy) * (fx if b else 1.0 - fx) * share[n]
                if w > 0.0:
                    pixel = window[min(i + a, rows - 1), min(j + b, cols - 1)]
                    w *= pixel[3] / 255.0
                    for c in range(3):
                        out[k, c] += w * linear[pixel[c]]
                    out[k, 3] += w


class Drape:
    """An image over a terrain.

    Attributes:
        image: the pixels. pixels_per_metre: image pixels (geometric mean of both ways) per metre of the terrain's CRS.
    """

    def __init__(self, image: Image, grid: Grid, locate: Callable[[Array, Array], tuple[Array, Array]]) -> None:
        self.image, self._grid, self._exact = image, grid, locate
        self._nodes = self._lattice()
        rows, cols = grid.shape
        x, y = (np.linspace(0, n - 1, 9) for n in (cols, rows))
        col, row = (a.ravel() for a in np.meshgrid(x, y))
        step = max(1.0, min(rows, cols) / 64)
        u, v = self._find(*grid.xy(col, row))
        with np.errstate(invalid="ignore"):
            u1, v1 = self._find(*grid.xy(col + step, row))
            u2, v2 = self._find(*grid.xy(col, row + step))
            area = np.abs((u1 - u) * (v2 - v) - (u2 - u) * (v1 - v))
        area = area[np.isfinite(area)]
        cell = step * step * abs(grid.transform.determinant)
        self.pixels_per_metre = float(np.sqrt(np.median(area) / cell)) if area.size else 1.0

    @classmethod
    def open(cls, path: str | os.PathLike[str], grid: Grid, max_bytes: int | None = None) -> Drape:
        """Lay the image at ``path`` over a terrain.

        Args:
            grid: the terrain's, in metres.
            max_bytes: of memory in all; a quarter of it, within ``LEAST`` and ``LARGEST``, is for tiles of the image.

        Raises:
            ReadError: the image cannot be read.
            UsageError: image and terrain do not meet, or there is no way between their CRSs.
        """
        image = Image(path, max(LEAST, min(LARGEST, (max_bytes or 4 * LARGEST) // 4)))
        rows, cols = image.shape
        if image.transform == Affine.identity():
            to_pixels = compose(Affine.scale(cols / grid.cols, rows / grid.rows), ~grid.transform)
            drape = cls(image, grid, lambda x, y: _moved(to_pixels, x, y))
        else:
            project = transformer(grid.crs, image.crs) if image.crs and grid.crs else None
            to_pixels = ~image.transform
            turn = (
                abs(360.0 / image.transform.a) if image.crs and image.crs.is_geographic and image.transform.a else 0.0
            )

            def find(x: Array, y: Array) -> tuple[Array, Array]:
                u, v = _moved(to_pixels, *(project(x, y) if project else (x, y)))
                if turn:  # longitudes count from −180, from 0 or on across 180
                    with np.errstate(invalid="ignore"):
                        u = u - turn * np.floor((u - (cols - 1) / 2) / turn + 0.5)
                return u, v

            drape = cls(image, grid, find)
        drape._check()
        return drape

    def sample(self, x: Array, y: Array, footprint: Array) -> Colours:
        """Colours at positions.

        Args:
            x, y: (n,) float64 in the terrain's CRS; NaN is nowhere. footprint: (n,) metres that a pixel covers.

        Returns:
            (n, 4) float32: linear red, green, blue, and opacity; all 0 outside the image.

        Raises:
            ReadError: the image is damaged.
        """
        out = np.zeros((len(x), 4), np.float32)
        u, v = self._find(np.asarray(x, np.float64), np.asarray(y, np.float64))
        rows, cols = self.image.shape
        inside = np.flatnonzero((u >= -0.5) & (u <= cols - 0.5) & (v >= -0.5) & (v <= rows - 0.5))
        scale = np.log2(np.maximum(footprint[inside] * self.pixels_per_metre, 1.0))
        scale = np.minimum(scale, self.image.levels - 1.0)
        whole = np.floor(scale).astype(np.int64)
        for level in range(self.image.levels):
            share = np.where(whole == level, 1 - (scale - whole), np.where(whole == level - 1, scale - whole, 0.0))
            taken = np.flatnonzero(share > 0)
            if len(taken):
                k = 2.0**level
                at = inside[taken]
                self._gather(level, (u[at] + 0.5) / k - 0.5, (v[at] + 0.5) / k - 0.5, share[taken], at, out)
        opaque = out[:, 3] > 0
        out[opaque, :3] /= out[opaque, 3:]
        return out

    def _gather(self, level: int, u: Array, v: Array, share: Array, at: NDArray[np.int64], out: Colours) -> None:
        rows, cols = self.image.size(level)
        row0, row1 = max(int(np.floor(v.min())), 0), min(int(np.floor(v.max())) + 2, rows)
        col0, col1 = max(int(np.floor(u.min())), 0), min(int(np.floor(u.max())) + 2, cols)
        if (row1 - row0) * (col1 - col0) > LARGEST_WINDOW and len(at) > 1:
            key = v if row1 - row0 > col1 - col0 else u
            low = key <= (key.min() + key.max()) / 2
            for part in (low, ~low):
                if part.any():
                    self._gather(level, u[part], v[part], share[part], at[part], out)
            return
        _add(self.image.window(level, row0, row1, col0, col1), row0, col0, u, v, share, at, LINEAR, out)

    def _find(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Image (col, row), 0 at the centre of the first pixel, of positions in the terrain's CRS."""
        if self._nodes is None:
            return self._exact(x, y)
        col, row = self._grid.index(x, y)
        rows, cols = self._nodes.shape[:2]
        u, v = np.empty(len(col)), np.empty(len(col))
        i = row * ((rows - 1) / max(self._grid.rows - 1, 1))
        j = col * ((cols - 1) / max(self._grid.cols - 1, 1))
        _between(self._nodes, i, j, u, v)
        return u, v

    def _lattice(self) -> Array | None:
        """Nodes (m, m, 2) over the terrain, the fewest that keep the tolerance; None if a thousand a side do not."""
        rows, cols = self._grid.shape
        m = 2
        while m <= 1025:
            nodes = self._project(np.linspace(0, cols - 1, m), np.linspace(0, rows - 1, m))
            if not np.isfinite(nodes).all():
                return None
            half = (np.linspace(0, n - 1, 2 * m - 1) for n in (cols, rows))
            finer = self._project(*half)
            across = (nodes[:, 1:] + nodes[:, :-1]) / 2 - finer[::2, 1::2]
            down = (nodes[1:] + nodes[:-1]) / 2 - finer[1::2, ::2]
            if max(np.abs(across).max(), np.abs(down).max()) <= TOLERANCE / 2:  # a cell errs by at most the sum of both
                return nodes
            m = 2 * m - 1
        return None

    def _project(self, cols: Array, rows: Array) -> Array:
        col, row = np.meshgrid(cols, rows)
        u, v = self._exact(*(a.ravel() for a in self._grid.xy(col, row)))
        return np.stack([u.reshape(col.shape), v.reshape(col.shape)], -1)

    def _check(self) -> None:
        """Refuse an image that lies elsewhere."""
        rows, cols = self._grid.shape
        where = self._project(np.linspace(0, cols - 1, 65), np.linspace(0, rows - 1, 65)).reshape(-1, 2)
        where = where[np.isfinite(where).all(1)]
        size = self.image.shape[1], self.image.shape[0]
        if len(where) == 0 or (where.max(0) < -0.5).any() or (where.min(0) > np.subtract(size, 0.5)).any():
            raise UsageError(
                "The image and the terrain do not meet: they lie in different places.",
                path=self.image.path,
                remedy="Check the image's CRS and extent (gdalinfo), or take an image of this area.",
            )


def _moved(transform: Affine, x: Array, y: Array) -> tuple[Array, Array]:
    """An affine map to pixel corners, brought to pixel centres; inf becomes NaN."""
    a, b, c, d, e, f = transform[:6]
    x, y = np.where(np.isfinite(x), x, np.nan), np.where(np.isfinite(y), y, np.nan)
    return a * x + b * y + c - 0.5, d * x + e * y + f - 0.5
