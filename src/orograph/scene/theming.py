"""A theme becomes what every backend draws: data as painted layers, priorities as light, lines and tint.

A scene's other options stand where they are given; a priority sets those that are left as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from orograph.scene.contours import Contours
from orograph.scene.silhouettes import Silhouettes

if TYPE_CHECKING:
    from orograph.store.terrain import Terrain
    from orograph.viewpoint import View

FINER, LEAST, MOST = 1.6, 1024, 3072
"""Texels along the longer side of painted data: so many to a pixel of the picture, within these bounds."""

PAPER = "#f4f2ec"
"""The ground under data."""


def themed(options: Mapping[str, Any], terrain: Terrain, view: View) -> dict[str, Any]:
    """A scene's options with its theme carried out.

    Raises:
        ReadError, UsageError: data cannot be read, or do not belong here.
    """
    from orograph.geovis.data.dataset import datasets_of
    from orograph.geovis.data.painting import painted, shown
    from orograph.geovis.data.priority import Priority
    from orograph.geovis.layers import layers_of

    made = dict(options)
    data = datasets_of(options.get("data"))
    given = options.get("priority")
    if not data and given is None:
        return made
    priority = Priority.parse(given) if isinstance(given, str) else given or Priority(data=True)
    usual = _ground() if priority.terrain else _ground() | _lines()
    made = usual | {k: v for k, v in made.items() if k not in usual or not _usual(k, v)}
    texels = int(min(MOST, max(LEAST, FINER * max(view.whole.width, view.whole.height))))
    layers = [painted(shown(one, terrain.grid, texels, priority)) for one in data]
    made["layers"] = (*layers_of(options.get("layers")), *layers)
    return made | {"data": data, "priority": priority}


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
