"""The bytes of the file behind an open dataset, wherever GDAL finds it."""

from __future__ import annotations

import gzip
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from orograph.errors import ReadError

DAMAGED = "The file is damaged or was cut short: fetch it again, or restore it from a copy."

_FETCHED = {"PNG", "AAIGrid", "GRASSASCIIGrid", "GSAG", "XYZ"}
"""Formats that GDAL fetches whole in any case, so that a remote one may be fetched to be looked at."""


def main_file(dataset: Any) -> str:
    """GDAL's name of the file that holds a dataset's samples or header."""
    return str(dataset.files[0] if dataset.files else dataset.name)


def archived(name: str) -> bool:
    """Whether a file of GDAL's name lies in a .zip or .gz."""
    return name.startswith(("/vsizip/{", "/vsigzip/"))


def here(name: str) -> bool:
    """Whether a file of GDAL's name lies on this disk, in an archive or not."""
    return archived(name) or Path(name).is_file()


@contextmanager
def stream(name: str) -> Iterator[IO[bytes]]:
    """The bytes of a file on this disk, or of one in an archive: best read forwards.

    Raises:
        ReadError: an archive is damaged.
    """
    try:
        if name.startswith("/vsizip/{"):
            archive, _, member = name.removeprefix("/vsizip/{").partition("}/")
            with zipfile.ZipFile(archive) as packed, packed.open(member) as inside:
                yield inside
        elif name.startswith("/vsigzip/"):
            with gzip.open(name.removeprefix("/vsigzip/")) as unpacked:
                yield unpacked  # type: ignore[misc]
        else:
            with Path(name).open("rb") as file:
                yield file
    except (EOFError, zlib.error, zipfile.BadZipFile, gzip.BadGzipFile) as error:
        raise ReadError(f"It cannot be unpacked ({error}).", path=name, remedy=DAMAGED) from None


@contextmanager
def local_file(dataset: Any) -> Iterator[str | None]:
    """The path on this disk of a dataset's main file, unpacked or fetched for this if need be; None if it is remote and
    too large for that, or no file.

    Raises:
        ReadError: an archive is damaged.
    """
    name = main_file(dataset)
    if not name.startswith("/vsi"):
        yield name if Path(name).is_file() else None
        return
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / Path(name).name
        if archived(name):
            with stream(name) as inside, out.open("wb") as file:
                shutil.copyfileobj(inside, file)
        elif dataset.driver in _FETCHED:
            from rasterio.shutil import copyfiles

            copyfiles(name, str(out))
        yield str(out) if out.exists() else None
