"""Fractal terrain of any size, made block by block: rivers carve its ranges on a coarse grid; furrows add detail.

1. Noise says where the land rises and how hard its rock is; ``erosion`` carves that on a grid of some hundred to a
thousand cells a side, from coarse to fine. This part is global, takes seconds and a few MiB, and is done once.

2. A block of samples is cut out of it and refined: its resolution is doubled again and again (cubic B-spline
subdivision), and each step adds furrows with a wavelength of 8 samples along the slopes so far (``noise.gullies``).

Every sample depends only on the seed, the shape, and its global row and column: blocks may be made in any order, by any
number of threads, and fit to the bit. Units: samples for positions, metres for heights.
"""

from __future__ import annotations

import math
import operator
import os
import re
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.erosion import drainage, stream_power
from orograph.dem.noise import feature_points, fractal, gullies
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress

TILE = 512
CARVED = 1100  # maximum cells a side of the grid that rivers carve, approximately
STEEPEST = 0.7  # slope at which hillsides slide (35°)
FURROW = 8.0  # wavelength of furrows, in samples of the level they are cut at

Floats = NDArray[np.float64]
Heights = NDArray[np.float32]


class Synth:
    """A synthetic terrain; has what a mosaic needs of a source (``grid``, ``name``, ``vertical``, ``read``).

    Args:
        shape: (rows, cols), each at least 2.
        seed: any integer; another seed is another terrain.
        spacing: metres between samples.
        crs: projected CRS in metres.
        relief: metres from the lowest to the highest place, about; by default 6 % of the longer side, at most 2500.
        roughness: depth of the furrows; 1 is natural, 0 leaves the surface smooth below the carved grid.
        origin: CRS coordinates of the north-west corner.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        seed: int = 1,
        *,
        spacing: float = 30.0,
        crs: CRS | None = None,
        relief: float | None = None,
        roughness: float = 1.0,
        origin: tuple[float, float] = (500_000.0, 5_000_000.0),
    ) -> None:
        rows, cols = shape
        if min(shape) < 2:
            raise UsageError(f"A terrain needs at least 2 × 2 samples, not {rows} × {cols}.")
        if not (math.isfinite(spacing) and spacing > 0):
            raise UsageError(f"The spacing must be a length in metres, not {spacing}.")
        self.relief = min(2500.0, 0.06 * max(shape) * spacing) if relief is None else float(relief)
        if not (math.isfinite(self.relief) and self.relief > 0):
            raise UsageError(f"The relief must be a height in metres, not {relief}.")
        self.grid = Grid(shape, Affine(spacing, 0, origin[0], 0, -spacing, origin[1]), crs or CRS.from_epsg(32633))
        self.name, self.vertical, self.seed = f"synth {seed}", None, operator.index(seed)
        self.roughness, self.spacing = float(roughness), float(spacing)
        side = math.sqrt(rows * cols)
        self.levels = max(0, min(3, math.floor(math.log2(side / 200))), math.ceil(math.log2(side / CARVED)))
        self.quantum = 2.0 ** math.floor(math.log2(spacing / 4000))
        self._salt = (self.seed * 0x9E3779B97F4A7C15 + 0x1234567) & 0x7FFFFFFF
        self._carved: Floats | None = None
        self._lock = threading.Lock()

    def fingerprint(self) -> str:
        """The parameters that define it."""
        return f"synthetic {self.grid.shape} {self.seed} {self.spacing} {self.relief} {self.roughness}"

    def again(self) -> tuple[SynthAgain, dict[str, Floats]]:
        """How to open it in another process, and with which arrays (``store.handing``)."""
        self.prepare()
        assert self._carved is not None
        left, top = self.grid.transform @ (0, 0)
        how = SynthAgain(
            self.grid.shape, self.seed, self.spacing, self.grid.crs, self.relief, self.roughness, (left, top)
        )  # fmt: skip
        return how, {"carved": self._carved}

    def prepare(self, progress: Progress = SILENT) -> None:
        """Carve the coarse grid, if that is not done yet; ``read`` does so too, silently."""
        with self._lock:
            if self._carved is None:
                self._carved = self._carve(progress)

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Heights of a half-open window inside the grid, float32 metres. Safe from any thread."""
        rows, cols = self.grid.shape
        if not (0 <= row0 < row1 <= rows and 0 <= col0 < col1 <= cols):
            raise ValueError(f"window [{row0}, {row1}) × [{col0}, {col1}) of a raster of {rows} × {cols}")
        self.prepare()
        # The range that each level needs, from the window itself up to the carved grid.
        ranges = [(row0, row1, col0, col1)]
        for _ in range(self.levels):
            a, b, c, d = ranges[-1]
            ranges.append(((a - 1) // 2 - 1, b // 2 + 2, (c - 1) // 2 - 1, d // 2 + 2))
        heights = self._coarse(*ranges[-1])
        for level in range(self.levels - 1, -1, -1):
            a, b, c, d = ranges[level]
            above = ranges[level + 1]
            top, left = 2 * above[0], 2 * above[2]
            doubled = _doubled(heights, a - 1 - top, b + 1 - top, c - 1 - left, d + 1 - left)
            heights = self._furrowed(doubled, level, a, c)
        return (np.rint(heights / self.quantum) * self.quantum).astype(np.float32)

    # -- the carved grid ------------------------------------------------------------------------------------------

    @property
    def _margin(self) -> int:
        """Cells of the carved grid beyond the terrain on each side: rivers end there, outside the terrain."""
        return 16 + max(self.grid.shape) // (24 << self.levels)

    def _carve(self, progress: Progress) -> Floats:
        """Heights in metres on the carved grid; its cell (m, m) is the terrain's first sample, m the margin."""
        cell = 1 << self.levels
        shape = tuple(-(-n // cell) + 2 * self._margin + 1 for n in self.grid.shape)
        doublings = max(0, int(math.log2(max(shape) / 90)))
        steps = [60, 20, 14, 10, 6][: doublings + 1] + [6] * (doublings - 4)
        heights = np.zeros((2, 2))
        steepest = math.inf
        costs = [n * 4.0**i for i, n in enumerate(steps)]
        with progress.task("Carving ranges", total=sum(costs)) as task:
            for i, n_steps in enumerate(steps):
                width = 1 << (doublings - i)  # carved cells per cell of this stage
                rows, cols = ((n - 1) // width + 2 for n in shape)
                y, x = np.meshgrid(np.arange(rows) * float(width), np.arange(cols) * float(width), indexing="ij")
                uplift, erodibility, start = self._geology(x, y)
                if i == 0:
                    heights = start * 0.1
                else:
                    heights = _doubled(np.pad(heights, 2, mode="edge"), 4, 4 + rows, 4, 4 + cols)
                    heights += start * 0.02 * width
                outlet = np.zeros((rows, cols), bool)
                outlet[[0, -1]] = outlet[:, [0, -1]] = True
                heights[outlet] = 0
                order, receiver = np.empty(heights.size, np.int64), np.empty(heights.size, np.int64)
                for n in range(n_steps):
                    if (
                        n % 2 == 0
                    ):  # rivers keep their courses for two steps, because finding them takes most of the time
                        drainage(heights, outlet, self._salt, order, receiver)
                    stream_power(heights, uplift, erodibility, outlet, order, receiver, float(width), 1.0, steepest)
                    task.advance(costs[i] / n_steps)
                # The slope limit is in metres, so it needs the length of a unit.
                steepest = STEEPEST * cell * self.spacing / (self.relief / self._seen(heights, width).max())
        seen = self._seen(heights, 1)
        low, high = float(seen.min()), float(seen.max())
        return (heights - low) * (self.relief / (high - low))

    def _seen(self, heights: Floats, width: int) -> Floats:
        """The part of a stage's heights that lies within the terrain."""
        m = self._margin // width
        return heights[m:-m, m:-m] if min(heights.shape) > 2 * m + 1 else heights

    def _geology(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Uplift, erodibility and first heights (0…1) at cells (x, y) of the carved grid."""
        side = math.sqrt(self.grid.rows * self.grid.cols) / (1 << self.levels)
        u, v = x / side, y / side
        bend_u, bend_v = self._fractal(u * 2, v * 2, 3, 0.5, 1), self._fractal(u * 2, v * 2, 3, 0.5, 2)
        region = self._fractal(u * 1.4 + 0.5 * bend_u, v * 1.4 + 0.5 * bend_v, 3, 0.5, 3)
        crest = 1 - np.abs(self._fractal(u * 2.6 + 0.6 * bend_v, v * 2.6 + 0.6 * bend_u, 3, 0.45, 4)) * 2.2
        highland = _smoothstep(-0.30, 0.30, region)
        uplift = 0.015 + highland**1.5 * (0.18 + 0.82 * np.clip(crest, 0, 1) ** 2)
        erodibility = 2.0 ** (1.6 * self._fractal(u * 7, v * 7, 4, 0.6, 5))
        return uplift, erodibility, 0.5 + 0.5 * self._fractal(x * 0.37, y * 0.37, 2, 0.7, 6)

    def _fractal(self, x: Floats, y: Floats, octaves: int, gain: float, which: int) -> Floats:
        out = np.empty_like(x)
        fractal(x, y, octaves, gain, self._salt + 104_729 * which, out)
        return out

    # -- blocks ---------------------------------------------------------------------------------------------------

    def _coarse(self, row0: int, row1: int, col0: int, col1: int) -> Floats:
        """The carved grid at indices counted from the terrain's first sample, with courses bent off its directions."""
        assert self._carved is not None
        y, x = np.meshgrid(np.arange(row0, row1, dtype=float), np.arange(col0, col1, dtype=float), indexing="ij")
        across, down = self._fractal(x / 9, y / 9, 3, 0.6, 8), self._fractal(x / 9, y / 9, 3, 0.6, 9)
        return _spline(self._carved, x + self._margin + 2.2 * across, y + self._margin + 2.2 * down)

    def _furrowed(self, heights: Floats, level: int, row0: int, col0: int) -> Floats:
        """Heights of a level (with a margin of one sample), furrowed.

        (row0, col0) is the index of the first returned sample.
        """
        out = np.empty((heights.shape[0] - 2, heights.shape[1] - 2))
        if self.roughness == 0:
            return heights[1:-1, 1:-1]
        angle = 0.7 + 1.9 * level
        cos, sin = math.cos(angle), math.sin(angle)
        cols = np.array([col0, col0 + out.shape[1]]) / FURROW
        rows = np.array([row0, row0 + out.shape[0]]) / FURROW
        x = [cos * c - sin * r for c in cols for r in rows]
        y = [sin * c + cos * r for c in cols for r in rows]
        i0, j0 = math.floor(min(x)) - 2, math.floor(min(y)) - 2
        px = np.empty((math.floor(max(y)) + 3 - j0, math.floor(max(x)) + 3 - i0))
        py = np.empty_like(px)
        feature_points(i0, j0, self._salt + 31 * level, px, py)
        unit = self.spacing * (1 << level)
        points, depth = (px, py, i0, j0), 0.12 * self.roughness
        gullies(heights / unit, row0, col0, FURROW, (cos, sin), points, depth, 0.1, 0.9, out)
        return out * unit

    # -- the file -------------------------------------------------------------------------------------------------

    def write(
        self,
        path: str | os.PathLike[str],
        *,
        compress: str = "zstd",
        jobs: int | None = None,
        progress: Progress = SILENT,
    ) -> None:
        """Write the terrain as a tiled GeoTIFF of float32; the file appears under its name only when it is whole.

        Args:
            compress: "zstd", "deflate" or "none".
            jobs: threads; the bytes do not depend on it.

        Raises:
            OutputError: the file cannot be written.
        """
        self.prepare(progress)
        write_windows(self, path, compress=compress, jobs=jobs, progress=progress)


class SynthAgain(NamedTuple):
    """Opens a synthetic terrain in another process. Attributes: as of ``Synth``."""

    shape: tuple[int, int]
    seed: int
    spacing: float
    crs: CRS | None
    relief: float
    roughness: float
    origin: tuple[float, float]

    def open(self, made: Mapping[str, NDArray[Any]]) -> Synth:
        """The terrain. Args: made: "carved", the grid that rivers have carved."""
        found = Synth(
            self.shape, self.seed, spacing=self.spacing, crs=self.crs, relief=self.relief, roughness=self.roughness,
            origin=self.origin,
        )  # fmt: skip
        found._carved = made["carved"]
        return found


class Windows(Protocol):
    """Heights or colours that are made window by window.

    Colours have an attribute ``bands``, 4, and windows (rows, cols, 4) of bytes: red, green, blue, opacity.
    """

    @property
    def grid(self) -> Grid: ...

    def read(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[Any]:
        """Heights of a half-open window inside the grid, float32 metres. Safe from any thread."""


def write_windows(
    made: Windows,
    path: str | os.PathLike[str],
    *,
    compress: str = "zstd",
    jobs: int | None = None,
    progress: Progress = SILENT,
    tags: dict[str, str] | None = None,
) -> None:
    """Write heights, or colours, as a tiled GeoTIFF, as ``Synth.write`` does.

    Args:
        tags: of the file.

    Raises:
        OutputError: the file cannot be written.
    """
    import rasterio
    from rasterio.windows import Window

    from orograph.dem.writing import raster_file

    goal = Path(path)
    rows, cols = made.grid.shape
    bands = getattr(made, "bands", 1)
    profile = {"driver": "GTiff", "height": rows, "width": cols, "count": bands}
    profile |= {"dtype": "float32"} if bands == 1 else {"dtype": "uint8", "photometric": "RGB", "alpha": "YES"}
    profile |= {"bigtiff": "if_safer", "transform": made.grid.transform}
    if made.grid.crs is not None:
        profile["crs"] = made.grid.crs.to_wkt()
    if min(rows, cols) >= 16:
        profile |= {"tiled": True, "blockxsize": TILE, "blockysize": TILE}
    if compress != "none":
        profile |= {
            "compress": compress,
            "predictor": 3 if bands == 1 else 2,
            "zstd_level" if compress == "zstd" else "zlevel": 1,
        }
    # One row of tiles after the other, so that GDAL's order in the file does not depend on its cache.
    tops, lefts = range(0, rows, TILE), range(0, cols, 4 * TILE)
    windows = [(r, min(r + TILE, rows), c, min(c + 4 * TILE, cols)) for r in tops for c in lefts]
    with raster_file(goal) as part, rasterio.open(part, "w", **profile) as file:
        if bands == 1:
            file.update_tags(1, UNITTYPE="m")
        file.update_tags(**(tags or {}))
        with progress.task(f"Writing {goal.name}", total=len(windows)) as task:
            blocks = map_ordered(lambda w: made.read(*w), windows, jobs)
            for (r0, r1, c0, c1), block in zip(windows, blocks):
                window = Window(c0, r0, c1 - c0, r1 - r0)
                file.write(block[None] if bands == 1 else np.moveaxis(block, -1, 0), window=window)
                task.advance()


def parse_size(text: str) -> tuple[int, int]:
    """(rows, cols) from "4097" (square) or "2049x4097" (rows × columns).

    Raises:
        UsageError: it is neither.
    """
    found = re.fullmatch(r"\s*(\d+)(?:\s*[x×]\s*(\d+))?\s*", text, re.IGNORECASE)
    if found is None or min(int(found[1]), int(found[2] or found[1])) < 2:
        raise UsageError(f"The size must be like 4097 (square) or 2049x4097 (rows × columns), not {text!r}.")
    return int(found[1]), int(found[2] or found[1])


def _smoothstep(low: float, high: float, x: Floats) -> Floats:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def _doubled(coarse: Floats, row0: int, row1: int, col0: int, col1: int) -> Floats:
    """Cubic B-spline subdivision: samples [row0, row1) × [col0, col1) of the doubled grid.

    Its sample 2i lies at i.
    """
    for axis, (start, stop) in enumerate(((row0, row1), (col0, col1))):
        c = np.moveaxis(coarse, axis, 0)
        first, last = start // 2, (stop - 1) // 2
        even = (c[first - 1 : last] + 6 * c[first : last + 1] + c[first + 1 : last + 2]) / 8
        odd = (c[first : last + 1] + c[first + 1 : last + 2]) / 2
        both = np.stack([even, odd], axis=1).reshape(2 * len(even), *c.shape[1:])
        coarse = np.moveaxis(both[start - 2 * first : stop - 2 * first], 0, axis)
    return np.ascontiguousarray(coarse)


def _spline(grid: Floats, x: Floats, y: Floats) -> Floats:
    """The cubic B-spline of a grid (slightly smoothing) at positions (x, y), clamped to the grid."""
    x, y = np.clip(x, 1, grid.shape[1] - 2.001), np.clip(y, 1, grid.shape[0] - 2.001)
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    total = np.zeros(x.shape)
    across, down = _weights(x - i), _weights(y - j)
    for dj in range(4):
        for di in range(4):
            total += down[dj] * across[di] * grid[j + dj - 1, i + di - 1]
    return total


def _weights(t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    s = 1 - t
    return s * s * s / 6, (3 * t * t * t - 6 * t * t + 4) / 6, (3 * s * s * s - 6 * s * s + 4) / 6, t * t * t / 6
