"""The parts of a scene: lighting, data, annotations, surface, budget. Each option is declared here, once.

Keyword arguments of ``orograph.render`` with their documentation, options of the command line with their help, and the
window's settings come from these fields: a new option needs only a field here and the code that draws it. This module
loads quickly, for the command line's help. Units: metres, pixels, degrees; colours are sRGB from 0 to 1.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

from orograph._named import remedy
from orograph.errors import UsageError
from orograph.folders import parse_bytes
from orograph.lod.options import Described, check, described, option
from orograph.lod.registry import AUTO, chosen
from orograph.scene import given
from orograph.scene.aids import Aids
from orograph.scene.contours import Contours
from orograph.scene.detail import Detail, detail_of
from orograph.scene.silhouettes import Silhouettes

if TYPE_CHECKING:
    from orograph.geovis.data.dataset import Dataset
    from orograph.geovis.data.focus import Focus
    from orograph.geovis.data.priority import Priority
    from orograph.geovis.data.standing import Things
    from orograph.geovis.layers import Layer
    from orograph.geovis.tables import Table
    from orograph.lighting.aperture import Lamp
    from orograph.lighting.sun import Sun
    from orograph.scene.flying import Flight
    from orograph.scene.ghosts import Ghost
    from orograph.store.terrain import Terrain
    from orograph.viewpoint import View

Light = Literal["relief", "ao", "aperture", "raytraced", "none"]
"""Ways of lighting a picture."""

SurfaceNormals = Literal["auto", "computed", "stored", "sampled", "derivatives", "faces"]
"""Where normals come from."""

SHINING = ("aperture", "raytraced")
"""Lights that take lamps and further discs."""

CALLED = "`{0.name}`"
"""Names of options in error messages."""


STEEPEST = 1e9
"""Limit on the exaggeration of heights."""


def _ends(pair: Any) -> tuple[float, float]:
    """Two finite numbers; otherwise two NaNs, with which every comparison is false."""
    try:
        low, high = map(float, pair)
    except (TypeError, ValueError):
        return math.nan, math.nan
    return (low, high) if math.isfinite(low) and math.isfinite(high) else (math.nan, math.nan)


def _some(value: Any) -> bool:
    """Whether an option is set: not None, False or an empty list. (Arrays have no truth value.)"""
    return value is not None and value is not False and not (isinstance(value, tuple | list) and not value)


def check_exaggeration(factor: float) -> None:
    """Raise UsageError unless heights can be stretched by ``factor``."""
    if not 0 < factor <= STEEPEST:
        raise UsageError(f"The exaggeration must be greater than 0 and at most {STEEPEST:g}, not {factor:g}.")


_HIGHEST = 1e9
"""Metres that exceed the heights of any body."""


@dataclass(frozen=True, slots=True)
class Lighting:
    """Light and air.

    Raises:
        UsageError: a number is out of its range, or options contradict each other.
    """

    sun: Sun = option(
        given.default_sun,
        "Where the sun stands: degrees clockwise from grid north and degrees above the horizon (315,45), or a time "
        "with its zone (2026-06-21T12:00+02:00), which gives the real sun at the terrain's middle, refraction "
        "included.",
        read=given.read_sun, given=given.sun, metavar="AZ,ALT|TIME", shown="315,45",
    )  # fmt: skip
    light: Light = option(
        "relief",
        "How light falls: relief: shadows by the skyline, a sky-view factor for the sky; ao: ambient occlusion; "
        "aperture: ambient apertures; raytraced: rays to the sun's disc and to the sky; none: bare colours. Products "
        "that `orograph.bake` has put into a store are used.",
        choices=get_args(Light),
    )
    shadows: bool = option(True, "Whether the ground casts shadows.")
    rays: int = option(64, 'With `light="raytraced"`: rays to each disc of light, and to the sky.', least=1)
    lamps: tuple[Lamp, ...] = option(
        (),
        "A lamp, HEIGHT metres above the zero of the heights, as bright as a sun REACH metres away; its colour from 0 "
        'to 1. Needs `light="aperture"` or `light="raytraced"`.',
        read=given.read_numbers(given.LAMP, 3), given=given.lamps, flag="light-at", metavar=given.LAMP, multiple=True,
    )  # fmt: skip
    discs: tuple[tuple[Sun, tuple[float, float, float]], ...] = option(
        (),
        'Another distant disc of light, with its diameter in degrees. Needs `light="aperture"` or `light="raytraced"`.',
        read=given.read_numbers(given.DISC, 3), given=given.discs, flag="disc", metavar=given.DISC, multiple=True,
    )  # fmt: skip
    relief: float | None = option(
        None, "Stretch slopes for shading only; 1: true slopes.", least=0, metavar="X",
        shown="1 to 6, more for gentle land",
    )  # fmt: skip
    sky: bool = option(False, "Draw sky and haze instead of paper.")
    depths: tuple[float, float] | None = option(
        None, "Depths in metres of the nearest and the farthest ground, between which haze grows.", flag=None,
        shown="those of the ground in view",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check(self, CALLED)
        more = [name for name in ("lamps", "discs") if _some(getattr(self, name))]
        if more and self.light not in SHINING:
            raise UsageError(
                f"`light={self.light!r}` does not support `{more[0]}`.",
                remedy=f"Use {' or '.join(f'`light={one!r}`' for one in SHINING)}.",
            )
        if self.depths is not None:
            nearest, farthest = _ends(self.depths)
            if not 0 <= nearest <= farthest:
                raise UsageError(
                    f"The depths must be those of the nearest and the farthest ground, metres, not {self.depths!r}."
                )


@dataclass(frozen=True, slots=True)
class Data:
    """What the ground shows: its tint, layers over it, water.

    Raises:
        UsageError: a water level is not a height. (``Scene.of`` raises it if there are more layers than can be drawn.)
    """

    colormap: str | Table | None = option(
        None, "Colours of heights: alpine, mars, grey or any name from the cmap catalogue.", metavar="NAME",
        shown="alpine", given=given.colormap,
    )  # fmt: skip
    range: tuple[float, float] | None = option(
        None, "Heights at the ends of the colours, metres, so that two pictures share a scale.", read=given.read_span,
        metavar="LOW:HIGH", shown="the terrain's own",
    )  # fmt: skip
    layers: tuple[Layer, ...] = option(
        (),
        "Lay an image or a raster in any CRS over the ground; several bottom to top. Keys: opacity (0 "
        "to 1), blend (normal, multiply), colormap, range (LOW:HIGH), band and nodata of a raster, visible, name: "
        "rain.tif,colormap=viridis,range=0:80,opacity=0.6.",
        read=given.read_layer, given=given.layers, flag="drape", metavar="IMAGE[,KEY=VALUE…]", multiple=True,
    )  # fmt: skip
    water: Literal["auto"] | float | None = option(
        "auto", "auto: level areas are lakes and seas; a number: all ground up to that height.",
        read=given.read_water, given=given.water, metavar="auto|none|METRES",
    )  # fmt: skip

    def __post_init__(self) -> None:
        if isinstance(self.water, float) and not abs(self.water) < _HIGHEST:
            raise UsageError(f"A water level must be a height in metres, not {self.water:g}.")
        if self.range is not None:
            low, high = _ends(self.range)
            if not low < high:
                raise UsageError(f"A `range` of heights must go from a lower to a higher one, not {self.range!r}.")


@dataclass(frozen=True, slots=True)
class Theme:
    """Data on the ground, their uncertainty, and the priorities of terrain, data and uncertainty.

    Attributes:
        things: the data that stand on the ground, in a scene ready to draw.
    """

    data: tuple[Dataset, ...] = option(
        (),
        "Show values of a raster in any CRS, or of points, lines and polygons (GeoJSON, CSV, what OGR reads). Keys: "
        "variable, band, time (2019-03-01T12, T12; A..B: a span, which films play), member, value (of several: median, "
        "min, max, spread, p90), exceeds (probability of exceeding this value), layer, geometry (which of several), "
        "style (continuous, segmented, isolines, isobands, cells, hatching, stipple, arrows, lic, bivariate; "
        "standing: bars, spheres, cones, discs, flags; of lines tubes, curtains; of tracks tubes, paths; of boreholes "
        "columns, logs; of volumes curtains, walls), "
        "colormap (a name, or CLASS:COLOR;CLASS:COLOR…), names (of classes: 11:Open water;41:Forest), range "
        "(LOW:HIGH), classes, breaks (quantiles, equal, jenks, or values: 0:5:10), height, above, "
        "depth (ATTRIBUTE[:km|ft]: metres of points over the heights' zero, or over or below the ground; from+to), "
        "group (ATTRIBUTE: which borehole or track), when (ATTRIBUTE: time of tracks and points), "
        "trail (6h: how long points are seen after their time), level (of a volume), vertical "
        "(what its levels are: height, above, depth, pressure), along (FILE of lines, or LON:LAT:LON:LAT…: where "
        "curtains through a volume run), hidden (how strongly things below the ground show through it), size, width, "
        "opacity, name, unit: era5.grib,time=T12,style=segmented.",
        read=given.read_data, given=given.data, metavar="FILE[,KEY=VALUE…]", multiple=True,
    )  # fmt: skip
    priority: Priority | None = option(
        None,
        "Priorities: T+ shaded relief, T- a line drawing; D+ a continuous scale, D- classes; U+ glyphs of "
        "uncertainty, U- transparency or noise. Or overview, approach, overflight, replanning.",
        read=given.read_priority, given=given.priority, metavar="T±D±U±", shown="T+D+U- with data",
    )  # fmt: skip
    focus: Focus | None = option(
        None,
        "A different priority in a part of the picture: lens (a disc: at=0.5:0.5, radius=0.25, parts of the "
        "picture), near (distance=METRES from the eye), a file of polygons, or of lines with width=METRES. Keys: "
        "priority, blend (metres; of a lens, parts of the height): route.geojson,width=4000,priority=T+D+U+.",
        read=given.read_focus, given=given.focus, metavar="lens|near|FILE[,KEY=VALUE…]",
    )  # fmt: skip
    flight: Flight | None = option(
        None,
        "Change the priority gradually with the camera's height above ground: approach below LOW metres; above HIGH "
        "overflight, or in films replanning at speeds below SLOW metres per second (overflight above FAST).",
        read=given.read_flight, given=given.flight, metavar="auto|LOW:HIGH[:SLOW:FAST]",
    )  # fmt: skip
    ghosts: tuple[Ghost, ...] = option(
        (),
        "Another, transparent surface over or under the ground: a DEM in any CRS, a water table. Keys: color, "
        "opacity (in front of the ground), hidden (behind it), name, band, vertical_unit: "
        "table.tif,color=#2f7fd1,hidden=0.4.",
        read=given.read_ghost, given=given.ghosts, flag="ghost", metavar="DEM[,KEY=VALUE…]", multiple=True,
    )  # fmt: skip
    things: Things | None = None


@dataclass(frozen=True, slots=True)
class Annotations:
    """Lines on the ground, and furniture around the picture."""

    contours: Contours | None = option(
        None, "Draw contour lines; auto: at an interval that suits the relief and the scale.",
        read=given.read_contours, given=given.contours, metavar="auto|METRES", details=Contours,
    )  # fmt: skip
    silhouettes: Silhouettes | None = option(
        None, "Draw lines along ridges and creases.", given=given.silhouettes, details=Silhouettes
    )
    aids: Aids | None = option(
        None,
        "Draw aids to see heights and directions: drops (lines from what floats down to the ground), shadows "
        "(straight below it), poles (in bands of METRES above ground), grid (lines of easting and northing on the "
        "ground, METRES apart), walls (sections through the middle, beside the terrain), icon (a cube turned like "
        "the view; with `furniture`, in perspective).",
        read=Aids.parse, given=given.aids, metavar="drops,shadows,poles[=METRES],grid[=METRES],walls,icon",
    )  # fmt: skip
    furniture: bool = option(False, "Add a title, a legend, a north arrow and a scale bar.")
    inset: bool = option(
        False,
        "With `furniture`, in perspective: a small map of the part of the terrain that the picture shows.",
    )
    title: str | None = option(None, "The title (with `furniture`).", shown="the file's name")

    def __post_init__(self) -> None:
        check(self, CALLED)


@dataclass(frozen=True, slots=True)
class Surface:
    """The surface to draw, the method, and the level of detail.

    Raises:
        UsageError: a number is out of its range, or options contradict each other.
    """

    exaggeration: float = option(1.0, "Stretch heights on the screen.", metavar="X")
    samples: int = option(4, "Rays per pixel where the picture has edges; 1: jagged edges.", least=1, most=1024)
    tolerance: float | None = option(
        None, "How far the ground may be displaced, pixels; 0 draws every sample.", least=0, metavar="PX",
        shown="0 up to 16.8 million samples, else 0.5; with a `method` 1",
    )  # fmt: skip
    method: str = option(
        "auto",
        "Draw the mesh that this method makes within `tolerance`, with light on its faces; auto: the terrain itself, "
        "by rays on the CPU, by patches on the GPU. The methods and their options: `orograph.methods()`.",
        read=given.read_method, metavar="NAME[,KEY=VALUE…]",
    )  # fmt: skip
    triangles: int | None = option(None, "With a `method`, instead: maximum number of triangles.", least=2, metavar="N")
    wireframe: bool = option(False, "With a `method`: draw its triangles' edges over the relief.")
    normals: SurfaceNormals = option(
        "auto",
        "Source of the normals for lighting (GPU): computed for every pixel from heights; stored at the mesh's "
        "vertices; sampled from heights half a pixel to every side; derivatives of the position on the screen; faces "
        "of the triangles. auto: computed, or faces with the mesh of a `method`.",
        choices=get_args(SurfaceNormals),
    )  # fmt: skip
    mesh_view: View | None = option(
        None, "With a `method`: the camera to select for, to look at the mesh from elsewhere.", given=given.view,
        read=str, metavar="VIEW.json", shown="the picture's",
    )  # fmt: skip

    detail: Detail | None = option(
        None,
        "Invent detail where samples are coarser than pixels: fractal, as rough as the data, or like a fine terrain "
        "(exemplar=lidar.tif). The samples stay as they are, and measurements ignore it.",
        read=Detail.parse, given=given.detail, metavar="fractal|exemplar=FILE[,seed=N]", shown="none",
    )  # fmt: skip

    def __post_init__(self) -> None:
        object.__setattr__(self, "detail", detail_of(self.detail))
        check(self, CALLED)
        check_exaggeration(self.exaggeration)
        if self.detail and not chosen(self.method, "cpu").invents:
            raise UsageError(
                "`detail` is drawn only by rays, or by clipmaps as printed: other methods need errors, which "
                "invented detail does not have.",
                remedy="Leave out the method or the detail.",
            )
        if self.triangles is not None and self.tolerance is not None:
            raise UsageError("Give one goal: `tolerance` or `triangles`.")
        if self.method.partition(",")[0] in ("auto", AUTO["cpu"]):
            for name in ("triangles", "wireframe", "mesh_view"):
                if _some(getattr(self, name)):
                    raise UsageError(
                        f"`{name}` applies to the mesh that a method makes.",
                        remedy='Choose a method, such as `method="soar"`.',
                    )


@dataclass(frozen=True, slots=True)
class Budget:
    """Resources that drawing may use."""

    max_memory: int | None = option(
        None, 'Bytes that heights and pictures may take: a number, or "1GiB".', least=1, read=parse_bytes,
        shown="no limit",
    )  # fmt: skip
    jobs: int | None = option(None, "Threads.", least=1, shown="all processors")

    def __post_init__(self) -> None:
        check(self, CALLED)


PARTS: dict[str, type] = {
    "lighting": Lighting, "data": Data, "theme": Theme, "annotations": Annotations, "surface": Surface,
    "budget": Budget,
}  # fmt: skip
"""The parts of a scene, by the names of its fields."""

OPTIONS: dict[str, Described] = {one.name: one for kind in PARTS.values() for one in described(kind)}
"""All options by their names: no two parts share one."""

HOMES = {one.name: part for part, kind in PARTS.items() for one in described(kind)}
"""The part that has an option, by the option's name."""


def by_part(options: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Options by the part that they belong to.

    Raises:
        UsageError: there is no such option.
    """
    parts: dict[str, dict[str, Any]] = {}
    for name, value in options.items():
        if name not in HOMES:
            raise UsageError(f"A scene has no option {name!r}.", remedy=remedy(name, HOMES))
        parts.setdefault(HOMES[name], {})[name] = value
    return parts


def made_of(name: str, value: Any, terrain: Terrain) -> Any:
    """Convert a given option, a text of the command line or a value, to its value over a terrain.

    Raises:
        UsageError: it cannot be a value of that option.
    """
    one = OPTIONS[name]
    value = one.worded(value)
    try:
        return value if one.given is None else one.given(value, terrain)
    except (TypeError, ValueError, AttributeError, LookupError) as error:
        raise UsageError(
            f"`{name}` cannot be {reprlib.repr(value)}: {error}.",
            remedy=f"It must be {one.metavar.replace('|', ', ') or one.annotation}: see help(orograph.render).",
        ) from error


def check_options(options: Mapping[str, Any]) -> None:
    """Raise UsageError if options contradict each other or a number is out of range, before there is a terrain.

    Values may be as users give them: mostly only their presence matters.
    """
    for part, values in by_part(options).items():
        PARTS[part](**{name: OPTIONS[name].worded(value) for name, value in values.items()})
