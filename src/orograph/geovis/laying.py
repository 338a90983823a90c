"""A layer's file over a terrain: where it lies, which part of it is needed, what its bands mean.

This is what every backend knows of a layer before it reads pixels. Units: pixels of the file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from orograph.dem.handles import HANDLES
from orograph.errors import ReadError
from orograph.geo.grid import Grid
from orograph.geovis.image_errors import unreadable
from orograph.geovis.imagery import Bands, ImageWindow
from orograph.geovis.layers import Layer
from orograph.geovis.placement import Lattice, Placement, extent, grid_of

LEAST = 64
"""At most this many texels along a side of the area at its coarsest level."""

OFF = 0.1
"""Image pixels: a larger position error is worth a warning."""


@dataclass(frozen=True, slots=True)
class Laid:
    """A layer over a terrain.

    Attributes:
        layer: what is shown. location: what GDAL opens.
        placement, lattice: where it lies.
        area: pixels of the file over the terrain with a margin for means; columns may lie beyond the borders of a file
            that goes once around the body.
        bands: how its values become colours.
        overviews: pixels along the side of a texel of each of the file's overviews.
        warnings: what a user should know, full sentences.
    """

    layer: Layer
    location: str
    placement: Placement
    lattice: Lattice
    area: ImageWindow
    bands: Bands
    overviews: tuple[int, ...]
    warnings: tuple[str, ...]

    @classmethod
    def open(cls, layer: Layer, grid: Grid) -> Laid:
        """Find a layer's place over a terrain with this grid.

        Raises:
            ReadError: the file is missing or damaged, or does not overlap the terrain.
            UsageError: its CRS cannot be reached from the terrain's.
        """
        from rasterio.errors import RasterioError

        name = layer.path if layer.held is None else layer.label
        location = layer.location
        warnings: list[str] = []
        with HANDLES.borrow(location) as file:
            image = grid_of(file)
            bands = Bands.of(file, layer)
            overviews = tuple(bands.factors(file))
        placement = Placement.of(grid, image, name, warnings)
        if placement.stretched and layer.held is not None:
            warnings.clear()  # an array without a place is meant to span the terrain
        lattice = Lattice.over(placement)
        bounds = lattice.bounds()
        area = None if bounds is None else _window(placement, bounds)
        if area is None:
            raise ReadError(
                f"The image does not overlap the terrain: it covers {extent(placement.image)}, and the terrain "
                f"{extent(grid)}.",
                path=name,
                remedy="Name an image of the same area, or fix its georeference (gdal_edit.py).",
            )
        if lattice.error > OFF:
            warnings.append(f"{name} may lie up to {lattice.error:.1f} of its pixels off.")
        try:
            with HANDLES.borrow(location) as file:
                bands = bands.spanned(file, layer, area)
        except (RasterioError, OSError) as error:
            raise unreadable(location, error) from None
        if bands.classes:
            warnings.append(
                f"{name} has {len(bands.classes)} distinct values and no colours, so they are drawn as classes. With "
                "colormap=grey they are greys."
            )
        return cls(layer, location, placement, lattice, area, bands, overviews, tuple(warnings))

    def aligned(self) -> tuple[ImageWindow, int]:
        """The area in whole texels of its coarsest level, and that level: all levels of means are then in register
        with the file's corner, as its overviews are, whoever holds them."""
        area, image = self.area, self.placement.image
        top = max(0, math.ceil(math.log2(max(area.row1 - area.row0, area.col1 - area.col0) / LEAST)))
        grain = 1 << top
        row0, col0 = area.row0 // grain * grain, area.col0 // grain * grain
        row1, col1 = min(-(-area.row1 // grain) * grain, image.rows), -(-area.col1 // grain) * grain
        return ImageWindow(row0, row1, col0, col1 if self.cyclic else min(col1, image.cols)), top

    @property
    def cyclic(self) -> bool:
        """Whether its right border meets its left."""
        return self.placement.cyclic


def empty(path: str) -> ReadError:
    """The error for an image that has nothing to show."""
    return ReadError(
        "The image has no valid pixel over the terrain (all is masked, transparent or nodata).",
        path=path,
        remedy="Name an image that covers it.",
    )


def _window(placement: Placement, bounds: tuple[float, float, float, float]) -> ImageWindow | None:
    """Pixels of the image around ``bounds`` with a margin for its means; None if there are none."""
    rows, cols = placement.image.shape
    u0, u1, v0, v1 = bounds
    if v1 <= 0 or v0 >= rows or not (placement.cyclic or (u1 > 0 and u0 < cols)):
        return None
    margin = 4 + 0.01 * max(u1 - u0, v1 - v0)
    row0, row1 = max(0, math.floor(v0 - margin)), min(rows, math.ceil(v1 + margin))
    col0, col1 = math.floor(u0 - margin), math.ceil(u1 + margin)
    if not placement.cyclic:
        return ImageWindow(row0, row1, max(0, col0), min(cols, col1))
    return ImageWindow(row0, row1, col0, min(col1, col0 + cols + 2 * math.ceil(margin)))
