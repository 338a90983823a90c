"""Values of arrays over a terrain: xarray's, which are read where the terrain is and only then, and NumPy's.

Their members and times are what a user chooses; undecoded numbers are decoded by their attributes (CF).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from affine import Affine

from orograph.errors import UsageError
from orograph.geo.grid import Grid, compose
from orograph.geovis.data.choosing import is_level, no_time, picked, time_words, wants_members
from orograph.geovis.data.dataset import Dataset, Uncertainty
from orograph.geovis.data.field import Field, Values, in_units, step_of, window_of
from orograph.geovis.data.listing import array_of
from orograph.geovis.data.shared import reading_once
from orograph.geovis.data.times import array_times, matches
from orograph.geovis.data.vertical import vertical_dimension
from orograph.geovis.keys import written_unit
from orograph.geovis.placement import Placement

MEMBERS = ("member", "realization", "realisation", "number", "ensemble", "ens")


def read_array(given: Dataset | Uncertainty, grid: Grid) -> Field:
    """Of a DataArray, of an array that spans the terrain, or of a field that is there already.

    Raises:
        UsageError: it has no such shape, member, time or level. Others: as ``reading.read``.
    """
    if isinstance(given.source, Field):
        return given.source
    one = array_of(given)
    if one is not None:
        return _of_dataarray(replace(given, source=one), grid, given.source)
    array = np.ma.asarray(given.source)
    if array.dtype.kind not in "biuf":
        raise UsageError(f"Data must be real numbers, not {array.dtype}.")
    raw = np.ma.filled(array.astype(np.float32), np.nan)
    if raw.ndim == 2:
        raw = raw[None]
    if raw.ndim != 3:
        raise UsageError(f"Data must have the shape (rows, cols) or (members, rows, cols), not {raw.shape}.")
    _check_size(raw.shape)
    fit = Affine.scale(grid.cols / raw.shape[2], grid.rows / raw.shape[1])
    chosen, words = _members(len(raw), given, "the array")
    values = raw if len(chosen) == len(raw) else raw[chosen]
    return Field(values, Grid(raw.shape[1:], compose(grid.transform, fit), grid.crs), "data", "", words)


def _check_size(sizes: tuple[int, ...] | dict[Any, int]) -> None:
    """Raise UsageError if an array of these sizes, by dimension, is empty."""
    if 0 in (sizes.values() if isinstance(sizes, dict) else sizes):
        raise UsageError(f"The array is empty: {sizes}.", remedy="Give at least one member, row and column.")


def _members(count: int, given: Dataset | Uncertainty, name: str) -> tuple[list[int], str]:
    """Of so many members those that are meant, from 0, and in words which they are."""
    asked, chosen = given.member if given.member is not None else given.band, list(range(count))
    if asked is not None:
        chosen = [i - 1 for i in picked(range(1, count + 1), str(asked), name)]
    elif given.time is None and not wants_members(given):
        chosen = chosen[:1]
    if len(chosen) == 1 and given.member is not None:
        return chosen, f"member {given.member}"
    return chosen, f"mean of {len(chosen)}" if len(chosen) > 1 else ""


def _of_dataarray(given: Dataset | Uncertainty, grid: Grid, source: Any) -> Field:
    """Of a DataArray; ``source``: the one, or the Dataset, that the user gave."""
    from orograph.dem.dataarray import decoded, located

    array, words, told = _chosen(given)
    lead = [d for d in array.dims if str(d).lower() in MEMBERS or d == "time"]
    if array.ndim - len(lead) != 2:
        raise UsageError(
            f"A DataArray must have rows and columns, and optionally time and member, not {dict(array.sizes)}.",
            remedy="Choose one level: level=; style curtains or walls shows all.",
        )
    _check_size(dict(array.sizes))
    plane, transform, crs = located(array.isel(dict.fromkeys(lead, 0)))
    stacked = array.transpose(*lead, *plane.dims)
    ahead = stacked.shape[:-2]
    chosen, mean = _members(int(np.prod(ahead, dtype=np.int64)), given, str(array.name))
    warnings: list[str] = []
    rows, cols = stacked.shape[-2:]
    window, step, own = (0, rows, 0, cols), 1, None
    if transform is not None:
        placement = Placement.of(grid, Grid((rows, cols), transform, crs), str(array.name or "the data"), warnings)
        window = window_of(placement, str(array.name or "the data"))
        step = step_of(window[1] - window[0], window[3] - window[2], len(chosen))
        transform, crs = placement.image.transform, placement.image.crs
    nearest = "flag_meanings" in array.attrs or getattr(given, "style", None) == "classes"

    def values_of() -> Values:
        part = decoded(stacked[..., window[0] : window[1], window[2] : window[3]])
        if lead:
            part = part.stack(_=lead, create_index=False).transpose("_", *plane.dims).isel(_=chosen)
        if (fill := array.attrs.get("_FillValue")) is not None:
            part = part.where(part != fill)
        part = _coarser(part, plane.dims, step, nearest)
        values = np.array(part.to_numpy(), np.float32).reshape(-1, *part.shape[-2:])
        values[~np.isfinite(values)] = np.nan
        return values

    lazy = not array.variable._in_memory  # (what is in memory may be changed by its owner, and is read in no time)
    what = (source, given.variable, told, tuple(chosen), window, step, nearest)
    values = reading_once("array", what, values_of) if lazy else values_of()
    if transform is None:
        own = Grid((rows, cols), compose(grid.transform, Affine.scale(grid.cols / cols, grid.rows / rows)), grid.crs)
    else:
        place = compose(transform, Affine.translation(window[2], window[0]))
        own = Grid(values.shape[1:], compose(place, Affine.scale(step)), crs)
    words = [mean, *words] if mean else words
    unit = str(array.attrs.get("units", ""))
    name = str(array.attrs.get("long_name") or array.name or "data").replace("_", " ")
    return in_units(Field(values, own, name, written_unit(unit), " ".join(words), tuple(warnings), tags=array.attrs))


def _chosen(given: Dataset | Uncertainty) -> tuple[Any, list[str], Any]:
    """A DataArray at the times and the level that are meant, in words which they are, and in short."""
    array, words, told = given.source, [], (str(given.time), str(given.level))
    if given.time is not None:
        times = array_times(array)
        if not times and "time" in array.coords:
            calendar = getattr(np.atleast_1d(array.coords["time"].values)[0], "calendar", "unknown")
            raise UsageError(
                f"Its times are in the calendar {calendar}, whose days are not ours.",
                remedy="Convert them (convert_calendar), or omit time.",
            )
        if not times:
            raise UsageError("The DataArray has no coordinate time.", remedy="Omit time.")
        keep = [i for i, time in enumerate(times) if matches(time, given.time)]
        if not keep:
            raise no_time(given.time, times)
        array = array.isel(time=keep) if "time" in array.dims else array
        words.append(time_words(given.time, [times[i] for i in keep]))
    if given.level is not None:
        found = vertical_dimension(array, getattr(given, "vertical", None))
        levels = np.empty(0) if found is None else np.asarray(array.coords[found[0]].values, np.float64)
        at = [i for i, value in enumerate(levels) if is_level(value, given.level)]
        if found is None or not at:
            known = ", ".join(f"{v:g}" for v in levels) or "none"
            raise UsageError(f"It has no level {given.level}; its levels are: {known}.")
        array = array.isel({found[0]: at[0]})
        words.append(f"at {float(given.level):g} {written_unit(found[1].unit)}")
    return array, words, told


def _coarser(part: Any, axes: tuple[Any, ...], step: int, nearest: bool) -> Any:
    """A DataArray with one sample for each square of ``step``: their mean, or the middle one."""
    if step == 1:
        return part
    if nearest:
        return part.isel({axis: slice(step // 2, None, step) for axis in axes})
    return part.coarsen(dict.fromkeys(axes, step), boundary="trim").mean()
