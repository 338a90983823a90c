"""The referee of pictures: a depth image, the terrain and the view → a ``DepthReport``.

Every renderer of terrain leaves a depth at each pixel. The truth for comparison is the referee's own (``walk``). See
docs/verify.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.parallel import aside
from orograph.store.terrain import TILE, Terrain
from orograph.verify.frustum import Camera
from orograph.verify.judge import check_exaggeration
from orograph.verify.report import ROUNDING
from orograph.verify.walk import Rays, true_depth
from orograph.viewpoint import View

Image = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DepthReport:
    """The verdict on a depth image.

    Attributes:
        hits, misses: pixels in which the full-resolution surface is visible, and those in which nothing is.
        largest: the largest distance in pixels between the point that a pixel shows and the full-resolution surface on
            its vertical, over the pixels that agree with the truth on whether there is ground.
        worst: (x, y) of that pixel; None if no pixel shows ground where there is some.
        rms, most: root of the mean square of the same, and its 99.9th percentile.
        mismatches: pixels that do not agree: ground is shown where there is none, or the other way round, or at a place
            where the terrain has none.
        farthest: pixels from a mismatch to the nearest pixel that agrees, the largest; infinite if none agrees.
        farthest_at: (x, y) of that mismatch; None if there is none.
        errors: (h, w) float64, pixels: these distances; 0 where nothing is visible, and nothing shown.
        truth: (h, w) float64, the depth of the full-resolution surface in metres, NaN where it is not visible.
    """

    hits: int
    misses: int
    largest: float
    worst: tuple[int, int] | None
    rms: float
    most: float
    mismatches: int
    farthest: float
    farthest_at: tuple[int, int] | None
    errors: Image = field(repr=False, compare=False)
    truth: Image = field(repr=False, compare=False)

    def ok(self, tolerance: float = math.inf) -> bool:
        """Whether no pixel shows a point more than ``tolerance`` pixels from the surface, and mismatches are near.

        Mismatches may be √2 pixels farther from a pixel that agrees: a moved outline changes whole pixels.
        """
        bound = tolerance * (1 + ROUNDING)
        return self.largest <= bound and (self.mismatches == 0 or self.farthest <= bound + math.sqrt(2))

    def to_dict(self) -> dict[str, Any]:
        """The numbers as JSON values; an infinite distance is None."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("errors", "truth")}
        for name in ("largest", "rms", "most", "farthest"):
            if not math.isfinite(values[name]):
                values[name] = None
        for name in ("worst", "farthest_at"):
            values[name] = None if values[name] is None else list(values[name])
        return values

    def __str__(self) -> str:
        at = "" if self.worst is None else f" at pixel {self.worst[0]}, {self.worst[1]}"
        lines = [
            f"{self.hits:,} pixels with ground, {self.misses:,} without",
            f"error: {self.largest:.4g} px at most{at}, {self.rms:.4g} px rms, 99.9 % within {self.most:.4g} px",
        ]
        if self.farthest_at is not None:
            lines.append(
                f"{self.mismatches:,} pixels wrongly show ground or none: up to {self.farthest:.4g} px from one that "
                f"agrees, at pixel {self.farthest_at[0]}, {self.farthest_at[1]}"
            )
        return "\n".join(lines)


def judge_depth(
    depth: NDArray[np.floating], terrain: Terrain, view: View, *, exaggeration: float = 1.0, jobs: int | None = None
) -> DepthReport:
    """Measure a depth image against the full-resolution surface.

    Args:
        depth: (h, w) float32 or float64, metres along the viewing direction at the pixels' centres; NaN (or anything
            not finite) where nothing is shown.
        terrain: of the picture; read by tiles.
        view: the camera, of h × w pixels, in the terrain's CRS.
        exaggeration: of the picture.
        jobs: threads; the result does not depend on it.

    Raises:
        UsageError: the image has another shape or type, or the exaggeration is not positive. DamagedChunkError: as
            ``terrain.read``.
    """
    check_exaggeration(exaggeration)
    if depth.shape != (view.height, view.width) or depth.dtype not in (np.float32, np.float64):
        raise UsageError(
            f"A depth image of this view must be float32 or float64 of shape ({view.height}, {view.width}), not "
            f"{depth.dtype} {depth.shape}."
        )
    return aside(partial(_judge, depth, terrain, view, Camera.of(view, terrain.grid, exaggeration), jobs))


def _judge(depth: NDArray[np.floating], terrain: Terrain, view: View, camera: Camera, jobs: int | None) -> DepthReport:
    from scipy.ndimage import distance_transform_edt

    truth = true_depth(terrain, camera, view, jobs)
    shown = np.isfinite(depth)
    errors = np.zeros(depth.shape)
    errors[shown] = vertical_pixels(depth, shown, terrain, view, camera)
    wrong = (shown != np.isfinite(truth)) | np.isnan(errors)
    both = shown & ~wrong
    if wrong.any():
        apart = np.full(depth.shape, np.inf) if wrong.all() else distance_transform_edt(wrong)
        errors[wrong] = apart[wrong]
    there = errors[both]
    return DepthReport(
        hits=int(np.isfinite(truth).sum()),
        misses=int(np.isnan(truth).sum()),
        largest=float(there.max(initial=0.0)),
        worst=_first(np.where(both, errors, -1.0)) if both.any() else None,
        rms=float(np.sqrt(np.mean(there**2))) if there.size else 0.0,
        most=float(np.quantile(there, 0.999)) if there.size else 0.0,
        mismatches=int(wrong.sum()),
        farthest=float(errors[wrong].max(initial=0.0)),
        farthest_at=_first(np.where(wrong, errors, -1.0)) if wrong.any() else None,
        errors=errors,
        truth=truth,
    )


def _first(values: Image) -> tuple[int, int]:
    """(x, y) of the first largest value."""
    y, x = divmod(int(values.argmax()), values.shape[1])
    return x, y


def vertical_pixels(
    depth: NDArray[np.floating], shown: NDArray[np.bool_], terrain: Terrain, view: View, camera: Camera
) -> Image:
    """Pixels (n,) between the points that pixels show and the full-resolution surface on their verticals.

    NaN where there is none. A point may be off the surface by the rounding of its depth.
    """
    rays, lens = Rays.of(camera, view), camera.lens
    exact = depth.astype(np.float64)
    point = rays.places(np.where(shown, exact, 0.0))[shown]
    rounded = np.where(shown, exact * (1.0 + 2.0 * np.finfo(depth.dtype).eps), 0.0)
    slack = 1e-9 + np.abs(rays.places(rounded)[shown] - point)
    column, row, height = np.moveaxis(point, -1, 0)
    ground = surface(terrain, column, row)
    for across, down in ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)):
        beside = np.flatnonzero(np.isnan(ground))
        ground[beside] = surface(
            terrain, column[beside] + across * slack[beside, 0], row[beside] + down * slack[beside, 1]
        )
    if lens.p1 == 0:
        return np.where(np.isnan(ground), np.nan, 0.0)
    x, y, w = lens.matrix @ np.stack([column, row, height, np.ones_like(height)])
    drop, (a, b, c) = ground - height, lens.matrix[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = np.abs(drop) * np.hypot(a * w - c * x, b * w - c * y) / (lens.p1 * w * (w + c * drop))
    return np.where((w > 0) & (w + c * drop > 0) | np.isnan(drop), pixels, np.inf)


def surface(terrain: Terrain, column: Image, row: Image) -> Image:
    """Heights (n,) of the full-resolution surface at places on the raster; NaN outside it and in holes."""
    rows, cols = terrain.grid.shape
    found = np.full(column.shape, np.nan)
    on = np.flatnonzero((column >= 0) & (column <= cols - 1) & (row >= 0) & (row <= rows - 1))
    if min(rows, cols) < 2 or not len(on):
        return found
    c = np.minimum(column[on].astype(np.int64), cols - 2)
    r = np.minimum(row[on].astype(np.int64), rows - 2)
    tile = r // TILE << 32 | c // TILE
    order = np.argsort(tile, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(tile[order])) + 1):
        top, west = (int(v[part[0]]) // TILE * TILE for v in (r, c))
        heights = terrain.read(0, top, min(top + TILE + 1, rows), west, min(west + TILE + 1, cols)).astype(np.float64)
        i, j, u, v = r[part] - top, c[part] - west, column[on[part]] - c[part], row[on[part]] - r[part]
        nw, ne, sw, se = heights[i, j], heights[i, j + 1], heights[i + 1, j], heights[i + 1, j + 1]
        even = (r[part] + c[part]) % 2 == 0
        upper = np.where(even, nw + u * (ne - nw) + v * (se - ne), nw + u * (ne - nw) + v * (sw - nw))
        lower = np.where(even, nw + v * (sw - nw) + u * (se - sw), se + (1 - u) * (sw - se) + (1 - v) * (ne - se))
        found[on[part]] = np.where(np.where(even, u >= v, u + v <= 1), upper, lower)
    return found
