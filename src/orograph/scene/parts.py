"""The parts of a scene: surface, lighting, annotations, data, budget. Each option is declared here, once.

Keyword arguments of ``orograph.render``, options of the command line and the window's settings come from these fields
and their help. Units: metres, pixels, degrees; colours are sRGB from 0 to 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

from orograph.errors import UsageError
from orograph.geovis.layers import Layer, check_count
from orograph.lighting.sun import Sun
from orograph.lod.registry import AUTO
from orograph.viewpoint import View

if TYPE_CHECKING:
    from orograph.lighting.aperture import Lamp
    from orograph.scene.contours import Contours
    from orograph.scene.silhouettes import Silhouettes

Light = Literal["relief", "ao", "aperture", "raytraced", "none"]
"""Ways of lighting a picture."""


def told(default: Any, help: str) -> Any:
    """A field with its help."""
    return field(default=default, metadata={"help": help})


def check_exaggeration(factor: float) -> None:
    """Raise UsageError unless heights can be stretched by ``factor``."""
    if not 0 < factor < math.inf:
        raise UsageError(f"The exaggeration is a factor greater than 0, not {factor:g}.")


@dataclass(frozen=True, slots=True)
class Surface:
    """Which surface is drawn, by which method, and how finely.

    Raises:
        UsageError: a number is out of its range, or options contradict each other.
    """

    method: str = told(
        "auto",
        "NAME[,key=value…]: the method whose mesh is drawn, with light on its faces; auto, or what that is: the "
        "terrain itself.",
    )
    tolerance: float | None = told(
        None,
        "Pixels by which the surface may be displaced; 0 draws every sample; None: 0 up to 16.8 million samples, "
        "else 0.5, and 1 of a mesh.",
    )
    triangles: int | None = told(None, "Instead of a tolerance: at most so many triangles of a mesh.")
    wireframe: bool = told(False, "Draw the edges of the mesh, over the terrain's own relief.")
    mesh_view: View | None = told(
        None, "The camera that the mesh is made for, to look at it from elsewhere; None: the scene's."
    )
    exaggeration: float = told(1.0, "Heights are stretched by this on the screen, never in what is measured.")
    samples: int = told(4, "Samples per pixel where the picture has edges; 1: no antialiasing.")

    def __post_init__(self) -> None:
        check_exaggeration(self.exaggeration)
        if self.samples < 1:
            raise UsageError(f"A pixel needs at least one sample, not {self.samples}.")
        if self.tolerance is not None and not self.tolerance >= 0:
            raise UsageError(f"The tolerance is in pixels, 0 or more, not {self.tolerance:g}.")
        if self.triangles is not None and (self.triangles < 2 or self.tolerance is not None):
            raise UsageError("A mesh has a tolerance, or a number of triangles from 2.", remedy="Give one of them.")
        meshed = self.mesh_view is not None or self.triangles is not None or self.wireframe
        if meshed and self.method.partition(",")[0] in ("auto", AUTO["cpu"]):
            raise UsageError(
                "A mesh, its triangles, its wireframe and the view it is made for are a method's.",
                remedy="Choose a method, such as soar.",
            )


@dataclass(frozen=True, slots=True)
class Lighting:
    """How light falls, and the air that it goes through.

    Raises:
        UsageError: a number is out of its range, or options contradict each other.
    """

    sun: Sun = field(default_factory=Sun, metadata={"help": "Where the light comes from."})
    shadows: bool = told(True, "Whether ground casts shadows.")
    light: Light = told(
        "relief",
        '"relief": shadows by the skyline, the sky by a sky-view factor; "ao": ambient occlusion; "aperture": ambient '
        'apertures; "raytraced": rays to the sun\'s disc and to the sky; "none": the bare colours.',
    )
    rays: int = told(64, 'Rays of "raytraced", to each disc and to the sky.')
    lamps: tuple[Lamp, ...] = told((), 'Points of light, with "aperture" and "raytraced".')
    discs: tuple[tuple[Sun, tuple[float, float, float]], ...] = told(
        (), "More suns with their colours, (1, 1, 1) being about that of the sun at 45°."
    )
    relief: float | None = told(
        None, "Factor on slopes for shading only; 1 is nature; None strengthens small scales and gentle land."
    )
    sky: bool = told(False, "Draw sky and haze, else the background is paper.")
    depths: tuple[float, float] | None = told(
        None, "Metres of depth of the nearest and the farthest ground, between which haze grows; None: of what is seen."
    )

    def __post_init__(self) -> None:
        if self.relief is not None and not 0 <= self.relief < math.inf:
            raise UsageError(f"The relief is a factor, 0 or more, not {self.relief:g}.")
        if self.light not in get_args(Light):
            raise UsageError(f"There is no light {self.light!r}; there are {', '.join(get_args(Light))}.")
        if self.rays < 1:
            raise UsageError(f"At least one ray is needed, not {self.rays}.")
        if (self.lamps or self.discs) and self.light not in ("aperture", "raytraced"):
            raise UsageError(
                "Lamps and further discs of light shine through apertures or by rays.",
                remedy='Choose the light "aperture" or "raytraced".',
            )
        if self.depths is not None and not 0 <= self.depths[0] <= self.depths[1] < math.inf:
            raise UsageError(f"depths are those of the nearest and the farthest ground in metres, not {self.depths}.")


@dataclass(frozen=True, slots=True)
class Annotations:
    """Lines on the ground, and what stands around the picture."""

    contours: Contours | None = told(None, "Lines of equal height on the ground.")
    silhouettes: Silhouettes | None = told(None, "Lines where ridges hide what is behind them, and along creases.")
    furniture: bool = told(False, "Add a title, a colour bar, a north arrow and a scale bar.")
    title: str | None = told(None, "The title; None: the terrain's name.")


@dataclass(frozen=True, slots=True)
class Data:
    """What the ground shows: its tint, layers over it, water.

    Raises:
        UsageError: there are more layers than can be drawn, or a water level is no height.
    """

    colormap: str | None = told(None, "A cmap name, or alpine, mars, grey; None: the hypsometric tint.")
    layers: tuple[Layer, ...] = told((), "Images and rasters laid over the ground, bottom to top.")
    water: Literal["auto"] | float | None = told(
        "auto", '"auto" finds seas and lakes by their flatness, None draws none, a number is a water level in metres.'
    )

    def __post_init__(self) -> None:
        check_count(self.layers)
        if isinstance(self.water, float) and not math.isfinite(self.water):
            raise UsageError(f"A water level is a height in metres, not {self.water:g}.")


@dataclass(frozen=True, slots=True)
class Budget:
    """What drawing may take."""

    max_memory: int | None = told(None, "Bytes that heights and pictures may take; None: no limit.")
    jobs: int | None = told(None, "Threads; None: all processors.")
