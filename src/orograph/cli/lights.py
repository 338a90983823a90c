"""How light falls in a picture, on the command line: the options of all verbs that draw, window included; ``--rays`` of
those that make maps, too.

``@light_options`` gives a verb ``light``, ``shadows``, ``rays``, ``lamps`` and ``discs``; ``check_lights`` refuses what
contradicts, before any work; ``lights_of`` makes a scene's lamps and discs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.camera import Numbers
from orograph.cli.options import F

if TYPE_CHECKING:
    from orograph.lighting.aperture import Lamp
    from orograph.lighting.sun import Sun
    from orograph.store.terrain import Terrain

LIGHTS = ("relief", "ao", "aperture", "raytraced", "none")  # orograph.scene.scene.Light, without importing it
SHINING = ("aperture", "raytraced")
"""Those with lamps and further discs."""


def rays_option(default: int, help: str) -> Callable[[F], F]:
    """``--rays``: how many, of whatever is answered by rays."""
    return click.option("--rays", type=click.IntRange(min=1), default=default, show_default=True, help=help)


def light_options(function: F) -> F:
    """Give a verb the options that say how light falls."""
    for option in reversed(
        [
            click.option(
                "--light",
                type=click.Choice(LIGHTS),
                default="relief",
                show_default=True,
                help="How light falls: relief: shadows by the skyline, a sky-view factor for the sky; ao: ambient "
                "occlusion; aperture: ambient apertures; raytraced: rays to the sun's disc and to the sky; none: bare "
                "colours. What orograph bake has put into a store is used.",
            ),
            click.option(
                "--shadows/--no-shadows", default=True, show_default=True, help="Whether the ground casts shadows."
            ),
            rays_option(64, "With --light raytraced: to each disc of light, and to the sky."),
            click.option(
                "--light-at",
                "lamps",
                type=Numbers("LON", "LAT", "HEIGHT", "REACH", "RED", "GREEN", "BLUE", optional=3),
                multiple=True,
                help="A lamp, HEIGHT metres above the heights' own zero, as bright as a sun REACH metres away; its "
                "colour from 0 to 1. Needs --light aperture or raytraced; give it again for each.",
            ),
            click.option(
                "--disc",
                "discs",
                type=Numbers("AZ", "ALT", "DIAMETER", "RED", "GREEN", "BLUE", optional=3),
                multiple=True,
                help="Another distant disc of light, so many degrees across. Needs --light aperture or raytraced.",
            ),
        ]
    ):
        function = option(function)
    return function


def check_lights(options: Mapping[str, Any]) -> None:
    """Raise UsageError where what is said of lamps and discs cannot be."""
    from orograph.errors import UsageError

    for name, colors in (("--light-at", [lamp[4:] for lamp in options["lamps"]]),
                          ("--disc", [disc[3:] for disc in options["discs"]])):  # fmt: skip
        if any(len(color) not in (0, 3) for color in colors):
            raise UsageError(f"{name} has no colour, or one of three numbers.")
        if colors and options["light"] not in SHINING:
            raise UsageError(
                f"--light {options['light']} knows no {name}.", remedy=f"Use --light {' or '.join(SHINING)}."
            )


def lights_of(
    terrain: Terrain, options: Mapping[str, Any]
) -> tuple[tuple[Lamp, ...], tuple[tuple[Sun, tuple[float, float, float]], ...]]:
    """The lamps and the further discs of light of a scene."""
    if not (options["lamps"] or options["discs"]):
        return (), ()
    from orograph.lighting.aperture import Lamp
    from orograph.lighting.sun import Sun
    from orograph.scene.camera import place

    white = (1.0, 1.0, 1.0)
    lamps = [
        Lamp.at(terrain.grid, *place(terrain, lon, lat), height, reach, tuple(color) or white)
        for lon, lat, height, reach, *color in options["lamps"]
    ]
    discs = [(Sun(*disc[:3]), (disc[3], disc[4], disc[5]) if disc[3:] else white) for disc in options["discs"]]
    return tuple(lamps), tuple(discs)
