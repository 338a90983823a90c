"""``orograph methods``: list the methods and the meaning of their options."""

from __future__ import annotations

import click

from orograph.cli.wording import spoken


@click.command("methods")
@click.argument("name", required=False)
def command(name: str | None) -> None:
    """List the methods, or a method's options with their units and defaults.

    A method decides what is drawn of a terrain for a camera. Verbs take it as --method NAME[,key=value…].

    \b
    Examples:
      orograph methods
      orograph methods soar
      orograph tessellate dem.tif -o mesh.npz --method soar,error=wedgie,geomorph=yes
    """
    from orograph.lod.describe import about, about_all

    click.echo(spoken(about_all() if name is None else about(name)))
