"""An image file as colours at any scale: a pyramid of means, read tile by tile as it is asked for.

Level k is the image reduced 2^k times by box means (Williams 1983, *Pyramidal parametrics*), taken in linear light and
weighted by opacity, so that neither dark lines nor transparent borders bleed. Overviews of the file are used where they
have the factor wanted; else a tile is the mean of four finer ones. Tiles are kept up to a budget of bytes. Bands: red,
green and blue by their names or the first three; a palette through its colours; one band as grey. What is not 8 bits is
stretched between its 2nd and 98th percentile. Missing pixels (alpha, mask, nodata) are transparent. Units: pixels.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.dem.handles import HANDLES, cause_of, locate
from orograph.errors import ReadError
from orograph.geovis.colour import srgb_to_linear

Pixels = NDArray[np.uint8]

TILE = 512
"""Pixels a side of what is read at once."""

LINEAR = srgb_to_linear(np.arange(256) / 255.0)
"""sRGB byte → linear light, (256,) float32."""

_BYTE_OF = np.searchsorted((LINEAR[1:] + LINEAR[:-1]) / 2, np.arange(4097) / 4096).astype(np.uint8)
"""Linear light in 4096 steps → the nearest sRGB byte."""


class Image:
    """A readable image. All methods may be called from any thread.

    Attributes:
        path: the file. shape: (rows, cols) of level 0. levels: of the pyramid; the last is one pixel.
        transform, crs: as the file has them (rasterio's); crs None and the identity where it has none.
    """

    def __init__(self, path: str | os.PathLike[str], max_bytes: int = 256 << 20) -> None:
        """Read the header.

        Raises:
            ReadError: GDAL cannot open the file, or its pixels are complex numbers.
        """
        self.path = os.fspath(path)
        self._location = locate(path)
        self._budget = max(max_bytes, 4 * TILE * TILE * 4)
        self._tiles: OrderedDict[tuple[int, int, int], Pixels] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()
        self._reading = threading.RLock()
        with HANDLES.borrow(self._location) as dataset:
            self.shape: tuple[int, int] = dataset.shape
            self.transform, self.crs = dataset.transform, dataset.crs
            self._bands, self._palette = _bands(dataset)
            if np.dtype(dataset.dtypes[0]).kind not in "uif":
                raise ReadError(f"Pixels of type {dataset.dtypes[0]} are no colours.", path=self.path)
            # Overviews of a palette are picked, not averaged, pixels: they would sparkle.
            overviews = [] if self._palette is not None else dataset.overviews(self._bands[0])
            self._overviews = {n.bit_length() - 1 for n in overviews if n & (n - 1) == 0}
            self._stretch = self._percentiles(dataset)
        self.levels = (max(self.shape) - 1).bit_length() + 1

    def size(self, level: int) -> tuple[int, int]:
        """(rows, cols) of a level."""
        return -(-self.shape[0] >> level), -(-self.shape[1] >> level)

    def window(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Pixels:
        """Pixels of a level, (rows, cols, 4) uint8: sRGB and opacity. The window lies within the level.

        Raises:
            ReadError: the file is damaged.
        """
        out = np.empty((row1 - row0, col1 - col0, 4), np.uint8)
        for i in range(row0 // TILE, -(-row1 // TILE)):
            for j in range(col0 // TILE, -(-col1 // TILE)):
                tile = self._tile(level, i, j)
                top, left = i * TILE, j * TILE
                a, b = max(row0, top), min(row1, top + TILE)
                c, d = max(col0, left), min(col1, left + TILE)
                out[a - row0 : b - row0, c - col0 : d - col0] = tile[a - top : b - top, c - left : d - left]
        return out

    def _tile(self, level: int, i: int, j: int) -> Pixels:
        key = (level, i, j)
        with self._lock:
            if key in self._tiles:
                self._tiles.move_to_end(key)
                return self._tiles[key]
        with self._reading:  # one thread reads; who waited finds the tile there
            with self._lock:
                if key in self._tiles:
                    return self._tiles[key]
            tile = self._read(level, i, j) if level == 0 or level in self._overviews else self._mean(level, i, j)
            with self._lock:
                self._tiles[key] = tile
                self._bytes += tile.nbytes
                while self._bytes > self._budget and len(self._tiles) > 1:
                    self._bytes -= self._tiles.popitem(last=False)[1].nbytes
        return tile

    def _mean(self, level: int, i: int, j: int) -> Pixels:
        """A tile from the finer level: means of two by two pixels."""
        rows, cols = self.size(level - 1)
        row0, col0 = 2 * i * TILE, 2 * j * TILE
        fine = self.window(level - 1, row0, min(row0 + 2 * TILE, rows), col0, min(col0 + 2 * TILE, cols))
        fine = np.pad(fine, ((0, fine.shape[0] % 2), (0, fine.shape[1] % 2), (0, 0)), mode="edge")
        quarters = [fine[a::2, b::2] for a in (0, 1) for b in (0, 1)]
        opacity = sum(q[..., 3].astype(np.float32) for q in quarters)
        light = sum(LINEAR[q[..., :3]] * q[..., 3:].astype(np.float32) for q in quarters)
        mean = light / np.maximum(opacity, 1)[..., None]
        out = np.empty((*mean.shape[:2], 4), np.uint8)
        out[..., :3] = _BYTE_OF[np.round(mean * 4096).astype(np.int64)]
        out[..., 3] = np.round(opacity / 4)
        return out

    def _read(self, level: int, i: int, j: int) -> Pixels:
        """A tile straight from the file, or from its overview of just this factor."""
        import rasterio
        from rasterio.windows import Window

        rows, cols = self.size(level)
        height, width = min(TILE, rows - i * TILE), min(TILE, cols - j * TILE)
        top, left = i * TILE << level, j * TILE << level
        window = Window(left, top, min(width << level, self.shape[1] - left), min(height << level, self.shape[0] - top))
        try:
            with HANDLES.borrow(self._location) as dataset:
                bands = dataset.read(self._bands, window=window, out_shape=(len(self._bands), height, width))
                opacity = dataset.dataset_mask(window=window, out_shape=(height, width))
        except (rasterio.errors.RasterioError, OSError, ValueError) as error:
            raise ReadError(
                f"The image cannot be read: {cause_of(error)}", path=self.path, remedy="Fetch or write it again."
            ) from error
        out = np.empty((height, width, 4), np.uint8)
        if self._palette is not None:
            out[:] = self._palette[np.clip(bands[0], 0, len(self._palette) - 1)]
            out[..., 3] = np.minimum(out[..., 3], opacity)
            return out
        if self._stretch is not None:
            low, high = self._stretch
            values = (bands.astype(np.float32) - low) * np.float32(255 / (high - low))
            opacity = np.where(np.isfinite(values).all(0), opacity, 0)
            bands = np.clip(np.nan_to_num(values), 0, 255).round().astype(np.uint8)
        out[..., :3] = np.moveaxis(bands, 0, -1)
        out[..., 3] = opacity
        return out

    def _percentiles(self, dataset: Any) -> tuple[float, float] | None:
        """The values that become black and white, None for 8 bits and palettes."""
        if self._palette is not None or dataset.dtypes[self._bands[0] - 1] == "uint8":
            return None
        shape = tuple(min(n, 512) for n in dataset.shape)
        bands = dataset.read(self._bands, out_shape=(len(self._bands), *shape)).astype(np.float64)
        seen = bands[:, dataset.dataset_mask(out_shape=shape) > 0]
        seen = seen[np.isfinite(seen)]
        low, high = np.percentile(seen, [2, 98]) if seen.size else (0.0, 1.0)
        return float(low), float(high) if high > low else float(low) + 1


def _bands(dataset: Any) -> tuple[list[int], Pixels | None]:
    """The bands (from 1) that are red, green and blue, or the one that is grey or an index into the palette."""
    from rasterio.enums import ColorInterp

    meaning = list(dataset.colorinterp)
    named = [meaning.index(c) + 1 for c in (ColorInterp.red, ColorInterp.green, ColorInterp.blue) if c in meaning]
    if len(named) == 3:
        return named, None
    if dataset.count >= 3:
        return [1, 2, 3], None
    if meaning[0] == ColorInterp.palette:
        colours = dataset.colormap(1)
        table = np.zeros((max(colours) + 1, 4), np.uint8)
        for index, colour in colours.items():
            table[index] = colour
        return [1], table
    return [1], None
