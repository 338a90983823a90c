"""Detail by example: the fine part of real lidar on coarse ground with similar slope and curvature.

The data's lattice uses the exemplar's level of the same spacing. Each of its places begins at the best of some random
places of the exemplar, by slopes and curvature; then coordinates are corrected and doubled as in ``windows``, with the
guide as a part of the distance. A doubling adds the exemplar's difference from its own doubling by the same 4-point
rule: pieces blend through samples that they share, and where neighbours come from one piece, its own forms appear.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.synthesis.exemplar import Exemplar, smoothed
from orograph.synthesis.kernels import MARGIN, ORDER, corrected, upsampled
from orograph.synthesis.reference import folded, hashed
from orograph.synthesis.refining import (
    Floats,
    Integers,
    Lattice,
    Spread,
    Tiled,
    added,
    around,
    doubled,
    metres,
    roughness,
)  # fmt: skip
from orograph.synthesis.windows import Range

TRIES = 64
"""Places of the exemplar that are tried for each sample of the data."""

GAIN = 12
"""Maximum bits of a gain: the quanta of the data in one of the exemplar, times ``Steering.shift`` halvings."""

GROUND = 2.0**-10
"""Metres to which the ground under an exemplar is rounded before smoothing."""

Guide = NDArray[np.int16]


class Steering:
    """An exemplar on a lattice of data.

    Args:
        doublings: from the data's spacing to the exemplar's, at least 1, at most ``exemplar.top``.
        stretch: heights of the data per height of the exemplar: the ratio of their spacings.
        ground: heights under the exemplar, metres, to match; None: the exemplar is the ground itself.
    """

    def __init__(
        self, exemplar: Exemplar, data: Lattice, doublings: int, stretch: float, seed: int,
        ground: Floats | None = None,
    ) -> None:  # fmt: skip
        self.exemplar, self.data, self.doublings, self.seed = exemplar, data, doublings, seed & 0x7FFFFFFF
        self.metres = exemplar.quantum * stretch
        ratio = self.metres / data.quantum
        self.shift = min(max(GAIN - 1 - math.floor(math.log2(ratio)), 1), 30)
        self._gain = min(ratio * 2.0**self.shift, 2.0**GAIN)
        step = 1 << doublings
        if ground is None:
            smooth = exemplar.stack[exemplar.top - doublings] * self.metres
        else:
            level = np.rint(ground / GROUND).astype(np.int32)
            for n in range(doublings):
                level = smoothed(level, 1 << n)
            smooth = level * (GROUND * stretch)
        shape = _shape(np.asarray(smooth, np.float64), step, "symmetric")
        self._scale = np.array([341 / max(np.sqrt((one**2).mean()), 1e-12)
                                for one in (np.stack(shape[:2]), np.stack(shape[:2]), shape[2])])  # fmt: skip
        self.guides = self._guide(shape)
        fine = exemplar.stack[-1] * self.metres
        rest = fine - (np.roll(fine, step, 1) + np.roll(fine, -step, 1)) / 2
        self._tiles = [Tiled(partial(self._made, level)) for level in range(doublings + 1)]
        self.rough = float(np.sqrt((rest[:, step:-step] ** 2).mean()))

    def _guide(self, shape: tuple[Floats, Floats, Floats]) -> Guide:
        known = [np.nan_to_num(one * scale) for one, scale in zip(shape, self._scale)]
        return np.asarray(np.rint(np.clip(np.stack(known, -1), -1023, 1023)), np.int16)

    def guide(self, r: Range) -> Guide:
        """Properties of the data at places of their lattice: slopes along columns and rows, and curvature."""
        smooth = metres(self.data.read(r.wider(2)), self.data.quantum)
        for axis in (0, 1):
            a, b, c = (np.take(smooth, range(k, smooth.shape[axis] - 2 + k), axis) for k in range(3))
            smooth = (a + 2 * b + c) / 4
        return self._guide(_shape(smooth, 1, None))

    def coordinates(self, level: int, r: Range) -> NDArray[np.int32]:
        """Coordinates of a window of the lattice that is ``level`` doublings finer than the data."""
        found: NDArray[np.int32] = self._tiles[level].read(r)
        return found

    def _made(self, level: int, r: Range) -> NDArray[np.int32]:
        wide = r.wider(MARGIN)
        if level == 0:
            guide = self.guide(wide)
            chosen = self._begun(wide, guide)
        else:
            own = around(wide, level)
            guide = Spread(self.guide(own).astype(np.int32), own, level).at(wide).astype(np.int16)
            chosen = self._upsampled(level, wide)
        return np.ascontiguousarray(self._corrected(level, wide, chosen, guide)[r.within(wide)])

    def _upsampled(self, level: int, wide: Range) -> Any:
        """The coordinates of a level as a continuation of the coarser one's."""
        parents, (rows, cols) = wide.parents(), self.exemplar.shape
        chosen = np.empty((*wide.shape, 2), np.int32)
        upsampled(
            self.coordinates(level - 1, parents), parents.row0, parents.col0, wide.row0, wide.col0,
            1 << (self.doublings - level), 0, level, self.seed, rows, cols, chosen,
        )  # fmt: skip
        return chosen

    def _corrected(self, level: int, wide: Range, chosen: Any, guide: Guide) -> NDArray[np.int32]:
        """The coordinates of a level, corrected except in its margin."""
        e, other, n = self.exemplar, np.empty_like(chosen), self.at(level)
        for k, (row, col) in enumerate(ORDER):
            corrected(
                chosen, e.features[n], e.similar[n], e.step(n), 1, guide, self.guides, (row + wide.row0) & 1,
                (col + wide.col0) & 1, 2 * (k + 1), other,
            )  # fmt: skip
            chosen, other = other, chosen
        return np.asarray(chosen)

    def residual(self, level: int) -> Steered:
        """The residual of the doubling that is ``level`` doublings finer than the data."""
        return Steered(self, level)

    def at(self, level: int) -> int:
        """The exemplar's level that is ``level`` doublings finer than the data."""
        return self.exemplar.top - self.doublings + level

    def _begun(self, r: Range, guide: Guide) -> Any:
        """For each place, the best of some random places of the exemplar's plane."""
        rows, cols = self.exemplar.shape
        row, col = (a.ravel() for a in np.meshgrid(np.arange(*r[:2]), np.arange(*r[2:]), indexing="ij"))
        wanted = guide.reshape(-1, guide.shape[-1]).astype(np.int64)
        best, least = np.zeros((len(row), 2), np.int32), np.full(len(row), 1 << 40)
        for n in range(TRIES):
            h = hashed(col, row, self.seed + 104729 * (n + 1))
            x, y = (h & 0xFFFF) * (2 * cols) >> 16, (h >> 16) * (2 * rows) >> 16
            there = self.guides[folded(y, rows), folded(x, cols)].astype(np.int64)
            there[..., 0] *= np.where(x < cols, 1, -1)
            there[..., 1] *= np.where(y < rows, 1, -1)
            far = ((wanted - there) ** 2).sum(-1)
            better = far < least
            least[better], best[better, 0], best[better, 1] = far[better], x[better], y[better]
        return best.reshape(*r.shape, 2)

    def gain(self, r: Range, level: int) -> Spread:
        """The factor for the exemplar's detail, before ``shift`` halvings.

        It goes down to 0 where the data are much smoother than the exemplar, so that level ground, such as water, stays
        level.
        """
        own = around(r, level)
        sigma, _ = roughness(self.data, own)
        gate = np.clip(8 * sigma / max(self.rough, 1e-12), 0, 1)
        return Spread(np.rint(gate * self._gain).astype(np.int32), own, level)


class Steered:
    """The residual of one doubling, ``level`` doublings finer than the data."""

    def __init__(self, steering: Steering, level: int) -> None:
        self.steering, self.level = steering, level

    def refined(self, coarse: Integers, above: Range, r: Range) -> Integers:
        """See ``refining.Residual``."""
        s = self.steering
        chosen = s.coordinates(self.level, r).astype(np.int64)
        step, fine = 1 << (s.doublings - self.level), s.exemplar.stack[-1]
        rest = np.zeros(r.shape, np.int64)
        rows, cols = fine.shape

        def at(part: NDArray[np.int64], dx: int, dy: int) -> NDArray[np.int64]:
            return fine[folded(part[..., 1] + dy * step, rows), folded(part[..., 0] + dx * step, cols)].astype(np.int64)

        def between(part: NDArray[np.int64], odd: bool, dy: int) -> NDArray[np.int64]:
            """Sixteen times the row of the exemplar at ``dy`` steps."""
            if not odd:
                return 16 * at(part, 0, dy)
            return 9 * (at(part, -1, dy) + at(part, 1, dy)) - at(part, -3, dy) - at(part, 3, dy)

        for down, across in ((0, 1), (1, 0), (1, 1)):
            turn = slice((down + r.row0) & 1, None, 2), slice((across + r.col0) & 1, None, 2)
            part = chosen[turn]
            if down:
                near = between(part, bool(across), -1) + between(part, bool(across), 1)
                own = 9 * near - between(part, bool(across), -3) - between(part, bool(across), 3)
            else:
                own = 16 * between(part, True, 0)
            rest[turn] = at(part, 0, 0) - (own + 128 >> 8)
        scaled = rest * s.gain(r, self.level).at(r) + (1 << s.shift - 1) >> s.shift
        return added(doubled(coarse, above, r), scaled.astype(np.int32), r)


def _shape(heights: Floats, step: int, mode: str | None) -> tuple[Floats, Floats, Floats]:
    """Slopes along columns and rows and the curvature of heights, by differences over ``step`` samples.

    Args:
        mode: of ``np.pad`` at the borders; None: the outermost samples are only used for those inside.
    """
    h = heights if mode is None else np.pad(heights, step, mode=mode)  # type: ignore[call-overload]
    inner = h[step:-step, step:-step]
    west, east, north, south = (
        h[step:-step, : -2 * step], h[step:-step, 2 * step :], h[: -2 * step, step:-step], h[2 * step :, step:-step]
    )  # fmt: skip
    return (east - west) / 2, (south - north) / 2, west + east + north + south - 4 * inner
