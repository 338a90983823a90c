"""How much coarser triangles change colours: a bound in ΔE for every diamond, for methods' γ.

A mesh that carries colours at its vertices (a drape, a tint, light on the slopes) shows between them what it
interpolates. The error of a diamond is a bound of the largest distance, in CIELAB (ΔE*ab, CIE 1976), between the colour
of any full-resolution sample of its region and the colour interpolated over its two coarse triangles; it is made
monotonic like a geometric error and computed by the same blocks, once per channel: with eL, ea, eb the largest
differences of the three channels, no colour is off by more than sqrt(eL² + ea² + eb²). About 2.3 is a just noticeable
difference.

The light is Lambert's on full-resolution slopes under one sun, over a constant sky: enough to say where light changes.
Values are kept in a byte each, as square roots rounded up: (code / 15.9)², so that ΔE ≤ 257.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.diamonds import Surface, diamonds
from orograph.geovis.color import tint_of
from orograph.lighting.normal import gradient
from orograph.progress import SILENT, Progress
from orograph.store.diamonds import NESTED, place, surface
from orograph.store.terrain import Terrain, diamond_shape

if TYPE_CHECKING:
    from orograph.geovis.drape import Drape

Floats = NDArray[np.float32]

SUN = (315.0, 45.0)
CODE = 15.9
SKY = 0.35
"""The ambient part of the light."""

_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_WHITE = _XYZ.sum(axis=1)


def lab(linear: NDArray[np.floating]) -> Floats:
    """CIELAB (…, 3), D65, of linear sRGB (…, 3) in 0 to 1 (CIE 15:2004, sec. 8.2.1)."""
    t = np.asarray(linear, np.float64) @ _XYZ.T / _WHITE
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1).astype(
        np.float32
    )


class Colors:
    """The colours of a terrain's samples, at full resolution.

    Args:
        terrain: whose samples are coloured.
        drape: an image file laid over it, in any CRS; None: the hypsometric tint.
        colormap: of the tint (see ``geovis.color``).
        sun: (azimuth, altitude) in degrees of the light on the slopes; None: no light, the colours alone.
        relief: factor on slopes for the light.
        max_memory: bytes for the image.
        progress: hears warnings.

    Attributes:
        step: how many pixels of the image a texel that is held is wide; 1 without an image.

    Raises:
        ReadError: the image cannot be read, or lies elsewhere.
    """

    def __init__(
        self,
        terrain: Terrain,
        *,
        drape: str | os.PathLike[str] | None = None,
        colormap: str | None = None,
        sun: tuple[float, float] | None = SUN,
        relief: float = 1.0,
        max_memory: int | None = None,
        progress: Progress = SILENT,
    ) -> None:
        self.terrain, self.relief = terrain, relief
        self._image: Drape | None = None
        if drape is not None:
            from orograph.geovis.drape import Drape

            self._image = Drape.open(drape, terrain.grid, max_memory, metres=min(terrain.grid.spacing))
            for warning in self._image.warnings:
                progress.warn(warning)
        self.step = 1 if self._image is None else self._image.step
        self._tint = tint_of(terrain, colormap)
        self._light = None
        if sun is not None:
            azimuth, altitude = (math.radians(v) for v in sun)
            self._light = np.array(
                [math.sin(azimuth) * math.cos(altitude), math.cos(azimuth) * math.cos(altitude), math.sin(altitude)]
            )

    def colors(self, row0: int, row1: int, col0: int, col1: int) -> Floats:
        """CIELAB colours (rows, cols, 3) of a window's samples, NaN where heights are missing."""
        rows, cols = self.terrain.grid.shape
        r0, r1, c0, c1 = max(row0 - 1, 0), min(row1 + 1, rows), max(col0 - 1, 0), min(col1 + 1, cols)
        heights = self.terrain.read(0, r0, r1, c0, c1)
        inner = slice(row0 - r0, row1 - r0), slice(col0 - c0, col1 - c0)
        here = heights[inner]
        albedo = self._albedo(here, row0, col0)
        if self._light is not None:
            east, north = (g[inner] * self.relief for g in gradient(heights, self.terrain.grid.linear, 1))
            x, y, z = self._light
            facing = (z - x * east - y * north) / np.sqrt(1 + east * east + north * north)
            albedo = albedo * (SKY + (1 - SKY) * np.maximum(facing, 0))[..., None]
        result = lab(albedo)
        result[np.isnan(here)] = np.nan
        return result

    def _albedo(self, heights: Floats, row0: int, col0: int) -> Floats:
        """Linear colours of samples without light."""
        tint = self._tint
        z = np.nan_to_num(heights, nan=tint.low)
        at = np.clip((z - tint.low) / (tint.high - tint.low) * (len(tint.land) - 1), 0, len(tint.land) - 1)
        result: Floats = tint.land[at.astype(np.intp)]
        if len(tint.sea):
            at = np.clip((1 - z / tint.floor) * (len(tint.sea) - 1), 0, len(tint.sea) - 1)
            result = np.where((z < 0)[..., None], tint.sea[at.astype(np.intp)], result)
        if self._image is not None:
            rows, cols = np.mgrid[row0 : row0 + heights.shape[0], col0 : col0 + heights.shape[1]]
            x, y = self.terrain.grid.xy(cols.ravel(), rows.ravel())
            width = np.full(1, min(self.terrain.grid.spacing))
            found = self._image.sample(x, y, width).reshape(*heights.shape, 4)
            result = np.where(found[..., 3:] > 0.5, found[..., :3], result)
        return result

    def nested(self) -> Floats:
        """The colours of every 16th sample, the last ones repeated where the step leads beyond the raster."""
        rows, cols = self.terrain.grid.shape
        step = 1 << NESTED
        columns = np.minimum(np.arange(0, cols - 1 + step, step), cols - 1)
        lines = np.minimum(np.arange(0, rows - 1 + step, step), rows - 1)
        return np.stack([self.colors(int(row), int(row) + 1, 0, cols)[0, columns] for row in lines])


def codes_of(errors: Sequence[Floats]) -> NDArray[np.uint8]:
    """Codes of color errors, rounded up, from those of the three channels; 0 where they are infinite (mixed)."""
    total = np.sqrt(sum(e.astype(np.float64) ** 2 for e in errors))
    # Mixed diamonds are split anyway.
    code = np.where(np.isfinite(total), np.minimum(np.ceil(np.sqrt(total) * CODE), 255), 0)
    return code.astype(np.uint8)


def decoded(codes: NDArray[np.uint8]) -> Floats:
    """Color errors, ΔE, of codes."""
    return (codes.astype(np.float32) / np.float32(CODE)) ** 2


def blank(terrain: Terrain) -> Surface:
    """A terrain's raster for surveys that make no spheres."""
    return surface(terrain.grid, np.zeros((1, 1), np.float32), 0.0)


class ColorErrors(Colors):
    """Color errors of a terrain's diamonds, called as methods want them: ``(level, row0, row1, col0, col1) → float32``.

    Computed at once and held in memory; see ``color_store`` for those stored with the terrain.

    Args:
        terrain, drape, colormap, sun, relief, max_memory: see ``Colors``.
        jobs: threads.
        progress: gets progress reports.

    Raises:
        ReadError: the image cannot be read, or lies elsewhere.
    """

    def __init__(
        self, terrain: Terrain, *, jobs: int | None = None, progress: Progress = SILENT, **options: Any
    ) -> None:
        super().__init__(terrain, progress=progress, **options)
        self._lock = threading.Lock()
        self._waiting: dict[tuple[int, ...], tuple[Future[Floats], list[int]]] = {}
        self._codes = self._all(jobs, progress)

    def __call__(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Floats:
        return decoded(self._codes[level][row0:row1, col0:col1])

    @property
    def size_bytes(self) -> int:
        """What is kept, one byte per diamond."""
        return sum(codes.nbytes for codes in self._codes)

    def _all(self, jobs: int | None, progress: Progress) -> list[NDArray[np.uint8]]:
        terrain = self.terrain
        shape = terrain.grid.shape
        top = terrain.levels - 1
        codes = [np.zeros(diamond_shape(shape, level), np.uint8) for level in range(terrain.levels)]
        blocks = -(-shape[0] // 1024) * -(-shape[1] // 1024)
        with progress.task("Color errors", total=blocks) as task:
            nested = self.nested()
            # One channel after the other in lock step: their parts come in the same order.
            channels = [
                diamonds(
                    self._channel(k),
                    np.ascontiguousarray(nested[..., k]),
                    blank(terrain),
                    ("exact",),
                    radii=False,
                    jobs=jobs,
                )
                for k in range(3)
            ]
            for parts in zip(*channels, strict=True):
                code = codes_of([part.errors["exact"] for part in parts])
                part = parts[0]
                level = min(part.octave, top)
                place(codes[level], code, part.octave, part.i, part.j, level)
                if part.octave == 0:
                    task.advance()
        return codes

    def _channel(self, k: int) -> Callable[[int, int, int, int], Floats]:
        def read(row0: int, row1: int, col0: int, col1: int) -> Floats:
            return np.ascontiguousarray(self._once(row0, row1, col0, col1)[..., k])

        return read

    def _once(self, *window: int) -> Floats:
        """``colors`` of a window that all three channels ask for, made by the first of them."""
        with self._lock:
            entry = self._waiting.get(window)
            first = entry is None
            if entry is None:
                entry = self._waiting[window] = (Future(), [3])
        future, left = entry
        if first:
            try:
                future.set_result(self.colors(*window))
            except BaseException as error:
                future.set_exception(error)
        result = future.result()
        with self._lock:
            left[0] -= 1
            if not left[0]:
                del self._waiting[window]
        return result
