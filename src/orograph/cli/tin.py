"""``orograph tin``: write an irregular triangulation that represents a terrain within a bound in metres."""

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


@click.command("tin")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "--output", "-o", required=True, type=FILE, help="The mesh: .npz, .ply, .obj, .glb; to print: .stl, .3mf."
)
@click.option(
    "--origin", metavar="auto|E,N[,H]",
    help="For .ply, .obj, .glb and --surface: the place that coordinates are relative to; auto: the middle.",
)  # fmt: skip
@click.option("--surface", is_flag=True, help="An .stl of the open surface in metres, instead of a model to print.")
@click.option("--max-error", type=FloatRange(min=0), metavar="METRES", help="Maximum vertical error.")
@click.option("--triangles", type=click.IntRange(min=2), metavar="N", help="Instead: maximum number of triangles.")
@click.option(
    "--bound", type=click.Choice(["surface", "samples"]), default="surface", show_default=True,
    help="Where the bound holds: everywhere, or at samples only.",
)  # fmt: skip
@click.option(
    "--breaklines", type=FILE, metavar="FILE", help="GeoJSON: lines that become edges, points that become vertices."
)
@click.option(
    "--base", type=Float(), metavar="MM", help="For .stl, .3mf: from the plate to the lowest ground.  [default: 3]"
)
@click.option("--model-size", type=Float(), metavar="MM", help="For .stl, .3mf: the longer side.  [default: 150]")
@click.option("--scale", type=Float(), metavar="N", help="For .stl, .3mf: 1:N, instead of a size.")
@click.option("--exaggeration", type=Float(), metavar="X", help="For .stl, .3mf: stretch heights.  [default: 1]")
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
@grid_options("triangulate")
@source_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, origin: str | None, surface: bool,
    max_error: float | None, triangles: int | None, bound: Any, breaklines: str | None, base: float | None,
    model_size: float | None, scale: float | None, exaggeration: float | None, as_json: bool, max_memory: int,
    jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Triangulate a DEM (one file or many) or a store as a TIN: few triangles on its samples, within a bound in metres.

    The bound also holds on the surface between samples. Holes stay holes. The files are those of orograph tessellate;
    an .stl or .3mf is a closed model to print, in millimetres, with walls and a base, unless --surface is given.

    \b
    Examples:
      orograph tin N44W072.hgt --max-error 10 -o ground.ply
      orograph tin area.oro --triangles 100000 -o ground.glb
      orograph tin dem.tif --max-error 1 -o model.stl --model-size 180 --base 4 --exaggeration 1.5
      orograph tin dem.tif --max-error 2 --bound samples -o ground.npz
    """
    began = time.perf_counter()
    check_outputs(
        {"--output": output},
        {"the input": paths, "the grid of --geoid": [options["geoid"]], "the file of --breaklines": [breaklines]},
    )
    progress = progress_of(ctx)
    with progress.task("Loading Orograph"):
        from orograph.store.prepare import prepare
        from orograph.verbs.tin import check_goal, print_of, tin

    check_goal(max_error, triangles)
    model = {"base": base, "model_size": model_size, "scale": scale, "exaggeration": exaggeration}
    print_of(output, **model, surface=surface)
    reading = source_of(options, ())
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, **reading)
    mesh = tin(
        terrain, max_error=max_error, triangles=triangles, bound=bound, breaklines=breaklines, output=output,
        origin=origin, surface=surface, **model, max_memory=max_memory, jobs=jobs, progress=progress,
    )  # fmt: skip
    stats, count = mesh.stats, len(mesh.triangles)
    if as_json:
        crs = terrain.grid.crs
        told = {
            "mesh": output, "seconds_in_all": round(time.perf_counter() - began, 3),
            "crs": crs.to_string() if crs else None, "vertices": len(mesh.vertices), "triangles": count, **stats,
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
    else:
        click.echo(
            f"{output}  {count:,} triangles, off by at most {stats['largest']:.4g} m on the surface, "
            f"{stats['largest_at_samples']:.4g} m at samples"
        )
        if "origin" in stats:
            click.echo("coordinates from {:.10g}, {:.10g}, height {:.10g} m".format(*stats["origin"]))
        if "model" in stats:
            x, y, z = stats["model"]["size_mm"]
            click.echo(f"{x:,.1f} × {y:,.1f} × {z:,.1f} mm, 1:{stats['model']['scale']:,.0f}, "
                       f"{stats['model']['volume_cm3']:,.1f} cm³")  # fmt: skip
