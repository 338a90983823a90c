"""Cached parts of tiles: a record of each tile, and its parts as small GeoTIFFs.

    tiles/PRODUCT-HASH/TILE/tile.json     its server's answer and time; the header of an existing tile
    tiles/PRODUCT-HASH/TILE/r0-c1024.tif  a part, in the tile's own numbers: its first row and column

The hash is of the product's URL rule, so each mirror has its own folder. Each file appears complete (``Beside``), so a
killed run loses only the current part. While an area is assembled, a lock on ``tiles`` protects its tiles from
removal to make room (``store.kept``).
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from orograph.dem.writing import raster_file
from orograph.errors import OutputError
from orograph.fetching.products import Product
from orograph.fetching.tiling import Tile
from orograph.folders import cache_folder
from orograph.output import Beside, remove
from orograph.store.kept import TILES

FRESH = 7 * 86400.0
"""Seconds for which a server's answer counts as current."""

Status = Literal["there", "absent", "withheld"]


@dataclass(frozen=True, slots=True)
class Header:
    """The header of a tile's file.

    Attributes:
        shape: its (rows, cols). row, col: of the first sample that the tile owns. block: of its parts.
        transform, crs: where it lies; crs as WKT, "" if it has none.
        dtype, nodata: of the numbers stored in parts; nodata None is NaN.
    """

    shape: tuple[int, int]
    row: int
    col: int
    block: tuple[int, int]
    transform: tuple[float, ...]
    crs: str
    dtype: str
    nodata: int | None

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Header:
        fields = {**values, "shape": tuple(values["shape"]), "block": tuple(values["block"])}
        return cls(**{**fields, "transform": tuple(values["transform"])})


@dataclass(frozen=True, slots=True)
class Record:
    """The record of a tile.

    Attributes:
        status: "there"; "absent"; "withheld": its makers have it and do not publish it.
        asked: when its server was asked, seconds since 1970. etag, modified, size: its answer.
        header: None: not opened yet.
    """

    status: Status
    asked: float
    etag: str = ""
    modified: str = ""
    size: int | None = None
    header: Header | None = None

    @property
    def fresh(self) -> bool:
        return 0 <= time.time() - self.asked < FRESH

    @property
    def state(self) -> tuple[str, str, int | None]:
        """As ``Answer.state``."""
        return self.etag, "" if self.etag else self.modified, self.size


class KeptTile:
    """A tile's folder in the cache.

    Attributes:
        path: of the folder. tile: which one.
    """

    def __init__(self, product: Product, tile: Tile) -> None:
        rule = f"{product.base} {product.url} {product.member} {product.nodata} {product.scale} {product.encoding}"
        place = f"{product.name}-{hashlib.sha256(rule.encode()).hexdigest()[:8]}"
        self.tile, self.path = tile, tiles_folder() / place / tile.key

    def record(self) -> Record | None:
        """Its record; None: unknown."""
        try:
            values = json.loads((self.path / "tile.json").read_text(encoding="utf-8"))
            header = values.pop("header")
            return Record(**values, header=None if header is None else Header.from_json(header))
        except (OSError, ValueError, TypeError, KeyError):
            return None

    def put_record(self, record: Record) -> None:
        with self._writing(), Beside(self.path / "tile.json") as part:
            part.write_text(json.dumps(asdict(record)), encoding="utf-8")

    def touch(self, record: Record) -> Record:
        """Record that its server was just asked, and that the tile is unchanged."""
        now = replace(record, asked=time.time())
        self.put_record(now)
        return now

    def use(self) -> None:
        """Mark it as just used: the least recently used is removed first."""
        with contextlib.suppress(OSError):
            os.utime(self.path)

    def clear(self) -> None:
        """Remove it from the cache."""
        for file in self.path.glob("*"):
            if file.suffix in (".tif", ".json"):
                remove(file)

    def part(self, row: int, col: int) -> Path:
        """The file of a part that begins at (row, col) of the tile's file."""
        return self.path / f"r{row}-c{col}.tif"

    def put_part(self, header: Header, row: int, col: int, heights: NDArray[np.float32]) -> None:
        """Keep heights (float32 metres, NaN where missing) of a part."""
        import rasterio

        if header.nodata is None:
            values: NDArray[Any] = heights
        else:
            values = np.where(np.isnan(heights), header.nodata, heights).astype(header.dtype)
        a, b, c, d, e, f = header.transform
        rows, cols = heights.shape
        profile = {
            "driver": "GTiff", "width": cols, "height": rows, "count": 1, "dtype": values.dtype.name,
            "compress": "zstd", "predictor": 3 if values.dtype.kind == "f" else 2, "zstd_level": 1,
            "nodata": float("nan") if header.nodata is None else header.nodata,
            "transform": Affine(a, b, c + a * col, d, e, f + e * row), "crs": header.crs or None,
        }  # fmt: skip

        with (
            self._writing(),
            raster_file(self.part(row, col), keep=True) as part,
            rasterio.open(part, "w", **profile) as file,
        ):
            file.write(values, 1)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """A context around writing one of its files."""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            yield
        except (OSError, OutputError) as error:
            cause = error.what if isinstance(error, OutputError) else f"{error.strerror or error}."
            raise OutputError(
                f"What was read cannot be cached: {cause}", path=self.path,
                remedy="Set OROGRAPH_CACHE to a writable folder with enough room.",
            ) from error  # fmt: skip


def tiles_folder() -> Path:
    """The folder of cached tiles."""
    return cache_folder() / TILES


@contextlib.contextmanager
def in_use() -> Any:
    """Protects all tiles in the cache from removal while it is open."""
    from orograph.store.kept import Use

    folder = tiles_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"The cache folder cannot be made: {error.strerror}.", path=folder,
            remedy="Set OROGRAPH_CACHE to a writable folder with enough room.",
        ) from error  # fmt: skip
    use = Use(folder)
    try:
        yield
    finally:
        use.release()
