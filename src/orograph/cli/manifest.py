"""``orograph manifest``: what many files are, found once (``verbs.manifest``)."""

from __future__ import annotations

import json
from typing import Any

import click

from orograph.cli.options import FILE, file_options, jobs_option, progress_of


@click.command("manifest", short_help="List what many DEM files are, once, for the other verbs.")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "-o", "--output", required=True, type=FILE, help="The manifest to write or to bring up to date: "
    "NAME.manifest.geojsonl.",
)  # fmt: skip
@click.option(
    "--skip-damaged", is_flag=True, help="Files that cannot be opened are no error; they are listed all the same."
)
@file_options
@jobs_option
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], output: str, skip_damaged: bool, jobs: int | None, as_json: bool,
    **options: Any,
) -> None:  # fmt: skip
    """List what DEM files are, so that build, info, render and the others need not open all of them to know.

    PATH is a file, a URL, a folder (all in it), a pattern or another manifest. The manifest is GeoJSON, a file a line,
    and is named in place of the files. Made again, it opens only what is new or changed, and goes on where it was
    broken off. A file that changes later is opened anew by whoever reads the manifest.

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
