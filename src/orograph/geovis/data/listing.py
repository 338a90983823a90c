"""The content of a data source: variables, levels of a vertical dimension, times."""

from __future__ import annotations

import sys
import warnings
from typing import Any

import numpy as np

from orograph.dem.handles import HANDLES, locate, stamped
from orograph.errors import UsageError
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.shared import reading_once
from orograph.geovis.data.times import array_times, times_of
from orograph.geovis.data.vertical import Levels, levels_of, vertical_dimension


def inside_of(location: str) -> tuple[dict[str, str], int]:
    """The variables that a file holds, what GDAL opens for each, and how many bands it has by itself."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(location) as file:  # (what is damaged, who opens it next says)
                inside, count = list(file.subdatasets), file.count
    except RasterioError:
        inside, count = [], 1
    return {one.rpartition(":")[2].rpartition("/")[2]: one for one in inside}, count


def subdataset(location: str, variable: str | None, name: str) -> str:
    """What GDAL opens for a variable of a file.

    Raises:
        UsageError: there is no such variable, or there are several and none is named.
    """
    known, count = inside_of(location)
    if not known:
        return location
    if variable is None:
        if count:
            return location
        if len(known) == 1:
            return next(iter(known.values()))
    if variable in known:
        return known[variable]
    what = "It holds several variables" if variable is None else f"It holds no variable {variable!r}"
    raise UsageError(f"{what}: {', '.join(known)}.", path=name, remedy="Choose one: variable=NAME.")


def levels_in(given: Dataset) -> Levels | None:
    """The levels of a variable, from the lowest value, each once; None: it has no vertical dimension.

    Raises:
        UsageError: there is no such variable.
    """
    source = array_of(given)
    if array_of(given) is not None:
        found = vertical_dimension(source, given.vertical)
        levels = None if found is None else Levels(np.asarray(source.coords[found[0]].values, np.float64), found[1])
    elif isinstance(given.source, str):
        with HANDLES.borrow(subdataset(locate(given.source), given.variable, given.source)) as file:
            levels = levels_of(file, given.vertical)
    else:
        return None
    if levels is None:
        return None
    return levels._replace(values=np.unique(levels.values[np.isfinite(levels.values)]))


def array_of(given: Dataset | Uncertainty) -> Any:
    """The DataArray that is meant, where the source is one, or a Dataset of xarray's; else None.

    Raises:
        UsageError: there is no such variable.
    """

    xarray, source = sys.modules.get("xarray"), given.source
    if xarray is not None and isinstance(source, xarray.Dataset):
        if given.variable not in source:
            raise UsageError(
                f"A Dataset holds {', '.join(map(str, source.data_vars))}.", remedy="Choose one: variable=."
            )
        source = source[given.variable]
    return source if xarray is not None and isinstance(source, xarray.DataArray) else None


def variables_in(given: Dataset) -> list[str]:
    """The variables of a source that holds several, by name."""
    if not isinstance(given.source, str):
        return [str(name) for name in getattr(given.source, "data_vars", ())]
    return list(inside_of(locate(given.source))[0])


def times_in(given: Dataset | Uncertainty) -> list[str]:
    """The times of a dataset, ISO 8601 in UTC, in order; none of what is no series."""

    from orograph.geovis.data.features import has_features
    from orograph.geovis.data.points import is_table

    source, xarray = given.source, sys.modules.get("xarray")
    if xarray is not None and isinstance(source, xarray.Dataset):
        source = source[str(given.variable).split("+")[0]]
    if xarray is not None and isinstance(source, xarray.DataArray):
        return sorted(set(filter(None, array_times(source))))
    if not isinstance(source, str) or has_features(source) or is_table(source):
        return []
    variable = given.variable.split("+")[0] if given.variable is not None else None
    location = locate(source)

    def found_times() -> list[str]:
        with HANDLES.borrow(subdataset(location, variable, source)) as file:
            return sorted({time for time in times_of(file) if time})

    return reading_once("times", (stamped(location), variable), found_times)
