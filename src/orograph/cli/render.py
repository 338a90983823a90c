"""``orograph render``: from any DEM or store to a relief picture."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from orograph.cli.camera import CAMERA, PLACES, camera_options, camera_view, check_camera
from orograph.cli.engines import engine_option
from orograph.cli.files import check_ending, check_outputs
from orograph.cli.options import (
    FILE,
    ParamType,
    jobs_option,
    memory_option,
    progress_of,
    source_options,
    vertical_options,
)
from orograph.cli.suns import sun_option
from orograph.errors import UsageError


class Water(ParamType):
    """auto, none, or a level in metres."""

    name = "auto|none|METRES"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | float:
        if isinstance(value, float) or value in ("auto", "none"):
            return float(value) if isinstance(value, float) else str(value)
        try:
            return float(value)
        except ValueError:
            self.fail(f"{value!r} is neither auto, none nor a level in metres.", param, ctx)


SCENE = ("shadows", "exaggeration", "colormap", "drape", "sky", "relief", "samples", "tolerance", "engine", "wireframe",
         "furniture", "title")  # fmt: skip
OWN = {*SCENE, *CAMERA, "sun", "water", "backend"}
"""What is said about the picture; all other options are about reading."""


@click.command("render")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--output", "-o", required=True, type=FILE, help="The picture: .png, .jpg, .webp or .tif.")
@camera_options
@sun_option()
@click.option("--shadows/--no-shadows", default=True, show_default=True, help="Whether the ground casts shadows.")
@click.option(
    "--exaggeration", type=float, default=1.0, show_default=True, metavar="X", help="Stretch heights on the screen."
)
@click.option(
    "--relief",
    type=float,
    metavar="X",
    help="Stretch slopes for shading only; 1 is nature.  [default: 1 to 6, more for gentle land]",
)
@click.option(
    "--colormap",
    metavar="NAME",
    help="Colours of heights: alpine, mars, grey or any name of the cmap catalogue.  [default: alpine]",
)
@click.option("--drape", type=FILE, metavar="IMAGE", help="Lay this image over the ground; it may be in any CRS.")
@click.option(
    "--water",
    type=Water(),
    metavar="auto|none|METRES",
    default="auto",
    show_default=True,
    help="auto: level areas are lakes and seas; a number: all ground up to that height.",
)
@click.option("--sky", is_flag=True, help="Draw sky and haze, instead of paper.")
@click.option("--furniture", is_flag=True, help="Add a title, a colour bar, a north arrow and a scale bar.")
@click.option("--title", help="The title (with --furniture).  [default: the file's name]")
@click.option(
    "--samples",
    type=click.IntRange(1, 1024),
    default=4,
    show_default=True,
    help="Rays per pixel where the picture has edges; 1: jagged ones.",
)
@click.option(
    "--tolerance",
    type=float,
    metavar="PX",
    help="Pixels by which the ground may be displaced; 0 draws every sample.  "
    "[default: 0 up to 16.8 million samples, else 0.5; with --engine 1]",
)
@engine_option(help="Draw the mesh that this engine makes within --tolerance, with light on its faces.")
@click.option("--wireframe", is_flag=True, help="With --engine: draw its triangles' edges over the relief.")
@click.option(
    "--mesh-view",
    type=FILE,
    metavar="VIEW.json",
    help="With --engine: the camera to refine for, to look at the mesh from elsewhere.  [default: the picture's]",
)
@click.option(
    "--depth",
    type=FILE,
    metavar="OUT.tif",
    help="Also write the depth: metres along the viewing direction, float32, NaN where no ground is.",
)
@click.option("--save-view", type=FILE, metavar="VIEW.json", help="Also write the camera that was used.")
@click.option("--crs", help="Projected CRS to draw in.  [default: the file's own, or its UTM zone]")
@click.option("--resolution", type=float, metavar="METRES", help="Distance between samples.  [default: the files']")
@click.option(
    "--backend",
    type=click.Choice(["cpu", "gpu"]),
    default="cpu",
    show_default=True,
    help="What draws; gpu: the CPU instead where there is none (see orograph doctor).",
)
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
@source_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, as_json: bool, depth: str | None, save_view: str | None,
    max_memory: int, jobs: int | None, mesh_view: str | None, **options: Any,
) -> None:  # fmt: skip
    """Draw a relief picture of a DEM (one file or many) or of a store.

    Degrees become metres, nodata becomes holes, and with no camera given all of the terrain is shown from the south. A
    large DEM is built into a store first, which is kept: the next picture of it takes seconds.

    \b
    Examples:
      orograph render N44W072.hgt -o relief.png
      orograph render tiles/*.tif -o area.png --from 225 --pitch 30 --sky
      orograph render dem.tif -o map.png --projection plan --furniture --size 2000x2000
      orograph render dem.tif -o summit.png --lonlat -71.3,44.2,2500 --look-at -71.303,44.270
      orograph render dem.tif -o mesh.png --engine soar --wireframe --tolerance 2
    """
    began = time.perf_counter()
    progress = progress_of(ctx)
    check_camera(options)
    if options["wireframe"] and options["engine"] is None:
        raise UsageError("--wireframe shows what an engine made.", remedy="Choose one, such as --engine soar.")
    if mesh_view is not None and options["engine"] is None:
        raise UsageError("--mesh-view is what an engine refines for.", remedy="Choose one, such as --engine soar.")
    check_outputs(
        {"--output": output, "--depth": depth, "--save-view": save_view},
        {"the input": paths, "the image of --drape": [options["drape"]], "the camera of --view": [options["view_path"]],
         "the camera of --mesh-view": [mesh_view],
         "the grid of --geoid": [options["geoid"]]},
    )  # fmt: skip
    if depth:
        check_ending("--depth", depth)
    source = {k: v for k, v in options.items() if k not in OWN}
    if source["band"] == 1:
        source["band"] = None
    with progress.task("Loading Orograph"):
        from orograph.errors import DamagedChunkError, NothingInViewError
        from orograph.geovis.colour import colour_table
        from orograph.output import Beside, check_folder
        from orograph.picture.backends import draw
        from orograph.picture.memory import check_memory
        from orograph.picture.prepare import cache_folder, prepare
        from orograph.picture.result import picture_format
        from orograph.picture.scene import Scene
        from orograph.view import View

    # What is wrong with the command line is said before any work is done.
    picture_format(Path(output))
    for file in filter(None, (output, depth, save_view)):
        check_folder(Path(file))
    colour_table(options["colormap"])
    if options["title"] is not None and not options["furniture"]:
        progress.warn("--title is drawn with --furniture only.")
    said = ctx.get_parameter_source("max_memory") is not ParameterSource.DEFAULT
    if options["size"] is not None:
        check_memory(options["size"], max_memory if said else None)
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, **source)
    sun = options["sun"].over(terrain.grid)
    view = camera_view(terrain, options)
    check_memory((view.width, view.height), max_memory if said else None)
    seen_by_engine = None if mesh_view is None else View.load(mesh_view, crs=terrain.grid.crs)
    scene = Scene(
        terrain, view, sun, mesh_view=seen_by_engine, water=None if options["water"] == "none" else options["water"],
        max_memory=max_memory, jobs=jobs,
        **{k: options[k] for k in SCENE},
    )  # fmt: skip
    try:
        picture = draw(scene, progress, backend=options["backend"])
    except DamagedChunkError as error:
        if error.path is not None and Path(error.path).parent == cache_folder():
            error.remedy = "It is a copy that was kept: delete it, and the next picture builds it again."
        raise
    except NothingInViewError as error:
        if not any(options[name] is not None for name in PLACES):
            error.remedy = "See what the file holds with orograph info."
        raise
    picture.save(output)
    if depth:
        picture.save_depth(depth)
    if save_view:
        with Beside(Path(save_view)) as part:
            part.write_text(json.dumps(view.to_dict(), indent=2) + "\n", encoding="utf-8")
    seconds = time.perf_counter() - began
    if as_json:
        crs = terrain.grid.crs
        told = {
            "picture": output, "depth": depth, "width": view.width, "height": view.height,
            "seconds_in_all": round(seconds, 3), "crs": crs.to_string() if crs else None,
            "sun": [sun.azimuth, sun.altitude], "view": view.to_dict(),
            **picture.facts,
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
    else:
        stats = picture.facts.get("mesh")
        mesh = f"  {stats['engine']}: {stats['triangles']:,} triangles" if stats else ""
        click.echo(f"{output}  {view.width} × {view.height}{mesh}  {seconds:.1f} s")
