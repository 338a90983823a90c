"""What is drawn: terrain, camera, and the scene's parts, the same description for every backend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

from orograph.errors import ReadError
from orograph.geovis.keys import Legend
from orograph.geovis.layers import attributed, drawn
from orograph.scene.parts import PARTS, Annotations, Budget, Data, Lighting, Surface, Theme, by_part, made_of
from orograph.scene.theming import themed
from orograph.store.terrain import EXACT_SAMPLES, Terrain
from orograph.viewpoint import View

DEFAULT_TOLERANCE = 0.5
"""Pixels: what larger terrains may be displaced by on the screen."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A picture to be.

    Attributes:
        terrain, view: what is looked at, and from where.
        surface, lighting, annotations, data, theme, budget: see ``scene.parts``.

    Raises:
        ReadError: the terrain has fewer than two rows or columns.
    """

    terrain: Terrain
    view: View
    surface: Surface = field(default_factory=Surface)
    lighting: Lighting = field(default_factory=Lighting)
    annotations: Annotations = field(default_factory=Annotations)
    data: Data = field(default_factory=Data)
    theme: Theme = field(default_factory=Theme)
    budget: Budget = field(default_factory=Budget)

    def __post_init__(self) -> None:
        if min(self.terrain.grid.shape) < 2:
            raise ReadError(
                f"The raster has {self.terrain.grid.rows} row(s) and {self.terrain.grid.cols} column(s); a surface "
                "needs at least two of each.",
                path=self.terrain.name,
            )

    @classmethod
    def of(cls, terrain: Terrain, view: View, **options: Any) -> Self:
        """A scene by its options' names, whichever parts they belong to, as users give them (``scene.given``).

        Raises:
            UsageError: there is no such option, or as the parts.
        """
        theme = themed(options, terrain, (view.whole.width, view.whole.height))
        things, parts = theme.things, _sorted(theme.options, terrain)
        made = cls(terrain, view, **{part: PARTS[part](**given) for part, given in parts.items()})
        return made if things is None else replace(made, theme=replace(made.theme, things=things))

    def but(self, *, terrain: Terrain | None = None, view: View | None = None, **options: Any) -> Self:
        """The same scene with another terrain, another view or other options.

        Raises: as ``of``.
        """
        parts: dict[str, Any] = {
            part: replace(getattr(self, part), **given)
            for part, given in _sorted(options, terrain or self.terrain).items()
        }
        if terrain is not None:
            parts["terrain"] = terrain
        if view is not None:
            parts["view"] = view
        return replace(self, **parts)

    @property
    def attribution(self) -> tuple[str, ...]:
        """Whom the makers of its heights and layers want to be named."""
        return attributed(self.terrain.attribution, self.data.layers)

    @property
    def keys(self) -> tuple[Legend, ...]:
        """What the colours and signs of its data mean: of what stands, then of painted data, the uppermost first."""
        things = self.theme.things
        painted = [layer.key for layer in reversed(drawn(self.data.layers)) if layer.key is not None]
        return (*((things.legend,) if things is not None else ()), *painted)

    @property
    def pixel_tolerance(self) -> float:
        """The tolerance in force, pixels."""
        if self.surface.tolerance is not None:
            return self.surface.tolerance
        rows, cols = self.terrain.grid.shape
        return 0.0 if rows * cols <= EXACT_SAMPLES else DEFAULT_TOLERANCE


def _sorted(options: Mapping[str, Any], terrain: Terrain) -> dict[str, dict[str, Any]]:
    """Options by the part that they belong to, each made what it is over a terrain."""
    return {
        part: {name: made_of(name, value, terrain) for name, value in own.items()}
        for part, own in by_part(options).items()
    }
