"""``orograph render``: draw a relief picture of any DEM or store."""

from __future__ import annotations

import json
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from orograph.cli.camera import CAMERA, PLACES, camera_options, camera_view, check_camera, is_fitted
from orograph.cli.files import check_ending, check_outputs
from orograph.cli.options import (
    FILE,
    cluster_options,
    jobs_option,
    memory_option,
    progress_of,
    sort_last_option,
    source_of,
    source_options,
    vertical_options,
)
from orograph.cli.scenes import DRAWING, check_scene, given_of, inputs_of, scene_of, scene_options
from orograph.cli.sections import Verb
from orograph.errors import UsageError
from orograph.scene.sizes import dpi_of

if TYPE_CHECKING:
    from orograph.viewpoint import View

OWN = {*DRAWING, *CAMERA}
"""The options about the picture; all other options are about reading."""


@click.command("render", cls=Verb)
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--output", "-o", required=True, type=FILE, help="The picture: .png, .jpg, .webp or .tif.")
@camera_options
@scene_options()
@click.option(
    "--depth",
    type=FILE,
    metavar="OUT.tif",
    help="Also write the depth: metres along the viewing direction, float32, NaN where there is no ground.",
)
@click.option(
    "--each",
    metavar="view|data|member|band|time[=SOME]",
    help="Draw several panels with one camera, scale and legend: a map beside the relief (view), one for each --data "
    "(data, each with its own scale), or for each member, band or time of the first --data, all or some: "
    "member=1-6, time=T12.",
)
@click.option("--save-view", type=FILE, metavar="VIEW.json", help="Also write the camera that was used.")
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
@source_options
@vertical_options
@memory_option
@jobs_option
@cluster_options("Draw tiles of it", ", which share --max-memory")
@sort_last_option("tiles of the picture")
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, as_json: bool, depth: str | None, save_view: str | None,
    each: str | None, max_memory: int, jobs: int | None, workers: int | None, dask: str | None, sort_last: bool,
    **options: Any,
) -> None:  # fmt: skip
    """Draw a relief picture of a DEM (one file or many) or of a store.

    Degrees become metres, nodata becomes holes, and by default all of the terrain is shown from the south. A large DEM
    is built into a store first, which is kept: the next picture of it takes seconds.

    \b
    Examples:
      orograph render N44W072.hgt -o relief.png
      orograph render tiles/*.tif -o area.png --from 225 --pitch 30 --sky
      orograph render dem.tif -o map.png --projection plan --furniture --size 20x15cm@300
      orograph render dem.tif -o summit.png --lonlat -71.3,44.2,2500 --look-at -71.303,44.270
      orograph render dem.tif -o mesh.png --method soar --wireframe --tolerance 2
      orograph render area.oro -o wall.tif --size 100000x60000 --workers 8 --max-memory 16GiB
      orograph render area.oro -o area.png --workers 4 --sort-last
    """
    # (One function, though long: most of it is its options and their help.)
    began = time.perf_counter()
    progress = progress_of(ctx)
    check_camera(options)
    errors = check_scene(options, progress)
    check_outputs(
        {"--output": output, "--depth": depth, "--save-view": save_view},
        {**inputs_of(paths, options), "the camera of --view": [options["view_path"]]},
    )
    if depth:
        check_ending("--depth", depth)
    if depth and each:
        raise UsageError("--depth is for a single picture, but --each makes several.")
    source = source_of(options, OWN)
    with progress.task("Loading Orograph"):
        from orograph.errors import DamagedChunkError, NothingInViewError
        from orograph.folders import cache_folder
        from orograph.output import check_folder
        from orograph.rendering.memory import check_memory
        from orograph.rendering.picture import picture_format
        from orograph.rendering.ways import Way
        from orograph.scene.diagnostics import LEAVE_CAMERA
        from orograph.store.prepare import prepare

    # Report errors of the command line before any work is done.
    picture_format(Path(output))
    for file in filter(None, (output, depth, save_view)):
        check_folder(Path(file))
    said = ctx.get_parameter_source("max_memory") is not ParameterSource.DEFAULT
    allowed = max_memory if said else None

    dpi = dpi_of(options["size"])
    way = Way(options["backend"], workers, dask, sort_last)
    if way.together and each:
        raise UsageError("Panels are drawn by this process: --each cannot be combined with --workers or --dask.")
    if options["size"] is not None and not way.in_tiles(options["size"], max_memory, options["wireframe"]):
        check_memory(options["size"], allowed)
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, errors=errors, **source)
    view = camera_view(terrain, options if each is None else {**options, "furniture": False})
    scene = scene_of(terrain, view, options, max_memory, jobs)
    if each is None and is_fitted(options):
        from orograph.rendering.standing import with_room

        scene = with_room(scene, partial(camera_view, terrain, options, keys=scene.keys))
        view = scene.view
    try:
        if each is not None:
            from orograph.rendering.panels import draw_panels

            check_memory((view.width, view.height), allowed)
            budget = {"max_memory": max_memory, "jobs": jobs}

            def again(size: tuple[int, int], also: Any = None) -> View:
                return camera_view(terrain, {**options, "size": size, "furniture": False}, also)

            picture = draw_panels(
                terrain, view, each, {**given_of(options), **budget}, backend=options["backend"],
                again=again if is_fitted(options) else None, progress=progress,
            )  # fmt: skip
            picture.save(output, dpi=dpi)
            facts, view = picture.facts, picture.view
        else:
            facts = way.into(scene, output, progress, depth=depth, dpi=dpi, max_memory=allowed)
    except DamagedChunkError as error:
        if error.path is not None and Path(error.path).parent == cache_folder():
            error.remedy = "It is a cached copy: delete it, and the next picture builds it again."
        raise
    except NothingInViewError as error:
        if error.remedy == LEAVE_CAMERA and not any(options[name] is not None for name in PLACES):
            error.remedy = "Check what the file holds with orograph info."
        raise
    if save_view:
        view.save(save_view)
    seconds = time.perf_counter() - began
    if as_json:
        crs = terrain.grid.crs
        told = {
            "picture": output, "depth": depth, "width": view.width, "height": view.height,
            "seconds_in_all": round(seconds, 3), "crs": crs.to_string() if crs else None,
            "sun": [scene.lighting.sun.azimuth, scene.lighting.sun.altitude], "view": view.to_dict(),
            **facts,
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
    else:
        stats = facts.get("mesh")
        mesh = f"  {stats['method']}: {stats['triangles']:,} triangles" if stats else ""
        uneven = f"  (busiest worker {facts['imbalance']:.2f} × the mean)" if way.together else ""
        click.echo(f"{output}  {view.width} × {view.height}{mesh}  {seconds:.1f} s{uneven}")
