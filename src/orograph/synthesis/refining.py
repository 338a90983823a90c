"""Detail beyond the data: samples between those of a terrain, doubled again and again, with what is added at each.

A doubling keeps every sample and puts one between each two, by the 4-point rule (−1, 9, 9, −1)/16 along columns, then
rows (F. Losasso, H. Hoppe, *Geometry clipmaps*, SIGGRAPH 2004), and adds a residual to the new ones.
So lattices nest, as a terrain's levels do, and the data's own samples stay as they are. A residual is

- ``Fractal``: noise, scaled by the local variance of the residuals of the data themselves (what the 4-point rule misses
  of every second sample) and by how that falls from level to level: rough ground stays rough, level ground stays level;
- ``steered.Steered``: what an exemplar has beyond its own doubling.

Any window is the same to the bit wherever it begins. A sample beyond the raster is NaN; next to one the 4-point rule
goes on in a straight line, and between a height and a void there is none. Units: samples of a lattice, metres.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.store.terrain import Terrain
from orograph.synthesis.reference import hashed
from orograph.synthesis.windows import Range

Floats = NDArray[np.float64]

SIDE = 256
"""Samples of a side of the tiles that are kept."""

REACH = 26
"""Samples around one that its roughness is told by."""

HURST = 0.5, 1.5
"""Least and largest exponent by which residuals fall from level to level."""


class Lattice(Protocol):
    """Heights on a square lattice, metres; NaN beyond it."""

    def read(self, r: Range) -> Floats:
        """(rows, cols) float64 of half-open ranges, which may reach beyond."""


class Residual(Protocol):
    """What a doubling adds."""

    def read(self, r: Range) -> Floats:
        """(rows, cols) float64 metres of the doubled lattice, 0 at its even samples."""


class Tiled:
    """Windows of anything, put together of square tiles of which the last ones are kept.

    A lattice is read by the finer ones, by several windows of a picture and for its means: each tile is made once.

    Args:
        make: gives the array (rows, cols, ...) of a range; the same to the bit wherever that begins.
    """

    def __init__(self, make: Callable[[Range], NDArray[Any]], most: int = 100) -> None:
        self._make, self._most = make, most
        self._held: OrderedDict[tuple[int, int], NDArray[Any]] = OrderedDict()
        self._lock = threading.Lock()

    def read(self, r: Range) -> NDArray[Any]:
        parts = []
        for i in range(r.row0 // SIDE, -(-r.row1 // SIDE)):
            row = []
            for j in range(r.col0 // SIDE, -(-r.col1 // SIDE)):
                tile = Range(i * SIDE, (i + 1) * SIDE, j * SIDE, (j + 1) * SIDE)
                inner = Range(max(tile.row0, r.row0), min(tile.row1, r.row1), max(tile.col0, r.col0),
                              min(tile.col1, r.col1))  # fmt: skip
                row.append(self._tile(i, j, tile)[inner.within(tile)])
            parts.append(np.concatenate(row, 1))
        return np.concatenate(parts, 0)

    def _tile(self, i: int, j: int, tile: Range) -> NDArray[Any]:
        with self._lock:
            if (i, j) in self._held:
                self._held.move_to_end((i, j))
                return self._held[i, j]
        made = self._make(tile)
        with self._lock:
            self._held[i, j] = made
            while len(self._held) > self._most:
                self._held.popitem(last=False)
        return made


class Data:
    """The full resolution of a terrain as a lattice."""

    def __init__(self, terrain: Terrain) -> None:
        self.terrain = terrain

    def read(self, r: Range) -> Floats:
        rows, cols = self.terrain.grid.shape
        inner = Range(max(r.row0, 0), min(r.row1, rows), max(r.col0, 0), min(r.col1, cols))
        out = np.full(r.shape, np.nan)
        if inner.row0 < inner.row1 and inner.col0 < inner.col1:
            out[inner.within(r)] = self.terrain.read(0, *inner)
        return out


class Doubled:
    """A lattice twice as fine: sample 2i is sample i of the coarser one."""

    def __init__(self, coarser: Lattice, residual: Residual) -> None:
        tiles = Tiled(lambda r: doubled(coarser, r) + residual.read(r))
        self.read: Callable[[Range], Floats] = tiles.read


def doubled(coarser: Lattice, r: Range) -> Floats:
    """Ranges of the lattice that doubles another by the 4-point rule."""
    a, b, c, d = r
    above = Range((a >> 1) - 1, ((b - 1) >> 1) + 3, (c >> 1) - 1, ((d - 1) >> 1) + 3)
    wide = _between(coarser.read(above).T)[c - 2 * above.col0 - 2 : d - 2 * above.col0 - 2].T
    return np.ascontiguousarray(_between(wide)[a - 2 * above.row0 - 2 : b - 2 * above.row0 - 2])


def _between(rows: Floats) -> Floats:
    """Rows 1 to n − 2 of an array and the ones between them: 2(n − 3) rows."""
    a, b, c, d = rows[:-3], rows[1:-2], rows[2:-1], rows[3:]
    a = np.where(np.isnan(a), 2 * b - c, a)
    d = np.where(np.isnan(d), 2 * c - b, d)
    out = np.empty((2 * len(b), *rows.shape[1:]))
    out[::2], out[1::2] = b, (9 * (b + c) - (a + d)) / 16
    return out


class Fractal:
    """Noise that goes on as the roughness of a lattice does.

    Args:
        base: whose roughness it is. doublings: how much finer than it the residual's lattice is, at least 1.
        level: another number, other noise: one for each lattice. seed: as of a terrain.
    """

    def __init__(self, base: Lattice, doublings: int, level: int, seed: int) -> None:
        self.base, self.doublings = base, doublings
        self.salt = (seed & 0x7FFFFFFF) + 7919 * level

    def read(self, r: Range) -> Floats:
        n = self.doublings
        own = Range(r.row0 >> n, ((r.row1 - 1) >> n) + 2, r.col0 >> n, ((r.col1 - 1) >> n) + 2)
        sigma, hurst = roughness(self.base, own)
        at, shape = (np.arange(r.row0, r.row1), np.arange(r.col0, r.col1)), r.shape
        scale = spread(sigma * 2.0 ** (-n * hurst), at, own, n)
        col, row = np.broadcast_arrays(at[1][None, :], at[0][:, None])
        h = hashed(col, row, self.salt)
        # Four bytes of a hash: nearly a normal distribution, mean 510, variance 4 · (256² − 1)/12.
        noise = ((h & 255) + (h >> 8 & 255) + (h >> 16 & 255) + (h >> 24) - 510) / np.sqrt(21845.0)
        noise[(at[0] % 2 == 0)[:, None] & (at[1] % 2 == 0)[None, :]] = 0
        return np.asarray(noise * scale).reshape(shape)


def roughness(lattice: Lattice, r: Range) -> tuple[Floats, Floats]:
    """The root mean square of residuals around each sample, metres, and the exponent by which it falls per doubling.

    The residual of a sample is how far it lies from what every second sample makes of it; that of the coarser level
    likewise, from every fourth. Weights are the binomial filter's, some ten samples wide. Level ground has none.
    """
    wide = Range((r.row0 - REACH) & ~3, r.row1 + REACH, (r.col0 - REACH) & ~3, r.col1 + REACH)
    heights = lattice.read(wide)
    fine = _variance(heights)
    coarse = _variance(heights[::2, ::2])
    half = Range(wide.row0 >> 1, (wide.row0 >> 1) + coarse.shape[0], wide.col0 >> 1, (wide.col0 >> 1) + coarse.shape[1])
    at = np.arange(r.row0, r.row1), np.arange(r.col0, r.col1)
    here, above = fine[r.within(wide)], spread(coarse, at, half, 1)
    # Water is level though its shores are rough.
    around = heights[r.wider(1).within(wide)]
    rows, cols = r.shape
    near = [around[i : i + rows, j : j + cols] for i in range(3) for j in range(3)]
    here = np.where(np.all([np.isnan(one) | (one == near[4]) for one in near], 0), 0, here)
    with np.errstate(divide="ignore", invalid="ignore"):
        hurst = np.where(here > 0, np.log2(above / here) / 2, HURST[1])
    return np.sqrt(here), np.clip(np.nan_to_num(hurst, nan=HURST[1]), *HURST)


def _variance(heights: Floats) -> Floats:
    """Local mean squares of the residuals of a window that begins at an even row and column; 0 where none is known."""
    rows, cols = heights.shape
    even = heights[::2, ::2]
    wide = np.pad(even, ((1, 2), (1, 2)), constant_values=np.nan)
    rest = heights - _between(_between(wide.T).T)[:rows, :cols]
    known = ~np.isnan(rest)
    known[::2, ::2] = False
    weight, square = known.astype(float), np.where(known, rest, 0) ** 2
    for step in (1, 2):
        weight, square = _blurred(weight, step), _blurred(square, step)
    return np.where(weight > 1e-3, square / np.maximum(weight, 1e-3), 0)


def _blurred(values: Floats, step: int) -> Floats:
    for axis in (0, 1):
        n = values.shape[axis]
        wide = np.pad(values, [(2 * step, 2 * step) if k == axis else (0, 0) for k in (0, 1)])
        a, b, c, d, e = (np.take(wide, range(k * step, k * step + n), axis) for k in range(5))
        values = (a + e + 4 * (b + d) + 6 * c) / 16
    return values


def spread(values: Floats, at: tuple[NDArray[np.int64], NDArray[np.int64]], own: Range, doublings: int) -> Floats:
    """Values of a coarser lattice, which begin at ``own``, bilinear at rows and columns of a finer one."""
    for axis, (index, first) in enumerate(zip(at, (own.row0, own.col0))):
        base = (index >> doublings) - first
        t = (index & ((1 << doublings) - 1)) / (1 << doublings)
        t = t[:, None] if axis == 0 else t[None, :]
        values = np.take(values, base, axis) * (1 - t) + np.take(values, np.minimum(base + 1, values.shape[axis] - 1),
                                                                 axis) * t  # fmt: skip
    return values
