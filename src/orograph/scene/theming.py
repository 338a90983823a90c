"""A theme becomes what every backend draws: data as painted layers, priorities as light, lines and tint.

A scene's other options stand where they are given; a priority sets those that are left as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from orograph.scene.contours import Contours
from orograph.scene.silhouettes import Silhouettes

if TYPE_CHECKING:
    from orograph.geo.grid import Grid
    from orograph.geovis.data.dataset import Dataset
    from orograph.geovis.data.priority import Priority
    from orograph.geovis.data.standing import Things
    from orograph.store.terrain import Terrain

FINER, LEAST, MOST = 1.6, 1024, 3072
"""Texels along the longer side of painted data: so many to a pixel of the picture, within these bounds."""

PAPER = "#f4f2ec"
"""The ground under data."""


def themed(options: Mapping[str, Any], terrain: Terrain, size: tuple[int, int]) -> tuple[dict[str, Any], Things | None]:
    """A scene's options with its theme carried out, and what stands on its ground.

    Args:
        size: pixels (width, height) of the picture, which painted data suit.

    Raises:
        ReadError, UsageError: data cannot be read, or do not belong here.
    """
    from orograph.geovis.data.dataset import datasets_of
    from orograph.geovis.data.painting import painted, shown
    from orograph.geovis.data.points import are_points
    from orograph.geovis.data.priority import Priority
    from orograph.geovis.data.standing import Things, stands
    from orograph.geovis.layers import layers_of

    made = dict(options)
    data = datasets_of(options.get("data"))
    given = options.get("priority")
    if not data and given is None:
        return made, None
    priority = Priority.parse(given) if isinstance(given, str) else given or Priority(data=True)
    texels = int(min(MOST, max(LEAST, FINER * max(size))))
    standing = [one for one in data if stands(one, are_points(one.source))]
    flat = [one for one in data if not stands(one, are_points(one.source))]
    usual = ({} if priority.terrain else _lines()) | (_ground() if flat or not priority.terrain else {})
    made = usual | {k: v for k, v in made.items() if k not in usual or not _usual(k, v)}
    layers = [painted(shown(one, terrain.grid, texels, priority)) for one in flat]
    made["layers"] = (*layers_of(options.get("layers")), *layers)
    things = Things.joined([_things(one, terrain.grid, priority) for one in standing]) if standing else None
    return made | {"data": data, "priority": priority}, things


def _things(dataset: Dataset, grid: Grid, priority: Priority) -> Things:
    """What stands for a dataset: for its own points, or for a raster's values on a lattice."""
    from orograph.geovis.data.points import Points, are_points, read_points
    from orograph.geovis.data.reading import read
    from orograph.geovis.data.sampling import values_at
    from orograph.geovis.data.standing import lattice_points, things_of

    if are_points(dataset.source):
        return things_of(dataset, read_points(dataset, grid), grid, priority, dataset.unit or "", "")
    field = read(dataset, grid)
    x, y = lattice_points(grid, dataset.size)
    values = values_at(field.mean, field, grid, x, y)
    doubt, sigma = dataset.uncertainty, None
    if doubt is not None and doubt.of_members:
        sigma = values_at(field.uncertainty(doubt.source), field, grid, x, y)
    elif doubt is not None:
        other = read(doubt, grid)
        sigma = values_at(other.mean, other, grid, x, y)
    known = np.isfinite(values) & (np.isfinite(sigma) if sigma is not None else True)
    points = Points(x[known], y[known], values[known], None if sigma is None else sigma[known], field.name)
    return things_of(dataset, points, grid, priority, dataset.unit or field.unit, field.chosen)


def _ground() -> dict[str, Any]:
    """Ground without colours of its own, which would mix with those of data."""
    from orograph.geovis.tables import Table

    red, green, blue = (int(PAPER[i : i + 2], 16) for i in (1, 3, 5))
    return {"colormap": Table("paper", bytes((red, green, blue, 255)) * 2), "water": None}


def _lines() -> dict[str, Any]:
    """Terrain that is not prioritised: lines, and no shading."""
    return {"light": "none", "contours": Contours(), "silhouettes": Silhouettes()}


def _usual(name: str, value: Any) -> bool:
    """Whether an option is as it would be without being said."""
    from orograph.scene.parts import OPTIONS

    return value is None or bool(value == OPTIONS[name].default)
