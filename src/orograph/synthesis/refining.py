"""Detail beyond the data: a terrain's samples are doubled again and again, and each doubling adds a residual.

A doubling keeps every sample and puts one between each two, by the 4-point rule (−1, 9, 9, −1)/16 along columns, then
rows (F. Losasso, H. Hoppe, *Geometry clipmaps*, SIGGRAPH 2004), and adds a residual to the new ones. So lattices nest,
as a terrain's levels do, and the data's own samples stay unchanged. A residual is

- ``Fractal``: noise, scaled by the local variance of the residuals of the data themselves (the error of the 4-point
  rule for every second sample) and by its decrease from level to level: rough ground stays rough, level ground stays
  level;
- ``steered.Steered``: the difference of an exemplar from its own doubling.

Heights are integers in units of the terrain's ``quantum``, and a doubling uses only 32-bit integers, in NumPy or on a
GPU (``detail_on_gpu``, ``shaders/refining.wgsl``): both give the same result, to the bit, wherever a window begins. A
sample beyond the raster is ``MISSING``; next to one, the 4-point rule continues in a straight line, and there is no
sample between a height and a void. Units: samples of a lattice, quanta.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.store.terrain import Terrain
from orograph.synthesis.reference import hashed
from orograph.synthesis.windows import Range

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

MISSING = -(1 << 31)
"""Marks a missing height."""

HIGHEST = 27
"""Bits of the largest height: sums of a few of them fit 32 bits."""

NOISE = math.sqrt(21845.0)
"""The standard deviation of the noise of ``Fractal``: its variance is 4 · (256² − 1)/12."""

ROUGHEST = 1 << 20
"""Maximum scale of noise: with ten bits for a place between samples, it fits 32 bits."""

SIDE = 256
"""Samples along a side of the cached tiles."""

REACH = 26
"""Samples around one that determine its roughness."""

HURST = 0.5, 1.5
"""Smallest and largest exponent by which residuals fall from level to level."""


class Lattice(Protocol):
    """Heights on a square lattice.

    Attributes:
        quantum: metres, a power of two.
    """

    quantum: float

    def read(self, r: Range) -> Integers:
        """(rows, cols) int32 of half-open ranges, which may reach beyond the lattice: ``MISSING`` there."""


class Residual(Protocol):
    """What a doubling adds."""

    def refined(self, coarse: Integers, above: Range, r: Range) -> Integers:
        """Ranges of the doubled lattice.

        Args:
            coarse: the coarser lattice's ranges ``above``, which are ``parents_of(r)``.
        """


class Tiled:
    """Windows of anything, assembled from square tiles, the last of which are kept.

    Finer lattices, several windows of a picture, and means read a lattice; each tile is made once.

    Args:
        make: returns the array (rows, cols, ...) of a range; the same to the bit wherever that begins.
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
        highest = float(np.nanmax(np.abs(terrain.height_range), initial=1e-9))
        self.quantum = 2.0 ** (math.ceil(math.log2(highest)) - HIGHEST)

    def read(self, r: Range) -> Integers:
        rows, cols = self.terrain.grid.shape
        inner = Range(max(r.row0, 0), min(r.row1, rows), max(r.col0, 0), min(r.col1, cols))
        out = np.full(r.shape, MISSING, np.int32)
        if inner.row0 < inner.row1 and inner.col0 < inner.col1:
            heights = self.terrain.read(0, *inner).astype(np.float64)
            known = np.rint(np.nan_to_num(heights) / self.quantum).astype(np.int32)
            out[inner.within(r)] = np.where(np.isnan(heights), np.int32(MISSING), known)
        return out


def metres(heights: Integers, quantum: float) -> Floats:
    """Heights of a lattice in metres, NaN where there is none."""
    return np.where(heights == MISSING, np.nan, heights * quantum)


class Doubled:
    """A lattice twice as fine: sample 2i is sample i of the coarser one."""

    def __init__(self, coarser: Lattice, residual: Residual) -> None:
        self.quantum = coarser.quantum

        def made(r: Range) -> Integers:
            above = parents_of(r)
            return residual.refined(coarser.read(above), above, r)

        self.read: Callable[[Range], Integers] = Tiled(made).read


def parents_of(r: Range) -> Range:
    """The ranges of the coarser lattice that the 4-point rule needs."""
    return Range((r.row0 >> 1) - 1, ((r.row1 - 1) >> 1) + 3, (r.col0 >> 1) - 1, ((r.col1 - 1) >> 1) + 3)


def doubled(coarse: Integers, above: Range, r: Range) -> Integers:
    """The 4-point rule: see ``Residual.refined``."""
    a, b, c, d = r
    wide = _between(coarse.T)[c - 2 * above.col0 - 2 : d - 2 * above.col0 - 2].T
    return np.ascontiguousarray(_between(wide)[a - 2 * above.row0 - 2 : b - 2 * above.row0 - 2])


def _between(rows: Integers) -> Integers:
    """Rows 1 to n − 2 of an array and the ones between them: 2(n − 3) rows."""
    a, b, c, d = rows[:-3], rows[1:-2], rows[2:-1], rows[3:]
    with np.errstate(over="ignore"):  # of missing samples
        a = np.where(a == MISSING, 2 * b - c, a)
        d = np.where(d == MISSING, 2 * c - b, d)
        # (9 (b + c) − (a + d) + 8) >> 4, in 32 bits
        near, far = b + c, a + d
        middle = (near >> 1) + (8 * (near & 1) + near - far + 8 >> 4)
    out = np.empty((2 * len(b), *rows.shape[1:]), np.int32)
    out[::2], out[1::2] = b, np.where((b == MISSING) | (c == MISSING), np.int32(MISSING), middle)
    return out


class Smooth:
    """No residual: smooth interpolation."""

    def refined(self, coarse: Integers, above: Range, r: Range) -> Integers:
        return doubled(coarse, above, r)


class Spread(NamedTuple):
    """Integers at samples of a lattice, interpolated bilinearly on one that is ``doublings`` finer.

    Attributes:
        values: (rows, cols[, any]) int32, at most ``ROUGHEST``. own: their ranges.
    """

    values: Integers
    own: Range
    doublings: int

    def at(self, r: Range) -> Integers:
        """The numbers at ranges of the finer lattice."""
        values, n = self.values.astype(np.int32), self.doublings
        half = 1 << n >> 1
        for axis, (index, first) in enumerate(zip((np.arange(*r[:2]), np.arange(*r[2:])), self.own[::2])):
            base = (index >> n) - first
            t = (index & ((1 << n) - 1)).astype(np.int32)
            t = t.reshape([-1 if k == axis else 1 for k in range(values.ndim)])
            far = np.take(values, np.minimum(base + 1, values.shape[axis] - 1), axis)
            values = np.take(values, base, axis) * ((1 << n) - t) + far * t + half >> n
        return np.asarray(values, np.int32)


def around(r: Range, doublings: int) -> Range:
    """The ranges of the coarser lattice that surround those of the finer one."""
    return Range(r.row0 >> doublings, ((r.row1 - 1) >> doublings) + 2, r.col0 >> doublings,
                 ((r.col1 - 1) >> doublings) + 2)  # fmt: skip


class Fractal:
    """Noise that continues the roughness of a lattice.

    Args:
        base: the lattice. doublings: how much finer the residual's lattice is, at least 1.
        level: a different number for each lattice gives different noise. seed: as for a terrain.
    """

    def __init__(self, base: Lattice, doublings: int, level: int, seed: int) -> None:
        self.base, self.doublings = base, doublings
        self.salt = (seed & 0x7FFFFFFF) + 7919 * level
        # Scales fall with each doubling by √2 at least.
        self.shift = 3 + doublings // 2

    def scale(self, r: Range) -> Spread:
        """The amplitude of the noise around a range, before ``shift`` halvings."""
        own = around(r, self.doublings)
        sigma, hurst = roughness(self.base, own)
        scale = sigma * 2.0 ** (-self.doublings * hurst) * (2.0**self.shift / NOISE / self.base.quantum)
        return Spread(np.rint(np.minimum(scale, ROUGHEST)).astype(np.int32), own, self.doublings)

    def refined(self, coarse: Integers, above: Range, r: Range) -> Integers:
        row, col = np.meshgrid(np.arange(*r[:2]), np.arange(*r[2:]), indexing="ij")
        h = hashed(col, row, self.salt)
        # Four bytes of a hash: nearly a normal distribution, of mean 510.
        noise = ((h & 255) + (h >> 8 & 255) + (h >> 16 & 255) + (h >> 24) - 510).astype(np.int32)
        scaled = noise * self.scale(r).at(r) + (1 << self.shift - 1) >> self.shift
        return added(doubled(coarse, above, r), scaled, r)


def added(heights: Integers, residual: Integers, r: Range) -> Integers:
    """Doubled heights with the residual added to the new ones."""
    old = (np.arange(*r[:2]) % 2 == 0)[:, None] & (np.arange(*r[2:]) % 2 == 0)[None, :]
    return np.where(old | (heights == MISSING), heights, heights + residual).astype(np.int32)


def roughness(lattice: Lattice, r: Range) -> tuple[Floats, Floats]:
    """The root mean square of residuals around each sample, metres, and the exponent by which it falls per doubling.

    The residual of a sample is its distance from the interpolation of every second sample; that of the coarser level,
    from every fourth. Weights are the binomial filter's, some ten samples wide. Level ground has none.
    """
    wide = Range((r.row0 - REACH) & ~3, r.row1 + REACH, (r.col0 - REACH) & ~3, r.col1 + REACH)
    heights = metres(lattice.read(wide), lattice.quantum)
    fine = _variance(heights)
    coarse = _variance(heights[::2, ::2])
    half = Range(wide.row0 >> 1, (wide.row0 >> 1) + coarse.shape[0], wide.col0 >> 1, (wide.col0 >> 1) + coarse.shape[1])
    at = np.arange(r.row0, r.row1), np.arange(r.col0, r.col1)
    here, above = fine[r.within(wide)], _spread(coarse, at, half, 1)
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
    rest = heights - _middles(_middles(wide.T).T)[:rows, :cols]
    known = ~np.isnan(rest)
    known[::2, ::2] = False
    weight, square = known.astype(float), np.where(known, rest, 0) ** 2
    for step in (1, 2):
        weight, square = _blurred(weight, step), _blurred(square, step)
    return np.where(weight > 1e-3, square / np.maximum(weight, 1e-3), 0)


def _middles(rows: Floats) -> Floats:
    """``_between`` of metres."""
    a, b, c, d = rows[:-3], rows[1:-2], rows[2:-1], rows[3:]
    a = np.where(np.isnan(a), 2 * b - c, a)
    d = np.where(np.isnan(d), 2 * c - b, d)
    out = np.empty((2 * len(b), *rows.shape[1:]))
    out[::2], out[1::2] = b, (9 * (b + c) - (a + d)) / 16
    return out


def _blurred(values: Floats, step: int) -> Floats:
    for axis in (0, 1):
        n = values.shape[axis]
        wide = np.pad(values, [(2 * step, 2 * step) if k == axis else (0, 0) for k in (0, 1)])
        a, b, c, d, e = (np.take(wide, range(k * step, k * step + n), axis) for k in range(5))
        values = (a + e + 4 * (b + d) + 6 * c) / 16
    return values


def _spread(values: Floats, at: tuple[NDArray[np.int64], NDArray[np.int64]], own: Range, doublings: int) -> Floats:
    """Values of a coarser lattice, which begin at ``own``, bilinear at rows and columns of a finer one."""
    for axis, (index, first) in enumerate(zip(at, (own.row0, own.col0))):
        base = (index >> doublings) - first
        t = (index & ((1 << doublings) - 1)) / (1 << doublings)
        t = t[:, None] if axis == 0 else t[None, :]
        values = np.take(values, base, axis) * (1 - t) + np.take(values, np.minimum(base + 1, values.shape[axis] - 1),
                                                                 axis) * t  # fmt: skip
    return values
