"""``orograph synth``: make a fractal terrain of any size."""

from __future__ import annotations

from pathlib import Path

import click

from orograph.cli.files import check_ending
from orograph.cli.options import Float, FloatRange, jobs_option, progress_of
from orograph.errors import UsageError


@click.command("synth")
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), required=True, help="The GeoTIFF to write."
)
@click.option(
    "--size", default="1025", show_default=True, metavar="N|ROWSxCOLS", help="Samples: of a side, or rows × columns."
)
@click.option("--seed", type=int, default=1, show_default=True, help="Which terrain: another number, another world.")
@click.option("--spacing", type=Float(), default=30.0, show_default=True, help="Metres between samples.")
@click.option("--crs", default="EPSG:32633", show_default=True, help="A projected CRS.")
@click.option(
    "--relief",
    type=Float(),
    help="Metres from the lowest to the highest place.  [default: 6 % of the side, at most 2500]",
)
@click.option(
    "--roughness",
    type=FloatRange(0, 3),
    default=1.0,
    show_default=True,
    help="Depth of the finer furrows: 0 smooth, 1 natural.",
)
@click.option(
    "--compress",
    type=click.Choice(["zstd", "deflate", "none"]),
    default="zstd",
    show_default=True,
    help="Compression of the file: zstd takes a third of the space of none, and is read half as fast from memory.",
)
@click.option("--overwrite", is_flag=True, help="Replace a file that is there.")
@jobs_option
@click.pass_context
def command(
    ctx: click.Context,
    output: Path,
    size: str,
    seed: int,
    spacing: float,
    crs: str,
    relief: float | None,
    roughness: float,
    compress: str,
    overwrite: bool,
    jobs: int | None,
) -> None:
    """Make a fractal terrain of any size: plains, and ranges carved by rivers.

    The same seed and size give the same file to the byte, whatever the number of jobs. The terrain is written in
    blocks, so any size works in some hundred MiB of memory; the file appears under its name only when it is whole.

    \b
    Examples:
      orograph synth -o hills.tif                              1025 × 1025 samples, 31 km a side
      orograph synth -o large.tif --size 16385 --seed 7        1 GiB: 35 s on two processors
      orograph synth -o strip.tif --size 2049x8193 --relief 800 --spacing 10
    """
    check_ending("--output", str(output))
    if output.exists() and not overwrite:
        raise UsageError("Something is there already.", path=output, remedy="Replace it with --overwrite.")
    from orograph.dem.synth import Synth, parse_size
    from orograph.dem.target import parse_crs

    terrain = Synth(parse_size(size), seed, spacing=spacing, crs=parse_crs(crs), relief=relief, roughness=roughness)
    terrain.write(output, compress=compress, jobs=jobs, progress=progress_of(ctx))
    rows, cols = terrain.grid.shape
    click.echo(f"{output}: {rows} × {cols} samples, {spacing:g} m apart, seed {seed}")
