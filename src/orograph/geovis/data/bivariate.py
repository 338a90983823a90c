"""Two variables in one colour: classes of one across, classes of the other upwards, in a square of colours.

The colours go from light grey to blue with the one, to amber with the other, and to nearly black where both are high
(after Brewer 1994, *Color use guidelines for mapping and visualization*): colour-blind readers can tell them apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.color import srgb_to_linear
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.derived import read_data
from orograph.geovis.data.field import Field
from orograph.geovis.data.painting import Shown, as_shown, cropped
from orograph.geovis.data.sampling import Positions
from orograph.geovis.data.scales import ColorScale
from orograph.geovis.keys import Square

CORNERS = ("#f3f3f3", "#509dc2", "#f3b300", "#2b2b2b")
"""Low and low, only the first high, only the second high, both high."""

USUAL, MOST = 3, 4
"""Classes of each if ``classes`` is too many to distinguish, and the maximum."""


@dataclass(frozen=True, slots=True)
class _One:
    """One of the two: what it is called, its field and its classes' edges."""

    dataset: Dataset
    field: Field
    edges: tuple[float, ...]

    @property
    def label(self) -> str:
        plain = self.dataset.unit is None or self.dataset.exceeds is not None
        unit = self.field.unit if plain else self.dataset.unit
        name = self.field.name if self.dataset.derived else self.dataset.name or self.field.name
        return f"{name} ({unit})" if unit else name


def pairs(data: tuple[Dataset, ...]) -> list[Dataset | tuple[Dataset, Dataset]]:
    """Datasets in order; two with style bivariate, or one with two variables or bands, become pairs.

    Raises:
        UsageError: one of them is alone.
    """
    found: list[Dataset | tuple[Dataset, Dataset]] = []
    waiting: Dataset | None = None
    for one in data:
        if one.style != "bivariate":
            found.append(one)
            continue
        key = "variable" if one.variable is not None else "band"
        names = str(getattr(one, key) or "").split("+")
        if len(names) == 2:
            found.append((one.but(**{key: names[0].strip()}), one.but(**{key: names[1].strip(), "name": None})))
        elif waiting is None:
            waiting = one
        else:
            found.append((waiting, one))
            waiting = None
    if waiting is not None:
        raise UsageError(
            "A bivariate picture needs two variables, but there is one.", path=waiting.called,
            remedy="Give two data with style=bivariate, or two variables of one: variable=t+q, or band=1+2.",
        )  # fmt: skip
    return found


def shown_pair(first: Dataset, second: Dataset, grid: Grid, texels: int) -> Shown:
    """Prepare two datasets for one image.

    Raises:
        UsageError: an uncertainty is given, which this style does not show. Others: as ``reading.read``.
    """
    if first.uncertainty is not None or second.uncertainty is not None:
        raise UsageError(
            "A bivariate picture cannot also show uncertainty.", path=first.called,
            remedy="Show the uncertainty as the second variable.",
        )  # fmt: skip
    count = classes_of(first)
    fields = [read_data(one, grid) for one in (first, second)]
    first, second = as_shown(first), as_shown(second)
    over = cropped(fields[0], grid, texels)
    values = [Positions.of(over, field).values(field.shown) for field in fields]
    known = np.isfinite(values[0]) & np.isfinite(values[1])
    scales = [
        ColorScale.of(np.where(known, v, np.nan), "viridis", one.range, count, one.breaks)
        for one, v in zip((first, second), values)
    ]
    across, up = (_One(one, field, scale.edges or ()) for one, field, scale in zip((first, second), fields, scales))
    wide, tall = len(across.edges) - 1, len(up.edges) - 1
    colors = square(wide, tall)
    number = scales[0].place(values[0]) + wide * scales[1].place(values[1])
    edges = tuple(k - 0.5 for k in range(wide * tall + 1))
    table = ColorScale(edges[0], edges[-1], colors.reshape(-1, 3), edges)
    chosen = "; ".join(f"{one.label}: {one.field.chosen}" for one in (across, up) if one.field.chosen)
    told = Field(np.zeros((1, 1, 1), np.float32), over, f"{across.label} and {up.label}", "", chosen)
    return Shown(
        first, "segmented", "none", told, np.where(known, number, np.nan).astype(np.float32), None, over, table,
        (0.0, 1.0), square=Square(colors, across.label, up.label, across.edges, up.edges),
    )  # fmt: skip


def classes_of(one: Dataset) -> int:
    """The number of classes that a dataset's values have."""
    return USUAL if one.style == "bivariate" and one.classes > MOST else one.classes


def square(wide: int, tall: int) -> NDArray[np.float32]:
    """(tall, wide, 3) linear colours: the first grows along the columns, the second along the rows; even steps of sRGB
    between the corners."""
    low, one, other, both = (np.array([int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)]) for c in CORNERS)
    s = np.linspace(0, 1, wide)[None, :, None]
    t = np.linspace(0, 1, tall)[:, None, None]
    mixed = (1 - t) * ((1 - s) * low + s * one) + t * ((1 - s) * other + s * both)
    return np.asarray(srgb_to_linear(mixed.astype(np.float32)), np.float32)
