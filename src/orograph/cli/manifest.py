"""``orograph manifest``: describe many files once (``verbs.manifest``)."""

from __future__ import annotations

import json
from typing import Any

import click

from orograph.cli.options import FILE, file_options, jobs_option, progress_of


@click.command("manifest", short_help="Describe many DEM files once, for the other verbs.")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "-o", "--output", required=True, type=FILE, help="The manifest to write or update: NAME.manifest.geojsonl.",
)  # fmt: skip
@click.option(
    "--skip-damaged", is_flag=True, help="Do not fail on files that cannot be opened; they are listed all the same."
)
@file_options
@jobs_option
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, skip_damaged: bool, jobs: int | None, as_json: bool,
    **options: Any,
) -> None:  # fmt: skip
    """Describe DEM files in a list, so that build, info, render and the other verbs need not open all of them.

    PATH is a file, a URL, a folder (all in it), a pattern or another manifest. The manifest is GeoJSON, one file per
    line, and is given in place of the files. Running the command again opens only new or changed files, and continues
    an interrupted run. Readers of the manifest open a file that has changed since.

    \b
    Examples:
      orograph manifest tiles/ -o tiles.manifest.geojsonl
      orograph build tiles.manifest.geojsonl -o area.oro
      orograph manifest 'tiles/**/*.tif' -o tiles.manifest.geojsonl --skip-damaged
    """
    from orograph.verbs.manifest import manifest

    if options["band"] == 1:
        options["band"] = None
    found = manifest(
        list(paths), output, skip_damaged=skip_damaged, jobs=jobs, progress=progress_of(ctx), **options
    )  # fmt: skip
    if as_json:
        click.echo(json.dumps({"path": found.path, "files": found.files, "damaged": list(found.damaged)}))
        return
    click.echo(f"{found.path}: {found.files} file{'s' if found.files != 1 else ''}")
    for text in found.damaged:
        click.echo(f"  {text}")
