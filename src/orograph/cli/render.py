"""``orograph render``: from any DEM or store to a relief picture."""

from __future__ import annotations

import json
import time
from typing import Any

import click

from orograph.cli.options import jobs_option, memory_option, progress_of, source_options


class Numbers(click.ParamType):  # type: ignore[type-arg]
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


class Size(click.ParamType):  # type: ignore[type-arg]
    """Pixels, WIDTHxHEIGHT."""

    name = "WIDTHxHEIGHT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        parts = str(value).lower().split("x")
        if len(parts) != 2 or not all(p.strip().isdigit() and int(p) > 0 for p in parts):
            self.fail(f"{value!r} is not a size such as 1280x720.", param, ctx)
        return int(parts[0]), int(parts[1])


class Water(click.ParamType):  # type: ignore[type-arg]
    """auto, none, or a level in metres."""

    name = "auto|none|METRES"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | float:
        if isinstance(value, float) or value in ("auto", "none"):
            return value  # type: ignore[no-any-return]
        try:
            return float(value)
        except ValueError:
            self.fail(f"{value!r} is neither auto, none nor a level in metres.", param, ctx)


@click.command("render")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--output", "-o", required=True, type=click.Path(dir_okay=False), help="The picture: .png, .jpg, .webp, .tif.")
@click.option("--view", "view_path", type=click.Path(dir_okay=False), metavar="VIEW.json",
              help='Camera: {"eye": [E, N, height], "target": […], "up": […], "fov_y": 40, "width": …, "height": …, '
              '"near": …, "far": …} in the terrain\'s CRS, or with "crs": "EPSG:4326" as longitude, latitude, height.')
@click.option("--from", "azimuth", type=float, metavar="AZIMUTH", help="Look from this side: degrees clockwise from north.  [default: 180]")
@click.option("--pitch", type=float, metavar="DEG", help="Look down by this angle.  [default: 42]")
@click.option("--distance", type=float, metavar="M", help="Metres to the middle of the terrain.  [default: all of it in view]")
@click.option("--lonlat", type=Numbers("LON", "LAT", "HEIGHT"), help="Stand at this place, height in metres above the datum.")
@click.option("--look-at", type=Numbers("LON", "LAT"), help="Look at the ground of this place.  [default: the middle]")
@click.option("--fov", type=float, metavar="DEG", help="Vertical field of view.  [default: 30, or 45 with --lonlat]")
@click.option("--projection", type=click.Choice(["perspective", "plan"]), default="perspective", show_default=True,
              help="plan: a map, straight down, north up.")
@click.option("--size", type=Size(), default=None, help="Pixels.  [default: 1280x720, or the view's]")
@click.option("--sun", type=Numbers("AZ", "ALT"), default=(315.0, 45.0), show_default="315,45",
              help="Where the sun stands: degrees clockwise from north, and above the horizon.")
@click.option("--shadows/--no-shadows", default=True, show_default=True, help="Cast shadows.")
@click.option("--exaggeration", type=float, default=1.0, show_default=True, metavar="X", help="Stretch heights in the picture.")
@click.option("--relief", type=float, metavar="X", help="Strengthen slopes for shading only; 1 is nature.  [default: by scale]")
@click.option("--colormap", metavar="NAME", help="Colour of heights: any name of the cmap catalogue, or a built-in tint (alpine, mars, grey).  [default: alpine]")
@click.option("--drape", type=click.Path(), metavar="IMAGE", help="Lay this image over the ground; any CRS.")
@click.option("--water", type=Water(), default="auto", show_default=True, help="Draw level ground as water, or all below a level.")
@click.option("--sky", is_flag=True, help="Draw sky and haze instead of paper.")
@click.option("--furniture", is_flag=True, help="Add title, colour bar, north arrow and scale bar.")
@click.option("--title", help="Title (with --furniture).  [default: the file's name]")
@click.option("--samples", type=click.IntRange(1, 1024), default=4, show_default=True, help="Rays per pixel at edges.")
@click.option("--tolerance", type=float, metavar="PX", help="Pixels by which a large terrain may be simplified; 0 draws every sample.  [default: 0 up to 16.8 million samples, else 0.5]")
@click.option("--depth", type=click.Path(dir_okay=False), metavar="OUT.tif", help="Also write view-space depth: float32 metres, NaN where nothing is hit.")
@click.option("--save-view", type=click.Path(dir_okay=False), metavar="VIEW.json", help="Also write the camera that was used.")
@click.option("--crs", help="Projected CRS to draw in.  [default: the file's own, or its UTM zone]")
@click.option("--resolution", type=float, metavar="METRES", help="Distance between samples.  [default: as the files]")
@click.option("--backend", type=click.Choice(["cpu"]), default="cpu", show_default=True, help="Who draws.")
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
@source_options
@memory_option
@jobs_option
@click.pass_context
def command(ctx: click.Context, /, paths: tuple[str, ...], output: str, as_json: bool, depth: str | None, save_view: str | None,
            max_memory: int, jobs: int | None, **options: Any) -> None:
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
    reading = ("band", "nodata", "spacing", "assume_crs", "encoding", "vertical_unit", "crs", "resolution")
    source = {k: options.pop(k) for k in reading}
    if source["band"] == 1:
        source["band"] = None
    with progress.task("Loading Orograph"):
        from orograph.picture.cpu import draw
        from orograph.picture.prepare import prepare
        from orograph.picture.scene import Scene, Sun

    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, **source)
    view = _view(terrain, options)
    water = None if options["water"] == "none" else options["water"]
    scene = Scene(
        terrain, view, Sun(*options["sun"]), shadows=options["shadows"], exaggeration=options["exaggeration"],
        colormap=options["colormap"], drape=options["drape"], sky=options["sky"], water=water, relief=options["relief"], samples=options["samples"],
        tolerance=options["tolerance"], furniture=options["furniture"], title=options["title"], max_memory=max_memory, jobs=jobs,
    )  # fmt: skip
    picture = draw(scene, progress)
    picture.save(output)
    if depth:
        picture.save_depth(depth)
    if save_view:
        from pathlib import Path

        Path(save_view).write_text(json.dumps(view.to_dict(), indent=2) + "\n", encoding="utf-8")
    seconds = time.perf_counter() - began
    if as_json:
        crs = terrain.grid.crs
        click.echo(json.dumps({
            "picture": output, "depth": depth, "width": view.width, "height": view.height, "seconds": round(seconds, 3),
            "view": view.to_dict(), "crs": crs.to_string() if crs else None, **picture.facts,
        }, allow_nan=False))  # fmt: skip
    else:
        click.echo(f"{output}  {view.width} × {view.height}  {seconds:.1f} s")


def _view(terrain: Any, options: dict[str, Any]) -> Any:
    """The camera that the options describe."""
    from dataclasses import replace

    from orograph.errors import UsageError
    from orograph.picture import camera
    from orograph.view import View

    oblique = {k: options[k] for k in ("azimuth", "pitch", "distance") if options[k] is not None}
    standing = options["lonlat"] is not None
    if options["look_at"] is not None and not standing:
        raise UsageError("--look-at needs --lonlat: the place to stand at.")
    if sum([options["view_path"] is not None, bool(oblique), standing]) > 1:
        raise UsageError("Give one camera: --view, or --from/--pitch/--distance, or --lonlat/--look-at.")
    size = options["size"] or (1280, 720)
    fov = options["fov"]
    if options["view_path"] is not None:
        view = View.load(options["view_path"], crs=terrain.grid.crs)
        if options["size"]:
            view = view.resized(*size)
        if fov:
            view = replace(view, fov_y=fov)
        if options["projection"] == "plan":
            view = replace(view, projection="plan")
        return view
    if options["projection"] == "plan" and not standing and not oblique:
        return camera.plan(terrain, size)
    if standing:
        view = camera.standing(terrain, size, options["lonlat"], options["look_at"], fov_y=fov or 45.0)
    else:
        view = camera.around(
            terrain, size, azimuth=oblique.get("azimuth", 180.0), pitch=oblique.get("pitch", 42.0),
            distance=oblique.get("distance"), fov_y=fov or 30.0, exaggeration=options["exaggeration"],
        )  # fmt: skip
    return replace(view, projection=options["projection"])
