"""Read tiles from their servers into the cache: which exist, their headers, and the needed parts.

There are three rounds, each for several tiles or parts at once: servers are asked about tiles (``asking``); GDAL opens
those that exist (range reads, ``/vsicurl/``); and it reads the parts, blocks of the file, that the area needs and the
cache lacks. Failed parts are retried after ``asking.PAUSES``; before that the server is asked for the reason, so that
an error can state it. Units: samples of the tile's file.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from affine import Affine
from pyproj import CRS

from orograph.dem.lattice import offset_between
from orograph.dem.source import Source
from orograph.errors import OrographError, ReadError
from orograph.fetching import asking
from orograph.fetching.asking import Answer, ask, public
from orograph.fetching.cached import Header, KeptTile, Record
from orograph.fetching.products import Product
from orograph.fetching.tiling import Piece, Tile, lay_out, one_tile
from orograph.geo.grid import Grid
from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress

CONNECTIONS = 4
"""Default number of simultaneous requests."""

PART = 512
"""Minimum rows and columns of a part, if the file's blocks are smaller."""


@dataclass(frozen=True, slots=True)
class Part:
    """A block of a tile's file: its first row and column, and those behind its last."""

    kept: KeptTile
    row: int
    col: int
    row1: int
    col1: int


class Reader:
    """Reads a product's tiles into the cache.

    Args:
        product: the product.
        others: all products, for witnesses.
        connections: requests at once.

    Attributes:
        records: the record of each tile, by its key.
        stale: tiles whose server could not be asked again, used as cached.
    """

    def __init__(
        self, product: Product, others: dict[str, Product], connections: int = CONNECTIONS, progress: Progress = SILENT
    ) -> None:
        self.product, self.others, self.connections, self.progress = product, others, connections, progress
        self.records: dict[str, Record] = {}
        self.stale: list[str] = []
        self._sources: dict[str, Source] = {}
        self._settings: dict[str, Any] = {}

    def header_of_one(self) -> Grid:
        """The grid of a product of one file."""
        tile = one_tile(self.product)
        with self._gdal():
            record = self._prepared(tile, ())
        if record.header is None:
            raise self._error(tile, "it is not there", "Check whether its makers have moved it, and set its base.")
        crs = CRS.from_wkt(record.header.crs) if record.header.crs else CRS.from_user_input(self.product.crs)
        return Grid(record.header.shape, Affine(*record.header.transform), crs)

    def read(self, pieces: Sequence[Piece]) -> None:
        """Put into the cache what these pieces need.

        Raises:
            ReadError: a server does not deliver it. OutputError: the cache cannot be written.
        """
        by_tile: dict[str, list[Piece]] = {}
        for piece in pieces:
            by_tile.setdefault(piece.tile.key, []).append(piece)
        with self._gdal():
            groups = list(by_tile.values())
            for group in groups:
                KeptTile(self.product, group[0].tile).use()
            with self.progress.task(f"Asking for {_count(len(groups), 'tile')}", total=len(groups)) as task:
                work = map_ordered(lambda group: self._prepared(group[0].tile, group), groups, self.connections)
                for group, record in zip(groups, work):
                    self.records[group[0].tile.key] = record
                    task.advance()
            lacking = [
                part
                for group in groups
                for part in self.parts(group)
                if not part.kept.part(part.row, part.col).exists()
            ]
            with self.progress.task(f"Reading {_count(len(lacking), 'part')}", total=len(lacking)) as task:
                for _ in map_ordered(self._load, lacking, self.connections):
                    task.advance()

    def parts(self, pieces: Sequence[Piece]) -> list[Part]:
        """The parts that contain pieces of one tile; none for a tile that does not exist."""
        tile = pieces[0].tile
        record = self.records[tile.key]
        return [] if record.header is None else self._parts(KeptTile(self.product, tile), record.header, pieces)

    def _parts(self, kept: KeptTile, header: Header, pieces: Sequence[Piece]) -> list[Part]:
        """The parts of a file that contain pieces, each once, with the rows and columns shared with others."""
        high, wide = header.block
        rows, cols = header.shape
        wanted: dict[tuple[int, int], None] = {}
        more = int(self.product.shared)
        for piece in pieces:
            row0, row1 = header.row + piece.row0, min(header.row + piece.row1 + more, rows)
            col0, col1 = header.col + piece.col0, min(header.col + piece.col1 + more, cols)
            for i in range(row0 // high, -(-row1 // high)):
                for j in range(col0 // wide, -(-col1 // wide)):
                    wanted[i * high, j * wide] = None
        return [Part(kept, row, col, min(row + high, rows), min(col + wide, cols)) for row, col in wanted]

    @contextmanager
    def _gdal(self) -> Iterator[None]:
        """A context with GDAL's settings; closes its files at the end."""
        with asking.gdal_settings(self.product) as self._settings:
            try:
                yield
            finally:
                for source in self._sources.values():
                    source.close()
                self._sources.clear()

    def _prepared(self, tile: Tile, pieces: Sequence[Piece]) -> Record:
        """The record of a tile, requested if needed; with a header if it exists."""
        if not tile.covered:
            return Record("withheld", time.time())
        kept = KeptTile(self.product, tile)
        known = kept.record()
        complete = known is not None and (known.status != "there" or known.header is not None)
        if known is not None and known.header is not None and pieces:
            complete = all(kept.part(p.row, p.col).exists() for p in self._parts(kept, known.header, pieces))
        if known is not None and complete and known.fresh:
            return known
        answer = ask(tile.url, etag=known.etag if known else "", modified=known.modified if known else "")
        if known is not None and known.status == "there" and answer.code == 304:
            known = kept.touch(known)
        elif known is not None and complete and not answer.there and answer.passing:
            self.stale.append(tile.key)  # there is no network: use the cached record
            return known
        else:
            known = self._record_of(kept, known, answer)
        if known.status == "there" and known.header is None:
            known = replace(known, header=self._opened(tile))
            kept.put_record(known)
        return known

    def _record_of(self, kept: KeptTile, known: Record | None, answer: Answer) -> Record:
        """A tile's record by its server's answer."""
        tile = kept.tile
        if answer.there:
            if known is not None and known.status == "there" and known.state == answer.state:
                return kept.touch(known)
            kept.clear()
            record = Record("there", time.time(), answer.etag, answer.modified, answer.size)
        elif answer.code in self.product.absent_codes:
            kept.clear()
            record = Record("withheld" if self._withheld(tile) else "absent", time.time())
        else:
            raise self._refused(tile, answer)
        kept.put_record(record)
        return record

    def _withheld(self, tile: Tile) -> bool:
        """Whether another product has this tile, which proves that it is not sea."""
        witness = self.others.get(self.product.witness)
        if witness is None or self.product.absent != "sea" or tile.grid is None:
            return False
        other = _same_tile(witness, tile)
        answer = ask(other.url)
        if answer.there or answer.code in witness.absent_codes:
            return answer.there
        raise self._refused(other, answer)

    def _opened(self, tile: Tile) -> Header:
        """The header of a tile's file."""
        source = self._attempted(tile, partial(self._source, tile), "opened")
        whole = self.product.by_file
        rows, cols = source.shape
        at = self._place(tile, source.grid, (rows, cols))
        dtype, nodata = source.code
        crs = source.grid.crs
        if not (crs is None or self.product.tiling == "one"):
            crs = tile.grid.crs if tile.grid is not None else crs
        return Header(
            (rows, cols), *at, (rows, cols) if whole else _part_shape(source.block, (rows, cols)),
            tuple(source.grid.transform[:6]), "" if crs is None else crs.to_wkt(), dtype,
            None if dtype == "float32" else int(nodata),
        )  # fmt: skip

    def _place(self, tile: Tile, grid: Grid, shape: tuple[int, int]) -> tuple[int, int]:
        """(row, col) in a tile's file of the first sample that the tile owns."""
        if self.product.tiling == "one":
            return 0, 0
        if tile.grid is None:
            if shape != (256, 256):
                raise self._error(tile, f"it has {shape[0]} × {shape[1]} samples, not 256 × 256", _REPORT)
            return 0, 0
        own = Grid(tile.grid.shape, tile.grid.transform, grid.crs)
        at = offset_between(own, grid)
        rows, cols = own.shape
        if at is None:
            raise self._error(
                tile, f"its samples are not those of the product: {_described(grid)}, not {_described(own)}", _REPORT
            )
        if at[0] < 0 or at[1] < 0 or at[0] + rows > shape[0] or at[1] + cols > shape[1]:
            raise self._error(
                tile, f"it has {shape[0]} × {shape[1]} samples, which are not all of its {rows} × {cols}", _REPORT
            )
        return at

    def _source(self, tile: Tile) -> Source:
        """The open file of a tile; the same one each time."""
        if tile.key not in self._sources:
            product = self.product
            source = Source.open(tile.location, nodata=product.nodata, encoding=product.encoding or None)
            if product.scale != 1 and source.scale == 1:
                source = replace(source, scale=product.scale)
            self._sources[tile.key] = source
        return self._sources[tile.key]

    def _load(self, part: Part) -> None:
        """Read a part into the cache."""
        kept, tile = part.kept, part.kept.tile
        header = self.records[tile.key].header
        assert header is not None

        def read() -> Any:
            return self._source(tile).read(part.row, part.row1, part.col, part.col1)

        what = f"read at rows {part.row}–{part.row1 - 1}, columns {part.col}–{part.col1 - 1}"
        heights = self._attempted(tile, read, what)
        kept.put_part(header, part.row, part.col, heights)

    def _attempted(self, tile: Tile, work: Any, what: str) -> Any:
        """Run a GDAL operation on a file, with retries where they may help."""
        import rasterio

        for pause in [*asking.PAUSES, None]:
            try:
                with rasterio.Env(**self._settings):
                    return work()
            except ReadError as error:
                self._sources.pop(tile.key, None)
                answer = ask(tile.url, again=False)
                if not answer.there and not answer.passing:
                    raise self._refused(tile, answer) from error
                if pause is None:
                    if not answer.there:
                        raise self._refused(tile, answer) from error
                    cause = self._own(error)
                    raise self._error(
                        tile, f"it repeatedly cannot be {what}: {cause}",
                        "Run it again later (what was read is kept); if the error persists, the tile is damaged on "
                        "the server.",
                    ) from error  # fmt: skip
            time.sleep(pause)
        raise AssertionError

    def _own(self, error: OrographError) -> str:
        """GDAL's error message, without the URL."""
        return error.what.replace(f"/vsicurl/{self.product.base}", "").rstrip(".")

    def _refused(self, tile: Tile, answer: Answer) -> ReadError:
        account = self.product.account
        if account and answer.code in (401, 403):
            return self._error(
                tile, f"{answer}, for it needs an account: {account}",
                f"Create one there, and add a line to ~/.netrc: machine {self.product.machine} login NAME password "
                "WORD (or set GDAL_HTTP_BEARER to a token); or use a mirror that needs none "
                "(`orograph.fetching.products()`).",
            )  # fmt: skip
        if answer.passing:
            return self._error(
                tile, str(answer), "Run it again later: what was read is kept, and it continues from there."
            )
        return self._error(
            tile, str(answer), "Check whether its makers have moved it, and then set its base; or, if that answer "
                               "means that there is no such tile, add it to absent_codes (docs/fetching.md)."
        )  # fmt: skip

    def _error(self, tile: Tile, cause: str, remedy: str) -> ReadError:
        return ReadError(
            f"{self.product.name}, tile {tile.key}: {cause}.", path=public(tile.url), remedy=remedy
        )  # fmt: skip


_REPORT = "The product's entry in the table of products does not match its files."


def _same_tile(witness: Product, tile: Tile) -> Tile:
    """A tile of another product that lies at the same place."""
    from orograph.fetching.areas import Box

    assert tile.grid is not None
    west, south, east, north = tile.grid.bounds()
    lon, lat = (west + east) / 2, (south + north) / 2
    return lay_out(witness, Box(lon, lat, lon + 1e-9, lat + 1e-9)).tiles[0]


def _part_shape(block: tuple[int, int], shape: tuple[int, int]) -> tuple[int, int]:
    """(rows, cols) of the parts of a file: its blocks; several if they are small, and strips of full width."""
    rows, cols = (min(-(-PART // b) * b, s) for b, s in zip(block, shape))
    if block[1] >= shape[1] and shape[1] > 4 * PART:
        rows = min(-(-(PART // 8) // block[0]) * block[0], shape[0])
    return rows, cols


def _described(grid: Grid) -> str:
    """The place of samples, for people."""
    (x, y), (west, _, _, north) = grid.spacing, grid.bounds()
    return f"{x:.9g} × {y:.9g}° apart from {west:.9g}, {north:.9g}"


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
