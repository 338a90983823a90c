"""The names in folders of files, as GDAL looks for headers and masks there; each folder is listed once.

Mosaics have thousands of files in one folder, so its names are kept as long as its time of change stays what it was.
"""

from __future__ import annotations

import bisect
import itertools
import os
import time

_FRESH = 2.0
"""Seconds within which a folder may change without its time of change telling."""

_folders: dict[str, tuple[int, list[str]]] = {}


def crowded(location: str) -> bool:
    """Whether a file is known to lie among so many that GDAL does not look at their names."""
    return len(_folders.get(os.path.split(location)[0], (0, []))[1]) > 1000


def beside(location: str) -> list[str]:
    """The names of what lies beside a file on this disk under its name but for the ending: where headers, masks and the
    like come to lie."""
    folder, name = os.path.split(location)
    try:
        changed = os.stat(folder or ".").st_mtime_ns  # noqa: PTH116 (of mosaics thousands at a time)
        held = _folders.get(folder)
        if held is None or held[0] != changed:
            names = sorted(os.listdir(folder or "."), key=str.lower)  # noqa: PTH208 (names alone are wanted)
            held = changed, names
            if time.time() - changed / 1e9 > _FRESH:
                if len(_folders) > 64:
                    _folders.clear()
                _folders[folder] = held
    except (OSError, ValueError):
        return []
    stem = f"{name.rpartition('.')[0] or name}.".lower()
    at = bisect.bisect_left(held[1], stem, key=str.lower)
    return [
        one
        for one in itertools.takewhile(lambda one: one.lower().startswith(stem), held[1][at : at + 64])
        if one != name
    ]
