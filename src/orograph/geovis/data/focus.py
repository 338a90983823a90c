"""Focus and context: where a picture has a different priority, and its weight at each place.

A focus is a lens (a disc of the picture), a region (polygons), a corridor along a route (lines of a width), or all that
is nearer to the eye than a distance. At its border the two pictures are blended over ``blend`` metres (of a lens:
heights of the picture), half on either side, by a smooth step. Borders of regions and corridors lie within a texel of
an image over the terrain, ``TEXELS`` along the longer side.
"""

from __future__ import annotations

import difflib
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from orograph._named import named
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.priority import Priority
from orograph.geovis.layers import keyed

Array = NDArray[np.float64]

TEXELS = 2048
LENS, NEAR = "lens", "near"

KEYS = ("priority", "at", "radius", "width", "distance", "blend", "layer", "geometry")


@named("A focus")
@dataclass(frozen=True, slots=True)
class Focus:
    """Where a different priority applies.

    Attributes:
        source: "lens", "near", or polygons or lines: a file, GeoJSON, or what has ``__geo_interface__``.
        priority: that of the focus, as of a scene.
        at, radius: of a lens: its middle, parts of the picture's width and height from the upper left corner, and its
            radius, a part of the picture's height.
        width: of a corridor, metres in all. distance: of ``near``, metres from the eye.
        blend: metres (of a lens, parts of the picture's height) over which the pictures are blended; None: a tenth
            of the radius, the width or the distance, of polygons a fiftieth of the terrain.
        layer, geometry: as of a ``Dataset``.

    Raises:
        UsageError: a value makes no sense, or is of another kind of focus.
    """

    source: Any
    priority: Priority | str = field(default_factory=lambda: Priority(True, True, True))
    at: tuple[float, float] = (0.5, 0.5)
    radius: float = 0.25
    width: float | None = None
    distance: float | None = None
    blend: float | None = None
    layer: str | None = None
    geometry: Any = None

    def __post_init__(self) -> None:
        if isinstance(self.priority, str):
            object.__setattr__(self, "priority", Priority.parse(self.priority))
        for name in ("radius", "width", "distance"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise UsageError(f"The {name} of a focus must be more than 0, not {value}.")
        if self.blend is not None and not 0 <= self.blend < math.inf:
            raise UsageError(f"The blend of a focus must be 0 or more, not {self.blend}.")
        at = np.asarray(self.at, object)
        if at.shape != (2,) or not all(isinstance(v, int | float | np.number) and 0 <= v <= 1 for v in at):
            raise UsageError(f"The place of a lens must be two parts of the picture, from 0 to 1 each, not {self.at}.")
        if self.source == NEAR and self.distance is None:
            raise UsageError("The focus near needs a distance, metres from the eye.")
        if self.source != NEAR and self.distance is not None:
            raise UsageError("A distance applies only to the focus near.")

    @classmethod
    def parse(cls, text: str) -> Self:
        """A focus from the command line: ``lens|near|FILE[,KEY=VALUE…]``.

        Raises:
            UsageError: a key is unknown or its value makes no sense.
        """
        source, told = keyed(text)
        made: dict[str, Any] = {}
        for key, value in told.items():
            if key not in KEYS:
                close = difflib.get_close_matches(key, KEYS, 1)
                hint = f"Did you mean {close[0]}?" if close else f"The keys are {', '.join(KEYS)}."
                raise UsageError(f"A focus has no key {key!r}.", path=source, remedy=hint)
            made[key] = value if key in ("priority", "layer", "geometry") else _numbers(value, key)
        return cls(source, **made)

    def over(self, grid: Grid) -> Weight:
        """How much of it shows, over a terrain with this grid.

        Raises:
            ReadError, UsageError: shapes cannot be read, or lie beside the terrain, or are points.
        """
        if self.source == LENS:
            return _Lens(self.at, self.radius, self.radius / 10 if self.blend is None else self.blend)
        if self.source == NEAR:
            far = self.distance or 0.0
            return _Near(far, far / 10 if self.blend is None else self.blend)
        return _region(self, grid)


class Weight(ABC):
    """How much of a focus shows at the pixels of a picture."""

    def shows(self, eye: Array) -> bool:
        """Whether any of it may show to an eye (3,)."""
        return True

    @abstractmethod
    def __call__(self, eye: Array, places: Array, pixels: tuple[Array, Array], aspect: float) -> Array:
        """(rows, cols), 0 to 1.

        Args:
            eye: (3,) easting, northing, height. places: (rows, cols, 3) of what is seen; NaN where it is sky.
            pixels: x (cols,) from the left and y (rows,) from the top of the whole picture, in heights of it.
            aspect: its width by its height.
        """


@dataclass(frozen=True, slots=True)
class _Lens(Weight):
    at: tuple[float, float]
    radius: float
    blend: float

    def __call__(self, eye: Array, places: Array, pixels: tuple[Array, Array], aspect: float) -> Array:
        x, y = pixels
        return smooth_step(
            self.radius - np.hypot((x - self.at[0] * aspect)[None, :], (y - self.at[1])[:, None]), self.blend
        )


@dataclass(frozen=True, slots=True)
class _Near(Weight):
    distance: float
    blend: float

    def __call__(self, eye: Array, places: Array, pixels: tuple[Array, Array], aspect: float) -> Array:
        far = np.sqrt(((places - eye) ** 2).sum(-1))
        return np.nan_to_num(smooth_step(self.distance - far, self.blend))


@dataclass(frozen=True, slots=True, eq=False)
class _Region(Weight):
    """Weights (rows, cols) at the texels of a grid; 0 beyond."""

    grid: Grid
    values: NDArray[np.float32]

    def __call__(self, eye: Array, places: Array, pixels: tuple[Array, Array], aspect: float) -> Array:
        from orograph.geovis.data.sampling import bilinear

        known = np.isfinite(places[..., 0])
        x, y = (np.where(known, places[..., k], 0.0) for k in (0, 1))
        found = bilinear(self.values, *self.grid.index(x, y))
        return np.where(known, np.nan_to_num(found), 0.0).astype(np.float64)


def smooth_step(inside: Array, blend: float) -> Array:
    """1 well inside a border, 0 well outside, by a cubic between; ``inside``: the distance from the border."""
    if blend == 0:
        return (inside >= 0).astype(np.float64)
    t = np.clip(inside / blend + 0.5, 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def _region(focus: Focus, grid: Grid) -> _Region:
    """The weights of polygons, or of a corridor along lines."""
    from affine import Affine
    from scipy.ndimage import distance_transform_edt

    from orograph.geo.grid import compose
    from orograph.geovis.data.features import has_features, read_features
    from orograph.geovis.data.shape_painting import shown_shapes

    made = Dataset(focus.source, layer=focus.layer, geometry=focus.geometry, style="continuous", name="focus")
    if not has_features(made.source):
        raise UsageError(
            "A focus must be lens, near, or a file of polygons or lines.", path=str(focus.source),
            remedy="Give a GeoJSON file, or one that OGR reads.",
        )  # fmt: skip
    found = read_features(made, grid)
    found = replace(found, columns={})  # (what they are does not matter)
    if found.kind == "points":
        raise UsageError("Points have no area.", path=found.name, remedy="Give polygons, or lines with a width.")
    if found.kind == "lines" and focus.width is None:
        raise UsageError(
            "A corridor along lines needs a width in metres.", path=found.name, remedy="Give width=2000, for example."
        )
    if found.kind == "polygons" and focus.width is not None:
        raise UsageError("A width applies only to a corridor along lines.", path=found.name)
    longer = max(grid.rows * grid.spacing[1], grid.cols * grid.spacing[0])
    blend = focus.blend
    if blend is None:
        blend = longer / 50 if focus.width is None else focus.width / 10
    shown = shown_shapes(
        made.but(width=0 if focus.width is None else f"{focus.width}m"), found, grid, TEXELS, 1.0, Priority()
    )
    cover, over = np.asarray(shown.cover), shown.over
    metres = float(np.hypot(over.transform.a, over.transform.d)), float(np.hypot(over.transform.b, over.transform.e))
    rim = math.ceil(blend / 2 / min(metres)) + 2
    inside = np.pad(cover >= 0.5, rim)
    step = (metres[1], metres[0])
    if inside.all() or not inside.any():
        far = np.full(inside.shape, math.inf if inside.all() else -math.inf)
    else:
        # Between the last texel inside and the first outside, half a texel from either, is the border.
        half = min(metres) / 2
        far = np.where(inside, distance_transform_edt(inside, step) - half,
                       half - distance_transform_edt(~inside, step))  # fmt: skip
    place = compose(over.transform, Affine.translation(-rim, -rim))
    return _Region(Grid(inside.shape, place, over.crs), smooth_step(far, blend).astype(np.float32))


def _numbers(text: str, key: str) -> Any:
    try:
        found = tuple(float(part) for part in text.split(":"))
    except ValueError:
        found = ()
    if len(found) != (2 if key == "at" else 1) or not all(map(math.isfinite, found)):
        raise UsageError(f"{key} must be {'X:Y' if key == 'at' else 'a number'}, not {text!r}.")
    return found if key == "at" else found[0]
