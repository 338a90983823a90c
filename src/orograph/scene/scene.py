"""What is drawn: terrain, camera, light, colour and furniture, the same description for every backend."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

from orograph.errors import ReadError, UsageError
from orograph.geovis.layers import Layer, check_count
from orograph.lighting.sun import Sun
from orograph.lod.registry import AUTO
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

if TYPE_CHECKING:
    from orograph.lighting.aperture import Lamp
    from orograph.scene.contours import Contours
    from orograph.scene.silhouettes import Silhouettes

EXACT_SAMPLES = 4100 * 4100
"""Terrains of up to this many samples are drawn at full resolution unless a tolerance is asked for."""

DEFAULT_TOLERANCE = 0.5
"""Pixels: what larger terrains may be displaced by on the screen."""


Light = Literal["relief", "ao", "aperture", "raytraced", "none"]
"""Ways of lighting a picture."""


def check_exaggeration(factor: float) -> None:
    """Raise UsageError unless heights can be stretched by ``factor``."""
    if not 0 < factor < math.inf:
        raise UsageError(f"The exaggeration is a factor greater than 0, not {factor:g}.")


@dataclass(frozen=True, slots=True)
class Scene:
    """A picture to be.

    Attributes:
        terrain, view: what is looked at, and from where.
        sun: the light; ``shadows``: whether ground casts shadows.
        light: how it falls (``LIGHTS``): "relief": shadows by the skyline, the sky by a sky-view factor swept for the
            picture; "ao": the same with ambient occlusion, baked or swept; "aperture": sun and sky through ambient
            apertures, baked or swept; "raytraced": rays to the sun's disc and to the sky; "none": the bare colours.
        rays: of "raytraced", to each disc and to the sky. ``lamps``: points of light, ``discs``: more suns with their
            colours ((1, 1, 1) being about that of the sun at 45°); both with "aperture" and "raytraced".
        exaggeration: heights are stretched by this on the screen (never in what is measured).
        colormap: a ``cmap`` name or one of ``geovis.color``'s own; None: the hypsometric tint.
        layers: images and rasters laid over the ground, bottom to top.
        sky: draw sky and haze; else the background is paper.
        water: "auto" finds seas and lakes by their flatness, None draws none, a number is a water level in metres.
        contours: lines of equal height on the ground; None: none.
        silhouettes: lines where ridges hide what is behind them, and along creases; None: none.
        relief: factor on slopes for shading only; None strengthens small scales and gentle land, 1 is nature.
        samples: rays per pixel where the picture has edges (1: no antialiasing).
        tolerance: pixels; 0 demands the exact surface, None decides by size (``EXACT_SAMPLES``, ``DEFAULT_TOLERANCE``).
        method: ``NAME[,key=value…]``: draw the mesh that this method makes within ``tolerance`` (None: 1 pixel), with
            light on its faces; "auto", or what that is (``lod.registry.AUTO``), draws the terrain itself.
            ``triangles``: instead of a tolerance, at most so many. ``wireframe``: draw its edges, over the terrain's
            own relief. ``mesh_view``: the camera the mesh is made for, if not ``view``: to look at it from elsewhere.
        furniture: title, colour bar, north arrow, scale bar; ``title``: None takes the terrain's name.
        depths: metres of depth of the nearest and the farthest ground, between which haze grows; None: of the ground in
            view. A movie gives them, so that haze does not flicker as a summit comes into view.
        max_memory: bytes that heights and pictures may take; None: no limit.
        jobs: threads; None: all processors.

    Raises:
        UsageError: a number is out of its range.
        ReadError: the terrain has fewer than two rows or columns.
    """

    terrain: Terrain
    view: View
    sun: Sun = field(default_factory=Sun)
    shadows: bool = True
    light: Light = "relief"
    rays: int = 64
    lamps: tuple[Lamp, ...] = ()
    discs: tuple[tuple[Sun, tuple[float, float, float]], ...] = ()
    exaggeration: float = 1.0
    colormap: str | None = None
    layers: tuple[Layer, ...] = ()
    sky: bool = False
    water: Literal["auto"] | float | None = "auto"
    contours: Contours | None = None
    silhouettes: Silhouettes | None = None
    relief: float | None = None
    samples: int = 4
    tolerance: float | None = None
    method: str = "auto"
    triangles: int | None = None
    wireframe: bool = False
    mesh_view: View | None = None
    furniture: bool = False
    title: str | None = None
    depths: tuple[float, float] | None = None
    max_memory: int | None = None
    jobs: int | None = None

    def __post_init__(self) -> None:
        check_count(self.layers)
        check_exaggeration(self.exaggeration)
        if self.relief is not None and not 0 <= self.relief < math.inf:
            raise UsageError(f"The relief is a factor, 0 or more, not {self.relief:g}.")
        if isinstance(self.water, float) and not math.isfinite(self.water):
            raise UsageError(f"A water level is a height in metres, not {self.water:g}.")
        if self.samples < 1:
            raise UsageError(f"A pixel needs at least one sample, not {self.samples}.")
        if self.tolerance is not None and not self.tolerance >= 0:
            raise UsageError(f"The tolerance is in pixels, 0 or more, not {self.tolerance:g}.")
        if self.light not in get_args(Light):
            raise UsageError(f"There is no light {self.light!r}; there are {', '.join(get_args(Light))}.")
        if self.rays < 1:
            raise UsageError(f"At least one ray is needed, not {self.rays}.")
        if (self.lamps or self.discs) and self.light not in ("aperture", "raytraced"):
            raise UsageError(
                "Lamps and further discs of light shine through apertures or by rays.",
                remedy="Choose --light aperture or --light raytraced.",
            )
        if self.depths is not None and not 0 <= self.depths[0] <= self.depths[1] < math.inf:
            raise UsageError(f"depths are those of the nearest and the farthest ground in metres, not {self.depths}.")
        if self.method.partition(",")[0] in ("auto", AUTO["cpu"]) and (
            self.mesh_view is not None or self.triangles is not None or self.wireframe
        ):
            raise UsageError(
                "A mesh, its triangles, its wireframe and the view it is made for are a method's.",
                remedy="Choose a method, such as soar.",
            )
        if self.triangles is not None and (self.triangles < 2 or self.tolerance is not None):
            raise UsageError("A mesh has a tolerance, or a number of triangles from 2.", remedy="Give one of them.")
        if min(self.terrain.grid.shape) < 2:
            raise ReadError(
                f"The raster has {self.terrain.grid.rows} row(s) and {self.terrain.grid.cols} column(s); a surface "
                "needs at least two of each.",
                path=self.terrain.name,
            )

    @property
    def pixel_tolerance(self) -> float:
        """The tolerance in force, pixels."""
        if self.tolerance is not None:
            return self.tolerance
        rows, cols = self.terrain.grid.shape
        return 0.0 if rows * cols <= EXACT_SAMPLES else DEFAULT_TOLERANCE
