"""A terrain of any size by example, as a raster read by windows, for ``orograph synth --exemplar``."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.header import copyright_tags
from orograph.geo.grid import Grid
from orograph.progress import SILENT, Progress
from orograph.store.given import source_of
from orograph.store.source import HeightSource
from orograph.synthesis.exemplar import Exemplar, check, check_size
from orograph.synthesis.windows import Endless, Range

ORIGIN = 500_000.0, 5_000_000.0
"""CRS coordinates of the north-west corner."""


class ByExample:
    """A terrain modelled on another; has what a mosaic needs of a source (``grid``, ``name``, ``read``…).

    It has the spacing of the example's samples, and its range of heights.

    Args:
        exemplar: the example: whatever ``orograph.terrain`` takes that has at most ``exemplar.MOST`` samples, none
            missing.
        shape: (rows, cols), each at least 2. seed: any integer; another seed is another terrain.
        crs: a projected CRS; None: the example's.
        jitter, passes: see ``windows.Endless``.
        jobs: threads. progress: gets the progress of the preparation, some 15 s for a million samples.

    Raises:
        UsageError: the example is no good (see ``Exemplar.of``), or an option makes no sense.
        ReadError: it cannot be read.
    """

    def __init__(
        self,
        exemplar: Any,
        shape: tuple[int, int],
        seed: int = 1,
        *,
        crs: CRS | None = None,
        jitter: float | Sequence[float] | None = None,
        passes: float | Sequence[float] | None = None,
        jobs: int | None = None,
        progress: Progress = SILENT,
    ) -> None:
        source = source_of(exemplar, progress, called="synth")
        heights = example(source)
        self.endless = Endless(Exemplar.of(heights, source.name, jobs, progress), seed, jitter=jitter, passes=passes)
        self._digest = hashlib.sha256(np.ascontiguousarray(heights, np.float32).view(np.uint8).data).hexdigest()[:32]
        a, b, _, d, e, _ = source.grid.transform[:6]
        self.grid = Grid(shape, Affine(a, b, ORIGIN[0], d, e, ORIGIN[1]), crs or source.grid.crs)
        self.name: str = f"after {source.name} {seed}"
        self.vertical: str | None = None
        self.attribution: tuple[str, ...] = tuple(getattr(source, "attribution", ()))

    def read(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
        """Heights of a half-open window, float32 metres. Safe from any thread."""
        return self.endless.metres(self.endless.heights(Range(row0, row1, col0, col1)))

    def fingerprint(self) -> str:
        """The example's heights and the parameters, which define it."""
        e = self.endless
        return f"after {self._digest} {self.grid.shape} {tuple(self.grid.transform)} {e.seed} {e.reach} {e.passes}"

    def again(self) -> tuple[ExampleAgain, dict[str, NDArray[Any]]]:
        """How to open it in another process, and with which arrays (``store.handing``)."""
        e = self.endless
        how = ExampleAgain(
            self.grid, self.name, self._digest, e.seed, e.reach, e.passes, e.exemplar.quantum, e.exemplar.base
        )
        return how, {
            f"{name}.{level}": array
            for name in ("stack", "features", "similar") for level, array in enumerate(getattr(e.exemplar, name))
        }  # fmt: skip

    @property
    def tags(self) -> dict[str, str]:
        """Its description in a file."""
        return {"TIFFTAG_IMAGEDESCRIPTION": f"synthetic terrain {self.name}", **copyright_tags(self.attribution)}


class ExampleAgain(NamedTuple):
    """Opens a terrain by example in another process, which need not search the example for similar places.

    Attributes:
        grid, name, digest, seed, reach, passes: of the terrain. quantum, base: of its exemplar.
    """

    grid: Grid
    name: str
    digest: str
    seed: int
    reach: list[int]
    passes: list[int]
    quantum: float
    base: float

    def open(self, made: Mapping[str, NDArray[Any]]) -> ByExample:
        """The terrain. Args: made: of each level the exemplar's "stack", "features" and "similar"."""
        levels = range(len(self.reach))
        stack, features, similar = (
            tuple(made[f"{name}.{level}"] for level in levels) for name in ("stack", "features", "similar")
        )
        found = object.__new__(ByExample)
        found.endless = Endless(
            Exemplar(stack, features, similar, self.quantum, self.base), self.seed,
            jitter=[reach / 256 for reach in self.reach], passes=self.passes,
        )  # fmt: skip
        found.grid, found.name, found.vertical, found.attribution = self.grid, self.name, None, ()
        found._digest = self.digest
        return found


def example(source: HeightSource) -> NDArray[np.float32]:
    """All heights of a source that serves as an example.

    Raises:
        UsageError: see ``exemplar.check``.
    """
    rows, cols = source.grid.shape
    check_size((rows, cols), source.name)
    heights = source.read(0, rows, 0, cols)
    check(heights, source.name)
    return heights
