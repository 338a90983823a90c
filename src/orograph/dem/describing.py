"""The lines of a manifest (``dem.manifest``), one for each file.

A line is made by opening the file, or from an open source without accessing the file again.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from pyproj import CRS

from orograph.dem.area import degrees_of
from orograph.dem.asking import State, asked, known, url_of
from orograph.dem.deciding import files_of
from orograph.dem.folders import beside
from orograph.dem.handles import Seen
from orograph.dem.manifest import PLAIN, Line, checksum, open_named, plain, source_of, unusual_of
from orograph.dem.remote import is_remote
from orograph.dem.source import Source
from orograph.dem.whole.files import absolute
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, wkt_of

Described = tuple[str, ReadError | None]
"""A line of a manifest, and the error if the file cannot be opened."""


def described(line: Line, options: Mapping[str, Any], folder: Path | None) -> Described:
    """The line of a file in its current state.

    Args:
        line: what is already known. options: of ``Source.open``.
        folder: of the manifest; None: names stay as they are, and the line has only what replaces the file's header.
    """
    unusual = unusual_of(options)
    source = line.source(unusual, ask=True)
    before = asked(line.path) if source is None and is_remote(line.path) else None
    try:
        source = source or open_named(line.path, options, whole=True)
    except ReadError as error:
        return _row(None, {"path": _said(line.path, folder), "error": error.what}), error
    header = _header(source, unusual, partial(_said, folder=folder), before)
    if folder is None:
        return _row(None, _checked({"path": line.path}, source, header)), None
    return _row(_footprint(source.grid), _checked(_facts(line.path, source, header, folder), source, header)), None


def brief(source: Source, options: Mapping[str, Any]) -> str:
    """A line for another process, in any folder, from an open source; servers are not asked.

    Args:
        options: with which it was opened.
    """
    header = _header(source, unusual_of(options), absolute, ask=False)
    return _row(None, _checked({"path": absolute(source.path)}, source, header))


def _facts(path: str, source: Source, header: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """A file's facts in a manifest, for people and programs."""
    grid, state = source.grid, (*header["files"], ["", None, None])[0][1:]
    return {
        "path": _said(path, folder),
        "size": state[0],
        "mtime_ns": state[1],
        **({"etag": state[2]} if len(state) > 2 else {}),
        "driver": source.driver,
        "shape": list(grid.shape),
        "dtype": source.dtype,
        "resolution": list(grid.spacing),
        "crs": None if grid.crs is None else grid.crs.name,
        "vertical": source.vertical,
        "nodata": _number(source.nodata),
    }


def _checked(facts: dict[str, Any], source: Source, header: Mapping[str, Any]) -> dict[str, Any]:
    """A file's facts with its header and a checksum, if these are enough to read it."""
    # A VRT's parts count too, and may come and go: it is opened whenever it is used.
    if source.driver in ("VRT", "Zarr") or not _same(
        source, source_of(source.path, source.location, json.loads(json.dumps(header)), Seen(()))
    ):
        return facts
    facts = {**facts, "header": header}
    return {**facts, "check": checksum(facts)}


def _header(
    source: Source, unusual: Mapping[str, Any], called: Callable[[str], str], before: State | None = None,
    ask: bool = True,
) -> dict[str, Any]:  # fmt: skip
    """The data needed to read a file without reading its header.

    Args:
        called: a file's name as it is written.
        before: the server's answer before it was opened.
        ask: request the state of further files from servers.
    """
    names = files_of(source.location)
    states: list[Sequence[Any]] = list(Seen(names).states())
    for number, name in enumerate(names):
        if is_remote(name):
            found = (before if url_of(name) == url_of(source.location) else None) or known(name)
            states[number] = found or (asked(name) if ask else None) or (None, None)
    grid = source.grid
    return {
        "location": called(source.location),
        "files": [[called(name), *state] for name, state in zip(names, states, strict=True)],
        "beside": beside(source.location),
        "options": plain(unusual),
        "transform": list(grid.transform[:6]),
        "shape": list(grid.shape),
        "crs": None if grid.crs is None else grid.crs.srs,
        **{name: _number(getattr(source, name)) for name in PLAIN},
        "block": list(source.block),
        "attribution": list(source.attribution),
        "valid": None if source.valid is None else [[_number(v) for v in source.valid.others],
                                                    _number(source.valid.low), _number(source.valid.high)],
    }  # fmt: skip


def _same(one: Source, other: Source) -> bool:
    """Whether two sources read the same samples."""
    mine, theirs = one.grid, other.grid
    if (mine.shape, mine.transform[:6]) != (theirs.shape, theirs.transform[:6]) or not _same_crs(mine.crs, theirs.crs):
        return False
    alike = [
        repr(getattr(one, name)) == repr(getattr(other, name)) for name in (*PLAIN, "block", "attribution", "valid")
    ]
    return all(alike)


@lru_cache(maxsize=64)
def _same_crs(one: CRS | None, other: CRS | None) -> bool:
    """Whether two CRSs have the same text, from which hashes are made."""
    if one is None or other is None:
        return one is other
    return one.to_wkt() == other.to_wkt() and wkt_of(one) == wkt_of(other)


@lru_cache(maxsize=64)
def _to_degrees(crs: CRS) -> Callable[[Any, Any], tuple[Any, Any]] | None:
    from orograph.geo.transform import transformer

    try:
        return transformer(crs, degrees_of(Grid((1, 1), Affine.identity(), crs)))
    except UsageError:
        return None


def _footprint(grid: Grid) -> dict[str, Any] | None:
    """The outline of a grid's outermost samples in degrees, 8 places per side; None if it has none."""
    move = None if grid.crs is None else _to_degrees(grid.crs)
    if move is None:
        return None
    t, end = np.linspace(0, 1, 9)[:-1], np.zeros(8)
    col = np.concatenate([t, end + 1, 1 - t, end, [0]]) * (grid.cols - 1)
    row = np.concatenate([end, t, end + 1, 1 - t, [0]]) * (grid.rows - 1)
    lon, lat = move(*grid.xy(col, row))
    if not np.isfinite([lon, lat]).all():
        return None
    ring = [[round(float(x), 7), round(float(y), 7)] for x, y in zip(lon, lat, strict=True)]
    return {"type": "Polygon", "coordinates": [ring]}


def _row(geometry: Mapping[str, Any] | None, facts: Mapping[str, Any]) -> str:
    return json.dumps(
        {"type": "Feature", "geometry": geometry, "properties": facts}, ensure_ascii=False, allow_nan=False
    )


def _number(value: Any) -> Any:
    """A value for JSON, which has no NaN and no infinity."""
    if isinstance(value, np.generic):
        value = value.item()
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _said(name: str, folder: Path | None) -> str:
    """A file's name in a manifest: relative to its folder if it lies below."""
    if folder is None or name.startswith("/vsi") or "://" in name or not Path(name).exists():
        return name
    file, here = Path(name).absolute(), folder.absolute()
    return file.relative_to(here).as_posix() if file.is_relative_to(here) else str(file)
