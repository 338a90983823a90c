"""Image files as RGBA bytes: what the bands mean, how other types become bytes, where nothing is.

Red, green and blue are found by the bands' colour interpretation, else they are the first three; one band is looked up
in its palette or is grey. Types other than bytes, and grey without a palette, are stretched between the 2nd and 98th
percentile of what is valid in the window, colours together so that hues stay. Opacity comes from an alpha band, a mask
or nodata. Large windows are averaged as they are read, from overviews if the file has them. Units: pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.dem.handles import HANDLES, cause_of
from orograph.errors import ReadError
from orograph.geovis.mipmap import curves

Bytes = NDArray[np.uint8]
Colours = NDArray[np.float32]

CUT = (2.0, 98.0)
"""Percentiles that become black and white."""

PROBE = 512
"""Side of the reduced window from which the percentiles are taken."""

PIECE = 1 << 22
"""Pixels read at once."""


@dataclass(frozen=True, slots=True)
class Bands:
    """What of a file is colour.

    Attributes:
        colours: three bands (red, green, blue) or one.
        palette: (256 or 65536, 4) uint8 for one band of indices, else None.
        stretched: whether values are stretched instead of taken as they are.
    """

    colours: tuple[int, ...]
    palette: Bytes | None
    stretched: bool

    @classmethod
    def of(cls, file: Any) -> Bands:
        """What an open rasterio dataset holds."""
        names = [c.name for c in file.colorinterp]
        data = [i + 1 for i, name in enumerate(names) if name != "alpha"]
        if all(c in names for c in ("red", "green", "blue")):
            colours = tuple(names.index(c) + 1 for c in ("red", "green", "blue"))
        else:
            colours = tuple(data[:3]) if len(data) >= 3 else tuple(data[:1] or [1])
        kind = np.dtype(file.dtypes[colours[0] - 1])
        if kind.kind == "c":
            raise ReadError("Its values are complex numbers, not colours.", path=file.name, remedy="Name an image.")
        palette = None
        if len(colours) == 1 and names[colours[0] - 1] == "palette" and kind in (np.uint8, np.uint16):
            palette = np.zeros((np.iinfo(kind).max + 1, 4), np.uint8)
            for index, colour in file.colormap(colours[0]).items():
                if 0 <= index < len(palette):
                    palette[index] = colour
        return cls(colours, palette, palette is None and (kind != np.uint8 or len(colours) == 1))


@dataclass(frozen=True, slots=True)
class Window:
    """Pixels [row0, row1) × [col0, col1) of a file, held as texels of ``step`` × ``step`` pixels.

    Columns may lie beyond the file's borders where it goes once around the body.
    """

    row0: int
    row1: int
    col0: int
    col1: int
    step: int = 1

    @property
    def shape(self) -> tuple[int, int]:
        """Texels (rows, cols); the last may cover fewer pixels."""
        return -(-(self.row1 - self.row0) // self.step), -(-(self.col1 - self.col0) // self.step)


def read_into(out: Bytes, location: str, window: Window) -> None:
    """Read a window into ``out`` (rows, cols, 4) of its shape: sRGB and opacity, means in linear light.

    Raises:
        ReadError: the file cannot be read there.
    """
    from rasterio.errors import RasterioError

    step, pixels = window.step, window.col1 - window.col0
    try:
        with HANDLES.borrow(location) as file:
            bands = Bands.of(file)
            span = _span(file, bands, window) if bands.stretched else (0.0, 255.0)
            # The file's own means take part of the way (a palette's are picked pixels, not means).
            overviews = [] if bands.palette is not None else file.overviews(bands.colours[0])
            factor = max((f for f in overviews if step % f == 0 and window.row0 % f == window.col0 % f == 0), default=1)
            height = max(1, PIECE * factor // (pixels * step))
            for first in range(0, len(out), height):
                last = min(first + height, len(out))
                rows = window.row0 + first * step, min(window.row0 + last * step, window.row1)
                parts = [_pixels(file, bands, span, (rows, cols), factor) for cols in _around(window, file.width)]
                piece = parts[0] if len(parts) == 1 else np.concatenate(parts, 1)
                if step == factor:
                    out[first:last] = piece
                else:
                    shrink(piece, step // factor, *curves(), out[first:last])
    except (RasterioError, OSError) as error:
        raise ReadError(
            f"The image cannot be read: {cause_of(error)}", path=location, remedy="Fetch it again if it was cut short."
        ) from None


def _around(window: Window, width: int) -> list[tuple[int, int]]:
    """The columns of a window as runs within the file."""
    borders = range(math.floor(window.col0 / width) * width, window.col1, width)
    edges = pairwise([window.col0, *(k for k in borders if k > window.col0), window.col1])
    return [(a % width, a % width + b - a) for a, b in edges]


Area = tuple[tuple[int, int], tuple[int, int]]
"""Rows and columns [from, to) of a file."""


def _options(area: Area, shape: tuple[int, ...]) -> dict[str, Any]:
    from rasterio.windows import Window as Part

    (a, b), (c, d) = area
    return {"window": Part(c, a, d - c, b - a), "out_shape": shape}


def _pixels(file: Any, bands: Bands, span: tuple[float, float], area: Area, factor: int) -> Bytes:
    """An area of the file, or of its overview of ``factor``, as RGBA."""
    shape = tuple(-(-(b - a) // factor) for a, b in area)
    values = file.read(list(bands.colours), **_options(area, (len(bands.colours), *shape)))
    opacity = file.dataset_mask(**_options(area, shape))
    if bands.palette is not None:
        out: Bytes = bands.palette[values[0]]
        out[..., 3] = np.minimum(out[..., 3], opacity)
        return out
    if bands.stretched:
        low, high = span
        seen = np.isfinite(values).all(0)
        opacity = np.where(seen, opacity, 0)
        scaled = np.where(seen, values.astype(np.float32), low) - np.float32(low)
        # Without a span there is but one value: grey.
        scaled = scaled * np.float32(255 / (high - low)) if high > low else np.full_like(scaled, 128)
        values = np.clip(np.round(scaled), 0, 255).astype(np.uint8)
    out = np.empty((*shape, 4), np.uint8)
    out[..., :3] = np.moveaxis(np.broadcast_to(values, (3, *shape)), 0, -1)
    out[..., 3] = opacity
    return out


def _span(file: Any, bands: Bands, window: Window) -> tuple[float, float]:
    """The values that become black and white: percentiles over the window."""
    cols = (max(window.col0, 0), min(window.col1, file.width))
    area = ((window.row0, window.row1), cols if cols[0] < cols[1] else (0, file.width))
    shape = tuple(min(PROBE, b - a) for a, b in area)
    values = file.read(list(bands.colours), **_options(area, (len(bands.colours), *shape))).astype(np.float64)
    valid = (file.dataset_mask(**_options(area, shape)) > 127) & np.isfinite(values).all(0)
    if not valid.any():
        return 0.0, 0.0
    low, high = (float(p) for p in np.percentile(values[:, valid], CUT))
    if not high > low:  # a few bright marks on one ground
        low, high = float(values[:, valid].min()), float(values[:, valid].max())
    return low, high


def step_for(rows: int, cols: int, budget: float, wanted: float) -> int:
    """Pixels along the side of a texel: the most within ``wanted``, but as many as ``budget`` bytes ask for (four a
    texel, a third more for the coarser levels). A power of two, which is what files have overviews of."""
    step = 1 << int(math.log2(max(1.0, wanted)))
    while -(-rows // step) * -(-cols // step) * 16 / 3 > budget and step < max(rows, cols):
        step *= 2
    return step


@kernel
def shrink(fine: Bytes, step: int, decode: Colours, encode: Bytes, out: Bytes) -> None:
    """Means of ``step`` × ``step`` pixels of linear light, weighted by opacity, as in ``mipmap``."""
    rows, cols = fine.shape[0], fine.shape[1]
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            red = green = blue = 0.0
            opacity = area = np.int64(0)
            for a in range(i * step, min(i * step + step, rows)):
                for b in range(j * step, min(j * step + step, cols)):
                    w = np.int64(fine[a, b, 3])
                    area += 1
                    opacity += w
                    red += w * decode[fine[a, b, 0]]
                    green += w * decode[fine[a, b, 1]]
                    blue += w * decode[fine[a, b, 2]]
            out[i, j, 3] = np.uint8(opacity / area + 0.5)
            scale = 65535.0 / opacity if opacity > 0 else 0.0
            out[i, j, 0] = encode[np.int64(red * scale + 0.5)]
            out[i, j, 1] = encode[np.int64(green * scale + 0.5)]
            out[i, j, 2] = encode[np.int64(blue * scale + 0.5)]
