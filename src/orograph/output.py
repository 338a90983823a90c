"""Files appear whole or not at all: results are written beside their place and moved there when they are finished."""

from __future__ import annotations

import glob
import os
import shutil
from pathlib import Path

from orograph.errors import OutputError


def check_folder(path: Path) -> None:
    """Raise OutputError unless there is a folder to write ``path`` into."""
    if not path.parent.is_dir():
        raise OutputError(f"There is no folder {path.parent} to write to.", path=path, remedy="Make it first.")


def check_room(path: Path, size: int) -> None:
    """Raise OutputError if the disk of ``path`` has less room than ``size`` bytes: before libraries meet its end, which
    print lines of their own."""
    free = shutil.disk_usage(path.parent).free
    if free < size:
        raise OutputError(
            f"There is no room for it: {size / 1e6:,.1f} MB are needed on the way, {free / 1e6:,.1f} MB are free.",
            path=path, remedy="Make room, or write to another disk.",
        )  # fmt: skip


_unfinished: set[Path] = set()


def remove_unfinished() -> None:
    """Remove what is half written, and what lies beside it under its name: the process is about to end."""
    for part in list(_unfinished):
        for left in part.parent.glob(f"{glob.escape(part.name)}*"):
            left.unlink(missing_ok=True)


class Beside:
    """A temporary path beside ``out`` that becomes ``out`` on success and vanishes on failure."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.part = out.with_name(f".{out.name}.{os.getpid()}.part")

    def __enter__(self) -> Path:
        check_folder(self.out)
        _unfinished.add(self.part)
        return self.part

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        _unfinished.discard(self.part)
        if kind is None:
            try:
                self.part.replace(self.out)
            except OSError as cause:
                self.part.unlink(missing_ok=True)
                raise OutputError(f"The file cannot be written: {cause.strerror}.", path=self.out) from cause
            return
        self.part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OutputError(
                f"The file cannot be written: {error.strerror or error}.", path=self.out,
                remedy="See that the disk has room and the folder is yours to write in.",
            ) from error  # fmt: skip
