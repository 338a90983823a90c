"""Data painted on the ground (A² of Dübel et al. 2014): values and their uncertainty become one image over the terrain.

Values are interpolated between the data's own samples, then coloured, so that classes have sharp borders at any scale.
The image is a layer like any other: every backend, film and window draws it. Units: texels; colours linear until the
image is made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid, apply, compose
from orograph.geovis.data.classes import ClassTable, classes_over, numbered, says_classes
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.derived import deviations, read_data
from orograph.geovis.data.field import Field, Values
from orograph.geovis.data.lic import STEP, STEPS, brightness
from orograph.geovis.data.patterns import covered, dotted, hatched
from orograph.geovis.data.priority import Priority
from orograph.geovis.data.sampling import Positions
from orograph.geovis.data.scales import ColorScale, doubted
from orograph.geovis.data.shared import once
from orograph.geovis.data.signs import Paint, colored, drawn_values, signed
from orograph.geovis.data.vectors import arrows, directions, read_vectors
from orograph.geovis.keys import Square

Array = NDArray[np.float64]
Colors = NDArray[np.float32]

SIGNS = 44
"""Signs along the longer side of the terrain, where no size is given."""

LEAST_PITCH = 6.0
"""Texels from sign to sign."""

LINE = 2.4
"""Texels that an isoline is wide."""

TURN = 45.0
"""Degrees between the hatchings of classes without an order: four directions."""

OUTLINE, CASING = 0.8, 0.65
"""Opacity of the outlines of polygons, and of what stands out on either side of a line."""

FLOWS = ("arrows", "lic")
"""Styles of two components."""

DARKER, LIGHTER = 0.75, 0.22
"""How much darker the darkest streaks of a flow are than its colours, and how much lighter the lightest."""

EDGE = np.array([0.03, 0.03, 0.04], np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """Data over a terrain, ready to be painted or to stand.

    Attributes:
        dataset: as given. style, sign: how values and uncertainty are shown. field: what was read.
        sigma: (rows, cols) of the field's grid, in the data's unit; None: nothing is known. its grid is ``over``'s.
        scale: colours of values. doubt: the ends of the scale of uncertainties.
        toward: of arrows, unit vectors along the image's columns and rows.
        cover, outline: of lines and polygons, how much of a texel they and their outlines (``cased``: what stands out
            beneath a line on either side) cover; None: values are everywhere.
        classes: names of values 0, 1, …; None: they are numbers.
        streaks: of lic, how bright texels are. square: of two datasets in one, what their colours mean.
    """

    dataset: Dataset
    style: str
    sign: str
    field: Field
    values: NDArray[np.float32]
    sigma: NDArray[np.float32] | None
    over: Grid
    scale: ColorScale
    doubt: tuple[float, float]
    toward: tuple[Array, Array] | None = None
    cover: Array | None = None
    outline: Array | None = None
    cased: bool = False
    classes: tuple[str, ...] | None = None
    streaks: Array | None = None
    square: Square | None = None

    @property
    def title(self) -> str:
        """What the legend calls it."""
        if self.dataset.name is not None and not self.dataset.derived:
            return self.dataset.name
        return self.field.name

    @property
    def note(self) -> str:
        """What else a reader must know."""
        parts = [self.field.chosen]
        if self.sigma is not None:
            doubt = self.dataset.uncertainty
            if doubt is not None:
                parts.append(doubt.source.name if isinstance(doubt.source, Field) else doubt.words)
        told = ", ".join(filter(None, parts))
        return f"{self.title}: {told}" if told else ""

    @property
    def unit(self) -> str:
        if self.dataset.unit is None or self.dataset.exceeds is not None:
            return self.field.unit
        return self.dataset.unit


def shown(
    dataset: Dataset, grid: Grid, texels: int, priority: Priority, surface: Callable[[Grid], Array] | None = None
) -> Shown:  # fmt: skip
    """Read data and prepare them for display.

    Args:
        grid: the terrain's. texels: along the longer side of the image. surface: heights (rows, cols) at the samples of
            a grid over the terrain, for what goes along the surface; None: it is flat.

    Raises: as ``reading.read``.
    """
    style = dataset.style or priority.style
    if style == "classes":
        return _shown_classes(dataset, read_data(dataset, grid), grid, texels, priority)
    if dataset.derived and style in FLOWS:
        raise UsageError(f"{style} shows two components, which have no value= or exceeds=.")
    components: list[Values] = []
    if style in FLOWS:
        field, *components = once("vectors", (dataset, grid), lambda: read_vectors(dataset, grid))
    else:
        field = once("read", (dataset, grid), lambda: read_data(dataset, grid))
    if dataset.style is None and not dataset.derived and says_classes(field):
        return _shown_classes(dataset.but(style="classes"), field, grid, texels, priority)
    dataset = as_shown(dataset)
    over, positions, values, sigma = once(
        "sampled", (dataset, grid, texels, id(field)), lambda: _sampled(dataset, field, grid, texels)
    )
    toward = directions(field, positions, *components) if components else None
    given = None if dataset.uncertainty is None else dataset.uncertainty.style
    sign = "none" if sigma is None else (given or priority.sign(style))
    classes = 0 if style in ("continuous", *FLOWS) else dataset.classes
    scale = ColorScale.of(values, dataset.plain_colormap, dataset.range, classes, dataset.breaks)
    doubt = (0.0, 1.0)
    if sigma is not None:
        asked = None if dataset.uncertainty is None else dataset.uncertainty.range
        doubt = asked or doubted(sigma)
    streaks = None
    if style == "lic" and toward is not None:
        flat = np.zeros(over.shape) if surface is None else surface(over)
        there = np.isfinite(values)
        streaks = _streaks((toward[0] * there, toward[1] * there), over, image_grid(grid, texels), flat, dataset.size)
    return Shown(dataset, style, sign, field, values, sigma, over, scale, doubt, toward, streaks=streaks)


def _sampled(
    dataset: Dataset, field: Field, grid: Grid, texels: int
) -> tuple[Grid, Positions, NDArray[np.float32], NDArray[np.float32] | None]:
    """An image's grid, where its texels lie in a field, and there values and standard deviations."""
    over = cropped(field, grid, texels)
    positions = Positions.of(over, field)
    found = deviations(dataset, field, grid)
    sigma = None
    if found is not None:
        other, sigmas = found
        sigma = (positions if other is field else Positions.of(over, other)).values(sigmas)
    return over, positions, positions.values(field.shown), sigma


def _shown_classes(dataset: Dataset, field: Field, grid: Grid, texels: int, priority: Priority) -> Shown:
    """A raster of classes: nothing is interpolated but how uncertain they are."""
    if dataset.derived or len(field.values) > 1:
        raise UsageError("Classes have no mean, no value= and no exceeds=.", path=dataset.called,
                         remedy="Choose one band, time or member.")  # fmt: skip
    over = cropped(field, grid, texels)
    table = ClassTable.of_tags(field.tags, field.palette, field.named)
    values, names, colors = numbered(
        classes_over(field, over), table, dataset.colormap, dataset.names or {}, field.name
    )
    found = deviations(dataset, field, grid)
    sigma = None if found is None else Positions.of(over, found[0]).values(found[1])
    given = None if dataset.uncertainty is None else dataset.uncertainty
    sign = "none" if sigma is None or given is None else given.style or priority.sign("segmented")
    if sign in ("noise", "blur", "palette"):
        raise UsageError(
            f"The uncertainty of classes cannot be shown by {sign}, which mixes neighbours.", path=dataset.called,
            remedy="Choose transparency, whiteness, saturation or glyphs.",
        )  # fmt: skip
    doubt = (0.0, 1.0)
    if sigma is not None and given is not None:
        doubt = given.range or doubted(sigma)
    scale = ColorScale.of_classes(names, colors)
    return Shown(dataset, "classes", sign, field, values, sigma, over, scale, doubt, classes=names)


def as_shown(dataset: Dataset) -> Dataset:
    """Data that were read, as they are shown: a probability has a scale from 0 to 1 of even classes, and is what is
    known of an uncertainty."""
    if dataset.exceeds is None:
        return dataset
    if dataset.uncertainty is not None and dataset.uncertainty.of_members:
        raise UsageError(
            "A probability of exceeding already expresses the members' uncertainty; it has no spread of its own.",
            path=dataset.called, remedy="Leave out the uncertainty.",
        )  # fmt: skip
    even = "equal" if dataset.breaks == "quantiles" else dataset.breaks
    return dataset.but(range=dataset.range or (0.0, 1.0), breaks=even, uncertainty=None)


def _streaks(toward: tuple[Array, Array], over: Grid, whole: Grid, heights: Array, size: float | None) -> Array:
    """Brightness of streaks along a flow.

    Args:
        toward: unit vectors in texels. over, whole: grids of the image and of one over all of the terrain. heights: at
            the image's texels. size: metres that a streak is long; None: what suits the image.
    """
    across, down = toward
    (a, b), (d, e) = over.linear
    rise_down, rise_across = np.gradient(np.where(np.isfinite(heights), heights, 0.0))
    rise = np.nan_to_num(rise_across * across + rise_down * down)
    metres = np.sqrt((a * across + b * down) ** 2 + (d * across + e * down) ** 2 + rise**2)
    step = STEP * float(np.sqrt(over.cell_area))
    steps = STEPS if size is None else max(1, round(size / 2 / step))
    pace = np.divide(step, metres, out=np.zeros_like(metres), where=metres > 0)
    col, row = (round(float(v)) for v in apply(~whole.transform, over.transform.c, over.transform.f))
    return brightness(across, down, pace, steps, (row, col))


def image_grid(grid: Grid, texels: int) -> Grid:
    """The grid of an image over a terrain, so many texels along its longer side."""
    step = max(grid.shape) / texels
    rows, cols = (max(2, round(n / step)) for n in grid.shape)
    return Grid((rows, cols), compose(grid.transform, Affine.scale(grid.cols / cols, grid.rows / rows)), grid.crs)


def cropped(field: Field, grid: Grid, texels: int) -> Grid:
    """The part of an image's grid that has data."""
    whole = image_grid(grid, texels)
    rows, cols = whole.shape
    if grid.crs is None:
        return whole
    few = 8
    coarse = Grid(
        (-(-rows // few), -(-cols // few)), compose(whole.transform, Affine.scale(few)), grid.crs
    )  # fmt: skip
    there = np.isfinite(Positions.of(coarse, field).values(field.shown))
    if not there.any():
        return whole
    i, j = (np.flatnonzero(there.any(axis)) for axis in (1, 0))
    row0, row1 = max(0, (i[0] - 1) * few), min(rows, (i[-1] + 2) * few)
    col0, col1 = max(0, (j[0] - 1) * few), min(cols, (j[-1] + 2) * few)
    return Grid((row1 - row0, col1 - col0), compose(whole.transform, Affine.translation(col0, row0)), grid.crs)


def pitch_of(found: Shown) -> float:
    metres = float(np.sqrt(found.over.cell_area))
    size = found.dataset.size
    return max(LEAST_PITCH, size / metres if size is not None else max(found.over.shape) / SIGNS)


def along(found: Shown, sigma: Any, shape: tuple[int, ...]) -> Array:
    """Uncertainties along their scale, 0 to 1."""
    if sigma is None:
        return np.zeros(shape)
    low, high = found.doubt
    return np.asarray(np.clip((sigma - low) / max(high - low, 1e-30), 0, 1))


def with_data(found: Shown, paint: Paint) -> Paint:
    """Values and their uncertainty, painted."""
    if found.style == "cells":
        paint = _aggregated(paint)
    values = drawn_values(paint, found.scale, found.sign)
    there = np.isfinite(values) * (1.0 if found.cover is None else found.cover)
    paint = replace(paint, rgb=colored(values, paint.u, found.scale, found.sign), alpha=there)
    share = (np.nan_to_num(found.scale.place(values)) + 1) / max(len(found.scale.table) + 1, 2)
    if found.style in ("isolines", "isobands") and found.scale.edges is not None:
        cover = _isolines(values, found.scale.edges[1:-1]) * there
        if found.style == "isobands":
            paint = paint.under(EDGE, cover * 0.8)
        else:
            paint = replace(paint, alpha=cover)
    elif found.style == "hatching":
        turn: Any = 45.0
        if found.classes is not None:  # unordered: told by direction, then by three densities that say no more or less
            number = np.nan_to_num(values)
            turn, share = 45.0 + number % 4 * TURN, 0.25 + 0.2 * (number // 4)
        paint = replace(paint, alpha=hatched(paint.x, paint.y, paint.pitch / 2, share, turn) * there)
    elif found.style == "stipple":
        paint = replace(paint, alpha=dotted(paint.x, paint.y, paint.pitch / 2, 0.7 * share) * there)
    elif found.style == "arrows" and found.toward is not None:
        length = np.nan_to_num(found.scale.place(values))
        paint = replace(paint, alpha=arrows(paint.x, paint.y, paint.pitch, *found.toward, length) * there)
    elif found.style == "lic" and found.streaks is not None:
        paint = replace(paint, rgb=_streaked(paint.rgb, found.streaks))
    elif found.style == "cells":
        border = np.minimum(*(0.5 - np.abs(v / paint.pitch % 1 - 0.5) for v in (paint.x, paint.y))) * paint.pitch
        paint = paint.under(EDGE, covered(border - 0.5) * 0.5 * there)
    if found.outline is None:
        return signed(paint, found.sign)
    if not found.cased:
        return signed(paint, found.sign).under(EDGE, found.outline * OUTLINE)
    casing = replace(paint, rgb=np.broadcast_to(EDGE, paint.rgb.shape), alpha=found.outline * CASING)
    return signed(casing.under(paint.rgb, paint.alpha), found.sign)


def _streaked(rgb: Colors, streaks: Array) -> Colors:
    """Colours, darker and lighter by streaks, the mean about what it was."""
    part = streaks[..., None].astype(np.float32)
    return np.asarray(rgb * (1 - DARKER * (1 - part)) * (1 - LIGHTER * part) + LIGHTER * part, np.float32)


def _aggregated(paint: Paint) -> Paint:
    """Means of square cells of a pitch: of values, and of variances."""
    i, j = (np.floor(v / paint.pitch).astype(np.int64) for v in (paint.y, paint.x))
    cell = i * (int(j.max()) + 1) + j

    def mean(values: Array) -> Array:
        known = np.isfinite(values)
        total = np.bincount(cell.ravel(), np.where(known, values, 0).ravel())
        count = np.bincount(cell.ravel(), known.ravel())
        size = np.bincount(cell.ravel())
        found = np.where(2 * count >= size, total / np.maximum(count, 1), np.nan)
        return np.asarray(found[cell])

    sigma = None if paint.sigma is None else np.sqrt(mean(paint.sigma**2))
    return replace(paint, values=mean(paint.values), sigma=sigma, u=mean(paint.u))


def _isolines(values: Array, levels: tuple[float, ...]) -> Array:
    """Coverage by lines at some values: by the distance to them, the difference over the gradient."""
    filled = np.where(np.isfinite(values), values, np.nan)
    down, across = np.gradient(filled)
    slope = np.hypot(down, across)
    cover = np.zeros(values.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        for level in levels:
            cover = np.fmax(cover, covered(np.abs(filled - level) / slope - LINE / 2))
    return np.nan_to_num(cover)
