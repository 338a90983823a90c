"""Work on a map that can resume after an interruption: its canvases are kept after each pass over the terrain.

A folder beside the output holds a plan (the products and the terrain) and, for the canvases of each sweep, a file of
their values and one that lists the azimuths in it. After a pass, a new file of values is written and then made current
by a rename: whenever work is interrupted, the folder describes whole passes only. For products made window by window,
by rays or walks, each window is a file.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OutputError
from orograph.lighting.raster import Canvas
from orograph.output import remove
from orograph.processes import host
from orograph.store.memory import MemoryTerrain
from orograph.store.terrain import Terrain

Values = NDArray[np.float32]

PLAN = "plan.json"
"""The first file in such a folder, and the last to be removed: everything beside it belongs to it."""

_CHUNK = 1 << 22
"""Values written at once."""


def identity(terrain: Terrain) -> str:
    """Differs whenever any height or its place might differ."""
    grid = terrain.grid
    digest = hashlib.sha256(repr((grid.shape, tuple(grid.transform), grid.crs and grid.crs.to_wkt())).encode())
    if isinstance(terrain, MemoryTerrain):
        digest.update(np.ascontiguousarray(terrain.heights).view(np.uint8).data)
    else:
        digest.update(str(getattr(getattr(terrain, "record", None), "source", terrain.name)).encode())
    return digest.hexdigest()[:32]


class Checkpoint:
    """The finished work on a map.

    Args:
        folder: created if necessary.
        plan: the work, JSON; other work in the folder is refused.

    Raises:
        OutputError: the folder holds other work, or cannot be written.
    """

    def __init__(self, folder: Path, plan: dict[str, Any]) -> None:
        self.folder = folder
        text = text_of(plan)
        file = folder / PLAN
        try:
            if file.is_file():
                if file.read_text(encoding="utf-8") != text:
                    raise OutputError(
                        "The interrupted work there is another map, or of another terrain.",
                        path=folder,
                        remedy="Run it with the same products and options, or delete that folder to start anew.",
                    )
                return
            folder.mkdir(exist_ok=True)
            _replace(file, text)
        except OSError as error:
            raise _unwritable(folder, error) from error

    def load(self, key: str, canvases: Sequence[Canvas]) -> list[int]:
        """Fill canvases with what is kept; returns the azimuths in them, [] if there is nothing."""
        state = self.folder / f"{key}.json"
        if not state.is_file():
            return []
        try:
            kept = json.loads(state.read_text(encoding="utf-8"))
            with (self.folder / kept["file"]).open("rb") as file:
                for part in _parts(canvases):
                    if file.readinto(part.view(np.uint8).data) != part.nbytes:
                        raise OSError("it is truncated")
        except (OSError, ValueError, KeyError) as error:
            raise OutputError(
                f"What was kept of the interrupted work cannot be read: {error}.",
                path=self.folder,
                remedy="Delete that folder to start anew.",
            ) from error
        return [int(k) for k in kept["azimuths"]]

    def save(self, key: str, canvases: Sequence[Canvas], azimuths: Iterable[int]) -> None:
        """Keep canvases after a pass."""
        done = list(azimuths)
        name = f"{key}.{len(done)}.f32"
        try:
            with (self.folder / name).open("wb") as file:
                for part in _parts(canvases):
                    file.write(part.view(np.uint8).data)
                file.flush()
                os.fsync(file.fileno())
            _replace(self.folder / f"{key}.json", json.dumps({"file": name, "azimuths": done}))
            for old in self.folder.glob(f"{key}.*.f32"):
                if old.name != name:
                    old.unlink()
        except OSError as error:
            raise _unwritable(self.folder, error) from error

    def window(self, key: str, row: int, col: int, make: Callable[[], Values]) -> Values:
        """A window (bands, rows, cols) of a product made window by window: as kept, or made and kept.

        From any thread and process: those that make the same window at once make the same bytes.
        """
        path = self.folder / f"{key}.{row}.{col}.npy"
        if path.is_file():
            try:
                return np.asarray(np.load(path, allow_pickle=False), np.float32)
            except (OSError, ValueError, EOFError):
                pass  # truncated: make it again
        values = make()
        part = path.with_suffix(f".{host()}.{os.getpid()}.{threading.get_ident()}.part")
        try:
            with part.open("wb") as file:
                np.save(file, np.ascontiguousarray(values), allow_pickle=False)
            part.replace(path)
        except OSError as error:
            raise _unwritable(self.folder, error) from error
        return values

    def remove(self) -> None:
        """Remove the folder, when the map is complete."""
        clear(self.folder)


def text_of(plan: dict[str, Any]) -> str:
    """A plan as it is stored."""
    return json.dumps(plan, sort_keys=True)


def clear(folder: Path) -> None:
    """Remove a work folder if it exists; nobody else may be working in it."""
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        elif path.name != PLAN:
            remove(path)
    shutil.rmtree(folder, ignore_errors=True)


def _parts(canvases: Sequence[Canvas]) -> Iterator[Values]:
    """All values, a few at a time; releases the memory of canvases on disk as it goes."""
    for canvas in canvases:
        flat = canvas.values.reshape(-1)
        for start in range(0, flat.size, _CHUNK):
            yield flat[start : start + _CHUNK]
            canvas.release()


def _replace(path: Path, text: str) -> None:
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def _unwritable(folder: Path, error: OSError) -> OutputError:
    return OutputError(
        f"What has been done cannot be kept: {error.strerror or error}.", path=folder,
        remedy="Check that the disk has space and the folder is writable, then run the same again to continue.",
    )  # fmt: skip
