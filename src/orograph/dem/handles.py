"""Open GDAL datasets, lent to one thread at a time.

A GDAL dataset must not be used by two threads at once, opening one costs most of a small read, and a mosaic has more
files than a process may hold open. So datasets are *borrowed*: a thread gets an idle one of that file or opens another,
and returns it; only the ``IDLE`` most recently used idle ones stay open. A file that was rewritten meanwhile (different
time, size or inode) is reopened; its header may have changed, so code that keeps header data compares the file's state
(``stamped``), and ``states`` that of all files that determine the samples.

GDAL's block cache is left at ``CACHE`` bytes unless GDAL_CACHEMAX says otherwise: its default, 5 % of the machine's
memory, would break our own memory limits.
"""

from __future__ import annotations

import errno
import os
import re
import struct
import tarfile
import threading
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from orograph.dem.conventions import ACROSS, DOWN
from orograph.dem.folders import crowded
from orograph.dem.remote import is_remote, network
from orograph.errors import ReadError

IDLE = 48
MANIFEST = ".manifest.geojsonl"
"""How the names of manifests end (``dem.manifest``)."""
CACHE = 64 << 20

Key = tuple[str, tuple[int, int, int] | None]


def _stamp(path: str | Path) -> tuple[int, int, int] | None:
    try:
        found = os.stat(path)  # noqa: PTH116 (of mosaics thousands at a time)
    except (OSError, ValueError):
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


def stamped(location: str) -> Key:
    """A file's name and state, which changes when it is rewritten."""
    from orograph.dem.whole.files import on_disk

    return location, _stamp(on_disk(location))


class Seen:
    """The state of files when this object is made.

    Args:
        names: GDAL's.
    """

    def __init__(self, names: Iterable[str]) -> None:
        from orograph.dem.whole.files import on_disk

        self._files = [(name, str(path), _stamp(path)) for name in dict.fromkeys(names) for path in (on_disk(name),)]

    def states(self) -> list[tuple[int | None, int | None]]:
        """Size and modification time (ns) of each file when seen; None, None for files not on this disk."""
        return [(None, None) if stamp is None else (stamp[1], stamp[0]) for *_, stamp in self._files]

    def changed(self) -> str | None:
        """The first file that has changed; None if none has."""
        return next((name for name, path, stamp in self._files if _stamp(path) != stamp), None)


def bounded_cache() -> dict[str, Any]:
    """GDAL's settings for writers that keep its block cache small."""
    return {} if "GDAL_CACHEMAX" in os.environ else {"GDAL_CACHEMAX": CACHE}


def _settings(location: str) -> dict[str, Any]:
    """Settings for GDAL.

    Damaged JPEGs and wrong DTED checksums are errors. Text is read as doubles, whatever its first lines look like.
    Vertical datums of GeoTIFF 1.0 count. VRTs do not share their parts, because a part that could once not be opened
    would be 0 in all of them, even when it is back.
    """
    return {
        "VRT_SHARED_SOURCE": "0", "GTIFF_REPORT_COMPD_CS": True,
        "GDAL_ERROR_ON_LIBJPEG_WARNING": True, "DTED_VERIFY_CHECKSUM": True, "AAIGRID_DATATYPE": "Float64",
        **bounded_cache(), **network(location),
        # GDAL itself gives up listing such a folder, after the first thousand names each time.
        **({"GDAL_DISABLE_READDIR_ON_OPEN": "TRUE"} if crowded(location) else {}),
    }  # fmt: skip


_MISLED = (ValueError, TypeError, LookupError, ArithmeticError, SyntaxError, OSError, struct.error)
"""Errors caused by invalid headers."""


class Handles:
    """A pool of open rasterio datasets. All methods may be called from any thread."""

    def __init__(self, idle: int = IDLE) -> None:
        self.limit = idle
        self._lock = threading.Lock()
        self._idle: list[tuple[Key, Any]] = []  # least recently used first

    @contextmanager
    def borrow(self, location: str) -> Iterator[Any]:
        """A dataset of ``location`` for this thread alone, inside a GDAL environment.

        Raises:
            ReadError: the file cannot be opened.
        """
        import rasterio
        from rasterio._err import CPLE_BaseError

        from orograph.dem.whole import DAMAGED, check_file

        key = stamped(location)
        with rasterio.Env(**_settings(location)):
            with self._lock:
                found = next((i for i in reversed(range(len(self._idle))) if self._idle[i][0] == key), None)
                dataset = None if found is None else self._idle.pop(found)[1]
            if dataset is None:
                dataset = open_dataset(location)
            try:
                try:
                    check_file(dataset, location, key)
                except _MISLED as error:
                    raise ReadError(
                        f"Its header cannot be understood ({' '.join(str(error).split())}).", path=location,
                        remedy=DAMAGED,
                    ) from None  # fmt: skip
                yield dataset
            except (SyntaxError, UnicodeDecodeError, struct.error) as error:
                dataset.close()
                raise ReadError(
                    f"Its header cannot be understood ({' '.join(str(error).split())}).", path=location, remedy=DAMAGED
                ) from None
            except CPLE_BaseError as error:  # while rasterio reads optional parts of a header, where it ignores errors
                dataset.close()
                raise ReadError(f"GDAL cannot read it: {cause_of(error)}", path=location, remedy=DAMAGED) from None
            except BaseException:
                dataset.close()
                raise
            with self._lock:
                self._idle.append((key, dataset))
                surplus = [self._idle.pop(0)[1] for _ in range(len(self._idle) - self.limit)]
            for old in surplus:
                old.close()

    def close(self, location: str | None = None) -> None:
        """Close the idle datasets (of one file)."""
        with self._lock:
            gone = [d for k, d in self._idle if location in (None, k[0])]
            self._idle = [(k, d) for k, d in self._idle if location not in (None, k[0])]
        for dataset in gone:
            dataset.close()

    def __len__(self) -> int:
        return len(self._idle)


HANDLES = Handles()


@contextmanager
def lent(location: str) -> Iterator[tuple[Any, Key]]:
    """A dataset of ``location`` for this thread alone, and the file's name and state."""
    with HANDLES.borrow(location) as dataset:
        yield dataset, stamped(location)


def is_manifest(path: str | os.PathLike[str]) -> bool:
    """Whether a file lists others (``dem.manifest``), by its name."""
    return os.fspath(path).lower().endswith(MANIFEST)


def locate(path: str | os.PathLike[str]) -> str:
    """GDAL's name for ``path``: the raster inside a .zip, .tar or .gz, else the path itself (URLs pass through).

    Raises:
        ReadError: there is no such file, it is a directory, or an archive holds no or several rasters.
    """
    text = os.fspath(path)
    packed = re.fullmatch(r"/vsizip/([^{].*?\.zip)/(.+)", text, re.IGNORECASE)
    if packed is not None and Path(packed[1]).is_file():
        return f"/vsizip/{{{packed[1]}}}/{packed[2]}"
    if "://" in text or text.startswith("/vsi") or (":" in text and not Path(text).exists() and text[1:2] != ":"):
        return text
    file = Path(text)
    if is_manifest(text):
        raise ReadError(
            "This is a manifest, which lists rasters, but one raster is needed here.",
            path=text,
            remedy="Give one of them.",
        )
    if file.is_dir() and not (file / "hdr.adf").exists() and file.suffix.lower() != ".zarr":
        if (file / "zarr.json").exists():
            raise ReadError(
                "This is a store: give it alone, open it (`orograph.open`), or export it (`orograph.export`).",
                path=text,
            )
        raise ReadError(
            "This is a directory, not an elevation raster.", path=text, remedy="Give the files in it, e.g. DIR/*.tif."
        )
    try:
        file.stat()
    except (OSError, ValueError) as error:
        raise _absent(file, error) from None
    if file.is_file() and file.stat().st_size == 0:
        raise ReadError("The file is empty.", path=text, remedy="Fetch it again, or restore it from a copy.")
    if file.suffix.lower() == ".zip":
        return f"/vsizip/{{{file.as_posix()}}}/{_member(file)}"
    if _kind(file) == "tar":
        return _in_tar(file, _member(file))
    if file.suffix.lower() == ".gz":
        return f"/vsigzip/{file.as_posix()}"
    return text


def _in_tar(file: Path, name: str) -> str:
    """GDAL's name of a member of a tar.

    It is the name in the plain header if GDAL does not read the extended header (PAX), which alone can hold non-ASCII
    letters.
    """
    from orograph.dem.whole.files import plain_name

    location = f"/vsitar/{{{file.as_posix()}}}/{name}"
    if name.isascii() and len(name) <= 100:
        return location
    from rasterio.shutil import exists

    plain = plain_name(file, name)
    return location if plain is None or exists(location) else f"/vsitar/{{{file.as_posix()}}}/{plain}"


def _absent(file: Path, error: OSError | ValueError) -> ReadError:
    """The reason why a file cannot be opened."""
    code = getattr(error, "errno", None)
    if code == errno.ELOOP:
        return ReadError("It is a link to itself.", path=file, remedy="Name the file itself.")
    if code == errno.ENOENT and file.is_symlink():
        return ReadError(
            f"It is a link to {file.readlink()}, which does not exist.", path=file, remedy="Name the file itself."
        )
    if code in (errno.ENOENT, errno.ENOTDIR):
        return ReadError("There is no such file.", path=file, remedy="Check the spelling of the path.")
    return ReadError(
        f"It cannot be opened: {getattr(error, 'strerror', error)}.",
        path=file,
        remedy="Check the path and its permissions.",
    )


SIDE_FILES = {
    ".xml",
    ".txt",
    ".prj",
    ".tfw",
    ".hdr",
    ".md",
    ".pdf",
    ".html",
    ".jpg",
    ".kml",
    ".ovr",
    ".msk",
    ".wld",
    ".csv",
}


TARS = (".tar", ".tar.gz", ".tgz")
"""Endings of tar archives."""


def _kind(file: Path) -> str:
    """The kind of an archive: tar or zip."""
    return "tar" if file.name.lower().endswith(TARS) else "zip"


def _names(file: Path) -> list[str]:
    """The files in an archive."""
    if _kind(file) == "zip":
        with zipfile.ZipFile(file) as packed:
            return [name for name in packed.namelist() if not name.endswith("/")]
    with tarfile.open(file) as archive:
        return [member.name for member in archive if member.isfile()]


def _member(file: Path) -> str:
    try:
        names = [name for name in _names(file) if not name.startswith("__MACOSX")]
    except (zipfile.BadZipFile, tarfile.TarError, EOFError, zlib.error, OSError) as error:
        raise ReadError(
            f"This is not a readable {_kind(file)} archive ({' '.join(str(error).split())}).",
            path=file,
            remedy="Fetch it again, or unpack it by hand.",
        ) from None
    rasters = [n for n in names if Path(n).suffix.lower() not in SIDE_FILES] if len(names) > 1 else names
    if len(rasters) == 1:
        return rasters[0]
    if not rasters:
        raise ReadError("The archive holds no raster.", path=file, remedy="Give an archive with an elevation raster.")
    shown = ", ".join(rasters[:6]) + ("…" if len(rasters) > 6 else "")
    raise ReadError(
        f"The archive holds {len(rasters)} files that may be rasters ({shown}).",
        path=file,
        remedy=f"Name one of them: /vsi{_kind(file)}/{file.as_posix()}/{rasters[0]}",
    )


def open_dataset(location: str) -> Any:
    """A rasterio dataset open for reading.

    Raises:
        ReadError: GDAL cannot open it, or it is a container of several rasters.
    """
    import rasterio
    from rasterio.errors import RasterioError

    from orograph.dem.missing import KEEP_RANGE, is_limited
    from orograph.dem.whole import DAMAGED, fault_before
    from orograph.dem.whole.files import OPENING

    fault = fault_before(location)
    if fault is not None:
        raise ReadError(fault, path=location, remedy=DAMAGED)
    try:
        with OPENING:
            dataset = rasterio.open(location)
            if is_limited(dataset):
                dataset.close()
                dataset = rasterio.open(location, **KEEP_RANGE)
    except (RasterioError, OSError, ValueError) as error:
        raise ReadError(
            f"GDAL cannot open it: {cause_of(error)}", path=location, remedy=_remedy(location, error)
        ) from None
    if dataset.count == 0:
        inside = sorted(dataset.subdatasets, key=_is_axis)
        dataset.close()
        shown = "; ".join(inside[:6]) + ("…" if len(inside) > 6 else "")
        raise ReadError(
            f"The file holds {len(inside)} rasters and does not say which is meant ({shown})."
            if inside
            else "The file holds no raster band.",
            path=location,
            remedy=f"Name one of them as the path, e.g. '{inside[0]}'." if inside else "Name an elevation raster.",
        )
    return dataset


def _is_axis(name: str) -> bool:
    """Whether a raster within a file has the name of coordinates along an axis."""
    return re.split(r"[:/]", name.strip('"'))[-1].lower() in ACROSS | DOWN


def cause_of(error: BaseException) -> str:
    """GDAL's message about a failure: the innermost one, on one line, ending in a full stop."""
    inner: BaseException = error
    while inner.__cause__ is not None:
        inner = inner.__cause__
    text = " ".join((getattr(inner, "errmsg", "") or str(inner) or type(inner).__name__).split())
    text = re.sub(r"\b0x[0-9a-f]{6,}, ?", "", text)  # addresses, which differ between runs
    return text if text.endswith(".") else text + "."


def _remedy(location: str, error: BaseException) -> str:
    text = str(error).lower()
    if "codec" in text and ".zarr" in location.lower():
        return "This build of GDAL lacks the codec: open it in Python (xarray.open_zarr), and give that to Orograph."
    if "codec" in text:
        return "This build of GDAL lacks the codec: rewrite it with another (gdal_translate -co COMPRESS=ZSTD)."
    if location.lower().endswith((".hgt", ".hgt.gz")):
        return "GDAL recognises .hgt files by name and size: the name must be like N44W072.hgt (the south-west corner)."
    if location.lower().endswith(".pmtiles") or location.lower().endswith(".mbtiles"):
        return "Convert tile archives to one raster first (gdal_translate to GeoTIFF)."
    if location.lower().endswith((".nc", ".nc4", ".h5", ".hdf5", ".cdf")):
        return "GDAL finds no raster in it: look for an empty dimension or missing coordinates (ncdump -h)."
    if location.startswith(("/vsizip/{", "/vsigzip/")):
        return "Give an archive that holds an elevation raster, or unpack it and give the raster."
    if is_remote(location):
        return "Check the address, the network and the credentials."
    return "Check that gdalinfo can read it and that it is complete (fetch it again if it was truncated)."
