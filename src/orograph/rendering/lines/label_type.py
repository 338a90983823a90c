"""The type of labels on contour lines: how large words are, and a sheet with all of them set.

Figures are set once, three times as large as they are wanted, and sampled at any angle. Units: pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.keys import minus
from orograph.rendering.furniture.lettering import Style, _font
from orograph.rendering.lines.label_kernels import lie, set_labels
from orograph.rendering.lines.label_spots import POINTS
from orograph.viewpoint import View

Array = NDArray[np.float64]

SCALE = 3
PAD = 0.2
"""The gap in lines around a label, as a share of the type's size."""


@dataclass(frozen=True, slots=True)
class Labels:
    """Labels (n,) of a view that are visible at all.

    Attributes:
        lines: (n, POINTS, 3) easting, northing, height along the line. heights: what they say, metres.
        opacity: (n,), 0 to 1.
    """

    lines: Array
    heights: Array
    opacity: Array

    def __len__(self) -> int:
        return len(self.heights)


NOTHING = Labels(np.zeros((0, POINTS, 3)), np.zeros(0), np.zeros(0))


def wording(height: float) -> str:
    """A label's text: metres, with no more digits than the interval needs."""
    return minus(f"{height:.6g}")


@lru_cache(maxsize=1024)
def _set(words: str, size: float) -> NDArray[np.uint8]:
    """Words as coverage (rows, cols), ``SCALE`` times as large, averaged over a pixel."""
    from PIL import Image, ImageDraw
    from scipy.ndimage import uniform_filter

    style = Style.of((1000, 1000), words)
    words = style.text(words)
    font = _font(style.face, round(size * SCALE, 1))
    x0, y0, x1, y1 = font.getbbox(words, anchor="ls")
    edge = SCALE
    image = Image.new("L", (int(x1 - x0) + 2 * edge + 1, int(y1 - y0) + 2 * edge + 1))
    ImageDraw.Draw(image).text((edge - x0, edge - y0), words, 255, font, "ls")
    return np.asarray(uniform_filter(np.asarray(image, np.float32), SCALE), np.float32).round().astype(np.uint8)


def measured(heights: Array, size: float) -> tuple[Array, float]:
    """Widths (n,) of the labels of heights, and their height."""
    words, which = np.unique(heights, return_inverse=True)
    type_ = [_set(wording(float(w)), size).shape for w in words]
    wide = np.array([(s[1] - 2 * SCALE) / SCALE for s in type_])
    return wide[which.reshape(-1)], float(max(s[0] - 2 * SCALE for s in type_)) / SCALE


@dataclass(frozen=True, slots=True)
class Lettering:
    """Labels as set on a view.

    Attributes:
        places: (n, 3) middle x, y in pixels of the whole picture, angle. opacity: (n,). size: of the type.
        words: (n,) what they say.
    """

    places: Array
    opacity: Array
    size: float
    words: tuple[str, ...]

    @classmethod
    def of(cls, labels: Labels, view: View, exaggeration: float, size: float) -> Lettering:
        """Labels set along their lines as seen in a view; those that the view bends too much are omitted."""
        if labels is NOTHING or not len(labels):
            return cls(np.zeros((0, 3)), np.zeros(0), size, ())
        widths, tall = measured(labels.heights, size)
        places, bends = np.zeros((len(labels), 3)), np.zeros(len(labels))
        lie(view.whole.project(labels.lines, exaggeration)[0], widths, tall, places, bends)
        there = np.flatnonzero(np.isfinite(bends) & (bends < 1.0))
        return cls(places[there], labels.opacity[there], size, tuple(wording(float(h)) for h in labels.heights[there]))

    def sheet(self, area: tuple[int, int, int, int]) -> NDArray[np.uint8]:
        """Ink and gaps in lines, (rows, cols, 2) uint8, of an area (top, bottom, left, right) of the whole picture."""
        top, bottom, left, right = area
        out = np.zeros((bottom - top, right - left, 2), np.uint8)
        if len(self.words):
            each = [_set(words, self.size) for words in self.words]
            first = np.concatenate([[0], np.cumsum([e.size for e in each])[:-1]]).astype(np.int64)
            shapes = np.array([e.shape for e in each], np.int64)
            pool = np.concatenate([e.ravel() for e in each])
            pad = PAD * self.size - 1.0  # around the type's own rim of a pixel
            set_labels(self.places, self.opacity, first, shapes, pool, SCALE, pad, left, top, out)
        return out
