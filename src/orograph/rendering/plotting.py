"""Pictures in matplotlib, xarray and notebooks: on axes with their extent, as a Dataset, in a cell."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from orograph.errors import UsageError

if TYPE_CHECKING:
    import xarray as xr

    from orograph.rendering.picture import Picture

DPI = 100
"""Pixels of a picture per inch of a new figure."""


def show(picture: Picture) -> None:
    """Show a picture: in a notebook's cell, otherwise in the system's image viewer."""
    ipython = sys.modules.get("IPython")
    if ipython is not None and getattr(ipython.get_ipython(), "kernel", None) is not None:
        ipython.display.display(picture)
        return
    from PIL import Image

    Image.fromarray(picture.pixels).show()


def plot(picture: Picture, ax: Any = None, **options: Any) -> Any:
    """Draw a picture on axes: a plan at its position, rotated if it is; a perspective by its pixels, without ticks.

    Args:
        ax: matplotlib's axes, or cartopy's ``GeoAxes``, which transform a plan to their projection; None: new ones.
        options: for ``Axes.imshow``.

    Returns: the ``AxesImage``.

    Raises:
        UsageError: matplotlib is not installed, or ``ax`` is no axes.
    """
    pyplot = _matplotlib()
    if ax is not None and not hasattr(ax, "imshow"):
        raise UsageError(
            f"A picture is drawn on axes, not on a {type(ax).__name__}.",
            remedy="Those of a figure are figure.subplots(), and pyplot.subplots() returns both.",
        )
    height, width = picture.pixels.shape[:2]
    if ax is None:
        _, ax = pyplot.subplots(figsize=(width / DPI, height / DPI), layout="constrained")
    options = {"interpolation": "antialiased", **options}
    grid = picture.grid
    if grid is None:
        image = ax.imshow(picture.pixels, **options)
        ax.set_axis_off()
        return image
    west, south, east, north = grid.bounds()
    a, b, _, d, e, _ = grid.transform[:6]
    if _is_geo(ax):
        if b or d:
            raise UsageError("A rotated plan cannot be transformed to a map's projection.", remedy="Draw it north up.")
        if not ax.has_data():  # else cartopy brings it to a picture of the globe
            ax.set_extent((west, east, south, north), crs=_projection(ax, grid.crs))
        return ax.imshow(
            picture.pixels, extent=(west, east, south, north), origin="upper", transform=_projection(ax, grid.crs),
            **options,
        )  # fmt: skip
    if b or d or a < 0 or e > 0:
        from matplotlib.transforms import Affine2D

        c, f = grid.transform.c, grid.transform.f
        turned = Affine2D(np.array([[a, b, c], [d, e, f], [0.0, 0.0, 1.0]])) + ax.transData
        image = ax.imshow(picture.pixels, extent=(0, width, height, 0), transform=turned, **options)
        ax.set_xlim(west, east)
        ax.set_ylim(south, north)
    else:
        image = ax.imshow(picture.pixels, extent=(west, east, south, north), origin="upper", **options)
    ax.set_aspect("equal")
    ax.ticklabel_format(style="plain", useOffset=False)
    ax.set_xlabel("easting (m)")
    ax.set_ylabel("northing (m)")
    return image


def colorbar(picture: Picture, ax: Any = None, **options: Any) -> Any:
    """A colour bar of heights beside axes.

    Args:
        ax: the axes; None: the current ones.
        options: for ``Figure.colorbar``.

    Raises:
        UsageError: the picture does not know its colours of heights, or matplotlib is not installed.
    """
    if picture.tint is None:
        raise UsageError("This picture does not know its colours of heights.")
    pyplot = _matplotlib()
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    from orograph.geovis.color import linear_to_srgb

    low, high, table = picture.tint.scale()
    colors = ScalarMappable(Normalize(low, high), ListedColormap(linear_to_srgb(table)))
    beyond = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    ax = pyplot.gca() if ax is None else ax
    told = {"label": "height (m)", "extend": beyond[picture.tint.below, picture.tint.above], **options}
    return ax.figure.colorbar(colors, ax=ax, **told)


def to_xarray(picture: Picture) -> xr.Dataset:
    """A picture as a Dataset.

    Variables: ``pixels`` (y, x, band) uint8; ``depth`` (y, x) float32, metres along the viewing direction; and what
    each pixel shows: ``easting``, ``northing`` (float64, in the terrain's CRS) and ``height`` (float32, true metres);
    NaN where there is no ground. The coordinates ``y`` and ``x`` are those of a plan that is not turned, in its CRS;
    else rows and columns of the picture, at pixel centres.
    """
    import xarray as xr

    grid, (height, width) = picture.grid, picture.depth.shape
    straight = grid is not None and not (grid.transform.b or grid.transform.d)
    if grid is not None and straight:
        x, y = grid.xy(np.arange(width), 0)[0], grid.xy(0, np.arange(height))[1]
    else:
        x, y = (np.arange(count, dtype=np.float64) + 0.5 for count in (width, height))
    units = {"units": "m" if straight else "pixels"}
    places, flat = picture.places(), ("y", "x")
    made = xr.Dataset(
        {
            "pixels": (("y", "x", "band"), picture.pixels),
            "depth": (flat, picture.depth, {"units": "m", "long_name": "depth along the viewing direction"}),
            "easting": (flat, places[..., 0], {"units": "m"}),
            "northing": (flat, places[..., 1], {"units": "m"}),
            "height": (flat, places[..., 2].astype(np.float32), {"units": "m", "long_name": "height of the ground"}),
        },
        {"y": ("y", y, units), "x": ("x", x, units), "band": ["red", "green", "blue"]},
    )
    if picture.crs is not None:
        wkt = picture.crs.to_wkt()
        made = made.assign_coords(spatial_ref=((), 0, {"crs_wkt": wkt, "spatial_ref": wkt}))
    return made


def _matplotlib() -> Any:
    try:
        import matplotlib.pyplot as pyplot
    except ImportError as error:
        raise UsageError(
            "Plotting needs matplotlib, which is not installed.", remedy="pip install matplotlib"
        ) from error
    return pyplot


def _is_geo(ax: Any) -> bool:
    """Whether axes are cartopy's."""
    return any(kind.__module__.startswith("cartopy.") for kind in type(ax).__mro__)


def _projection(ax: Any, crs: Any) -> Any:
    """A picture's CRS for cartopy; that of the axes if they are the same."""
    if crs is None:
        raise UsageError("The picture has no CRS, but a map's axes need one.", remedy="Give the terrain's: crs=…")
    if crs == ax.projection:
        return ax.projection
    from cartopy.crs import Projection

    return Projection(crs)
