"""Tracks that stand: tubes where they run, and space–time paths, whose height is the time.

A path (Hägerstrand 1970; the space–time cube over a map: Kraak 2003) begins at the height of the terrain's highest
place at the earliest time that is shown, and rises evenly. A frame and an axis with moments say which height is when.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.signs import INK
from orograph.geovis.data.standing import Kind, Mark, Things, longer
from orograph.geovis.data.standing_aids import OTHER_BAND
from orograph.geovis.data.standing_colors import Caption, colors_of
from orograph.geovis.data.standing_lines import PIECES
from orograph.geovis.data.times import ticks, written
from orograph.geovis.data.tracks import Tracks, until
from orograph.geovis.keys import Legend

Array = NDArray[np.float64]

STYLES = ("tubes", "paths")

ACROSS = {"tubes": 130, "paths": 3}
"""How many diameters of tubes, or heights of all time, go along the terrain's longer side, where no size is given."""

THIN, AXIS = 1 / 2200, 1 / 700
"""Radii of the frame and of the axis, parts of the terrain's longer side; of paths see ``ACROSS``."""

ABOVE = 0.03
"""Of the height of all time, how far over the terrain's highest place it begins."""


class Pieces(NamedTuple):
    """Straight pieces of tracks: (n, 4) x, y, metres and seconds of both ends, and (n,) the sample of each."""

    start: Array
    end: Array
    of: NDArray[np.int64]


def things_of_tracks(
    dataset: Dataset, tracks: Tracks, grid: Grid, highest: float, stretch: float, moment: float | None
) -> Things:
    """What stands for tracks.

    Args:
        highest: metres of the terrain. stretch: by which a picture stretches heights, for the usual height of paths.
        moment: seconds; what is later is not shown. None: all.

    Raises:
        UsageError: nothing says when, and height is time, or a moment is asked for.
    """
    size = dataset.size if dataset.size is not None else longer(grid) / ACROSS[str(dataset.style)]
    paths = dataset.style == "paths"
    whole = tracks
    if (paths or moment is not None) and not np.isfinite(tracks.seconds).any():
        raise UsageError(
            "Nothing says when its places were reached.", path=dataset.called, remedy="Name it: when=NAME."
        )
    if moment is not None:
        tracks = until(tracks, moment)
    step = max(*grid.spacing, longer(grid) / PIECES)
    follows = not paths and not np.isfinite(tracks.at[:, 2]).any()
    pieces = _on(_pieces(tracks, step if follows else np.inf), grid)
    span = _span(whole, grid)
    height = size if dataset.size is not None else size / stretch
    start, end = pieces.start, pieces.end
    if paths:
        base = highest + ABOVE * height
        rise = height / max(span[1] - span[0], 1e-9)
        levels = [base + (one[:, 3] - span[0]) * rise for one in (start, end)]
    else:
        levels = [start[:, 2], end[:, 2]]
    values = tracks.values[pieces.of]
    sigma = None if tracks.sigma is None else tracks.sigma[pieces.of]
    count = f"{tracks.tracks} track{'s' * (tracks.tracks != 1)}"
    when = "" if moment is None else f"until {written(moment)[:16].replace('T', ' ')}"
    note = ", ".join(filter(None, (count, when, "height is time (UTC)" if paths else "")))
    rgb, legend, *_ = colors_of(_of_all(dataset, whole), values, sigma,
                                Caption(tracks.name, dataset.unit or tracks.unit, note, tracks.classes))  # fmt: skip
    wide = longer(grid) / ACROSS["tubes"] if paths else size
    n = len(values)
    lift = np.where(np.isfinite(levels[0]), 0.0, wide / 2)
    main = Things.plain(legend).but(
        kind=np.full(n, Kind.TUBE, np.int8), x=start[:, 0], y=start[:, 1], lift=lift, radius=np.full(n, wide / 2),
        height=np.full(n, wide), rgb=rgb, values=values,
        ends=np.column_stack([levels[0], end[:, :2], levels[1]]), hidden=np.full(n, dataset.through),
    )  # fmt: skip
    return Things.joined([main, *_axis(span, base, height, grid)]) if paths else main


def _of_all(dataset: Dataset, whole: Tracks) -> Dataset:
    """Data with the scale of all times, whatever moment is shown."""
    if dataset.range is not None or whole.classes is not None:
        return dataset
    from orograph.geovis.data.scales import Shared, spanned

    return dataset.but(range=Shared(spanned(whole.values, None)))


def _span(tracks: Tracks, grid: Grid) -> tuple[float, float]:
    """The first and the last moment of what lies on the terrain."""
    col, row = grid.index(tracks.at[:, 0], tracks.at[:, 1])
    here = (col >= 0) & (row >= 0) & (col <= grid.cols - 1) & (row <= grid.rows - 1)
    return float(np.min(tracks.seconds[here])), float(np.max(tracks.seconds[here]))


def _pieces(tracks: Tracks, step: float) -> Pieces:
    """Pieces no longer than a step; a sample's own reach halfway to its neighbours."""
    at = np.column_stack([tracks.at, tracks.seconds])
    first = np.flatnonzero(np.diff(tracks.part) == 0)
    middle = (at[first] + at[first + 1]) / 2
    start = np.stack([at[first], middle], 1).reshape(-1, 4)
    end = np.stack([middle, at[first + 1]], 1).reshape(-1, 4)
    of = np.stack([first, first + 1], 1).ravel()
    count = np.maximum(1, np.ceil(np.hypot(*(end - start)[:, :2].T) / step)).astype(int)
    which = np.repeat(np.arange(len(of)), count)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)) / count[which]
    way = (end - start)[which]
    begin = start[which] + way * share[:, None]
    return Pieces(begin, begin + way / count[which][:, None], of[which])


def _on(pieces: Pieces, grid: Grid) -> Pieces:
    """Those whose both ends are on the terrain."""
    here = np.ones(len(pieces.of), bool)
    for end in pieces[:2]:
        col, row = grid.index(end[:, 0], end[:, 1])
        here &= (col >= 0) & (row >= 0) & (col <= grid.cols - 1) & (row <= grid.rows - 1)
    return Pieces(pieces.start[here], pieces.end[here], pieces.of[here])


def _axis(span: tuple[float, float], base: float, height: float, grid: Grid) -> list[Things]:
    """The frame of the first and the last moment, and at a corner an axis with moments."""
    right, bottom = grid.cols - 1.0, grid.rows - 1.0
    x, y = grid.xy(np.array([0.0, right, right, 0.0]), np.array([bottom, bottom, 0.0, 0.0]))
    corners = np.stack([x, y], 1)
    ink = np.asarray(INK, np.float32)
    frame = [_tube(corners, np.roll(corners, -1, 0), level, level, THIN * longer(grid), ink)
             for level in (base, base + height)]  # fmt: skip
    posts = _tube(corners[1:], corners[1:], base, base + height, THIN * longer(grid), ink)
    seconds, words = ticks(*span)
    level = base + (seconds - span[0]) / max(span[1] - span[0], 1e-9) * height
    edges = np.concatenate([[base], level, [base + height]])
    corner = np.repeat(corners[:1], len(edges) - 1, 0)
    shades = np.where((np.arange(len(edges) - 1) % 2 == 0)[:, None], INK, OTHER_BAND).astype(np.float32)
    axis = _tube(corner, corner, edges[:-1], edges[1:], AXIS * longer(grid), shades)
    marks = tuple(Mark(float(x[0]), float(y[0]), float(at), word) for at, word in zip(level, words))
    return [*frame, posts, axis.but(marks=marks)]


def _tube(start: Array, end: Array, low: Array | float, high: Array | float, radius: float, rgb: Any) -> Things:
    n = len(start)
    ends = np.column_stack([np.broadcast_to(low, n), end, np.broadcast_to(high, n)])
    return Things.plain(Legend()).but(
        kind=np.full(n, Kind.TUBE, np.int8), x=start[:, 0], y=start[:, 1], lift=np.zeros(n), radius=np.full(n, radius),
        height=np.full(n, 2 * radius), rgb=np.broadcast_to(rgb, (n, 3)).astype(np.float32),
        values=np.full(n, np.nan), ends=ends,
    )  # fmt: skip
