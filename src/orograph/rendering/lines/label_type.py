"""The type of labels on contour lines: how large words are, and a sheet with all of them set.

Figures are set once, three times as large as they are wanted, and sampled at any angle. Units: pixels.
"""

from __future__ import annotations

import math
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
HALO = 0.12, 0.32
"""Distances from a figure, as shares of the type's size, up to which its halo is whole and from which on there is none:
there lines are left out and dark ground is lighter."""


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


def _rim(size: float) -> int:
    """Pixels between the ink of a label and the border of its type, for the halo."""
    return math.ceil(HALO[1] * size) + 1


@lru_cache(maxsize=1024)
def _set(words: str, size: float) -> NDArray[np.uint8]:
    """Words as coverage by ink and by their halo (rows, cols, 2), ``SCALE`` times as large; ink is averaged over a
    pixel."""
    from PIL import Image, ImageDraw
    from scipy.ndimage import distance_transform_edt, uniform_filter

    style = Style.of((1000, 1000), words)
    words = style.text(words)
    font = _font(style.face, round(size * SCALE, 1))
    x0, y0, x1, y1 = font.getbbox(words, anchor="ls")
    edge = SCALE * _rim(size)
    image = Image.new("L", (int(x1 - x0) + 2 * edge + 1, int(y1 - y0) + 2 * edge + 1))
    ImageDraw.Draw(image).text((edge - x0, edge - y0), words, 255, font, "ls")
    ink = np.asarray(image, np.float32)
    away = distance_transform_edt(ink < 128) / (SCALE * size)
    halo = np.clip((HALO[1] - away) / (HALO[1] - HALO[0]), 0.0, 1.0)
    both = np.stack([uniform_filter(ink, SCALE), 255.0 * halo * halo * (3.0 - 2.0 * halo)], -1)
    return both.round().astype(np.uint8)


def measured(heights: Array, size: float) -> tuple[Array, float]:
    """Widths (n,) of the labels of heights, and their height."""
    words, which = np.unique(heights, return_inverse=True)
    rims = 2 * SCALE * _rim(size)
    type_ = [_set(wording(float(w)), size).shape for w in words]
    wide = np.array([(s[1] - rims) / SCALE for s in type_])
    return wide[which.reshape(-1)], float(max(s[0] - rims for s in type_)) / SCALE


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
        """Ink and halo, (rows, cols, 2) uint8, of an area (top, bottom, left, right) of the whole picture."""
        top, bottom, left, right = area
        out = np.zeros((bottom - top, right - left, 2), np.uint8)
        if len(self.words):
            each = [_set(words, self.size) for words in self.words]
            first = np.concatenate([[0], np.cumsum([e.size for e in each])[:-1]]).astype(np.int64)
            shapes = np.array([e.shape[:2] for e in each], np.int64)
            pool = np.concatenate([e.ravel() for e in each])
            set_labels(self.places, self.opacity, first, shapes, pool, SCALE, left, top, out)
        return out
