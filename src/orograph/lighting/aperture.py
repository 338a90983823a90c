"""Ambient aperture lighting: the sky that each sample sees as one spherical cap, and light through such caps.

Oat & Sander 2007, "Ambient aperture lighting", I3D. *Precomputed*: for every sample, the visible sky (above the horizon
and above the ground's own plane) is replaced by a cap, whose direction is the mean of the visible directions and whose
solid angle is theirs, so that cos(radius) = 1 − Ω / 2π. *Then*, for any lights, however they move: a sun is a disc, so
its visible part is the overlap of two caps (``caps``): all, nothing, or a smoothstep in between (or the exact lens),
and the cosine of incidence is taken in the middle of the overlap. Point lights are visible inside the cap and hidden
outside. The sky is an area light over the whole hemisphere: through a cap it gives sin²(radius) ⟨n, c⟩ of what level
open ground receives (exact for a cap above the ground's plane), minus the part that suns cover.

Bands of the product: ``east``, ``north``, ``up`` (a unit vector), ``radius`` (degrees). If nothing is visible, the
radius is 0 and the direction up. Caps come from ``azimuths`` horizons or from ``rays``, spread evenly over the upper
hemisphere. One cap cannot express which side of a valley is open and how far down; see the manual for the errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.lighting.arrays import context_of
from orograph.lighting.caps import cap_area
from orograph.lighting.context import Blocks, Context, Options, Values
from orograph.lighting.gather import Sweep, Window, by_azimuth
from orograph.lighting.occlusion import Method, Neighbourhood, by_blocks, flat_only, lift
from orograph.lighting.products import Product, compute
from orograph.lighting.sun import Sun
from orograph.lighting.sweep_lines import direction
from orograph.parallel import map_ordered

if TYPE_CHECKING:
    from orograph.lighting.aperture_kernels import LightTables

Array = NDArray[np.float64]
Color = tuple[float, float, float]

BANDS = ["east", "north", "up", "radius"]
_SHARE = 1 << 14


@dataclass(frozen=True, slots=True)
class Lamp:
    """A point of light.

    Attributes:
        col, row: its place in sample coordinates. height: metres, in the terrain's datum.
        colour: its irradiance at a distance of one metre.
    """

    col: float
    row: float
    height: float
    color: Color = (1.0, 1.0, 1.0)

    @classmethod
    def at(cls, grid: Grid, x: float, y: float, height: float, reach: float, color: Color = (1.0, 1.0, 1.0)) -> Lamp:
        """A lamp at a place of the grid's CRS that gives ``color`` on a surface facing it, ``reach`` metres away.

        (1, 1, 1) is about the sun at 45°. At half the distance it gives four times as much.

        Raises:
            UsageError: the reach is not a positive number of metres.
        """
        if not 0 < reach < math.inf:
            raise UsageError(f"A lamp's reach must be a positive number of metres, not {reach:g}.")
        col, row = grid.index(x, y)
        red, green, blue = (c * reach * reach for c in color)
        return cls(float(col), float(row), float(height), (red, green, blue))


@dataclass(frozen=True, slots=True)
class Lights:
    """All light sources of a terrain.

    Attributes:
        suns: discs, with the irradiance of a surface that faces the whole disc.
        lamps: points.
        ambient: irradiance of level ground by the whole sky.
    """

    suns: Sequence[tuple[Sun, Color]] = ()
    lamps: Sequence[Lamp] = ()
    ambient: Color = (0.0, 0.0, 0.0)

    def tables(self, linear: Array) -> LightTables:
        """The lights in the form of kernels."""
        from orograph.lighting.aperture_kernels import LightTables

        suns, lamps = np.zeros((len(self.suns), 10)), np.zeros((len(self.lamps), 6))
        for row, (sun, color) in zip(suns, self.suns):
            radius = math.radians(sun.diameter / 2)
            row[:] = *sun.direction, radius, math.cos(radius), math.sin(radius), cap_area(radius), *color
        for row, lamp in zip(lamps, self.lamps):
            row[:] = *(linear @ [lamp.col, lamp.row]), lamp.height, *lamp.color
        return LightTables(suns, lamps, np.array(self.ambient, np.float64))


def _caps(moments: Values, missing: NDArray[np.bool_]) -> Values:
    """∫ ω dω and ∫ dω (4, rows, cols) → direction and radius in degrees."""
    m = moments.astype(np.float64)
    length = np.sqrt((m[:3] ** 2).sum(0))
    seen = length > 1e-9
    with np.errstate(invalid="ignore", divide="ignore"):
        out = np.where(seen, m[:3] / length, np.array([0.0, 0.0, 1.0])[:, None, None])
    radius = np.degrees(np.arccos(np.clip(1.0 - np.where(seen, m[3], 0.0) / (2 * math.pi), 0.0, 1.0)))
    out = np.concatenate([out, radius[None]])
    out[:, missing] = np.nan
    return out.astype(np.float32)


def make(context: Context) -> Blocks | Sweep:
    """The product: ``method`` ("horizon" or "rays") and ``seed`` among the other options."""
    options = context.options
    check(options)
    if options.more.get("method", "horizon") == "rays":
        return _rays(context, options.rays, int(options.more.get("seed", 0)))
    return _horizons(context)


def check(options: Options) -> None:
    """Raise UsageError if the method, rays and curvature in the options do not fit together."""
    method: Method = options.more.get("method", "horizon")
    if method not in ("horizon", "rays"):
        raise UsageError(f"There is no method {method!r} for apertures; the methods are horizon and rays.")
    if method == "rays":
        flat_only(options)
        if options.rays < 1:
            raise UsageError(f"At least one ray is needed, not {options.rays}.")


def _horizons(context: Context) -> Sweep:
    from orograph.lighting.aperture_kernels import add_moments

    fan = context.options.directions()
    width = 2 * math.pi / len(fan)

    def add(out: Values, slopes: Values, gx: Values, gy: Values, row0: int, col0: int, index: int) -> None:
        add_moments(slopes, gx, gy, *direction(fan[index]), width, row0, col0, out)

    def finish(canvas: Values, window: Window) -> Values:
        moments = canvas[:, window[0] : window[1], window[2] : window[3]]
        return _caps(moments, np.isnan(moments[3]))

    return Sweep(fan, 4, by_azimuth(context, add), finish)


def _rays(context: Context, rays: int, seed: int) -> Blocks:
    from orograph.lighting.occlusion_kernels import ray_cone

    radius = context.options.radius or math.inf

    def work(near: Neighbourhood) -> Values:
        samples = near.samples(lift(context))
        out = np.zeros((4, *samples.heights.shape))
        ray_cone(near.scene(), samples, radius, rays, seed, out)
        return _caps(out.astype(np.float32), np.isnan(samples.heights))

    return by_blocks(context, radius, work, "Casting rays to the sky", "aperture")


def aperture(
    heights: ArrayLike,
    linear: ArrayLike,
    *,
    method: Method = "horizon",
    azimuths: int = 32,
    rays: int = 1024,
    seed: int = 0,
    jobs: int | None = None,
) -> Values:
    """The cap of visible sky of every sample.

    Args:
        heights: (rows, cols), metres, NaN where missing.
        linear: (2, 2) linear part of the geotransform: metres east and north per column and per row.
        method: "horizon" (``azimuths`` of them) or "rays" (``rays`` per sample, chosen by ``seed``).
        jobs: threads; None: all processors. The result does not depend on it.

    Returns:
        (4, rows, cols) float32: direction east, north, up, and radius in degrees; NaN where heights are.

    Raises:
        UsageError: wrong shapes, degenerate cells, an unknown method.
    """
    options = Options(azimuths, rays=rays, more={"method": method, "seed": seed})
    return compute(context_of(heights, linear, options, jobs=jobs), "aperture")


def field(caps: Values) -> Values:
    """Caps (4, rows, cols) of the product → (rows, cols, 4) with the cosine of the radius, as kernels take them."""
    out = np.ascontiguousarray(np.moveaxis(caps, 0, -1))
    out[..., 3] = np.cos(np.radians(out[..., 3]))
    return out


class CapField(NamedTuple):
    """Caps of visible sky on a grid of samples; light is interpolated between them.

    Attributes:
        values: (rows, cols, 4) float32: direction east, north, up, and the cosine of the radius; NaN: missing.
        linear: (2, 2) metres east and north per column and per row of the terrain.
        scale: columns and rows of the terrain between caps; (row0, col0): the first, counted in such steps.
    """

    values: Values
    linear: Array
    scale: float = 1.0
    row0: float = 0.0
    col0: float = 0.0

    @classmethod
    def of(cls, caps: Values, linear: ArrayLike) -> CapField:
        """One cap per sample, from (4, rows, cols) of the product, with the radius in degrees."""
        return cls(field(caps), np.asarray(linear, np.float64))


def light(
    caps: CapField, points: Array, gradient: Array, lights: Lights, *, exact: bool = False, jobs: int | None = None
) -> Values:
    """Light on points of the ground through the caps of a field, interpolated between its samples.

    Args:
        points: (n, 3) float64: column and row of the terrain, metres.
        gradient: (n, 2) float64: rise per metre east and north.
        exact: the overlap of caps in closed form, instead of a smoothstep.
        jobs: threads; None: all processors.

    Returns:
        (n, 3) float32, in the unit of the lights' colours; NaN where points are.
    """
    from orograph.lighting.aperture_kernels import light_hits

    tables = lights.tables(caps.linear)
    out = np.full((len(points), 3), np.nan, np.float32)

    def share(first: int) -> None:
        last = min(first + _SHARE, len(points))
        light_hits(points, gradient, caps, tables, exact, first, last, out)

    for _ in map_ordered(share, range(0, len(points), _SHARE), jobs):
        pass
    return out


def shade(
    caps: Values, heights: ArrayLike, linear: ArrayLike, lights: Lights, *, exact: bool = False, jobs: int | None = None
) -> Values:
    """Light on every sample of a raster through its own cap.

    Args:
        caps: (4, rows, cols), from ``aperture``. heights, linear: as there.

    Returns:
        (rows, cols, 3) float32; NaN where heights are.
    """
    from orograph.lighting.normal import gradient

    surface = np.ascontiguousarray(heights, np.float32)
    rows, cols = surface.shape
    gx, gy = gradient(surface, linear, jobs)
    row, col = np.indices(surface.shape, np.float64)
    points = np.stack([np.where(np.isnan(surface), np.nan, col), row, surface.astype(np.float64)], axis=-1)
    slopes = np.stack([gx, gy], axis=-1).astype(np.float64)
    seen = CapField.of(caps, linear)
    made = light(seen, points.reshape(-1, 3), slopes.reshape(-1, 2), lights, exact=exact, jobs=jobs)
    return made.reshape(rows, cols, 3)


PRODUCTS = [
    Product(
        "aperture",
        lambda options: BANDS,
        "1",
        "The sky that is seen as one cap: its direction (east, north, up) and its radius.",
        make,
        (-1.0, 1.0),
        lambda band, options: {"unit": "degrees", "byte": (0.0, 90.0)} if band == "radius" else {},
        check,
    )
]
