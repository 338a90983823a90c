"""The bytes of the file behind an open dataset, wherever GDAL finds it."""

from __future__ import annotations

import gzip
import re
import shutil
import tarfile
import threading
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from orograph.errors import ReadError
from orograph.folders import temporary

DAMAGED = "The file is damaged or truncated: fetch it again, or restore it from a copy."


class _Opening:
    """Suppresses rasterio's warnings about files without a place, for all threads that open files.

    A filter per thread would not do: filters of other threads may be left behind.
    """

    def __init__(self) -> None:
        self._lock, self._count = threading.Lock(), 0
        self._filters: warnings.catch_warnings[None] | None = None

    def __enter__(self) -> None:
        from rasterio.errors import NotGeoreferencedWarning

        with self._lock:
            if self._filters is None:
                self._filters = warnings.catch_warnings()
                self._filters.__enter__()
                warnings.simplefilter("ignore", NotGeoreferencedWarning)
            self._count += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._count -= 1
            if self._count == 0 and self._filters is not None:
                self._filters.__exit__(None, None, None)
                self._filters = None


OPENING = _Opening()

_FETCHED = {"PNG", "AAIGrid", "GRASSASCIIGrid", "GSAG", "XYZ"}
"""Formats that GDAL fetches whole in any case, so a remote file may be fetched for checking."""


_UNLISTED = {
    "BT": (".prj",), "ILWIS": (".mp#", ".csy", ".grf", ".dom"),
    "MRF": (".idx", ".til", ".ppg", ".pjg", ".pjp", ".pzp", ".ptf", ".lrc", ".pzs"),
}  # fmt: skip
"""Formats → endings of files beside the main one, under its name, that their drivers read and do not list."""

_INNER = re.compile(
    r"""([A-Z][A-Z0-9_]+:(?:\d+:|[A-Z]+(?:_[A-Z]+)*:(?="))?)  # the driver, and what is before the file
        (?:"([^"]*)"|((?:[A-Za-z]:(?=[\\/]))?[^:"]+))(.*)  # the file, and the raster in it""",
    re.VERBOSE | re.DOTALL,
)
_WITHIN = re.compile(r"(vrt://|/vsisubfile/\d+(?:_\d*)?,)([^?]+)(.*)", re.DOTALL)
_ARCHIVE = re.compile(r"/vsi(?:zip|tar|gzip|7z|rar)/")


def file_in(name: str) -> tuple[str, str, str]:
    """Split GDAL's name into what precedes the file, the file, and what follows.

    For ``NETCDF:"a.nc":z`` the file is ``a.nc``. Most names are just the file.
    """
    within = _WITHIN.fullmatch(name)
    if within is not None:
        return within[1], within[2], within[3]
    found = _INNER.fullmatch(name)
    if found is None or Path(name).is_file():
        return "", name, ""
    before, quoted, plain, after = found.groups()
    return (f'{before}"', quoted, f'"{after}') if quoted is not None else (before, plain, after)


def on_disk(name: str) -> Path:
    """The file on this disk behind GDAL's name; for one in an archive, the archive. It need not exist."""
    name = file_in(name)[1]
    inside = _ARCHIVE.match(name)
    if inside is None:
        return Path(name)
    packed = name[inside.end() :].removeprefix("{").partition("}")[0]
    if _ARCHIVE.match(packed):  # an archive in an archive
        return on_disk(packed)
    path = Path(packed)
    return next((at for at in (path, *path.parents) if at.is_file()), path)


def absolute(name: str) -> str:
    """GDAL's name that means the same file from any folder; unchanged if the file is not on this disk."""
    before, file, after = file_in(name)
    at = on_disk(name)
    if not at.exists():
        return name
    archive = _ARCHIVE.match(file)
    if archive is None:
        return f"{before}{at.absolute()}{after}"
    head, path = archive[0], file[archive.end() :]
    brace = "{" if path.startswith("{") else ""
    return f"{before}{head}{brace}{at.absolute()}{path[len(brace) + len(str(at)) :]}{after}"


def main_file(dataset: Any) -> str:
    """GDAL's name of the file that holds a dataset's samples or header."""
    return str(dataset.files[0] if dataset.files else dataset.name)


def files_listed(dataset: Any) -> list[str]:
    """GDAL's names of a dataset's files, and of others, existing or not, that its driver reads without listing them."""
    main = Path(str(dataset.name))
    if main.is_dir():
        return files_in(dataset)
    return [*map(str, dataset.files), *(str(main.with_suffix(e)) for e in _UNLISTED.get(dataset.driver, ()))]


def files_in(dataset: Any) -> list[str]:
    """GDAL's names of a dataset's files: those that its driver lists, and those that it does not."""
    listed = [str(name) for name in dataset.files]
    main = on_disk(str(dataset.name))
    if dataset.driver in _UNLISTED and main.is_file():
        beside = [str(main.with_suffix(ending)) for ending in _UNLISTED[dataset.driver]]
        return list(dict.fromkeys([*listed, *(name for name in beside if Path(name).is_file())]))
    if dataset.driver == "Zarr" and main.is_dir():
        return list(dict.fromkeys([*listed, *sorted(str(path) for path in main.rglob("*") if path.is_file())]))
    return listed


def archive_name(name: str) -> bool:
    """Whether GDAL's name refers to a file in an archive."""
    return bool(_ARCHIVE.match(name)) and "/vsi" not in name[4:]


def archived(name: str) -> bool:
    """Whether GDAL's name refers to a file in a .zip, .gz or .tar on this disk."""
    return name.startswith(("/vsigzip/", "/vsizip/", "/vsitar/")) and on_disk(name).is_file()


def here(name: str) -> bool:
    """Whether GDAL's name refers to a file on this disk, in an archive or not."""
    return archived(name) or Path(name).is_file()


def _member(name: str) -> str:
    """A file's name inside its archive."""
    return name.partition("/vsi")[2].partition("/")[2].removeprefix("{")[len(str(on_disk(name))) :].lstrip("}/")


def _zip_member(packed: zipfile.ZipFile, name: str) -> IO[bytes]:
    """Open a file in an archive; ReadError if Python does not know its compression, or it has a password."""
    try:
        return packed.open(_member(name))
    except (NotImplementedError, RuntimeError) as error:
        raise ReadError(f"It cannot be unpacked here ({error}).", path=name, remedy="Unpack it by hand.") from None


def _plain(packed: tarfile.TarFile, member: tarfile.TarInfo) -> str:
    """A tar member's name in its plain header."""
    if packed.fileobj is None or "path" not in member.pax_headers:
        return member.name
    packed.fileobj.seek(member.offset_data - tarfile.BLOCKSIZE)
    return packed.fileobj.read(100).rstrip(b"\0").decode("utf-8", "replace")


def plain_name(file: Path, name: str) -> str | None:
    """A tar member's name in its plain header; None if there is no such member."""
    with tarfile.open(file) as packed:
        member = next((one for one in packed if one.name == name), None)
        return None if member is None else _plain(packed, member)


@contextmanager
def _tar_member(name: str) -> Iterator[IO[bytes]]:
    with tarfile.open(on_disk(name)) as packed:
        wanted = _member(name)
        try:
            member = packed.getmember(wanted)
        except KeyError:  # GDAL's name of a member with another name in its extended header
            member = next((one for one in packed if _plain(packed, one) == wanted), None) or packed.getmember(wanted)
        inside = packed.extractfile(member)
        if inside is None:
            raise tarfile.TarError(f"{_member(name)} is not a file")
        with inside:
            yield inside
        if packed.fileobj is not None:  # a compressed tar has its checksum at the end
            while packed.fileobj.read(1 << 20):
                pass


@contextmanager
def stream(name: str) -> Iterator[IO[bytes]]:
    """The bytes of a file on this disk or in an archive, best read in order.

    Raises:
        ReadError: an archive is damaged.
    """
    try:
        if not archived(name):
            with Path(name).open("rb") as file:
                yield file
        elif name.startswith("/vsigzip/"):
            with gzip.open(name.removeprefix("/vsigzip/")) as unpacked:
                yield unpacked  # type: ignore[misc]
        elif name.startswith("/vsizip/"):
            with zipfile.ZipFile(on_disk(name)) as packed, _zip_member(packed, name) as inside:
                yield inside
        else:
            with _tar_member(name) as inside:
                yield inside
    except (EOFError, KeyError, zlib.error, zipfile.BadZipFile, gzip.BadGzipFile, tarfile.TarError) as error:
        raise ReadError(f"It cannot be unpacked ({error}).", path=name, remedy=DAMAGED) from None


def check_packed(dataset: Any) -> None:
    """Unpack a dataset's files in an archive up to the end, where the checksums are.

    GDAL does not read the checksums where it needs only a part, and continues where they differ.

    Raises:
        ReadError: an archive is damaged.
    """
    for name in filter(archived, dataset.files):
        if (
            name.startswith("/vsitar/")
            and on_disk(name).suffix.lower() == ".tar"
            and on_disk(name).stat().st_size % 512
        ):
            raise ReadError("It does not consist of whole blocks, as a tar does.", path=name, remedy=DAMAGED)
        with stream(name) as inside:
            while inside.read(1 << 20):
                pass


def _unlisted(dataset: Any, name: str) -> list[str]:
    """GDAL's names of possible companions in a file's archive that are not listed."""
    if name.startswith("/vsigzip/"):
        return []
    stem = name.rpartition(".")[0]
    return [stem + ending for ending in _UNLISTED.get(dataset.driver, ())]


def _unpack(name: str, folder: str) -> None:
    """Write a file of an archive into a folder."""
    with stream(name) as inside, (Path(folder) / Path(name).name).open("wb") as file:
        shutil.copyfileobj(inside, file)


@contextmanager
def local_file(dataset: Any) -> Iterator[str | None]:
    """The path on this disk of a dataset's main file, unpacked or fetched if necessary.

    None if the file is remote and too large for that, or if there is no file.

    Raises:
        ReadError: an archive is damaged.@@ src/orograph/dem/synth.py
    """
    name = main_file(dataset)
    if not name.startswith("/vsi"):
        yield name if Path(name).is_file() else None
        return
    with temporary() as folder:
        out = Path(folder) / Path(name).name
        if archived(name):
            for part in dataset.files:  # companion files with headers and samples count too
                if archived(part):
                    _unpack(part, folder)
            for part in _unlisted(dataset, name):
                with suppress(ReadError):  # not all of them exist
                    _unpack(part, folder)
        elif dataset.driver in _FETCHED:
            from rasterio.shutil import copyfiles

            copyfiles(name, str(out))
        yield str(out) if out.exists() else None
