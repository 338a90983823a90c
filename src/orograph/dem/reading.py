"""``orograph.read``: one raster as a whole."""

from __future__ import annotations

import math
import os
from functools import partial

import numpy as np

from orograph._named import answering
from orograph.dem.inspect import doubtful_heights
from orograph.dem.raster import MAX_READ_BYTES, Dem
from orograph.dem.source import Source
from orograph.errors import ReadError, UsageError
from orograph.folders import Amount, bytes_of
from orograph.progress import Progress
from orograph.reporting import reporting

PART = "`orograph.terrain(path, bbox=(7, 45, 8, 46))` reads a part, of stores too; `orograph.export` writes it."


@partial(answering, elsewhere=dict.fromkeys(("bbox", "clip", "crs", "resolution"), PART))
def read(
    path: str | os.PathLike[str],
    *,
    band: int = 1,
    nodata: float | str | None = None,
    spacing: float | None = None,
    assume_crs: str | None = None,
    encoding: str | None = None,
    vertical_unit: str | None = None,
    assume_vertical: str | None = None,
    max_bytes: Amount = MAX_READ_BYTES,
    progress: Progress | bool | None = None,
) -> Dem:
    """Read a whole raster as a ``Dem``, and warn of what is doubtful. The options are those of ``Source.open``.

    Args:
        max_bytes: refuse rasters whose heights (float32) take more memory than this.
        progress: gets warnings; None: Python's; False: silent.

    Raises:
        ReadError: the file cannot be read, is damaged, or is too large.
        UsageError: an option does not apply to the file.
    """
    max_bytes = bytes_of(max_bytes, "max_bytes")
    if not isinstance(path, str | os.PathLike):
        raise UsageError(
            f"`orograph.read` reads one file, not {type(path).__name__}.",
            remedy="Use `orograph.terrain` for everything else.",
        )
    source = Source.open(
        path,
        band=band,
        nodata=nodata,
        spacing=spacing,
        assume_crs=assume_crs,
        encoding=encoding,
        vertical_unit=vertical_unit,
        assume_vertical=assume_vertical,
    )
    rows, cols = source.shape
    if rows * cols * 4 > max_bytes:
        raise ReadError(
            f"Its {rows} × {cols} heights would take {rows * cols * 4 / 2**30:,.1f} GiB of memory "
            f"(the limit is {max_bytes / 2**30:.1f} GiB).",
            path=path,
            remedy="Use `orograph.build` or `orograph.render`, which work in blocks, or read windows with Source.",
        )
    heard = reporting(progress)
    with source:
        heights = source.read(0, rows, 0, cols)
        low, high = (float(end.reduce(heights, axis=None)) for end in (np.fmin, np.fmax))
        doubts = [] if math.isnan(low) else doubtful_heights(source, low, high)
        for text in dict.fromkeys((*source.warnings, *doubts)):
            heard.warn(f"{source.name}: {text}")
    return Dem(heights, source.grid, source.vertical, source.name, source.attribution)
