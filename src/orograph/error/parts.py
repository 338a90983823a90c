"""A survey's knowledge of its raster, and the pieces of its results.

Metres; indices are (row, col) of samples, or entries (i, j) of an octave: the vertex (i·2^k, j·2^k).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error import KINDS, ErrorKind

Floats = NDArray[np.float32]
Shape = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Surface:
    """What the spheres need to know about a raster.

    Attributes:
        shape: (rows, cols).
        metric: float64 (2, 2), metres of easting and northing per column and row.
        minimum: float32 (tile rows, tile cols), lowest height of each 256-cell tile, NaN where there is none.
        lowest: the lowest height of all (any number if nothing is valid).
    """

    shape: Shape
    metric: NDArray[np.float64]
    minimum: Floats
    lowest: float

    @property
    def n(self) -> int:
        """The exponent of the enclosing square's side, 2^n + 1 samples."""
        return max(max(self.shape) - 2, 0).bit_length()

    @property
    def squeezed(self) -> bool:
        """Whether the raster is less than the whole square."""
        side = (1 << self.n) + 1
        return self.shape != (side, side)

    def octave_shape(self, k: int) -> Shape:
        """Entries of an octave's arrays: the vertices whose diamonds reach into the raster."""
        rows, cols = self.shape
        return -((1 - rows) >> k) + 1, -((1 - cols) >> k) + 1

    def filled(self, heights: Floats, row0: int, col0: int, k: int) -> Floats:
        """Heights at spacing 2^k that begin at a sample, missing ones replaced by the lowest of their tile."""
        from orograph.error.spheres import fill  # compiled code, which readers of stores do not need

        table = np.where(np.isnan(self.minimum), np.float32(self.lowest), self.minimum)
        filled = np.empty(heights.shape, np.float32)
        fill(heights, row0, col0, k, *self.shape, table, filled)
        return filled


@dataclass(frozen=True, slots=True)
class Part:
    """The diamonds of one octave in a window: entries from (i, j) on.

    Attributes:
        octave, i, j: where.
        errors: kind to float32 (height, width).
        radii: float32, the same shape; negative where empty. None if they were not asked for.
    """

    octave: int
    i: int
    j: int
    errors: dict[ErrorKind, Floats]
    radii: Floats | None


@dataclass(frozen=True, slots=True)
class Rest:
    """What larger diamonds need from a block.

    Attributes:
        part: its diamonds of the last octave that blocks finish.
        sums, states: of that octave's square diamonds (see ``wedgies`` and ``holes``); None where they are of no use.
        raw: octave, first entry (i, j), deviations of the block's samples from the octave's coarse triangles.
    """

    part: Part
    sums: Floats | None
    states: NDArray[np.uint8] | None
    raw: list[tuple[int, int, int, Floats]]

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Its arrays by name, for storage."""
        part = self.part
        arrays: dict[str, NDArray[Any]] = {"at": np.array([part.octave, part.i, part.j])}
        arrays.update({f"errors.{kind}": e for kind, e in part.errors.items()})
        others = {"radii": part.radii, "sums": self.sums, "states": self.states}
        arrays.update({name: array for name, array in others.items() if array is not None})
        arrays.update({f"raw.{k}.{i}.{j}": raw for k, i, j, raw in self.raw})
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Rest:
        """The inverse of ``to_arrays``."""
        octave, i, j = (int(v) for v in arrays["at"])
        errors = {kind: arrays[f"errors.{kind}"] for kind in KINDS if f"errors.{kind}" in arrays}
        raw = []
        for name, array in arrays.items():
            if name.startswith("raw."):
                k, a, b = (int(v) for v in name.split(".")[1:])
                raw.append((k, a, b, array))
        return cls(Part(octave, i, j, errors, arrays.get("radii")), arrays.get("sums"), arrays.get("states"), raw)
