"""``orograph movie``: film a tour of a DEM or a store."""

from __future__ import annotations

import json
import time
from functools import partial
from typing import Any

import click
from click.core import ParameterSource

from orograph.cli.camera import SIZES, Size
from orograph.cli.files import check_outputs
from orograph.cli.options import (
    FILE,
    Float,
    cluster_options,
    jobs_option,
    memory_option,
    progress_of,
    sort_last_option,
    source_of,
    source_options,
    vertical_options,
)
from orograph.cli.scenes import DRAWING, check_scene, given_of, inputs_of, scene_options
from orograph.cli.sections import Verb
from orograph.cli.tours import tour_options
from orograph.scene import given
from orograph.scene.parts import OPTIONS
from orograph.scene.sizes import dpi_of
from orograph.verbs.ways import WAY, check_passage, settle_tour, tour_of

OWN = {*DRAWING, *WAY, "size", "fps", "begin", "end"}
"""The options about the film; all other options are about reading."""


@click.command("movie", cls=Verb)
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "--output",
    "-o",
    required=True,
    type=FILE,
    help="The film: .mp4, .mov, .mkv (H.264), .webm (VP9), .gif, or pictures such as frames/%05d.png.",
)
@click.option("--tour", "tour_path", type=FILE, metavar="TOUR.json", help="The key frames; see docs/movies.md.")
@tour_options
@click.option("--size", type=Size(), help=f"The frames' size{SIZES}.  [default: the tour's, or 1280x720]")
@click.option("--fps", type=Float(), metavar="N", help="Frames per second.  [default: the tour's, or 30]")
@click.option("--from", "begin", type=Float(), metavar="S", help="Begin here in the tour.  [default: 0]")
@click.option("--to", "end", type=Float(), metavar="S", help="End here.  [default: the tour's end]")
@click.option(
    "--crf",
    type=click.IntRange(0, 63),
    metavar="N",
    help="Constant rate factor: lower is better and larger.  [default: 18 for H.264, 28 for VP9]",
)
@click.option("--overwrite", is_flag=True, help="Redraw existing pictures.")
@scene_options(
    sun={
        "read": given.read_suns,
        "metavar": "AZ,ALT|TIME|TIME..TIME",
        "help": OPTIONS["sun"].help.rstrip(".") + "; or two times, between which it passes evenly over the whole film "
        "(2026-06-21T06:00+02:00..20:00).",
    }
)
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
@source_options
@vertical_options
@memory_option
@jobs_option
@cluster_options("Draw", ", which share --max-memory")
@sort_last_option("whole frames")
@click.option("--part", metavar="I/N", help="Draw only this part of the frames (for job arrays), such as 3/64.")
@click.option("--finish", is_flag=True, help="Make the film from its parts, once all are drawn.")
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, tour_path: str | None, crf: int | None,
    overwrite: bool, as_json: bool, max_memory: int, jobs: int | None, workers: int | None, dask: str | None,
    sort_last: bool, part: str | None, finish: bool, **options: Any,
) -> None:  # fmt: skip
    """Film a tour of a DEM (one file or many) or of a store, every frame with all of its detail.

    Options of the scene (--sun, --exaggeration…) apply to the whole film, whatever the tour says. Existing pictures
    (frames/%05d.png) are not drawn again: an interrupted film continues where it stopped.

    \b
    Examples:
      orograph movie N44W072.hgt -o orbit.mp4
      orograph movie N44W072.hgt --around -71.303,44.270,3000 -o summit.mp4
      orograph movie dem.tif --still --sun 2026-10-15T06:30-07:00..18:00 -o day.mp4
      orograph movie area.oro --tour tour.json -o tour.mp4 --size 1920x1080 --sky
      orograph movie dem.tif --line hike.gpx --height 200 -o hike.webm
      orograph movie dem.tif --tour tour.json -o frames/%05d.png --from 10 --to 20
      orograph movie area.oro --tour tour.json -o tour.mp4 --workers 4
      orograph movie area.oro --tour tour.json -o tour.mp4 --workers 4 --sort-last
      orograph movie area.oro --tour tour.json -o tour.mp4 --part 3/64
      orograph movie area.oro --tour tour.json -o tour.mp4 --finish
    """
    # (One function, though long: most of it is its options and their help.)
    began = time.perf_counter()
    progress = progress_of(ctx)
    settle_tour(options, tour_path is not None)
    options, passage = given.standing(options)
    check_passage(passage, options)
    errors = check_scene(options, progress)
    check_outputs(
        {"--output": output},
        {**inputs_of(paths, options), "the tour": [tour_path], "the line": [options["line"]]},
    )
    source = source_of(options, OWN)
    with progress.task("Loading Orograph"):
        from orograph.rendering.backends import check_sort_last, session
        from orograph.rendering.memory import check_memory
        from orograph.store.prepare import prepare
        from orograph.touring import Tour
        from orograph.touring.encode import check_movie, is_numbered
        from orograph.touring.film import Film
        from orograph.verbs.filming import By, Shot, shoot_by
        from orograph.verbs.movie import shoot, shoot_by_parts, whole, without

    # Report errors of the command line before any work is done.
    check_movie(output, options["size"], crf)
    by = By.of(workers, dask, part, finish)
    check_sort_last(sort_last, workers, dask, options["backend"])
    if overwrite and not is_numbered(output):
        progress.warn("--overwrite applies to pictures: a finished film replaces an existing file anyway.")
    if tour_path is not None:
        Tour.readable(tour_path)
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, errors=errors, **source)
    said = {name for name in options if ctx.get_parameter_source(name) is not ParameterSource.DEFAULT}
    sun = given.sun(options["sun"], terrain)
    again = None
    if tour_path is not None:
        first = partial(whole, terrain, options["size"], options["exaggeration"])
        tour = without(Tour.load(tour_path, crs=terrain.grid.crs, whole=first), said)
        size = options["size"] or (tour.keys[0].view.width, tour.keys[0].view.height)
    else:
        size = options["size"] or (1280, 720)
        way = (sun.azimuth, sun.altitude), options["exaggeration"], options["furniture"]
        again = partial(tour_of, terrain, size, options, *way)
        tour = again()
    check_movie(output, size, crf)
    check_memory(size, max_memory if "max_memory" in said else None)
    looks = {**given_of(options, terrain), "max_memory": max_memory, "jobs": jobs}
    film = Film.of(
        tour, terrain, size, looks, draw=session(progress, backend=options["backend"]), fps=options["fps"],
        first=options["begin"], last=options["end"], progress=progress, again=again, passage=passage,
    )  # fmt: skip
    how: dict[str, Any] = {"crf": crf, "overwrite": overwrite, "jobs": jobs, "progress": progress}
    how["dpi"] = dpi_of(options["size"])
    if by is None:
        shot = Shot(shoot(film, output, size, **how))
    elif sort_last:
        shot = shoot_by_parts(by, film, output, size, max_memory=max_memory, **how)
    else:
        shot = shoot_by(by, film, output, size, backend=options["backend"], max_memory=max_memory, **how)
    seconds = time.perf_counter() - began
    if as_json:
        told = {
            "movie": output, "frames": len(film), "drawn": shot.drawn, "fps": film.tour.fps, "width": size[0],
            "height": size[1], "tour_seconds": film.tour.duration, "seconds_in_all": round(seconds, 3),
            "lifted_m": round(film.course.lifted, 3), "imbalance": shot.imbalance, "part": part,
            "played": [] if film.playing is None else film.playing.facts,
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
    elif part is not None:
        click.echo(f"{output}: part {part} is drawn ({shot.drawn} frames)  {seconds:.1f} s")
    else:
        there = f" ({len(film) - shot.drawn} existed)" if shot.drawn < len(film) else ""
        uneven = "" if shot.imbalance is None else f"  (busiest worker {shot.imbalance:.2f} × the mean)"
        click.echo(
            f"{output}  {len(film)} frames{there}, {size[0]} × {size[1]}, {film.tour.fps:g}/s  {seconds:.1f} s{uneven}"
        )
