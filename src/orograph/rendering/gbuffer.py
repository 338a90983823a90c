"""What a pixel shows, before it has a colour: the G-buffer (Saito & Takahashi 1990, *Comprehensible rendering of 3-D
shapes*), and the surfaces that write it.

A ``Surface`` combines a selection (a mesh, windows for rays) with a camera, and writes; light, tint, layers, contours,
water and haze read, and never ask which surface wrote. A pixel's place on the ground is not stored: it follows from its
depth (``Projection.place``), to the last bits, and a picture of 50 million pixels would need 1.2 GB for it.

Depth is in metres along the viewing direction: the parameter of a ray whose direction has unit forward component.
Pixel positions are those of the *whole* picture, of which a tile is a part; the first pixel's centre is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Area = tuple[int, int, int, int]
"""Pixels of the whole picture: the first row, that after the last, the first column, that after the last."""

NONE = -1
"""The object of a sample that shows nothing."""


class Mark(IntFlag):
    """Bits of ``GBuffer.marks``, which qualify ground."""

    VOID_FILL = 1
    """A patch over missing data, not ground."""


@dataclass(frozen=True, slots=True, eq=False)
class GBuffer:
    """Samples of a picture. All arrays have the same shape: (rows, cols) of an area, or (n,) of single positions.

    Attributes:
        depth: float64, metres; NaN where nothing is.
        objects: int32, what was hit, by the surface's own numbers: a mesh's triangle, a window for rays; ``NONE``
            where nothing is. Only the surface that wrote it knows what it means.
        marks: uint8, bits of ``Mark``.
        values: float32, a number that the object carries, NaN where it has none; None: no object has any.
        over: what is transparent and lies in front of this: depth NaN where there is nothing, else less than the depth
            here, or over nothing. None: no sample has any.
    """

    depth: Array
    objects: NDArray[np.int32]
    marks: NDArray[np.uint8]
    values: NDArray[np.float32] | None = None
    over: GBuffer | None = None

    @property
    def void_fill(self) -> Array:
        """Depth of a patch over missing data in front of this, NaN where there is none."""
        return np.full(self.depth.shape, np.nan) if self.over is None else self.over.depth

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> GBuffer:
        """An empty G-buffer."""
        return cls(np.full(shape, np.nan), np.full(shape, NONE, np.int32), np.zeros(shape, np.uint8))


class Surface(Protocol):
    """What a camera sees of a selection. Results do not depend on the number of threads, nor a sample on other samples.

    Attributes:
        side: pixels, a power of two. ``at`` is fastest for positions within one square of this many pixels a side,
            counted from the picture's first pixel.
    """

    @property
    def side(self) -> int: ...

    def draw(self, area: Area) -> GBuffer:
        """The pixel centres of an area, by all threads: arrays (rows, cols), the same to the bit as those pixels in any
        other area."""
        ...

    def at(self, px: Array, py: Array) -> GBuffer:
        """Pixel positions (n,) inside the picture, in any order, in the calling thread: arrays (n,)."""
        ...
