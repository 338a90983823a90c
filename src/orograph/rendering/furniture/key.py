"""The legend as a piece of furniture: scales with their ticks, squares of two things in one colour, swatches."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.color import linear_to_srgb
from orograph.geovis.keys import Legend, Scale, Square, minus
from orograph.rendering.furniture.lettering import Color, Style, cut, length
from orograph.rendering.furniture.pieces import GREY, INK, PAPER, Piece, number, ticks

WIDEST, LEAST, LINE = 11.0, 3.5, 1.2
"""Units: the width of words, the height of one of several scales, and from line to line of words."""


def fewer(legend: Legend, count: int) -> Legend:
    """The legend with its first swatches only, and how many are left out."""
    more = (f"and {len(legend.swatches) - count} more", None)
    return replace(legend, swatches=(*legend.swatches[:count], more) if count else ())


def key(legend: Legend, style: Style, size: float) -> Piece:
    """The scales with their ticks, ``size`` units high in all; below them the swatches; headings have no colour."""
    u, pad, small = style.unit, style.pad, style.font(0.9)
    bar = round(1.15 * u)
    rows = [(titled(words, "", small, style), color) for words, color in legend.swatches]
    each = max(size / max(len(legend.scales), 1), LEAST)
    widest = max([length(small, line) for lines, _ in rows for line in lines], default=0.0)
    piece = Piece(bar + 0.6 * u + widest if rows else 0.0, float(pad))
    for i, scale in enumerate(legend.scales):
        piece.height += 0.9 * u if i else 0.0
        _scale(piece, scale, style, round(each * u), bar)
    for both in legend.squares:
        _square(piece, both, style)
    lead = 0.75 * u if legend.scales or legend.squares else 0.15 * u
    y, high = float(round(piece.height + lead)), round(0.95 * u)  # whole pixels, for patterns
    tall = sum(1.5 + (len(lines) - 1) * LINE for lines, _ in rows) * u
    piece.height += pad + (lead - 0.5 * u + tall if rows else 0.25 * u)
    piece.width += 2 * pad
    for lines, color in rows:
        x, ink = (pad, GREY) if color is None else (pad + bar + 0.65 * u, INK)
        _lines(piece, x, y + 0.78 * u, lines, ink, style)
        if color is not None:
            sample = _bytes(color)
            piece.framed(pad, y, pad + bar, y + high, _color(sample.reshape(-1, 3)[0]), style.hair / 2)
            if sample.ndim == 3:
                piece.patterns.append((pad, y, pad + bar, y + high, sample))
        y = round(y + (1.5 + (len(lines) - 1) * LINE) * u)
    return piece


def titled(words: str, unit: str, font: Any, style: Style) -> list[str]:
    """Words of a legend in at most two lines, the second cut with an ellipsis if need be; a unit stands whole at their
    end."""
    words, end = style.text(words), f" {style.text(f'({unit})')}" if unit else ""
    widest = WIDEST * style.unit
    if length(font, words + end) <= widest:
        return [words + end]
    room, told = widest - length(font, end), words.split()
    most = next((n for n in range(len(told), 0, -1) if length(font, " ".join(told[:n])) <= widest), 0)
    first, rest = " ".join(told[:most]), cut(" ".join(told[most:]), font, room, style)
    return [line for line in (first, (rest + end).strip()) if line]


def _lines(piece: Piece, x: float, y: float, lines: list[str], color: Color, style: Style) -> float:
    """Add lines of words, the first on a baseline, and return the baseline of the last."""
    small = style.font(0.9)
    for k, words in enumerate(lines):
        piece.texts.append((x, y + k * LINE * style.unit, words, small, color, "ls"))
    return y + (len(lines) - 1) * LINE * style.unit


def _scale(piece: Piece, scale: Scale, style: Style, tall: float, bar: float) -> None:
    """Add a scale, its bar ``tall`` and ``bar`` wide: words, colours, ends and ticks. The piece grows accordingly."""
    u, pad, small, tip = style.unit, style.pad, style.font(0.9), 0.8 * style.unit
    lines = titled(scale.label, scale.unit, small, style)
    top = _lines(piece, pad, piece.height + 0.72 * u, lines, GREY, style) + 0.63 * u + (tip if scale.above else 0.0)
    table, line = _bytes(scale.colors), style.hair / 2
    piece.ramps.append((pad, top, pad + bar, top + tall, table))
    for there, y, way, color in ((scale.above, top, -1, table[-1]), (scale.below, top + tall, 1, table[0])):
        for grow, ink in ((line, INK), (-line, _color(color))) if there else ():
            left, right, point = pad - grow, pad + bar + grow, y + way * (tip + 1.6 * grow)
            piece.polygons.append(([(left, y), (right, y), ((left + right) / 2, point)], ink))
    span = scale.high - scale.low
    values = ticks(scale.low, scale.high, max(2, int(tall / (1.9 * u))))
    names = [number(v, values) for v in values]
    for value, name in zip(values, names):
        y = top + tall * (1 - (value - scale.low) / span) if span > 0 else top + tall / 2
        piece.box(pad + bar, y - style.hair / 2, pad + bar + 0.35 * u, y + style.hair / 2, INK)
        _signed(piece, pad + bar + 0.65 * u, y + 0.31 * u, name, small, style)
    reach = max([length(small, name.replace("−", "+")) for name in names], default=0.0)
    piece.width = max(piece.width, bar + 0.8 * u + reach, *(length(small, words) for words in lines))
    piece.height = top + tall + (tip if scale.below else 0.0)


def _signed(piece: Piece, x: float, y: float, name: str, font: Any, style: Style) -> None:
    """Add a number; a minus sign that the typeface lacks is drawn, as wide as a plus."""
    if name.startswith("−") and style.text("−") != "−":
        u, wide = style.unit, length(font, "+")
        half = max(0.5, 0.035 * u)
        piece.box(x + 0.12 * wide, y - 0.29 * u - half, x + 0.88 * wide, y - 0.29 * u + half, INK)
        x, name = x + wide, name[1:]
    piece.texts.append((x, y, style.text(name), font, INK, "ls"))


def _square(piece: Piece, both: Square, style: Style) -> None:
    """Add a square of colours, labelled above and to the right along its two axes. The piece grows accordingly."""
    u, pad, small = style.unit, style.pad, style.font(0.9)
    rows, cols = both.colors.shape[:2]
    up, across = (titled(f"{way} {told}", "", small, style)
                  for way, told in (("up:", both.up), ("across:", both.across)))  # fmt: skip
    cell, left, top = round(2.4 * u), pad, _lines(piece, pad, piece.height + 0.87 * u, up, GREY, style) + 0.63 * u
    piece.framed(left, top, left + cols * cell, top + rows * cell, PAPER, style.hair / 2)
    table = _bytes(linear_to_srgb(both.colors))
    for i in range(rows):
        for j in range(cols):
            y = top + (rows - 1 - i) * cell
            piece.box(left + j * cell, y, left + (j + 1) * cell, y + cell, _color(table[i, j]))
    ends, names = (both.up_edges[1:-1], both.across_edges[1:-1]), []
    for k, value in enumerate(ends[0]):
        y = top + (rows - 1 - k) * cell
        names.append(style.text(minus(f"{value:.3g}")))
        piece.box(left + cols * cell, y - style.hair / 2, left + cols * cell + 0.35 * u, y + style.hair / 2, INK)
        piece.texts.append((left + cols * cell + 0.65 * u, y + 0.31 * u, names[-1], small, INK, "ls"))
    for k, value in enumerate(ends[1]):
        x = left + (k + 1) * cell
        piece.box(x - style.hair / 2, top + rows * cell, x + style.hair / 2, top + rows * cell + 0.35 * u, INK)
        piece.texts.append((x, top + rows * cell + 1.3 * u, style.text(minus(f"{value:.3g}")), small, INK, "ms"))
    last = _lines(piece, left, top + rows * cell + 2.6 * u, across, GREY, style)
    beside = cols * cell + 0.8 * u + max([length(small, one) for one in names], default=0.0)
    piece.width = max(piece.width, beside, *(length(small, words) for words in (*up, *across)))
    piece.height = last + 0.1 * u


def _bytes(colors: Any) -> NDArray[np.uint8]:
    a = np.asarray(colors)
    if a.dtype.kind not in "iu":
        a = np.round(np.clip(a.astype(np.float64), 0, 1) * 255)
    out: NDArray[np.uint8] = np.clip(a, 0, 255).astype(np.uint8, copy=False)
    return out


def _color(color: Any) -> Color:
    r, g, b = (int(v) for v in _bytes(color)[:3])
    return r, g, b
