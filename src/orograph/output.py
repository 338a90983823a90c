"""Files appear whole or not at all: results are written beside their destination and renamed when finished.

The temporary file is named after the machine and the process: ``.sky.tif.HOST.PID.part``. A killed process leaves it
behind; the next process that writes the same result removes it.
"""

from __future__ import annotations

import contextlib
import functools
import glob
import math
import os
import re
import shutil
from pathlib import Path

from orograph.errors import OutputError
from orograph.processes import host, running


def check_folder(path: Path) -> None:
    """Raise OutputError unless there is a folder to write ``path`` into."""
    if not path.parent.is_dir():
        raise OutputError(f"There is no folder {path.parent} to write to.", path=path, remedy="Make it first.")


def same_file(a: str | os.PathLike[str], b: str | os.PathLike[str]) -> bool:
    """Whether two paths are the same file, or will be once both exist."""
    try:
        return Path(a).samefile(b)
    except (OSError, ValueError):
        return os.path.normcase(os.path.realpath(a)) == os.path.normcase(os.path.realpath(b))


def check_vacant(path: Path, overwrite: bool) -> None:
    """Raise OutputError if a file is there that must not be replaced."""
    if path.exists() and not overwrite:
        raise OutputError("Something is there already.", path=path, remedy="Replace it with `overwrite=True`.")


def beside(out: Path, ending: str) -> Path:
    """A temporary name beside ``out`` for a file or folder of this process; leftovers of ended processes are removed.

    Args:
        ending: "part" or "raw".
    """
    # A name without a host belongs to this machine.
    ours = re.compile(rf"\.{re.escape(out.name)}\.(?:{re.escape(host())}\.)?(\d+)\.(?:part|raw)(?:\..+)?")
    for path in _left(out.parent.absolute()):
        found = ours.fullmatch(path.name)
        if found is not None and not running(int(found[1])):
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else remove(path)
    return out.with_name(f".{out.name}.{host()}.{os.getpid()}.{ending}")


@functools.cache
def _left(folder: Path) -> list[Path]:
    """What processes may have left in a folder (an absolute path) before it was first written to."""
    with contextlib.suppress(OSError):
        return [path for path in folder.iterdir() if re.fullmatch(r"\..+\.\d+\.(part|raw)(\..+)?", path.name)]
    return []


def check_room(path: Path, size: int) -> None:
    """Raise OutputError if the disk of ``path`` has less than ``size`` bytes free, or this process may not write a file
    of that size. Libraries that meet this themselves print lines of their own."""
    allowed = _largest_file()
    if allowed < size:
        raise OutputError(
            f"A file of {size / 1e6:,.2f} MB is needed on the way, and this process may write no file larger than "
            f"{allowed / 1e6:,.2f} MB.", path=path, remedy="Raise that limit of your shell (ulimit -f).",
        )  # fmt: skip
    free = shutil.disk_usage(path.parent).free
    if free < size:
        raise OutputError(
            f"There is not enough room: {size / 1e6:,.1f} MB are needed on the way, {free / 1e6:,.1f} MB are free.",
            path=path, remedy="Make room, or write to another disk.",
        )  # fmt: skip


def _largest_file() -> float:
    """The largest file that this process may write, bytes."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return math.inf
    allowed = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    return math.inf if allowed == resource.RLIM_INFINITY else allowed


def remove(path: Path) -> None:
    """Remove a file if it is there and can be removed (on a read-only disk it cannot)."""
    with contextlib.suppress(OSError):
        path.unlink()


_unfinished: set[Path] = set()


def remove_unfinished() -> None:
    """Remove unfinished files and their companions: the process is about to end."""
    for part in list(_unfinished):
        for left in part.parent.glob(f"{glob.escape(part.name)}*"):
            remove(left)


class Beside:
    """A temporary path beside ``out`` that becomes ``out`` on success and vanishes on failure.

    Args:
        keep: leave an existing file with the same bytes alone, since another process may be reading it.
    """

    def __init__(self, out: Path, keep: bool = False) -> None:
        self.out, self.keep = out, keep

    def __enter__(self) -> Path:
        check_folder(self.out)
        if self.out.is_dir():
            raise OutputError("It is a folder, not a file.", path=self.out, remedy="Name a file in it.")
        self.part = beside(self.out, "part")
        _unfinished.add(self.part)
        return self.part

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        _unfinished.discard(self.part)
        if kind is None:
            try:
                if not (self.keep and self._kept()):
                    self.part.replace(self.out)
            except OSError as cause:
                remove(self.part)
                raise OutputError(f"The file cannot be written: {cause.strerror}.", path=self.out) from cause
            return
        remove(self.part)
        if isinstance(error, OSError):
            raise OutputError(
                f"The file cannot be written: {error.strerror or error}.", path=self.out,
                remedy="Check that the disk has room and that you may write to the folder.",
            ) from error  # fmt: skip

    def _kept(self) -> bool:
        """Rename the part if the name is free, or leave an identical file there; False: the file must be replaced."""
        import filecmp

        try:
            os.link(self.part, self.out)
        except FileExistsError:
            if not filecmp.cmp(self.part, self.out, shallow=False):
                return False
        except OSError:  # a file system without links
            return False
        remove(self.part)
        return True
