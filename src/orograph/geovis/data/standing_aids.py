"""Aids to see where floating things are: drop lines, height poles, and shadows on the ground straight below them.

All are things themselves: their depth is as exact as that of what they belong to. Along a track they stand at equal
distances. A shadow falls straight down whatever the light does: it says where, which a slanting one does not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.signs import INK
from orograph.geovis.data.standing import Kind, Things, longer
from orograph.geovis.keys import Legend

Array = NDArray[np.float64]

THIN, POLE = 1 / 1800, 1 / 600
"""Radii of drop lines and poles, parts of the terrain's longer side."""

APART = 32
"""Along a track: so many drop lines or poles to the terrain's longer side."""

OTHER_BAND = (0.79, 0.35, 0.0)
"""The colour of every other band of a pole, linear: an orange that is told from ink by all eyes, and seen on snow."""

BANDS = 7
"""How many bands the highest pole has at most, about, where no step is given."""

MOST = 500_000
"""Bands of all poles together."""

PLATE = 5
"""Every how many bands a pole has a plate."""


class Floating(NamedTuple):
    """Places that float: (n,) in the terrain's CRS, and (n,) metres above the heights' zero; (n,) with which opacity
    they are seen through the ground."""

    x: Array
    y: Array
    level: Array
    hidden: Array


def floating(things: Things, grid: Grid) -> Floating:
    """Where aids stand for things: below each that floats by itself, and along tubes at equal distances."""
    if things.ends is None:
        none = np.empty(0)
        return Floating(none, none, none, none)
    level, x1, y1, level1 = things.ends.T
    through = np.zeros(len(level)) if things.hidden is None else things.hidden
    alone = np.isfinite(level) & np.isnan(x1)
    tube = (things.kind == Kind.TUBE) & np.isfinite(level) & np.isfinite(level1)
    x, y, z = things.x[tube], things.y[tube], level[tube]
    dx, dy, dz = x1[tube] - x, y1[tube] - y, level1[tube] - z
    along = np.concatenate([[0.0], np.cumsum(np.hypot(dx, dy))])
    at = np.arange(0.0, along[-1], longer(grid) / APART)
    piece = np.clip(np.searchsorted(along, at, side="right") - 1, 0, max(len(x) - 1, 0))
    part = (at - along[piece]) / np.maximum(np.diff(along)[piece], 1e-12) if len(at) else at
    return Floating(
        np.concatenate([things.x[alone], x[piece] + part * dx[piece]]),
        np.concatenate([things.y[alone], y[piece] + part * dy[piece]]),
        np.concatenate([level[alone], z[piece] + part * dz[piece]]),
        np.concatenate([through[alone], through[tube][piece]]),
    )


def drops(at: Floating, ground: Array, grid: Grid) -> Things:
    """Lines straight down to the ground, and up to it from what is seen through it.

    Args:
        ground: (n,) heights of the ground there; what is below it and not seen has no line.
    """
    x, y, level, hidden = (v[(at.level > ground) | ((at.hidden > 0) & (at.level < ground))] for v in at)
    ends = np.column_stack([np.full(len(x), np.nan), x, y, level])
    return _plain(Kind.TUBE, x, y, ends, THIN * longer(grid), np.asarray(INK, np.float32)).but(hidden=hidden)


def poles(at: Floating, ground: Array, step: float, grid: Grid) -> Things:
    """Ranging rods: bands of ``step`` metres from the ground to what floats above it, with plates.

    Raises:
        UsageError: there would be too many bands.
    """
    above = at.level > ground
    x, y, top = (v[above] for v in at[:3])
    foot = ground[above]
    count = np.maximum(np.ceil((top - foot) / step - 1e-9), 1)  # (no band that rounding makes)
    if count.sum() > MOST:
        raise UsageError(
            f"Poles would have {count.sum():.3g} bands of {step:g} m.", remedy="Give a larger step: poles=METRES."
        )
    of = np.repeat(np.arange(len(x)), count.astype(np.int64))
    number = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count.astype(np.int64))
    low = foot[of] + number * step
    radius = POLE * longer(grid)
    shades = np.where((number % 2 == 0)[:, None], INK, OTHER_BAND).astype(np.float32)
    ends = np.column_stack([low, x[of], y[of], np.minimum(low + step, top[of])])
    rods = _plain(Kind.TUBE, x[of], y[of], ends, radius, shades)
    fifth = (number % PLATE == 0) & (number > 0)
    free = np.full(int(fifth.sum()), np.nan)
    plates = _plain(
        Kind.CYLINDER, x[of][fifth], y[of][fifth], np.column_stack([low[fifth], free, free, free]), 2.6 * radius,
        np.asarray(INK, np.float32), lift=-radius / 2,
    )  # fmt: skip
    joined = Things.joined([rods, plates])
    return Things(
        joined.kind, joined.x, joined.y, joined.lift, joined.radius, np.full(len(joined), radius), joined.rgb,
        joined.values, Legend(note=f"poles: bands of {step:g} m above ground"), joined.ends,
    )  # fmt: skip


def shadows(things: Things, middle: Array) -> Things | None:
    """Shadows of things that float.

    Args:
        middle: (n,) heights of the ground below the things' middles.
    """
    if things.ends is None:
        return None
    level, x1, y1, level1 = things.ends.T
    floats = np.isfinite(level) & (np.fmax(level, level1) > middle)
    x, y = things.x[floats], things.y[floats]
    ends = np.column_stack([
        np.full(len(x), np.nan), np.where(np.isnan(x1), things.x, x1)[floats],
        np.where(np.isnan(y1), things.y, y1)[floats], np.full(len(x), np.nan),
    ])  # fmt: skip
    return _plain(Kind.SHADOW, x, y, ends, things.radius[floats], np.zeros(3, np.float32))


def middles(things: Things) -> tuple[Array, Array]:
    """(n,) eastings and northings of things' middles."""
    if things.ends is None:
        return things.x, things.y
    _, x1, y1, _ = things.ends.T
    x, y = (things.x + x1) / 2, (things.y + y1) / 2
    return np.where(np.isnan(x1), things.x, x), np.where(np.isnan(y1), things.y, y)


def _plain(
    kind: Kind, x: Array, y: Array, ends: Array, radius: float | Array, rgb: NDArray[np.float32], lift: float = 0.0
) -> Things:
    """Things that show no value."""
    n = len(x)
    size = np.broadcast_to(np.asarray(radius, np.float64), n).copy()
    return Things(
        np.full(n, kind, np.int8), x, y, np.full(n, lift), size, 2 * size,
        np.broadcast_to(rgb, (n, 3)).astype(np.float32), np.full(n, np.nan), Legend(), ends,
    )  # fmt: skip
