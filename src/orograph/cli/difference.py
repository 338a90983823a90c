"""``orograph difference``: how much higher one DEM is than another of the same place."""

from __future__ import annotations

import json
import time
from typing import Any

import click

from orograph.cli.files import check_outputs
from orograph.cli.options import (
    FILE,
    FloatRange,
    grid_options,
    jobs_option,
    memory_option,
    progress_of,
    source_of,
    source_options,
    vertical_options,
)  # fmt: skip

OWN = ("onto", "resampling", "quantiles", "limit", "sigma", "range", "confidence", "any_vertical")


@click.command("difference")
@click.argument("a")
@click.argument("b")
@click.option(
    "--output", "-o", type=FILE, multiple=True,
    help="The output: .tif, in metres; .png, .jpg or .webp, a picture. Repeat it for both.",
)  # fmt: skip
@click.option(
    "--onto", type=click.Choice(["first", "second", "finer"]), default="first", show_default=True,
    help="Whose samples are kept; the other's heights are interpolated there.",
)  # fmt: skip
@click.option(
    "--resampling", type=click.Choice(["nearest", "bilinear", "cubic"]), default="bilinear", show_default=True,
    help="How they are interpolated.",
)  # fmt: skip
@click.option(
    "--quantiles", metavar="Q[,Q…]", default="0.05,0.25,0.75,0.95", show_default=True,
    help="Which quantiles of the difference to print.",
)  # fmt: skip
@click.option(
    "--limit", type=FloatRange(min=0, min_open=True), metavar="METRES",
    help="For a picture: the difference at both ends of the colours.  [default: a round number that covers 98 %]",
)  # fmt: skip
@click.option(
    "--sigma", multiple=True, metavar="METRES|FILE",
    help="Standard deviation of heights, metres, or a raster of them; twice: of A and of B. Volumes and pictures "
    "are then of significant differences only.",
)  # fmt: skip
@click.option(
    "--range", type=FloatRange(min=0), default=0.0, metavar="METRES",
    help="Distance at which the errors' correlation has dropped to 5 %.  [default: 0, independent]",
)  # fmt: skip
@click.option(
    "--confidence", type=FloatRange(min=0, max=1, min_open=True, max_open=True), default=0.95, show_default=True,
    help="Of what counts as significant.",
)  # fmt: skip
@click.option(
    "--any-vertical",
    is_flag=True,
    help="Accept heights above two vertical datums as they are, instead of refusing them.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the statistics as JSON.")
@grid_options("compare", own_resampling=True)
@source_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, a: str, b: str, output: tuple[str, ...], as_json: bool, max_memory: int, jobs: int | None,
    **options: Any,
) -> None:  # fmt: skip
    """Compute the difference A − B of two DEMs of the same place: after and before, a surface and the ground, two
    products.

    A and B are files, stores, manifests or quoted patterns ("tiles/*.tif"). Where A is higher there is a gain (blue),
    where it is lower a loss (red). It prints mean, median, rms, NMAD (robust standard deviation), quantiles, and the
    volumes of gain and loss by the true area of each cell; with --sigma, of differences beyond the uncertainty.
    Options of reading are for both; --vertical-unit ft,m says that A is in feet and B in metres.

    \b
    Examples:
      orograph difference after.tif before.tif -o change.tif -o change.png
      orograph difference surface.tif ground.tif --onto finer -o heights.tif
      orograph difference copernicus.tif srtm.tif --to-vertical ellipsoidal --geoid egm96_15.gtx
      orograph difference 2016.tif 2012.tif --sigma 0.1 --sigma 0.15 --range 20 -o change.tif
      orograph difference a.tif b.tif --json
    """
    began = time.perf_counter()
    outputs = {f"--output {path}": path for path in output}
    check_outputs(dict(outputs), {"A": [a], "B": [b], "the grid of --geoid": [options["geoid"]]})
    progress = progress_of(ctx)
    with progress.task("Loading Orograph"):
        from orograph.verbs.difference import difference

    own = {name: options[name] for name in OWN}
    own["sigma"] = own["sigma"] or None
    found = difference(
        a, b, output, max_memory=max_memory, jobs=jobs, progress=progress, **own, **source_of(options, OWN)
    )
    if as_json:
        told = {
            "a": found.first, "b": found.second, "seconds_in_all": round(time.perf_counter() - began, 3),
            "shape": list(found.grid.shape), **found.statistics.to_dict(),
        }  # fmt: skip
        click.echo(json.dumps(told, allow_nan=False))
        return
    click.echo(found.name)
    for _, text in found.rows():
        click.echo(f"  {text}")
    for path in output:
        click.echo(path)
