"""Heights in every form that users have, as a reader of windows: files, arrays, DataArrays, open datasets.

``source_of`` is the only place that distinguishes them; ``store.opening.terrain`` makes a terrain from any of them.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orograph._named import check_simple, remedy
from orograph.errors import UsageError
from orograph.output import same_file
from orograph.progress import SILENT, Progress
from orograph.store.detect import is_store
from orograph.store.source import ArraySource, HeightSource, StoreSource
from orograph.store.typed import KINDS

if TYPE_CHECKING:
    from orograph.dem.raster import Dem
    from orograph.store.memory import MemoryTerrain
    from orograph.store.stored import StoredTerrain

TAKES = (
    "a path or URL of a DEM, of a folder of DEMs, of a file of points or of a store, a list of DEMs, a Dem, a Terrain, "
    "an xarray.DataArray or Dataset, an open rasterio dataset or (dataset, window), or an array of heights (with "
    "transform= and crs=)"
)
"""What every function that takes a terrain accepts."""

OF_FILES = ("band", "nodata", "spacing", "assume_crs", "encoding", "vertical_unit", "assume_vertical")
"""How to read a file; ``OF_ARRAYS`` also apply to heights in memory."""
OF_POINTS = ("max_edge", "height_column", "point_layer", "point_classes")
"""How points are read and become a surface (``dem.gridding``)."""
OF_LABELLED = ("nodata", "vertical_unit", "assume_vertical", "name")
"""How to read a DataArray, which has its own place."""
OF_ARRAYS = ("transform", "spacing", *OF_LABELLED)
OF_AREAS = ("bbox", "clip")
"""Which part of the ground to read (``dem.area``)."""
OF_GRIDS = ("crs", "resolution", "resampling", "to_vertical", "geoid", *OF_AREAS)
"""The grid of the terrain (``Mosaic.open``)."""

OF_MANY = ("skip_damaged",)
"""What to do if some of many files cannot be read (``Mosaic.open``)."""

READING = tuple(dict.fromkeys((*OF_GRIDS, *OF_FILES, *OF_POINTS, *OF_ARRAYS, *OF_MANY)))
"""All options of reading heights."""


def is_dataset(thing: Any) -> bool:
    """Whether something is a rasterio dataset (``dem.datasets``), without importing the reader."""
    if "rasterio" not in sys.modules:
        return False
    from orograph.dem import datasets

    return datasets.is_dataset(thing)


def files_of(given: Any) -> list[str] | None:
    """The files and stores that something names, by path or as open datasets; None for everything else."""
    if isinstance(given, str | os.PathLike):
        return matching(os.fspath(given))
    from orograph.dem.datasets import file_of

    if is_dataset(given):
        path = file_of(given)
        return None if path is None else [path]
    if isinstance(given, list | tuple) and given and not _is_window(given):
        found = [files_of(one) for one in given if isinstance(one, str | os.PathLike) or is_dataset(one)]
        if len(found) == len(given) and None not in found:
            return [path for one in found for path in one or ()]
    return None


def check_apart(output: str | os.PathLike[str], *given: Any) -> None:
    """Raise UsageError if a result would replace a file that it is made from."""
    if any(same_file(output, path) for one in given for path in files_of(one) or ()):
        raise UsageError("The result would overwrite what it is made from.", path=output, remedy="Choose another file.")


def matching(path: str) -> list[str]:
    """The files that a pattern ("tiles/*.tif") matches, sorted by name; any other path alone."""
    if "://" in path or not ("*" in path or "?" in path) or os.path.lexists(path):
        return [path]
    anchor = Path(Path(path).anchor)
    return sorted(map(str, anchor.glob(str(Path(path).relative_to(anchor))))) or [path]


def source_of(given: Any, progress: Progress = SILENT, *, called: str = "terrain", **options: Any) -> HeightSource:
    """A reader of windows of heights on a metric grid, from whatever form they come in.

    Args:
        given: ``TAKES``, or a ``HeightSource``, which is returned.
        called: the function that wants it, for errors.
        options: ``READING``. ``crs`` is also that of heights in memory without one (it may be unprojected only for
            these).

    Raises:
        ReadError: a file cannot be read, or the heights are not real numbers.
        UsageError: it does not hold heights, or an option does not apply.
    """
    check_names(options, called)
    reading = {k: v for k, v in options.items() if v is not None}
    files = files_of(given)
    if files is not None:
        if len(files) == 1 and is_store(files[0]):
            return _of_store(files[0], reading)
        if (points := points_of(files, progress, reading)) is not None:
            return points
        from orograph.dem.mosaic import Mosaic

        return Mosaic.open(files, progress=progress, **options_of_rasters(reading))
    from orograph.store.memory import MemoryTerrain, is_metric
    from orograph.store.stored import StoredTerrain

    if isinstance(given, MemoryTerrain | StoredTerrain):
        source = source_of_terrain(given)
        return _part(source, _fitting(reading, OF_AREAS, "a Terrain, which has already been read"))
    if isinstance(given, HeightSource):
        return _part(given, _fitting(reading, OF_AREAS, "heights that are already read by windows"))
    several = isinstance(given, list | tuple) and not _is_window(given) and not is_rows(given)
    if several and not given:
        raise UsageError(f"{called} got an empty list: there is nothing to read.")
    if several and not all(_is_heights(one) for one in given):
        raise refused(given, called)
    warned: list[str] = []
    made = [_raster(one, reading, warned, called) for one in (given if several else [given])]
    for text in dict.fromkeys(warned):
        progress.warn(text)
    grid = {k: v for k, v in reading.items() if k in OF_GRIDS}
    if "crs" in grid and (made[0][1] or not _projected(grid["crs"])):
        del grid["crs"]  # the source said where the heights lie
    if len(made) == 1 and not grid and isinstance(made[0][0], ArraySource) and is_metric(made[0][0].grid):
        return made[0][0]
    from orograph.dem.mosaic import Mosaic

    return Mosaic([raster for raster, _ in made], **grid)


def points_of(
    files: Sequence[str], progress: Progress, reading: dict[str, Any], made: Mapping[str, Any] | None = None
) -> HeightSource | None:
    """The raster of a file of points; None if the files are rasters.

    Args:
        reading: options of reading. made: another process's result for the file (``PointRaster.made``).

    Raises:
        ReadError, UsageError: as ``PointRaster.open``; points among other files; an option that does not apply to
        points.
    """
    from orograph.dem.scattered import is_points

    found = [path for path in files if is_points(path)]
    if not found:
        return None
    if len(files) > 1:
        raise UsageError(
            "A file of points is a terrain of its own; it cannot be combined with other files.", path=found[0],
            remedy="Put all points into one file.",
        )  # fmt: skip
    from orograph.dem.gridding import PointRaster

    how = options_of_points(reading, "crs", "resolution", "max_edge", *OF_AREAS)
    area = {name: how.pop(name) for name in OF_AREAS if name in how}
    raster = PointRaster.taken_over(made, found[0]) if made else PointRaster.open(found[0], progress=progress, **how)
    return _part(raster, area)


def options_of_files(reading: Mapping[str, Any]) -> dict[str, Any]:
    """The given options of reading that apply to a raster's file.

    Raises:
        UsageError: there are others.
    """
    return _fitting({k: v for k, v in reading.items() if v is not None}, OF_FILES, "files of rasters")


def options_of_rasters(reading: dict[str, Any]) -> dict[str, Any]:
    """The given options of reading, for ``Mosaic.open``.

    Raises:
        UsageError: there are others.
    """
    return _fitting(reading, (*OF_GRIDS, *OF_FILES, *OF_MANY), "files of rasters")


def options_of_points(reading: Mapping[str, Any], *more: str) -> dict[str, Any]:
    """The given options of reading that apply to a file of points, with ``more``.

    Raises:
        UsageError: there are others.
    """
    names = (*OF_POINTS[1:], "assume_crs", "vertical_unit", "assume_vertical", *more)
    return _fitting({k: v for k, v in reading.items() if v is not None and _asked(k, v)}, names, "points")


def _asked(name: str, value: Any) -> bool:
    """Whether an option differs from its default on the command line."""
    return bool(value != {"band": 1, "resampling": "bilinear"}.get(name))


def _of_store(path: str, reading: dict[str, Any]) -> HeightSource:
    """The full resolution of the store at a path or URL, or the part of it in an area."""
    from orograph.store.stored import open

    area = _fitting(
        {k: v for k, v in reading.items() if _asked(k, v)},
        OF_AREAS,
        "a store, which is already built and describes itself",
    )
    return _part(StoreSource(open(path)), area)


def stores_in(source: HeightSource) -> list[StoredTerrain]:
    """The stores that a source reads."""
    from orograph.dem.area import Cut

    parts = [part.raster if isinstance(part, Cut) else part for part in (source, *getattr(source, "sources", ()))]
    return [part.terrain for part in parts if isinstance(part, StoreSource)]


def source_of_terrain(terrain: MemoryTerrain | StoredTerrain) -> HeightSource:
    """The full resolution of a terrain as a source."""
    from orograph.store.stored import StoredTerrain

    if isinstance(terrain, StoredTerrain):
        return StoreSource(terrain)
    return ArraySource(terrain.heights, terrain.grid, terrain.name, terrain.vertical, terrain.attribution)


def _part(source: HeightSource, area: dict[str, Any]) -> HeightSource:
    """A source, or the part of it that lies in an area."""
    if not area:
        return source
    from orograph.dem.mosaic import Mosaic

    return Mosaic([source], **area)


def check_names(options: Any, called: str) -> None:
    """Raise UsageError for unknown options of reading, and for what is no number where one is needed."""
    for name in options:
        if name not in READING:
            own = getattr(sys.modules["orograph"], called, None)  # (only to report an error)
            known = inspect.signature(own).parameters if callable(own) else ()
            names = [one for one in known if one not in ("options", "reading")]
            raise UsageError(f"{called} has no option {name!r}.", remedy=remedy(name, [*names, *READING]))
    check_simple(KINDS, options.items())


def _raster(one: Any, reading: dict[str, Any], warned: list[str], called: str) -> tuple[Any, bool]:
    """A source from one thing, and whether ``crs`` determines its place."""
    from orograph.dem.datasets import file_of
    from orograph.dem.source import Source

    if isinstance(one, str | os.PathLike) or (is_dataset(one) and file_of(one) is not None):
        path = one if isinstance(one, str | os.PathLike) else str(file_of(one))
        return Source.open(path, **_fitting(reading, OF_FILES, "", strict=False)), False
    if isinstance(one, HeightSource):
        return one, False
    dem, own = _dem(one, reading, warned, called)
    return ArraySource(dem.heights, dem.grid, reading.get("name") or dem.name, dem.vertical, dem.attribution), own


def _dem(one: Any, reading: dict[str, Any], warned: list[str], called: str) -> tuple[Dem, bool]:
    from orograph.dem.arrays import from_array
    from orograph.dem.datasets import from_dataset
    from orograph.dem.raster import Dem

    crs = reading.get("assume_crs", reading.get("crs"))
    own = "assume_crs" not in reading and "crs" in reading
    if isinstance(one, Dem):
        _fitting(reading, (*OF_GRIDS, "name"), "a Dem, which has its own")
        return one, False
    if is_dataset(one) or _is_window(one):
        dataset, window = one if _is_window(one) else (one, None)
        file_options = _fitting(reading, (*OF_GRIDS, *OF_FILES, "name"), "an open dataset")
        return from_dataset(dataset, window, **{k: v for k, v in file_options.items() if k not in OF_GRIDS}), False
    xarray = sys.modules.get("xarray")
    if xarray is not None and isinstance(one, xarray.DataArray | xarray.Dataset):
        from orograph.dem import dataarray

        how = _fitting(reading, (*OF_GRIDS, *OF_LABELLED, "assume_crs"), "a DataArray")
        array = the_heights(one)
        if dataarray.says_crs(array):
            crs, own = None, False
        how = {name: value for name, value in how.items() if name in OF_LABELLED}
        return dataarray.from_xarray(array, crs=crs, **how), own
    if not _is_heights(one):
        raise refused(one, called)
    how = _fitting(reading, (*OF_GRIDS, *OF_ARRAYS, "assume_crs"), "an array")
    dem = from_array(one, crs=crs, warnings=warned, **{k: v for k, v in how.items() if k in OF_ARRAYS})
    return dem, own


def the_heights(given: Any) -> Any:
    """The variable of an ``xarray.Dataset`` that holds heights (``heights_in``); everything else unchanged."""
    xarray = sys.modules.get("xarray")
    if xarray is None or not isinstance(given, xarray.Dataset):
        return given
    from orograph.dem.dataarray import heights_in

    return heights_in(given)


def refused(given: Any, called: str) -> UsageError:
    """The error about something that holds no heights, with a hint."""
    if isinstance(given, list | tuple):
        kinds = sorted({type(one).__name__ for one in given})
        got = f"a {type(given).__name__} of {' and '.join(kinds)}s"
    else:
        got = "None" if given is None else f"{type(given).__module__}.{type(given).__name__}".removeprefix("builtins.")
    return UsageError(f"{called} takes {TAKES}; got {got}: {_short(given)}.", remedy=_way_in(given))


def _way_in(given: Any) -> str:
    """How to get heights out of what often holds some; "" of anything else."""
    kinds = {f"{kind.__module__.partition('.')[0]}.{kind.__name__}" for kind in type(given).__mro__}
    if "pandas.DataFrame" in kinds:
        return "Give its values, .to_numpy(), with transform= and crs=; or, of points, a path of a table."
    if "rasterio.Band" in kinds:
        return "Give its dataset, with band=."
    if "rasterio.MemoryFile" in kinds:
        return "Open it: .open()."
    if isinstance(given, bytes) or hasattr(given, "read"):
        return "Give its path; or, of bytes, rasterio.MemoryFile(…).open()."
    if isinstance(given, Iterator):
        return "Make a list of it: list(…)."
    return ""


def _short(given: Any) -> str:
    text = " ".join(repr(given).split())
    return text if len(text) <= 60 else f"{text[:57]}…"


def _is_window(given: Any) -> bool:
    return isinstance(given, tuple) and len(given) == 2 and is_dataset(given[0]) and not is_dataset(given[1])


def is_rows(given: Any) -> bool:
    """Whether something is a list of rows of numbers."""
    rows = isinstance(given, list | tuple) and given and all(isinstance(row, list | tuple) for row in given)
    return bool(rows and not any(_is_window(row) for row in given) and np.asarray(given[0]).dtype.kind in "iufbc")


def _is_heights(one: Any) -> bool:
    """Whether something is a raster of some kind."""
    from orograph.dem.raster import Dem

    raster = isinstance(one, str | os.PathLike | Dem | HeightSource) or hasattr(one, "data_vars")
    return raster or is_dataset(one) or _is_window(one) or is_rows(one) or is_array_like(one)


def is_array_like(given: Any) -> bool:
    """Whether something is a NumPy array or convertible to one (Dask's, PyTorch's, CuPy's…)."""
    return hasattr(given, "__array__") and hasattr(given, "dtype") and hasattr(given, "shape")


def _projected(crs: Any) -> bool:
    from orograph.dem.header import parsed_crs

    return bool(parsed_crs(crs).is_projected)


def _fitting(reading: dict[str, Any], names: Sequence[str], what: str, strict: bool = True) -> dict[str, Any]:
    """The given options, all of which must be among ``names``."""
    wrong = [f"`{name}`" for name in reading if name not in names]
    if wrong and strict:
        raise UsageError(f"{', '.join(wrong)} cannot be used with {what}.")
    return {k: v for k, v in reading.items() if k in names}
