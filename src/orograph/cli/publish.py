"""``orograph publish``: copy a finished store into a bucket."""

from __future__ import annotations

import json

import click

from orograph.cli.options import progress_of


@click.command("publish", short_help="Copy a finished store into a bucket.")
@click.argument("store", metavar="STORE")
@click.argument("url", metavar="URL")
@click.option("--overwrite", is_flag=True, help="Replace an existing store; it is removed first.")
@click.option("--jobs", type=click.IntRange(min=1), help="Simultaneous uploads (default: 16).")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.pass_context
def command(ctx: click.Context, /, store: str, url: str, overwrite: bool, jobs: int | None, as_json: bool) -> None:
    """Copy a finished store to a URL (s3://, gs://, az://…), where it opens once it is complete.

    Every object is checked against the store's root before it is sent, and its end is read back afterwards. The root
    comes last. After an interruption the same command continues. Credentials come from the environment.

    \b
    Examples:
      orograph publish area.oro s3://bucket/area.oro
      orograph check s3://bucket/area.oro
    """
    from orograph.store.publishing import publish

    done = publish(store, url, overwrite=overwrite, jobs=jobs, progress=progress_of(ctx))
    if as_json:
        click.echo(json.dumps({"store": url, "objects": done.objects, "sent": done.sent, "bytes": done.size}))
        return
    from orograph.cli.memory import megabytes

    click.echo(f"{url}: {done.objects} objects, {done.sent} sent ({megabytes(done.size)})")
