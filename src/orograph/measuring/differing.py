"""The difference of two rasters on one grid, block by block, and its statistics.

Blocks are fixed, and their sums are added in their order, so that nothing depends on memory or threads. Quantiles are
exact (``order``). Mean and rms are sensitive to blunders; median and NMAD, 1.4826 times the median of
|d − median|, are not, and are what Höhle and Höhle (2009) recommend. Volumes are sums of difference × ground area of a
cell: the area on the map divided by the projection's areal scale there. Units: metres, metres², metres³.

J. Höhle, M. Höhle, Accuracy assessment of digital elevation models by means of robust statistical methods, ISPRS
Journal of Photogrammetry and Remote Sensing 64(4), 2009, 398–406.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.dem.aligned import Aligned
from orograph.dem.placing import areal_scales
from orograph.errors import ReadError
from orograph.geo.grid import Grid
from orograph.lighting.raster import Canvas, rectangles
from orograph.measuring.detection import Detected, Doubt
from orograph.measuring.order import Counts, Floats, quantiles, upper_counts
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress

BLOCK = 1024
"""Samples along the side of a block."""
CELLS = 128
"""Side in samples of a square whose cells all count as large as the middle one."""
NORMAL = 1.4826
"""The standard deviation of a normal distribution over its median absolute deviation."""
ENDS = (0.01, 0.99)
"""Quantiles that a colour scale must cover."""

Box = tuple[int, int, int, int]
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Statistics:
    """Statistics of a difference; metres, NaN if nothing was compared.

    Attributes:
        count: samples that both have. missing: samples of the shared window that one of them lacks.
        mean, median, rms, nmad, low, high: of the differences; std: around their mean.
        quantiles: (probability, difference), ascending.
        area: of the ground compared, metres²; gain_area, loss_area: where the difference is above and below 0.
        gain, loss: volumes above and below 0, metres³, both positive; net: gain − loss.
        detected: if heights are uncertain, what is significant; gain, loss and their areas are then of that only.
        ratio: the factor that best maps the second's heights to the first's (least squares).
    """

    count: int
    missing: int
    mean: float
    median: float
    rms: float
    std: float
    nmad: float
    low: float
    high: float
    quantiles: tuple[tuple[float, float], ...]
    area: float
    gain_area: float
    loss_area: float
    gain: float
    loss: float
    ratio: float
    ends: tuple[float, float]
    detected: Detected | None = None

    @property
    def net(self) -> float:
        return self.gain - self.loss

    def to_dict(self) -> dict[str, Any]:
        """For JSON: names with units; None for what is unknown."""
        metres = {f"{name}_m": getattr(self, name) for name in ("mean", "median", "rms", "std", "nmad", "low", "high")}
        areas = {f"{name}_m2": getattr(self, name) for name in ("area", "gain_area", "loss_area")}
        volumes = {f"{name}_m3": getattr(self, name) for name in ("gain", "loss", "net")}
        numbers = {
            name: value if math.isfinite(value) else None for name, value in {**metres, **areas, **volumes}.items()
        }
        every = {f"{q:g}": value if math.isfinite(value) else None for q, value in self.quantiles}
        known = {} if self.detected is None else self.detected.to_dict()
        return {"count": self.count, "missing": self.missing, **numbers, "quantiles_m": every, **known}


class Sums(NamedTuple):
    """Sums over a block."""

    known: int
    upper: Counts
    plain: Array  # sums of d, d², a b, b²; the area compared, with gain, with loss; the volumes of both
    low: float
    high: float
    doubted: Array  # of gain and loss each Σ σ² a, Σ σ a and the whole volume; significant samples; their area
    lods: tuple[float, float]
    lacking: int


def differ(
    a: Aligned, b: Aligned, wanted: Sequence[float], *, max_memory: int, jobs: int | None = None,
    progress: Progress = SILENT, doubt: Doubt | None = None,
) -> tuple[Floats, Statistics]:  # fmt: skip
    """a − b on their grid, (rows, cols) float32, NaN where one of them has no height, and its statistics.

    Args:
        wanted: quantiles, 0 to 1. max_memory: bytes; a difference of more than half of them is kept in a scratch file.
        doubt: volumes are then of significant samples only.

    Raises:
        ReadError, DamagedChunkError: a source is damaged, or a map of standard deviations does not cover what is
            compared.
    """
    grid = a.grid
    canvas = Canvas(1, grid.shape, on_disk=4 * grid.rows * grid.cols > max_memory // 2)
    values = canvas.values[0]
    boxes = list(rectangles(grid.shape, BLOCK, BLOCK))

    def work(box: Box) -> Sums:
        first, second = a.read(*box), b.read(*box)
        made = np.subtract(first, second) + np.float32(0.0)  # (no −0)
        values[box[0] : box[1], box[2] : box[3]] = made
        return _sums(grid, box, first, second, made, doubt)

    def known(box: Any) -> Floats:
        part = values[box[0] : box[1], box[2] : box[3]]
        found: Floats = part[part == part]
        return found

    sums: list[Sums] = []
    with progress.task("Taking the difference", total=3 * len(boxes)) as task:
        for one in map_ordered(work, boxes, jobs):
            sums.append(one)
            canvas.release()
            task.advance()
        upper = np.sum([one.upper for one in sums], axis=0)
        ranks = [0.5, *ENDS, *wanted]
        middle, low, high, *rest = quantiles(boxes, known, upper, ranks, jobs)
        task.advance(len(boxes))

        def off(box: Any) -> Floats:
            return np.abs(known(box).astype(np.float64) - middle).astype(np.float32)

        away = np.zeros_like(upper)
        for counts in map_ordered(lambda box: upper_counts(off(box)), boxes, jobs):
            away += counts
        (deviation,) = quantiles(boxes, off, away, [0.5], jobs)
        canvas.release()
        task.advance(len(boxes))
    pairs = tuple(sorted(zip(map(float, wanted), rest, strict=True)))
    return values, _statistics(sums, grid, middle, NORMAL * deviation, pairs, (low, high), doubt)


def _sums(grid: Grid, box: Box, first: Floats, second: Floats, made: Floats, doubt: Doubt | None) -> Sums:
    there = made == made
    d = np.where(there, made, np.float32(0)).astype(np.float64)
    a, b = np.where(there, first, 0).astype(np.float64), np.where(there, second, 0).astype(np.float64)
    cells = _cells(grid, box)

    def areas_of(*parts: NDArray[Any]) -> list[float]:
        return [float(np.sum(_squares(part) * cells)) for part in parts]

    up, down = d > 0, d < 0
    doubted, lods, lacking = np.zeros(8), (math.inf, -math.inf), 0
    if doubt is not None:
        sigma = doubt.sigma(box)
        lacking = int((np.isnan(sigma) & there).sum())
        lod = np.nan_to_num(doubt.times * sigma)
        sigma, sure = np.nan_to_num(sigma), np.abs(d) > lod
        whole = areas_of(np.maximum(d, 0.0), np.maximum(-d, 0.0))
        up, down = up & sure, down & sure
        sums = areas_of(*(part * s for s in (up, down) for part in (sigma**2, sigma)))
        doubted = np.array([*sums, *whole, (up | down).sum(), *areas_of(up | down)])
        if there.any():
            lods = float(lod[there].min()), float(lod[there].max())
    areas = areas_of(there, up, down, np.where(up, d, 0.0), np.where(down, -d, 0.0))
    some = made[there]
    low, high = (float(some.min()), float(some.max())) if len(some) else (math.inf, -math.inf)
    plain = [float(d.sum()), float((d * d).sum()), float((a * b).sum()), float((b * b).sum()), *areas]
    return Sums(len(some), upper_counts(some), np.array(plain), low, high, doubted, lods, lacking)


def _squares(values: NDArray[Any]) -> Array:
    """Sums over squares of ``CELLS`` × ``CELLS``."""
    rows, cols = (np.arange(0, n, CELLS) for n in values.shape)
    return np.add.reduceat(np.add.reduceat(values.astype(np.float64), rows, axis=0), cols, axis=1)


def _cells(grid: Grid, box: Box) -> Array:
    """Metres² of ground per cell in each of a block's squares; on the map if the projection's scale is undefined."""
    rows, cols = (
        (np.minimum(np.arange(start, stop, CELLS) + CELLS, stop) + np.arange(start, stop, CELLS) - 1) / 2
        for start, stop in ((box[0], box[1]), (box[2], box[3]))
    )
    col, row = np.meshgrid(cols, rows)
    scale = areal_scales(grid, col.ravel(), row.ravel()).reshape(col.shape)
    return grid.cell_area / np.where(np.isnan(scale), 1.0, scale)


def _statistics(
    sums: Sequence[Sums], grid: Grid, median: float, nmad: float, quantiles: tuple[tuple[float, float], ...],
    ends: tuple[float, float], doubt: Doubt | None,
) -> Statistics:  # fmt: skip
    count = sum(one.known for one in sums)
    total, squares, product, second, area, gained, lost, gain, loss = (
        math.fsum(one.plain[k] for one in sums) for k in range(9)
    )
    mean, square = (total / count, squares / count) if count else (math.nan, math.nan)
    return Statistics(
        count, grid.rows * grid.cols - count, mean, median, math.sqrt(square),
        math.sqrt(max(square - mean * mean, 0.0)), nmad,
        min(one.low for one in sums) if count else math.nan, max(one.high for one in sums) if count else math.nan,
        quantiles, area, gained, lost, gain, loss, product / second if second > 0 else math.nan, ends,
        None if doubt is None else _detected(sums, doubt),
    )  # fmt: skip


def _detected(sums: Sequence[Sums], doubt: Doubt) -> Detected:
    if lacking := sum(one.lacking for one in sums):
        raise ReadError(
            f"A raster of standard deviations has no value at {lacking:,} samples that are compared.",
            remedy="Give one that covers them, or compare a part (`bbox`, `clip`).",
        )
    up2, up, down2, down, gain, loss, count, area = (math.fsum(one.doubted[k] for one in sums) for k in range(8))
    lowest, highest = min(one.lods[0] for one in sums), max(one.lods[1] for one in sums)
    known = lowest <= highest
    return Detected(
        doubt.confidence, lowest if known else 0.0, highest if known else 0.0, int(count), area,
        doubt.error(up2, up), doubt.error(down2, down), doubt.error(up2 + down2, up + down), gain, loss,
    )  # fmt: skip
