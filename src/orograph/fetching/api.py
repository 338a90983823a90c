"""``orograph.fetch``: heights of an area from open elevation products."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, overload

from orograph._named import answering
from orograph.errors import UsageError
from orograph.fetching.areas import asked
from orograph.fetching.reading import CONNECTIONS
from orograph.fetching.request import MOST, Request
from orograph.folders import Amount, bytes_of
from orograph.progress import Progress
from orograph.reporting import reporting

if TYPE_CHECKING:
    from orograph.dem.raster import Dem
    from orograph.dem.undulation import Direction
    from orograph.store.stored import StoredTerrain


class Fetching(TypedDict, total=False):
    """The options of ``fetch`` as type checkers and editors know them; a test compares them."""

    bbox: Any
    at: Any
    radius: float | None
    geojson: Any
    zoom: int | None
    absent: str | None
    table: str | os.PathLike[str] | None
    to_vertical: Direction | None
    geoid: Any
    most: Amount | None
    connections: int
    overwrite: bool
    resume: bool
    max_memory: Amount | None
    jobs: int | None
    progress: Progress | bool | None


@overload
def fetch(area: Any = None, product: str = ..., *, output: None = None, **options: Unpack[Fetching]) -> Dem: ...


@overload
def fetch(
    area: Any = None, product: str = ..., *, output: str | os.PathLike[str] | None, **options: Unpack[Fetching]
) -> Dem | StoredTerrain: ...


@answering
def fetch(
    area: Any = None,
    product: str = "copernicus-30",
    *,
    bbox: Any = None,
    at: Any = None,
    radius: float | None = None,
    geojson: Any = None,
    output: str | os.PathLike[str] | None = None,
    zoom: int | None = None,
    absent: str | None = None,
    table: str | os.PathLike[str] | None = None,
    to_vertical: Direction | None = None,
    geoid: Any = None,
    most: Amount | None = MOST,
    connections: int = CONNECTIONS,
    overwrite: bool = False,
    resume: bool = False,
    max_memory: Amount | None = None,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
) -> Dem | StoredTerrain:
    """Heights of an area from an open elevation product; what was read is cached for later calls.

    Args:
        area: (west, south, east, north) in degrees, east < west across the 180th meridian; (longitude, latitude) with
            ``radius``; a GeoJSON object, or one with ``__geo_interface__``: the box around it.
        product: its name (``orograph.fetching.products``).
        bbox, at, geojson: the area in one form: the four numbers; the place, with ``radius``; the geometry, or a
            GeoJSON file. radius: metres around a place.
        output: a GeoTIFF (.tif) or a store (.oro) to write; None: only the Dem.
        zoom: of web-mercator tiles; None: the product's. absent: "sea" or "missing": the meaning of an absent tile,
            instead of the product's. table: a file of more products.
        to_vertical, geoid: as for ``orograph.build``.
        most: bytes of heights that may be read; None: any number. connections: simultaneous requests.
        overwrite: replace an existing output. resume: finish an interrupted store.
        max_memory, jobs: bytes and threads that building a store may take.
        progress: gets progress reports; False: silent.

    Returns:
        a Dem on the product's own grid (metres, above its vertical datum), or the store.

    Raises:
        UsageError: the area is invalid, there is no such product, or it exceeds ``most``.
        ReadError: a server does not deliver a tile; the message names the tile and a remedy.
        OutputError, StoreError: a result cannot be written.
    """
    max_memory, most = bytes_of(max_memory), bytes_of(most, "most")
    area = asked(area, bbox, at, radius, geojson)
    out = None if output is None else Path(os.fspath(output))
    if out is not None and out.suffix.lower() not in (".tif", ".tiff", ".oro"):
        raise UsageError(
            "The result can only be written as a GeoTIFF or a store.", path=out, remedy="Use .tif or .oro."
        )
    request = Request(
        area, product, radius=radius, table=table, zoom=zoom, absent=absent, to_vertical=to_vertical, geoid=geoid,
        most=most, connections=connections, progress=reporting(progress),
    )  # fmt: skip
    if out is not None and out.suffix.lower() == ".oro":
        taken = {name: value for name, value in (("max_memory", max_memory), ("jobs", jobs)) if value is not None}
        store: StoredTerrain = request.build(os.fspath(out), overwrite=overwrite, resume=resume, **taken)
        return store
    request.check_memory()
    if out is not None:
        request.write(out, overwrite)
    return request.dem()
