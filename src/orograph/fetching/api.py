"""``orograph.fetch``: heights of a place out of open elevation products."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orograph.errors import UsageError
from orograph.fetching.request import MOST, Request
from orograph.progress import SILENT, Progress

if TYPE_CHECKING:
    from orograph.dem.raster import Dem
    from orograph.store.stored import StoredTerrain


def fetch(
    area: Any,
    product: str = "copernicus-30",
    *,
    radius: float | None = None,
    output: str | os.PathLike[str] | None = None,
    most: int | None = MOST,
    overwrite: bool = False,
    progress: Progress = SILENT,
    build: dict[str, Any] | None = None,
    **options: Any,
) -> Dem | StoredTerrain:
    """Heights of an area out of an open elevation product; what was read is kept, and not read again.

    Args:
        area: (west, south, east, north) in degrees, east < west across the 180th meridian; (longitude, latitude) with
            ``radius``; a GeoJSON object, or one with ``__geo_interface__``: the box around it.
        product: its name (``orograph.fetching.products``).
        radius: metres around a place.
        output: a GeoTIFF (.tif) or a store (.oro) to write; None: only the Dem.
        most: bytes of heights that may be read; None: any number.
        overwrite: replace an output that is there.
        build: options of ``orograph.build`` for a store.
        options: ``zoom`` of web-mercator tiles; ``absent``: "sea" or "missing", instead of what the product says an
            absent tile is; ``to_vertical`` and ``geoid``, as of ``orograph.build``; ``table``: a file of products;
            ``connections``: requests at once.

    Returns:
        a Dem on the product's own grid (metres, above its vertical datum), or the store.

    Raises:
        UsageError: the area is none, there is no such product, or it is more than ``most``.
        ReadError: a server does not give a tile; the message names it, and what to do.
        OutputError, StoreError: a result cannot be written.
    """
    out = None if output is None else Path(os.fspath(output))
    if out is not None and out.suffix.lower() not in (".tif", ".tiff", ".oro"):
        raise UsageError("What is fetched is written as a GeoTIFF or a store.", path=out, remedy="Use .tif or .oro.")
    request = Request(area, product, radius=radius, most=most, progress=progress, **options)
    if out is not None and out.suffix.lower() == ".oro":
        store: StoredTerrain = request.build(os.fspath(out), overwrite=overwrite, **(build or {}))
        return store
    request.check_memory()
    if out is not None:
        request.write(out, overwrite)
    return request.dem()
