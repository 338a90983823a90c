"""The ground as every renderer sees it: ``Terrain``, a raster of heights at all resolutions, read by windows.

The raster is treated as the corner of a square of side 2^n + 1 samples; it is never padded in memory. Level k holds the
*nested* subsample, every 2^k-th sample, so that a coarse vertex is a fine vertex (Lindstrom & Pascucci 2002); where the
last sample of a level falls beyond the raster it repeats the raster's last one. Box means for shading are a second
pyramid. Over tiles of 256 × 256 cells each level has tables of the lowest and highest full-resolution sample, of the
valid fraction, and of a bound of the vertical distance between the full-resolution surface and the level's.

Heights are metres, float32, NaN where missing; indices are (row, col) from the north-west sample; windows are half
open.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.cards import Row, amount, card, extent_rows, heights_row, one_line, relief
from orograph.errors import StoreError, UsageError
from orograph.geo.chart import AffineChart
from orograph.geo.grid import Grid

if TYPE_CHECKING:
    from orograph.store.layers import StoredLayer

TILE = 256
"""Cells along the side of a tile, at every level."""

EXACT_SAMPLES = 4100 * 4100
"""Terrains of up to this many samples are read into memory, and drawn at full resolution unless a tolerance is
given."""

Heights = NDArray[np.float32]
Shape = tuple[int, int]


def exponent(shape: Shape) -> int:
    """The smallest n with 2^n + 1 ≥ both sides."""
    return max(max(shape) - 2, 0).bit_length()


def level_count(shape: Shape) -> int:
    """The number of nested levels: the coarsest has at most 257 samples per side."""
    return max(1, exponent(shape) - TILE.bit_length() + 2)


def level_shape(shape: Shape, level: int) -> Shape:
    """Samples of a nested level: ceil((side - 1) / 2^level) + 1 along each side."""
    rows, cols = shape
    return -((1 - rows) >> level) + 1, -((1 - cols) >> level) + 1


def diamond_shape(shape: Shape, level: int) -> Shape:
    """Entries of a level's diamonds: one per sample, at the top level those of the whole padded square."""
    top = level_count(shape) - 1
    side = (1 << (exponent(shape) - top)) + 1
    return (side, side) if level == top else level_shape(shape, level)


def mean_shape(shape: Shape, level: int) -> Shape:
    """Blocks of 2^level × 2^level samples that cover the raster."""
    rows, cols = shape
    return -(-rows >> level), -(-cols >> level)


def tile_shape(shape: Shape, level: int) -> Shape:
    """Tiles that cover the cells of a level (at least one along each axis, even for a single row of samples)."""
    rows, cols = level_shape(shape, level)
    return max(1, -(-(rows - 1) // TILE)), max(1, -(-(cols - 1) // TILE))


@runtime_checkable
class Samples(Protocol):
    """The original samples of a terrain, on their own lattice."""

    def heights_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Heights (n,) at places (n,) in the terrain's CRS, bilinear between the samples; NaN where there is none."""


@dataclass(frozen=True, slots=True)
class TileTable:
    """Facts about each tile of a level, as arrays of shape (tile rows, tile cols).

    Attributes:
        minimum: float32, the lowest full-resolution sample under the tile, its borders included; NaN if there is none.
        maximum: float32, the highest.
        error: float32, metres; at least the vertical distance between the full-resolution surface and the level's
            surface at every point of the tile where both exist.
        valid: uint8, 0 if no full-resolution sample under the tile is valid, 1 if some are, 2 if all are.
    """

    minimum: Heights
    maximum: Heights
    error: Heights
    valid: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Resampled:
    """The loss of a terrain when it was resampled, metres; nan where nothing could be compared.

    ``store.resampling`` has the definitions.

    Attributes:
        rms, largest: of the deviations of the surface from its original samples, where there is a surface.
        summit_loss: the largest loss of a summit, never more than ``largest``.
        highest: the highest of those samples; highest_loss: its loss.
    """

    rms: float
    largest: float
    summit_loss: float
    highest: float
    highest_loss: float

    def __str__(self) -> str:
        if math.isnan(self.rms):
            return "no sample of the source has ground beside it"
        return (
            f"{self.rms:.2g} m rms from the source's samples, at most {self.largest:.3g} m; summits lose at most "
            f"{self.summit_loss:.3g} m, the highest {self.highest_loss:.3g} of {self.highest:.6g} m"
        )

    def to_json(self) -> dict[str, float | None]:
        return {name: None if math.isnan(value) else value for name, value in asdict(self).items()}

    @classmethod
    def from_json(cls, record: dict[str, float | None]) -> Resampled:
        return cls(**{name: math.nan if value is None else value for name, value in record.items()})


class Terrain(ABC):
    """An elevation raster at all its resolutions. Reading is safe from any number of threads.

    Attributes:
        grid: level 0, the real raster, projected, in metres (or without CRS).
        name: for titles.
        vertical: name of the vertical datum, or None if unknown.
        attribution: the credit that the makers of its heights ask for; pictures carry it.
    """

    grid: Grid
    name: str
    vertical: str | None
    attribution: tuple[str, ...] = ()
    remote: bool = False
    """Whether it is read over a network: many concurrent reads take hardly longer than one."""
    samples: Samples | None = None
    """The original samples, while they are available; None if only its own are known."""
    resampled: Resampled | None = None
    """The distance from its original samples; None if it has these, or it was never measured."""

    @property
    @abstractmethod
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest valid sample, metres; (nan, nan) if none is valid."""

    @property
    @abstractmethod
    def valid_fraction(self) -> float:
        """The part of all samples that is valid, 0 to 1."""

    @property
    def chart(self) -> AffineChart:
        """The map from samples to the world: flat terrain has one affine chart."""
        return AffineChart(self.grid)

    @property
    def n(self) -> int:
        """The exponent of the enclosing square's side, 2^n + 1 samples."""
        return exponent(self.grid.shape)

    @property
    def side(self) -> int:
        """Samples along the enclosing square, 2^n + 1."""
        return (1 << self.n) + 1

    @property
    def levels(self) -> int:
        """The number of nested levels; level 0 is the raster itself."""
        return level_count(self.grid.shape)

    def shape(self, level: int) -> Shape:
        """(rows, cols) of a nested level."""
        return level_shape(self.grid.shape, self._check(level))

    def mean_shape(self, level: int) -> Shape:
        """(rows, cols) of a level of box means."""
        return mean_shape(self.grid.shape, self._check(level))

    @abstractmethod
    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Nested heights ``[row0, row1) × [col0, col1)`` of ``level``; the window lies inside ``shape(level)``.

        Sample (i, j) is the raster's sample (min(i·2^level, rows − 1), min(j·2^level, cols − 1)). The array may be
        shared with a cache: it is read-only; copy it to change it.

        Raises:
            UsageError: there is no such level, or the window is not inside it.
            DamagedChunkError: a chunk of a store fails its checksum.
        """

    @abstractmethod
    def read_mean(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Means of the valid samples of each 2^level × 2^level block, NaN where there is none; level 0 is the raster.

        Raises: as ``read``, with ``mean_shape(level)``.
        """

    @abstractmethod
    def tiles(self, level: int) -> TileTable:
        """The tile table of a level."""

    def diamond_shape(self, level: int) -> Shape:
        """(rows, cols) of the arrays of diamonds: ``shape(level)``, at the top level the whole padded square."""
        return diamond_shape(self.grid.shape, self._check(level))

    def derived(self, name: str, **options: Any) -> Any:
        """A reader of data derived from the heights: read from a store, or computed now for a raster in memory.

        Args:
            name: "diamonds" (``error``), "patches" (``error``, ``legs``)…; see ``store.registry``.
            options: the options it must have been made with.

        Raises:
            UsageError: there is no such kind, error or option.
            StoreError: the store was built without it.
        """
        raise UsageError(f"{self.name} has no {name}.")

    def has(self, name: str, **options: Any) -> bool:
        """Whether a store holds such data, so that ``derived`` need not compute them."""
        return False

    @property
    def layers(self) -> tuple[str, ...]:
        """The names of the layers it has (``layer``)."""
        return ()

    def layer(self, name: str, **options: Any) -> StoredLayer:
        """A raster on the terrain's grid at every level, such as baked light (``orograph bake``).

        Args:
            name: "sky-view-factor", "aperture"…
            options: the options it must have been made with (``radius=600.0``, ``azimuths=64``…).

        Raises:
            StoreError: it has no such layer, or one made with other options or from other heights.
        """
        there = f"; it has {', '.join(self.layers)}" if self.layers else ""
        raise StoreError(
            f"This terrain has no layer {name!r}{there}.",
            path=self.name,
            remedy=f"Bake it into a store: `orograph.bake(store, [{name!r}])`.",
        )

    def close(self) -> None:  # noqa: B027 (most terrains have nothing to close)
        """Close files and caches; the terrain cannot be read afterwards."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _rows(self) -> list[Row]:
        rows = [*extent_rows(self.grid), heights_row(*self.height_range, self.vertical)]
        levels = f"{self.levels} level{'s' if self.levels > 1 else ''}"
        return [*rows, ("levels", levels), *self._kept()]

    def _kept(self) -> list[Row]:
        """Its location and size."""
        return [("memory", amount(4 * self.grid.rows * self.grid.cols))]

    def __repr__(self) -> str:
        return one_line(type(self).__name__, self.name, self._rows())

    def _repr_html_(self) -> str:
        level = self.levels - 1
        rows, cols = self.shape(level)
        small = relief(self.read(level, 0, rows, 0, cols), self.grid, 2.0**level)
        return card("terrain", self.name, self._rows(), small)

    def _check(self, level: int) -> int:
        if not 0 <= level < self.levels:
            raise UsageError(f"Terrain {self.name!r} has levels 0 to {self.levels - 1}, not {level}.")
        return level

    def check_window(self, shape: Shape, row0: int, row1: int, col0: int, col1: int) -> None:
        """Raise UsageError unless a window is inside an array of that shape."""
        if not (0 <= row0 <= row1 <= shape[0] and 0 <= col0 <= col1 <= shape[1]):
            raise UsageError(
                f"The window of rows {row0} to {row1} and columns {col0} to {col1} is not inside "
                f"the {shape[0]}×{shape[1]} samples of this level of {self.name!r}."
            )
