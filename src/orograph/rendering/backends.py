"""The backends that draw a scene, by name: the CPU ray caster, or a later layer's renderer, imported on demand."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, Protocol

from orograph.errors import OrographError, UsageError
from orograph.progress import SILENT, Progress
from orograph.rendering.blending import blended
from orograph.rendering.picture import Picture
from orograph.scene.scene import Scene

BACKENDS = {"cpu": "orograph.rendering.cpu.draw", "gpu": "orograph.rendering.gpu.draw"}
"""Maps a name to the module whose ``draw`` makes a picture of a scene."""

NO_GPU = 6
"""Exit code of the error that there is no GPU."""

Session = Callable[[Scene], Picture]
"""Draws scene after scene of one terrain, and makes shared data only once."""


def check_sort_last(wanted: bool, workers: int | None, dask: Any, backend: str) -> None:
    """Raise UsageError if workers are to draw parts of the terrain, but there are none, or another backend draws."""
    if wanted and workers is None and dask is None:
        raise UsageError("`sort_last` needs workers.", remedy="Give `workers` or `dask`.")
    if wanted and backend != "cpu":
        raise UsageError("`sort_last` draws on the CPU.", remedy="Leave out `backend`.")


class Draw(Protocol):
    """Draws a scene; further arguments belong to the backend."""

    def __call__(self, scene: Scene, progress: Progress = ..., **own: Any) -> Picture: ...


def backend_of(name: str) -> Draw:
    """The function that draws with a backend.

    Raises:
        UsageError: there is no backend of that name.
    """
    if name not in BACKENDS:
        raise UsageError(f"There is no backend {name!r}; the backends are {', '.join(BACKENDS)}.")
    draw: Draw = importlib.import_module(BACKENDS[name]).draw
    return draw


def draw(scene: Scene, progress: Progress = SILENT, *, backend: str = "cpu") -> Picture:
    """Draw a scene; without a GPU the CPU draws the same picture, with a warning.

    Raises: as the backend's ``draw``.
    """
    if scene.variants:

        def plain(one: Scene) -> Picture:
            return draw(one, progress, backend=backend)

        return blended(scene, plain, lambda _: plain, progress.warn)
    try:
        return backend_of(backend)(scene, progress)
    except OrographError as error:
        if backend == "cpu" or error.exit_code != NO_GPU:
            raise
        progress.warn(f"{error} The CPU draws the picture instead.")
        return backend_of("cpu")(scene, progress)


def session(progress: Progress = SILENT, *, backend: str = "cpu") -> Session:
    """A function that draws many pictures of one terrain, such as a movie's frames; without a GPU, on the CPU, with a
    warning.

    Each picture is complete and the same whatever was drawn before it.

    Raises: as ``backend_of``.
    """
    backend_of(backend)
    try:
        make: Callable[[], Session] = importlib.import_module(BACKENDS[backend]).session
        first = make()
    except OrographError as error:
        if backend == "cpu" or error.exit_code != NO_GPU:
            raise
        progress.warn(f"{error} The CPU draws the pictures instead.")
        return session(progress)
    more: dict[int, Session] = {}  # of variants: each keeps what its frames share

    def other(number: int) -> Session:
        if number not in more:
            more[number] = make()
        return more[number]

    return lambda scene: blended(scene, first, other) if scene.variants else first(scene)
