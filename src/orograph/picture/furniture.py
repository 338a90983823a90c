"""A map's furniture drawn over a finished picture: title, legend of heights, scale bar, north arrow, note.

Every piece stands on a slip of paper in its own corner (title top left, north top right, scale and note bottom left,
legend bottom right), translucent, of the colour the background has where no sky is drawn. All lengths are multiples of
one unit, the size of plain type, which follows the picture's size. Shapes are drawn three times too large and averaged;
type is drawn at its size. Where pieces would meet or crowd the picture they shrink, then go, the last first:
title, legend, scale bar, north arrow, note, subtitle. Units: pixels; colours sRGB.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.picture.lettering import Colour, Style, cut, length, set_type

Pixels = NDArray[np.uint8]
Corner = Literal["top left", "top right", "bottom left", "bottom right"]

PAPER: Colour = (246, 244, 239)
INK: Colour = (36, 40, 46)
GREY: Colour = (92, 96, 102)
OPACITY = 0.84
"""Of the paper under the pieces."""

OVERSIZE = 3
COVER = 0.36
"""The part of the picture that furniture may cover."""

TALL = 0.56
"""The part of the picture's height that the legend may take."""


@dataclass(frozen=True, slots=True)
class Legend:
    """What the colours of a picture mean.

    Attributes:
        low, high: heights at the ends of the colour table.
        colours: (n, 3), from low to high, sRGB: uint8, or float in [0, 1].
        unit: of the heights; ``label``: what the colours show.
        water, missing: sRGB colours (uint8 or float) of water and of ground without data, None if there is none.
    """

    low: float
    high: float
    colours: NDArray[Any]
    unit: str = "m"
    label: str = "Height"
    water: Any = None
    missing: Any = None


def furnish(
    pixels: Pixels,
    *,
    title: str | None = None,
    subtitle: str | None = None,
    legend: Legend | None = None,
    north: float | None = None,
    metres_per_pixel: float | None = None,
    note: str | None = None,
) -> Pixels:
    """The picture with furniture drawn over it.

    Args:
        pixels: (height, width, 3) uint8, sRGB; left as it is.
        title, subtitle: text at the top left.
        legend: the colours of heights.
        north: direction of north on the screen, degrees clockwise from up.
        metres_per_pixel: for the scale bar; None (a perspective has no one scale) leaves it out.
        note: a line of small type, such as "Light from 315°, 45° · heights ×2".

    Returns:
        (height, width, 3) uint8. What does not fit is left out; see the module's text for the order.
    """
    from PIL import Image

    sheet = Image.fromarray(np.ascontiguousarray(pixels, np.uint8)).convert("RGB")
    words = " ".join(t for t in (title, subtitle, note, legend.label + legend.unit if legend else None) if t)
    style = Style.of(sheet.size, words)
    inner = sheet.width - 2 * style.margin
    taken: list[tuple[int, int, int, int]] = []
    chosen: dict[Corner, tuple[Piece, tuple[int, int, int, int]]] = {}

    def put(corner: Corner, piece: Piece | None) -> bool:
        """Place a piece, in the stead of what that corner held, if it fits."""
        if piece is None:
            return False
        box = _box(piece, corner, sheet.size, style.margin)
        others = [b for c, (_, b) in chosen.items() if c != corner]
        area = sum((b[2] - b[0]) * (b[3] - b[1]) for b in [*others, box])
        inside = min(box[:2]) >= 0 and box[2] <= sheet.width and box[3] <= sheet.height
        if not inside or area > COVER * sheet.width * sheet.height or any(_meet(box, b, style.gap) for b in others):
            return False
        chosen[corner] = piece, box
        return True

    if title:
        put("top left", _heading(title, None, style, inner))
    if legend is not None:
        sizes = ((12, True), (9, True), (6.5, True), (9, False), (6.5, False), (4.5, False))
        pieces = (_legend(legend, style, size, rows) for size, rows in sizes)
        any(put("bottom right", p) for p in pieces if p.height < TALL * sheet.height)
    if metres_per_pixel is not None:
        any(put("bottom left", _foot(metres_per_pixel, None, style, inner, share)) for share in (0.24, 0.4))
    if north is not None:
        put("top right", _arrow(north, style))
    if note:
        held = "bottom left" in chosen
        scale = metres_per_pixel if held else None
        any(put("bottom left", _foot(scale, note, style, inner, share)) for share in (0.24, 0.4))
    if subtitle and (not title or "top left" in chosen):
        put("top left", _heading(title or "", subtitle, style, inner))
    for piece, box in chosen.values():
        _paint(sheet, piece, box, style)
        taken.append(box)
    return np.asarray(sheet, np.uint8).copy()


# ---- pieces --------------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class Piece:
    """Something to draw: shapes and type in pixels from the upper left corner of its paper."""

    width: float
    height: float
    polygons: list[tuple[list[tuple[float, float]], Colour]] = field(default_factory=list)
    texts: list[tuple[float, float, str, Any, Colour, str]] = field(default_factory=list)
    ramp: tuple[float, float, float, float, NDArray[np.uint8]] | None = None

    def box(self, x0: float, y0: float, x1: float, y1: float, colour: Colour) -> None:
        self.polygons.append(([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], colour))

    def framed(self, x0: float, y0: float, x1: float, y1: float, colour: Colour, line: float) -> None:
        """A box with an outline around it."""
        self.box(x0 - line, y0 - line, x1 + line, y1 + line, INK)
        self.box(x0, y0, x1, y1, colour)


def _heading(title: str, subtitle: str | None, style: Style, inner: int) -> Piece | None:
    """Title and subtitle; a long title is set smaller, then cut."""
    widest = inner - 2 * style.pad
    lines: list[tuple[str, Any, Colour, float]] = []
    for words, sizes, colour in ((title, (1.7, 1.4, 1.15), INK), (subtitle or "", (0.95,), GREY)):
        if not words:
            continue
        words = style.text(words)
        size = next((s for s in sizes if length(style.font(s), words) <= widest), sizes[-1])
        lines.append((cut(words, style.font(size), widest, style), style.font(size), colour, size * style.unit))
    if not lines or any(not words for words, *_ in lines):
        return None
    piece = Piece(max(length(f, w) for w, f, *_ in lines) + 2 * style.pad, 0)
    y = float(style.pad)
    for words, font, colour, size in lines:
        y += 0.74 * size
        piece.texts.append((style.pad, y, words, font, colour, "ls"))
        y += 0.26 * size + 0.25 * style.unit
    piece.height = y - 0.25 * style.unit - 0.1 * style.unit + style.pad
    return piece


def _legend(legend: Legend, style: Style, size: float, extras: bool) -> Piece:
    """The ramp with its ticks, ``size`` units high; below it the swatches, if ``extras``."""
    u, pad, small = style.unit, style.pad, style.font(0.9)
    label = style.text(f"{legend.label} ({legend.unit})" if legend.unit else legend.label)
    rows = [(style.text("Water"), legend.water), (style.text("No data"), legend.missing)]
    rows = [(words, colour) for words, colour in rows if colour is not None and extras]
    top = pad + 1.35 * u
    bar, tall = round(1.15 * u), round(size * u)
    span = legend.high - legend.low
    values = ticks(legend.low, legend.high, max(2, int(tall / (1.9 * u))))
    names = [number(v, values) for v in values]
    reach = max([length(small, n) for n in names], default=0.0)
    width = max(bar + 0.8 * u + reach, length(small, label), *(bar + 0.6 * u + length(small, w) for w, _ in rows), 0)
    piece = Piece(width + 2 * pad, top + tall + pad + (0.25 * u + len(rows) * 1.5 * u if rows else 0.25 * u))
    piece.texts.append((pad, pad + 0.72 * u, label, small, GREY, "ls"))
    table = _bytes(legend.colours)
    piece.ramp = pad, top, pad + bar, top + tall, table
    for value, name in zip(values, names):
        y = top + tall * (1 - (value - legend.low) / span) if span > 0 else top + tall / 2
        piece.box(pad + bar, y - style.hair / 2, pad + bar + 0.35 * u, y + style.hair / 2, INK)
        piece.texts.append((pad + bar + 0.65 * u, y + 0.31 * u, name, small, INK, "ls"))
    y = top + tall + 0.75 * u
    for words, colour in rows:
        piece.framed(pad, y, pad + bar, y + 0.95 * u, _colour(colour), style.hair / 2)
        piece.texts.append((pad + bar + 0.65 * u, y + 0.78 * u, words, small, INK, "ls"))
        y += 1.5 * u
    return piece


def _foot(metres_per_pixel: float | None, note: str | None, style: Style, inner: int, share: float) -> Piece | None:
    """Scale bar of at most ``share`` of the width, and the note beneath it."""
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
    if note:
        words = cut(style.text(note), tiny, inner - 2 * pad, style)
        if not words:
            return None
        if metres_per_pixel is not None:
            piece.height += 0.5 * u
        piece.texts.append((pad, piece.height + 0.58 * u, words, tiny, GREY, "ls"))
        piece.width = max(piece.width, length(tiny, words) + 2 * pad)
        piece.height += 0.66 * u
    piece.height += pad
    return piece


def _arrow(north: float, style: Style) -> Piece | None:
    """A slim needle, its western half dark, with an N at its tip that stays upright."""
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
    return piece


def ticks(low: float, high: float, most: int) -> list[float]:
    """At most ``most`` round values from low to high, in steps of 1, 2, 2.5 or 5 × 10ᵏ."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return []
    if not high > low:
        return [low]
    power = math.floor(math.log10((high - low) / most)) - 1
    for k in range(power, power + 4):
        for m in (1.0, 2.0, 2.5, 5.0):
            step = m * 10.0**k
            if m == 2.5 and k < 1:
                continue
            first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
            if last - first + 1 <= most:
                return [i * step for i in range(first, last + 1)]
    return []


def number(value: float, among: list[float]) -> str:
    """A tick's value with the decimals its neighbours need, groups of three set apart from 10 000 on."""
    steps = [b - a for a, b in pairwise(among)] or [abs(value) or 1.0]
    decimals = max(0, -math.floor(math.log10(min(steps)) + 1e-9))
    text = f"{value:,.{decimals}f}" if abs(value) >= 10_000 else f"{value:.{decimals}f}"
    return "0" if float(text.replace(",", "")) == 0 else text.replace(",", " ")


def bar_length(most: float) -> tuple[float, int, str]:
    """The longest round distance (1, 2 or 5 × 10ᵏ metres) up to ``most``, its parts, and its name with the unit."""
    power = math.floor(math.log10(most))
    digit = next((d for d in (5, 2) if d * 10.0**power <= most * (1 + 1e-9)), 1)
    length = digit * 10.0**power
    unit, metres = ("km", 1000.0) if length >= 1000 else ("m", 1.0) if length >= 1 else ("cm", 0.01)
    return length, {1: 4, 2: 4, 5: 5}[digit], f"{length / metres:g} {unit}"


# ---- drawing -------------------------------------------------------------------------------------------------------


def _bytes(colours: Any) -> NDArray[np.uint8]:
    a = np.asarray(colours)
    if a.dtype.kind not in "iu":
        a = np.round(np.clip(a.astype(np.float64), 0, 1) * 255)
    out: NDArray[np.uint8] = np.clip(a, 0, 255).astype(np.uint8, copy=False)
    return out


def _colour(colour: Any) -> Colour:
    r, g, b = (int(v) for v in _bytes(colour)[:3])
    return r, g, b


def _box(piece: Piece, corner: Corner, size: tuple[int, int], margin: int) -> tuple[int, int, int, int]:
    w, h = math.ceil(piece.width), math.ceil(piece.height)
    x = margin if "left" in corner else size[0] - margin - w
    y = margin if "top" in corner else size[1] - margin - h
    return x, y, x + w, y + h


def _meet(a: tuple[int, int, int, int], b: tuple[int, int, int, int], gap: int) -> bool:
    return a[0] < b[2] + gap and b[0] < a[2] + gap and a[1] < b[3] + gap and b[1] < a[3] + gap


def _paint(sheet: Any, piece: Piece, box: tuple[int, int, int, int], style: Style) -> None:
    """Lay the piece's paper, shapes and type onto the sheet."""
    from PIL import Image, ImageDraw

    s = OVERSIZE
    w, h = box[2] - box[0], box[3] - box[1]
    layer = Image.new("RGBA", (w * s, h * s), (*PAPER, 0))
    pen = ImageDraw.Draw(layer)
    pen.rounded_rectangle((0, 0, w * s - 1, h * s - 1), 0.3 * style.unit * s, (*PAPER, round(255 * OPACITY)))
    if piece.ramp is not None:
        x0, y0, x1, y1 = (round(v) for v in piece.ramp[:4])
        line = max(1, round(style.hair * s / 2))
        pen.rectangle((x0 * s - line, y0 * s - line, x1 * s - 1 + line, y1 * s - 1 + line), (*INK, 255))
        table = piece.ramp[4].astype(np.float64)
        # Row centres of the bar run from high to low through the table.
        at = (1 - (np.arange(y1 - y0) + 0.5) / (y1 - y0)) * (len(table) - 1)
        k = np.minimum(at.astype(int), max(len(table) - 2, 0))
        part = (at - k)[:, None]
        rows = table[k] * (1 - part) + table[np.minimum(k + 1, len(table) - 1)] * part
        for i, colour in enumerate(np.round(rows).astype(int)):
            pen.rectangle((x0 * s, (y0 + i) * s, x1 * s - 1, (y0 + i + 1) * s - 1), (*(int(v) for v in colour), 255))
    for points, colour in piece.polygons:
        pen.polygon([(x * s - 0.5, y * s - 0.5) for x, y in points], (*colour, 255))
    layer = layer.resize((w, h), Image.Resampling.BOX)
    sheet.paste(layer, box[:2], layer)
    for x, y, words, font, colour, anchor in piece.texts:
        set_type(sheet, (box[0] + x, box[1] + y), words, font, colour, anchor)
