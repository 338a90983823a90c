"""``orograph tessellate``: write the triangles that a method makes of a terrain for a view."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any

import click

from orograph.cli import refining
from orograph.cli.camera import CAMERA, camera_options, camera_view, check_camera
from orograph.cli.options import FILE, Float, progress_of, source_of
from orograph.cli.sections import Verb
from orograph.errors import OrographError

if TYPE_CHECKING:
    from orograph.progress import Progress
    from orograph.verify.report import Report

OWN = (*CAMERA, "seconds")
"""The options about the mesh besides the method and its goal; all other options are about reading."""


@click.command("tessellate", cls=Verb)
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--output", "-o", required=True, type=FILE, help="The mesh: .npz, .ply, .obj or .glb.")
@refining.method_option("The method that makes the triangles.", default="soar", show_default=True)
@refining.goal_options
@click.option("--seconds", type=Float(), metavar="S", help="Instead: the best mesh that this time allows.")
@camera_options
@click.option("--check", is_flag=True, help="Let the referee measure the mesh against every sample in view.")
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
@refining.terrain_options("triangulate")
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, method: str, check: bool, as_json: bool,
    max_memory: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Triangulate a DEM (one file or many) or a store for a view, within a tolerance in pixels.

    The camera is that of orograph render: without options all of the terrain, from the south. An .npz holds vertices
    (n, 3) = column, row and height of the full-resolution samples, triangles (m, 3), counter-clockwise from above, the
    strip if the method makes one, and the method's stats; .ply and .obj are in the terrain's CRS, .glb near its origin.

    \b
    Examples:
      orograph tessellate N44W072.hgt -o mesh.npz --check
      orograph tessellate area.oro -o mesh.ply --view VIEW.json --method roam --tolerance 0.5
      orograph tessellate dem.tif -o mesh.glb --from 225 --pitch 20 --triangles 20000
    """
    began = time.perf_counter()
    progress = progress_of(ctx)
    check_camera(options)
    refining.check_written({"--output": output}, paths, options, view=options["view_path"])
    with progress.task("Loading Orograph"):
        from orograph.verbs.tessellate import triangulate
    goals = {name: options[name] for name in ("tolerance", "triangles", "seconds")}
    made = triangulate(
        list(paths), lambda terrain: camera_view(terrain, options), method=method, goals=goals,
        conservative=options["conservative"], drape=options["drape"], exaggeration=options["exaggeration"],
        check=check, output=output, max_memory=max_memory, jobs=jobs, progress=progress,
        **source_of(options, {*OWN, *refining.REFINE}),
    )  # fmt: skip
    stats, count, report = made.stats, len(made.mesh.triangles), made.report
    if as_json:
        crs = made.terrain.grid.crs
        told = {
            "mesh": output, "seconds_in_all": round(time.perf_counter() - began, 3),
            "crs": crs.to_string() if crs else None, "view": made.view.to_dict(), "vertices": len(made.mesh.vertices),
            **stats, "triangles": count, "bound": made.bound, "report": None if report is None else report.to_dict(),
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
    else:
        took = f"  {stats['refine_ms']:.1f} ms" if "refine_ms" in stats else ""
        click.echo(f"{output}  {made.choice}: {count:,} triangles{took}")
        if report is not None:
            click.echo(str(report))
    if report is not None:
        _judge(report, made.bound, str(made.choice), output, progress)


def _judge(report: Report, promised: float | None, choice: str, output: str, progress: Progress) -> None:
    """Warn about an unsound mesh, or raise OrographError if a promise is broken."""
    if report.defects and promised is None:
        progress.warn("The mesh is not sound (see the report), and nothing was promised.")
    elif promised is not None and not report.ok(promised):
        raise OrographError(
            "The mesh is not sound (see the report)." if report.defects else
            f"The mesh is off by {report.largest:.4g} pixels, but {choice} promised {promised:g}.",
            path=output, remedy="This is a fault of the method: please report it, with the terrain and the view.",
        )  # fmt: skip
