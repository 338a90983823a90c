"""What a store was built from, as its record keeps it: so that it can be built or mended again by one command.

Paths are absolute; of URLs what may be secret (user, password, query) is left out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orograph.progress import SILENT, Progress
from orograph.store.source import HeightSource

DEFAULTS: dict[str, Any] = {"band": 1, "resampling": "bilinear"}
"""Of the options that are not None by default."""


def inputs_of(source: HeightSource) -> dict[str, Any] | None:
    """The files and options of a source that can be opened again by them (``Mosaic.recipe``); None of others."""
    recipe = getattr(source, "recipe", None)
    found = None if recipe is None else recipe()
    if found is None:
        return None
    files, options = found
    return {
        "files": [_file(path) for path in files],
        "options": {k: v for k, v in options.items() if v is not None and v != DEFAULTS.get(k)},
    }


def _file(path: str) -> dict[str, Any]:
    file = Path(path)
    if not file.is_file():
        return {"path": str(file.absolute()) if file.exists() else _public(path), "size": None, "time_ns": None}
    found = file.stat()
    return {"path": str(file.absolute()), "size": found.st_size, "time_ns": found.st_mtime_ns}


def _public(url: str) -> str:
    """A URL without user, password and query."""
    return re.sub(r"://[^/@]*@", "://", url).partition("?")[0]


def reopened(inputs: Mapping[str, Any], progress: Progress = SILENT) -> HeightSource:
    """The source again.

    Raises:
        ReadError: a file cannot be read.
    """
    from orograph.dem.mosaic import Mosaic

    return Mosaic.open([file["path"] for file in inputs["files"]], progress=progress, **inputs["options"])


def changes(inputs: Mapping[str, Any]) -> list[str]:
    """What became of the files since: a sentence for each that is gone or another."""
    told = []
    for file in inputs["files"]:
        if file["size"] is None:
            continue
        now = _file(file["path"])
        if now["size"] is None:
            told.append(f"{file['path']} is gone.")
        elif now != file:
            told.append(f"{file['path']} was changed.")
    return told
