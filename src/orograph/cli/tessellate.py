"""``orograph tessellate``: the triangles that a method makes of a terrain for a view, in a file."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import click

from orograph.cli.camera import CAMERA, camera_options, camera_view, check_camera
from orograph.cli.files import check_outputs
from orograph.cli.options import (
    FILE,
    Float,
    grid_options,
    jobs_option,
    memory_option,
    progress_of,
    source_options,
    vertical_options,
)
from orograph.cli.refining import (
    REFINE,
    check_colors,
    choice_of,
    error_kinds,
    goal_of,
    goal_options,
    make_method,
    method_option,
    not_enough,
)
from orograph.cli.scenes import scene_option
from orograph.errors import OrographError

OWN = {*CAMERA, *REFINE, "seconds", "exaggeration"}
"""What is said about the mesh; all other options are about reading."""


@click.command("tessellate")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--output", "-o", required=True, type=FILE, help="The mesh: .npz, .ply, .obj or .glb.")
@method_option("What makes the triangles.", default="soar", show_default=True)
@goal_options
@click.option("--seconds", type=Float(), metavar="S", help="Instead: what can be done in so much time.")
@camera_options
@scene_option("exaggeration")
@click.option("--check", is_flag=True, help="Let the referee measure the mesh against every sample in view.")
@grid_options("triangulate")
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
@source_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, method: str, check: bool, as_json: bool,
    max_memory: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Triangulate a DEM (one file or many) or a store for a view, within a tolerance in pixels.

    The camera is that of orograph render: without options all of the terrain, from the south. In an .npz are vertices
    (n, 3) = column, row and height of the full-resolution samples, triangles (m, 3), counter-clockwise from above, the
    strip where the method makes one, and the method's stats; .ply and .obj are in the terrain's CRS, .glb near its
    origin.

    \b
    Examples:
      orograph tessellate N44W072.hgt -o mesh.npz --check
      orograph tessellate area.oro -o mesh.ply --view VIEW.json --method roam --tolerance 0.5
      orograph tessellate dem.tif -o mesh.glb --from 225 --pitch 20 --triangles 20000
    """
    began = time.perf_counter()
    progress = progress_of(ctx)
    check_camera(options)
    check_outputs(
        {"--output": output},
        {"the input": paths, "the image of --drape": [options["drape"]], "the camera of --view": [options["view_path"]],
         "the grid of --geoid": [options["geoid"]]},
    )  # fmt: skip
    source = {k: v for k, v in options.items() if k not in OWN}
    if source["band"] == 1:
        source["band"] = None
    with progress.task("Loading Orograph"):
        from orograph.meshing import mesh_format, write
        from orograph.output import check_folder
        from orograph.scene.parts import check_exaggeration
        from orograph.scene.prepare import prepare
        from orograph.viewpoint import Camera

        choice = choice_of(method, options["conservative"])
        goal = goal_of(options, "tolerance", "triangles", "seconds")
        choice.check_triangles()
        choice.info.check_goal(goal.name)
        check_colors(options, [choice])
    mesh_format(output)
    check_folder(Path(output))
    check_exaggeration(options["exaggeration"])
    terrain = prepare(
        list(paths), max_memory=max_memory, jobs=jobs, progress=progress, errors=error_kinds([choice]), **source
    )
    view = camera_view(terrain, options)
    with progress.task("Errors of the terrain"):
        selects = make_method(choice, terrain, options, max_memory, jobs, progress)
    with progress.task(f"Selecting ({choice})"):
        selection = selects.select(Camera.over(terrain.grid, view, options["exaggeration"]), goal)
        mesh = selection.tessellation()
    stats, count = selection.stats, len(mesh.triangles)
    if goal.triangles is not None and count > goal.triangles:
        progress.warn(not_enough(goal.triangles, choice.info.name, count))
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
            **stats, "triangles": count, "bound": selection.bound,
            "report": None if report is None else report.to_dict(),
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
    else:
        took = f"  {stats['refine_ms']:.1f} ms" if "refine_ms" in stats else ""
        click.echo(f"{output}  {choice}: {count:,} triangles{took}")
        if report is not None:
            click.echo(str(report))
    if report is not None:
        promised = selection.bound
        if report.defects and promised is None:
            progress.warn("The mesh is not sound (see the report), and nothing was promised.")
        elif promised is not None and not report.ok(promised, of="samples"):
            raise OrographError(
                "The mesh is not sound (see the report)." if report.defects else
                f"The mesh is off by {report.largest_at_samples:.4g} pixels, and {choice} promised {promised:g}.",
                path=output, remedy="This is a fault of Orograph: please report it, with the terrain and the view.",
            )  # fmt: skip
