"""The description of a picture: terrain, camera, and the scene's parts; the same for every backend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from orograph.errors import ReadError, UsageError
from orograph.geovis.data.shared import sharing
from orograph.geovis.keys import Legend
from orograph.geovis.layers import attributed, drawn
from orograph.scene.parts import (
    HOMES,
    PARTS,
    Annotations,
    Budget,
    Data,
    Lighting,
    Surface,
    Theme,
    by_part,
    made_of,
)
from orograph.scene.theming import themed
from orograph.store.terrain import EXACT_SAMPLES, Terrain
from orograph.viewpoint import View

if TYPE_CHECKING:
    from orograph.geovis.data.focus import Weight
    from orograph.scene.ghosts import Ghost

DEFAULT_TOLERANCE = 0.5
"""Default tolerance of larger terrains, pixels."""


BY_PRIORITY = ("light", "contours", "silhouettes", "colormap", "water", "layers", "data", "priority", "focus",
               "flight", "ghosts")  # fmt: skip
"""Options in which the variants of a scene differ."""


OF_GHOSTS = ("sun", "relief", "exaggeration", "sky", "depths", "furniture", "title")
"""Options that ghosted surfaces share with their scene."""


@dataclass(frozen=True, slots=True)
class Variant:
    """A scene shown in place of another, where it is shown, and its additional legend."""

    scene: Scene
    weight: Weight
    name: str = "focus"
    rgb: tuple[int, int, int] | None = None
    """The colour of a ghost."""

    def but(self, terrain: Terrain | None, view: View | None, options: Mapping[str, Any]) -> Variant:
        """The same variant of another scene; a ghost keeps its own terrain and takes the light and the exaggeration."""
        if self.rgb is None:
            return replace(self, scene=self.scene.but(terrain=terrain, view=view, **options))
        own = {name: options[name] for name in OF_GHOSTS if name in options}
        return replace(self, scene=self.scene.but(view=view, **own))


@dataclass(frozen=True, slots=True)
class Scene:
    """The description of a picture.

    Attributes:
        terrain, view: the ground and the camera.
        surface, lighting, annotations, data, theme, budget: see ``scene.parts``.
        variants: scenes shown in place of this one, each with its weight at a pixel, later ones over earlier ones.

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
    variants: tuple[Variant, ...] = ()

    def __post_init__(self) -> None:
        if min(self.terrain.grid.shape) < 2:
            raise ReadError(
                f"The raster has {self.terrain.grid.rows} × {self.terrain.grid.cols} samples (rows × columns); a "
                "surface needs at least two of each.",
                path=self.terrain.name,
            )

    @classmethod
    @sharing()
    def of(cls, terrain: Terrain, view: View, **options: Any) -> Self:
        """A scene from options by name, whichever parts they belong to, as users give them (``scene.given``).

        Raises:
            UsageError: there is no such option, or as for the parts.
        """
        theme = themed(options, terrain, (view.whole.width, view.whole.height))
        things, parts = theme.things, _sorted(theme.options, terrain)
        made = cls(terrain, view, **{part: PARTS[part](**given) for part, given in parts.items()})
        if things is not None:
            made = replace(made, theme=replace(made.theme, things=things))
        focus = made.theme.focus
        bare = {**options, "ghosts": ()}
        if made.theme.flight is not None:
            made = cls._flying(made, bare)
        elif focus is not None:
            there = cls.of(terrain, view, **{**bare, "focus": None, "priority": focus.priority})
            made = replace(made, variants=(Variant(there, focus.over(terrain.grid)),))
        ghosts = tuple(cls.ghost(made, one) for one in made.theme.ghosts)
        return replace(made, variants=(*made.variants, *ghosts)) if ghosts else made

    @classmethod
    def ghost(cls, scene: Self, ghost: Ghost) -> Variant:
        """Another, transparent surface."""
        from orograph.scene.ghosts import Seen

        surface = ghost.over(scene.terrain)
        alone = cls.of(
            surface, scene.view, sun=scene.lighting.sun, relief=scene.lighting.relief, water="none",
            colormap=ghost.table, exaggeration=scene.surface.exaggeration, samples=scene.surface.samples,
            max_memory=scene.budget.max_memory, jobs=scene.budget.jobs,
        )  # fmt: skip
        named = ghost.name or surface.name.replace("_", " ")
        return Variant(alone, Seen(scene.terrain.grid, ghost.opacity, ghost.hidden), named, ghost.rgb)

    @classmethod
    def _flying(cls, scene: Self, options: Mapping[str, Any]) -> Self:
        """A scene whose scenarios change with its camera."""
        from orograph.scene.flying import BASE, OTHERS, Flown

        terrain, flight = scene.terrain, scene.theme.flight
        assert flight is not None
        for name in ("priority", "focus"):
            if options.get(name) is not None:
                raise UsageError(f"`flight` and `{name}` both set the priority: give one of them.", remedy="Give one.")
        bare = {**options, "flight": None}
        first, *rest = (cls.of(terrain, scene.view, **{**bare, "priority": name}) for name in (BASE, *OTHERS))
        whole = flight.over(terrain)
        variants = tuple(Variant(one, Flown(terrain, whole, k), OTHERS[k]) for k, one in enumerate(rest))
        return replace(first, theme=replace(first.theme, flight=flight), variants=variants)

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
        if self.variants:
            common = {name: value for name, value in options.items() if name not in BY_PRIORITY}
            parts["variants"] = tuple(one.but(terrain, view, common) for one in self.variants)
        return replace(self, **parts)

    def summary(self) -> dict[str, Any]:
        """A short description of the picture: its options, view and terrain, for JSON with ``default=str``."""
        left_out = ("sun", "jobs", "max_memory", "mesh_view")
        options = {name: getattr(getattr(self, part), name) for name, part in HOMES.items() if name not in left_out}
        options["layers"] = [
            layer for layer in options["layers"] if layer.key is None
        ]  # (data are described separately)
        sun, mesh_view, grid = self.lighting.sun, self.surface.mesh_view, self.terrain.grid
        return {
            "scene": options, "sun": [sun.azimuth, sun.altitude, sun.diameter], "view": self.view.to_dict(),
            "terrain": [self.terrain.name, grid.shape, list(grid.transform)[:6], self.terrain.height_range],
            "mesh_view": None if mesh_view is None else mesh_view.to_dict(),
        }  # fmt: skip

    @property
    def attribution(self) -> tuple[str, ...]:
        """The credits that the makers of its heights and layers ask for."""
        return attributed(self.terrain.attribution, self.data.layers)

    @property
    def keys(self) -> tuple[Legend, ...]:
        """The meaning of the data's colours and signs: first standing objects, then painted data, uppermost first."""
        things = self.theme.things
        painted = [layer.key for layer in reversed(drawn(self.data.layers)) if layer.key is not None]
        own = (*((things.legend,) if things is not None else ()), *painted)
        eye = np.asarray(self.view.eye, np.float64)
        shown = [one for one in self.variants if one.weight.shows(eye)]
        more = (beyond(own, key, one.name) for one in shown for key in one.scene.keys)
        ghosts = tuple((one.name, one.rgb) for one in self.variants if one.rgb is not None)
        seen = (Legend(classes=ghosts),) if ghosts else ()
        return (*own, *(key for key in more if key is not None), *seen)

    @property
    def pixel_tolerance(self) -> float:
        """The effective tolerance, pixels."""
        if self.surface.tolerance is not None:
            return self.surface.tolerance
        rows, cols = self.terrain.grid.shape
        return 0.0 if rows * cols <= EXACT_SAMPLES else DEFAULT_TOLERANCE


def beyond(own: tuple[Legend, ...], key: Legend, name: str) -> Legend | None:
    """Legend entries that the others do not have yet; None: nothing."""
    scales = {(one.words, one.low, one.high, one.colors.tobytes()) for legend in own for one in legend.scales}
    words = {word for legend in own for word, _ in (*legend.swatches, *legend.classes)}
    notes = {legend.note for legend in own}
    new = replace(
        key,
        scales=tuple(
            replace(one, label=f"{one.label}, {name}") for one in key.scales
            if (one.words, one.low, one.high, one.colors.tobytes()) not in scales
        ),
        swatches=tuple((f"{word}, {name}" if word in words else word, look) for word, look in key.swatches),
        classes=tuple(one for one in key.classes if one[0] not in words), note="" if key.note in notes else key.note,
        squares=tuple(one for one in key.squares if not any(legend.squares for legend in own)),
    )  # fmt: skip
    return new if new.scales or new.swatches or new.classes or new.note or new.squares else None


def _sorted(options: Mapping[str, Any], terrain: Terrain) -> dict[str, dict[str, Any]]:
    """Options by the part that they belong to, each converted to its value over a terrain."""
    return {
        part: {name: made_of(name, value, terrain) for name, value in own.items()}
        for part, own in by_part(options).items()
    }
