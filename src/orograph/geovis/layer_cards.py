"""What a layer says of itself in a notebook: its file, its options and a small picture."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from affine import Affine
from rasterio.errors import RasterioError

from orograph.cards import SIDE, Row, card, extent_rows, png
from orograph.dem.handles import HANDLES
from orograph.errors import OrographError
from orograph.geovis.basemaps import PREFIX
from orograph.geovis.imagery import MANY, Bands, Bytes, ImageWindow, read_into
from orograph.geovis.placement import grid_of

if TYPE_CHECKING:
    from orograph.geovis.layers import Layer


def card_of(layer: Layer) -> str:
    """The card as HTML. A file that cannot be read is said to be so; a tile service is not asked for a picture."""
    rows: list[Row] = [("file", "(in memory)" if layer.held is not None else layer.path)]
    picture = None
    if not layer.path.startswith(PREFIX):
        try:
            extent, picture = _looked_at(layer)
            rows += extent
        except OrographError as error:
            rows.append(("problem", error.what))
        except (RasterioError, OSError) as error:
            rows.append(("problem", f"It cannot be read: {error}"))
    rows += [(name, str(value)) for name, value in layer.to_dict().items() if name not in ("path", "name")]
    rows += [("credit", text) for text in layer.attribution]
    return card("Layer", layer.label, rows, picture)


def _looked_at(layer: Layer) -> tuple[list[Row], bytes | None]:
    """The rows about a file's extent, and its picture as a PNG; None if much would have to be read for it."""
    with HANDLES.borrow(layer.location) as file:
        grid = grid_of(file)
        (_, size), *place = extent_rows(grid)
        rows = [("pixels", size), *([] if grid.transform == Affine.identity() else place)]
        height, width = file.shape
        bands = Bands.of(file, layer)
        if height * width > MANY * max(bands.factors(file), default=1) ** 2:
            return rows, None
        step = 1 << max(0, math.ceil(math.log2(max(height, width) / SIDE)))
        whole = ImageWindow(0, height, 0, width, step)
        bands = bands.spanned(file, layer, whole)
    pixels: Bytes = np.empty((*whole.shape, 4), np.uint8)
    read_into(pixels, layer.location, whole, bands)
    return rows, png(pixels)
