"""``orograph light``: make maps of light on a terrain, as GeoTIFFs."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import click

from orograph.cli.files import check_ending, check_outputs
from orograph.cli.options import (
    FILE,
    Numbers,
    grid_options,
    jobs_option,
    memory_option,
    progress_of,
    source_of,
    source_options,
    vertical_options,
)
from orograph.cli.products import (
    Names,
    check_used,
    horizon_options,
    insolation_options,
    more_of,
    once,
    ray_options,
)
from orograph.cli.scenes import scene_option
from orograph.cli.sections import Verb
from orograph.scene import given

OWN = (
    "products", "azimuths", "radius", "sun", "lights", "curvature", "refraction", "exaggeration", "rays", "rho",
    "method", "cones", "date", "step", "turbidity", "byte",
)  # fmt: skip
"""The options about light; all other options are about reading."""


@click.command("light", cls=Verb, short_help="Make maps of light: slope, hillshade, horizons, sky, openness…")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "--product",
    "products",
    type=Names(),
    required=True,
    multiple=True,
    metavar="NAME",
    help="What to make (see above); several (with commas, or repeated) become bands of one file.",
)
@click.option(
    "--output", "-o", required=True, type=FILE, metavar="OUT.tif", help="The Cloud Optimized GeoTIFF to write."
)
@horizon_options
@scene_option("sun")
@click.option(
    "--light",
    "lights",
    type=Numbers("AZ,ALT,WEIGHT", 1),
    multiple=True,
    help="One of several lights of a hillshade, in place of --sun: degrees, and its weight in the mean (default 1); "
    "repeat it for each.",
)
@scene_option("exaggeration", help="Stretch heights, for hillshade only.")
@ray_options(
    ["horizon", "rays", "shadow-maps", "cone-tracing"],
    method="Method for ambient occlusion (the last two on the GPU) and apertures (the first two).  [default: horizon]",
    rays="Rays per sample by Monte Carlo; directions of shadow maps.",
)
@click.option(
    "--cones", type=click.IntRange(min=3), help="For cone tracing: about how many cones per sample.  [default: 64]"
)
@insolation_options
@click.option("--byte", is_flag=True, help="Write 8-bit values for display, instead of float32 in physical units.")
@grid_options("work")
@click.option(
    "--resume",
    is_flag=True,
    help="Keep finished work in OUT.tif.partial, and go on from there after an interruption.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@source_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, as_json: bool, max_memory: int, jobs: int | None,
    resume: bool, **options: Any,
) -> None:  # fmt: skip
    """Make maps of light on a terrain (DEM files or a store): a GeoTIFF on its metric grid, in physical units.

    \b
    normal               unit normals: east, north, up
    slope, aspect        degrees; the azimuth in which the ground falls
    hillshade            cosine of the angle between light and normal (--sun, --light)
    horizon              its elevation in degrees, one band per azimuth
    sky-view-factor      share of the sky's light that falls on inclined ground (Dozier & Frew 1990)
    sky-view-horizontal  the same of a horizontal surface
    visible-sky          share of the hemisphere's solid angle that is sky
    openness             mean zenith angle of the horizon (Yokoyama et al. 2002)
    openness-negative    mean nadir angle, under the ground
    ambient-occlusion    share of ambient light that reaches the ground (--radius, --rho, --by)
    aperture             the sky that is seen as one cap: its direction (east, north, up) and radius
    shadow               the part of the sun's disc that is seen (--sun), and a code
    insolation           energy of sun and sky, Wh/m² (--date)
    sunshine             hours of direct sun (--date)

    A large DEM is built into a store first, which is kept. Memory stays within --max-memory, whatever the size; what
    does not fit goes to a scratch file in the temporary folder. The result depends neither on it nor on --jobs.

    \b
    Examples:
      orograph light dem.tif --product sky-view-factor -o sky.tif
      orograph light dem.tif --product slope,aspect -o ground.tif
      orograph light dem.tif --product hillshade --light 315,45,2 --light 225,30 -o shade.tif --byte
      orograph light area.oro --product openness --azimuths 8 --radius 500 -o openness.tif
      orograph light dem.tif --product shadow --sun 2026-12-21T08:00-08:00 -o shadow.tif
      orograph light dem.tif --product insolation --date 2026 --azimuths 64 -o year.tif
      orograph light dem.tif --product sunshine --date 2026-10-15 --azimuths 64 -o hours.tif
    """
    began = time.perf_counter()
    progress = progress_of(ctx)
    check_outputs({"--output": output}, {"the input": paths, "the grid of --geoid": [options["geoid"]]})
    check_ending("--output", output)
    source = source_of(options, OWN)
    with progress.task("Loading Orograph"):
        from orograph.lighting.context import Options, weighted
        from orograph.lighting.maps import write_map
        from orograph.lighting.products import product
        from orograph.lighting.sun import Sun
        from orograph.output import check_folder
        from orograph.store.prepare import prepare

    # Report errors of the command line before any work is done.
    check_folder(Path(output))
    wanted = once(options["products"])
    products = [product(name) for name in wanted]
    check_used(ctx, wanted)
    lights = weighted(options["lights"])
    common = {k: options[k] for k in ("azimuths", "radius", "curvature", "refraction", "exaggeration", "rays")}
    more = more_of(options)
    asked = Options(**common, lights=lights, more=more)
    for each in products:
        each.check(asked)
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, **source)
    place = given.sun(options["sun"], terrain) if {"hillshade", "shadow"} & set(wanted) else Sun()
    if place.altitude < -place.diameter / 2:
        progress.warn(
            f"the sun is {round(-place.altitude, 1):g}° below the horizon: no light of it falls on the ground."
        )
    chosen = Options(**common, sun=(place.azimuth, place.altitude), lights=lights, more=more)
    try:
        bands = write_map(
            output, terrain, wanted, chosen, place, byte=options["byte"], resume=resume, jobs=jobs,
            max_memory=max_memory, progress=progress,
        )  # fmt: skip
    except KeyboardInterrupt as stopped:
        for note in getattr(stopped, "__notes__", ()):
            click.echo(f"\n{note}", err=True)
        raise
    seconds = time.perf_counter() - began
    rows, cols = terrain.grid.shape
    if as_json:
        from orograph.cli.memory import peak_memory

        crs = terrain.grid.crs
        told = {
            "output": output, "products": wanted, "bands": [{"name": b.name, "unit": b.unit} for b in bands],
            "shape": [rows, cols], "crs": crs.to_string() if crs else None, "sun": list(chosen.sun),
            "seconds": round(seconds, 3), "peak_memory_bytes": peak_memory(),
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
    else:
        click.echo(f"{output}  {', '.join(wanted)}  {cols} × {rows} samples  {seconds:.1f} s")
