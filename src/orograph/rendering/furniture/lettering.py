"""The lettering of a sheet: its sizes, a typeface that can show its words, and type set evenly at any size.

Pillow's own typeface (Aileron) is used if it has the characters; typographic characters and accents that it lacks are
replaced by plain ones, and if that would lose too much (other scripts) another typeface is searched for. Units: pixels.
"""

from __future__ import annotations

import math
import unicodedata
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

Color = tuple[int, int, int]

FALLBACKS = ("DejaVuSans.ttf", "NotoSans-Regular.ttf", "Arial.ttf", "Arial Unicode.ttf")
PLAIN = {"×": "x", "−": "-", "–": "-", "—": "-", "…": "...", "’": "'", "“": '"', "”": '"', "′": "'", "″": '"'}
PLAIN |= {"²": "2", "³": "3"}

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


@lru_cache(maxsize=256)
def _plain(face: str | None, sign: str) -> str:
    if sign.isspace():
        return " "
    if unicodedata.category(sign) in UNSEEN:
        return ""
    if _shows(face, sign):
        return sign
    if sign in PLAIN:
        return PLAIN[sign]
    base = "".join(c for c in unicodedata.normalize("NFKD", sign) if not unicodedata.combining(c))
    return base if base and all(_shows(face, c) for c in base) else "?"


@lru_cache(maxsize=64)
def _face(signs: frozenset[str]) -> str | None:
    """None for Pillow's own typeface if it can show the words (with plain characters), else one that can."""
    if all(_shows(None, s) or s in PLAIN for s in signs):
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
    return float(large.getlength(words)) / s


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
    """Set words on an image with their baseline at ``place``."""
    from PIL import Image, ImageDraw

    s, large = _large(font)
    x, y = round(place[0] * s), round(place[1]) * s
    x0, y0, x1, y1 = large.getbbox(words, anchor=anchor)
    left, top = (x + math.floor(x0)) // s - 1, (y + math.floor(y0)) // s - 1
    w, h = math.ceil((x1 - x0) / s) + 3, math.ceil((y1 - y0) / s) + 3
    mask = Image.new("L", (w * s, h * s))
    ImageDraw.Draw(mask).text((x - left * s, y - top * s), words, 255, large, anchor)
    if s > 1:
        mask = mask.resize((w, h), Image.Resampling.BOX)
    sheet.paste(color, (left, top, left + w, top + h), mask)
