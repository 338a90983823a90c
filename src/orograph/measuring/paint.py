"""A viewshed as an image to lay over the terrain: seen and hidden ground in colours that let the relief through.

The image has one texel per sample (means of whole blocks of samples if it would be too large), red, green, blue and
opacity, and lies on the viewshed's own grid, so that ``render(..., layers=path)`` puts it in the right place.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.dem.writing import raster_file
from orograph.geo.grid import compose
from orograph.measuring.viewshed import Viewshed
from orograph.output import check_folder

Values = NDArray[np.float32]
SEEN, HIDDEN = (255, 176, 0, 165), (38, 44, 74, 120)
"""Red, green, blue and opacity: visible ground looks lit, hidden ground dark."""
MOST = 36_000_000
"""Maximum texels of the image."""


def save_paint(shed: Viewshed, blocks: Iterable[tuple[int, int, Values]], path: str | os.PathLike[str]) -> None:
    """Write a GeoTIFF of red, green, blue, opacity.

    Args:
        blocks: of the viewshed, in any order (``Viewshed.blocks``).

    Raises:
        OutputError: it cannot be written.
    """
    import rasterio

    rows, cols = shed.grid.shape
    step = 1
    while (rows // step) * (cols // step) > MOST:
        step *= 2  # blocks begin at multiples of 256
    image = np.zeros((4, -(-rows // step), -(-cols // step)), np.uint8)
    palette = np.array([(0, 0, 0, 0), HIDDEN, SEEN], np.float32)
    palette[:, :3] *= palette[:, 3:] / 255.0  # means of colours times opacity
    for row, col, values in blocks:
        code = np.where(np.isnan(values), 0, 1 + (values <= 0 if shed.heights else values > 0))
        part = palette[code]
        if step > 1:
            part = np.pad(part, ((0, -part.shape[0] % step), (0, -part.shape[1] % step), (0, 0)), mode="edge")
            part = part.reshape(part.shape[0] // step, step, part.shape[1] // step, step, 4).mean(axis=(1, 3))
        part[..., :3] *= 255.0 / np.maximum(part[..., 3:], 1e-6)
        r, c = row // step, col // step
        image[:, r : r + part.shape[0], c : c + part.shape[1]] = np.round(part).astype(np.uint8).transpose(2, 0, 1)
    out = Path(path)
    check_folder(out)
    transform = compose(shed.grid.transform, Affine.scale(step))
    with raster_file(out) as part_file, rasterio.open(
        part_file, "w", driver="GTiff", height=image.shape[1], width=image.shape[2], count=4, dtype="uint8",
        crs=None if shed.grid.crs is None else shed.grid.crs.to_wkt(), transform=transform, compress="deflate",
        tiled=True, photometric="RGB", alpha="non-premultiplied",
    ) as file:  # fmt: skip
        file.write(image)
