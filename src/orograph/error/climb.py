"""From octave to octave upwards: a window's errors, holes and spheres, each octave's from those of the one below.

Blocks climb the small octaves, and the whole raster, subsampled, the larger ones (``diamonds``). Metres, float32.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph.error import ErrorKind, holes, monotony, octaves
from orograph.error.encode import Encoder
from orograph.error.parts import Floats, Part, Surface
from orograph.error.spheres import edge_spheres, square_spheres, tell_empty

NOTHING = np.float32(-1e-30)
"""The radius of an empty diamond whose sphere would be a point."""

NO_SUMS: Floats = np.zeros((2, 0, 0), np.float32)


class Climb:
    """Climbs octave by octave over a window, and keeps what the next one needs.

    Args:
        surface, kinds, rounding: as in ``Survey``.
        row0, col0: the window's first sample.
        errors, sums, states, radii, filled: of the octave below the first (none: it begins with octave 0). ``sums`` are
            kept only for wedgies, ``states`` only where there may be holes, ``radii`` only where they are wanted.
        gaps: whether samples may be missing; if not, only what the border squeezes may be empty.
    """

    def __init__(
        self,
        surface: Surface,
        kinds: tuple[ErrorKind, ...],
        rounding: Encoder | None,
        row0: int,
        col0: int,
        errors: dict[ErrorKind, Floats],
        sums: Floats | None,
        states: NDArray[np.uint8] | None,
        radii: Floats | None,
        filled: Floats,
        *,
        gaps: bool,
    ) -> None:
        self.surface, self.kinds, self.rounding, self.row0, self.col0 = surface, kinds, rounding, row0, col0
        self.errors, self.sums, self.states, self.radii, self.filled = errors, sums, states, radii, filled
        self.gaps = gaps
        self.found = self.seen = np.zeros((0, 0), np.uint8)

    def step(self, k: int, fine: Floats, z: Floats, exact: Floats | None = None) -> None:
        """Compute octave k's values.

        Args:
            fine: the window's samples (what it holds matters for k = 0 and for ``exact`` errors).
            z: its heights at spacing 2^k.
            exact: the octave's deviations, if they are known already.
        """
        rows, cols = self.surface.shape
        at = self.row0, self.col0, k, rows, cols
        half = z.shape[0] // 2, z.shape[1] // 2
        if self.states is not None:
            below, self.states = self.states, np.full((2, *half), holes.WHOLE, np.uint8)
            self.found = np.full(z.shape, holes.WHOLE, np.uint8)
            beyond = (at[i] + ((z.shape[i] - 1) << k) >= self.surface.shape[i] for i in (0, 1))
            # Without gaps all is whole that ends within the raster.
            known = (0, 0) if self.gaps else ((rows - 1 - self.row0) >> k, (cols - 1 - self.col0) >> k)
            self.seen = np.zeros((z.shape[0], -(-z.shape[1] // holes.RUN) + 2), np.uint8)
            holes.states(fine, below, k, self.states, self.found, self.seen, *known, *beyond)
        finer, self.errors = self.errors, {}
        for kind in self.kinds:
            e = exact if kind == "exact" and exact is not None else np.zeros(z.shape, np.float32)
            if kind == "exact":
                if exact is None:
                    octaves.deviations(fine, z, *at, e)
                holes.mark(self.found, self.seen, e)
                monotony.close(finer[kind], k, e)
            else:
                number, sums_below, sums = octaves.MIDPOINT, NO_SUMS, NO_SUMS
                if self.sums is not None and kind == "wedgie":
                    number, sums_below, sums = octaves.WEDGIE, self.sums, np.zeros((2, *half), np.float32)
                    self.sums = sums
                monotony.ascend(z, at, number, sums_below, finer[kind], self.found, self.seen, sums, e)
            self.errors[kind] = e
        if self.radii is not None:
            filled = self.surface.filled(z, self.row0, self.col0, k) if self.states is not None else z
            radii = np.empty(z.shape, np.float32)
            edge_spheres(filled, self.filled, self.radii, *at, self.surface.metric, radii)
            if self.rounding is not None:
                self.rounding.round_up(radii, k, squares=False)
            square_spheres(filled, *at, self.surface.metric, radii)
            if self.rounding is not None:
                self.rounding.round_up(radii, k, squares=True)
            self.radii, self.filled = radii, filled

    def part(self, k: int, i: int, j: int, area: tuple[slice, slice]) -> Part:
        """The values of octave k in an ``area`` whose first entry is (i, j)."""
        radii = self.radii
        if radii is not None and self.states is not None:
            radii = radii.copy()  # the next octave's spheres are around these, empty or not
            tell_empty(self.found, self.seen, NOTHING, radii)
        radii = None if radii is None else radii[area]
        return Part(k, i, j, {kind: e[area] for kind, e in self.errors.items()}, radii)


def halve(heights: Floats, end: tuple[bool, bool] = (True, True)) -> Floats:
    """Every second sample each way; where an axis is at the raster's ``end`` its last sample closes the row. A copy."""
    rows, cols = ((side + at_end + 1) // 2 for side, at_end in zip(heights.shape, end, strict=True))
    kept = heights[::2, ::2]
    result = np.empty((rows, cols), np.float32)
    result[: kept.shape[0], : kept.shape[1]] = kept
    if cols > kept.shape[1]:
        result[: kept.shape[0], -1] = heights[::2, -1]
    if rows > kept.shape[0]:
        result[-1, : kept.shape[1]] = heights[-1, ::2]
        if cols > kept.shape[1]:
            result[-1, -1] = heights[-1, -1]
    return result
