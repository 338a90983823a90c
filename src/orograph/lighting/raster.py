"""Rasters of light: canvases during their making, in memory or in a scratch file, and GeoTIFFs when done.

A canvas as large as the terrain is kept in memory if it fits the limit; otherwise it is a file in the temporary folder,
mapped into memory, whose pages are released after each block. The file has no name once it is open, so nothing is left
of it however the process ends.
"""

from __future__ import annotations

import ctypes
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orograph.dem.writing import check_written, raster_file, write_cog
from orograph.folders import scratch
from orograph.geo.grid import Grid
from orograph.output import check_folder, check_room, remove
from orograph.parallel import threads_for
from orograph.progress import SILENT, Progress

Values = NDArray[np.float32]

_GDAL_CACHE = 1 << 20
"""Bytes of GDAL's block cache while a file is written: its blocks are written once, so nothing needs to wait there."""
_LEVEL = 4
"""Compression level of DEFLATE: twice as fast as its default, 1 % larger."""
_HEADER, _PER_TILE = 1 << 12, 16
"""Approximate bytes of a plain TIFF in addition to its samples."""


class Canvas:
    """Bands of float32 as large as the terrain, zero to begin with.

    Args:
        bands, shape: how many, and their (rows, cols).
        on_disk: keep it in a scratch file.

    Attributes:
        values: (bands, rows, cols) float32.
        on_disk: whether it is a scratch file.

    Raises:
        OutputError: the temporary folder has no room.
    """

    def __init__(self, bands: int, shape: tuple[int, int], on_disk: bool = False) -> None:
        size = (bands, *shape)
        self.on_disk = on_disk
        self._release: Callable[[], None] | None = None
        self.values: Values
        if on_disk:
            space, self._release = scratch(4 * bands * shape[0] * shape[1])
            self.values = space.view(np.float32).reshape(size)
        else:
            self.values = np.zeros(size, np.float32)

    def release(self) -> None:
        """Release the memory of a canvas on disk; what was written stays."""
        if self._release is not None:
            self._release()


def trim() -> None:
    """Return free memory to the system.

    The C library would keep it: glibc does so with many arrays of up to 32 MiB, however much they take together.
    """
    if sys.platform == "linux":
        give_back = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if give_back is not None:
            give_back(0)


def rectangles(shape: tuple[int, int], height: int, width: int | None = None) -> Iterator[tuple[int, int, int, int]]:
    """Windows (row0, row1, col0, col1) that cover a raster, row by row, at most ``height`` × ``width`` samples."""
    rows, cols = shape
    width = cols if width is None else width
    for row in range(0, rows, height):
        for col in range(0, cols, width):
            yield row, min(row + height, rows), col, min(col + width, cols)


@dataclass(frozen=True, slots=True)
class Band:
    """The description of a band in a file.

    Attributes:
        name: its description.
        unit: of its values.
        doc: a sentence, in its tags.
        byte: the values that 8-bit files show as 1 and as 255.
        codes: what its values mean, if they are codes: names of 0 (missing), 1… 8-bit files show them as they are, and
            the tags of all files have them as CF's flags, by which ``--data`` knows classes.
        long_name: for legends, in its tags; "": none.
    """

    name: str
    unit: str
    doc: str
    byte: tuple[float, float] = (0.0, 1.0)
    codes: tuple[str, ...] = ()
    long_name: str = ""

    @property
    def scale(self) -> tuple[float, float]:
        """Scale and offset that convert an 8-bit file's bytes back."""
        if self.codes:
            return 1.0, 0.0
        step = (self.byte[1] - self.byte[0]) / 254.0
        return step, self.byte[0] - step

    @property
    def tags(self) -> dict[str, str]:
        """Its tags in a file."""
        texts = {"description": self.doc, **({"long_name": self.long_name} if self.long_name else {})}
        if not self.codes:
            return texts
        numbers = " ".join(map(str, range(len(self.codes))))
        names = " ".join(name.replace(" ", "_") for name in self.codes)
        return {**texts, "flag_values": numbers, "flag_meanings": names}

    def to_bytes(self, values: Values) -> NDArray[np.uint8]:
        """Values (rows, cols) as in 8-bit files."""
        if self.codes:
            return np.nan_to_num(values, nan=0.0).astype(np.uint8)
        return to_bytes(values, *self.byte)


def to_bytes(values: Values, low: float, high: float) -> NDArray[np.uint8]:
    """Values between ``low`` and ``high`` as 1 to 255, those beyond as the nearest, missing ones as 0."""
    scaled = np.clip((values - np.float32(low)) * np.float32(254.0 / (high - low)), 0.0, 254.0) + np.float32(1.5)
    return np.where(np.isnan(values), np.float32(0.0), scaled).astype(np.uint8)


def write(
    path: str | os.PathLike[str],
    grid: Grid,
    bands: Sequence[Band],
    blocks: Iterable[tuple[int, int, int, Values]],
    *,
    byte: bool = False,
    overviews: str = "average",
    tags: Mapping[str, str] | None = None,
    jobs: int | None = None,
    progress: Progress = SILENT,
) -> None:
    """Write a Cloud Optimized GeoTIFF, block by block, whole or not at all.

    Blocks first go to a plain tiled file beside the destination, which is then copied into the order of a COG, with
    overviews.

    Args:
        bands: of the file.
        blocks: (first band, row0, col0, values (bands, rows, cols)) that cover everything once, in any order.
        byte: 8-bit values (``Band.byte``) instead of float32; the file says how to turn them back.
        overviews: how they are resampled: "average" or "nearest".
        tags: of the file.
        jobs: threads of the compression.

    Raises:
        OutputError: it cannot be written; a previous file is still there.
    """
    import rasterio

    out = Path(path)
    check_folder(out)
    rows, cols = grid.shape
    tiles = len(bands) * -(-rows // 256) * -(-cols // 256)
    check_room(out, tiles * (256 * 256 * (1 if byte else 4) + _PER_TILE) + _HEADER)
    profile = {
        "driver": "GTiff", "height": rows, "width": cols, "count": len(bands), "dtype": "uint8" if byte else "float32",
        "nodata": 0 if byte else math.nan, "crs": None if grid.crs is None else grid.crs.to_wkt(),
        "transform": grid.transform, "tiled": True, "blockxsize": 256, "blockysize": 256, "bigtiff": "IF_SAFER",
        "interleave": "band",
    }  # fmt: skip
    with raster_file(out, _GDAL_CACHE) as part:
        plain = part.with_name(part.name + ".tif")
        try:
            with rasterio.open(plain, "w", **profile) as file:
                for k, band in enumerate(bands, 1):
                    file.set_band_description(k, band.name)
                    file.update_tags(k, **band.tags)
                file.units = tuple(band.unit for band in bands)
                if byte:
                    file.scales = tuple(b.scale[0] for b in bands)
                    file.offsets = tuple(b.scale[1] for b in bands)
                file.update_tags(**(tags or {}))
                for first, row, col, values in blocks:
                    window = rasterio.windows.Window(col, row, values.shape[2], values.shape[1])
                    for k, layer in enumerate(values):
                        data = bands[first + k].to_bytes(layer) if byte else layer
                        file.write(data, first + k + 1, window=window)
            check_written(plain, out)
            with progress.task("Writing the file"):
                write_cog(
                    plain, part, floats=not byte, overviews=overviews.upper(), threads=threads_for(jobs), level=_LEVEL
                )
        finally:
            remove(plain)
