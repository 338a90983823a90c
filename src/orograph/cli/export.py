"""``orograph export``: write heights of a store or a DEM, or data as they lie on it, for other tools."""

from __future__ import annotations

from typing import Any

import click

from orograph.cli.files import check_outputs
from orograph.cli.memory import megabytes
from orograph.cli.options import (
    FILE,
    grid_options,
    jobs_option,
    memory_option,
    progress_of,
    source_of,
    source_options,
    vertical_options,
)  # fmt: skip
from orograph.cli.scenes import scene_option, uncertainty_option

DATA = (
    "Write these data instead of heights; several rasters become bands. Keys as for orograph render: variable, band, "
    "time, member, value (median, min, max, spread, p90), exceeds, layer, geometry, unit, name."
)


@click.command("export")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "-o",
    "--output",
    required=True,
    type=FILE,
    help="The file to write: .tif; for data also .nc, .csv, .geojson, .gpkg.",
)
@scene_option("data", help=DATA)
@uncertainty_option
@grid_options("write")
@click.option("--overwrite", is_flag=True, help="Replace a file that is there.")
@source_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, data: tuple[Any, ...],
    bbox: tuple[float, float, float, float] | None, overwrite: bool, max_memory: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Write the heights of a store, or of DEM files as Orograph reads them, as a Cloud Optimized GeoTIFF.

    Heights are metres at full resolution, on the terrain's own grid, NaN where there is none; the file's CRS includes
    the vertical datum if it is known. With --data, the data are written instead: values and uncertainty of rasters at
    the terrain's samples, or points with the height of the ground.

    \b
    Examples:
      orograph export area.oro -o area.tif
      orograph export area.oro -o valley.tif --bbox 7.5,45.9,7.8,46.1
      orograph export tiles/*.tif -o mosaic.tif --crs EPSG:32632 --resolution 30 --resampling cubic
      orograph export area.oro -o warm.nc --data era5.grib,time=T12,exceeds=15
      orograph export area.oro -o quakes.gpkg --data quakes.geojson,variable=mag
    """
    check_outputs(
        {"--output": output},
        {
            "the input": paths,
            "the data of --data": [str(one.source) for one in data],
            "the grid of --geoid": [options["geoid"]],
        },
    )
    progress = progress_of(ctx)
    with progress.task("Loading Orograph"):
        from orograph.store.prepare import prepare
        from orograph.verbs.export import check_output, export

    path = check_output(output, overwrite, data)
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, **source_of(options, ()))
    export(
        terrain, path, data=data, bbox=bbox, overwrite=overwrite, max_memory=max_memory, jobs=jobs, progress=progress
    )
    click.echo(f"{path}  {megabytes(path.stat().st_size)}")
