"""A manifest: descriptions of many elevation files, so that none has to be opened for them.

It is GeoJSON, one feature per line (``*.manifest.geojsonl``), which GIS programs can draw and any editor can edit:
footprint, the main facts (path, size, modification time, shape, type, resolution, CRS, datum, nodata value), and under
``header`` whatever else ``Source`` needs. It is accepted wherever files are. Lines may be removed or reordered; their
order is the order of precedence. A line with only a path, ``{"path": "a.tif"}``, is enough.

A line counts only while it is true: a file is reopened if its size, modification time or companion files have changed,
or if the line was edited or made with other options. Only ``orograph manifest`` checks files on servers, and their
entity tags (``asking``); readers of a manifest trust it.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from affine import Affine
from pyproj import CRS

from orograph.dem.area import degrees_of
from orograph.dem.asking import State, asked, fetched, known, url_of
from orograph.dem.asking import know as know_state
from orograph.dem.deciding import files_of, know
from orograph.dem.folders import beside, taken
from orograph.dem.handles import MANIFEST, Seen, is_manifest
from orograph.dem.header import parsed_crs
from orograph.dem.missing import Valid
from orograph.dem.remote import is_remote
from orograph.dem.source import Source
from orograph.dem.whole.files import DAMAGED
from orograph.dem.whole.tiff import cut_off
from orograph.documents import parse
from orograph.errors import ReadError, UsageError
from orograph.geo.grid import Grid, wkt_of
from orograph.parallel import cpu_count, map_ordered
from orograph.progress import SILENT, Progress

AT_ONCE = 16
"""Files on servers opened at once."""

PLAIN = tuple(
    one.name for one in fields(Source)
    if one.name not in ("path", "location", "grid", "undeclared", "valid", "block", "attribution", "_opened")
)  # fmt: skip
"""Attributes of a source that are JSON values."""


class Line(NamedTuple):
    """One file of a manifest.

    Attributes:
        path: of the file. said: its other properties.
        folder: of the manifest, or its address, which paths are relative to.
    """

    path: str
    said: Mapping[str, Any]
    folder: Path | str

    def source(self, options: Mapping[str, Any], ask: bool = False) -> Source | None:
        """The file as the line describes it; None if the description is absent or outdated.

        Args:
            options: those of ``Source.open`` that differ from the defaults.
            ask: check files on servers for changes.
        """
        header = self.said.get("header")
        if not isinstance(header, dict) or self.said.get("check") != _check(self.said):
            return None
        if header["options"] != _plain(options):
            return None
        names = [_meant(name, self.folder) for name, *_ in header["files"]]
        seen = Seen(names)
        location = _meant(header["location"], self.folder)
        listed = [_state(state) for _, *state in header["files"]]
        far = list(map(is_remote, names))
        if [state for state, away in zip(seen.states(), far) if not away] != [
            state for state, away in zip(listed, far) if not away
        ] or beside(location) != header["beside"]:
            return None
        there = {url_of(name): state for name, state, away in zip(names, listed, far) if away}
        for url, state in there.items():
            told = isinstance(state, State)
            if (ask and (not told or asked(url or "") != state)) or (not told and state != (None, None)):
                return None
        for url, state in there.items():
            if url and isinstance(state, State):
                know_state(url, state)
        know(location, names)
        return _source(self.path, location, header, seen)


class Named(NamedTuple):
    """The result of ``opened``.

    Attributes:
        sources, damaged: the files that could be opened, in order, and the errors of the others. files: how many in
        all.
        manifests: whether any of the names was one.
    """

    sources: list[Source]
    damaged: list[ReadError]
    files: int
    manifests: bool


def opened(names: Sequence[str | os.PathLike[str]], options: Mapping[str, Any], progress: Progress = SILENT) -> Named:
    """Open files, those in folders, and those that manifests list (of these only changed ones).

    Args:
        options: of ``Source.open``. progress: gets reports on the files.

    Raises:
        ReadError: a manifest cannot be read.
    """
    lines: list[Line] = []
    for name in names:
        lines += read(name) if is_manifest(name) else [Line(f, {}, Path()) for f in taken(name, progress)]
    unusual = _unusual(options)

    def one(line: Line) -> Source | ReadError:
        try:
            return line.source(unusual) or _opened(line.path, options, whole=len(lines) > 1)
        except ReadError as error:
            return error

    found = Named([], [], len(lines), any(map(is_manifest, names)))
    with progress.task("Opening files", total=len(lines)) as task:
        for each in map_ordered(one, lines, _threads(lines)):
            found.damaged.append(each) if isinstance(each, ReadError) else found.sources.append(each)
            task.advance()
    return found


def read(path: str | os.PathLike[str]) -> list[Line]:
    """The lines of a manifest.

    Raises:
        ReadError: it does not exist, lists nothing, or a line is not a JSON object with a path.
    """
    file = os.fspath(path)
    try:
        text = fetched(file).decode() if is_remote(file) else Path(file).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        cause = getattr(error, "strerror", None) or error
        raise ReadError(
            f"The manifest cannot be read: {cause}.", path=file, remedy="Make it: orograph manifest."
        ) from None
    lines = []
    for number, row in enumerate(text.splitlines(), 1):
        if row.strip():
            lines.append(_line(row, number, file))
    if not lines:
        raise ReadError("The manifest lists no file.", path=file, remedy="Make it: orograph manifest.")
    return lines


def _line(row: str, number: int, file: str) -> Line:
    try:
        return line_of(row, file.rpartition("/")[0] if is_remote(file) else Path(file).parent)
    except (ValueError, LookupError, TypeError, AttributeError):
        raise ReadError(
            f"Line {number} of the manifest is not a JSON object with a path.", path=file,
            remedy='Correct or remove it; {"path": "tile.tif"} is enough.',
        ) from None  # fmt: skip


def line_of(row: str, folder: Path | str) -> Line:
    """A line of a manifest in a folder, or at an address.

    Raises:
        ValueError, LookupError, TypeError, AttributeError: it is not a JSON object with a path.
    """
    said = parse(row)
    said = said.get("properties", said)
    path = said["path"]
    if not isinstance(path, str) or not path:
        raise ValueError(path)
    return Line(_meant(path, folder), said, folder)


def described(line: Line, options: Mapping[str, Any], folder: Path) -> tuple[str, ReadError | None]:
    """The line of a file in its current state, and the error if it cannot be opened.

    Args:
        line: what is already known. options: of ``Source.open``. folder: of the manifest.
    """
    unusual = _unusual(options)
    source = line.source(unusual, ask=True)
    before = asked(line.path) if source is None and is_remote(line.path) else None
    try:
        source = source or _opened(line.path, options, whole=True)
    except ReadError as error:
        return _row(None, {"path": _said(line.path, folder), "error": error.what}), error
    header = _header(source, unusual, folder, before)
    grid = source.grid
    said: dict[str, Any] = {
        "path": _said(line.path, folder),
        "size": header["files"][0][1] if header["files"] else None,
        "mtime_ns": header["files"][0][2] if header["files"] else None,
        **({"etag": header["files"][0][3]} if header["files"] and len(header["files"][0]) > 3 else {}),
        "driver": source.driver,
        "shape": list(grid.shape),
        "dtype": source.dtype,
        "resolution": list(grid.spacing),
        "crs": None if grid.crs is None else grid.crs.name,
        "vertical": source.vertical,
        "nodata": _number(source.nodata),
        "header": header,
    }
    said["check"] = _check(said)
    # A VRT's parts count too, and may come and go: it is opened whenever it is used.
    if source.driver in ("VRT", "Zarr") or not _same(
        source, _source(source.path, source.location, json.loads(json.dumps(header)), Seen(()))
    ):
        del said["header"], said["check"]
    return _row(_footprint(grid), said), None


def _opened(path: str, options: Mapping[str, Any], whole: bool) -> Source:
    """A file by its own name, without a manifest.

    Args:
        whole: raise ReadError if it was cut off. (Of a single file the first window that lacks samples is told.)
    """
    know_state(path, None)
    source = Source.open(path, **options)
    if whole and Path(path).is_file():
        with Path(path).open("rb") as file:
            fault = cut_off(file)
        if fault is not None:
            raise ReadError(fault, path=path, remedy=DAMAGED)
    return source


def _state(said: Sequence[Any]) -> State | tuple[Any, ...]:
    """A manifest's entry on a file's state; for one on a server it includes its entity tag, or its absence."""
    return State(*said) if len(said) == len(State._fields) else tuple(said)


def _header(source: Source, unusual: Mapping[str, Any], folder: Path, before: State | None = None) -> dict[str, Any]:
    """What is needed to read a file without reading its header.

    Args:
        before: the server's answer before it was opened.
    """
    names = files_of(source.location)
    states: list[Sequence[Any]] = list(Seen(names).states())
    for number, name in enumerate(names):
        if is_remote(name):
            found = (before if url_of(name) == url_of(source.location) else None) or known(name) or asked(name)
            states[number] = found or (None, None)
    grid = source.grid
    return {
        "location": _said(source.location, folder),
        "files": [[_said(name, folder), *state] for name, state in zip(names, states, strict=True)],
        "beside": beside(source.location),
        "options": _plain(unusual),
        "transform": list(grid.transform[:6]),
        "shape": list(grid.shape),
        "crs": None if grid.crs is None else grid.crs.srs,
        **{name: _number(getattr(source, name)) for name in PLAIN},
        "block": list(source.block),
        "attribution": list(source.attribution),
        "valid": None if source.valid is None else [[_number(v) for v in source.valid.others],
                                                    _number(source.valid.low), _number(source.valid.high)],
    }  # fmt: skip


def _source(path: str, location: str, header: Mapping[str, Any], seen: Seen) -> Source:
    """The source that a header describes."""
    valid = header["valid"]
    if valid is not None:
        others, low, high = valid
        valid = Valid(tuple(map(_value, others)), _value(low), _value(high))
    rows, cols = header["shape"]
    plain = {name: _value(header[name]) if name in ("nodata", "scale", "offset") else header[name] for name in PLAIN}
    return Source(
        path=path,
        location=location,
        grid=Grid(
            (rows, cols), Affine(*header["transform"]), None if header["crs"] is None else parsed_crs(header["crs"])
        ),
        valid=valid,
        block=(header["block"][0], header["block"][1]),
        attribution=tuple(header["attribution"]),
        _opened=[seen],
        **plain,
    )


def _same(one: Source, other: Source) -> bool:
    """Whether two sources read alike."""
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


def _row(geometry: Mapping[str, Any] | None, said: Mapping[str, Any]) -> str:
    return json.dumps(
        {"type": "Feature", "geometry": geometry, "properties": said}, ensure_ascii=False, allow_nan=False
    )


def _check(said: Mapping[str, Any]) -> str:
    """A checksum of a line, to detect edits."""
    rest = {name: value for name, value in said.items() if name != "check"}
    return f"{zlib.crc32(json.dumps(rest, sort_keys=True).encode()):08x}"


def _unusual(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of ``Source.open`` that differ from the defaults."""
    usual: dict[str, Any] = {"band": 1}
    return {name: value for name, value in options.items() if value is not None and value != usual.get(name)}


def _plain(options: Mapping[str, Any]) -> dict[str, str]:
    return {name: repr(value) for name, value in sorted(options.items())}


def _number(value: Any) -> Any:
    """A value for JSON, which has no NaN and no infinity."""
    if isinstance(value, np.generic):
        value = value.item()
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _value(said: Any) -> Any:
    return float(said) if isinstance(said, str) else said


def _said(name: str, folder: Path) -> str:
    """A file's name for a manifest in a folder: relative if it lies below."""
    if name.startswith("/vsi") or "://" in name or not Path(name).exists():
        return name
    file, here = Path(name).absolute(), folder.absolute()
    return file.relative_to(here).as_posix() if file.is_relative_to(here) else str(file)


def _meant(name: str, folder: Path | str) -> str:
    """The file that a name in a manifest refers to."""
    if name.startswith("/") or "://" in name or ":" in name:
        return name
    if isinstance(folder, str):
        return f"{folder}/{name}"
    return os.path.join(folder, name)  # noqa: PTH118 (of mosaics thousands at a time)


def _threads(lines: Sequence[Line]) -> int:
    return AT_ONCE if any(is_remote(line.path) for line in lines[:64]) else cpu_count()


def rows(
    lines: Sequence[Line], options: Mapping[str, Any], folder: Path, jobs: int | None = None
) -> Iterator[tuple[str, ReadError | None]]:
    """``described`` for many files, in order, in ``jobs`` threads."""
    return map_ordered(lambda line: described(line, options, folder), lines, jobs or _threads(lines))


__all__ = ["MANIFEST", "Line", "Named", "described", "is_manifest", "line_of", "opened", "read", "rows"]
