"""A map's furniture drawn over a finished picture: title, legend of heights, scale bar, north arrow, note.

Every piece has its own corner: title top left, north top right, scale and note bottom left, legend bottom right. A
camera that keeps ``insets`` leaves these places free, and the pieces stand on the picture's own paper. If ground (or
sky) lies under one of them, all get framed opaque backgrounds and exchange corners so as to hide the least ground. All
lengths are multiples of one unit, the size of plain type, which follows the picture's size. Shapes are drawn three
times too large and averaged; type is drawn at its size. Pieces that would meet or crowd the picture shrink, then
disappear, the last first: title, legend, scale bar, north arrow, note, subtitle. Units: pixels; colours sRGB.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.keys import Legend, Scale
from orograph.geovis.layers import Layer, attributed, drawn
from orograph.rendering.furniture.key import fewer, key
from orograph.rendering.furniture.lettering import Color, Style, set_type
from orograph.rendering.furniture.pieces import (
    INK,
    PAPER,
    Piece,
    above_map,
    arrow,
    cube,
    foot,
    heading,
)

Pixels = NDArray[np.uint8]
Box = tuple[int, int, int, int]
Corner = Literal["top left", "top right", "bottom left", "bottom right"]
CORNERS: tuple[Corner, ...] = get_args(Corner)

EDGE: Color = (168, 166, 160)
"""The outline of paper that lies on something else."""

OVERSIZE = 3
COVER = 0.36
"""Maximum part of the picture that furniture may cover."""

COVERED = 1 << 26
"""Pixels of a picture above which not each has a bit of its own in a ``Cover``."""

TALL, TALLER = 0.56, 0.84
"""Maximum part of the picture's height for the legend."""

USUAL = Legend((Scale(-5000.0, 5000.0, np.zeros((2, 3))),), (("Water", (0, 0, 0)), ("No data", (0, 0, 0))))
"""A legend of typical width."""

PLAIN_NOTE = "Light from 315°, 45° high · heights ×40 · scale at the picture's middle · WGS 84 / UTM zone 30N"
"""A long note of a picture without data."""

MOVED = 0.01
"""A piece leaves its usual corner only if that frees this part of the picture's ground."""

MOST_INSET = 0.3
"""Maximum part of the picture's width or height that one side leaves free: tiny pictures are for the terrain."""


def insets(
    size: tuple[int, int], own: Sequence[str] = (), layers: Sequence[Layer] = (), keys: Sequence[Legend] = ()
) -> tuple[float, float, float, float]:
    """Parts of a picture of ``size`` (width, height) to leave free for furniture: left, right, top, bottom.

    Args:
        own: the credit that the makers of the heights ask for. layers: over the ground. keys: other known legend
            entries.

    The right side holds the legend and the north arrow; titles and notes run along the top and bottom.
    """
    credit = "; ".join(attributed(own, layers)) or None
    scales = [replace(USUAL.scales[0], label=one.title) for one in drawn(layers) if one.colormap is not None]
    scales += [scale for one in drawn(layers) if one.key is not None for scale in one.key.scales]
    scales += [scale for one in keys for scale in one.scales]
    named = [entry for one in keys for entry in one.entries]
    squares = tuple(square for one in keys for square in one.squares)
    usual = Legend((*USUAL.scales, *scales), (*USUAL.swatches, *named), squares=squares)
    style = Style.of(size, credit or "")
    far = 100 * max(size)
    title = heading("A", None, style, far)
    column = key(usual, style, 6.5)
    beside = size[0] - 2 * style.margin - math.ceil(column.width) - style.gap
    told = [one.note for one in keys if one.note]
    note = " · ".join([PLAIN_NOTE, *told]) if told else "A"
    base = foot(1.0, note, credit, style, far, 1.0, beside) or foot(1.0, note, None, style, far, 1.0, beside)
    edge = style.margin + style.gap
    right = (column.width + edge) / size[0]
    top, bottom = ((piece.height + edge) / size[1] if piece else 0.0 for piece in (title, base))
    return 0.0, min(right, MOST_INSET), min(top, MOST_INSET), min(bottom, MOST_INSET)


def cover_step(size: tuple[int, int]) -> int:
    """Every how many columns and rows of a picture of ``size`` (width, height) a ``Cover`` has a bit: 1, 2, 4 or 8."""
    return next((step for step in (1, 2, 4) if size[0] * size[1] <= step * step * COVERED), 8)


@dataclass(frozen=True, slots=True)
class Cover:
    """Which pixels show ground that should not be hidden: one bit per pixel, or for every ``step``-th column and row.

    Attributes:
        rows: (⌈height / step⌉, ⌈width / step / 8⌉) uint8, packed as ``numpy.packbits`` does. width: of these, in bits.
    """

    rows: NDArray[np.uint8]
    width: int
    step: int = 1

    @classmethod
    def of(cls, mask: NDArray[np.bool_]) -> Cover:
        step = cover_step((mask.shape[1], mask.shape[0]))
        some = mask[::step, ::step]
        return cls(np.packbits(some, axis=1), some.shape[1], step)

    @classmethod
    def empty(cls, size: tuple[int, int], step: int) -> Cover:
        """That of a picture of ``size`` (width, height) without ground, to be filled."""
        cols, rows = (-(-side // step) for side in size)
        return cls(np.zeros((rows, -(-cols // 8)), np.uint8), cols, step)

    @property
    def size(self) -> int:
        """The total number of pixels."""
        return int(self.rows.shape[0]) * self.width * self.step**2

    def under(self, box: Box) -> int:
        """Pixels of ground under a box."""
        x0, y0, x1, y1 = (-(-side // self.step) for side in box)
        first = x0 // 8
        bits = np.unpackbits(self.rows[y0:y1, first : -(-x1 // 8)], axis=1)
        return int(np.count_nonzero(bits[:, x0 - 8 * first : x1 - 8 * first])) * self.step**2


@dataclass(frozen=True, slots=True)
class Layout:
    """Pieces of furniture in their places.

    Attributes:
        placed: the pieces and their boxes. style: their type. framed: whether they bring paper of their own.
    """

    placed: list[tuple[Piece, Box]]
    style: Style
    framed: bool

    def paint(self, sheet: Any, corner: tuple[int, int] = (0, 0), which: int | None = None) -> None:
        """Paint the pieces onto an image that begins at the picture's pixel ``corner`` (x, y); ``which``: only one."""
        for i, (piece, box) in enumerate(self.placed):
            if which in (None, i):
                x, y = corner
                _paint(sheet, piece, (box[0] - x, box[1] - y, box[2] - x, box[3] - y), self.style, framed=self.framed)


def furnish(
    pixels: Pixels,
    *,
    ground: NDArray[np.bool_] | None = None,
    **pieces: Any,
) -> Pixels:
    """The picture with furniture drawn over it.

    Args:
        pixels: (height, width, 3) uint8, sRGB; left as it is.
        ground: (height, width), what should not be hidden; None: everything equally.
        pieces: for ``lay_out``.

    Returns:
        (height, width, 3) uint8. Pieces that do not fit are left out; see the module's text for the order.
    """
    from PIL import Image

    sheet = Image.fromarray(np.ascontiguousarray(pixels, np.uint8)).convert("RGB")
    lay_out(sheet.size, ground=None if ground is None else Cover.of(ground), **pieces).paint(sheet)
    return np.asarray(sheet, np.uint8).copy()


def lay_out(
    size: tuple[int, int],
    *,
    title: str | None = None,
    subtitle: str | None = None,
    legend: Legend | None = None,
    north: float | None = None,
    metres_per_pixel: float | None = None,
    note: str | None = None,
    credit: str | None = None,
    grid_north: bool = False,
    turned: tuple[Any, Any, Any] | None = None,
    inset: Pixels | None = None,
    ground: Cover | None = None,
    paper: bool = False,
) -> Layout:
    """Find places for furniture in a picture.

    Args:
        size: (width, height) in pixels.
        title, subtitle: text at the top left.
        legend: what colours mean.
        north: direction of north on the screen, degrees clockwise from up.
        metres_per_pixel: for the scale bar; None (a perspective has no single scale) leaves it out.
        note: a line of small type, such as "Light from 315°, 45° · heights ×2".
        credit: the credit that the makers of the heights ask for: lines of small type below the note.
        grid_north: whether the arrow must be labelled as grid north.
        turned: the view's axes, to show by a cube instead of the arrow.
        inset: a map, to stand below the arrow or the cube.
        ground: what should not be hidden; None: everything equally.
        paper: whether the rest is bare paper, on which pieces need no background.
    """
    words = " ".join(t for t in (title, subtitle, note, credit, legend.words if legend else None) if t)
    style = Style.of(size, words)
    inner = size[0] - 2 * style.margin
    chosen: dict[Corner, tuple[Piece, Box]] = {}

    def put(corner: Corner, piece: Piece | None) -> bool:
        """Place a piece, in place of that corner's previous one, if it fits."""
        if piece is None:
            return False
        box = _box(piece, corner, size, style.margin)
        others = [b for c, (_, b) in chosen.items() if c != corner]
        area = sum((b[2] - b[0]) * (b[3] - b[1]) for b in [*others, box])
        inside = min(box[:2]) >= 0 and box[2] <= size[0] and box[3] <= size[1]
        if not inside or area > COVER * size[0] * size[1] or any(_meet(box, b, style.gap) for b in others):
            return False
        chosen[corner] = piece, box
        return True

    if title:
        put("top left", heading(title, None, style, inner))
    if legend is not None:
        keys = [(legend, high, share) for high, share in ((12.0, TALL), (9.0, TALL), (6.5, TALL), (4.5, TALLER))]
        keys += [(fewer(legend, count), 4.5, TALLER) for count in range(len(legend.swatches) - 1, -1, -1)]
        pieces = ((key(one, style, high), share) for one, high, share in keys)
        any(put("bottom right", piece) for piece, share in pieces if piece.height < share * size[1])
    if metres_per_pixel is not None:
        any(put("bottom left", foot(metres_per_pixel, None, None, style, inner, share)) for share in (0.24, 0.4))
    pointing = None if north is None else arrow(north, style, grid_north)
    for one in (None if turned is None else cube(turned, style, grid_north), pointing):
        if (inset is not None and put("top right", above_map(one, inset, style))) or put("top right", one):
            break
    if note or credit:
        held = "bottom left" in chosen
        scale = metres_per_pixel if held else None
        beside = inner - (math.ceil(chosen["bottom right"][0].width) + style.gap if "bottom right" in chosen else 0)
        rooms = [(room, share) for room in (inner, beside) for share in (0.24, 0.4)]
        ways = [(words, *way) for words in dict.fromkeys((credit, None)) for way in rooms]
        any(put("bottom left", foot(scale, note, words, style, inner, share, room)) for words, room, share in ways)
    if subtitle and (not title or "top left" in chosen):
        put("top left", heading(title or "", subtitle, style, inner))
    placed = list(chosen.items())
    boxes = [box for _, (_, box) in placed]
    free = False
    if ground is not None:
        slips = {corner: piece for corner, (piece, _) in placed}
        boxes = _arrange(slips, ground, size, style)
        free = paper and not any(ground.under(box) for box in boxes)
    return Layout([(piece, box) for (_, (piece, _)), box in zip(placed, boxes)], style, not free)


def _arrange(pieces: dict[Corner, Piece], ground: Cover, size: tuple[int, int], style: Style) -> list[Box]:
    """A box for each piece: one corner each, chosen to hide the least ground. Pieces that are read first or last stay
    at the top or the bottom: titles and notes change sides only."""
    usual = list(pieces)
    best, least = [_box(pieces[c], c, size, style.margin) for c in usual], math.inf
    for corners in permutations(CORNERS, len(usual)):
        if any(c.split()[0] != u.split()[0] for c, u in zip(corners, usual) if u in ("top left", "bottom left")):
            continue
        boxes = [_box(pieces[u], c, size, style.margin) for c, u in zip(corners, usual)]
        if any(_meet(a, b, style.gap) for i, a in enumerate(boxes) for b in boxes[:i]):
            continue
        moved = sum(c != u for c, u in zip(corners, usual))
        cost = sum(ground.under(box) for box in boxes) + MOVED * moved * ground.size
        if cost < least:
            best, least = boxes, cost
    return best


# ---- pieces --------------------------------------------------------------------------------------------------------


def _box(piece: Piece, corner: Corner, size: tuple[int, int], margin: int) -> Box:
    w, h = math.ceil(piece.width), math.ceil(piece.height)
    x = margin if "left" in corner else size[0] - margin - w
    y = margin if "top" in corner else size[1] - margin - h
    return x, y, x + w, y + h


def _meet(a: Box, b: Box, gap: int) -> bool:
    return a[0] < b[2] + gap and b[0] < a[2] + gap and a[1] < b[3] + gap and b[1] < a[3] + gap


def _paint(sheet: Any, piece: Piece, box: Box, style: Style, framed: bool = True) -> None:
    """Lay the piece's paper (if ``framed``), shapes and type onto the sheet."""
    from PIL import Image, ImageDraw

    s = OVERSIZE
    w, h = box[2] - box[0], box[3] - box[1]
    layer = Image.new("RGBA", (w * s, h * s), (*PAPER, 0))
    pen = ImageDraw.Draw(layer)
    if framed:
        line = max(s, round(style.hair * s))
        whole = 0, 0, w * s - 1, h * s - 1
        pen.rounded_rectangle(whole, 0.3 * style.unit * s, (*PAPER, 255), outline=(*EDGE, 255), width=line)
    for ramp in piece.ramps:
        x0, y0, x1, y1 = (round(v) for v in ramp[:4])
        line = max(1, round(style.hair * s / 2))
        pen.rectangle((x0 * s - line, y0 * s - line, x1 * s - 1 + line, y1 * s - 1 + line), (*INK, 255))
        table = ramp[4].astype(np.float64)
        # Row centres of the bar run from high to low through the table.
        at = (1 - (np.arange(y1 - y0) + 0.5) / (y1 - y0)) * (len(table) - 1)
        k = np.minimum(at.astype(int), max(len(table) - 2, 0))
        part = (at - k)[:, None]
        rows = table[k] * (1 - part) + table[np.minimum(k + 1, len(table) - 1)] * part
        for i, color in enumerate(np.round(rows).astype(int)):
            pen.rectangle((x0 * s, (y0 + i) * s, x1 * s - 1, (y0 + i + 1) * s - 1), (*(int(v) for v in color), 255))
    for points, color in piece.polygons:
        pen.polygon([(x * s - 0.5, y * s - 0.5) for x, y in points], (*color, 255))
    layer = layer.resize((w, h), Image.Resampling.BOX)
    sheet.paste(layer, box[:2], layer)
    for left, top, right, bottom, tile in piece.patterns:
        x0, y0, x1, y1 = math.ceil(left), math.ceil(top), math.floor(right), math.floor(bottom)
        rows, cols = np.arange(max(y1 - y0, 1)) % tile.shape[0], np.arange(max(x1 - x0, 1)) % tile.shape[1]
        sheet.paste(Image.fromarray(np.ascontiguousarray(tile[np.ix_(rows, cols)])), (box[0] + x0, box[1] + y0))
    for x, y, words, font, color, anchor in piece.texts:
        set_type(sheet, (box[0] + x, box[1] + y), words, font, color, anchor)
