"""Where files derived from a user's data are kept, for the next run or only this one, and how much of them. Bytes."""

from __future__ import annotations

import contextlib
import functools
import glob
import mmap
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, overload

from orograph.errors import OutputError, UsageError
from orograph.processes import host, running

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Amount: TypeAlias = int | str
"""An amount of memory as users give it: a number of bytes, or a text such as "1GiB"."""

HELD = 1 << 26
"""Tables up to this many bytes are held in memory; larger ones go to a scratch file."""

CACHE_SIZE = "20GiB"
"""Size of the cache folder, unless ``$OROGRAPH_CACHE_SIZE`` says otherwise."""

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}


def cache_folder() -> Path:
    """The folder for stores of large DEMs and coarse levels of images: ``$OROGRAPH_CACHE``, else the platform's cache
    folder."""
    if chosen := os.environ.get("OROGRAPH_CACHE"):
        return Path(chosen)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "orograph"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "orograph" / "cache"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "orograph"


def cache_limit() -> int:
    """How many bytes the cache folder may hold.

    Raises:
        UsageError: ``$OROGRAPH_CACHE_SIZE`` is not a size.
    """
    text = os.environ.get("OROGRAPH_CACHE_SIZE") or CACHE_SIZE
    try:
        return parse_bytes(text)
    except ValueError:
        raise UsageError(
            f"OROGRAPH_CACHE_SIZE is {text!r}, which is not a size.", remedy="Write it like 20GiB, 512MiB or 2G."
        ) from None


@overload
def bytes_of(value: Amount, called: str = "max_memory") -> int: ...


@overload
def bytes_of(value: Amount | None, called: str = "max_memory") -> int | None: ...


def bytes_of(value: Amount | None, called: str = "max_memory") -> int | None:
    """Bytes of what a user gave: a number, or a text such as "1GiB"; None stays None.

    Args:
        called: the argument, for errors.

    Raises:
        UsageError: it is not an amount of memory.
    """
    if value is None:
        return None
    with contextlib.suppress(ValueError, TypeError, OverflowError):
        size = parse_bytes(value) if isinstance(value, str) else int(value)
        if size >= 1 and (isinstance(value, str) or size == value) and not isinstance(value, bool):
            return size
    raise UsageError(f"`{called}` is a whole number of bytes, or a text such as '1GiB' or '512MiB', not {value!r}.")


def parse_bytes(text: str) -> int:
    """Bytes in "1GiB", "512 MiB", "1.5G" (10^9) or "4096".

    Raises:
        ValueError: not a number with one of these units, or less than one byte.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([kmgt]i?)?b?\s*", text, re.IGNORECASE)
    size = int(float(found[1]) * _UNITS[(found[2] or "").lower()]) if found else 0
    if size < 1:
        raise ValueError(f"{text!r} is not an amount of memory (write it like 1GiB, 512MiB or 2G)")
    return size


def held(length: int) -> tuple[NDArray[np.uint8], Callable[[], None]]:
    """As ``scratch``, but in memory if the amount is small."""
    import numpy as np

    return scratch(length) if length > HELD else (np.zeros(length, np.uint8), lambda: None)


def temporary() -> tempfile.TemporaryDirectory[str]:
    """A temporary folder; folders of killed processes are removed.

    Raises:
        OutputError: nothing can be written to the temporary folder.
    """
    try:
        _sweep(tempfile.gettempdir())
        return tempfile.TemporaryDirectory(prefix=f"{_ours()}{os.getpid()}-", ignore_cleanup_errors=True)
    except OSError as error:
        raise OutputError(
            f"Nothing can be written to the temporary folder: {error.strerror}.", path=tempfile.gettempdir(),
            remedy="Set TMPDIR to a folder with room.",
        ) from error  # fmt: skip


def _ours() -> str:
    return f"orograph-{host()}-"


@functools.cache
def _sweep(folder: str) -> None:
    """Remove what ended processes of this machine left in a temporary folder."""
    for path in Path(folder).glob(f"{glob.escape(_ours())}*-*"):
        pid = path.name.removeprefix(_ours()).partition("-")[0]
        if pid.isdecimal() and not running(int(pid)):
            shutil.rmtree(path, ignore_errors=True)


def scratch(length: int) -> tuple[NDArray[np.uint8], Callable[[], None]]:
    """``length`` zero bytes in a scratch file, as an array, and a function that releases their memory.

    Raises:
        OutputError: the temporary folder has no room.
    """
    import numpy as np  # (the command line starts without it)

    try:
        with tempfile.TemporaryFile(prefix="orograph-") as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, length)  # a full disk raises an error here, not a signal later
            else:
                file.truncate(length)
            mapped = mmap.mmap(file.fileno(), length)
    except OSError as error:
        raise OutputError(
            f"There is no room for {length >> 20} MiB of scratch: {error.strerror}.",
            path=tempfile.gettempdir(),
            remedy="Set TMPDIR to a folder with room, or allow more memory.",
        ) from error

    def release() -> None:
        if hasattr(mapped, "madvise"):
            with contextlib.suppress(OSError):
                mapped.madvise(mmap.MADV_DONTNEED)  # of a shared mapping: the file keeps the data

    return np.frombuffer(mapped, np.uint8), release
