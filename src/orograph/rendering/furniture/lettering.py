"""The lettering of a sheet: its sizes, a typeface that can show its words, and type set evenly at any size.

Pillow's own typeface (Aileron) is used if it has the characters, or ones that can be drawn (×, −, ², ³); other
typographic characters and accents that it lacks are replaced by plain ones, and if that would lose too much (other
scripts) another typeface is searched for. Units: pixels.
"""

from __future__ import annotations

import math
import re
import unicodedata
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

Color = tuple[int, int, int]

FALLBACKS = ("DejaVuSans.ttf", "NotoSans-Regular.ttf", "Arial.ttf", "Arial Unicode.ttf")
PLAIN = {"–": "-", "—": "-", "…": "...", "’": "'", "“": '"', "”": '"', "′": "'", "″": '"'}
RAISED = {"²": "2", "³": "3"}
STROKES = {"×": ((0.16, 0.16, 0.84, 0.84), (0.16, 0.84, 0.84, 0.16)), "−": ((0.1, 0.5, 0.88, 0.5),)}
"""Signs that are drawn where the typeface lacks them: small figures, and strokes in the box of a plus sign."""

UNSEEN = ("Cc", "Cf", "Cs", "Co", "Cn")
"""Unicode categories without a shape: control codes, surrogates and the like."""

SMALL = 24
"""Type below this size is drawn four times too large and averaged: hinting, which moves letters to whole pixels, would
space it unevenly."""


@dataclass(frozen=True, slots=True)
class Style:
    """Sizes of everything on one sheet, in pixels, and the typeface."""

    unit: float
    face: str | None

    @classmethod
    def of(cls, size: tuple[int, int], words: str) -> Style:
        """The style of a picture of ``size`` (width, height) with these words on it."""
        return cls(max(10.0, min(size[1], 0.72 * size[0]) / 44.0), _face(frozenset(words)))

    @property
    def margin(self) -> int:
        return round(1.1 * self.unit)

    @property
    def gap(self) -> int:
        return round(0.6 * self.unit)

    @property
    def pad(self) -> int:
        return round(0.7 * self.unit)

    @property
    def hair(self) -> float:
        """The width of thin lines."""
        return max(1.0, self.unit / 16)

    def font(self, size: float = 1.0) -> Any:
        """Type of ``size`` units."""
        return _font(self.face, round(size * self.unit, 1))

    def text(self, words: str) -> str:
        """Words that the typeface can show, in one line: missing characters and accents are replaced by plain ones."""
        return " ".join("".join(_plain(self.face, c) for c in words).split())


@lru_cache(maxsize=32)
def _font(face: str | None, size: float) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size) if face is None else ImageFont.truetype(face, size)


@lru_cache(maxsize=512)
def _shows(face: str | None, sign: str) -> bool:
    """Whether the typeface has its own glyph for a character."""
    if sign.isspace() or unicodedata.category(sign) in UNSEEN:
        return True
    font = _font(face, 24.0)
    mask, none = font.getmask(sign), font.getmask("\U0010ffff")
    return mask.size != none.size or bytes(mask) != bytes(none)


def _drawn(sign: str) -> bool:
    return sign in RAISED or sign in STROKES


@lru_cache(maxsize=256)
def _plain(face: str | None, sign: str) -> str:
    if sign.isspace():
        return " "
    if unicodedata.category(sign) in UNSEEN:
        return ""
    if _shows(face, sign) or (face is None and _drawn(sign)):
        return sign
    if sign in PLAIN:
        return PLAIN[sign]
    base = "".join(c for c in unicodedata.normalize("NFKD", sign) if not unicodedata.combining(c))
    return base if base and all(_shows(face, c) for c in base) else "?"


@lru_cache(maxsize=64)
def _face(signs: frozenset[str]) -> str | None:
    """None for Pillow's own typeface if it can show the words (with plain characters), else one that can."""
    if all(_shows(None, s) or _drawn(s) or s in PLAIN for s in signs):
        return None
    best, most = None, sum(_shows(None, s) for s in signs)
    for name in [*FALLBACKS, *_shipped()]:
        try:
            shown = sum(_shows(name, s) for s in signs)
        except OSError:
            continue
        if shown > most:
            best, most = name, shown
    return best


def _shipped() -> list[str]:
    """The typeface that comes with matplotlib, if that is installed."""
    from importlib.util import find_spec
    from pathlib import Path

    spec = find_spec("matplotlib")
    if spec is None or spec.origin is None:
        return []
    file = Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf"
    return [str(file)] if file.exists() else []


def _large(font: Any) -> tuple[int, Any]:
    """The scale at which a font is drawn, and the font at that scale."""
    return (1, font) if font.size >= SMALL else (4, font.font_variant(size=font.size * 4))


def length(font: Any, words: str) -> float:
    """The extent of the words when set."""
    s, large = _large(font)
    return (_compose(None, (0.0, 0.0), words, large) if _composed(words, font) else float(large.getlength(words))) / s


def _composed(words: str, font: Any) -> bool:
    """Whether some of the words' signs must be drawn: in Pillow's own typeface, those that it lacks."""
    own = font.getname() == _font(None, 24.0).getname()
    return own and any(_drawn(sign) and not _shows(None, sign) for sign in words)


def _compose(draw: Any, at: tuple[float, float], words: str, font: Any) -> float:
    """Draw words from a place on their baseline, signs that the typeface lacks included; returns their extent.

    Args:
        draw: an ``ImageDraw``; None: only measure. font: drawn at its own size.
    """
    (x, y), size = at, font.size
    for run in re.split(f"([{''.join((*RAISED, *STROKES))}])", words):
        if run in RAISED:
            small = font.font_variant(size=0.62 * size)
            if draw is not None:
                draw.text((x, y - 0.32 * size), RAISED[run], 255, small, "ls")
            x += small.getlength(RAISED[run])
        elif run in STROKES:
            left, top, right, bottom = font.getbbox("+", anchor="ls")
            for x0, y0, x1, y1 in STROKES[run] if draw is not None else ():
                ends = [x + left + x0 * (right - left), y + top + y0 * (bottom - top),
                        x + left + x1 * (right - left), y + top + y1 * (bottom - top)]  # fmt: skip
                draw.line(ends, 255, max(1, round(0.085 * size)))
            x += font.getlength("+")
        elif run:
            if draw is not None:
                draw.text((x, y), run, 255, font, "ls")
            x += font.getlength(run)
    return float(x - at[0])


def cut(words: str, font: Any, widest: float, style: Style) -> str:
    """The words, or as many letters as fit with an ellipsis; "" if not even three fit."""
    if length(font, words) <= widest:
        return words
    dots = style.text("…")
    for n in range(len(words) - 1, 2, -1):
        if length(font, words[:n].rstrip() + dots) <= widest:
            return words[:n].rstrip() + dots
    return ""


def set_type(sheet: Any, place: tuple[float, float], words: str, font: Any, color: Color, anchor: str) -> None:
    """Set words on an image, ``place`` being on their baseline (anchors "ls", "ms", "rs") or in the middle ("mm")."""
    from PIL import Image, ImageDraw

    s, large = _large(font)
    composed = _composed(words, font)
    if composed:
        s, large = 4, font.font_variant(size=font.size * 4)
        aside = {"l": 0.0, "m": 0.5, "r": 1.0}[anchor[0]] * length(font, words)
        ascent, descent = font.getmetrics()
        below = (ascent - descent) / 2 if anchor[1] == "m" else 0.0
        place, anchor = (place[0] - aside, place[1] + below), "ls"
    x, y = round(place[0] * s), round(place[1]) * s
    x0, y0, x1, y1 = large.getbbox(words, anchor=anchor)
    if composed:
        x1 = x0 + _compose(None, (0.0, 0.0), words, large) + s
    left, top = (x + math.floor(x0)) // s - 1, (y + math.floor(y0)) // s - 1
    w, h = math.ceil((x1 - x0) / s) + 3, math.ceil((y1 - y0) / s) + 3
    mask = Image.new("L", (w * s, h * s))
    draw, at = ImageDraw.Draw(mask), (x - left * s, y - top * s)
    if composed:
        _compose(draw, at, words, large)
    else:
        draw.text(at, words, 255, large, anchor)
    if s > 1:
        mask = mask.resize((w, h), Image.Resampling.BOX)
    sheet.paste(color, (left, top, left + w, top + h), mask)
