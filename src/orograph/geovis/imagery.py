"""Image files as RGBA bytes: what the bands mean, how other types become bytes, where nothing is.

Red, green and blue are found by the bands' colour interpretation, else they are the first three; one band is looked up
in its palette or is grey. Types other than bytes, and grey without a palette, are stretched between the 2nd and 98th
percentile of what is valid over the terrain, colours together so that hues stay. With a colour map one band's values
are looked up there. Opacity comes from an alpha band, a mask or nodata. Large windows are averaged as they are read,
from overviews if the file has them. Units: pixels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph._numba import kernel
from orograph.dem.handles import HANDLES
from orograph.errors import ReadError
from orograph.geovis.image_errors import unreadable
from orograph.geovis.mipmap import curves

if TYPE_CHECKING:
    from orograph.geovis.layers import Layer

Bytes = NDArray[np.uint8]
Colors = NDArray[np.float32]

CUT = (2.0, 98.0)
"""Percentiles that become black and white."""

FEW = range(3, 33)
"""Different values of a band that has classes: an image of greys has more, one in black and white fewer."""

WIDEST = 1 << 12
"""Classes lie within so many of each other."""

PROBE = 512
"""Side of the reduced window from which the percentiles are taken."""

MANY = 1 << 26
"""Pixels without overviews from which on values are taken from some spots instead: a reduced window reads all."""

SPOTS, SPOT = 16, 64
"""How many along rows and columns, and pixels of a spot's side."""

PIECE = 1 << 22
"""Pixels read at once."""


@dataclass(frozen=True, slots=True)
class ImageWindow:
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


PICKS = 8
"""A palette's overviews hold picked pixels, not means: those are used from so many a side on for one texel."""


@dataclass(frozen=True, slots=True)
class Bands:
    """What of a file is colour.

    Attributes:
        colours: three bands (red, green, blue) or one.
        palette: (256 or 65536, 4) uint8 for one band of indices, else None.
        stretched: whether values are stretched instead of taken as they are.
        table: (n, 3) uint8, or (n, 4) with opacity, the colour map of one band's values, else None.
        nodata: the value that means "nothing here" besides what the file says, or None.
        span: the values that become black and white, or the ends of the table.
        classes: the values of one band of integers without colours, if they are few: classes, not greys.
    """

    colors: tuple[int, ...]
    palette: Bytes | None
    stretched: bool
    table: Bytes | None = None
    nodata: float | None = None
    span: tuple[float, float] = (0.0, 255.0)
    classes: tuple[int, ...] = ()

    @classmethod
    def of(cls, file: Any, layer: Layer) -> Bands:
        """What an open rasterio dataset holds, shown as a layer says; the span is not known yet (``spanned``).

        Raises:
            ReadError: it has no such band, or complex values.
        """
        names = [c.name for c in file.colorinterp]
        data = [i + 1 for i, name in enumerate(names) if name != "alpha"]
        if layer.colormap is not None:
            colors: tuple[int, ...] = (_number_of(layer.band, file),)
        elif all(c in names for c in ("red", "green", "blue")):
            colors = tuple(names.index(c) + 1 for c in ("red", "green", "blue"))
        else:
            colors = tuple(data[:3]) if len(data) >= 3 else tuple(data[:1] or [1])
        kind = np.dtype(file.dtypes[colors[0] - 1])
        if kind.kind == "c":
            raise ReadError("Its values are complex numbers, not colours.", path=file.name, remedy="Name an image.")
        if layer.colormap is not None:
            from orograph.geovis.color import color_table, linear_to_srgb
            from orograph.geovis.tables import Table

            if isinstance(layer.colormap, Table):
                table = layer.colormap.colors
            else:
                table = np.round(linear_to_srgb(color_table(layer.colormap)) * 255).astype(np.uint8)
            return cls(colors, None, True, table, layer.nodata)
        palette = None
        if len(colors) == 1 and names[colors[0] - 1] == "palette" and kind in (np.uint8, np.uint16):
            palette = np.zeros((np.iinfo(kind).max + 1, 4), np.uint8)
            for index, color in file.colormap(colors[0]).items():
                if 0 <= index < len(palette):
                    palette[index] = color
        stretched = palette is None and (kind != np.uint8 or len(colors) == 1)
        return cls(colors, palette, stretched, nodata=layer.nodata)

    def spanned(self, file: Any, layer: Layer, window: ImageWindow) -> Bands:
        """With the span of the layer's range, or else of the values in a window."""
        if not self.stretched:
            return self
        given = layer.range or getattr(layer.colormap, "span", None)
        if given is not None and self.table is not None:
            return replace(self, span=given)
        values = _sampled(file, self, window)
        if self.table is None and given is None and (codes := _codes(values)):
            from orograph.geovis.tables import DISTINCT, Table

            table = Table.of({code: DISTINCT[k % len(DISTINCT)] for k, code in enumerate(codes)})
            assert table.span is not None
            return replace(self, table=table.colors, span=table.span, classes=codes)
        return replace(self, span=given or _span(values))

    def coded(self, file: Any, window: ImageWindow) -> list[int]:
        """The values that a raster with a colour table has in a window, the most frequent first."""
        found, counts = np.unique(_sampled(file, self, window), return_counts=True)
        return [int(k) for k in found[np.argsort(-counts, kind="stable")]]

    def factors(self, file: Any) -> list[int]:
        """Pixels along the side of a texel of the file's overviews, finest first."""
        return [int(f) for f in file.overviews(self.colors[0])]


def _number_of(band: int | str, file: Any) -> int:
    """The number of a band, from 1, which may be given by its name.

    Raises:
        ReadError: there is no such band.
    """
    names = [name for name in file.descriptions if name]
    if isinstance(band, str) and band in names:
        return int(file.descriptions.index(band)) + 1
    if isinstance(band, str) or band > file.count:
        there = f"bands 1 to {file.count}" + (f", called {', '.join(names[:12])}" if names else "")
        raise ReadError(f"It has no band {band}.", path=file.name, remedy=f"There are {there}.")
    return band


def read_into(out: Bytes, location: str, window: ImageWindow, bands: Bands) -> None:
    """Read a window into ``out`` (rows, cols, 4) of its shape: sRGB and opacity, means in linear light.

    Raises:
        ReadError: the file cannot be read there.
    """
    for first, last, piece, step in pieces(location, window, bands):
        if step == 1:
            out[first:last] = piece
        else:
            shrink(piece, step, *curves(), out[first:last])


def pieces(location: str, window: ImageWindow, bands: Bands) -> Iterator[tuple[int, int, Bytes, int]]:
    """A window's pixels, or those of the file's own means that take part of the way, in pieces of bounded size.

    Yields:
        rows of texels [first, last); their pixels (rows, cols, 4), RGBA; how many of those a texel is wide.

    Raises:
        ReadError: the file cannot be read there.
    """
    from rasterio.errors import RasterioError

    step, pixels = window.step, window.col1 - window.col0
    rows = window.shape[0]
    try:
        with HANDLES.borrow(location) as file:
            picks = 1 if bands.palette is None else PICKS
            wraps = window.col0 < 0 or window.col1 > file.width
            factor = max(
                (
                    f
                    for f in bands.factors(file)
                    if not (wraps and file.width % f)
                    and step % (f * picks) == 0
                    and window.row0 % f == window.col0 % f == 0
                ),
                default=1,
            )
            height = max(1, PIECE * factor // (pixels * step))
            for first in range(0, rows, height):
                last = min(first + height, rows)
                span = window.row0 + first * step, min(window.row0 + last * step, window.row1)
                parts = [_pixels(file, bands, (span, cols), factor) for cols in _around(window, file.width)]
                yield first, last, parts[0] if len(parts) == 1 else np.concatenate(parts, 1), step // factor
    except (RasterioError, OSError) as error:
        raise unreadable(location, error) from None


def _around(window: ImageWindow, width: int) -> list[tuple[int, int]]:
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


def _pixels(file: Any, bands: Bands, area: Area, factor: int) -> Bytes:
    """An area of the file, or of its overview of ``factor``, as RGBA."""
    shape = tuple(-(-(b - a) // factor) for a, b in area)
    values = file.read(list(bands.colors), **_options(area, (len(bands.colors), *shape)))
    opacity = _mask(file, bands, values, area, shape)
    if bands.palette is not None:
        out: Bytes = bands.palette[values[0]]
        out[..., 3] = np.minimum(out[..., 3], opacity)
        return out
    out = np.empty((*shape, 4), np.uint8)
    out[..., 3] = opacity
    if bands.stretched:
        low, high = bands.span
        seen = np.isfinite(values).all(0)
        out[..., 3] = np.where(seen, opacity, 0)
        last = 255 if bands.table is None else len(bands.table) - 1
        # In double precision only where single would lose digits of the value.
        real = np.float32 if values.dtype.itemsize <= 4 and values.dtype.kind == "f" else np.float64
        scaled = np.where(seen, values.astype(real), low) - real(low)
        # Without a span there is but one value: grey.
        scaled = scaled * real(last / (high - low)) if high != low else np.full_like(scaled, last / 2 + 0.5)
        values = np.clip(np.round(scaled), 0, last).astype(np.uint16)
        if bands.table is not None:
            colors = bands.table[values[0]]
            out[..., :3] = colors[..., :3]
            if colors.shape[-1] == 4:
                out[..., 3] = np.minimum(out[..., 3], colors[..., 3])
            return out
    for k in range(3):
        out[..., k] = values[min(k, len(values) - 1)]
    return out


def _mask(file: Any, bands: Bands, values: NDArray[Any], area: Area, shape: tuple[int, ...]) -> Bytes:
    """Opacity (rows, cols) of values (bands, rows, cols) that were read: 0 where there is nothing."""
    if bands.nodata is not None:
        nothing = np.isnan(values).all(0) if np.isnan(bands.nodata) else (values == bands.nodata).all(0)
        opacity: Bytes = np.where(nothing, 0, 255).astype(np.uint8)
        return opacity
    if all("all_valid" in (flag.name for flag in flags) for flags in file.mask_flag_enums):
        return np.full(shape, 255, np.uint8)
    if bands.table is not None:  # one band of several: its own mask, not all of theirs
        return np.asarray(file.read_masks(bands.colors[0], **_options(area, shape)))
    return np.asarray(file.dataset_mask(**_options(area, shape)))


def _probed(file: Any, bands: Bands, area: Area, shape: tuple[int, ...]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Values (bands, rows, cols) of an area, picked to this shape, and which are valid in all bands."""
    values = file.read(list(bands.colors), **_options(area, (len(bands.colors), *shape)))
    return values, (_mask(file, bands, values, area, shape) > 127) & np.isfinite(values).all(0)


def _spots(file: Any, area: Area) -> Iterator[Area]:
    """Small areas spread over a large one, each within one of the file's blocks where these are as large."""
    high, wide = file.block_shapes[0]
    starts = []
    for (first, last), block in zip(area, (high, wide), strict=True):
        at = (np.linspace(first, last - SPOT, SPOTS) // block * block).astype(int)
        starts.append([min(max(int(k), first), last - SPOT) for k in at])
    for row in starts[0]:
        for col in starts[1]:
            yield (row, row + SPOT), (col, col + SPOT)


def _sampled(file: Any, bands: Bands, window: ImageWindow) -> NDArray[Any]:
    """Valid values (bands, n) of pixels spread over the window."""
    cols = (max(window.col0, 0), min(window.col1, file.width))
    area = ((window.row0, window.row1), cols if cols[0] < cols[1] else (0, file.width))
    whole = math.prod(b - a for a, b in area)
    if whole > MANY * max(bands.factors(file), default=1) ** 2:
        found = [_probed(file, bands, spot, (SPOT, SPOT)) for spot in _spots(file, area)]
        values, valid = (np.concatenate(part, -1) for part in zip(*found, strict=True))
    else:
        values, valid = _probed(file, bands, area, tuple(min(PROBE, b - a) for a, b in area))
    return values[:, valid]


def _codes(values: NDArray[Any]) -> tuple[int, ...]:
    """The values of one band of integers if they seem to be classes: few, and no greys in equal steps."""
    if values.dtype.kind not in "iu" or len(values) != 1:
        return ()
    found = np.unique(values)
    if len(found) not in FEW or int(found[-1]) - int(found[0]) >= WIDEST:
        return ()
    steps = np.diff(found.astype(np.int64))
    greys = steps.min() == steps.max() and steps[0] > 1 and steps.sum() > 128
    return () if greys else tuple(int(v) for v in found)


def _span(values: NDArray[Any]) -> tuple[float, float]:
    """The values that become black and white: percentiles of samples."""
    if not values.size:
        return 0.0, 0.0
    values = values.astype(np.float64)
    low, high = (float(p) for p in np.percentile(values, CUT))
    if not high > low:  # a few bright marks on one ground
        low, high = float(values.min()), float(values.max())
    return low, high


def step_for(rows: int, cols: int, budget: float, wanted: float) -> int:
    """Pixels along the side of a texel: the most within ``wanted``, but as many as ``budget`` bytes ask for (four a
    texel, a third more for the coarser levels). A power of two, which is what files have overviews of."""
    step = 1 << int(math.log2(max(1.0, wanted)))
    while -(-rows // step) * -(-cols // step) * 16 / 3 > budget and step < max(rows, cols):
        step *= 2
    return step


@kernel
def shrink(fine: Bytes, step: int, decode: Colors, encode: Bytes, out: Bytes) -> None:
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
