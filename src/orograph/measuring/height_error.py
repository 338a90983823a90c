"""Errors of heights: how large, how far correlated, and terrains that might be the true one.

A height is the terrain's plus an error, normal with mean 0. Its standard deviation at a sample is

    sqrt(σ² + (h tan slope)²)

with σ the vertical accuracy (metres, a number or a raster) and h the horizontal one: on a slope, horizontally displaced
ground is too high or too low. Errors at two samples d metres apart are correlated by the Gaussian model, ρ = exp(−3
(d/R)²); R, the *range*, is where 5 % of the correlation is left (the practical range of geostatistics: Isaaks &
Srivastava 1989; Monte Carlo with correlated error: Fisher 1991, Heuvelink 1998, Oksanen & Sarjakoski 2005).

A draw is a moving average (Oliver 1995): white noise on a lattice of R / sqrt(12), averaged by a Gaussian of the same
standard deviation, whose weights at each sample have the sum of squares 1, so that the variance is 1 everywhere. Its
noise comes from a counter-based generator (Philox: Salmon et al. 2011) whose key is the seed and the number of the
draw, and whose counter is the place: any window of any draw can be computed separately and always has the same numbers.
If check points are given, draws agree with them (``conditioning``). Where R is less than ``INDEPENDENT`` of a cell,
errors are independent (correlated by less than 0.005).
"""

from __future__ import annotations

import functools
import inspect
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid
from orograph.lighting.normal import gradient
from orograph.lighting.raster import Canvas, rectangles
from orograph.measuring.conditioning import Conditioning, read_checks
from orograph.measuring.error_kernels import REACH, spread
from orograph.parallel import for_each
from orograph.store.terrain import TILE, Heights, Terrain, TileTable

if TYPE_CHECKING:
    from orograph.geovis.data.field import Field

Array = NDArray[np.float64]
Values = NDArray[np.float32]

NOISE = 64
"""Nodes along the side of a tile of noise."""
AHEAD = 16
"""Maximum number of nodes before the first sample."""
INDEPENDENT = 0.75
SQUARE = 1e-6
"""Limit of the cosine between rows and columns beyond which cells count as sheared."""
BEYOND = 8.0
"""Standard deviations that no error exceeds (probability 10⁻¹⁵)."""


@dataclass(frozen=True)
class HeightError:
    """How uncertain the heights of a terrain are.

    Attributes:
        sigma: standard deviation, metres: a number, or a raster of them (a file, a ``DataArray``, an array that spans
            the terrain).
        range: metres at which 5 % of the correlation is left; 0: errors of samples are independent.
        horizontal: standard deviation of the place, metres; adds (horizontal · tan slope)² to the variance.
        checks: check points with measured heights that all draws agree with: an array (n, 3) of easting, northing and
            height; or a table, file or ``Dataset`` of points. None: there are none.
        check_sigma: standard deviation of the measured heights, metres, if the points have none.

    Raises:
        UsageError: a number is negative or not finite.
    """

    sigma: Any = 0.0
    range: float = 0.0
    horizontal: float = 0.0
    checks: Any = None
    check_sigma: float = 0.0

    def __post_init__(self) -> None:
        if isinstance(self.sigma, os.PathLike):
            object.__setattr__(self, "sigma", os.fspath(self.sigma))
        numbers = {"range of errors": self.range, "horizontal accuracy": self.horizontal,
                "accuracy of check points": self.check_sigma}  # fmt: skip
        if self.is_number:
            numbers["standard deviation"] = self.sigma
        for name, value in numbers.items():
            if not (math.isfinite(value) and value >= 0):
                raise UsageError(f"The {name} must be 0 or more metres, not {value!r}.")

    @property
    def is_number(self) -> bool:
        """Whether σ is the same for all of the terrain."""
        return isinstance(self.sigma, int | float | np.integer | np.floating)

    @property
    def tags(self) -> dict[str, str]:
        """Metadata for a file."""
        sigma = f"{self.sigma:g} m" if self.is_number else str(self.sigma)[:200]
        found = {"sigma": sigma, "range": f"{self.range:g} m", "horizontal": f"{self.horizontal:g} m"}
        if self.checks is not None:
            source = getattr(self.checks, "source", self.checks)
            source = source if isinstance(source, str) else "an array or table"
            found |= {"check_points": str(source)[:200], "check_sigma": f"{self.check_sigma:g} m"}
        return found


NAMES = {"sigma": "sigma", "range": "range", "horizontal": "horizontal", "check_points": "checks",
         "check_sigma": "check_sigma"}  # fmt: skip
"""Arguments of measures → fields of ``HeightError``."""

T = TypeVar("T")


def takes_error(function: Callable[..., T]) -> Callable[..., T]:
    """Let a measure take the fields of a ``HeightError`` by name, instead of ``error``."""
    own = inspect.signature(function)
    named = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None) for name in NAMES]
    kinds = [one for one in own.parameters.values() if one.kind is not one.VAR_KEYWORD]
    rest = [one for one in own.parameters.values() if one.kind is one.VAR_KEYWORD]

    @functools.wraps(function)
    def taking(*args: Any, **options: Any) -> T:
        fields = {name: options.pop(name) for name in NAMES if options.get(name) is not None}
        if fields:
            if options.get("error") is not None:
                raise UsageError(f"An error is given, and `{next(iter(fields))}`, too.", remedy="Give one of the two.")
            options["error"] = HeightError(**{NAMES[name]: value for name, value in fields.items()})
        return function(*args, **options)

    vars(taking)["__signature__"] = own.replace(parameters=[*kinds, *named, *rest])
    return taking


class ErrorField:
    """Draws of the error of a terrain's heights.

    Args:
        terrain, error: the terrain and its error.
        seed: of all draws.
        max_memory: bytes; a map of standard deviations that takes more than a third of them goes to a scratch file.

    Attributes:
        sigma: metres: a number, or (rows, cols) float32.
        largest: of them. beyond: metres that no error exceeds.
        conditioning: makes draws agree with check points; None: there are none.

    Raises:
        UsageError: the cells are sheared, and errors correlated; the seed is negative.
        ReadError: a raster of standard deviations cannot be read, is negative or does not cover the heights.
    """

    def __init__(
        self, terrain: Terrain, error: HeightError, seed: int = 1, *, max_memory: int = 1 << 30, jobs: int | None = None
    ) -> None:
        if not isinstance(error, HeightError):
            raise UsageError(f"An error must be a HeightError, such as HeightError(sigma=2), not {error!r}.")
        if not 0 <= seed < 1 << 63:
            raise UsageError(f"A seed must be a whole number, 0 or more, not {seed}.")
        self.terrain, self.error, self.seed = terrain, error, seed
        (a, b), (d, e) = terrain.grid.linear
        cell_x, cell_y = terrain.grid.spacing
        self.independent = error.range < INDEPENDENT * min(cell_x, cell_y)
        if not self.independent and abs(a * b + d * e) > SQUARE * cell_x * cell_y:
            raise UsageError(
                "The terrain's cells are sheared; correlated errors need rows at right angles to columns.",
                remedy="Convert it to another grid (`crs`), or treat errors as independent (range 0).",
            )
        step = error.range / math.sqrt(12.0)
        self._step = (step / cell_y, step / cell_x)
        self._canvas: Canvas | None = None
        self.sigma: float | Values = float(error.sigma) if error.is_number else 0.0
        if not error.is_number or error.horizontal:
            size = 4 * terrain.grid.rows * terrain.grid.cols
            self._canvas = Canvas(1, terrain.grid.shape, 3 * size > max_memory)
            found = self._canvas.values[0]
            self._map(found, jobs)
            self.sigma = found
        known = np.asarray(self.sigma)
        self.largest = float(known) if known.ndim == 0 else float(np.nanmax(known, initial=0.0))
        self.conditioning = self._conditioning((cell_x, cell_y))
        moved = 0.0 if self.conditioning is None else self.conditioning.most
        self.beyond = (BEYOND + moved) * self.largest

    def _conditioning(self, cells: tuple[float, float]) -> Conditioning | None:
        if self.error.checks is None:
            return None
        checks = read_checks(self.error.checks, self.error.check_sigma, self.terrain)

        def sigma(rows: NDArray[np.int64], cols: NDArray[np.int64]) -> Array:
            if isinstance(self.sigma, float):
                return np.full(len(rows), self.sigma)
            return self.sigma[rows, cols].astype(np.float64)

        reach = 0.0 if self.independent else self.error.range
        return Conditioning(checks, self.terrain.grid.shape, cells, reach, sigma)

    def window(self, draw: int, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Errors (rows, cols) of samples, metres, of draw ``number``, counted from 0."""
        window = row0, row1, col0, col1
        out = self._unit(draw, *window)
        if self.conditioning is not None:
            out += self.conditioning.moved(draw, self.seed, lambda *w: self._unit(draw, *w), window)
        sigma = self.sigma if isinstance(self.sigma, float) else self.sigma[row0:row1, col0:col1]
        return np.asarray(out * sigma)

    def _unit(self, draw: int, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Errors (rows, cols) of variance 1, before conditioning on check points."""
        out = np.empty((row1 - row0, col1 - col0))
        if self.independent:
            noise = self._noise(draw, row0, row1, col0, col1)
            out[:] = noise
        elif out.size:
            down, across = self._step
            rows = self._nodes(row0, row1, down)
            cols = self._nodes(col0, col1, across)
            noise = self._noise(draw, *rows, *cols)
            spread(noise, rows[0], cols[0], row0, col0, down, across, out)
        return out

    def deviations(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Standard deviations (rows, cols) of samples, metres; conditional on the check points, if there are any."""
        if isinstance(self.sigma, float):
            found = np.full((row1 - row0, col1 - col0), self.sigma)
        else:
            found = self.sigma[row0:row1, col0:col1].astype(np.float64)
        return found if self.conditioning is None else found * self.conditioning.left((row0, row1, col0, col1))

    def mean(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Means (rows, cols) of errors, metres: 0 unless check points change them."""
        if self.conditioning is None:
            return np.zeros((row1 - row0, col1 - col0))
        sigma = self.sigma if isinstance(self.sigma, float) else self.sigma[row0:row1, col0:col1]
        return np.asarray(sigma * self.conditioning.mean((row0, row1, col0, col1)))

    @staticmethod
    def _nodes(first: int, last: int, step: float) -> tuple[int, int]:
        """The nodes needed for errors of samples [first, last): the first, and one after the last."""
        half = REACH // 2
        return math.floor(first / step) - half + 1, math.floor((last - 1) / step) + half + 1

    def _noise(self, draw: int, row0: int, row1: int, col0: int, col1: int) -> Array:
        """White noise (rows, cols) of nodes, from ``-AHEAD``."""
        out = np.empty((row1 - row0, col1 - col0))
        row0, row1, col0, col1 = (v + AHEAD for v in (row0, row1, col0, col1))
        key = np.array([self.seed, draw], np.uint64)
        for i in range(row0 // NOISE, -(-row1 // NOISE)):
            for j in range(col0 // NOISE, -(-col1 // NOISE)):
                counter = np.array([0, 0, i, j], np.uint64)
                tile = np.random.Generator(np.random.Philox(counter=counter, key=key)).standard_normal((NOISE, NOISE))
                r0, r1 = max(i * NOISE, row0), min((i + 1) * NOISE, row1)
                c0, c1 = max(j * NOISE, col0), min((j + 1) * NOISE, col1)
                out[r0 - row0 : r1 - row0, c0 - col0 : c1 - col0] = tile[
                    r0 - i * NOISE : r1 - i * NOISE, c0 - j * NOISE : c1 - j * NOISE
                ]
        return out

    def _map(self, out: Values, jobs: int | None) -> None:
        """Fill in the standard deviation of each sample; NaN where the height is unknown."""
        field = None if self.error.is_number else deviations_of(self.error.sigma, self.terrain.grid)
        windows = list(rectangles(self.terrain.grid.shape, TILE, 4 * TILE))
        lacking = np.zeros(len(windows), np.int64)

        def fill(k: int) -> None:
            row0, row1, col0, col1 = windows[k]
            heights, inner = around(self.terrain, *windows[k])
            sigma: Any = float(self.error.sigma) if field is None else sampled(field, self.terrain.grid, *windows[k])
            if self.error.horizontal:
                east, north = gradient(heights, self.terrain.grid.linear, 1)
                tangent = np.hypot(east[inner].astype(np.float64), north[inner])
                sigma = np.sqrt(sigma**2 + (self.error.horizontal * tangent) ** 2)
            missing = np.isnan(heights[inner])
            out[row0:row1, col0:col1] = np.where(missing, np.nan, sigma)
            lacking[k] = (np.isnan(sigma) & ~missing).sum()
            if self._canvas is not None and k % 16 == 15:
                self._canvas.release()

        for_each(fill, range(len(windows)), jobs)
        if lacking.any():
            raise ReadError(
                f"It has no value at {lacking.sum():,} samples of the terrain that have a height.",
                path=str(self.error.sigma) if isinstance(self.error.sigma, str) else None,
                remedy="Give one that covers the terrain, or clip the terrain to it (`bbox`, `clip`).",
            )  # fmt: skip


def around(terrain: Terrain, row0: int, row1: int, col0: int, col1: int) -> tuple[Heights, tuple[slice, slice]]:
    """Heights of a window with adjacent samples, and the position of the window in them."""
    r0, c0 = max(row0 - 1, 0), max(col0 - 1, 0)
    rows, cols = terrain.grid.shape
    heights = terrain.read(0, r0, min(row1 + 1, rows), c0, min(col1 + 1, cols))
    return heights, (slice(row0 - r0, row1 - r0), slice(col0 - c0, col1 - c0))


def deviations_of(source: Any, grid: Grid) -> Field:
    """A raster of standard deviations over a terrain."""
    from orograph.geovis.data.dataset import Uncertainty
    from orograph.geovis.data.reading import read

    field = read(Uncertainty(source), grid)
    lowest = float(np.nanmin(field.values))
    if lowest < 0:
        raise ReadError(
            f"A standard deviation cannot be negative, but the lowest is {lowest:g}.",
            path=source if isinstance(source, str) else None, remedy="Give another raster, or correct it.",
        )  # fmt: skip
    return field


def sampled(field: Field, grid: Grid, row0: int, row1: int, col0: int, col1: int) -> Array:
    from orograph.geovis.data.sampling import Positions

    return Positions.of(grid.window(row0, row1, col0, col1), field).values(field.values[0]).astype(np.float64)


class Drawn(Terrain):
    """A terrain with a drawn error: heights of level 0 only."""

    def __init__(self, terrain: Terrain, field: ErrorField, draw: int) -> None:
        self.grid, self.name, self.vertical = terrain.grid, terrain.name, terrain.vertical
        self._terrain, self._field, self._draw = terrain, field, draw

    @cached_property
    def height_range(self) -> tuple[float, float]:
        low, high = self._terrain.height_range
        return low - self._field.beyond, high + self._field.beyond

    @property
    def valid_fraction(self) -> float:
        return self._terrain.valid_fraction

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        if level:
            raise UsageError("A drawn terrain has level 0 only.")
        heights = self._terrain.read(0, row0, row1, col0, col1)
        return np.asarray(heights + self._field.window(self._draw, row0, row1, col0, col1), np.float32)

    def read_mean(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        return self.read(level, row0, row1, col0, col1)

    def tiles(self, level: int) -> TileTable:
        raise UsageError("A drawn terrain has no table of tiles.")
