"""The content of a scene's furniture: title, colours, north, scale and light, from what was drawn."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph.geo.grid import NAMELESS, Grid, name_of
from orograph.geovis.basemaps import PREFIX
from orograph.geovis.color import Tint, linear_to_srgb
from orograph.geovis.keys import Legend, Scale, written_unit
from orograph.geovis.layers import Layer
from orograph.geovis.layers import drawn as visible
from orograph.geovis.tables import Table
from orograph.memo import Memo
from orograph.rendering.palette import HATCH, VISIBLE, WATER, hatching
from orograph.rendering.survey import stride
from orograph.scene.aids import interval_of
from orograph.scene.scene import Scene

if TYPE_CHECKING:
    from orograph.geovis.laying import Laid

Array = NDArray[np.float64]

DRAPED = 0.98
"""If images cover at least this part of the visible ground, the colours of heights are not explained."""

ONE_SCALE = 3.0
"""A perspective has a scale bar, for its middle, if its ground's distance varies by at most this factor."""

CONVERGENCE = 3.0
"""Degrees between grid north and true north from which the arrow, which shows grid north, says so."""

MOST_SCALES, MOST_CLASSES = 3, 12
"""Maximum entries of a legend."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """What furniture needs from a picture besides its scene.

    Attributes:
        tint: the colours of heights. shown: number of pixels that show "ground" (of these "water" and "draped") and
        "missing".
        draped: whether an image lies over the ground.
        depths: (n,) view-space depths of ground, evenly from all of the picture (``sampled``), none NaN.
        column: (height,) depths in the picture's middle column, NaN where no ground is.
    """

    tint: Tint
    shown: dict[str, int]
    draped: bool
    depths: Array
    column: Array


def sampled(depth: NDArray[np.floating], height: int, width: int, top: int = 0, left: int = 0) -> Array:
    """A sample, for ``Drawn.depths``, of the depths of a part of a picture that begins at (top, left)."""
    step = stride(height, width)
    some = depth[-top % step :: step, -left % step :: step]
    return np.asarray(some[np.isfinite(some)], np.float64)


def furniture_of(scene: Scene, drawn: Drawn) -> dict[str, Any]:
    """The keyword arguments of ``furnish`` for a scene's picture, except the ground to spare."""
    view, terrain = scene.view, scene.terrain
    metres = _scale(scene, drawn)
    if metres is not None:
        metres /= stretch(scene)
    sun, parts = scene.lighting.sun, []
    if scene.lighting.light != "none":
        parts.append(sun.words)
    if scene.surface.exaggeration != 1:
        parts.append(f"heights ×{scene.surface.exaggeration:g}")
    if scene.surface.detail is not None:
        parts.append(scene.surface.detail.words)
    if scene.annotations.contours is not None:
        interval = scene.annotations.contours.fitted(terrain, view, Memo()).interval
        parts.append(f"contours every {interval:g} m")
    if (apart := interval_of(scene.annotations.aids, scene.view)) is not None:
        parts.append(f"grid lines every {apart:g} m")
    if view.projection == "perspective" and metres is not None:
        parts.append("scale at the picture's middle")
    parts += [key.note for key in scene.keys if key.note]
    if crs := _crs_name(terrain.grid.crs):
        parts.append(crs)
    title = scene.annotations.title
    return {
        "title": title if title is not None else _title(terrain.name), "legend": _legend(drawn, scene),
        "north": north_on_screen(scene), "metres_per_pixel": metres, "note": " · ".join(parts),
        "credit": "; ".join(scene.attribution) or None,
        "turned": _turned(scene), "grid_north": abs(convergence(scene)) > CONVERGENCE, "paper": not scene.lighting.sky,
    }  # fmt: skip


def _legend(drawn: Drawn, scene: Scene) -> Legend | None:
    """The legend of what was drawn: layers' values, the uppermost first, heights unless an image covers (nearly) all,
    water, no data."""
    shown, tint = drawn.shown, drawn.tint
    dry = shown["ground"] - shown["water"]
    scales = [scale for key in scene.keys for scale in key.scales]
    swatches = [entry for key in scene.keys for entry in key.entries]
    for layer in [one for one in reversed(visible(scene.data.layers)) if not one.path.startswith(PREFIX)]:
        explained = explain(layer, scene.terrain.grid)
        if isinstance(explained, Scale):
            scales.append(explained)
        else:
            swatches += explained
    plain = bool((tint.land == tint.land[0]).all())
    if not plain and (not drawn.draped or shown["draped"] < DRAPED * dry):
        low, high, colors = tint.scale()
        scales.append(Scale(low, high, linear_to_srgb(colors), below=tint.below, above=tint.above))
    if shown["water"] >= VISIBLE:
        swatches.append(("Water", linear_to_srgb(WATER)))
    if shown["missing"] >= VISIBLE:
        y, x = np.mgrid[:HATCH, :HATCH].reshape(2, -1) + 0.5
        swatches.append(("No data", linear_to_srgb(hatching(x, y)).reshape(HATCH, HATCH, 3)))
    squares = tuple(one for key in scene.keys for one in key.squares)
    if not (scales or swatches or squares):
        return None
    return Legend(tuple(scales[:MOST_SCALES]), tuple(swatches), squares=squares[:1])


def explain(layer: Layer, grid: Grid) -> Scale | list[tuple[str, Any]]:
    """The legend of a layer's values over a terrain: a scale, or a swatch for each class; [] for an image."""
    from orograph.dem.handles import HANDLES
    from orograph.geovis.laying import Laid

    laid = Laid.open(layer.content, grid)
    table, (low, high) = laid.bands.table, laid.bands.span
    if laid.bands.palette is not None:
        return _of_colour_table(laid)
    if table is None:
        return []
    if laid.bands.classes or (isinstance(layer.colormap, Table) and layer.colormap.classes):
        there = np.flatnonzero(table[:, 3]) if table.shape[1] == 4 else np.arange(len(table))
        return [(layer.title, None), *((str(round(low + k)), table[k, :3]) for k in there[:MOST_CLASSES])]
    with HANDLES.borrow(laid.location) as file:
        band = laid.bands.colors[0] - 1
        unit, called = (file.units[band] or "").strip(), (file.descriptions[band] or "").strip()
    beyond = layer.range is None and getattr(layer.colormap, "span", None) is None  # (the ends are percentiles)
    return Scale(low, high, table[:, :3], written_unit(unit), layer.name or called or layer.title, beyond, beyond)


def _of_colour_table(laid: Laid) -> list[tuple[str, Any]]:
    """Swatches of the commonest classes of a raster with a colour table; [] if its numbers only stand for colours: they
    have no names, and no gaps, or are many."""
    from orograph.dem.handles import HANDLES
    from orograph.geovis.data.attribute_table import named_beside
    from orograph.geovis.data.classes import MOST, ClassTable

    colors, band = laid.bands.palette, laid.bands.colors[0]
    with HANDLES.borrow(laid.location) as file:
        codes, tags = laid.bands.coded(file, laid.area), file.tags(band)
    names = ClassTable.of_tags(tags, None, named_beside(laid.location, band)).names
    gaps = len(codes) > 1 and max(codes) - min(codes) >= len(codes)
    if colors is None or len(codes) > MOST or not (gaps or any(code in names for code in codes)):
        return []
    there = sorted(codes[:MOST_CLASSES])
    return [(laid.layer.title, None), *((names.get(k, str(k)), colors[k, :3]) for k in there)]


def _crs_name(crs: Any) -> str | None:
    """A label for a CRS: its name, else its projection's and its origin; None if neither is known."""
    if crs is None:
        return None
    method = crs.coordinate_operation.method_name if crs.coordinate_operation is not None else ""
    if method and crs.is_projected:
        method += _center(crs)
    if method.lower().startswith(NAMELESS):
        method = ""
    return name_of(crs) or method or None


def _center(crs: Any) -> str:
    """ ", 9.5° E" or ", 47° N 9.5° E": the origin of a projection's longitudes and, if it has one, latitudes."""
    found = {"Latitude": "", "Longitude": ""}
    for param in crs.coordinate_operation.params:
        for kind, (plus, minus) in (("Latitude", "NS"), ("Longitude", "EW")):
            if param.name.startswith(f"{kind} of") and ("origin" in param.name or "center" in param.name):
                degrees = math.degrees(param.value * param.unit_conversion_factor)
                found[kind] = f"{abs(round(degrees, 2)):g}° {plus if degrees >= 0 else minus}"
    if found["Latitude"].startswith("0°"):
        found["Latitude"] = ""
    told = " ".join(text for text in found.values() if text)
    return f", {told}" if told else ""


def _factors(scene: Scene) -> Any:
    """The projection's distortions (``pyproj`` factors) at the target; None if the CRS has none."""
    crs = scene.terrain.grid.crs
    if crs is None or not crs.is_projected:
        return None
    from pyproj import Proj
    from pyproj.exceptions import ProjError

    try:
        projection = Proj(crs)
        lon, lat = projection(scene.view.target[0], scene.view.target[1], inverse=True)
        return projection.get_factors(lon, lat)
    except ProjError:
        return None


def convergence(scene: Scene) -> float:
    """Degrees between true north and grid north at the target; 0 if unknown."""
    found = _factors(scene)
    angle = 0.0 if found is None else float(found.meridian_convergence)
    return angle if math.isfinite(angle) else 0.0


def stretch(scene: Scene) -> float:
    """Metres of the grid per metre on the ground at the target: 2 at 60° N in Web Mercator."""
    found = _factors(scene)
    area = 1.0 if found is None else float(found.areal_scale)
    return math.sqrt(area) if math.isfinite(area) and area > 0 else 1.0


def _title(name: str) -> str:
    return name.replace("_", " ").strip()


def north_on_screen(scene: Scene) -> float | None:
    """Direction of grid north at the target, degrees clockwise from the picture's up; None if it points at the eye."""
    view: Any = scene.view
    here = np.array(view.target)
    step = max(view.distance * 1e-4, 1e-3)
    (a, b), _ = view.project(np.stack([here, here + np.array([0.0, step, 0.0])]), scene.surface.exaggeration)
    dx, dy = b - a
    if not (math.isfinite(dx) and math.isfinite(dy)) or math.hypot(dx, dy) < 1e-6:
        return None
    return math.degrees(math.atan2(dx, -dy))


def _turned(scene: Scene) -> Any:
    """The view's axes, if a cube should show them."""
    aids = scene.annotations.aids
    if aids is None or not aids.icon or scene.view.projection != "perspective":
        return None
    return scene.view.axes(scene.surface.exaggeration)


def _scale(scene: Scene, drawn: Drawn) -> float | None:
    """Metres per pixel: everywhere in a plan, at the ground nearest the picture's middle in perspective; None if depths
    differ so much (see ``ONE_SCALE``) that one scale would mislead."""
    view = scene.view
    if view.projection == "plan":
        return view.pixel_metres
    seen = np.flatnonzero(np.isfinite(drawn.column))
    if len(seen) == 0 or len(drawn.depths) == 0:
        return None
    near, far = np.percentile(drawn.depths, [1, 99])
    if far > ONE_SCALE * near:
        return None
    middle = seen[np.argmin(np.abs(seen - view.height // 2))]
    return float(drawn.column[middle]) * view.pixel_slope
