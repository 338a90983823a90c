"""Files that GDAL writes: complete or not at all, and without libtiff's own messages on the screen.

GDAL writes a raster's last blocks and its directory when it is closed, and rasterio does not report errors of that
step: if the disk becomes full at that moment, an unreadable or incomplete file silently remains. So a file is checked
before it gets its name. libtiff also prints its errors on standard error; this is turned off.
"""

from __future__ import annotations

import ctypes
import functools
import glob
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from orograph.dem.handles import bounded_cache, cause_of
from orograph.errors import OutputError
from orograph.output import Beside, remove

_ROOM = "Check that the disk has space and that you may write to the folder."
_ENDS = {b"\x89PNG": b"IEND\xaeB`\x82", b"\xff\xd8\xff": b"\xff\xd9"}
"""First bytes of formats: their last ones (PNG 3rd edition, 11.2.5; ITU-T T.81, B.2.1)."""


@contextmanager
def raster_file(out: Path, cache: int | None = None, keep: bool = False) -> Iterator[Path]:
    """A path for GDAL to write to, which becomes ``out`` if the file is complete; a context around writing and closing.

    Args:
        cache: bytes of GDAL's cache of blocks; None: as for reading.
        keep: as for ``Beside``.

    Raises:
        OutputError: it cannot be written. An existing file is unchanged.
    """
    with Beside(out, keep) as part, gdal_writes(out, cache):
        yield part
        check_written(part, out)


@contextmanager
def gdal_writes(out: Path, cache: int | None = None) -> Iterator[None]:
    """GDAL's settings for writers, with its errors raised as OutputError of ``out``."""
    import rasterio
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    _silence_libtiff()
    settings = bounded_cache() if cache is None else {"GDAL_CACHEMAX": cache}
    try:
        with rasterio.Env(GDAL_PAM_ENABLED="NO", **settings), warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)  # a picture in perspective has no place
            yield
    except (RasterioError, CPLE_BaseError) as error:
        raise OutputError(f"The file cannot be written: {cause_of(error)}", path=out, remedy=_ROOM) from error
    except SystemError as error:  # rasterio's own, if GDAL fails without a reason
        raise OutputError("The file cannot be written.", path=out, remedy=_ROOM) from error


def write_cog(
    source: Path, part: Path, *, floats: bool, overviews: str = "AVERAGE", threads: int = 1, level: int = 6
) -> None:
    """Copy a raster that GDAL reads into a cloud-optimised GeoTIFF (GDAL's driver COG), within ``raster_file``.

    The driver makes the overviews first, in files beside ``part``; the source is only read.

    Args:
        floats: whether samples are floating-point. overviews: how overviews are made. level: of compression.
    """
    import rasterio.shutil

    try:
        rasterio.shutil.copy(
            source, part, driver="COG", COMPRESS="DEFLATE", LEVEL=level, BLOCKSIZE=512,
            PREDICTOR="FLOATING_POINT" if floats else "STANDARD", BIGTIFF="IF_SAFER", OVERVIEW_RESAMPLING=overviews,
            NUM_THREADS=threads,
        )  # fmt: skip
    finally:
        for left in part.parent.glob(f"{glob.escape(part.name)}*.tmp"):  # from an interrupted copy
            remove(left)


def check_written(part: Path, out: Path) -> None:
    """Raise OutputError of ``out`` unless a file that GDAL has closed is complete.

    It must have reached the disk and have its end and, as a TIFF, all of its blocks.
    """
    from rasterio.errors import RasterioError

    try:
        with part.open("r+b") as file:
            os.fsync(file.fileno())  # where space is accounted late (NFS, quotas), the error appears here
        whole = _whole(part)
    except (OSError, RasterioError):
        whole = False
    if not whole:
        raise OutputError("The file cannot be written: only part of it reached the disk.", path=out, remedy=_ROOM)


def _whole(path: Path) -> bool:
    import rasterio

    size = path.stat().st_size
    with path.open("rb") as file:
        first = file.read(12)
        file.seek(-min(size, 8), os.SEEK_END)
        last = file.read()
    if first[:4] == b"RIFF":
        return int.from_bytes(first[4:8], "little") + 8 <= size
    for begin, end in _ENDS.items():
        if first.startswith(begin):
            return last.endswith(end)
    with rasterio.open(path) as dataset:
        levels = len(dataset.overviews(1))
        sound = _has_blocks(dataset, size)
    for level in range(levels):
        with rasterio.open(path, overview_level=level) as dataset:
            sound = sound and _has_blocks(dataset, size)
    return sound


def _has_blocks(dataset: Any, size: int) -> bool:
    """Whether all blocks of a TIFF, or of its opened overview, lie within a file of so many bytes."""
    from rasterio.enums import Interleaving

    high, wide = dataset.block_shapes[0]
    planes = 1 if dataset.interleaving == Interleaving.pixel else dataset.count
    for band in range(1, planes + 1):
        for row in range(-(-dataset.height // high)):
            for col in range(-(-dataset.width // wide)):
                place = [dataset.get_tag_item(f"BLOCK_{what}_{col}_{row}", "TIFF", bidx=band)
                         for what in ("OFFSET", "SIZE")]  # fmt: skip
                if not all(place) or sum(map(int, place)) > size:
                    return False
    return True


@functools.cache
def _silence_libtiff() -> None:
    """Turn off messages of the libtiff that GDAL uses, if it is a separate library, found through rasterio."""
    import rasterio._io

    try:
        setter = ctypes.CDLL(rasterio._io.__file__).TIFFSetErrorHandler
    except (OSError, AttributeError):  # part of GDAL, or a system that does not list a library's dependencies
        return
    setter.restype, setter.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
    setter(None)
