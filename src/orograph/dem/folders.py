"""Folders of files: the rasters of a folder given as terrain, and the companions of a file.

A folder stands for the rasters in it and below it with the endings of elevation files; the products' companion rasters
(masks, counts, qualities) are left out. GDAL looks for headers and masks beside each file. A mosaic may have thousands
of files in one folder, so its names are listed once, and kept while its modification time is unchanged.
"""

from __future__ import annotations

import bisect
import itertools
import os
import re
import time
from pathlib import Path
from typing import NamedTuple

from orograph.progress import Progress

_FRESH = 2.0
"""Seconds within which a folder may change without a change of its modification time."""

RASTERS = frozenset(
    f".{one}"
    for one in (
        "tif", "tiff", "gtiff", "hgt", "dt0", "dt1", "dt2", "asc", "grd", "dem", "bil", "bip", "bsq", "flt", "img",
        "nc", "nc4", "h5", "hdf5", "bag", "jp2", "ter", "sdat", "rst", "map", "bt", "hf2", "sigdem", "ers", "cub",
    )
)  # fmt: skip
"""Endings of the files that a folder stands for; pictures of heights, points and other files must be given by name."""

BESIDE = re.compile(
    r"_(edm|flm|hem|wbm|acm|src|msk|stk|num|swb|qai|lst)\.tiff?(\.gz|\.zip)?$|\.(num|swb)(\.gz|\.zip)?$", re.IGNORECASE
)
"""Companion rasters of the products of Copernicus, ALOS, ASTER and NASADEM."""

_folders: dict[str, tuple[int, list[str]]] = {}


def crowded(location: str) -> bool:
    """Whether a file's folder is known to hold so many files that GDAL does not list them."""
    return len(_folders.get(os.path.split(location)[0], (0, []))[1]) > 1000


def beside(location: str) -> list[str]:
    """The companions of a file on this disk: names that match its own except for the ending (headers, masks…)."""
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


class Inside(NamedTuple):
    """The content of a folder.

    Attributes:
        rasters: the files it stands for, in the order of their names. others: how many are left out.
    """

    rasters: list[str]
    others: int


def is_folder(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a folder of files, not one that is a raster (ESRI grid, Zarr) or a store."""
    text = os.fspath(path)
    if "://" in text or text.startswith("/vsi"):
        return False
    folder = Path(text)
    try:
        return folder.is_dir() and not (folder / "hdr.adf").exists() and not _is_zarr(folder)
    except (OSError, ValueError):
        return False


def inside(path: str | os.PathLike[str]) -> Inside:
    """The rasters in a folder and below it; a VRT only if there is nothing else, since it refers to the rest."""
    rasters: list[Path] = []
    virtual: list[Path] = []
    others = 0
    for root, folders, names in os.walk(path):
        here = Path(root)
        if "hdr.adf" in names:  # (its other files are parts of it)
            rasters.append(here)
            folders.clear()
            continue
        folders[:] = sorted(
            name for name in folders if not name.startswith(".") and name != "info" and not _is_zarr(here / name)
        )
        for name in names:
            plain = re.sub(r"\.(zip|gz)$", "", name, flags=re.IGNORECASE)
            ending = Path(plain).suffix.lower()
            if name.startswith(".") or (ending not in RASTERS and ending != ".vrt") or BESIDE.search(name):
                others += 1
            else:
                (virtual if ending == ".vrt" else rasters).append(here / name)
    if rasters:
        others, virtual = others + len(virtual), []
    return Inside([str(one) for one in sorted(rasters or virtual)], others)


def taken(path: str | os.PathLike[str], progress: Progress) -> list[str]:
    """The files that a path stands for: itself, or the rasters of a folder, whose number is reported."""
    found = inside(path) if is_folder(path) else Inside([], 0)
    if not found.rasters:  # (an empty folder's own error appears when it is opened)
        return [os.fspath(path)]
    left = f"; {_counted(found.others, 'other file')} left out" if found.others else ""
    progress.note(f"{os.fspath(path)}: {_counted(len(found.rasters), 'raster')} taken{left}")
    return found.rasters


def _counted(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def _is_zarr(folder: Path) -> bool:
    endings = (".zarr", ".oro", ".partial")
    return folder.suffix.lower() in endings or any((folder / f).exists() for f in ("zarr.json", ".zgroup", ".zarray"))
