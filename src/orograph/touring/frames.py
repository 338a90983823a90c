"""Frames of a film drawn by several processes: each frame is a task (``store.executing``), and a picture in a folder.

A worker has the tour and the scene, opens the terrain itself, and refuses if its film differs from the coordinating
process's. Frames do not depend on those drawn before them; existing ones are not drawn again. One process encodes a
video from such lossless pictures, in order.
"""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from orograph.errors import OutputError, StoreError
from orograph.progress import Progress
from orograph.rendering.backends import session
from orograph.rendering.memory import WORKER, worker_memory
from orograph.scene.scene import Scene
from orograph.store.digests import Spot
from orograph.store.executing import Stage
from orograph.store.in_parts import Part, share
from orograph.store.worker_state import WorkerState
from orograph.touring.encode import Pictures, Pixels, Video
from orograph.touring.film import Film
from orograph.touring.playing import Playing
from orograph.touring.tour import Tour

Warned = tuple[str, ...]


class FilmRecipe(NamedTuple):
    """What workers receive once for a film.

    Attributes:
        tour, scene: of the film; the tour has its frame rate. numbers: of its first frame, and of the
            one after its last. backend: that draws. path: of the pictures. dpi: in their metadata. fingerprint: of the
            film.
        memory, base: as for all recipes. playing: of the film.
    """

    tour: Tour
    scene: Scene
    numbers: tuple[int, int]
    backend: str
    path: str
    dpi: float | None
    fingerprint: str
    memory: int
    base: int = WORKER
    playing: Playing | None = None

    def open(self) -> WorkerState:
        first, last = (number / self.tour.fps for number in self.numbers)
        draw = session(backend=self.backend)
        film = Film(self.tour, self.scene, draw=draw, first=first, last=last, playing=self.playing)
        if film.fingerprint() != self.fingerprint:
            raise StoreError(
                "A worker has another terrain, or another release of Orograph, than the process that films.",
                path=self.scene.terrain.name, remedy="Make sure that all of them have the same.",
            )  # fmt: skip
        return _FilmState(Frames(film, pictures_of(self.path, film, self.dpi)))


def recipe_of(film: Film, path: str, backend: str, dpi: float | None, max_memory: int) -> FilmRecipe:
    """The recipe of a film.

    Args:
        path: of the pictures. max_memory: bytes for each worker.
    """
    view = film.base.view
    needed = worker_memory(view.width * view.height, film.base.terrain, max_memory)
    numbers = film.numbers.start, film.numbers.stop
    where = str(Path(path).absolute())
    return FilmRecipe(
        film.tour, film.given, numbers, backend, where, dpi, film.fingerprint(), needed, playing=film.playing
    )


def pictures_of(path: str, film: Film, dpi: float | None, overwrite: bool = False) -> Pictures:
    """Where the frames of a film are written and found."""
    return Pictures(path, film.fingerprint(), overwrite, film.base.attribution, dpi)


class _FilmState:
    """The state of one process for a film."""

    def __init__(self, frames: Frames) -> None:
        self._frames = frames

    def stage(self, name: str, number: int) -> Frames:
        return self._frames


class Frames(Stage[Warned]):
    """The frames of a film; the tasks are their numbers.

    Args:
        film: draws them. pictures: where they are. then: is called with each, in order, when it is complete.
    """

    name = "frames"
    label = "Filming"

    def __init__(self, film: Film, pictures: Pictures, then: Callable[[int], None] = lambda number: None) -> None:
        self.film, self.pictures, self.then = film, pictures, then
        self._drawing = threading.Lock()  # a session draws one picture at a time, with all threads
        self._there: set[int] = set()
        self._next = film.numbers.start

    @property
    def place(self) -> str:
        return str(self.pictures.path)

    def tasks(self) -> list[Spot]:
        return [(number, 0) for number in self.film.numbers]

    def key(self, spot: Spot) -> str:
        return self.pictures.of(spot[0]).name

    def kept(self, spot: Spot) -> bool:
        return self.pictures.of(spot[0]).is_file()

    def found(self, spot: Spot, proof: bool = True) -> Warned | None:
        return () if self.kept(spot) else None

    def make(self, spot: Spot) -> Warned:
        with self._drawing:
            picture = self.film.picture(spot[0])
            self.pictures.add(spot[0], picture.pixels)
        return tuple(picture.facts.get("warnings", ()))

    def remarks(self, found: Warned) -> Warned:
        return found

    def add(self, spot: Spot, found: Warned) -> None:
        self._there.add(spot[0])
        while self._next in self._there:
            self._there.remove(self._next)
            self.then(self._next)
            self._next += 1


def folder_of(video: str) -> Path:
    """The folder of a video's frames until it is complete."""
    path = Path(video)
    return path.with_name(f".{path.name}.frames")


def frames_of(video: str) -> str:
    """Where the frames of a video are."""
    return str(folder_of(video) / "%06d.png")


def draw_part(stage: Frames, part: Part, progress: Progress) -> int:
    """Draw a part's share of the frames, without existing ones; returns their number."""
    own = share(stage.tasks(), part)
    drawn = 0
    with progress.task(f"Filming part {part[0]} of {part[1]}", total=len(own)) as task:
        for spot in own:
            if not stage.kept(spot):
                for warning in stage.make(spot):
                    progress.warn(warning)
                drawn += 1
            task.advance()
    return drawn


def pixels_of(path: Path) -> Pixels:
    """A picture's pixels (height, width, 3) uint8.

    Raises:
        OutputError: it cannot be read.
    """
    from PIL import Image

    try:
        with Image.open(path) as picture:
            return np.asarray(picture.convert("RGB"), np.uint8)
    except OSError as error:
        raise OutputError(
            f"A frame cannot be read: {error}.", path=path, remedy="Remove it, and run the same again."
        ) from error


def encoder(video: Video, pictures: Pictures) -> Callable[[int], None]:
    """A function that adds one frame after the other to a video."""
    return lambda number: video.add(number, pixels_of(pictures.of(number)))


def done_with(video: str) -> None:
    """Remove a video's frames."""
    shutil.rmtree(folder_of(video), ignore_errors=True)
