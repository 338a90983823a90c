"""Views of a terrain that a user keeps under the keys 1 to 9: JSON in the user's config folder, one file per terrain.

A terrain is identified by its name and its grid (size, transform, CRS), so a store and the files it was built from
share their views if their grids are the same.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path

from orograph.documents import load_object, write
from orograph.errors import OrographError, OutputError
from orograph.geo.grid import Grid
from orograph.viewpoint import View

SLOTS = tuple("123456789")


def config_folder() -> Path:
    """The settings folder: ``$OROGRAPH_CONFIG``, else the platform's config folder."""
    if chosen := os.environ.get("OROGRAPH_CONFIG"):
        return Path(chosen)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Application Support" / "orograph"
    if sys.platform == "win32":
        return Path(os.environ.get("APPDATA", Path.home() / "AppData" / "Roaming")) / "orograph"
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "orograph"


def place_key(grid: Grid) -> str:
    """Twelve hexadecimal digits that identify a grid."""
    crs = "" if grid.crs is None else grid.crs.to_wkt()
    text = f"{grid.shape} {[f'{v:.9g}' for v in grid.transform[:6]]} {crs}"
    return hashlib.sha256(text.encode()).hexdigest()[:12]


class Bookmarks:
    """The views of a terrain.

    Args:
        grid, name: the terrain's.
        folder: where files of views are kept; None: ``views`` in the config folder.

    Attributes:
        path: the file. trouble: why it could not be read, or "".
    """

    def __init__(self, grid: Grid, name: str, folder: Path | None = None) -> None:
        stem = re.sub(r"[^\w.-]+", "-", name).strip("-.")[:48] or "terrain"
        self.path = (folder or config_folder() / "views") / f"{stem}-{place_key(grid)}.json"
        self.trouble = ""
        self._views: dict[str, View] = {}
        if self.path.exists():
            try:
                values = load_object(self.path, "file of views", 'a view for each of the keys "1" to "9"')
                self._views = {k: View.from_dict(v) for k, v in values.items() if k in SLOTS and isinstance(v, dict)}
            except OrographError as error:
                self.trouble = str(error)

    def __contains__(self, slot: str) -> bool:
        return slot in self._views

    def get(self, slot: str) -> View | None:
        """The view kept under "1" to "9"."""
        return self._views.get(slot)

    @property
    def slots(self) -> tuple[str, ...]:
        """The slots that hold a view."""
        return tuple(sorted(self._views))

    def keep(self, slot: str, view: View) -> None:
        """Keep a view, also in the file.

        Raises:
            OutputError: the file cannot be written; the view is kept until the window closes.
        """
        self._views[slot] = view
        self._write()

    def carry(self, others: Bookmarks, moved: Callable[[View], View | None]) -> None:
        """Also use the views of another terrain, until the window closes: those that ``moved`` can convert and whose
        slots are free."""
        for slot in others.slots:
            if slot not in self and (view := moved(others._views[slot])) is not None:
                self._views[slot] = view

    def forget(self, slot: str) -> None:
        """Drop a view.

        Raises:
            OutputError: the file cannot be written.
        """
        self._views.pop(slot, None)
        self._write()

    def _write(self) -> None:
        values = {k: v.to_dict() for k, v in sorted(self._views.items())}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"The folder of views cannot be made: {error.strerror}.", path=self.path.parent
            ) from error
        write(values, self.path)
