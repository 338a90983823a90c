"""Lines and polygons painted on the ground: a value for each feature becomes values over an image's texels.

What is painted then is what a raster's values would be: the same scales, patterns and signs of uncertainty. Lines have
a casing, polygons outlines, both dark, so that pale colours stand out from paper.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid, apply, compose
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.features import Features
from orograph.geovis.data.field import Field
from orograph.geovis.data.painting import Shown, image_grid
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.scales import ColorScale, doubted
from orograph.geovis.data.shape_kernels import fill, stroke
from orograph.geovis.data.shapes import Shapes, read_shapes

STYLES = {"lines": ("continuous", "segmented"), "polygons": ("continuous", "segmented", "hatching", "stipple")}

SIGNS = {"lines": ("transparency", "noise", "saturation", "whiteness", "palette", "hatching", "none"),
         "polygons": ("transparency", "noise", "blur", "saturation", "whiteness", "palette", "glyphs", "hatching",
                      "none")}  # fmt: skip

UNORDERED = ("noise", "blur", "palette")
"""Signs that mix neighbouring values, which classes do not have."""

WIDTH = {"lines": 3.0, "polygons": 1.0}
"""Pixels of lines and of outlines."""

CASING = 0.7
"""Pixels on either side of a line."""

EXACT = 0.25
"""Texels that edges may be off by."""


def shown_shapes(
    dataset: Dataset, features: Features, grid: Grid, texels: int, pixel: float, priority: Priority
) -> Shown:  # fmt: skip
    """Say how lines or polygons are shown.

    Args:
        texels: along the longer side of the image, were it over all of the terrain. pixel: texels to a pixel of a
            picture that shows all of it.

    Raises:
        UsageError: lines and polygons have no such style or sign. Others: as ``read_shapes``.
    """
    whole = image_grid(grid, texels)
    metres = float(np.hypot(whole.transform.a, whole.transform.d))
    shapes = read_shapes(dataset, features, grid, EXACT * metres)
    style = _style(dataset, shapes, priority)
    sign = _sign(dataset, shapes, style, priority)
    wide = _texels(dataset.width, WIDTH[shapes.kind], pixel, metres)
    over = _cropped(shapes, whole, wide + 2 * CASING * pixel + 2)
    which, cover, outline = _drawn(shapes, over, wide, CASING * pixel)
    scale = _scale(dataset, shapes, np.unique(shapes.owner), style)
    doubt = (0.0, 1.0)
    if shapes.sigma is not None:
        given = dataset.uncertainty.range if dataset.uncertainty is not None else None
        doubt = given or doubted(shapes.sigma[np.unique(shapes.owner)])

    def spread(of: Any) -> NDArray[np.float32]:
        return np.where(which >= 0, np.asarray(of, np.float32)[which], np.float32(np.nan))

    values = spread(shapes.values)
    field = Field(values[None], over, shapes.name, "", ", ".join(shapes.notes))
    sigma = None if shapes.sigma is None else spread(shapes.sigma)
    return Shown(
        dataset, style, sign, field, values, sigma, over, scale, doubt, cover=cover, outline=outline,
        cased=shapes.kind == "lines", classes=shapes.classes,
    )  # fmt: skip


def _style(dataset: Dataset, shapes: Shapes, priority: Priority) -> str:
    style = dataset.style or ("segmented" if shapes.classes else priority.style)
    known = STYLES[shapes.kind]
    if style not in known:
        raise UsageError(
            f"There is no style {style} of {shapes.kind}.", path=dataset.called,
            remedy=f"There are {', '.join(known)}.",
        )  # fmt: skip
    return style


def _sign(dataset: Dataset, shapes: Shapes, style: str, priority: Priority) -> str:
    if shapes.sigma is None or dataset.uncertainty is None:
        return "none"
    usual = priority.sign("segmented" if shapes.classes else style)
    sign = dataset.uncertainty.style or ("hatching" if usual == "glyphs" and shapes.kind == "lines" else usual)
    known = tuple(one for one in SIGNS[shapes.kind] if shapes.classes is None or one not in UNORDERED)
    if sign not in known:
        whose = f"{shapes.kind} in classes" if shapes.classes else shapes.kind
        raise UsageError(
            f"The uncertainty of {whose} cannot be shown by {sign}.", path=dataset.called,
            remedy=f"There are {', '.join(known)}.",
        )  # fmt: skip
    return sign


def _scale(dataset: Dataset, shapes: Shapes, here: NDArray[np.int64], style: str) -> ColorScale:
    if shapes.classes is not None:
        return ColorScale.of_classes(shapes.classes, dataset.colormap)
    classes = 0 if style == "continuous" else dataset.classes
    return ColorScale.of(shapes.values[here], dataset.plain_colormap, dataset.range, classes, dataset.breaks)


def _texels(given: float | str | None, usual: float, pixel: float, metres: float) -> float:
    """A width in texels, ``metres`` wide each."""
    if isinstance(given, str):
        return float(given.removesuffix("m")) / metres
    return (usual if given is None else given) * pixel


def _cropped(shapes: Shapes, whole: Grid, margin: float) -> Grid:
    """The part of an image's grid that shapes lie in."""
    x, y = apply(~whole.transform, shapes.x, shapes.y)
    low = np.clip(np.floor([x.min() - margin, y.min() - margin]), 0, [whole.cols - 2, whole.rows - 2]).astype(int)
    high = np.clip(np.ceil([x.max() + margin, y.max() + margin]), low + 2, [whole.cols, whole.rows]).astype(int)
    place = compose(whole.transform, Affine.translation(int(low[0]), int(low[1])))
    return Grid((int(high[1] - low[1]), int(high[0] - low[0])), place, whole.crs)


def _drawn(
    shapes: Shapes, over: Grid, wide: float, casing: float
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    """Of each texel the feature seen there (−1: none), how much of it features cover, and casings or outlines."""
    x, y = apply(~over.transform, shapes.x, shapes.y)
    t = over.transform
    tall = float(np.hypot(t.b, t.e) / np.hypot(t.a, t.d))
    which = np.full(over.shape, -1, np.int32)
    cover, edge = np.zeros(over.shape), np.zeros(over.shape)
    if shapes.kind == "polygons":
        fill(x, y, shapes.first, shapes.owner, which, np.zeros(over.shape), cover)
        _stroked(shapes, x, y, wide, tall, np.full(over.shape, -1, np.int32), edge)
        return which, cover, edge
    around = np.full(over.shape, -1, np.int32)
    _stroked(shapes, x, y, wide + 2 * casing, tall, around, edge)
    _stroked(shapes, x, y, wide, tall, which, cover)
    return np.where(which >= 0, which, around), cover, edge


def _stroked(shapes: Shapes, x: Any, y: Any, wide: float, tall: float, which: Any, cover: Any) -> None:
    """Lines so many texels wide; below one texel they are one wide, and paler."""
    if wide <= 0:
        return
    stroke(x, y, shapes.first, shapes.owner, max(wide, 1.0) / 2, tall, which, cover)
    cover *= min(wide, 1.0)
