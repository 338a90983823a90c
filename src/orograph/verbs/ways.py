"""The options of a tour: contradictions among them, and the tour that they describe. Loads quickly, for the command
line."""

from __future__ import annotations

import os
from collections.abc import Mapping, MutableMapping
from typing import TYPE_CHECKING, Any

from orograph.errors import UsageError
from orograph.scene.bearings import bearing
from orograph.several import numbers

if TYPE_CHECKING:
    from orograph.lighting.sun import Passage
    from orograph.store.terrain import Terrain
    from orograph.touring.tour import Tour

KINDS = ("orbit", "turntable", "still", "plan", "line", "points")
WAY = (*KINDS, "around", "azimuth", "pitch", "distance", "fov", "seconds", "height", "speed", "line_crs")
"""All options that describe a tour's path."""

ROUND = ("around", "azimuth", "pitch", "distance")
"""The options that apply to orbits only."""


def chosen(options: Mapping[str, Any]) -> list[str]:
    """The kinds of tours that were asked for; ``around`` alone means an orbit."""
    return [kind for kind in KINDS if options[kind]] or ["orbit"] * (options["around"] is not None)


def parsed_path(options: Mapping[str, Any]) -> dict[str, Any]:
    """The path that options describe, with places parsed from text ("7.6,45.9,2000")."""
    flags = dict.fromkeys(("orbit", "turntable", "still", "plan"), False)
    way = {**dict.fromkeys(WAY), **flags, "points": (), **options}
    if way["around"] is not None:
        way["around"] = numbers(way["around"], "around")
    if isinstance(way["line"], Mapping) or hasattr(way["line"], "__geo_interface__"):
        from orograph.touring.make import longest

        way["line"] = longest(way["line"])
    if way["line"] is not None and not isinstance(way["line"], str | os.PathLike):
        way["points"], way["line"] = way["line"], None  # (places, not a file of them)
    if way["azimuth"] is not None:
        way["azimuth"] = bearing(way["azimuth"])
    way["points"] = tuple(numbers(point, "points") for point in way["points"])
    return way


def settle_tour(options: MutableMapping[str, Any], from_file: bool = False) -> None:
    """Make a tour an orbit if its options ask for no kind of tour.

    Args:
        from_file: whether there is a tour already, which options must not describe.

    Raises:
        UsageError: options contradict each other.
    """
    if from_file and chosen(options):
        raise UsageError("Give a tour or describe one (orbit, turntable, still, plan, around, line, points), not both.")
    if not from_file and not chosen(options):
        options["orbit"] = True
    kinds = [f"`{kind}`" for kind in chosen(options)]
    if len(kinds) > 1:
        raise UsageError(f"{kinds[0]} and {kinds[1]} are two tours: choose one.")
    kind = (chosen(options) or [""])[0]
    along = ("height", "speed", "line_crs")
    only = {"orbit": along, "turntable": along, "still": along, "plan": (*ROUND, *along, "fov"), "line": ROUND,
            "points": ROUND}  # fmt: skip
    for name in only.get(kind, WAY[len(KINDS) :]):
        if options[name] is not None:
            raise UsageError(f"`{name}` does not apply to {kinds[0] if kinds else 'a tour that is given'}.")
    if options["speed"] is not None and options["seconds"] is not None:
        raise UsageError("`seconds` and `speed` say the same twice: give one of them.")
    if options["speed"] is not None and not options["speed"] > 0:
        raise UsageError(f"`speed` must be more than 0 metres per second, not {options['speed']:g}.")
    if options["around"] is not None and len(options["around"]) > 2 and options["distance"] is not None:
        raise UsageError("The radius in `around` and `distance` say the same twice: give one of them.")
    if kind == "points" and len(options["points"]) < 2:
        raise UsageError("A line to fly along needs at least two points: give `points` twice or more.")


def check_passage(passage: Passage | None, options: Mapping[str, Any]) -> None:
    """Raise UsageError if the sun moves by time and a turntable turns it, too."""
    if passage is not None and options["turntable"]:
        raise UsageError(
            "A turntable turns the light itself, so its sun cannot also pass from one time to another.",
            remedy="Give one time or direction, or an orbit in place of the turntable.",
        )


def tour_of(
    terrain: Terrain, size: tuple[int, int], options: Mapping[str, Any], sun: tuple[float, float], exaggeration: float,
    furniture: bool = False, also: Any = None,
) -> Tour:  # fmt: skip
    """The tour that the options describe (see ``settle_tour``). A camera that stays
    leaves room for ``furniture``; one that shows the whole terrain keeps further positions, ``also``, in view."""
    from orograph.touring import make

    given = {new: options[old] for old, new in
             (("azimuth", "azimuth"), ("pitch", "pitch"), ("distance", "distance"), ("seconds", "seconds"),
              ("fov", "fov_y"), ("around", "around"),
              ("height", "height"), ("speed", "speed")) if options[old] is not None}  # fmt: skip
    kind = chosen(options)[0]
    if kind in ("turntable", "still", "orbit"):
        given["also"] = also
    if kind == "turntable":
        return make.turntable(terrain, size, sun=sun, exaggeration=exaggeration, **given)
    if kind in ("still", "plan"):
        if furniture:
            from orograph.rendering.furniture.furnish import insets

            given["insets"] = insets(size, terrain.attribution)
        return make.still(terrain, size, plan=kind == "plan", exaggeration=exaggeration, **given)
    if kind == "orbit":
        return make.orbit(terrain, size, exaggeration=exaggeration, **given)
    crs = terrain.grid.crs
    if kind == "line":
        line = make.read_line(options["line"], crs, options["line_crs"])
    else:
        line = make.to_crs(options["points"], crs, options["line_crs"])
    return make.flyover(terrain, size, line, **given)
