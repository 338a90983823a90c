"""``orograph measure``: pick, profile, area, line of sight, viewshed and probabilities, on the true surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from orograph.cli.camera import CAMERA, camera_options, camera_view, check_camera
from orograph.cli.files import TIFF
from orograph.cli.measure_probable import check_files, contours, error_options, flood, height_error, slope
from orograph.cli.measure_probable import viewshed as probable_viewshed
from orograph.cli.measuring import (
    POINTS,
    Measure,
    Point,
    check_points,
    kinds,
    of_terrain,
    on_terrain,
    opened,
    output_option,
    points_option,
    sight_options,
    tell,
    without,
)
from orograph.cli.options import FILE, Float, FloatRange, progress_of
from orograph.cli.scenes import scene_option
from orograph.errors import UsageError


class Measures(click.Group):
    """The measures in the order of their use, and the error message for an unknown one."""

    command_class = Measure

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in self.commands:
            known, first = ", ".join(self.commands), args[0]
            if args[0].startswith("-"):
                ctx.fail(f"First name what to measure, then the options: one of {known}.")
            turned = next((name for name in args[1:] if name in self.commands), None)
            if turned is not None:
                ctx.fail(f"What to measure comes first: orograph measure {turned} {first} …")
            ctx.fail(f"There is no measure {first!r}; the measures are {known}.")
        return super().resolve_command(ctx, args)


@click.group("measure", cls=Measures, context_settings=POINTS)
def command() -> None:
    """Measure on the surface of a DEM or a store: at full resolution, in true metres.

    Points are E,N (easting, northing in the terrain's CRS, metres) or, with --lonlat, LON,LAT in degrees. Lengths and
    areas are corrected for the distortion of the map projection and for the height above the ellipsoid; their values on
    the grid are also shown.

    \b
    Examples:
      orograph measure pick dem.tif 512000,4180000
      orograph measure profile dem.tif --lonlat -71.38,44.22 -71.30,44.27 -o profile.png
      orograph measure area dem.tif --geojson lake.geojson --level 850
      orograph measure los dem.tif 512000,4180000 515000,4182000 --eye 1.7 -o sight.png
      orograph measure viewshed area.oro 512000,4180000 -o seen.tif --picture seen.png
      orograph measure viewshed area.oro 512000,4180000 --sigma 4 --range 150 -o probable.tif
      orograph measure flood coast.tif 512000,4180000 --level 2.5 --sigma 0.5 --range 300 -o flood.tif
    """


@command.command("pick", context_settings=POINTS, short_help="Height, coordinates, slope and aspect of points.")
@of_terrain
@click.argument("points", nargs=-1, type=Point(), metavar="[POINT]...")
@click.option("--pixel", "pixels", type=Point(), multiple=True, metavar="X,Y",
              help="The ground at a pixel of the picture that orograph render draws with this camera; 0,0 is its upper "
              "left corner.")  # fmt: skip
@without("lonlat", "look_at")
@camera_options
@scene_option("exaggeration", help="Exaggeration of the heights in the picture.")
@output_option("A table (.csv) or points (.geojson); may be repeated.")
@points_option
@click.pass_context
def pick(
    ctx: click.Context, /, points: tuple[tuple[float, ...], ...], pixels: tuple[tuple[float, ...], ...],
    outputs: tuple[str, ...], degrees: bool, as_json: bool, **camera: Any,
) -> None:  # fmt: skip
    """Height, coordinates, slope and aspect of the ground at points, or under pixels of a picture.

    Slope and aspect (the azimuth in which the ground falls, clockwise from north) are those of the ground between its
    samples, as in orograph light. A pixel's ray is cast against the full-resolution surface. For a picture with
    --furniture the camera is the view that render --json prints: save it as VIEW.json.
    """
    if not points and not pixels:
        raise UsageError("Give a point, or a pixel with --pixel.")
    camera = {**camera, "lonlat": None, "look_at": None}
    check_camera({k: camera[k] for k in CAMERA})
    kinds(outputs, False, (".csv", ".geojson"))
    terrain = opened(ctx, outputs)
    from orograph import measuring

    places = measuring.Places(terrain)
    hits = [measuring.place(terrain, p) for p in on_terrain(places, points, degrees)] if points else []
    if pixels:
        from orograph.scene.parts import check_exaggeration

        check_exaggeration(camera["exaggeration"])
        view = camera_view(terrain, camera)
        for x, y in pixels:
            found = measuring.pick(terrain, view, (x, y), camera["exaggeration"])
            if found is None:
                raise UsageError(f"There is no ground at pixel {x:g},{y:g}: sky, or no data.")
            hits.append(found)
    for path in outputs:
        measuring.save_hits(hits, path)
    tell(ctx, terrain, {"places": [hit.to_dict() for hit in hits]}, hits, as_json, outputs)


@command.command("profile", context_settings=POINTS, short_help="Lengths, climb and descent along a line.")
@of_terrain
@click.argument("points", nargs=-1, type=Point(), metavar="POINT POINT...")
@click.option("--geojson", type=FILE, metavar="FILE", help="The line in a GeoJSON file, instead of points.")
@click.option(
    "--every", type=Float(), metavar="M", help="Distance between rows of the table.  [default: a row at every edge]"
)
@output_option("A table (.csv), the line (.geojson) or a plot (.png, .svg, .pdf); may be repeated.")
@points_option
@click.pass_context
def profile(
    ctx: click.Context, /, points: tuple[tuple[float, ...], ...], geojson: str | None, every: float | None,
    outputs: tuple[str, ...], degrees: bool, as_json: bool,
) -> None:  # fmt: skip
    """Lengths along the ground, straight and on the ellipsoid, climb and descent, and the profile."""
    if geojson is None:
        check_points(points, 2, "A profile")
    elif points:
        raise UsageError("Give the line as points or with --geojson, not both.")
    kinds(outputs, True, (".csv", ".geojson"))
    if every is not None and not every > 0:
        raise UsageError(f"--every must be a positive number of metres, not {every:g}.")
    terrain = opened(ctx, outputs)
    from orograph import measuring

    places = measuring.Places(terrain)
    if geojson is None:
        line = on_terrain(places, points, degrees)
    else:
        from orograph.measuring.geojson import read_geojson

        line = read_geojson(geojson, "LineString", places)[0]
    with progress_of(ctx).task("Measuring"):
        found = measuring.profile(terrain, line)
        for path in outputs:
            found.save(path, every)
    tell(ctx, terrain, found.to_dict(), [found], as_json, outputs)


@command.command("area", context_settings=POINTS)
@of_terrain
@click.argument("points", nargs=-1, type=Point(), metavar="POINT POINT POINT...")
@click.option("--geojson", type=FILE, metavar="FILE",
              help="Polygons in a GeoJSON file, each of which is measured; they may have holes.")  # fmt: skip
@click.option(
    "--level", type=Float(), metavar="M", help="Also measure the volumes of ground above and space below this height."
)
@click.option("--steeper-than", type=FloatRange(min=0, max=90, max_open=True), default=30.0, show_default=True,
              metavar="DEG", help="Slope above which the share of samples is found.")  # fmt: skip
@output_option("A table with a row for each polygon (.csv, .json), or these polygons (.geojson); may be repeated.")
@points_option
@click.pass_context
def area(
    ctx: click.Context, /, points: tuple[tuple[float, ...], ...], geojson: str | None, level: float | None,
    steeper_than: float, outputs: tuple[str, ...], degrees: bool, as_json: bool,
) -> None:  # fmt: skip
    """Areas of polygons in plan and of the surface in them, and the heights and slopes of the samples in them.

    Slopes are those between samples, in true metres, as in orograph measure pick.
    """
    if geojson is None:
        check_points(points, 3, "A polygon")
    elif points:
        raise UsageError("Give the polygon as points or with --geojson, not both.")
    terrain = opened(ctx, outputs)
    from orograph import measuring
    from orograph.measuring.text import zone_rows
    from orograph.measuring.zones import check_zones_file

    for path in outputs:
        check_zones_file(path)
    zones: Any = geojson or on_terrain(measuring.Places(terrain), points, degrees)
    found = measuring.areas(
        terrain, zones, level=level, steeper_than=steeper_than, jobs=ctx.obj["jobs"], progress=progress_of(ctx)
    )
    for path in outputs:
        found.save(path)
    one = len(found) == 1
    told = found[0].to_dict() if one else {"areas": found.rows()}
    rows = [row for zone in found for row in ([] if one else [("", "", ""), (zone.name, "", "")]) + zone_rows(zone)]
    tell(ctx, terrain, told, rows, as_json, outputs)


@command.command("los", context_settings=POINTS)
@of_terrain
@click.argument("points", nargs=-1, type=Point(), metavar="FROM TO")
@sight_options
@output_option("A plot (.png, .svg, .pdf) or the ground under it as a table (.csv).")
@points_option
@click.pass_context
def los(
    ctx: click.Context, /, points: tuple[tuple[float, ...], ...], eye: float, target: float, flat: bool,
    refraction: float, outputs: tuple[str, ...], degrees: bool, as_json: bool,
) -> None:  # fmt: skip
    """Whether one point is visible from another, and what is in the way."""
    check_points(points, 2, "A line of sight", 2)
    kinds(outputs, True)
    terrain = opened(ctx, outputs)
    from orograph import measuring

    ends = on_terrain(measuring.Places(terrain), points, degrees)
    with progress_of(ctx).task("Looking"):
        found = measuring.line_of_sight(terrain, ends[0], ends[1], eye, target, flat=flat, refraction=refraction)
        for path in outputs:
            found.save(path)
    tell(ctx, terrain, found.to_dict(), [found], as_json, outputs)


@command.command("viewshed", context_settings=POINTS, short_help="What part of the terrain is visible from a point.")
@of_terrain
@click.argument("points", nargs=-1, type=Point(), metavar="POINT")
@sight_options
@click.option(
    "--radius", type=Float(), metavar="M", help="How far to look, true metres.  [default: all of the terrain]"
)
@click.option(
    "--heights", is_flag=True, help="Write how high a target must be to be visible, instead of 1 (visible) and 0."
)
@error_options
@click.option("--output", "-o", type=FILE, metavar="OUT", help="The Cloud Optimized GeoTIFF (.tif), or the visible "
              "ground as polygons (.gpkg, .geojson, .shp, .parquet, .fgb), to write.")  # fmt: skip
@click.option("--picture", type=FILE, metavar="OUT.png", help="A relief picture with the visible ground painted.")
@without("lonlat", "look_at")
@camera_options
@points_option
@click.pass_context
def viewshed(
    ctx: click.Context, /, points: tuple[tuple[float, ...], ...], eye: float, target: float, flat: bool,
    refraction: float, radius: float | None, heights: bool, sigma: str | None, reach: float, horizontal: float,
    checks: str | None, check_sigma: float, draws: int, seed: int, output: str | None, picture: str | None,
    degrees: bool, as_json: bool, **camera: Any,
) -> None:  # fmt: skip
    """What part of the terrain is visible from a point, sample by sample; as a raster, or painted on a picture.

    Each sample has its own line of sight over the full-resolution surface. What does not fit in a third of --max-memory
    goes to a scratch file in the temporary folder. With --sigma (or --horizontal) heights are uncertain, and the result
    is the probability that a sample is visible.
    """
    check_points(points, 1, "A viewshed", 1)
    uncertain = sigma is not None or horizontal > 0
    if output is not None and not uncertain:
        from pyproj import CRS

        from orograph.geo.vector_files import ENDINGS
        from orograph.measuring.viewshed_polygons import check_polygons

        check_polygons(Path(output), heights, CRS.from_epsg(4326))  # (that of the terrain is not known yet)
        camera = check_files(output, picture, camera, (*TIFF, *ENDINGS))
    else:
        camera = check_files(output, picture, camera)
    error = height_error(sigma, reach, horizontal, checks, check_sigma)
    if uncertain and heights:
        raise UsageError("--heights and --sigma contradict each other: uncertain heights give a probability.")
    outputs = () if output is None else (output,)
    terrain = opened(ctx, outputs, (picture,))
    from orograph import measuring
    from orograph.cli.painting import painted

    progress = progress_of(ctx)
    place = on_terrain(measuring.Places(terrain), points, degrees)[0]
    if uncertain:
        probable_viewshed(
            ctx, terrain, place, error, draws, seed, output, picture, camera, as_json, eye=eye,
            target=target, radius=radius, flat=flat, refraction=refraction,
        )  # fmt: skip
        return
    shed = measuring.viewshed(
        terrain, place, eye, target, radius=radius, flat=flat, refraction=refraction, heights=heights,
        max_memory=ctx.obj["max_memory"], jobs=ctx.obj["jobs"], progress=progress,
    )  # fmt: skip
    told: dict[str, Any] = {"point": list(shed.point), "ground_m": shed.ground, "eye_m": eye, "target_m": target,
                            "radius_m": radius, "bend_per_m": shed.bend, "shape": list(shed.grid.shape)}  # fmt: skip
    if output is not None:
        told |= shed.save(output, progress)
    if picture is not None:
        summary = painted(terrain, shed, camera, picture, progress, ctx.obj["max_memory"], ctx.obj["jobs"])
        told |= summary
    east, north = shed.point
    lines = [
        ("from", f"{east:.2f}, {north:.2f}, ground {shed.ground:,.2f} m, eye {eye:,.2f} m above", ""),
        ("seen", f"{told['seen']:,} of {told['samples']:,} samples ({told['seen_fraction']:.1%})", ""),
    ]  # fmt: skip
    tell(ctx, terrain, told, lines, as_json, tuple(filter(None, (output, picture))))


for measure in (slope, contours, flood):
    command.add_command(measure)
