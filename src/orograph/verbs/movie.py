"""``orograph.movie``: a tour of a terrain as a film."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from orograph._named import answering
from orograph.errors import UsageError
from orograph.progress import Progress
from orograph.rendering.api import check_names
from orograph.rendering.backends import check_sort_last, session
from orograph.rendering.memory import check_memory
from orograph.reporting import reporting
from orograph.scene import given
from orograph.scene.methods import check_promise, conservative_method
from orograph.scene.parts import OPTIONS, check_options
from orograph.scene.sizes import Size, size_of
from orograph.store.given import READING
from orograph.store.opening import terrain as opened
from orograph.store.terrain import Terrain
from orograph.touring import Tour
from orograph.touring.encode import Pictures, Video, check_movie, is_numbered
from orograph.touring.film import Film, spoken
from orograph.touring.make import still
from orograph.verbs.filming import MEMORY, By, Shot, shoot_by
from orograph.verbs.ways import WAY, check_passage, parsed_path, settle_tour, tour_of
from orograph.viewpoint import View


@answering
def movie(
    terrain: Any,
    output: str | os.PathLike[str],
    tour: Tour | Mapping[str, Any] | str | os.PathLike[str] | None = None,
    *,
    size: Size | None = None,
    fps: float | None = None,
    begin: float | None = None,
    end: float | None = None,
    crf: int | None = None,
    overwrite: bool = False,
    backend: Literal["cpu", "gpu"] = "cpu",
    conservative: bool = False,
    progress: Progress | bool | None = None,
    workers: int | None = None,
    dask: Any = None,
    sort_last: bool = False,
    part: str | tuple[int, int] | None = None,
    finish: bool = False,
    **options: Any,
) -> Path:
    """Film a tour of a terrain, every frame with all of its detail.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options.
        output: the film: .mp4, .mov, .mkv (H.264), .webm (VP9), .gif, or pictures such as frames/%05d.png.
        tour: the key frames (``orograph.tour``), their JSON, or its file; None: the tour that ``options`` describe as
            for ``orograph.tour`` (orbit, turntable, still, plan, around, line, points…), or an orbit.
        size: (width, height) of the frames; None: the tour's, or 1280 × 720. fps: frames per second; None: the tour's.
        begin, end: the part of the tour to film, seconds; None: all of it.
        crf: constant rate factor: lower is better and larger; None: 18 for H.264, 28 for VP9.
        overwrite: redraw existing pictures; otherwise an interrupted film is continued.
        backend: "cpu" or "gpu". conservative: as of ``render``.
        progress: gets progress reports; False: silent.
        workers: draw in this many processes of ``jobs`` threads each (default: 1), which share ``max_memory`` (Dask).
        dask: draw on the workers of a cluster: a ``distributed.Client``, or its scheduler's address.
        sort_last: each worker has a part of the terrain, and all draw every frame together (``rendering.sort_last``).
        part: draw only this part of the frames, "3/64" or (3, 64), for job arrays. finish: make the film of its parts.
        options: of the scene, as for ``orograph.render``; they apply to the whole film, whatever the tour says. A
            ``sun`` may move: "A..B" or (A, B), two times with their zones, between which it passes evenly.

    Returns:
        the path of the film.

    Raises:
        UsageError: an option is unknown or makes no sense. ReadError, StoreError: the terrain or the tour cannot be
        read; parts are missing, or workers gave up frames. OutputError: the film cannot be written.
        NothingInViewError: a frame would be empty.
    """
    heard = reporting(progress)
    reading = {name: options.pop(name) for name in READING if name in options}
    way = parsed_path({name: options.pop(name) for name in WAY if name in options})
    check_names(options, "movie", (*WAY, *inspect.signature(movie).parameters))
    options, passage = given.standing(options)
    check_options(options)
    if conservative:
        options["method"] = conservative_method(options.get("method", "auto"), backend)
    settle_tour(way, tour is not None)
    check_passage(passage, way)
    by = By.of(workers, dask, part, finish)
    check_sort_last(sort_last, workers, dask, backend)
    path = os.fspath(output)
    size = None if size is None else size_of(size)
    check_movie(path, size, crf)
    max_memory, jobs = OPTIONS["max_memory"].worded(options.get("max_memory")), options.get("jobs")
    ground = opened(terrain, heard, max_memory=max_memory, jobs=jobs, called="movie", **reading)
    if conservative:
        check_promise(options["method"], backend, ground)
    again = None
    if tour is None:
        sun = given.sun(options.get("sun"), ground)
        way_size = size or (1280, 720)
        stretch, furniture = options.get("exaggeration", 1.0), bool(options.get("furniture"))
        again = partial(tour_of, ground, way_size, way, (sun.azimuth, sun.altitude), stretch, furniture)
        keys = again()
    else:
        stretched = options.get("exaggeration", 1.0)
        keys = without(_tour_of(tour, ground, partial(whole, ground, size, stretched)), options)
    view = keys.keys[0].view
    pixels = size or (view.width, view.height)
    check_movie(path, pixels, crf)
    check_memory(pixels, max_memory)
    draw = session(heard, backend=backend)
    film = Film.of(keys, ground, pixels, options, draw=draw, fps=fps, first=begin, last=end, progress=heard,
                   again=again, passage=passage)  # fmt: skip
    if by is None:
        shoot(film, path, pixels, crf=crf, overwrite=overwrite, jobs=jobs, progress=heard)
    elif sort_last:
        shoot_by_parts(
            by, film, path, pixels, crf=crf, overwrite=overwrite, jobs=jobs, max_memory=max_memory, progress=heard
        )
    else:
        shoot_by(by, film, path, pixels, backend=backend, crf=crf, overwrite=overwrite, jobs=jobs,
                 max_memory=max_memory, progress=heard)  # fmt: skip
    return Path(path)


def _tour_of(
    given: Tour | Mapping[str, Any] | str | os.PathLike[str], ground: Terrain, first: Callable[[int, int], View]
) -> Tour:
    if isinstance(given, Tour):
        return given
    if isinstance(given, Mapping):
        return Tour.from_dict(given, crs=ground.grid.crs, whole=first)
    if isinstance(given, str | os.PathLike):
        return Tour.load(os.fspath(given), crs=ground.grid.crs, whole=first)
    raise UsageError(f"A tour is made by orograph.tour, or is its file, not {type(given).__name__}.")


def whole(ground: Terrain, size: tuple[int, int] | None, exaggeration: float, width: int, height: int) -> View:
    """The camera of a tour's first key that has none: all of the terrain in view, in frames of ``size`` or else as
    large as the tour says."""
    return still(ground, size or (width, height), exaggeration=exaggeration).keys[0].view


def without(tour: Tour, options: Iterable[str]) -> Tour:
    """A tour whose key frames do not set what ``options`` set for the whole film."""
    over: dict[str, Any] = dict.fromkeys(set(options) & set(spoken(tour)))
    passage = None if "sun" in over else tour.passage
    return replace(tour, keys=tuple(replace(key, **over) for key in tour.keys), passage=passage)


def shoot(
    film: Film, path: str, size: tuple[int, int], *, crf: int | None, overwrite: bool, jobs: int | None,
    progress: Progress, dpi: float | None = None,
) -> int:  # fmt: skip
    """Draw the frames of a film into its file or its pictures; returns how many were drawn (existing ones do not
    count).

    Args:
        dpi: dots per inch to write into pictures; None: none.

    Raises:
        KeyboardInterrupt: it was interrupted; a note says what was finished.
    """
    writer: Pictures | Video
    if is_numbered(path):
        writer = Pictures(path, film.fingerprint(), overwrite, film.base.attribution, dpi)
    else:
        writer = Video(path, size, film.tour.fps, crf=crf, jobs=jobs, attribution=film.base.attribution)
    drawn, number = 0, film.numbers[0]
    try:
        with writer, progress.task("Filming", total=len(film)) as task:
            for number in film.numbers:
                if not writer.has(number):
                    picture = film.picture(number)
                    for warning in picture.facts.get("warnings", ()):
                        progress.warn(warning)
                    writer.add(number, picture.pixels)
                    drawn += 1
                task.advance()
    except KeyboardInterrupt:
        done = f"\nstopped after {number - film.numbers[0]} of {len(film)} frames"
        if is_numbered(path):
            progress.note(f"{done}, which are kept: run the same again to go on from there")
        else:
            progress.note(
                f"{done}; {path} is as it was before. A film as pictures (frames/%05d.png) can be continued where it "
                "stopped."
            )
        raise
    return drawn


def shoot_by_parts(
    by: By, film: Film, path: str, size: tuple[int, int], *, crf: int | None, overwrite: bool, jobs: int | None,
    max_memory: int | None, progress: Progress, dpi: float | None = None,
) -> Shot:  # fmt: skip
    """Draw the frames of a film one after the other, each by all workers, sort-last. Arguments and errors as for
    ``shoot_by``."""
    from orograph.rendering.sort_last import by_parts

    memory = max_memory or MEMORY * (by.workers or 1)
    with by_parts(
        film.base, workers=by.workers, dask=by.dask, jobs=jobs, max_memory=memory, what="A film"
    ) as (draw, cluster):  # fmt: skip
        film.draw = draw
        drawn = shoot(film, path, size, crf=crf, overwrite=overwrite, jobs=jobs, progress=progress, dpi=dpi)
        return Shot(drawn, cluster.imbalance())
