"""``orograph info``: describe a DEM, a file of points or a store, and what looks suspicious in it (``verbs.info``)."""

from __future__ import annotations

import json
from typing import Any

import click

from orograph.cli.options import area_options, file_options, jobs_option, point_file_options, progress_of
from orograph.cli.wording import spoken


@click.command("info")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object (a list for several paths).")
@click.option("--exact", is_flag=True, help="Read every sample of a raster, however large.")
@area_options
@file_options
@point_file_options
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], as_json: bool, exact: bool, jobs: int | None, **options: Any
) -> None:
    """Describe a DEM, a file of points or a store, and point out what looks suspicious.

    PATH is anything GDAL reads (also inside .zip and .gz, or a URL), a folder of rasters, which are one terrain, a file
    of points, or a terrain store. Heights are in metres, after scale, offset and unit. --bbox and --clip restrict the
    description to an area.

    \b
    Examples:
      orograph info N44W072.hgt
      orograph info tiles/*.tif --json
      orograph info tiles/
      orograph info dem.tif --bbox 7.5,45.9,7.8,46.1
      orograph info height.png --spacing 30
    """
    progress = progress_of(ctx)
    from orograph.verbs.info import info
    from orograph.verbs.info_text import describe

    facts = [info(path, progress=progress, exact=exact or None, jobs=jobs, **options) for path in paths]
    for fact in facts:
        fact["warnings"] = [spoken(text) for text in fact["warnings"]]
    if as_json:
        plain = [{k: v for k, v in f.items() if not k.startswith("_")} for f in facts]
        click.echo(json.dumps(plain[0] if len(plain) == 1 else plain, indent=2, ensure_ascii=False, allow_nan=False))
        return
    for i, fact in enumerate(facts):
        click.echo(("\n" if i else "") + spoken(describe(fact, _bold, _mark)))


def _bold(text: str) -> str:
    return click.style(text, bold=True)


def _mark(text: str) -> str:
    return click.style(text, fg="yellow", bold=True)
