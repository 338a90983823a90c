"""The lines along which horizons are swept, and their stacks between bands (see ``sweep``)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from orograph.folders import scratch
from orograph.lighting.own_cell import OwnCell
from orograph.lighting.sweep_hulls import PAGE, Stacks

T = TypeVar("T")

_TIE = 1e-6
"""A line this close to a sample (in samples) goes through it, so that rounding does not choose its neighbours."""


def direction(azimuth: float) -> tuple[float, float]:
    """Unit vector (east, north) of an azimuth in degrees."""
    a = math.radians(azimuth % 360.0)
    return math.sin(a), math.cos(a)


class Lines:
    """The lines of one azimuth over a raster: line ``l`` crosses step i at lane l + shift[i] + part[i].

    Attributes:
        by_columns: steps are columns and lanes rows, or the other way round.
        backward: the light is at the end of increasing steps.
        scale: steps per metre. points: of a line in a step (``OwnCell``).
        only: the requested lines [first, last); None: all.
    """

    only: tuple[int, int] | None = None

    def __init__(self, index: int, azimuth: float, linear: NDArray[np.float64], shape: tuple[int, int]) -> None:
        across, down = (float(v) for v in np.linalg.solve(linear, direction(azimuth)))  # samples per metre to the light
        self.index = index
        self.by_columns = abs(across) >= abs(down)
        major, minor = (across, down) if self.by_columns else (down, across)
        self.lanes, self.steps = shape if self.by_columns else shape[::-1]
        self.backward, self.scale = major > 0, abs(major)
        tilt = minor / major
        if abs(tilt) * self.steps < _TIE:
            tilt = 0.0
        offset = tilt * np.arange(self.steps, dtype=np.float64)
        near = np.round(offset)
        offset = np.where(np.abs(offset - near) < _TIE, near, offset)
        self.tilt = tilt
        self.shift = np.floor(offset).astype(np.int64)
        self.part = (offset - self.shift).astype(np.float32)
        self.points = 2 if abs(tilt) > 0.5 and not self.part.any() else 1

    def position(self, step: int) -> int:
        """Steps between the light's end of the raster and a step."""
        return self.steps - 1 - step if self.backward else step

    def own_cell(self, step0: int, curvature: float) -> OwnCell:
        """The samples of own cells towards the light, for steps counted from ``step0``."""
        toward = 1 if self.backward else -1
        across = self.tilt * toward
        edge = (self.steps - 1 if self.backward else 0) - step0
        return OwnCell(
            np.float64(self.part.any()), toward, edge, int(np.sign(across)), np.float32(abs(across)), step0 & 1,
            self.points, np.float32(self.scale), np.float32(0.5 * curvature / self.scale),
        )  # fmt: skip

    def touched(self, step0: int, step1: int) -> tuple[int, int]:
        """The lines [first, last) that pass between or beside samples at these steps, and the line after the last."""
        ends = int(self.shift[step0]), int(self.shift[step1 - 1])
        first, last = -1 - max(ends), self.lanes - min(ends) + 1
        return (first, last) if self.only is None else (max(first, self.only[0]), min(last, self.only[1]))


class Pool:
    """The stacks of a share of an azimuth's lines, between two bands; call ``clear`` first."""

    def __init__(self) -> None:
        self.top = np.empty(0, np.int64)
        self.position = np.empty(0, np.int32)
        self.height = np.empty(0, np.float64)
        self.link = np.empty(0, np.int64)
        self.free = np.zeros(1, np.int64)
        self.release: Callable[[], None] | None = None

    def grow(self, pages: int, on_disk: bool) -> None:
        """Add at least ``pages`` free pages, and at least half of the current number."""
        before = len(self.link)
        after = before + max(pages, before // 2)
        position, height = self.position, self.height
        if on_disk:
            space, self.release = scratch(after * PAGE * 12)
            self.height = space[: after * PAGE * 8].view(np.float64)
            self.position = space[after * PAGE * 8 :].view(np.int32)
        else:
            self.height = np.empty(after * PAGE, np.float64)
            self.position = np.empty(after * PAGE, np.int32)
        self.height[: len(height)], self.position[: len(position)] = height, position
        self.link = np.append(self.link, np.full(after - before, -1))
        count = int(self.free[0])
        free = np.empty(after + 1, np.int64)
        free[1 : count + 1] = self.free[1 : count + 1]
        free[count + 1 : count + 1 + after - before] = np.arange(after - 1, before - 1, -1)
        free[0] = count + after - before
        self.free = free

    def clear(self, lines: int) -> None:
        """Begin with empty stacks for ``lines``, and one for the line before them."""
        self.top = np.full(lines + 1, -1, np.int64)
        self.free[0] = len(self.link)
        self.free[1:] = np.arange(len(self.link) - 1, -1, -1)

    @property
    def stacks(self) -> Stacks:
        """The stacks as kernels take them."""
        return Stacks(self.top, self.position, self.height, self.link, self.free)

    @property
    def size(self) -> int:
        """Bytes in memory."""
        return 0 if self.release else len(self.link) * (PAGE * 12 + 16)


def taken(spare: list[T], make: Callable[[], T]) -> T:
    """A spare pool, or a new one; from any thread."""
    try:
        return spare.pop()
    except IndexError:
        return make()
