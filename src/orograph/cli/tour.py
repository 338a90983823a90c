"""``orograph tour``: make a tour to start from, or describe one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from orograph.cli.camera import SIZES, Size
from orograph.cli.files import check_outputs
from orograph.cli.options import FILE, grid_options, jobs_option, memory_option, progress_of, source_of, source_options
from orograph.cli.scenes import scene_option
from orograph.cli.tours import tour_options
from orograph.errors import UsageError
from orograph.verbs.ways import WAY, settle_tour, tour_of


class Tours(click.Group):
    """The commands about tours, and the error message for an unknown one."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in self.commands:
            ctx.fail(f"{args[0]!r} is neither new nor info: orograph tour new DEM -o TOUR.json, orograph tour info "
                     "TOUR.json.")  # fmt: skip
        return super().resolve_command(ctx, args)


@click.group("tour", cls=Tours)
def command() -> None:
    """Make a tour (key frames in a file, for orograph movie), or describe one."""


@command.command("new")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--output", "-o", required=True, type=FILE, metavar="TOUR.json", help="The tour.")
@tour_options
@click.option("--size", type=Size(), default="1280x720", show_default=True, help=f"The pictures' size{SIZES}.")
@scene_option("exaggeration", help="The exaggeration that the film will use.")
@grid_options("draw")
@source_options
@memory_option
@jobs_option
@click.pass_context
def new(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, size: tuple[int, int], exaggeration: float,
    max_memory: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Write a tour of a DEM or a store, to film as it is or to edit by hand.

    \b
    Examples:
      orograph tour new N44W072.hgt -o orbit.json
      orograph tour new N44W072.hgt --around -71.303,44.270,3000 -o summit.json
      orograph tour new area.oro --line hike.gpx --height 300 -o hike.json
      orograph tour new dem.tif --point -71.40,44.10 --point -71.30,44.27 --seconds 30 -o flight.json
    """
    progress = progress_of(ctx)
    settle_tour(options)
    check_outputs({"--output": output}, {"the input": paths, "the line": [options["line"]]})
    source = source_of(options, WAY)
    with progress.task("Loading Orograph"):
        from orograph.output import check_folder
        from orograph.store.prepare import prepare

    check_folder(Path(output))
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, **source)
    made = tour_of(terrain, size, options, (315.0, 45.0), exaggeration)
    made.save(output)
    click.echo(f"{output}  {len(made.keys)} key frame(s), {made.duration:.1f} s")


@command.command("info")
@click.argument("path", type=FILE, metavar="TOUR.json")
@click.option("--crs", help="The terrain's CRS, for tours in another.")
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def info(path: str, crs: str | None, as_json: bool) -> None:
    """Describe a tour: where the camera is, and when."""
    from orograph.documents import load_object
    from orograph.touring import Tour

    if crs is None:
        values = load_object(path, "tour", "keys")
        keys = values.get("keys")
        for part in (values, *(keys if isinstance(keys, list) else ())):
            if isinstance(part, dict) and part.get("crs") is not None:
                raise UsageError(
                    f"The tour's places are in {part['crs']}, and its path depends on the terrain's CRS.", path=path,
                    remedy="Give it: --crs EPSG:32612 (orograph info prints a terrain's).",
                )  # fmt: skip
    tour = Tour.load(path, crs=crs)
    if as_json:
        click.echo(json.dumps({**tour.to_dict(), "duration": tour.duration, "frames": len(tour),
                               "times": list(tour.times)}, allow_nan=False))  # fmt: skip
        return
    view = tour.keys[0].view
    kind = "loop, " if tour.loop else ""
    click.echo(f"{tour.duration:.2f} s, {kind}{len(tour)} frames at {tour.fps:g}/s, {view.width} × {view.height}")
    for number, (key, time) in enumerate(zip(tour.keys, tour.times)):
        said = [f"{name} {value:g}" for name in ("exaggeration", "tolerance", "relief", "water")
                if (value := getattr(key, name)) is not None]  # fmt: skip
        if key.sun is not None:
            said.append(f"sun {key.to_dict()['sun']}")
        held = f" holds {key.hold:g} s" if key.hold else " stops" if key.stop else ""
        place = ", ".join(f"{v:.0f}" for v in key.view.eye)
        click.echo(f"{number:4d} {time:8.2f} s  eye ({place})  {key.path}{held}  {'; '.join(said)}".rstrip())
