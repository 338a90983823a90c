"""A request: planned first, so that its size is known before reading; then read into a Dem, a GeoTIFF or a store."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from orograph.dem.lattice import group
from orograph.dem.projection import flat_crs
from orograph.dem.raster import MAX_READ_BYTES, Dem
from orograph.dem.undulation import ConvertedLattice, Direction, check_datums, check_request
from orograph.errors import ReadError, UsageError
from orograph.fetching.areas import Box, area_of
from orograph.fetching.cached import in_use
from orograph.fetching.geotiff import write_geotiff
from orograph.fetching.products import Product, product_named, products
from orograph.fetching.raster import Fetched
from orograph.fetching.reading import CONNECTIONS, Reader
from orograph.fetching.tiling import Layout, lay_out
from orograph.geo.ellipsoid import BODIES
from orograph.geo.vertical import Geoid
from orograph.output import check_vacant
from orograph.progress import SILENT, Progress
from orograph.store.kept import make_room

MOST = 1 << 30
"""Default maximum bytes of heights to fetch."""

STRIP = 512


@dataclass(frozen=True, slots=True)
class Plan:
    """The plan of a request.

    Attributes:
        product: the product. box: the area. layout: its grid and tiles.
    """

    product: Product
    box: Box
    layout: Layout

    @property
    def samples(self) -> int:
        rows, cols = self.layout.grid.shape
        return rows * cols

    @property
    def bytes(self) -> int:
        """Maximum bytes to read, before compression; tiles that are read whole count completely."""
        item = np.dtype(self.product.dtype).itemsize
        pieces = [piece for band in self.layout.bands for piece in band.pieces]
        if not self.product.by_file:
            return item * sum((p.row1 - p.row0) * (p.col1 - p.col0) for p in pieces)
        tiles = {piece.tile.key: piece.tile.grid for piece in pieces}
        return item * sum(256 * 256 if grid is None else grid.rows * grid.cols for grid in tiles.values())

    def __str__(self) -> str:
        rows, cols = self.layout.grid.shape
        tiles = len(self.layout.tiles)
        return (
            f"{self.product.title}, {self.box}: {tiles:,} tile{'' if tiles == 1 else 's'}, {rows:,} × {cols:,} "
            f"samples, at most {self.bytes / 1e6:,.1f} MB to read before compression"
        )


class Request:
    """A request for an area of a product.

    Args:
        area, radius: as for ``fetch``. product: its name. table: a file of products.
        zoom: of web-mercator tiles. absent: "sea" or "missing", instead of the product's.
        to_vertical, geoid: as for ``Mosaic.open``.
        most: bytes of heights that may be read; None: any number.
        connections: requests at once.

    Attributes:
        plan: its size. product: the product.
    """

    def __init__(
        self,
        area: Any,
        product: str = "copernicus-30",
        *,
        radius: float | None = None,
        table: str | os.PathLike[str] | None = None,
        zoom: int | None = None,
        absent: str | None = None,
        to_vertical: Direction | None = None,
        geoid: Geoid | str | os.PathLike[str] | None = None,
        most: int | None = MOST,
        connections: int = CONNECTIONS,
        progress: Progress = SILENT,
    ) -> None:
        check_request(to_vertical, geoid)
        if absent not in (None, "sea", "missing"):
            raise UsageError(f"An absent tile must be sea or missing, not {absent!r}.")
        self.product = product_named(product, table)
        body = BODIES[self.product.body.lower()]
        box = area_of(area, radius, body)
        if zoom is not None and self.product.tiling != "web-mercator":
            raise UsageError(f"{product} has no zooms.", remedy="Leave out `zoom`.")
        self.sea = (absent or self.product.absent) == "sea"
        self.to_vertical, self.progress = to_vertical, progress
        self.geoid = None if to_vertical is None or geoid is None else _geoid(self.product, box, to_vertical, geoid)
        self.reader = Reader(self.product, products(table), connections, progress)
        header = None
        if self.product.tiling == "one":
            with in_use():
                header = self.reader.header_of_one()
        self.plan = Plan(self.product, box, lay_out(self.product, box, zoom, header))
        if most is not None and self.plan.bytes > most:
            raise UsageError(
                f"{self.plan}. That is more than {most / 2**20:,.0f} MiB.",
                remedy="Allow it (`most=None`), or choose a smaller area or a coarser product.",
            )

    @contextlib.contextmanager
    def fetched(self) -> Iterator[Fetched]:
        """The raster; while this is open its parts stay in the cache.

        Raises:
            ReadError: a server does not give a tile. OutputError: the cache cannot be written.
        """
        plan = self.plan
        with in_use():
            self.reader.read([piece for band in plan.layout.bands for piece in band.pieces])
            name = f"{plan.product.name} {plan.box}"
            raster = Fetched(plan.product, plan.layout, self.reader, name, self.sea)
            if raster.missing == len(plan.layout.tiles):
                raise ReadError(
                    f"{plan.product.title} has no heights at {plan.box}: none of its tiles exists.",
                    remedy="Choose another product (`orograph.fetching.products()`).",
                )
            self._tell(raster)
            yield raster
        make_room(self.progress)

    def dem(self) -> Dem:
        """The heights in memory."""
        self.check_memory()
        with self.fetched() as raster:
            source = self._converted(raster)
            rows, cols = raster.grid.shape
            heights = np.empty((rows, cols), np.float32)
            for row in range(0, rows, STRIP):
                end = min(row + STRIP, rows)
                heights[row:end] = source.read(row, end, 0, cols)
        return Dem(heights, raster.grid, self.vertical(raster), raster.name, raster.attribution)

    def write(self, path: Path, overwrite: bool = False) -> None:
        """Write a GeoTIFF.

        Raises:
            OutputError: it cannot be written, or the file exists.
        """
        check_vacant(path, overwrite)
        with self.fetched() as raster:
            source = self._converted(raster)
            write_geotiff(path, source, raster, self.vertical(raster), self.progress)

    def build(self, url: str, **options: Any) -> Any:
        """Build a store and open it; options as for ``store.build``."""
        from orograph.dem.mosaic import Mosaic
        from orograph.store.build import build

        with self.fetched() as raster:
            mosaic = Mosaic([raster], crs=self._flat(raster), to_vertical=self.to_vertical, geoid=self.geoid)
            for warning in mosaic.warnings:
                self.progress.warn(warning)
            return build(mosaic, url, progress=self.progress, **options)

    def check_memory(self) -> None:
        """Raise UsageError if the heights exceed the limit of a Dem."""
        if self.plan.samples * 4 > MAX_READ_BYTES:
            raise UsageError(
                f"{self.plan}. That is more than fits into a Dem ({MAX_READ_BYTES >> 30} GiB).",
                remedy='Give `output="area.oro"`: a store is read tile by tile.',
            )

    def vertical(self, raster: Fetched) -> str | None:
        """The vertical datum of the result."""
        if self.geoid is None:
            return raster.vertical
        return self.geoid.ellipsoidal_datum if self.to_vertical == "ellipsoidal" else self.geoid.datum

    def _converted(self, raster: Fetched) -> Fetched | ConvertedLattice:
        """The raster above the requested datum."""
        if self.to_vertical is None or self.geoid is None:
            return raster
        return ConvertedLattice(group([raster], [raster.grid])[0], self.geoid, self.to_vertical)

    def _flat(self, raster: Fetched) -> CRS | None:
        """A CRS that is true to scale in place of web Mercator; None: the one that a mosaic chooses."""
        if self.product.tiling != "web-mercator":
            return None
        box = self.plan.box
        lon, lat = np.meshgrid(np.linspace(box.west, box.east, 9), np.linspace(box.south, box.north, 9))
        return flat_crs(CRS.from_epsg(4326), lon.ravel(), lat.ravel()).crs

    def _tell(self, raster: Fetched) -> None:
        """Messages for the user about what was fetched."""
        tell, product = self.progress.warn, self.product
        tiles = len(self.plan.layout.tiles)
        if raster.sea:
            self.progress.note(f"{raster.sea} of {tiles} tiles are absent: sea, at 0 m")
        if raster.missing:
            withheld = sum(record.status == "withheld" for record in self.reader.records.values())
            other = f"; {product.witness} has some of them" if withheld and product.witness else ""
            tell(f"{raster.missing} of {tiles} tiles of {product.name} are absent: heights are missing{other}.")
        if raster.resampled:
            tell(
                "Columns of the northern or southern tiles are farther apart: their rows are interpolated to the "
                "columns of the others."
            )
        if self.reader.stale:
            tell(
                f"{product.base} cannot be reached: {len(self.reader.stale)} tiles are used as cached more than a "
                "week ago."
            )


def _geoid(product: Product, box: Box, to: Direction, geoid: Geoid | str | os.PathLike[str]) -> Geoid:
    """The geoid grid that converts a product's heights, opened before any are read.

    Raises:
        UsageError: it is not for their datum.
        ReadError: it cannot be read.
    """
    if product.datum is None:
        raise UsageError(
            f"The heights of {product.name} have no single datum, so they cannot be converted.",
            remedy="Choose another product (`orograph.fetching.products()`), or leave out `to_vertical`.",
        )
    grid = geoid if isinstance(geoid, Geoid) else Geoid.open(geoid, latitudes=(box.south - 0.1, box.north + 0.1))
    check_datums([_Named(product.name, product.datum)], to, grid)
    return grid


@dataclass(frozen=True, slots=True)
class _Named:
    """The properties that ``check_datums`` uses."""

    name: str
    vertical: str
