"""Extrinsic signs of uncertainty on what stands upright: triangles, and hatching of upright lines.

They lie close before the sections of a volume, or the curtain along a line, whose values are colours: triangles on a
lattice, larger and darker the more uncertain the value at their middle is (figure 5 of Dübel et al. 2017), or lines,
wider where it is more uncertain. Both are made of upright rectangles. Units: metres; heights are those of the data,
which the picture stretches.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.color import linear_to_srgb
from orograph.geovis.data.patterns import hatched
from orograph.geovis.data.signs import INK, WARNING, Paint, signed

Array = NDArray[np.float64]

MARKS = ("glyphs", "hatching")

ACROSS = 40
"""Signs along the terrain's longer side."""

STRIPS = 10
"""Rectangles that a triangle is made of, from its foot to its tip."""

LEAST, MORE = 0.16, 0.30
"""Of the pitch, from a triangle's middle to its corners: where data are certain, and what uncertainty adds."""

EDGE = 0.05
"""Of the pitch, the width of a triangle's outline."""

WIDEST, LINES = 0.6, 3
"""Of their distance, how wide the lines of a hatching are at most; how many there are to a sign."""

BEFORE = 1e-4
"""Of the terrain's longer side, how far before a face each layer of signs lies."""

TILE = 32
"""Texels of a legend's swatch."""


class Face(NamedTuple):
    """Upright cells along a line.

    Attributes:
        start, end: (m, 2) the pieces of the line. column: (n,) the piece that each cell stands over. low, top: (n,)
            heights. u: (n,) uncertainties along their scale, 0 to 1. values: (n,).
    """

    start: Array
    end: Array
    column: NDArray[np.int64]
    low: Array
    top: Array
    u: Array
    values: Array


class Marks(NamedTuple):
    """Upright rectangles (k): from ``start`` to ``end`` (k, 2), from ``low`` to ``top``.

    Attributes:
        rgb: (k, 3) linear. values: (k,) of the cell behind. layer: (k,) 1, or 2 of what lies before that.
    """

    start: Array
    end: Array
    low: Array
    top: Array
    rgb: NDArray[np.float32]
    values: Array
    layer: NDArray[np.int64]

    def before(self, gap: float) -> tuple[Array, Array]:
        """(k, 2) where they start and end, moved ``gap`` a layer to the left of their way (below 0: to its right)."""
        way = self.end - self.start
        left = np.stack([-way[:, 1], way[:, 0]], 1) / np.maximum(np.hypot(*way.T), 1e-30)[:, None]
        out = left * (gap * self.layer)[:, None]
        return self.start + out, self.end + out


def marks_on(face: Face, sign: str, pitch: float, stretch: float) -> Marks:
    """The signs on a face.

    Args:
        sign: "glyphs" or "hatching". pitch: from sign to sign along the line. stretch: of heights in the picture.
    """
    rise = pitch / stretch
    return _lines(face, pitch / LINES) if sign == "hatching" else _triangles(face, pitch, rise)


def swatch(rgb: Sequence[float] | NDArray[np.floating], u: float, sign: str) -> NDArray[np.uint8]:
    """A legend's tile (rows, cols, 3) of a colour with a sign over it."""
    y, x = np.mgrid[:TILE, :TILE] + 0.5
    doubt = np.full((TILE, TILE), u)
    color = np.broadcast_to(np.asarray(rgb, np.float32), (TILE, TILE, 3))
    paint = Paint(x, y, TILE / 2, np.zeros((TILE, TILE)), None, doubt, color, np.ones((TILE, TILE)))
    if sign == "hatching":
        paint = paint.under(INK, hatched(x, y, TILE / 2 / LINES, WIDEST * doubt, 0.0))
    else:
        paint = signed(paint, sign)
    return np.asarray(np.rint(linear_to_srgb(paint.rgb) * 255), np.uint8)


def _stations(face: Face, step: float) -> tuple[Array, NDArray[np.int64], Array]:
    """Places (k, 2) at steps along the line, their pieces, and the directions there."""
    way = face.end - face.start
    long = np.hypot(*way.T)
    total = np.concatenate([[0.0], np.cumsum(long)])
    count = max(1, int(total[-1] // step))
    at = (np.arange(count) + 0.5) * total[-1] / count
    piece = np.clip(np.searchsorted(total, at, "right") - 1, 0, len(long) - 1)
    toward = way[piece] / np.maximum(long[piece], 1e-30)[:, None]
    return face.start[piece] + toward * (at - total[piece])[:, None], piece, toward


def _cells_at(face: Face, piece: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which stations have which cells: numbers of stations, and of cells, by station and height."""
    order = np.lexsort([face.low, face.column])
    first, last = (np.searchsorted(face.column[order], piece, side) for side in ("left", "right"))
    count = last - first
    station = np.repeat(np.arange(len(piece)), count)
    within = np.arange(len(station)) - np.repeat(np.cumsum(count) - count, count)
    return station, order[np.repeat(first, count) + within]


def _lines(face: Face, step: float) -> Marks:
    place, piece, toward = _stations(face, step)
    station, cell = _cells_at(face, piece)
    half = (step * WIDEST / 2 * face.u[cell])[:, None] * toward[station]
    middle, n = place[station], len(cell)
    return Marks(
        middle - half, middle + half, face.low[cell], face.top[cell], np.tile(INK, (n, 1)), face.values[cell],
        np.ones(n, np.int64),
    )  # fmt: skip


def _triangles(face: Face, pitch: float, rise: float) -> Marks:
    place, piece, toward = _stations(face, pitch)
    base, highest = float(face.low.min()), float(face.top.max())
    rows = max(1, int((highest - base) // rise))
    at = base + (np.arange(rows) + 0.5) * (highest - base) / rows
    station, cell = _cells_at(face, piece)
    there = (face.low[cell, None] <= at) & (at < face.top[cell, None])
    k, row = np.nonzero(there)
    none = np.empty((0, 2))
    flat = none[:, 0]
    found = [Marks(none, none, flat, flat, np.empty((0, 3), np.float32), flat, flat.astype(np.int64))]
    for one, height in zip(k, at[row]):
        where, of = station[one], cell[one]
        found += _triangle(place[where], toward[where], height, face.u[of], face.values[of], pitch, rise)
    return Marks(*(np.concatenate(parts) for parts in zip(*found)))


def _triangle(
    middle: Array, toward: Array, height: float, u: float, value: float, pitch: float, rise: float
) -> list[Marks]:
    """A triangle, tip up, and its darker outline behind it."""
    radius = pitch * (LEAST + MORE * u)
    colors = INK, WARNING[min(int(u * 3), 2)]
    found = []
    # The outline is a triangle whose sides lie EDGE farther out: those of one of twice that much larger a radius.
    for layer, (size, color) in enumerate(zip((radius + 2 * EDGE * pitch, radius), colors), 1):
        edges = np.linspace(-size / 2, size, STRIPS + 1)
        half = (size - (edges[1:] + edges[:-1]) / 2) / np.sqrt(3)
        reach = half[:, None] * toward
        low, top = (height + edges[part] * rise / pitch for part in (slice(None, -1), slice(1, None)))
        found.append(Marks(
            middle - reach, middle + reach, low, top, np.tile(color.astype(np.float32), (STRIPS, 1)),
            np.full(STRIPS, value), np.full(STRIPS, layer),
        ))  # fmt: skip
    return found
