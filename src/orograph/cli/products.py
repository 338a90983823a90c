"""Options of light products, shared by the verbs that make them: ``light`` writes files, ``bake`` writes into stores.

``@horizon_options`` gives a verb ``azimuths``, ``radius``, ``curvature`` and ``refraction``; ``@ray_options(…)``
``rays``, ``rho`` and ``method``; ``@insolation_options`` ``date``, ``step`` and ``turbidity``: keyword arguments by the
names of ``lighting.products.Options``, or of what its ``more`` holds (``MORE``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import click

from orograph.cli.options import F, Float, with_options
from orograph.errors import UsageError

MORE = ("rho", "method", "cones", "date", "step", "turbidity")
"""Options of single products; only those given are passed on."""


def check_used(ctx: click.Context, wanted: Sequence[str]) -> None:
    """Refuse options that affect none of the products: they would be ignored.

    Raises:
        UsageError: an option was given that none of ``wanted`` uses.
    """
    from orograph.errors import UsageError
    from orograph.lighting.maps import USERS

    if ctx.params.get("refraction") is not None and not ctx.params.get("curvature"):
        raise UsageError("--refraction needs --curvature: on a flat Earth rays are straight.")
    for option in ctx.command.params:
        users = USERS.get(str(option.name))
        given = ctx.get_parameter_source(str(option.name)) is click.core.ParameterSource.COMMANDLINE
        if users is not None and given and not set(users) & set(wanted):
            raise UsageError(
                f"{option.opts[0]} has no effect on {', '.join(wanted)}.",
                remedy=f"Leave it out: it is for {', '.join(users)}.",
            )


class Names(click.ParamType["tuple[str, ...]"]):
    """Names of products separated by commas."""

    name = "NAME"

    def get_missing_message(self, param: click.Parameter, ctx: click.Context | None) -> str:
        return "Say what to make: --product hillshade, slope, sky-view-factor… (orograph light --help lists all)."

    def convert(
        self, value: str | tuple[str, ...], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        if not isinstance(value, str):
            return value
        from orograph.lighting.products import product

        wanted = tuple(word.strip() for word in value.split(","))
        for word in wanted:
            try:
                product(word)
            except UsageError as error:
                self.fail(str(error), param, ctx)
        return wanted


def once(names: Sequence[tuple[str, ...]]) -> list[str]:
    """All names of a repeated option, each once."""
    return list(dict.fromkeys(name for some in names for name in some))


def more_of(options: dict[str, Any]) -> dict[str, Any]:
    """Remove the options of single products from a verb's; returns those that were given."""
    taken = {name: options.pop(name) for name in MORE if name in options}
    return {name: value for name, value in taken.items() if value is not None}


def horizon_options(function: F) -> F:
    """Give a verb the options of horizons."""
    return with_options(
        function,
        click.option(
            "--azimuths",
            type=click.IntRange(3, 720),
            default=32,
            show_default=True,
            help="Number of directions in which horizons are computed, evenly spread from north.",
        ),
        click.option(
            "--radius",
            type=Float(),
            metavar="METRES",
            help="How far away ground can hide the sky.  [default: any distance]",
        ),
        click.option(
            "--curvature",
            is_flag=True,
            help="Account for the curvature of the Earth (or another body) and for refraction.",
        ),
        click.option(
            "--refraction",
            type=Float(),
            help="With --curvature: curvature of rays relative to that of the ground.  [default: 0.13; 0 beyond the "
            "Earth]",
        ),
    )


def ray_options(methods: Sequence[str], method: str, rays: str) -> Callable[[F], F]:
    """Give a verb the options of ambient occlusion and apertures.

    Args:
        methods: the available ones. method, rays: help texts of these options.
    """

    def give(function: F) -> F:
        return with_options(
            function,
            click.option("--rays", type=click.IntRange(min=1), default=256, show_default=True, help=rays),
            click.option(
                "--rho",
                type=click.Choice(["step", "linear"]),
                help="For ambient occlusion: what ground nearer than --radius lets through: nothing (light of the "
                "sky), or distance / radius (light that fills the air).  [default: step]",
            ),
            click.option("--by", "method", type=click.Choice(methods), help=method),
        )

    return give


def insolation_options(function: F) -> F:
    """Give a verb the options of insolation and sunshine."""
    return with_options(
        function,
        click.option(
            "--date",
            metavar="DATE",
            help="For insolation and sunshine: a day, a month or a year (2026-06-21, 2026-06, 2026), in mean solar "
            "time.",
        ),
        click.option(
            "--step",
            type=Float(),
            metavar="MINUTES",
            help="For insolation and sunshine: time between two sun positions.  [default: 10]",
        ),
        click.option(
            "--turbidity",
            type=Float(),
            help="For insolation: Linke turbidity of the air: 2 clean and cold, 5 hazy, 0 none.  [default: 3]",
        ),
    )
