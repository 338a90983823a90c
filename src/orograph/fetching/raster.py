"""An area's heights from the cache: the pieces of its tiles on one grid.

A sample is its tile's own number, to the bit, if its band of tiles has the grid's columns; towards the poles, samples
are interpolated linearly along rows (float64, rounded once). Samples of an absent tile are 0 m of sea or missing,
according to the product; a row or column shared with another tile comes from the tile that owns it. Units: metres;
samples.
"""

from __future__ import annotations

import hashlib
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orograph.dem.deciding import states
from orograph.dem.lattice import FLOAT
from orograph.dem.source import Source
from orograph.errors import ReadError
from orograph.fetching.products import Product
from orograph.fetching.reading import Part, Reader
from orograph.fetching.tiling import Band, Layout, Piece
from orograph.output import remove

Heights = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class _Spot:
    """A piece, the parts that hold it by their first (row, col), and where its tile begins in them."""

    piece: Piece
    parts: dict[tuple[int, int], Part]
    row: int
    col: int
    shape: tuple[int, int]
    fill: float


class Fetched:
    """A raster of an area, for a mosaic or a store; reads the data that ``Reader.read`` has put into the cache.

    Attributes:
        grid: of the area. name, vertical, attribution: as for a ``Dem``. product: the source.
        code: (dtype, nodata) of the smallest numbers that hold all of them.
        sea, missing: number of absent tiles, by their meaning.
    """

    def __init__(self, product: Product, layout: Layout, reader: Reader, name: str, sea: bool) -> None:
        self.product, self.grid, self.name = product, layout.grid, name
        self.vertical = product.datum
        self.attribution = (product.attribution,)
        self._bands = layout.bands
        self._spots = [[self._spot(piece, reader, sea) for piece in band.pieces] for band in layout.bands]
        absent = {spot.piece.tile.key: spot.fill for spots in self._spots for spot in spots if not spot.parts}
        self.sea = sum(fill == 0 for fill in absent.values())
        self.missing = len(absent) - self.sea
        self.code = self._code(reader)
        self._files: dict[Path, Source] = {}
        self._lock = threading.Lock()

    @property
    def resampled(self) -> bool:
        """Whether rows of some tiles were interpolated."""
        return any(band.resampled for band in self._bands)

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Heights:
        """Heights of a half-open window inside the grid: float32 metres, NaN where missing. Safe from any thread.

        Raises:
            ReadError: a part in the cache is damaged.
        """
        out = np.full((row1 - row0, col1 - col0), np.nan, np.float32)
        spots = [
            (band, spots) for band, spots in zip(self._bands, self._spots) if band.row0 <= row1 and band.row1 >= row0
        ]
        for band, some in spots:
            a, b = max(row0, band.row0), min(row1, band.row1)
            if a < b:
                place = out[a - row0 : b - row0]
                self._fill(band, some, a - band.row0, b - band.row0, col0, col1, place)
        if self.product.shared:
            for band, some in spots:
                for spot in some:
                    self._share(spot, band.row0 + spot.piece.row, (row0, col0), out)
        for band, some in spots:
            for spot in some:
                if spot.fill == 0 and not spot.parts and not band.resampled:
                    piece = spot.piece
                    view = _within(out, (row0, col0), band.row0 + piece.row, piece.col, _size(piece))
                    view[np.isnan(view)] = 0
        return out

    def fingerprint(self) -> str:
        """A hash of its parts and their places."""
        parts = [self.product.name, repr(self.grid.transform[:6]), repr(self.grid.shape)]
        for spots in self._spots:
            for spot in spots:
                parts.append(f"{spot.piece} {spot.fill}")
                parts += states(str(part.kept.part(part.row, part.col)) for part in spot.parts.values())
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def _spot(self, piece: Piece, reader: Reader, sea: bool) -> _Spot:
        header = reader.records[piece.tile.key].header
        parts = {(part.row, part.col): part for part in reader.parts([piece])}
        absent = reader.records[piece.tile.key].status == "absent"
        fill = 0.0 if sea and absent else np.nan
        if header is None:
            return _Spot(piece, {}, 0, 0, (0, 0), fill)
        return _Spot(piece, parts, header.row, header.col, header.shape, fill)

    def _code(self, reader: Reader) -> tuple[str, float]:
        """The type and nodata value of its tiles, if they have one and need no numbers in between."""
        headers = [record.header for record in reader.records.values() if record.header is not None]
        codes = {FLOAT if header.nodata is None else (header.dtype, header.nodata) for header in headers}
        return codes.pop() if len(codes) == 1 and not self.resampled else FLOAT

    def _fill(self, band: Band, spots: list[_Spot], row0: int, row1: int, col0: int, col1: int, out: Heights) -> None:
        """Samples of a band's rows [row0, row1) and the area's columns [col0, col1) into ``out``."""
        if not band.resampled:
            self._put(spots, row0, col0, out)
            return
        # Columns of the band at the area's columns; one that coincides needs no neighbour.
        at = band.start + np.arange(col0, col1) * band.step
        nearest = np.rint(at)
        at = np.where(np.abs(at - nearest) < 1e-6, nearest, at)
        left = np.floor(at).astype(np.int64)
        first, end = int(left[0]), min(int(left[-1]) + 2, band.cols)
        own = np.full((row1 - row0, end - first), np.nan, np.float32)
        self._put(spots, row0, first, own)
        for spot in spots:
            if spot.fill == 0 and not spot.parts:
                view = _within(own, (row0, first), spot.piece.row, spot.piece.col, _size(spot.piece))
                view[:] = 0
        part = at - left
        low, high = own[:, left - first], own[:, np.minimum(left - first + 1, end - first - 1)]
        mixed = low * (1 - part) + high.astype(np.float64) * part
        out[:] = np.where(part == 0, low, mixed)

    def _put(self, spots: list[_Spot], row: int, col: int, out: Heights) -> None:
        """Put the samples of pieces into an array that begins at (row, col) of their band."""
        for spot in spots:
            piece = spot.piece
            self._copy(spot, piece.row0, piece.col0, _size(piece), (piece.row - row, piece.col - col), out)

    def _share(self, spot: _Spot, top: int, first: tuple[int, int], out: Heights) -> None:
        """Copy a piece's last shared row and column where its neighbour, which owns them, has nothing."""
        piece = spot.piece
        rows, cols = _size(piece)
        at = top - first[0], piece.col - first[1]
        for row, col, size in ((rows, 0, (1, cols + 1)), (0, cols, (rows, 1))):
            view = _within(out, first, top + row, piece.col + col, size)
            if view.size:
                found = np.full_like(view, np.nan)
                start = min(at[0] + row, 0), min(at[1] + col, 0)
                self._copy(spot, piece.row0 + row, piece.col0 + col, size, start, found)
                np.copyto(view, found, where=np.isnan(view))

    def _copy(self, spot: _Spot, row: int, col: int, size: tuple[int, int], at: tuple[int, int], out: Heights) -> None:
        """Copy ``size`` samples of a tile from its (row, col) to ``at`` in an array, as far as both reach."""
        if not spot.parts:
            return
        # In samples of the tile's file.
        row, col = row + spot.row, col + spot.col
        row0, col0 = row + max(0, -at[0]), col + max(0, -at[1])
        row1 = min(row + size[0], row + out.shape[0] - at[0], spot.shape[0])
        col1 = min(col + size[1], col + out.shape[1] - at[1], spot.shape[1])
        if row0 >= row1 or col0 >= col1:
            return
        for part in spot.parts.values():
            a, b, c, d = max(row0, part.row), min(row1, part.row1), max(col0, part.col), min(col1, part.col1)
            if a < b and c < d:
                found = self._read(part, a - part.row, b - part.row, c - part.col, d - part.col)
                top, left = at[0] - row, at[1] - col
                out[a + top : b + top, c + left : d + left] = found

    def _read(self, part: Part, *window: int) -> Heights:
        """Samples of a part; a damaged one is removed from the cache."""
        path = part.kept.part(part.row, part.col)
        try:
            try:
                return self._file(path).read(*window)
            except ReadError:  # another process may have replaced it
                with self._lock:
                    self._files.pop(path, None)
                return self._file(path).read(*window)
        except ReadError as error:
            remove(path)
            raise ReadError(
                error.what, path=path, remedy="It was a cached copy and has been removed: run it again."
            ) from error

    def _file(self, path: Path) -> Source:
        """The open file of a part."""
        with self._lock:
            if path not in self._files:
                self._files[path] = Source.open(path)
            return self._files[path]


def _size(piece: Piece) -> tuple[int, int]:
    return piece.row1 - piece.row0, piece.col1 - piece.col0


def _within(out: Heights, first: tuple[int, int], row: int, col: int, size: tuple[int, int]) -> Heights:
    """The part of an array, whose first sample is ``first``, that lies in a rectangle."""
    rows, cols = out.shape
    top, left = max(row - first[0], 0), max(col - first[1], 0)
    return out[
        top : max(min(row - first[0] + size[0], rows), top), left : max(min(col - first[1] + size[1], cols), left)
    ]
