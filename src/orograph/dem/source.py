"""One raster file opened for reading by windows: ``Source``; and ``read``, the whole of it as a ``Dem``.

Whatever the file holds, ``Source.read`` gives metres as float32 with NaN where there is no height:

1. the file's numbers are compared with its nodata value *as stored*, before any scaling (integers exactly, floats by
   ``is_nodata``); a mask or alpha band counts too; NaN, ±inf and anything of magnitude 1e12 or more (a nodata value
   that was not declared: no body is that large) are never heights;
2. height = (number · scale + offset) · metres per unit, in float64, rounded once to float32. Integers beyond 2^24 and
   float64 thereby keep 24 bits: better than 0.001 m for every height on Earth.

``Source`` can handle files larger than memory; ``read`` refuses them (``MAX_READ_BYTES``).
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.dem.bands import (
    MAX_BLOCK_BYTES,
    band_warnings,
    check_band,
    check_encoding,
    check_scale,
    check_size,
    description_of,
    is_palette,
    is_picture,
    unit_tag,
)
from orograph.dem.deciding import know
from orograph.dem.diagnostics import diagnose
from orograph.dem.encode import decode_rgb
from orograph.dem.handles import HANDLES, Seen, cause_of, lent, locate, stamped
from orograph.dem.header import attribution_of, place_of, settled_vertical, unit_of, vertical_of
from orograph.dem.lattice import FLOAT
from orograph.dem.missing import Valid, is_default_fill, is_nodata, mask_of, nodata_of, valid_of
from orograph.dem.pool import forget_parts, is_virtual
from orograph.dem.whole import DAMAGED, check_blocks, check_mask
from orograph.dem.whole.files import files_in
from orograph.errors import ReadError
from orograph.geo.grid import Grid

HUGE = 1e12  # metres; nodata values such as ±3.4e38 and 1e20 lie beyond, heights of any body do not

_CHUNK = 32 << 20  # bytes of the file's own numbers read at once


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """One raster, opened for windowed reading. Make one with ``Source.open``.

    Attributes:
        path: as given; ``location``: what GDAL opens (inside an archive, say).
        name: the file's stem.
        grid: where the samples lie, the north-west one first.
        vertical: name of the vertical datum, None if unknown.
        dtype: of the stored numbers, e.g. "int16"; ``band``: which band (1-based).
        nodata: the stored number that means "missing", None if there is none.
        scale, offset: height in the file's unit = number · scale + offset.
        unit_factor: metres in one of the file's unit.
        encoding: how colours hold the height ("mapbox", "terrarium"), or None.
        georeferenced: whether the file says where it lies.
        block: (rows, cols) of the blocks the file is stored in; ``bands``: how many it has.
        driver: GDAL's name of the format.
        description: what the file calls the band, "" if it does not say.
        unit: what the user or the file calls the unit of its numbers, "" if neither says.
        attribution: the credits that its makers ask for: the file's tag ATTRIBUTION.
        picture: whether its bands are colours or classes rather than heights.
        valid: further rules for which stored numbers are heights (netCDF); None: there are none.
        undeclared: stored numbers of magnitude 1e12 or more met so far that the file does not declare as nodata.
        warnings: what a user should know, full sentences.
    """

    path: str
    location: str
    name: str
    grid: Grid
    vertical: str | None
    dtype: str
    band: int
    bands: int
    nodata: float | int | None
    scale: float
    offset: float
    unit_factor: float
    encoding: str | None
    georeferenced: bool
    block: tuple[int, int]
    driver: str
    description: str = ""
    unit: str = ""
    warnings: list[str] = field(default_factory=list)
    undeclared: set[float] = field(default_factory=set)
    valid: Valid | None = None
    picture: bool = False
    attribution: tuple[str, ...] = ()
    _flip_rows: bool = False
    _flip_cols: bool = False
    _mask: Literal["none", "gdal", "alpha"] = "none"
    _alpha: int = 0
    _opened: Sequence[Seen] = ()

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        *,
        band: int = 1,
        nodata: float | str | None = None,
        spacing: float | None = None,
        assume_crs: str | None = None,
        encoding: str | None = None,
        vertical_unit: str | None = None,
        assume_vertical: str | None = None,
    ) -> Source:
        """Read the header of a raster (no samples).

        Args:
            path: a file, a .zip or .gz of one, a URL or anything else GDAL opens.
            band: which band holds the heights, from 1.
            nodata: the stored number that means "missing", instead of the declared one; "none" for no such number.
            spacing: metres between samples, for files without georeferencing.
            assume_crs: the CRS of files that declare none.
            encoding: "mapbox" or "terrarium" for terrain-RGB pictures.
            vertical_unit: the unit of the heights ("ft", "cm"…), instead of the declared one.
            assume_vertical: the vertical datum of files that name none ("EGM96", "ellipsoidal", "EPSG:5703"…).

        Raises:
            ReadError: the file is missing, broken, or not of real numbers.
            UsageError: an option that does not fit the file.
        """
        location = locate(path)
        if is_virtual(location):
            forget_parts()
        HANDLES.close(location)  # an open dataset would not notice that companions or a VRT's parts have changed
        opened = [Seen([location])]
        warnings: list[str] = []
        with HANDLES.borrow(location) as dataset:
            names = files_in(dataset)
            opened.append(Seen(names))  # including headers, masks and the parts of a VRT
            if dataset.driver not in ("VRT", "Zarr"):
                know(location, names)
            check_size(dataset, path)
            check_band(dataset, band, path)
            if encoding is not None:
                check_encoding(dataset, encoding, path)
            elif vertical_unit is None and is_picture(dataset):
                warnings.append(
                    "It looks like a picture, not heights: its bands are 8-bit colours "
                    '(give `encoding="mapbox"` or `encoding="terrarium"` if it is a terrain-RGB tile).'
                )
            elif is_palette(dataset, band):
                warnings.append("It has a colour table: its numbers are classes or colours, not heights.")
            elif dataset.count > 1:
                warnings.extend(band_warnings(dataset, band))
            if nodata is None and is_default_fill(dataset, band):
                warnings.append("Its fill value is 0, so heights of 0 count as missing (`nodata=none` if they do not).")
            place, crs = place_of(dataset, spacing=spacing, assume_crs=assume_crs, warnings=warnings)
            dtype = dataset.dtypes[band - 1]
            mask, alpha = mask_of(dataset, band, nodata)
            unit = unit_of(dataset, band, crs, vertical_unit, warnings)
            plain = encoding is None
            if plain:
                masked = mask != "none"
                warnings += diagnose(dataset, band, nodata=nodata, unit=vertical_unit, masked=masked, crs=crs)
                check_scale(dataset, band)
            return cls(
                path=os.fspath(path),
                location=location,
                name=_stem(path),
                grid=place.grid,
                vertical=settled_vertical(vertical_of(dataset, crs), assume_vertical, warnings),
                dtype=dtype,
                band=band,
                bands=dataset.count,
                nodata=nodata_of(dataset, band, nodata, dtype) if plain else None,
                scale=float(dataset.scales[band - 1]) if plain else 1.0,
                offset=float(dataset.offsets[band - 1]) if plain else 0.0,
                unit_factor=unit,
                encoding=encoding,
                georeferenced=place.georeferenced,
                block=tuple(dataset.block_shapes[band - 1]),
                driver=dataset.driver,
                description=description_of(dataset, band),
                unit=vertical_unit or unit_tag(dataset, band),
                warnings=warnings,
                valid=valid_of(dataset, band) if plain and nodata != "none" else None,
                picture=plain and (is_picture(dataset) or is_palette(dataset, band)),
                attribution=attribution_of(dataset),
                _flip_rows=place.flip_rows,
                _flip_cols=place.flip_cols,
                _mask=mask if plain else "none",
                _alpha=alpha,
                _opened=opened,
            )

    @property
    def masked(self) -> bool:
        """Whether a mask, an alpha band or a valid range, besides any nodata value, says where samples are missing."""
        return self._mask != "none" or self.valid is not None

    @property
    def code(self) -> tuple[str, float]:
        """(dtype, nodata) of its numbers if they are whole metres of 8 or 16 bits and a nodata value marks missing
        ones; else ("float32", nan), which is what ``read`` returns."""
        plain = (self.scale, self.offset, self.unit_factor, self.encoding, self.valid) == (1.0, 0.0, 1.0, None, None)
        if plain and self.nodata is not None and self.dtype in ("int8", "uint8", "int16", "uint16"):
            limits = np.iinfo(self.dtype)
            if limits.min <= self.nodata <= limits.max and self.nodata == int(self.nodata):
                return self.dtype, int(self.nodata)
        return FLOAT

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.grid.shape

    def read(self, row0: int, row1: int, col0: int, col1: int, *, step: int = 1) -> NDArray[np.float32]:
        """Heights of every ``step``-th sample of the half-open window, from its first: float32 metres, NaN if missing.

        Safe from any thread. The samples are the file's own, whatever overviews it has.

        Args:
            row0, row1, col0, col1: window in samples, inside the raster.
            step: 1 reads all; k reads rows row0, row0 + k… and columns likewise.

        Returns:
            (ceil((row1 − row0) / step), ceil((col1 − col0) / step)) float32.

        Raises:
            ReadError: the file is damaged there (names the block), or was changed since it was opened.
            ValueError: a window that is empty or not inside the raster, or a step below 1.
        """
        rows, cols = self.grid.shape
        if not (0 <= row0 < row1 <= rows and 0 <= col0 < col1 <= cols) or step < 1:
            raise ValueError(f"window [{row0}, {row1}) × [{col0}, {col1}), step {step}, of a raster of {rows} × {cols}")
        n_rows, n_cols = -(-(row1 - row0) // step), -(-(col1 - col0) // step)
        first_row = rows - 1 - (row0 + (n_rows - 1) * step) if self._flip_rows else row0
        first_col = cols - 1 - (col0 + (n_cols - 1) * step) if self._flip_cols else col0
        try:
            out = self._window(n_rows, n_cols, first_row, first_col, step)
        except ReadError:
            if self.driver == "VRT":
                forget_parts()
            self._refuse_changed()  # rather than report a fault of the new content
            raise
        self._refuse_changed()
        if self._flip_rows:
            out = out[::-1]
        if self._flip_cols:
            out = out[:, ::-1]
        return np.ascontiguousarray(out)

    def _window(self, n_rows: int, n_cols: int, first_row: int, first_col: int, step: int) -> NDArray[np.float32]:
        """Every ``step``-th sample of a window of the file's own rows and columns."""
        out = np.empty((n_rows, n_cols), np.float32)
        with HANDLES.borrow(self.location) as dataset:
            key = stamped(self.location)
            for i0, i1, j0, j1 in self._chunks(n_rows, n_cols, step):
                top, left = first_row + i0 * step, first_col + j0 * step
                height, width = (i1 - i0 - 1) * step + 1, (j1 - j0 - 1) * step + 1
                out[i0:i1, j0:j1] = self._decode(dataset, top, left, height, width, step)
                for band in self._bands_read(dataset):  # (after GDAL has found that they exist)
                    check_blocks(dataset, key, band, (top, left, height, width), step, lent)
                if self._mask == "gdal":
                    check_mask(dataset, key, (top, left, height, width), lent)
        return out

    def _refuse_changed(self) -> None:
        changed = next(filter(None, (seen.changed() for seen in self._opened)), None)
        if changed is not None:
            name = self.path if changed == self.location else changed
            raise ReadError("The file was changed after it was opened.", path=name, remedy="Open it again.")

    def turned(self, row0: int, row1: int, col0: int, col1: int) -> tuple[int, int, int, int]:
        """A window of the file's own rows and columns as ``read`` counts them, from the north-west."""
        rows, cols = self.grid.shape
        if self._flip_rows:
            row0, row1 = rows - row1, rows - row0
        if self._flip_cols:
            col0, col1 = cols - col1, cols - col0
        return row0, row1, col0, col1

    def close(self) -> None:
        """Close the file's idle handles (they are also closed when many other files are read)."""
        HANDLES.close(self.location)

    def __enter__(self) -> Source:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _chunks(self, n_rows: int, n_cols: int, step: int) -> list[tuple[int, int, int, int]]:
        """Pieces (i0, i1, j0, j1) of the output whose source windows are small enough to be read at once."""
        itemsize = np.dtype(self.dtype).itemsize * (4 if self.encoding else 1)
        wide = max(1, min(n_cols, _CHUNK // itemsize // step))
        # Where whole blocks lie between the wanted rows, reading one row at a time touches only the blocks it needs.
        tall = 1 if step > self.block[0] else max(1, min(n_rows, _CHUNK // (itemsize * wide * step * step)))
        if step == 1 and self.block[0] > 1 and tall < n_rows:
            tall = max(self.block[0], tall // self.block[0] * self.block[0])  # decode each block once
        return [
            (i, min(i + tall, n_rows), j, min(j + wide, n_cols))
            for i in range(0, n_rows, tall)
            for j in range(0, n_cols, wide)
        ]

    def _bands_read(self, dataset: Any) -> list[int]:
        if self.encoding is not None:
            return list(range(1, min(dataset.count, 4) + 1))
        return [self.band, self._alpha] if self._mask == "alpha" else [self.band]

    def _decode(self, dataset: Any, top: int, left: int, height: int, width: int, step: int) -> NDArray[np.float32]:
        from rasterio._err import CPLE_BaseError
        from rasterio.errors import RasterioError
        from rasterio.windows import Window

        window = Window(left, top, width, height)
        indexes = self._bands_read(dataset) if self.encoding is not None else self.band
        try:
            raw = dataset.read(indexes, window=window)[..., ::step, ::step]
            mask = None
            if self._mask == "gdal":
                mask = dataset.read_masks(self.band, window=window)[::step, ::step] == 0
            elif self._mask == "alpha":
                mask = dataset.read(self._alpha, window=window)[::step, ::step] == 0
        except (RasterioError, CPLE_BaseError, MemoryError) as error:
            raise ReadError(
                f"{self._where(error, top, left, height, width)} cannot be read: {cause_of(error)}",
                path=self.path,
                remedy=DAMAGED,
            ) from None
        if self.encoding is not None:
            heights = decode_rgb(raw, self.encoding)
        else:
            heights = self._heights(raw)
        if mask is not None:
            heights[mask] = np.nan
        return heights

    def _where(self, error: BaseException, top: int, left: int, height: int, width: int) -> str:
        """The block that failed, in the file's own rows and columns, if GDAL names it; else the requested window."""
        inner: BaseException | None = error
        while inner is not None:
            found = re.search(r"X offset (\d+), Y offset (\d+)", getattr(inner, "errmsg", "") or str(inner))
            if found:
                (high, wide), (col, row) = self.block, (int(found[1]), int(found[2]))
                row, col = row * high, col * wide
                return f"The block of rows {row}–{row + high - 1}, columns {col}–{col + wide - 1}"
            inner = inner.__cause__
        return f"Something in rows {top}–{top + height - 1}, columns {left}–{left + width - 1}"

    def _heights(self, raw: NDArray[Any]) -> NDArray[np.float32]:
        missing = None if self.nodata is None else is_nodata(raw, self.nodata)
        if self.valid is not None:
            outside = self.valid.outside(raw)
            missing = outside if missing is None else missing | outside
        plain = self.scale == 1 and self.offset == 0 and self.unit_factor == 1
        with np.errstate(over="ignore", invalid="ignore"):
            if plain:
                heights = raw.astype(np.float32)
            else:
                heights = ((raw.astype(np.float64) * self.scale + self.offset) * self.unit_factor).astype(np.float32)
            if raw.dtype.kind == "f":
                huge = ~(np.abs(raw) < HUGE)
                heights[huge] = np.nan
                if self._mask != "gdal":  # ISIS's special pixels are such numbers, which the mask covers
                    self._note_undeclared(raw, huge, missing)
        if not plain or raw.dtype.itemsize > 4:
            heights[~(np.abs(heights) < HUGE)] = np.nan
        if missing is not None:
            heights[missing] = np.nan
        return heights

    def _note_undeclared(self, raw: NDArray[Any], huge: NDArray[np.bool_], missing: NDArray[np.bool_] | None) -> None:
        if missing is not None:
            huge = huge & ~missing
        found = raw[huge]
        finite = found[np.isfinite(found)]
        if finite.size and len(self.undeclared) < 8:
            self.undeclared.add(float(finite[0]))


def _stem(path: str | os.PathLike[str]) -> str:
    name = os.fspath(path).rstrip("/").replace("\\", "/").rpartition("/")[2].partition("?")[0]
    while name.lower().endswith((".zip", ".gz", ".tar", ".tgz")):
        name = name.rpartition(".")[0]
    stem = name.rpartition(".")[0]
    return stem or name


__all__ = ["HUGE", "MAX_BLOCK_BYTES", "Source"]
