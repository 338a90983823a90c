"""Open rasterio datasets as sources of heights: by their file where they have one, else by a copy in GDAL's memory.

So nodata, masks, scales, units and damage are handled as for any file (``source``). A virtual dataset (``WarpedVRT``)
or one made in memory becomes a GeoTIFF in GDAL's memory for as long as it takes to read it.
"""

from __future__ import annotations

import uuid
from typing import Any

from orograph.dem.raster import MAX_READ_BYTES, Dem
from orograph.dem.source import Source
from orograph.errors import ReadError, UsageError


def is_dataset(thing: Any) -> bool:
    """Whether something is a rasterio dataset, without importing rasterio."""
    kind = type(thing)  # (whose attributes can be looked at also where the dataset is closed)
    return kind.__module__.partition(".")[0] == "rasterio" and hasattr(kind, "read") and hasattr(kind, "gcps")


def file_of(dataset: Any) -> str | None:
    """The name by which GDAL reopens a dataset's file; None if it has none.

    Raises:
        UsageError: it is closed, or open for writing.
    """
    if dataset.closed:
        raise UsageError("The dataset is closed.", path=dataset.name, remedy="Open it again, or give its path.")
    if dataset.mode != "r":
        raise UsageError(
            "The dataset is open for writing, so its content may still change.", path=dataset.name,
            remedy="Close it, and give its path.",
        )  # fmt: skip
    virtual = type(dataset).__name__ == "WarpedVRT" or dataset.driver == "MEM" or dataset.name.startswith("/vsimem/")
    return None if virtual else str(dataset.name)


def from_dataset(dataset: Any, window: Any = None, *, name: str | None = None, **options: Any) -> Dem:
    """Read a dataset, or a window of it, into memory.

    Args:
        dataset: of rasterio's, open for reading.
        window: a ``rasterio.windows.Window``, or ((row0, row1), (col0, col1)), in its own pixels; None: all of it.
        name: its name. Default: its file's stem.
        options: those of ``Source.open``.

    Raises:
        ReadError: it cannot be read, or is too large. UsageError: the window is not inside it.
    """
    path = file_of(dataset)
    if path is not None:
        with Source.open(path, **options) as source:
            return _read(source, window, name)
    from rasterio.io import MemoryFile
    from rasterio.shutil import copy

    called = name or str(dataset.name).rpartition("/")[2].partition(".")[0] or "dataset"
    with MemoryFile(filename=f"{uuid.uuid4().hex}/{called}.tif") as held:
        copy(dataset, held.name, driver="GTiff")
        with Source.open(held.name, **options) as source:
            return _read(source, window, called)


def _read(source: Source, window: Any, name: str | None) -> Dem:
    rows, cols = source.shape
    if window is None:
        box = 0, rows, 0, cols
    else:
        box = source.turned(*_box(window, rows, cols))
    if (box[1] - box[0]) * (box[3] - box[2]) * 4 > MAX_READ_BYTES:
        raise ReadError(
            f"Its {box[1] - box[0]} × {box[3] - box[2]} heights do not fit into {MAX_READ_BYTES >> 30} GiB.",
            path=source.path, remedy="Give its path, or a smaller window.",
        )  # fmt: skip
    return Dem(source.read(*box), source.grid.window(*box), source.vertical, name or source.name, source.attribution)


def _box(window: Any, rows: int, cols: int) -> tuple[int, int, int, int]:
    """(row0, row1, col0, col1) of a window, whole pixels."""
    try:
        (row0, row1), (col0, col1) = window.toranges() if hasattr(window, "toranges") else window
        box = tuple(round(float(v)) for v in (row0, row1, col0, col1))
    except (TypeError, ValueError):
        raise UsageError(
            f"A window must be a rasterio.windows.Window, or ((row0, row1), (col0, col1)), not {window!r}."
        ) from None
    if not (0 <= box[0] < box[1] <= rows and 0 <= box[2] < box[3] <= cols):
        raise UsageError(
            f"The window of rows {box[0]} to {box[1]} and columns {box[2]} to {box[3]} is not inside the dataset's "
            f"{rows} × {cols} samples."
        )
    return box[0], box[1], box[2], box[3]
