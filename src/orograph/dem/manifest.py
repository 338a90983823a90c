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
import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

from affine import Affine

from orograph.dem.asking import State, asked, fetched, url_of
from orograph.dem.asking import know as know_state
from orograph.dem.deciding import know
from orograph.dem.folders import beside
from orograph.dem.handles import MANIFEST, Seen, is_manifest
from orograph.dem.header import parsed_crs
from orograph.dem.missing import Valid
from orograph.dem.remote import is_remote
from orograph.dem.source import Source
from orograph.dem.whole.files import DAMAGED
from orograph.dem.whole.tiff import cut_off
from orograph.documents import parse
from orograph.errors import ReadError
from orograph.geo.grid import Grid

PLAIN = tuple(
    one.name for one in fields(Source)
    if one.name not in ("path", "location", "grid", "undeclared", "valid", "block", "attribution", "_opened")
)  # fmt: skip
"""Attributes of a source that are JSON values."""


class Line(NamedTuple):
    """One file of a manifest.

    Attributes:
        path: of the file. said: the line's other properties.
        folder: of the manifest, or its address, which paths are relative to; None: they are as they were given.
    """

    path: str
    said: Mapping[str, Any]
    folder: Path | str | None

    def source(self, options: Mapping[str, Any], ask: bool = False) -> Source | None:
        """The file as the line describes it; None if the description is absent or outdated.

        Args:
            options: those of ``Source.open`` that differ from the defaults.
            ask: check files on servers for changes.
        """
        header = self.said.get("header")
        if not isinstance(header, dict) or self.said.get("check") != checksum(self.said):
            return None
        if header["options"] != plain(options):
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
        return source_of(self.path, location, header, seen)


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


def line_of(row: str, folder: Path | str | None) -> Line:
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


def open_named(path: str, options: Mapping[str, Any], whole: bool) -> Source:
    """A file by its own name, without a manifest.

    Args:
        whole: raise ReadError if it was cut off. (A single file's error names the first window that lacks samples.)
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


def source_of(path: str, location: str, header: Mapping[str, Any], seen: Seen) -> Source:
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


def checksum(said: Mapping[str, Any]) -> str:
    """A checksum of a line, to detect edits."""
    rest = {name: value for name, value in said.items() if name != "check"}
    return f"{zlib.crc32(json.dumps(rest, sort_keys=True).encode()):08x}"


def unusual_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of ``Source.open`` that differ from the defaults."""
    usual: dict[str, Any] = {"band": 1}
    return {name: value for name, value in options.items() if value is not None and value != usual.get(name)}


def plain(options: Mapping[str, Any]) -> dict[str, str]:
    return {name: repr(value) for name, value in sorted(options.items())}


def _value(said: Any) -> Any:
    return float(said) if isinstance(said, str) else said


def _meant(name: str, folder: Path | str | None) -> str:
    """The file that a name in a manifest refers to."""
    if folder is None or name.startswith("/") or "://" in name or ":" in name:
        return name
    if isinstance(folder, str):
        return f"{folder}/{name}"
    return os.path.join(folder, name)  # noqa: PTH118 (of mosaics thousands at a time)


__all__ = ["MANIFEST", "Line", "is_manifest", "line_of", "read"]
