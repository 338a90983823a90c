"""Films whose frames several processes draw: workers of a cluster, or independent parts."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, NamedTuple

from orograph.errors import StoreError
from orograph.progress import Progress
from orograph.store.clusters import check_workers, on_workers
from orograph.store.in_parts import Part, gather, part_of
from orograph.store.lock import alone
from orograph.store.storage import FolderStorage
from orograph.touring.encode import Pictures, Video, is_numbered
from orograph.touring.film import Film
from orograph.touring.frames import (
    Frames,
    done_with,
    draw_part,
    encoder,
    frames_of,
    pictures_of,
    recipe_of,
)

MEMORY = 1 << 30


class By(NamedTuple):
    """Who draws a film.

    Attributes:
        workers, dask: workers of a cluster (``workforce``). part: only this part. finish: parts that are already drawn.
    """

    workers: int | None = None
    dask: Any = None
    part: Part | None = None
    finish: bool = False

    @classmethod
    def of(cls, workers: int | None, dask: Any, part: str | tuple[int, int] | None, finish: bool) -> By | None:
        """The plan that the arguments describe; None: this process draws.

        Raises:
            UsageError: arguments exclude each other, or a part is invalid.
        """
        check_workers(workers, dask, "A film", part, finish)
        if workers is None and dask is None and part is None and not finish:
            return None
        return cls(workers, dask, None if part is None else part_of(part), finish)


class Shot(NamedTuple):
    """What was drawn of a film.

    Attributes:
        drawn: frames that were not there already. imbalance: the busiest worker's time over the mean; None without
            workers.
    """

    drawn: int
    imbalance: float | None = None


def shoot_by(
    by: By, film: Film, path: str, size: tuple[int, int], *, backend: str, crf: int | None, overwrite: bool,
    jobs: int | None, max_memory: int | None, progress: Progress, dpi: float | None = None,
) -> Shot:  # fmt: skip
    """Draw the frames of a film, or a part of them, into its file or its pictures.

    Raises:
        StoreError: parts are missing, another process draws the same film, or workers gave up frames.
        UsageError, OutputError: as for a film.
    """
    video = not is_numbered(path)
    pictures = pictures_of(frames_of(path) if video else path, film, dpi, overwrite)
    done = _drawn(pictures, film)
    with pictures, _lock(pictures, by):
        if by.part is not None:
            _note(pictures, by.part[1])
            return Shot(draw_part(Frames(film, pictures), by.part, progress))
        count = _noted(pictures) if by.finish else 0
        if overwrite and not by.finish:
            for number in film.numbers:
                pictures.of(number).unlink(missing_ok=True)
            done = 0
        writer = None
        if video:
            writer = Video(path, size, film.tour.fps, crf=crf, jobs=jobs, attribution=film.base.attribution)
        with writer or nullcontext():
            frames = Frames(film, pictures, encoder(writer, pictures) if writer else _nothing)
            if by.finish:
                gather([frames], count, path, progress)
                imbalance = None
            else:
                imbalance = _by_workers(by, frames, jobs, max_memory or MEMORY * (by.workers or 1), backend, progress)
        _parts(pictures).unlink(missing_ok=True)
    if video:
        done_with(path)
    return Shot(0 if by.finish else len(film) - done, imbalance)


def _nothing(number: int) -> None:
    """A picture is done when its file exists."""


def _by_workers(
    by: By, frames: Frames, jobs: int | None, max_memory: int, backend: str, progress: Progress
) -> float:  # fmt: skip
    """Have workers draw all frames; returns the imbalance."""
    pictures = frames.pictures
    recipe = recipe_of(frames.film, str(pictures.path), backend, pictures.dpi, max_memory // (by.workers or 1))
    if by.workers is not None:  # processes of this machine share its processors and memory
        allowed = recipe.scene.budget.max_memory
        each = None if allowed is None else allowed // by.workers
        recipe = recipe._replace(scene=recipe.scene.but(jobs=jobs or 1, max_memory=each))
    with on_workers(recipe, by.workers, by.dask, 1, max_memory, "A film") as cluster:
        cluster.run(frames, progress)
        return cluster.imbalance()


def _drawn(pictures: Pictures, film: Film) -> int:
    """How many frames exist already."""
    return sum(pictures.of(number).is_file() for number in film.numbers)


@contextmanager
def _lock(pictures: Pictures, by: By) -> Iterator[None]:
    """Keep other processes from drawing the same frames, except other parts of the same plan."""
    shared = None if by.part is None else f"{pictures.fingerprint} {by.part[1]}"
    with alone(FolderStorage(pictures.sign), "drawing this film", shared=shared):
        yield


def _parts(pictures: Pictures) -> Path:
    """The file that records in how many parts a film is drawn."""
    return pictures.sign.with_suffix(".parts")


def _note(pictures: Pictures, count: int) -> None:
    said = _said(pictures)
    if said not in (None, count):
        raise StoreError(
            f"This film was begun in {said} parts, not in {count}.", path=pictures.path,
            remedy=f"Draw parts of {said}, or remove {_parts(pictures).name} beside the frames.",
        )  # fmt: skip
    _parts(pictures).write_text(f"{count}\n", encoding="ascii")


def _noted(pictures: Pictures) -> int:
    said = _said(pictures)
    if said is None:
        raise StoreError(
            "No part of this film was drawn.", path=pictures.path, remedy="Draw its parts first: `part=(1, N)`."
        )
    return said


def _said(pictures: Pictures) -> int | None:
    try:
        return int(_parts(pictures).read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None
