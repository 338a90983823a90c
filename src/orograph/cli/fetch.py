"""``orograph fetch``: fetch open elevation models by place."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.options import (
    FILE,
    FloatRange,
    Numbers,
    ParamType,
    jobs_option,
    memory_option,
    progress_of,
    vertical_options,
    with_options,
)
from orograph.errors import ReadError, UsageError
from orograph.folders import parse_bytes

if TYPE_CHECKING:
    from orograph.fetching.products import Product
    from orograph.fetching.request import Request


class Most(ParamType):
    """An amount of data, or "none"."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int | None:
        if not isinstance(value, str):
            return value  # type: ignore[no-any-return]
        try:
            return None if value.lower() == "none" else parse_bytes(value)
        except ValueError as error:
            self.fail(f"{error}.", param, ctx)


def _options(function: Any) -> Any:
    return with_options(
        function,
        click.option(
            "--bbox", type=Numbers("W,S,E,N"), help="The area, in degrees; W > E lies across the 180th meridian."
        ),
        click.option("--at", type=Numbers("LON,LAT"), help="The middle of the area, with --radius."),
        click.option("--radius", type=FloatRange(min=0, min_open=True), metavar="METRES", help="Around --at."),
        click.option("--geojson", type=FILE, help="A GeoJSON file: the box around it."),
        click.option(
            "--product",
            default="copernicus-30",
            show_default=True,
            metavar="NAME",
            help="Which elevation model (see --products).",
        ),
        click.option("-o", "--output", type=click.Path(), help="What to write: a GeoTIFF (.tif) or a store (.oro)."),
        click.option("--zoom", type=click.IntRange(0), help="Zoom level of tiles z/x/y.  [default: the product's]"),
        click.option(
            "--absent",
            type=click.Choice(["sea", "missing"]),
            help="What absent tiles stand for: 0 m, or missing.  [default: as the product says]",
        ),
        click.option(
            "--table",
            type=FILE,
            envvar="OROGRAPH_PRODUCTS",
            show_envvar=True,
            help="A file of more products, or of changes to these (TOML, JSON).",
        ),
        click.option("--products", "list_products", is_flag=True, help="List the products and exit."),
        click.option(
            "--try-products",
            is_flag=True,
            help="Ask the server of every product (or of --product) for a tile that it must have, and exit.",
        ),
        click.option(
            "--most",
            type=Most(),
            default="1GiB",
            show_default=True,
            metavar="SIZE|none",
            help="Maximum amount of heights to read.",
        ),
        click.option("--yes", is_flag=True, help="Read however much it is: same as --most none."),
        click.option(
            "--connections", type=click.IntRange(1, 16), default=4, show_default=True, help="Simultaneous requests."
        ),
        click.option("--overwrite", is_flag=True, help="Replace an existing file or store."),
        click.option("--resume", is_flag=True, help="Finish an interrupted store."),
        click.option("--json", "as_json", is_flag=True, help="Print the result as JSON."),
    )


@click.command("fetch")
@_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, output: str | None, list_products: bool, try_products: bool, as_json: bool, overwrite: bool,
    resume: bool, max_memory: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Fetch open elevation models by place: Copernicus, SRTM, 3DEP, Mars, the Moon…

    Reads only what the area needs, from tiles in public storage. What was read is kept in the cache folder: an
    interrupted run can be continued, and the same area needs no network again. The credit goes into the file, and from
    there into pictures.

    \b
    Examples:
      orograph fetch --bbox 7.5,45.9,7.8,46.1 -o matterhorn.tif
      orograph fetch --at -71.3,44.27 --radius 10000 --product 3dep-10 -o washington.oro
      orograph fetch --geojson park.geojson --product srtm-1 -o park.tif
      orograph fetch --products
    """
    if list_products:
        _list(options["table"], as_json)
        return
    if try_products:
        chosen = ctx.get_parameter_source("product") is not click.core.ParameterSource.DEFAULT
        if not _try(options["table"], options["product"] if chosen else None, as_json):
            ctx.exit(ReadError.exit_code)
        return
    if output is None:
        raise click.UsageError("Missing option '--output' / '-o'.", ctx)
    suffix = Path(output).suffix.lower()
    if suffix not in (".tif", ".tiff", ".oro"):
        raise UsageError(
            "The result can only be written as a GeoTIFF or a store.", path=output, remedy="Use .tif or .oro."
        )
    if resume and suffix != ".oro":
        raise UsageError("--resume is for stores: what was read is kept anyway.", remedy="Leave it out.")
    from orograph.output import check_folder

    check_folder(Path(output))
    began = time.perf_counter()
    progress = progress_of(ctx)
    with progress.task("Loading Orograph"):
        from orograph.fetching.areas import asked
        from orograph.fetching.request import Request
    area = asked(None, *(options[name] for name in ("bbox", "at", "radius", "geojson")))
    request = Request(
        area, options["product"], radius=options["radius"], table=options["table"], zoom=options["zoom"],
        absent=options["absent"], to_vertical=options["to_vertical"], geoid=options["geoid"],
        most=None if options["yes"] else options["most"], connections=options["connections"], progress=progress,
    )  # fmt: skip
    progress.note(str(request.plan))
    try:
        if suffix == ".oro":
            request.build(output, overwrite=overwrite, resume=resume, max_memory=max_memory, jobs=jobs).close()
        else:
            request.write(Path(output), overwrite)
    except KeyboardInterrupt:
        click.echo("\nWhat was read is kept: run the same command to go on from there.", err=True)
        raise
    _tell(request, output, time.perf_counter() - began, as_json)


def _tell(request: Request, output: str, seconds: float, as_json: bool) -> None:
    """Report what was fetched."""
    product, grid = request.product, request.plan.layout.grid
    if as_json:
        told = {
            "path": output, "product": product.name, "tiles": len(request.plan.layout.tiles), "shape": list(grid.shape),
            "absent": sum(record.status == "absent" for record in request.reader.records.values()),
            "bounds": list(grid.bounds()), "attribution": product.attribution, "licence": product.licence,
            "seconds": round(seconds, 3),
        }  # fmt: skip
        click.echo(json.dumps(told, ensure_ascii=False))
        return
    click.echo(f"{output}: {grid.rows:,} × {grid.cols:,} samples of {product.title} in {seconds:.1f} s")
    click.echo(f"  {product.attribution}")
    click.echo(f"  licence: {product.licence}")


def _list(table: str | None, as_json: bool) -> None:
    """Print the table of products."""
    from dataclasses import asdict

    from orograph.fetching.products import products

    known = products(table)
    if as_json:
        click.echo(json.dumps({name: asdict(one) for name, one in known.items()}, indent=1, ensure_ascii=False))
        return
    for name, one in known.items():
        click.echo(click.style(f"{name:<14}", bold=True) + f"{one.title}: {_spacing(one)}, {one.model} model")
        datum = one.datum or "heights above several datums"
        absent = f"absent tiles are {one.absent}" + (f", missing where {one.witness} has them" if one.witness else "")
        click.echo(f"{'':<14}{datum}; measured {one.years or 'at unknown times'}; {absent}")
        click.echo(f"{'':<14}{one.licence}")
        if one.account:
            click.echo(f"{'':<14}needs an account: {one.account}, in ~/.netrc as machine {one.machine}")
        click.echo(f"{'':<14}{one.home or one.base}")


def _spacing(product: Product) -> str:
    if product.tiling == "degrees":
        text = "1/3" if abs(product.spacing - 1 / 3) < 1e-6 else f"{product.spacing:g}"
        return f"{text}″ (about {product.spacing * 30.9:.0f} m)"
    if product.tiling == "web-mercator":
        return f"zoom {product.zoom} (about {156543 / 2**product.zoom:.0f} m), up to {product.most_zoom}"
    return f"{product.spacing:.0f} m"


def _try(table: str | None, name: str | None, as_json: bool) -> bool:
    """Ask the servers and print their answers; returns whether all are good."""
    from orograph.fetching.trying import tried

    told = []
    for product, url, answer in tried(table, name):
        good = answer.there or (bool(product.account) and answer.code in (401, 403))
        note = " (it needs an account)" if product.account and answer.code in (401, 403) else ""
        told.append({"product": product.name, "url": url, "code": answer.code, "size": answer.size, "good": good})
        if not as_json:
            size = f", {answer.size / 1e6:,.1f} MB" if answer.size else ""
            text = f"{answer.code}{size}" if answer.there else f"{answer}{note}"
            click.echo(f"{product.name:<14}{'good' if good else 'BAD ':<5} {text}\n{'':<14}{url}")
    if as_json:
        click.echo(json.dumps(told, indent=1))
    return all(one["good"] for one in told)
