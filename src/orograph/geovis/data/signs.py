"""What uncertainty does to the picture of data: intrinsic signs change its colours, extrinsic ones lie over it.

Intrinsic: transparency, noise, blur, saturation, whiteness, and
palettes that suppress values. Extrinsic: triangular glyphs (figure 5 of Dübel et al. 2017), hatching. Values are those
of the data, uncertainties ``u`` go from 0 to 1 along their scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.data.patterns import covered, gauss, hatched, lattice, triangle
from orograph.geovis.data.scales import ColorScale, suppressed

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

CLEAREST = 0.3
"""Opacity of what is most uncertain: classes can still be told apart where all is uncertain."""

PALEST = 0.8
"""How much of its colour the most uncertain loses to white."""

GRAIN = 3
"""Texels of a grain of noise."""

NOISY = 0.2
"""Of the scale of values: the standard deviation of the noise on what is most uncertain."""

WIDEST = 1.5
"""Of a blur: its standard deviation in pitches, where data are most uncertain."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)

WARNING = np.array([[0.95, 0.83, 0.30], [0.90, 0.42, 0.10], [0.55, 0.03, 0.08]], np.float32)
"""Linear colours of glyphs, by a third of the scale of uncertainties: amber, orange, dark red; told apart in grey."""

INK = np.array([0.02, 0.02, 0.03], np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Paint:
    """A part of the ground as it is painted.

    Attributes:
        x, y: (rows, cols) texels. pitch: texels from sign to sign.
        values: (rows, cols), NaN where there are none. sigma: standard deviations in the same unit; None: unknown.
        u: uncertainties along their scale. rgb: (rows, cols, 3) linear. alpha: (rows, cols), 0 to 1.
    """

    x: Array
    y: Array
    pitch: float
    values: Array
    sigma: Array | None
    u: Array
    rgb: Colors
    alpha: Array

    def under(self, color: Colors, cover: Array) -> Paint:
        """The same with something over it: ``color`` (…, 3), of which ``cover`` is seen."""
        alpha = self.alpha + cover * (1 - self.alpha)
        part = np.divide(cover, alpha, out=np.zeros_like(alpha), where=alpha > 0)[..., None].astype(np.float32)
        return replace(self, rgb=self.rgb * (1 - part) + color * part, alpha=alpha)


def drawn_values(paint: Paint, scale: ColorScale, sign: str) -> Array:
    """The values that colours are made of: blurred or noisy ones where the sign says so."""
    if sign == "noise":
        most = NOISY * (scale.high - scale.low)
        return np.asarray(paint.values + most * np.nan_to_num(paint.u, nan=1.0) * gauss(paint.x, paint.y, GRAIN))
    return blurred(paint.values, paint.u, WIDEST * paint.pitch) if sign == "blur" else paint.values


def colored(values: Array, u: Array, scale: ColorScale, sign: str) -> Colors:
    """Colours (…, 3) of values as a sign leaves them."""
    if sign == "palette":
        return suppressed(scale, values, u)
    rgb = scale.color(values)
    less = np.nan_to_num(u, nan=1.0)[..., None].astype(np.float32)
    if sign == "saturation":
        return np.asarray(rgb + (np.sum(rgb * LUMINANCE, -1, keepdims=True) - rgb) * less, np.float32)
    if sign == "whiteness":
        return rgb + (np.float32(0.93) - rgb) * less * np.float32(PALEST)
    return rgb


def signed(paint: Paint, sign: str) -> Paint:
    """The paint with what changes its opacity, or lies over it."""
    u = np.nan_to_num(paint.u, nan=1.0)
    if sign == "transparency":
        return replace(paint, alpha=paint.alpha * (1 - (1 - CLEAREST) * u))
    there = np.isfinite(paint.values)
    if sign == "hatching":
        return paint.under(INK, hatched(paint.x, paint.y, paint.pitch / 3, 0.6 * u) * there)
    return _glyphs(paint) if sign == "glyphs" else paint


def _glyphs(paint: Paint) -> Paint:
    """Triangles, larger and darker the more uncertain the data at their middle are."""
    cx, cy = lattice(paint.x, paint.y, paint.pitch)
    rows, cols = paint.values.shape
    i = np.clip(np.rint(cy - paint.y[0, 0]), 0, rows - 1).astype(int)
    j = np.clip(np.rint(cx - paint.x[0, 0]), 0, cols - 1).astype(int)
    u = paint.u[i, j]
    there = np.isfinite(u) & np.isfinite(paint.values[i, j])
    u = np.nan_to_num(u)
    radius = paint.pitch * (0.16 + 0.30 * u)
    away = triangle(paint.x - cx, paint.y - cy - 0.1 * paint.pitch, radius)
    color = WARNING[np.minimum((u * 3).astype(int), 2)]
    line = max(1.0, 0.05 * paint.pitch)
    edged = paint.under(INK, covered(away - line) * there)
    return edged.under(color, covered(away) * there)


def blurred(values: Array, u: Array, widest: float) -> Array:
    """Values blurred by a Gaussian whose width grows with ``u`` to ``widest`` texels; NaN stays NaN."""
    from scipy.ndimage import gaussian_filter

    known = np.isfinite(values)
    steps = np.linspace(0, 1, 5)
    layers: list[Any] = [np.where(known, values, 0).astype(np.float32)]
    for step in steps[1:]:
        weight = np.float32(1) if known.all() else gaussian_filter(known.astype(np.float32), step * widest)
        layers.append(gaussian_filter(layers[0], step * widest) / np.maximum(weight, 1e-6))
    at = np.clip(np.nan_to_num(u, nan=1.0), 0, 1) * (len(steps) - 1)
    k = np.minimum(at.astype(int), len(steps) - 2)
    stack = np.stack(layers)
    low, high = (np.take_along_axis(stack, (k + more)[None], 0)[0] for more in (0, 1))
    return np.where(known, np.where(at > 0, low + (high - low) * (at - k), values), np.nan)
