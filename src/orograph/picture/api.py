"""``orograph.render``: from a terrain, a DEM or a path to a picture, in one call."""

from __future__ import annotations

import os
from typing import Any, Literal

from orograph.dem.raster import Dem
from orograph.errors import UsageError
from orograph.picture.result import Picture
from orograph.picture.scene import Scene, Sun
from orograph.progress import SILENT, Progress
from orograph.store.terrain import Terrain
from orograph.view import View


def render(
    terrain: Terrain | Dem | str | os.PathLike[str],
    view: View | None = None,
    *,
    size: tuple[int, int] = (1280, 720),
    sun: Sun | tuple[float, float] = (315.0, 45.0),
    backend: Literal["cpu"] = "cpu",
    progress: Progress = SILENT,
    **options: Any,
) -> Picture:
    """Draw a relief picture.

    Args:
        terrain: an opened terrain, a DEM in memory, or the path of either.
        view: the camera; None shows all of the terrain.
        size: (width, height) in pixels where there is no view.
        sun: a ``Sun`` or (azimuth, altitude) in degrees.
        backend: "cpu".
        **options: the other attributes of ``Scene``.

    Returns:
        a ``Picture``: ``save(path)``, ``pixels`` (height, width, 3) uint8, ``depth`` float32 metres.

    Raises:
        ReadError, StoreError: the path cannot be read.
        UsageError: an option makes no sense.
        NothingInViewError: the picture would be empty.
    """
    if backend != "cpu":
        raise UsageError(f"There is no backend {backend!r}; there is 'cpu'.")
    if isinstance(terrain, (str, os.PathLike)):
        from orograph.picture.prepare import prepare

        terrain = prepare(
            [os.fspath(terrain)], max_memory=options.get("max_memory"), jobs=options.get("jobs"), progress=progress
        )
    elif isinstance(terrain, Dem):
        from orograph.store import terrain as in_memory

        terrain = in_memory(terrain)
    if view is None:
        from orograph.picture.camera import whole

        view = whole(terrain, size, exaggeration=options.get("exaggeration", 1.0))
    light = sun if isinstance(sun, Sun) else Sun(*sun)

    from orograph.picture.cpu import draw

    return draw(Scene(terrain, view, light, **options), progress)
