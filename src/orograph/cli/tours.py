"""Tours on the command line: the options that make one (``tour_options``), for ``tour new`` and ``movie``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.camera import Numbers
from orograph.cli.options import FILE, F, Float, FloatRange, with_options

if TYPE_CHECKING:
    from orograph.store.terrain import Terrain
    from orograph.touring.tour import Tour

KINDS = ("orbit", "turntable", "line", "points")
WAY = (*KINDS, "azimuth", "pitch", "distance", "fov", "seconds", "height", "speed", "line_crs")
"""All that ``tour_options`` gives."""


def tour_options(function: F) -> F:
    """Give a verb the options that make a tour."""
    return with_options(
        function,
        click.option("--orbit", is_flag=True, help="Once round the terrain, all of it in view; a loop."),
        click.option(
            "--turntable", is_flag=True, help="The same with the light turning too, as if the terrain were turned."
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
        click.option("--seconds", type=Float(), metavar="S", help="How long it takes.  [default: 12 for once round]"),
        click.option("--speed", type=Float(), metavar="M/S", help="Along a line.  [default: one that suits --height]"),
        click.option(
            "--height",
            type=Float(),
            metavar="M",
            help="Above the ground, along a line.  [default: a fifteenth of its length, 50 to 3000]",
        ),
        click.option(
            "--side",
            "azimuth",
            type=Float(),
            metavar="AZIMUTH",
            help="The side an orbit begins from, degrees clockwise from north.  [default: 180, the south]",
        ),
        click.option("--pitch", type=Float(), metavar="DEG", help="How far an orbit looks down.  [default: 35]"),
        click.option(
            "--distance",
            type=Float(),
            metavar="M",
            help="From an orbit to the terrain's middle.  [default: such that all of it is in view]",
        ),
        click.option(
            "--fov",
            type=FloatRange(0, 180, min_open=True, max_open=True),
            metavar="DEG",
            help="Vertical field of view.  [default: 30, along a line 45]",
        ),
    )


def chosen(options: Mapping[str, Any]) -> list[str]:
    """The kinds of tours that were asked for."""
    return [kind for kind in KINDS if options[kind]]


def check_tour(options: Mapping[str, Any]) -> None:
    """Raise UsageError where the options of a tour contradict each other."""
    from orograph.errors import UsageError

    kinds = [f"--{kind.removesuffix('s')}" for kind in chosen(options)]
    if len(kinds) > 1:
        raise UsageError(f"{kinds[0]} and {kinds[1]} are two tours: choose one.")
    kind = (chosen(options) or [""])[0]
    only = {"orbit": ("height", "speed", "line_crs"), "turntable": ("height", "speed", "line_crs"),
            "line": ("azimuth", "pitch", "distance"), "points": ("azimuth", "pitch", "distance")}  # fmt: skip
    for name in only.get(kind, WAY[len(KINDS) :]):
        if options[name] is not None:
            option = "--side" if name == "azimuth" else f"--{name.replace('_', '-')}"
            raise UsageError(f"{option} says nothing about {kinds[0] if kinds else 'a tour from a file'}.")
    if options["speed"] is not None and options["seconds"] is not None:
        raise UsageError("--seconds and --speed say the same twice: give one of them.")
    if options["speed"] is not None and not options["speed"] > 0:
        raise UsageError(f"--speed is in metres per second, more than 0, not {options['speed']:g}.")
    if kind == "points" and len(options["points"]) < 2:
        raise UsageError("A line to fly along has at least two places: give --point twice or more.")


def tour_of(
    terrain: Terrain, size: tuple[int, int], options: Mapping[str, Any], sun: tuple[float, float], exaggeration: float
) -> Tour:
    """The tour that the options describe (see ``check_tour``); an orbit, if they describe none."""
    from orograph.touring import make

    given = {new: options[old] for old, new in
             (("azimuth", "azimuth"), ("pitch", "pitch"), ("distance", "distance"), ("seconds", "seconds"),
              ("fov", "fov_y"), ("height", "height"), ("speed", "speed")) if options[old] is not None}  # fmt: skip
    kind = (chosen(options) or ["orbit"])[0]
    if kind == "turntable":
        return make.turntable(terrain, size, sun=sun, exaggeration=exaggeration, **given)
    if kind == "orbit":
        return make.orbit(terrain, size, exaggeration=exaggeration, **given)
    crs = terrain.grid.crs
    if kind == "line":
        line = make.read_line(options["line"], crs, options["line_crs"])
    else:
        line = make.to_crs(options["points"], crs, options["line_crs"])
    return make.flyover(terrain, size, line, **given)
