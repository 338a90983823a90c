"""Draws of errors that agree with check points: conditional simulation by kriging (Journel & Huijbregts 1978, VII.C).

An unconditional draw u and simple kriging with its own covariance give

    u_c(x) = u(x) + c(x)ᵀ C⁻¹ (e − H u − η)

where e are the errors at the check points (measured minus the terrain's surface there), H takes the errors of
samples to the surface at those places (linear within triangles), C = H Σ Hᵀ + τ² the covariance of what is found, and η
normal noise of the check points' own accuracy τ. Mean and covariance of u_c are those of the errors given e (Chilès &
Delfiner 2012, 7.3), and where τ is 0 each drawn surface passes through the check points. Σ is that of
``height_error``; ρ counts as 0 beyond 2 R (there it is below 1e-5).

Weights belong to samples, so any window of a draw is made by itself. Units: metres; places in sample coordinates.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import ReadError, UsageError
from orograph.measuring.ground import heights
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

MOST = 2000
"""Maximum number of check points: their covariances are held in memory and solved once."""

NUGGET = 1e-6
"""Added to the variance of each check point, relative to the largest variance, so that two at the same place can be
solved for. A drawn surface passes within a thousandth of σ of a check point."""

FAR = 2.0
"""Ranges beyond which errors are not correlated."""

HELD = 64
"""Number of draws whose weights are held."""

CALLED = ("height", "elevation", "z", "h", "ele", "altitude", "alt")
"""Usual names of a column of measured heights."""


class Checks(NamedTuple):
    """Check points on a terrain.

    Attributes:
        x, y: (n,) sample coordinates. found: (n,) measured heights minus the surface's. tau: (n,) standard deviations
            of the measured heights.
    """

    x: Array
    y: Array
    found: Array
    tau: Array


def read_checks(source: Any, tau: float, terrain: Terrain) -> Checks:
    """Check points from an array, a table, a file or a ``Dataset``.

    An array is (n, 3): easting, northing and height in the terrain's CRS and heights. The others have points with
    measured heights, and optionally their uncertainty.

    Raises:
        ReadError: none is on ground. UsageError: there are too many, or no heights.
    """
    if isinstance(source, np.ndarray):
        if source.ndim != 2 or source.shape[1] != 3:
            raise UsageError(f"Check points must be an array (n, 3), not {source.shape}.")
        east, north, high = source.astype(np.float64).T
        own, name = np.full(len(east), tau), "the check points"
    else:
        east, north, high, own, name = _of_points(source, tau, terrain)
    col, row = terrain.grid.index(east, north)
    rows, cols = terrain.grid.shape
    on = np.isfinite(high) & (col >= 0) & (row >= 0) & (col <= cols - 1) & (row <= rows - 1)
    col, row, high, own = col[on], row[on], high[on], own[on]
    found = high - heights(terrain, col, row) if len(col) else high
    known = np.isfinite(found)
    if not known.any():
        raise ReadError("None of the check points is on the ground.", path=name, remedy="Give points of the same area.")
    if known.sum() > MOST:
        raise UsageError(f"There are {known.sum():,} check points, and at most {MOST:,} can be solved for.",
                         remedy="Leave some out.")  # fmt: skip
    return Checks(col[known], row[known], found[known], own[known])


def _of_points(source: Any, tau: float, terrain: Terrain) -> tuple[Array, Array, Array, Array, str]:
    from orograph.geovis.data.dataset import Dataset
    from orograph.geovis.data.features import has_features, read_features
    from orograph.geovis.data.points import columns_of, columns_of_features, read_points

    given = source if isinstance(source, Dataset) else Dataset(source)
    name = given.source if isinstance(given.source, str) else "the check points"
    if given.variable is None:
        features = has_features(given.source)
        columns = columns_of_features(read_features(given, terrain.grid)) if features else columns_of(given.source)
        known = [k for k, v in columns[0].items() if k.lower() in CALLED and np.isfinite(v).any()]
        if len(known) != 1:
            listed = " and ".join(known) or "none"
            raise UsageError(f"It is unclear which column holds their heights; there is {listed}.", path=name,
                             remedy="Name it: variable=NAME.")  # fmt: skip
        given = given.but(variable=known[0])
    points = read_points(given, terrain.grid)
    own = np.full(len(points.x), tau) if points.sigma is None else points.sigma
    return points.x, points.y, points.values, own, name


class Conditioning:
    """Makes draws agree with check points.

    Args:
        checks: the points. shape: of the terrain. cells: metres from column to column and from row to row. reach: the
            range R, metres; 0: errors are independent. sigma: standard deviations at samples (rows (n,), columns (n,)).

    Attributes:
        most: maximum correction of a draw, in standard deviations.
    """

    def __init__(
        self, checks: Checks, shape: tuple[int, int], cells: tuple[float, float], reach: float,
        sigma: Callable[[Numbers, Numbers], Array],
    ) -> None:  # fmt: skip
        self.checks, self._reach, self._cells = checks, reach, cells
        self.row, self.col, weights = corner_weights(checks.x, checks.y, shape)
        size = np.nan_to_num(sigma(self.row.ravel(), self.col.ravel()).reshape(self.row.shape))
        self._part = weights * size  # (n, 4): the effect of a unit error of each corner's sample at the check point
        places = np.stack([self.row.ravel(), self.col.ravel()], 1)
        self.samples, of = np.unique(places, axis=0, return_inverse=True)
        n = len(checks.x)
        spread = np.zeros((n, len(self.samples)))
        np.add.at(spread, (np.repeat(np.arange(n), 4), of.ravel()), self._part.ravel())
        self._spread = spread
        r, c = self.samples.T.astype(np.float64)
        rho = self._factor(r[:, None] - r[None], 1) * self._factor(c[:, None] - c[None], 0)
        covariance = spread @ rho @ spread.T
        nugget = NUGGET * max(float(size.max(initial=0.0)) ** 2, 1e-12)
        covariance[np.diag_indices(n)] += checks.tau**2 + nugget
        self._inverse = np.linalg.inv(covariance)
        bound = np.abs(checks.found) + 8 * (np.abs(self._part).sum(1) + checks.tau)
        self.most = float((np.abs(spread).T @ (np.abs(self._inverse) @ bound)).sum())
        self._weights: dict[int, Array] = {}
        self._lock = threading.Lock()

    def _factor(self, samples: NDArray[Any], axis: int) -> Array:
        """The factor of the correlation of two samples at a distance along an axis (0: columns, 1: rows)."""
        if not self._reach:
            return np.asarray(samples == 0, np.float64)
        d = np.asarray(samples, np.float64) * self._cells[axis] / self._reach
        return np.where(np.abs(d) <= FAR, np.exp(-3 * d * d), 0.0)

    def moved(
        self, draw: int, seed: int, unit: Callable[[int, int, int, int], Array], window: tuple[int, ...]
    ) -> Array:
        """The correction (rows, cols) of a draw's unit errors.

        Args:
            unit: unit errors of the draw at the samples of a window.
        """
        with self._lock:
            weights = self._weights.get(draw)
        if weights is None:
            drawn = np.empty(len(self.samples))
            for k, (row, col) in enumerate(self.samples.tolist()):
                drawn[k] = unit(row, row + 1, col, col + 1)[0, 0]
            counter = np.array([0, 1, 0, 0], np.uint64)
            rng = np.random.Generator(np.random.Philox(counter=counter, key=np.array([seed, draw], np.uint64)))
            noise = self.checks.tau * rng.standard_normal(len(self.checks.x))
            weights = self._solved(self.checks.found - self._spread @ drawn - noise)
            with self._lock:
                while len(self._weights) >= HELD:
                    self._weights.pop(next(iter(self._weights)))
                self._weights[draw] = weights
        return self._laid(weights, window)

    def mean(self, window: tuple[int, ...]) -> Array:
        """The mean (rows, cols) of errors given the check points, in standard deviations."""
        return self._laid(self._solved(self.checks.found), window)

    def left(self, window: tuple[int, ...]) -> Array:
        """The remaining part (rows, cols) of the standard deviation: 0 to 1."""
        row0, row1, col0, col1 = window
        across = self._factor(np.arange(col0, col1)[None, :] - self.samples[:, 1, None], 0)
        out = np.empty((row1 - row0, col1 - col0))
        for i in range(row0, row1):
            down = self._factor(np.asarray(i - self.samples[:, 0], np.float64), 1)
            covariance = self._spread @ (down[:, None] * across)
            out[i - row0] = 1 - (covariance * (self._inverse @ covariance)).sum(0)
        return np.sqrt(np.clip(out, 0, 1))

    def _solved(self, residual: Array) -> Array:
        """Weights (samples,) of residuals at the check points."""
        return np.asarray(self._spread.T @ (self._inverse @ residual))

    def _laid(self, weights: Array, window: tuple[int, ...]) -> Array:
        """The weighted sum of the samples' correlations, in the samples' order: the same in any window."""
        row0, row1, col0, col1 = window
        rows, cols = np.arange(row0, row1, dtype=np.float64), np.arange(col0, col1, dtype=np.float64)
        out = np.zeros((len(rows), len(cols)))
        for (row, col), weight in zip(self.samples.tolist(), weights.tolist()):
            down, across = self._factor(rows - row, 1), self._factor(cols - col, 0)
            i, j = np.flatnonzero(down), np.flatnonzero(across)
            if len(i) and len(j):
                part = slice(i[0], i[-1] + 1), slice(j[0], j[-1] + 1)
                out[part] += weight * (down[part[0], None] * across[None, part[1]])
        return out


def corner_weights(x: Array, y: Array, shape: tuple[int, int]) -> tuple[Numbers, Numbers, Array]:
    """Rows, columns and weights (n, 4) of the samples that define the surface at places (see ``ground``)."""
    rows, cols = shape
    col = np.clip(np.floor(x), 0, max(cols - 2, 0)).astype(np.int64)
    row = np.clip(np.floor(y), 0, max(rows - 2, 0)).astype(np.int64)
    u, v = x - col, y - row
    even = (col + row) % 2 == 0
    upper = np.where(even, u >= v, u + v <= 1)
    first, along = even | upper, even == upper
    a = first - u * upper - v * ~along
    b = ~first + u * upper - v * along
    c = ~first - u * ~upper + v * ~along
    d = -1.0 * ~first + u * ~upper + v * along
    corners = np.stack([row, row, row + 1, row + 1], 1), np.stack([col, col + 1, col, col + 1], 1)
    return np.minimum(corners[0], rows - 1), np.minimum(corners[1], cols - 1), np.stack([a, b, c, d], 1)
