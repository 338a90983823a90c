"""Telling stores (Zarr groups) from raster files by a path or URL, with a single look."""

from __future__ import annotations

import os
from pathlib import Path

from orograph.errors import ReadError, StoreError
from orograph.store.addresses import storage_at
from orograph.store.places import PLAN, ROOT, VERSION, left_over, names_version
from orograph.store.versions import folder_of


def is_store(path: str | os.PathLike[str]) -> bool:
    """Whether a folder or URL holds a Zarr group or an unfinished build, or is named like a version of a store.

    ``store.open`` refuses the latter two and explains.

    Raises:
        ReadError: a URL that could be a store cannot be reached.
    """
    text = os.fspath(path)
    if "://" not in text:
        folder = Path(folder_of(text))
        if (folder / ROOT).is_file() or (folder / PLAN).is_file():
            return True
        return not folder.exists() and (left_over(folder) or names_version(folder))
    last = text.rstrip("/").rpartition("/")[2].partition("?")[0]
    version = VERSION.fullmatch(last)
    if Path(version[1] if version else last).suffix not in ("", ".oro", ".zarr"):
        return False
    try:
        place = storage_at(text)
        return place.number is not None or place.exists(ROOT)
    except StoreError as error:
        raise ReadError(
            f"It cannot be reached: {error.what}", path=text, remedy="Check the URL and the network."
        ) from error
