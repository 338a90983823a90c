"""``orograph.manifest``: what many elevation files are, found once and written down (``dem.manifest``)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from orograph.errors import OutputError, ReadError, UsageError
from orograph.output import Beside, check_folder, remove
from orograph.progress import Progress
from orograph.reporting import reporting

PICTURES = {".png", ".jpeg", ".gif", ".webp", ".bmp", ".svg"}
"""Endings of what lies in folders beside rasters; elevations as pictures have to be named."""

SAVED = 256
"""Files after which what was found is kept, should the rest be broken off."""


class Listed(NamedTuple):
    """What a manifest lists.

    Attributes:
        path: of the manifest. files: how many. damaged: what cannot be opened, each with its cause.
    """

    path: str
    files: int
    damaged: tuple[str, ...]


def manifest(
    files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], path: str | os.PathLike[str], *,
    skip_damaged: bool = False, jobs: int | None = None, progress: Progress | bool | None = None, **reading: Any,
) -> Listed:  # fmt: skip
    """Find out what elevation files are, and write a manifest, which is taken wherever files are named.

    What a manifest of that name says already, and is still true, is kept: made again, only what is new or changed is
    opened. So is what was found before the work was broken off.

    Args:
        files: paths, URLs, folders (all in them but side files, pictures and manifests), patterns with ``*``, other
            manifests.
        path: of the manifest; it ends in ``.manifest.geojsonl``.
        skip_damaged: files that cannot be opened are no error; they are listed with the cause in any case.
        jobs: files that are opened at once; None: as many as there are processors, of files on servers 16.
        progress: hears of it; False: nothing is said.
        reading: how files are to be understood (``band``, ``nodata``, ``spacing``, ``assume_crs``…): with the same
            options the manifest is of use later.

    Raises:
        ReadError: files cannot be opened (the manifest is written, and names them), or none are found.
        UsageError: the name does not end as it should. OutputError: the manifest cannot be written.
    """
    from orograph.dem.handles import MANIFEST, is_manifest
    from orograph.dem.manifest import read, rows
    from orograph.dem.mosaic import unread
    from orograph.store.given import OF_FILES, check_names

    target = Path(path)
    if not is_manifest(target):
        raise UsageError(f"The name of a manifest ends in {MANIFEST}.", path=target, remedy="Name it so.")
    check_names(reading, "manifest")
    if wrong := [name for name in reading if name not in OF_FILES and reading[name] is not None]:
        raise UsageError(f"{', '.join(f'`{name}`' for name in wrong)} cannot be said of single files.")
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
            kept.write("\n")  # behind what a process that was killed may have cut short
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
        raise OutputError(f"It cannot be written: {error.strerror or error}.", path=target) from error
    remove(begun)
    if damaged and not skip_damaged:
        raise unread(damaged, len(lines))
    return Listed(str(target), len(lines), tuple(f"{error.path}: {error.what}" for error in damaged))


def named(files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[Any]:
    """The lines of a manifest of these files, with their paths alone, or with what manifests among them say.

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
            lines.update((found, Line(found, {}, Path())) for found in _expanded(name))
    return list(lines.values())


def _expanded(name: str) -> Iterable[str]:
    """The files that a name means, in the order of their names."""
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
    """What a manifest that was broken off had found; a last line that was cut short is none."""
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
