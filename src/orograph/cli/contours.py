"""``orograph contours``: write contour lines to a vector file."""

from __future__ import annotations

import json
import time
from typing import Any

import click

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
    vertical_options,
)  # fmt: skip

OWN = ("interval", "levels", "base", "index", "simplify")


@click.command("contours")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--output", "-o", required=True, type=FILE, help="The lines: .gpkg, .geojson, .shp, .parquet or .fgb.")
@click.option(
    "--interval", type=FloatRange(min=0, min_open=True), metavar="METRES",
    help="Distance between levels.  [default: a round number that gives about twenty levels]",
)  # fmt: skip
@click.option("--levels", metavar="M[,M…]", help="Instead: these heights, in metres.")
@click.option(
    "--base",
    type=Float(),
    default=0.0,
    show_default=True,
    metavar="METRES",
    help="The height that levels are counted from.",
)
@click.option(
    "--index", type=click.IntRange(min=0), default=5, show_default=True, metavar="N",
    help="Every how many levels there is an index contour (`is_index`); 0: none.",
)  # fmt: skip
@click.option(
    "--simplify", type=FloatRange(min=0), default=0.0, show_default=True, metavar="METRES",
    help="How far a line may be displaced.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
@grid_options("trace")
@source_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, as_json: bool, max_memory: int, jobs: int | None,
    **options: Any,
) -> None:  # fmt: skip
    """Write the contour lines of a DEM (one file or many) or a store as vectors.

    They are isolines of the surface that pictures draw, at full resolution and in the terrain's CRS (GeoJSON: in
    longitude and latitude). Each line has its height (metres) and whether it is an index contour (is_index). Rings are
    closed; other lines end at the border or at missing ground.

    \b
    Examples:
      orograph contours N44W072.hgt --interval 20 -o contours.gpkg
      orograph contours area.oro --interval 10 --simplify 5 -o contours.geojson
      orograph contours dem.tif --levels 372.5,380 -o shores.shp
    """
    began = time.perf_counter()
    check_outputs(
        {"--output": output}, {"the input": paths, "the grid of --geoid": [options["geoid"]]}
    )  # fmt: skip
    progress = progress_of(ctx)
    with progress.task("Loading Orograph"):
        from orograph.verbs.contours import Written, traced

    own = {name: options[name] for name in OWN}
    found = traced(
        list(paths), output=output, max_memory=max_memory, jobs=jobs, progress=progress, **own,
        **source_of(options, OWN),
    )  # fmt: skip
    assert isinstance(found, Written)
    if as_json:
        told = {
            "contours": output, "seconds_in_all": round(time.perf_counter() - began, 3), "interval_m": found.interval,
            "lines": found.lines, "points": found.points, "lowest_m": found.lowest, "highest_m": found.highest,
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
        return
    every = "" if found.interval is None else f" every {found.interval:g} m"
    heights = "" if found.lowest is None else f" from {found.lowest:g} to {found.highest:g} m"
    click.echo(f"{output}  {found.lines:,} contour lines{every}{heights}, {found.points:,} points")
