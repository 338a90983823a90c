"""Tours on the command line: the options that make one (``tour_options``), for ``tour new`` and ``movie``."""

from __future__ import annotations

import click

from orograph.cli.options import FILE, Direction, F, Float, FloatRange, Numbers, with_options


def tour_options(function: F) -> F:
    """Give a verb the options that make a tour."""
    return with_options(
        function,
        click.option("--orbit", is_flag=True, help="Once around the terrain, all of it in view; a loop (the default)."),
        click.option(
            "--turntable", is_flag=True, help="The same with the light turning too, as if the terrain rotated."
        ),
        click.option(
            "--still",
            is_flag=True,
            help="The camera stays, all of the terrain in view: for data over time, or a moving sun.",
        ),
        click.option("--plan", is_flag=True, help="The same straight down, as a map."),
        click.option(
            "--around",
            type=Numbers("LON,LAT,RADIUS", optional=1),
            help="Orbit this place, with RADIUS metres of ground around it in view.  [default: the whole terrain; "
            "RADIUS: a quarter of its shorter side]",
        ),
        click.option("--line", type=FILE, metavar="FILE", help="Fly along the longest line of a GPX or GeoJSON file."),
        click.option(
            "--point",
            "points",
            type=Numbers("LON,LAT"),
            multiple=True,
            help="Fly over this place, then on to the next --point.",
        ),
        click.option(
            "--line-crs",
            metavar="CRS",
            help="The CRS of --line and --point.  [default: longitude and latitude, EPSG:4326]",
        ),
        click.option("--seconds", type=Float(), metavar="S", help="Duration.  [default: 12 for once around]"),
        click.option(
            "--speed", type=Float(), metavar="M/S", help="Speed along a line.  [default: one that suits --height]"
        ),
        click.option(
            "--height",
            type=Float(),
            metavar="M",
            help="Height above the ground along a line.  [default: a fifteenth of its length, 50 to 3000]",
        ),
        click.option(
            "--side",
            "azimuth",
            type=Direction(),
            metavar="AZIMUTH",
            help="The side from which an orbit begins, degrees clockwise from north or a point of the "
            "compass (NE).  [default: 180, the south]",
        ),
        click.option("--pitch", type=Float(), metavar="DEG", help="How far an orbit looks down.  [default: 35]"),
        click.option(
            "--distance",
            type=Float(),
            metavar="M",
            help="Distance of an orbit from the terrain's middle, or from the place of --around.  [default: far "
            "enough to see all of it]",
        ),
        click.option(
            "--fov",
            type=FloatRange(1e-6, 180, max_open=True),
            metavar="DEG",
            help="Vertical field of view.  [default: 30, along a line 45]",
        ),
    )
