"""``orograph tessellate``: the triangles that an engine makes of a terrain for a view, in a file."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import click

from orograph.cli.camera import CAMERA, camera_options, camera_view, check_camera
from orograph.cli.engines import (
    REFINE,
    check_colors,
    color_errors,
    engine_option,
    goal_of,
    make_engine,
    not_enough,
    refine_options,
)
from orograph.cli.files import check_outputs
from orograph.cli.options import (
    FILE,
    grid_options,
    jobs_option,
    memory_option,
    progress_of,
    source_options,
    vertical_options,
)
from orograph.errors import OrographError

OWN = {*CAMERA, *REFINE, "seconds", "metric", "exaggeration", "geomorph"}
"""What is said about the mesh; all other options are about reading."""


@click.command("tessellate")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--output", "-o", required=True, type=FILE, help="The mesh: .npz, .ply, .obj or .glb.")
@engine_option(default="soar", show_default=True, help="The method of refinement.")
@refine_options
@click.option("--seconds", type=float, metavar="S", help="Instead: what can be done in so much time.")
@click.option("--metric", metavar="NAME", help="How errors become pixels.  [default: the engine's own]")
@click.option("--geomorph", is_flag=True, help="Let vertices grow out of their edges as they come (soar, batched).")
@camera_options
@click.option(
    "--exaggeration", type=float, default=1.0, show_default=True, metavar="X", help="Stretch heights on the screen."
)
@click.option("--check", is_flag=True, help="Let the referee measure the mesh against every sample in view.")
@grid_options("triangulate")
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
@source_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, engine: str, check: bool, as_json: bool,
    max_memory: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Triangulate a DEM (one file or many) or a store for a view, within a tolerance in pixels.

    The camera is that of orograph render: without options all of the terrain, from the south. In an .npz are vertices
    (n, 3) = column, row and height of the full-resolution samples, triangles (m, 3), counter-clockwise from above, the
    strip where the engine makes one, and the engine's stats; .ply and .obj are in the terrain's CRS, .glb near its
    origin.

    \b
    Examples:
      orograph tessellate N44W072.hgt -o mesh.npz --check
      orograph tessellate area.oro -o mesh.ply --view VIEW.json --engine roam --tolerance 0.5
      orograph tessellate dem.tif -o mesh.glb --from 225 --pitch 20 --triangles 20000
    """
    began = time.perf_counter()
    progress = progress_of(ctx)
    check_camera(options)
    check_colors(options)
    goal = goal_of(options, "tolerance", "triangles", "seconds")
    check_outputs(
        {"--output": output},
        {"the input": paths, "the image of --drape": [options["drape"]], "the camera of --view": [options["view_path"]],
         "the grid of --geoid": [options["geoid"]]},
    )  # fmt: skip
    source = {k: v for k, v in options.items() if k not in OWN}
    if source["band"] == 1:
        source["band"] = None
    with progress.task("Loading Orograph"):
        from orograph.mesh import mesh_format, write
        from orograph.output import check_folder
        from orograph.picture.prepare import prepare
        from orograph.picture.scene import check_exaggeration

    mesh_format(output)
    check_folder(Path(output))
    check_exaggeration(options["exaggeration"])
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, **source)
    view = camera_view(terrain, options)
    color = color_errors(terrain, options, max_memory, jobs, progress)
    with progress.task("Errors of the terrain"):
        refiner = make_engine(
            engine, terrain, options, color=color, max_memory=max_memory, jobs=jobs, metric=options["metric"],
            geomorph=options["geomorph"],
        )  # fmt: skip
    with progress.task(f"Refining ({engine})"):
        mesh = refiner.refine(view, **goal)
    if mesh.stats.get("within_budget") is False:
        progress.warn(not_enough(goal["triangles"], engine, mesh.stats["triangles"]))
    with progress.task("Writing"):
        write(mesh, terrain.grid, output)
    report = None
    if check:
        from orograph import verify

        with progress.task("The referee"):
            report = verify.judge_mesh(mesh, terrain, view, exaggeration=options["exaggeration"], jobs=jobs)
    if as_json:
        crs = terrain.grid.crs
        told = {
            "mesh": output, "seconds_in_all": round(time.perf_counter() - began, 3),
            "crs": crs.to_string() if crs else None, "view": view.to_dict(), "vertices": len(mesh.vertices),
            **mesh.stats, "report": None if report is None else report.to_dict(),
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
    else:
        click.echo(f"{output}  {engine}: {len(mesh.triangles):,} triangles  {mesh.stats['refine_ms']:.1f} ms")
        if report is not None:
            click.echo(str(report))
    if report is not None:
        promised = mesh.stats["tolerance"] if mesh.stats["conservative"] else None
        if report.defects and promised is None and "tolerance" not in goal:
            progress.warn("The mesh is not sound (see the report): nothing is promised for this budget.")
        elif report.defects or (promised is not None and not report.ok(promised, of="samples")):
            raise OrographError(
                "The mesh is not sound (see the report)." if report.defects else
                f"The mesh is off by {report.largest_at_samples:.4g} pixels, and {engine} promised {promised:g}.",
                path=output, remedy="This is a fault of Orograph: please report it, with the terrain and the view.",
            )  # fmt: skip
