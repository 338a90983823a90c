"""The pieces of a map's furniture (``key`` is the legend): what each draws, in pixels, before ``furnish`` places it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.keys import minus
from orograph.rendering.furniture.lettering import Color, Style, cut, length

PAPER: Color = (246, 244, 239)
INK: Color = (36, 40, 46)
GREY: Color = (92, 96, 102)

MOST_LINES, MOST_NOTES = 5, 2
"""Maximum lines of note and credit, and of the note alone, which is cut if longer."""


@dataclass(slots=True)
class Piece:
    """Something to draw: shapes and type in pixels from the upper left corner of its paper."""

    width: float
    height: float
    polygons: list[tuple[list[tuple[float, float]], Color]] = field(default_factory=list)
    texts: list[tuple[float, float, str, Any, Color, str]] = field(default_factory=list)
    ramps: list[tuple[float, float, float, float, NDArray[np.uint8]]] = field(default_factory=list)
    patterns: list[tuple[float, float, float, float, NDArray[np.uint8]]] = field(default_factory=list)

    def box(self, x0: float, y0: float, x1: float, y1: float, color: Color) -> None:
        self.polygons.append(([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], color))

    def framed(self, x0: float, y0: float, x1: float, y1: float, color: Color, line: float) -> None:
        """A box with an outline around it."""
        self.box(x0 - line, y0 - line, x1 + line, y1 + line, INK)
        self.box(x0, y0, x1, y1, color)


def heading(title: str, subtitle: str | None, style: Style, inner: int) -> Piece | None:
    """Title and subtitle; a long title is set smaller, then cut."""
    widest = inner - 2 * style.pad
    lines: list[tuple[str, Any, Color, float]] = []
    for words, sizes, color in ((title, (1.7, 1.4, 1.15), INK), (subtitle or "", (0.95,), GREY)):
        if not words:
            continue
        words = style.text(words)
        size = next((s for s in sizes if length(style.font(s), words) <= widest), sizes[-1])
        lines.append((cut(words, style.font(size), widest, style), style.font(size), color, size * style.unit))
    if not lines or any(not words for words, *_ in lines):
        return None
    piece = Piece(max(length(f, w) for w, f, *_ in lines) + 2 * style.pad, 0)
    y = float(style.pad)
    for words, font, color, size in lines:
        y += 0.74 * size
        piece.texts.append((style.pad, y, words, font, color, "ls"))
        y += 0.26 * size + 0.25 * style.unit
    piece.height = y - 0.25 * style.unit - 0.1 * style.unit + style.pad
    return piece


def foot(
    metres_per_pixel: float | None, note: str | None, credit: str | None, style: Style, inner: int, share: float,
    room_for_note: int = 0,
) -> Piece | None:  # fmt: skip
    """A scale bar of at most ``share`` of the width, with note and credit below (within ``inner`` or their own width);
    None if the credit does not fit completely."""
    u, pad, small, tiny = style.unit, style.pad, style.font(0.9), style.font(0.78)
    piece = Piece(0, float(pad))
    if metres_per_pixel is not None:
        if not (math.isfinite(metres_per_pixel) and metres_per_pixel > 0):
            return None
        room = min(share * inner, 15 * u)
        if room < 2.5 * u:
            return None
        distance, parts, name = bar_length(room * metres_per_pixel)
        pixels = distance / metres_per_pixel
        name = style.text(name)
        if pixels < 2.5 * u:
            return None
        x0, y0 = pad + length(small, "0") / 2, piece.height + 1.15 * u
        thick = max(3.0, round(0.32 * u))
        piece.framed(x0, y0, x0 + pixels, y0 + thick, PAPER, style.hair)
        for k in range(0, parts, 2):
            piece.box(x0 + pixels * k / parts, y0, x0 + pixels * (k + 1) / parts, y0 + thick, INK)
        digits = name.split(" ")[0]
        piece.texts.append((x0, y0 - 0.42 * u, "0", small, INK, "ms"))
        end = x0 + pixels - length(small, digits) / 2
        piece.texts.append((end, y0 - 0.42 * u, name, small, INK, "ls"))
        piece.width = max(x0 + pixels, end + length(small, name)) + pad
        piece.height = y0 + thick + 0.15 * u
    room = (room_for_note or inner) - 2 * pad
    lines = wrapped(style.text(note), tiny, room) if note else []
    if note and (not all(lines) or len(lines) > MOST_NOTES):
        lines = [cut(style.text(note), tiny, room, style)]
    if credit:
        lines += wrapped(style.text(credit), tiny, room)
    if not all(lines) or len(lines) > MOST_LINES:
        return None
    for i, words in enumerate(lines):
        piece.height += 0.3 * u if i else 0.5 * u if metres_per_pixel is not None else 0
        piece.texts.append((pad, piece.height + 0.58 * u, words, tiny, GREY, "ls"))
        piece.width = max(piece.width, length(tiny, words) + 2 * pad)
        piece.height += 0.66 * u
    piece.height += pad
    return piece


def wrapped(text: str, font: Any, widest: float) -> list[str]:
    """A text in lines no wider than this; one that is empty, if a word is wider."""
    lines: list[str] = []
    for word in text.split():
        if length(font, word) > widest:
            return [""]
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and length(font, longer) <= widest:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def arrow(north: float, style: Style, grid: bool = False) -> Piece | None:
    """A slim needle, its western half dark, with an upright N at its tip; below it "grid north", if so."""
    if not math.isfinite(north):
        return None
    u, font = style.unit, style.font(1.05)
    a = math.radians(north)
    along, across = np.array([math.sin(a), -math.cos(a)]), np.array([math.cos(a), math.sin(a)])
    side = 5.0 * u
    middle = np.array([side / 2, side / 2])
    piece = Piece(side, side)

    def at(forward: float, right: float) -> tuple[float, float]:
        x, y = middle + (along * forward + across * right) * u
        return float(x), float(y)

    h = style.hair / u
    outline = [at(0.9 + 2.6 * h, 0), at(-2.0 - 1.2 * h, -0.78 - h), at(-1.4 - h, 0), at(-2.0 - 1.2 * h, 0.78 + h)]
    piece.polygons.append((outline, INK))
    piece.polygons.append(([at(0.9, 0), at(-1.4, 0), at(-2.0, 0.78)], PAPER))
    x, y = at(1.68, 0)
    piece.texts.append((x, y + 0.36 * 1.05 * u, "N", font, INK, "ms"))
    if grid:
        piece.texts.append((side / 2, side + 0.35 * u, "grid north", style.font(0.78), GREY, "ms"))
        piece.height += 0.9 * u
    return piece


def above_map(top: Piece | None, pixels: NDArray[np.uint8], style: Style) -> Piece:
    """A map with north up and an N at its upper side; above it another piece, if there is one."""
    u, pad, font = style.unit, style.pad, style.font(0.9)
    rows, cols = pixels.shape[:2]
    head = top.height if top is not None else float(pad)
    piece = Piece(math.ceil(max(cols + 2 * pad, top.width if top is not None else 0.0)), 0.0)
    if top is not None:
        off = math.floor((piece.width - top.width) / 2)
        piece.polygons = [([(x + off, y) for x, y in points], color) for points, color in top.polygons]
        piece.texts = [(x + off, *rest) for x, *rest in top.texts]
    left, y = math.floor((piece.width - cols) / 2), math.ceil(head + 1.0 * u)
    middle = left + cols / 2
    piece.texts.append((middle - 0.5 * u, y - 0.3 * u, "N", font, INK, "ms"))
    tip = [(middle + 0.5 * u, y - 1.0 * u), (middle + 0.85 * u, y - 0.3 * u), (middle + 0.15 * u, y - 0.3 * u)]
    piece.polygons.append((tip, INK))
    piece.framed(left, y, left + cols, y + rows, PAPER, style.hair)
    piece.patterns.append((left, y, left + cols, y + rows, pixels))
    piece.height = y + rows + pad
    return piece


FACES = (("", (0, 0, 1)), ("N", (0, 1, 0)), ("E", (1, 0, 0)), ("S", (0, -1, 0)), ("W", (-1, 0, 0)))
"""The letter and the direction of a cube's side."""

PAPERS: tuple[Color, ...] = ((250, 249, 245), (206, 208, 210), (186, 189, 192), (206, 208, 210), (186, 189, 192))

EDGE = 1.1
"""Units: half the edge of the cube."""

LEGIBLE = 0.42
"""How far a face must be turned towards the eye to get its letter."""


def cube(axes: tuple[Any, Any, Any], style: Style, grid: bool = False) -> Piece:
    """A cube turned like the view, with letters on its sides and an arrow to the north on its top.

    Args:
        axes: the view's, unit vectors to the right, upwards and ahead (east, north, up). grid: as for ``arrow``.
    """
    right, up, ahead = (np.asarray(v, np.float64) for v in axes)
    u, font, side = style.unit, style.font(0.95), 5.4 * style.unit
    piece = Piece(side, side)

    def at(place: Any) -> tuple[float, float]:
        p = np.asarray(place, np.float64) * EDGE * u
        return side / 2 + float(p @ right), side / 2 - float(p @ up)

    for (letter, way), paper in zip(FACES, PAPERS):
        normal = np.asarray(way, np.float64)
        facing = -float(normal @ ahead)
        if facing <= 0:
            continue
        a = np.array([0.0, 1, 0]) if letter in ("E", "W") else np.array([1.0, 0, 0])
        b = np.array([0.0, 0, 1]) if letter else np.array([0.0, 1, 0])
        corners = [normal + i * a + j * b for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        piece.polygons.append(([at(c) for c in corners], INK))
        inner = 1 - 1.5 * style.hair / (EDGE * u)
        piece.polygons.append(([at(normal + (c - normal) * inner) for c in corners], paper))
        if letter and facing > LEGIBLE:
            x, y = at(normal)
            piece.texts.append((x, y + 0.34 * u, letter, font, INK, "ms"))
        if not letter:
            piece.polygons.append(([at(p) for p in ((0, 0.8, 1), (0.5, -0.6, 1), (0, -0.25, 1), (-0.5, -0.6, 1))], INK))
            if -float(np.array([0.0, 1.0, 0.0]) @ ahead) <= LEGIBLE:  # (else the northern side has its letter there)
                x, y = at((0, 1.85, 1))
                piece.texts.append((x, y + 0.34 * u, "N", font, INK, "ms"))
    if grid:
        piece.texts.append((side / 2, side + 0.35 * u, "grid north", style.font(0.78), GREY, "ms"))
        piece.height += 0.9 * u
    return piece


def ticks(low: float, high: float, most: int) -> list[float]:
    """At most ``most`` round values from low to high, in steps of 1, 2, 2.5 or 5 × 10ᵏ; at least two, if allowed.

    One value gives no scale: if the step leaves only one, the outer ones of the next finer step are used.
    """
    if not (math.isfinite(low) and math.isfinite(high)):
        return []
    if not high > low:
        return [low]
    power = math.floor(math.log10((high - low) / most)) - 1
    finer: list[float] = []
    for k in range(power, power + 4):
        for m in (1.0, 2.0, 2.5, 5.0):
            step = m * 10.0**k
            if m == 2.5 and k < 1:
                continue
            first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
            found = [i * step for i in range(first, last + 1)]
            if len(found) <= most:
                return found if len(found) > 1 or most < 2 else [finer[0], finer[-1]] if finer else found
            finer = found
    return []


MOST_DECIMALS = 12


def number(value: float, among: list[float]) -> str:
    """A tick's value with the decimals its neighbours need, groups of three set apart from 10 000 on."""
    steps = [b - a for a, b in pairwise(among)] or [abs(value) or 1.0]
    decimals = max(0, -math.floor(math.log10(min(steps)) + 1e-9))
    while decimals < MOST_DECIMALS and any(abs(round(v, decimals) - v) > 1e-6 * min(steps) for v in among):
        decimals += 1
    text = f"{value:,.{decimals}f}" if abs(value) >= 10_000 else f"{value:.{decimals}f}"
    return "0" if float(text.replace(",", "")) == 0 else minus(text.replace(",", " "))


def bar_length(most: float) -> tuple[float, int, str]:
    """The longest round distance (1, 2 or 5 × 10ᵏ metres) up to ``most``, its parts, and its name with the unit."""
    power = math.floor(math.log10(most))
    digit = next((d for d in (5, 2) if d * 10.0**power <= most * (1 + 1e-9)), 1)
    length = digit * 10.0**power
    unit, metres = ("km", 1000.0) if length >= 1000 else ("m", 1.0) if length >= 1 else ("cm", 0.01)
    return length, {1: 4, 2: 4, 5: 5}[digit], f"{length / metres:g} {unit}"
