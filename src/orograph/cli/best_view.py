"""``orograph best-view``: the views that show a target best."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from orograph.cli.camera import Size
from orograph.cli.files import check_outputs
from orograph.cli.options import (
    FILE,
    Float,
    FloatRange,
    grid_options,
    jobs_option,
    memory_option,
    progress_of,
    source_of,
    source_options,
)
from orograph.errors import UsageError

OWN = ("target", "k", "size", "azimuths", "pitches", "heights", "distances", "fov", "clearance", "target_height", "sun",
       "apart", "pieces")  # fmt: skip


@click.command("best-view")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--target", required=True, type=FILE, metavar="FILE.geojson", help="Points, lines, areas to show.")
@click.option(
    "--output",
    "-o",
    required=True,
    type=FILE,
    metavar="VIEWS.json",
    help="The views; each also as VIEWS-1.json, VIEWS-2.json…, for render --view.",
)
@click.option("-k", "--views", "k", type=click.IntRange(1, 100), default=3, show_default=True, help="How many views.")
@click.option("--size", type=Size(), default="1280x720", show_default=True, help="The pictures' size in pixels.")
@click.option(
    "--azimuths",
    type=click.IntRange(1, 3600),
    default=72,
    show_default=True,
    metavar="N",
    help="Sides of the target that cameras may stand at, evenly spread.",
)
@click.option(
    "--pitch",
    "pitches",
    type=FloatRange(-90, 90, min_open=True, max_open=True),
    multiple=True,
    metavar="DEG",
    help="How far cameras may look down; may be repeated.  [default: 5 to 50]",
)
@click.option(
    "--height",
    "heights",
    type=FloatRange(0),
    multiple=True,
    metavar="M",
    help="Heights of cameras above the ground; may be repeated.  [default: by --pitch]",
)
@click.option(
    "--distance",
    "distances",
    type=FloatRange(0, min_open=True),
    multiple=True,
    metavar="M",
    help="Distances of cameras over the ground, from the target's middle; may be repeated.  [default: 0.75 to 3 "
    "times the distance from which all of it is in view]",
)
@click.option(
    "--fov",
    type=FloatRange(1e-6, 180, max_open=True),
    multiple=True,
    default=(40.0,),
    show_default=True,
    metavar="DEG",
    help="Vertical field of view; may be repeated.",
)
@click.option(
    "--clearance",
    type=FloatRange(0),
    default=2.0,
    show_default=True,
    metavar="M",
    help="Minimum height of every eye above the ground.",
)
@click.option(
    "--target-height",
    type=FloatRange(0),
    default=0.0,
    show_default=True,
    metavar="M",
    help="Height of the target above the ground.",
)
@click.option("--sun", metavar="AZIMUTH,ALTITUDE|TIME", help="Prefer ground that this sun lights.")
@click.option(
    "--apart",
    type=FloatRange(0, 180),
    default=20.0,
    show_default=True,
    metavar="DEG",
    help="Minimum angle between any two views, seen from the target.",
)
@click.option(
    "--pieces",
    type=click.IntRange(1, 1_000_000),
    default=1000,
    show_default=True,
    help="About how many pieces the target is divided into for scoring.",
)
@click.option(
    "--tour", "tour_path", type=FILE, metavar="TOUR.json", help="Also write a tour through the views, to film."
)
@click.option(
    "--seconds",
    type=Float(),
    default=6.0,
    show_default=True,
    metavar="S",
    help="Time from one view of the tour to the next.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the views as JSON.")
@grid_options("draw")
@source_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, tour_path: str | None, seconds: float, as_json: bool,
    max_memory: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Find the views that show most of a target and differ from each other.

    \b
    Examples:
      orograph best-view dem.tif --target lake.geojson -o views.json
      orograph render dem.tif --view views-1.json -o best.png
      orograph best-view area.oro --target hike.geojson --height 2 -o views.json --tour tour.json
    """
    progress = progress_of(ctx)
    if not seconds > 0:
        raise UsageError(f"`seconds`, the time from view to view, must be more than 0, not {seconds:g}.")
    source = source_of(options, OWN)
    own = {name: options[name] for name in OWN if name != "pitches"}
    with progress.task("Loading Orograph"):
        from orograph.output import check_folder
        from orograph.touring.best_view import singles
        from orograph.verbs.best_view import best_view

    files = {f"view {i + 1} of --output": file for i, file in enumerate(singles(output, own["k"]))}
    check_outputs({"--output": output, "--tour": tour_path, **files},
                  {"the input": paths, "the target": [options["target"]]})  # fmt: skip
    for file in filter(None, (output, tour_path)):
        check_folder(Path(file))
    found = best_view(
        list(paths), **own, pitches=options["pitches"] or None, max_memory=max_memory, jobs=jobs, progress=progress,
        **source,
    )  # fmt: skip
    written = found.save(output)
    if tour_path is not None:
        found.tour(seconds=seconds).save(tour_path)
    if as_json:
        click.echo(json.dumps(found.to_list(), allow_nan=False))
        return
    for file, one in zip(written, found.views):
        eye = ", ".join(f"{v:.0f}" for v in one.view.eye)
        click.echo(f"{file}  score {one.score:.3f}, adds {one.gain:.3f}, sees {100 * one.visible:.1f} %  eye ({eye})")
    click.echo(f"{output}  {len(found)} of {found.cameras} cameras, together {found.together:.3f}")
