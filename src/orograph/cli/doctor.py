"""``orograph doctor``: what this machine offers for drawing and computing (``verbs.doctor``)."""

from __future__ import annotations

import json

import click

from orograph.cli.wording import spoken


@click.command("doctor")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(as_json: bool) -> None:
    """Report what this machine can draw with, and what to install.

    Lists the GPU adapters and computes something on the one that would be used, the optional libraries, processors and
    memory, the screen, and the folder where stores are kept. The exit code is 0 even if something is missing: pictures
    need only the CPU.
    """
    from orograph.verbs.doctor import doctor

    facts = doctor()
    for extra in facts["extras"].values():
        extra["for"] = spoken(extra["for"])
    click.echo(json.dumps(facts, indent=1) if as_json else repr(facts))
