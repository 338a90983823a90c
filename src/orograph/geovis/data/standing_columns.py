"""Boreholes and ascents: columns along which values change, in the ground, over it, or raised onto it.

Intervals (from, to) have the length that they say. Samples at single depths or heights reach halfway to their
neighbours in the same hole, and the outermost as far beyond. ``columns`` are where the samples are, and stretched as
the ground is; ``logs`` are raised until the lowest end stands on the ground, of one scale of depth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.points import Points
from orograph.geovis.data.standing import Kind, Things, longer
from orograph.geovis.data.standing_colors import Caption, colors_of

Array = NDArray[np.float64]

STYLES = ("columns", "logs")

ACROSS = {"columns": 90, "logs": 8}
"""How many diameters of columns, or heights of the deepest log, go along the terrain's longer side, where no size is
given."""

SLENDER = 0.05
"""Radius of logs by the height of the deepest."""


class Parts(NamedTuple):
    """Parts of holes.

    Attributes:
        start, end: (m, 3) x, y and metres, as the points' levels count them. of: (m,) the point that each belongs to.
        hole: (m,) the hole. alone: holes of one sample, which have no length.
    """

    start: Array
    end: Array
    of: NDArray[np.int64]
    hole: NDArray[np.int64]
    alone: int


def things_of_profiles(dataset: Dataset, points: Points, grid: Grid, ground: Array) -> Things:
    """What stands for values along boreholes.

    Args:
        ground: (n,) heights of the ground at the points.

    Raises:
        UsageError: nothing says how deep or high the points are, or no hole has two; the uncertainty's sign.
    """
    if dataset.leveled is None or points.level is None:
        raise UsageError(
            f"Nothing gives the depth or height of the samples of {dataset.style}.", path=dataset.called,
            remedy="Name the attribute: depth=, above= or height=; of intervals depth=from+to.",
        )  # fmt: skip
    parts = parts_of(points)
    if not len(parts.of):
        raise UsageError(
            f"None of its {parts.alone} holes has two samples, and one has no length.", path=dataset.called,
            remedy="Group those that belong together (group=NAME), or show them as spheres.",
        )  # fmt: skip
    count = len(np.unique(parts.hole))
    notes = [f"{count} hole{'s' * (count != 1)}"]
    if parts.alone:
        notes.append(f"{parts.alone} of one sample left out")
    logs = dataset.style == "logs"
    if logs and dataset.leveled != "depth":
        raise UsageError("Logs need depths.", path=dataset.called, remedy="Give depth=, or choose columns.")
    if logs:
        deepest = float(max(parts.start[:, 2].max(), parts.end[:, 2].max()))
        notes.append(f"raised onto the ground, the deepest {deepest:.4g} m")
    values = points.values[parts.of]
    sigma = None if points.sigma is None else points.sigma[parts.of]
    caption = Caption(points.name, dataset.unit or "", ", ".join(notes), points.classes)
    rgb, legend, *_ = colors_of(dataset, values, sigma, caption)
    size = dataset.size if dataset.size is not None else longer(grid) / ACROSS[str(dataset.style)]
    if logs:
        return _logs(parts, values, size, rgb, Things.plain(legend))
    return _columns(parts, values, size, rgb, ground, dataset, Things.plain(legend))


def parts_of(points: Points) -> Parts:
    """The parts of holes that points stand for."""
    assert points.level is not None
    n = len(points.x)
    places = np.unique(np.stack([points.x, points.y], 1), axis=0, return_inverse=True)[1].reshape(n)
    hole = places if points.group is None else points.group
    if points.level.ndim == 2:
        start, end = (np.stack([points.x, points.y, points.level[:, k]], 1) for k in (0, 1))
        long = start[:, 2] != end[:, 2]
        of = np.flatnonzero(long)
        return Parts(start[long], end[long], of, hole[long], 0)
    order = np.lexsort([points.level, hole])
    at, hole = np.stack([points.x, points.y, points.level], 1)[order], hole[order]
    same = hole[1:] == hole[:-1]
    middle = (at[1:] + at[:-1]) / 2
    before, after = np.concatenate([[False], same]), np.concatenate([same, [False]])
    from_, to = np.concatenate([at[:1], middle]), np.concatenate([middle, at[-1:]])
    start = np.where(before[:, None], from_, 2 * at - to)
    end = np.where(after[:, None], to, 2 * at - from_)
    some = before | after
    keep = some & (start[:, 2] != end[:, 2])
    return Parts(start[keep], end[keep], order[keep], hole[keep], int((~some).sum()))


def _columns(
    parts: Parts, values: Array, size: float, rgb: NDArray[np.float32], ground: Array, dataset: Dataset, bare: Things
) -> Things:
    """Cylinders, and tubes where a hole is not upright, at their heights."""
    base = ground[parts.of]
    start, end = parts.start.copy(), parts.end.copy()
    if dataset.depth is not None:
        for one in (start, end):
            one[:, 2] = base - np.maximum(one[:, 2], 0.0)
    elif dataset.above is not None:
        for one in (start, end):
            one[:, 2] = base + np.maximum(one[:, 2], 0.0)
    known = np.isfinite(start[:, 2]) & np.isfinite(end[:, 2]) & (start[:, 2] != end[:, 2])
    start, end, rgb, values = start[known], end[known], rgb[known], values[known]
    foot = np.where((start[:, 2] <= end[:, 2])[:, None], start, end)
    top = np.where((start[:, 2] <= end[:, 2])[:, None], end, start)
    upright = np.hypot(*(top - foot)[:, :2].T) < 1e-6 * (top - foot)[:, 2]
    n = len(foot)
    return bare.but(
        kind=np.where(upright, Kind.COLUMN, Kind.TUBE).astype(np.int8), x=foot[:, 0], y=foot[:, 1], lift=np.zeros(n),
        radius=np.full(n, size / 2), height=np.full(n, size), rgb=rgb, values=values,
        ends=np.column_stack([foot[:, 2], top]), hidden=np.full(n, dataset.through),
    )  # fmt: skip


def _logs(parts: Parts, values: Array, size: float, rgb: NDArray[np.float32], bare: Things) -> Things:
    """Cylinders that stand on the ground, by depth from their top down."""
    low = np.maximum(np.minimum(parts.start[:, 2], parts.end[:, 2]), 0.0)
    high = np.maximum(np.maximum(parts.start[:, 2], parts.end[:, 2]), 0.0)
    deepest = np.zeros(int(parts.hole.max()) + 1)
    np.maximum.at(deepest, parts.hole, high)
    metres = size / deepest.max()
    keep = high > low
    low, high, hole = low[keep], high[keep], parts.hole[keep]
    n = len(low)
    # A hole that is not upright stands where it begins.
    first = np.full((len(deepest), 3), np.inf)
    for k in np.argsort(-low, kind="stable"):
        first[hole[k]] = parts.start[keep][k]
    return bare.but(
        kind=np.full(n, Kind.CYLINDER, np.int8), x=first[hole, 0], y=first[hole, 1],
        lift=(deepest[hole] - high) * metres, radius=np.full(n, size * SLENDER), height=(high - low) * metres,
        rgb=rgb[keep], values=values[keep],
    )  # fmt: skip
