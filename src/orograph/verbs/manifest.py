"""``orograph.manifest``: describe many elevation files once and write it down (``dem.manifest``)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from orograph._named import answering
from orograph.errors import OutputError, ReadError, UsageError
from orograph.output import Beside, check_folder, remove
from orograph.progress import Progress
from orograph.reporting import reporting

PICTURES = {".png", ".jpeg", ".gif", ".webp", ".bmp", ".svg"}
"""Endings of companion files in folders of rasters; pictures that hold elevations must be named."""

SAVED = 256
"""After this many files the findings are saved, in case the work is interrupted."""


class Listed(NamedTuple):
    """What a manifest lists.

    Attributes:
        path: of the manifest. files: how many. damaged: files that cannot be opened, each with the cause.
    """

    path: str
    files: int
    damaged: tuple[str, ...]


@answering
def manifest(
    files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], path: str | os.PathLike[str], *,
    skip_damaged: bool = False, jobs: int | None = None, progress: Progress | bool | None = None, **reading: Any,
) -> Listed:  # fmt: skip
    """Describe elevation files in a manifest, which can be given wherever files are given.

    Entries of an existing manifest that still hold are kept, so only new or changed files are opened. The same goes for
    what was found before an interruption.

    Args:
        files: paths, URLs, folders (all in them but side files, pictures and manifests), patterns with ``*``, other
            manifests.
        path: of the manifest; it ends in ``.manifest.geojsonl``.
        skip_damaged: files that cannot be opened are not an error; they are listed with the cause either way.
        jobs: files opened at once; None: as many as there are processors, or 16 for files on servers.
        progress: gets progress reports; False: silent.
        reading: how to interpret files (``band``, ``nodata``, ``spacing``, ``assume_crs``…); later reads use the
            manifest if their options are the same.

    Raises:
        ReadError: files cannot be opened (the manifest is written, and names them), or none are found.
        UsageError: the name has the wrong ending. OutputError: the manifest cannot be written.
    """
    from orograph.dem.handles import MANIFEST, is_manifest
    from orograph.dem.manifest import read
    from orograph.dem.mosaic import unread
    from orograph.dem.openers import rows
    from orograph.store.given import OF_FILES, check_names

    target = Path(path)
    if not is_manifest(target):
        raise UsageError(f"The name of a manifest must end in {MANIFEST}.", path=target, remedy="Rename it.")
    check_names(reading, "manifest")
    if wrong := [name for name in reading if name not in OF_FILES and reading[name] is not None]:
        raise UsageError(f"{', '.join(f'`{name}`' for name in wrong)} cannot be given for single files.")
    options = {name: value for name, value in reading.items() if value is not None}
    check_folder(target)
    heard = reporting(progress)
    begun = target.with_name(f".{target.name}.begun")
    known = {line.path: line for line in (*(read(target) if target.exists() else ()), *_lines(begun))}
    lines = [known.get(line.path, line) for line in named(files)]
    if not lines:
        raise ReadError("There is no file to list.", remedy="Name files, or folders that hold some.")
    found: list[str] = []
    damaged: list[ReadError] = []
    try:
        with begun.open("a", encoding="utf-8") as kept, heard.task("Opening files", total=len(lines)) as task:
            kept.write("\n")  # drops a line that a killed process may have cut short
            for row, error in rows(lines, options, target.parent, jobs):
                found.append(row)
                if error is not None:
                    damaged.append(error)
                kept.write(row + "\n")
                if len(found) % SAVED == 0:
                    kept.flush()
                task.advance()
        with Beside(target) as part:
            part.write_text("\n".join(found) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"The manifest cannot be written: {error.strerror or error}.", path=target) from error
    remove(begun)
    if damaged and not skip_damaged:
        raise unread(damaged, len(lines))
    return Listed(str(target), len(lines), tuple(f"{error.path}: {error.what}" for error in damaged))


def named(files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[Any]:
    """The lines of a manifest of these files: their paths alone, or the entries of manifests among them.

    Each file is listed once.
    """
    from orograph.dem.handles import is_manifest
    from orograph.dem.manifest import Line, read

    names = [files] if isinstance(files, str | os.PathLike) else list(files)
    lines: dict[str, Any] = {}
    for name in (os.fspath(one) for one in names):
        if is_manifest(name):
            lines.update((line.path, line) for line in read(name))
        else:
            lines.update((found, Line(found, {}, None)) for found in _expanded(name))
    return list(lines.values())


def _expanded(name: str) -> Iterable[str]:
    """The files that a name stands for, sorted by name."""
    from orograph.dem.handles import SIDE_FILES, is_manifest
    from orograph.store.given import matching

    folder = Path(name)
    if "://" in name or name.startswith("/vsi"):
        return [name]
    if folder.is_dir() and not (folder / "hdr.adf").exists() and folder.suffix.lower() != ".zarr":
        inside: list[Path] = []
        for root, folders, inner in os.walk(folder):
            folders[:] = [one for one in folders if not one.startswith(".") and not one.endswith((".oro", ".partial"))]
            inside += [Path(root, file) for file in inner if not file.startswith(".")]
        return [
            str(file)
            for file in sorted(inside)
            if file.suffix.lower() not in SIDE_FILES | PICTURES and not is_manifest(file)
        ]
    return matching(name)


def _lines(begun: Path) -> list[Any]:
    """What an interrupted manifest had found; an incomplete last line is ignored."""
    from orograph.dem.manifest import line_of

    if not begun.exists():
        return []
    rows = begun.read_text(encoding="utf-8", errors="replace").splitlines()
    found = []
    for row in filter(str.strip, rows):
        try:
            found.append(line_of(row, begun.parent))
        except (ValueError, LookupError, TypeError, AttributeError):
            continue
    return found
