"""``orograph check``: verify every byte of a store."""

from __future__ import annotations

import json

import click

from orograph.cli.options import jobs_option, progress_of
from orograph.errors import StoreError

SHOWN = 20
"""How many damages are listed one by one; --json lists all."""


@click.command("check", short_help="Read all of a store and list what is damaged.")
@click.argument("store", metavar="STORE")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@jobs_option
@click.pass_context
def command(ctx: click.Context, /, store: str, as_json: bool, jobs: int | None) -> None:
    """Read every byte of a store and list what is damaged, missing or out of place.

    Heights of all levels, means, tables, errors, layers, coordinates and metadata are compared with what the store's
    root lists. The exit code is 0 if all is sound and 4 if not; orograph build --repair repairs what can be repaired.
    For a damaged store it also lists which of its source files are gone or changed.

    \b
    Examples:
      orograph check area.oro
      orograph check s3://bucket/area.oro --json
    """
    from orograph.store import open
    from orograph.store.checking import check
    from orograph.store.inputs import changes

    with open(store, jobs=jobs) as terrain:
        found = check(terrain, jobs=jobs, progress=progress_of(ctx))
        shards, size = terrain.record.shard_count, terrain.size_bytes
        changed = changes(terrain.record.inputs) if found and terrain.record.inputs is not None else []
    if as_json:
        damages = [{"key": damage.key, "cause": damage.cause} for damage in found]
        click.echo(
            json.dumps({"path": store, "sound": not found, "shards": shards, "damaged": damages, "changed": changed})
        )
        if found:
            ctx.exit(StoreError.exit_code)
        return
    if not found:
        from orograph.cli.memory import megabytes

        click.echo(f"{store}: sound; {shards} shards, {megabytes(size)}")
        return
    for damage in found[:SHOWN]:
        click.echo(f"{damage.key}: {damage.cause}")
    if len(found) > SHOWN:
        click.echo(f"and {len(found) - SHOWN} more")
    for sentence in changed:
        click.echo(sentence)
    objects = len({damage.object for damage in found})
    raise StoreError(
        f"{objects} of its objects {'is' if objects == 1 else 'are'} damaged.",
        path=store,
        remedy=f"Repair it: orograph build -o {store} --repair",
    )
