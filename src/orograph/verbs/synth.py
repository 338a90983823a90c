"""``orograph.synth``: a fractal terrain of any size, in memory or in a file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from orograph.dem.raster import Dem
from orograph.dem.synth import Synth, parse_size
from orograph.dem.target import parse_crs
from orograph.errors import UsageError
from orograph.progress import Progress
from orograph.reporting import reporting


def synth(
    output: str | os.PathLike[str] | None = None,
    *,
    size: int | str | tuple[int, int] = 1025,
    seed: int = 1,
    spacing: float = 30.0,
    crs: Any = "EPSG:32633",
    relief: float | None = None,
    roughness: float = 1.0,
    compress: str = "zstd",
    overwrite: bool = False,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
) -> Dem | Path:
    """Make a fractal terrain: plains, and ranges carved by rivers. The same seed and size give the same heights.

    Args:
        output: the GeoTIFF to write, in blocks, so that any size works; None: the terrain is returned.
        size: samples of a side, or (rows, columns). seed: another number, another world.
        spacing: metres between samples. crs: a projected CRS.
        relief: metres from the lowest to the highest place; None: 6 % of the side, at most 2500.
        roughness: depth of the finer furrows: 0 smooth, 1 natural.
        compress: of the file: "zstd", "deflate" or "none". overwrite: replace one that is there.
        jobs: threads; None: all processors. progress: hears of it; False: nothing is said.

    Returns:
        a ``Dem``, or the path of the file.

    Raises:
        UsageError: an option makes no sense, or the file is there. OutputError: it cannot be written.
    """
    shape = tuple(size) if isinstance(size, tuple | list) else parse_size(str(size))
    if len(shape) != 2 or min(shape) < 2:
        raise UsageError(f"The size is a number of samples, or (rows, columns), not {size!r}.")
    made = Synth(
        (int(shape[0]), int(shape[1])), seed, spacing=spacing, crs=parse_crs(crs), relief=relief, roughness=roughness
    )
    heard = reporting(progress)
    if output is None:
        made.prepare(heard)
        rows, cols = made.grid.shape
        return Dem(made.read(0, rows, 0, cols), made.grid, None, f"synth {seed}")
    path = Path(output)
    if path.exists() and not overwrite:
        raise UsageError("Something is there already.", path=path, remedy="Replace it with `overwrite=True`.")
    made.write(path, compress=compress, jobs=jobs, progress=heard)
    return path
