"""``orograph render``: from any DEM or store to a relief picture."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from orograph.cli.files import check_ending, check_outputs
from orograph.cli.options import ParamType, jobs_option, memory_option, progress_of, source_options, vertical_options

if TYPE_CHECKING:
    from orograph.store.terrain import Terrain
    from orograph.view import View


class Numbers(ParamType):
    """Numbers separated by commas, so many of them."""

    def __init__(self, *names: str, optional: int = 0) -> None:
        self.names, self.optional = names, optional
        self.name = ",".join(names)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            numbers = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            numbers = ()
        if not len(self.names) - self.optional <= len(numbers) <= len(self.names):
            self.fail(f"{value!r} is not {self.name}: numbers separated by commas.", param, ctx)
        return numbers


class Size(ParamType):
    """Pixels, WIDTHxHEIGHT."""

    name = "WIDTHxHEIGHT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        parts = str(value).lower().split("x")
        if len(parts) != 2 or not all(p.strip().isdigit() and int(p) > 0 for p in parts):
            self.fail(f"{value!r} is not a size such as 1280x720.", param, ctx)
        return int(parts[0]), int(parts[1])


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


FILE = click.Path(dir_okay=False)

SCENE = ("shadows", "exaggeration", "colormap", "drape", "sky", "relief", "samples", "tolerance", "furniture", "title")
OWN = {*SCENE, "azimuth", "pitch", "distance", "lonlat", "look_at", "view_path", "fov", "projection", "size", "sun",
       "water", "backend"}  # fmt: skip
"""What is said about the picture; all other options are about reading."""

CAMERA = ("azimuth", "pitch", "distance", "lonlat", "look_at", "view_path", "fov")


@click.command("render")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--output", "-o", required=True, type=FILE, help="The picture: .png, .jpg, .webp or .tif.")
@click.option(
    "--from",
    "azimuth",
    type=float,
    metavar="AZIMUTH",
    help="Look from this side, degrees clockwise from north.  [default: 180, the south]",
)
@click.option("--pitch", type=float, metavar="DEG", help="Look down by this angle; 90 is straight down.  [default: 42]")
@click.option(
    "--distance",
    type=float,
    metavar="M",
    help="Metres from the ground in the terrain's middle.  [default: such that all of it is in view]",
)
@click.option(
    "--lonlat", type=Numbers("LON", "LAT", "HEIGHT"), help="Stand here, HEIGHT metres above the heights' own zero."
)
@click.option(
    "--look-at",
    type=Numbers("LON", "LAT"),
    help="With --lonlat: look at the ground here.  [default: the terrain's middle]",
)
@click.option(
    "--view",
    "view_path",
    type=FILE,
    metavar="VIEW.json",
    help='The camera in a file: {"eye": [E, N, height], "target": […], "up": […], "fov_y": 40, "width": …, '
    '"height": …, "near": …, "far": …}, in the terrain\'s CRS, or longitude, latitude and height with '
    '"crs": "EPSG:4326".',
)
@click.option(
    "--fov",
    type=click.FloatRange(0, 180, min_open=True, max_open=True),
    metavar="DEG",
    help="Vertical field of view.  [default: 30; with --lonlat 45; with --view the view's]",
)
@click.option(
    "--projection",
    type=click.Choice(["perspective", "plan"]),
    default="perspective",
    show_default=True,
    help="plan: a map, straight down with parallel rays; --from says which side is at its foot.",
)
@click.option("--size", type=Size(), help="The picture's size in pixels.  [default: 1280x720, or the view's]")
@click.option(
    "--sun",
    type=Numbers("AZ", "ALT"),
    default=(315.0, 45.0),
    help="Where the sun stands: degrees clockwise from north, degrees above the horizon.  [default: 315,45]",
)
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
    "[default: 0 up to 16.8 million samples, else 0.5]",
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
@click.option("--backend", type=click.Choice(["cpu"]), default="cpu", show_default=True, help="What draws.")
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
@source_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, as_json: bool, depth: str | None, save_view: str | None,
    max_memory: int, jobs: int | None, **options: Any,
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
    """
    began = time.perf_counter()
    progress = progress_of(ctx)
    _check_camera(options)
    check_outputs(
        {"--output": output, "--depth": depth, "--save-view": save_view},
        {"the input": paths, "the image of --drape": [options["drape"]], "the camera of --view": [options["view_path"]],
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
        from orograph.picture.cpu import draw
        from orograph.picture.memory import check_memory
        from orograph.picture.prepare import cache_folder, prepare
        from orograph.picture.result import picture_format
        from orograph.picture.scene import Scene, Sun

    # What is wrong with the command line is said before any work is done.
    picture_format(Path(output))
    for file in filter(None, (output, depth, save_view)):
        check_folder(Path(file))
    colour_table(options["colormap"])
    sun = Sun(*options["sun"])
    if options["title"] is not None and not options["furniture"]:
        progress.warn("--title is drawn with --furniture only.")
    said = ctx.get_parameter_source("max_memory") is not ParameterSource.DEFAULT
    if options["size"] is not None:
        check_memory(options["size"], max_memory if said else None)
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, **source)
    view = _view(terrain, options)
    check_memory((view.width, view.height), max_memory if said else None)
    scene = Scene(
        terrain, view, sun, water=None if options["water"] == "none" else options["water"],
        max_memory=max_memory, jobs=jobs,
        **{k: options[k] for k in SCENE},
    )  # fmt: skip
    try:
        picture = draw(scene, progress)
    except DamagedChunkError as error:
        if error.path is not None and Path(error.path).parent == cache_folder():
            error.remedy = "It is a copy that was kept: delete it, and the next picture builds it again."
        raise
    except NothingInViewError as error:
        if not any(options[name] is not None for name in CAMERA):
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
            "seconds_in_all": round(seconds, 3), "crs": crs.to_string() if crs else None, "view": view.to_dict(),
            **picture.facts,
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
    else:
        click.echo(f"{output}  {view.width} × {view.height}  {seconds:.1f} s")


def _check_camera(options: Mapping[str, Any]) -> None:
    """Raise UsageError where the camera options contradict each other."""
    from orograph.errors import UsageError

    oblique = [f"--{k}" for k in ("from", "pitch", "distance") if options["azimuth" if k == "from" else k] is not None]
    if options["look_at"] is not None and options["lonlat"] is None:
        raise UsageError("--look-at needs --lonlat: the place to stand at.")
    if sum([options["view_path"] is not None, bool(oblique), options["lonlat"] is not None]) > 1:
        raise UsageError("Give one camera: --view, or --from, --pitch and --distance, or --lonlat and --look-at.")
    if options["projection"] == "plan":
        wrong = [o for o in oblique if o != "--from"] + (["--lonlat"] if options["lonlat"] is not None else [])
        if wrong:
            raise UsageError(
                f"{wrong[0]} and --projection plan contradict each other: a plan is the whole terrain, straight down.",
                remedy="Turn it with --from, or choose another extent with --view.",
            )


def _view(terrain: Terrain, options: Mapping[str, Any]) -> View:
    """The camera that the options describe (see ``_check_camera``)."""
    from dataclasses import replace

    from orograph.picture import camera
    from orograph.view import View

    def given(name: str, default: float) -> float:
        return default if options[name] is None else float(options[name])

    size = options["size"] or (1280, 720)
    if options["view_path"] is not None:
        view = View.load(options["view_path"], crs=terrain.grid.crs)
        if options["size"] is not None:
            view = view.resized(*size)
        if options["projection"] == "plan":
            view = replace(view, projection="plan")
        return replace(view, fov_y=given("fov", view.fov_y))
    azimuth = given("azimuth", 180.0)
    insets = camera.NO_INSETS
    if options["furniture"]:
        from orograph.picture import furniture

        insets = furniture.insets(size)
    if options["projection"] == "plan":
        return camera.plan(terrain, size, azimuth=azimuth, insets=insets)
    if options["lonlat"] is not None:
        return camera.standing(terrain, size, options["lonlat"], options["look_at"], fov_y=given("fov", 45.0))
    return camera.around(
        terrain, size, azimuth=azimuth, pitch=given("pitch", 42.0), distance=options["distance"],
        fov_y=given("fov", 30.0), exaggeration=options["exaggeration"], insets=insets,
    )  # fmt: skip
