"""The layer of painted data, with its legend: swatches are painted like the data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orograph.geovis.color import linear_to_srgb
from orograph.geovis.data.painting import Shown, along, pitch_of, with_data
from orograph.geovis.data.signs import Paint
from orograph.geovis.keys import Legend, Scale, minus
from orograph.geovis.layers import Layer

Array = NDArray[np.float64]

SWATCH, SWATCHES = 32, (0.15, 0.5, 0.85)
"""Texels of a legend's swatch, and the places along the scale of uncertainties that it shows."""


def painted(found: Shown) -> Layer:
    """The layer of data that are shown on the surface, with its legend."""
    rows, cols = found.over.shape
    y, x = np.mgrid[:rows, :cols] + 0.5
    sigma = None if found.sigma is None else found.sigma.astype(np.float64)
    pitch = pitch_of(found)
    paint = with_data(found, Paint(
        x, y, pitch, found.values.astype(np.float64), sigma, along(found, sigma, found.values.shape),
        np.zeros((rows, cols, 3), np.float32), np.zeros((rows, cols)),
    ))  # fmt: skip
    image = np.empty((rows, cols, 4), np.uint8)
    image[..., :3] = np.rint(linear_to_srgb(paint.rgb) * 255)
    image[..., 3] = np.rint(paint.alpha * 255)
    placed = found.over.crs is not None
    return Layer(
        image, opacity=found.dataset.opacity, name=found.title, key=key_of(found),
        transform=found.over.transform if placed else None, crs=found.over.crs if placed else None,
    )  # fmt: skip


def key_of(found: Shown) -> Legend:
    """What the colours and signs of data mean."""
    if found.square is not None:
        return Legend(note=found.field.chosen, squares=(found.square,))
    scale = Scale(
        found.scale.low, found.scale.high, linear_to_srgb(found.scale.colors), found.unit, found.title,
        *found.scale.exceeded(found.values, found.dataset.range),
    )  # fmt: skip
    scales, classes = ((scale,), ()) if found.classes is None else ((), _classes(found, found.classes))
    if found.sign == "none" or found.sigma is None:
        return Legend(scales, classes=classes, note=found.note, title=found.title)
    low, high = found.doubt
    swatches = []
    for part in SWATCHES:
        sigma = low + part * (high - low)
        words = f"± {rounded(sigma, high)} {found.unit}".rstrip()
        swatches.append((words, _swatch(found, sigma)))
    return Legend(scales, tuple(swatches), classes, found.note, title=found.title)


def _classes(found: Shown, names: tuple[str, ...]) -> tuple[tuple[str, NDArray[np.uint8]], ...]:
    """Names of classes, and what each looks like where it is certain."""
    bare = replace(found, sign="none", cover=None, outline=None)
    tiles = (_painted_swatch(bare, np.full((SWATCH, SWATCH), float(k)), 0.0) for k in range(len(names)))
    return tuple(zip(names, tiles))


def _swatch(found: Shown, sigma: float) -> NDArray[np.uint8]:
    """A tile (rows, cols, 3) of what the data look like in a telling colour of their scale, so uncertain."""
    scale, values = found.scale, np.full((SWATCH, SWATCH), found.scale.telling)
    if found.sign == "blur":
        x = np.mgrid[:SWATCH, :SWATCH][1] + 0.5
        values = scale.low + np.where(x < SWATCH / 2, 0.25, 0.75) * (scale.high - scale.low)
    return _painted_swatch(_plainly(found), values, sigma)


def _painted_swatch(found: Shown, values: Array, sigma: float) -> NDArray[np.uint8]:
    """A tile of values so uncertain, on light grey."""
    y, x = np.mgrid[:SWATCH, :SWATCH] + 0.5
    doubt = np.full(values.shape, sigma)
    bare = Paint(x, y, SWATCH / 2, values, doubt, along(found, doubt, values.shape),
                 np.zeros((SWATCH, SWATCH, 3), np.float32), np.zeros(values.shape))  # fmt: skip
    paint = with_data(found, bare)
    alpha = paint.alpha[..., None].astype(np.float32)
    seen = paint.rgb * alpha + np.float32(0.8) * (1 - alpha)
    return np.asarray(np.rint(linear_to_srgb(seen) * 255), np.uint8)


def _plainly(found: Shown) -> Shown:
    """The same as plain colours, under which signs are told best."""
    style = "continuous" if found.scale.edges is None else "segmented"
    return replace(found, style=style, cover=None, outline=None, streaks=None)


def rounded(value: float, top: float) -> str:
    """A number with the digits that its scale needs."""
    digits = max(0, 2 - int(np.floor(np.log10(top))) - 1) if top > 0 else 0
    return minus(f"{value:.{min(digits, 6)}f}")
