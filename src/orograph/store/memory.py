"""A terrain held in memory: one array of heights, whose coarser levels, means and tile tables are computed on demand.

Rasters that fit in memory need no build: a picture of one SRTM tile starts at once.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from orograph.compiling import expect
from orograph.error import ErrorKind
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.parallel import map_ordered
from orograph.store.terrain import TILE, Heights, Terrain, TileTable, tile_shape

T = TypeVar("T")


def is_metric(grid: Grid) -> bool:
    """Whether a grid is projected and in metres, as the heights are, or has no CRS."""
    crs = grid.crs
    return crs is None or (crs.is_projected and {a.unit_conversion_factor for a in crs.axis_info[:2]} == {1.0})


def check_metric(grid: Grid, name: str) -> None:
    """Raise UsageError unless the grid is projected and in metres, as the heights are (or has no CRS)."""
    crs = grid.crs
    if crs is None:
        return
    if not crs.is_projected:
        what = "in degrees" if crs.is_geographic else f"in {crs.type_name.lower()} coordinates"
        raise UsageError(
            f"{name} is {what} ({crs.name}), but terrain must be in metres.",
            remedy="Build a store of it, or open it as a Mosaic; both convert it to a projected CRS.",
        )
    factors = {axis.unit_conversion_factor for axis in crs.axis_info[:2]}
    if factors - {1.0}:
        raise UsageError(
            f"{name} is in {crs.axis_info[0].unit_name} ({crs.name}), but terrain must be in metres.",
            remedy="Build a store of it, or open it as a Mosaic; both convert it to a metric CRS.",
        )


class MemoryTerrain(Terrain):
    """A terrain over an array in memory.

    Args:
        heights: (rows, cols) float32, metres, NaN where missing. Not copied.
        grid: where they lie: projected in metres, or without CRS.
        name: its name.
        vertical: name of the vertical datum.
        attribution: as for a ``Terrain``.

    Raises:
        UsageError: the CRS is not metric, or the shapes differ.
    """

    def __init__(
        self, heights: Heights, grid: Grid, name: str, vertical: str | None = None, attribution: tuple[str, ...] = ()
    ) -> None:
        if heights.shape != grid.shape:
            raise UsageError(f"{name} has {heights.shape} heights on a grid of {grid.shape}.")
        check_metric(grid, name)
        self.grid, self.name, self.vertical, self.attribution = grid, name, vertical, attribution
        self.heights = np.ascontiguousarray(heights, np.float32).view()
        self.heights.flags.writeable = False
        self._lock = threading.RLock()
        self._made: dict[tuple[str, int], object] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the heights without what was derived from them (and without the source's own samples)."""
        return MemoryTerrain, (self.heights, self.grid, self.name, self.vertical, self.attribution)

    @property
    def height_range(self) -> tuple[float, float]:
        low, high, _ = self._extrema(0)
        if np.isnan(low).all():
            return float("nan"), float("nan")
        return float(np.nanmin(low)), float(np.nanmax(high))

    @property
    def valid_fraction(self) -> float:
        def count() -> float:
            missing = sum(int(np.isnan(self.heights[r : r + TILE]).sum()) for r in range(0, self.grid.rows, TILE))
            return (self.heights.size - missing) / self.heights.size

        return self._once("valid", 0, count)

    def read(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        self.check_window(self.shape(level), row0, row1, col0, col1)
        return self._nested(level)[row0:row1, col0:col1]

    def read_mean(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Heights:
        self.check_window(self.mean_shape(level), row0, row1, col0, col1)
        return (self._means()[level - 1] if level else self.heights)[row0:row1, col0:col1]

    def tiles(self, level: int) -> TileTable:
        self._check(level)
        return self._once("tiles", level, lambda: self._tiles(level))

    def derived(self, name: str, **options: Any) -> Any:
        from orograph.store.registry import kind_of

        kind, made_with = kind_of(name), sorted(options.items())
        return self._once(f"{name} {made_with}", 0, lambda: kind.compute(self, **options))

    def _once(self, what: str, level: int, make: Callable[[], T]) -> T:
        """Compute a value on first use, in one thread."""
        with self._lock:
            key = what, level
            if key not in self._made:
                self._made[key] = make()
            return self._made[key]  # type: ignore[return-value]

    def _nested(self, level: int) -> Heights:
        def make() -> Heights:
            from orograph.store.levels import subsample

            fine = self._nested(level - 1)  # replication commutes with subsampling
            return _frozen(subsample(fine, 1))

        return self._once("nested", level, make) if level else self.heights

    def diamonds(self, kind: ErrorKind) -> tuple[list[Heights], list[Heights]]:
        """Errors of a kind, and the radii that all kinds share, per level.

        They are rounded up as in a store, so that a raster is drawn exactly like its store.
        """

        def make() -> tuple[list[Heights], list[Heights]]:
            from orograph.error.diamonds import diamonds
            from orograph.error.encode import Encoder
            from orograph.error.quantise import ErrorCode, RadiusCode
            from orograph.store.diamonds import NESTED, gather, metric, surface
            from orograph.store.levels import subsample

            known = self._made.get(("radii", 0))
            low, high = self.height_range
            code = ErrorCode.of(high - low, kind, self.n)
            encoder = Encoder({kind: code}, RadiusCode.of(high - low, metric(self.grid), self.n))
            parts = diamonds(
                # (a copy: kernels are compiled again for read-only arrays)
                lambda row0, row1, col0, col1: self.heights[row0:row1, col0:col1].copy(),
                subsample(self.heights, NESTED),
                surface(self.grid, self.tiles(0).minimum, low),
                (kind,),
                radii=known is None,
                rounding=encoder,
            )
            expect("errors")
            errors, radii = gather(self.grid.shape, parts, kind)
            errors = [code.decode(encoder.errors(kind, level)) for level in errors]
            for array in (*errors, *radii):
                _frozen(array)
            return errors, self._once("radii", 0, lambda: radii)

        return self._once(kind, 0, make)

    def _means(self) -> list[Heights]:
        def make() -> list[Heights]:
            from orograph.store.levels import BoxMeans

            made = [np.empty(self.mean_shape(level), np.float32) for level in range(1, self.levels)]
            height = max(1 << (self.levels - 1), TILE)  # such strips cut no block of any level

            def strip(row: int) -> None:
                means = BoxMeans(self.heights[row : row + height])
                for level, whole in enumerate(made, 1):
                    part = means.next()
                    whole[row >> level : (row >> level) + len(part)] = part

            for _ in map_ordered(strip, range(0, self.grid.rows, height)):
                pass
            return [_frozen(whole) for whole in made]

        return self._once("means", 0, make)

    def _extrema(self, level: int) -> tuple[Heights, Heights, NDArray[np.uint8]]:
        def make() -> tuple[Heights, Heights, NDArray[np.uint8]]:
            from orograph.store.levels import extrema, reduce_tiles

            if level:
                return reduce_tiles(*self._extrema(level - 1))
            strips = range(0, max(1, self.grid.rows - 1), TILE)
            parts = list(map_ordered(lambda r: extrema(self.heights[r : r + TILE + 1]), strips))
            low, high, valid = (np.concatenate(column) for column in zip(*parts, strict=True))
            return low, high, valid

        return self._once("extrema", level, make)

    def _tiles(self, level: int) -> TileTable:
        from orograph.store.levels import magnitude, round_up, tile_errors

        low, high, valid = self._extrema(level)
        if level == 0:
            return TileTable(low, high, np.zeros(low.shape, np.float32), valid)
        size = TILE << level
        # Cells of 2^level samples never straddle a strip of that height, so strips of one cell are independent; several
        # cells at a time keep the number of calls small.
        rows = max(1 << level, TILE)
        strips = range(0, max(1, self.grid.rows - 1), rows)

        def strip(row: int) -> NDArray[np.float64]:
            part: NDArray[np.float64] = tile_errors(self.heights[row : row + rows + 1], level, (row, 0)).max(axis=0)
            return part

        worst = np.zeros(tile_shape(self.grid.shape, level))
        for row, part in zip(strips, map_ordered(strip, strips), strict=True):
            np.maximum(worst[row // size], part, out=worst[row // size])
        return TileTable(low, high, round_up(worst, magnitude(low, high)), valid)


def _frozen(array: Heights) -> Heights:
    array.flags.writeable = False
    return array
