"""What a store was built from, as recorded in it, so that one command can rebuild or repair it.

Each input has its own state and that of its companion files (headers, masks, the parts of a VRT): a change of any of
them is a change of the input. Its window is the part of the terrain that it may affect. Paths are absolute; possible
secrets in URLs (user, password, query) are left out. The state of files on servers is only known from a manifest.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orograph.errors import public
from orograph.progress import SILENT, Progress
from orograph.store.source import HeightSource

DEFAULTS: dict[str, Any] = {"band": 1, "resampling": "bilinear"}
"""Defaults of the options that are not None by default."""

LINES = "lines"
"""The name of the lines with which a process passes on the headers of many files."""


def inputs_of(source: HeightSource) -> dict[str, Any] | None:
    """The files and options that reopen a source (its ``recipe``); None for others."""
    recipe = getattr(source, "recipe", None)
    found = None if recipe is None else recipe()
    if found is None:
        return None
    files, options = found
    return {
        "files": [state_of(path) for path in files],
        "beside": [_beside(path) for path in files],
        "windows": [list(window) for window in getattr(source, "windows", ())],
        "geoid": state_of(options["geoid"]) if options.get("geoid") else None,
        "options": {k: v for k, v in options.items() if v is not None and v != DEFAULTS.get(k)},
    }


def _beside(path: str) -> list[dict[str, Any]]:
    """The other files on this disk that affect an input's samples."""
    from orograph.dem.deciding import files_of
    from orograph.dem.handles import locate
    from orograph.dem.scattered import is_points

    if is_points(path):
        parts = (Path(path).with_suffix(suffix) for suffix in (".dbf", ".shx", ".prj", ".cpg"))
        return [state_of(str(part)) for part in parts if path.lower().endswith(".shp") and part.is_file()]
    found = {file["path"]: file for file in map(state_of, files_of(locate(path))) if file["size"] is not None}
    return [
        file for name, file in found.items() if name not in (state_of(path)["path"], state_of(locate(path))["path"])
    ]


def state_of(path: str) -> dict[str, Any]:
    """A file with its size and time of change, as it is recorded; None where they are unknown."""
    from orograph.dem.asking import known
    from orograph.dem.whole.files import absolute, on_disk

    file = on_disk(path)
    if not file.is_file():
        if (state := known(path)) is not None:
            return {"path": public(path), "size": state.size, "time_ns": state.time_ns, "etag": state.etag}
        return {"path": absolute(path) if file.exists() else public(path), "size": None, "time_ns": None}
    found = file.stat()
    return {"path": absolute(path), "size": found.st_size, "time_ns": found.st_mtime_ns}


def reopened(inputs: Mapping[str, Any], progress: Progress = SILENT) -> HeightSource:
    """Open the source again.

    Raises:
        ReadError: a file cannot be read.
    """
    return opened([file["path"] for file in inputs["files"]], inputs["options"], progress)


def opened(
    files: list[str], options: dict[str, Any], progress: Progress = SILENT, made: Mapping[str, Any] | None = None
) -> HeightSource:
    """The source of these files and options (``recipe`` lists them): points, or rasters.

    Args:
        made: another process's result for points (``PointRaster.made``), or ``LINES`` of a manifest of many files.

    Raises:
        ReadError: a file cannot be read.
    """
    from orograph.dem.manifest import line_of
    from orograph.dem.mosaic import Mosaic
    from orograph.store.given import points_of

    if made is not None and LINES in made:
        lines = [line_of(row, None) for row in bytes(made[LINES]).decode().split("\n")]
        return Mosaic.open(lines, progress=progress, **options)
    points = points_of(files, progress, options, made)
    return Mosaic.open(files, progress=progress, **options) if points is None else points


def changes(inputs: Mapping[str, Any]) -> list[str]:
    """What happened to the files since: a sentence for each that is gone or changed."""
    from orograph.dem.asking import asked

    sentences = []
    files, geoid = inputs["files"], inputs.get("geoid")
    found = [(file, file["path"]) for file in (*files, *([geoid] if geoid else []))]
    for main, beside in zip(files, inputs.get("beside", ())):  # older stores list neither
        found += [(file, f"{file['path']} (of {main['path']})") for file in beside]
    for file, name in found:
        if file["size"] is None:
            continue
        now = state_of(file["path"])
        if "etag" in file:
            if (told_now := asked(file["path"])) is None:
                continue  # (unknown)
            now = {"path": file["path"], **told_now._asdict()}
        if now["size"] is None:
            sentences.append(f"{name} is gone.")
        elif now != file:
            sentences.append(f"{name} was changed.")
    return sentences
