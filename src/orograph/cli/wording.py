"""Translates Python's names in messages and help to the command line's: options are called as in the running verb."""

from __future__ import annotations

from collections.abc import Mapping

import click

SAID = {
    "plan": "--projection plan", "map": "--projection plan", "perspective": "--projection perspective",
    **dict.fromkeys(("graticule", "grid"), "--aids grid"), "points": "--data FILE,variable=NAME",
    **dict.fromkeys(("track", "gpx"), "--line"), "time": "--sun DATE",
    **dict.fromkeys(("contour", "lines"), "--contours"), **dict.fromkeys(("extent", "bounds", "area"), "--bbox"),
    "duration": "--seconds", "azimuth": "--from, --sun AZIMUTH,ALTITUDE", "altitude": "--sun AZIMUTH,ALTITUDE",
    "zoom": "--bbox, --distance, --fov", "tolerance": "--max-error", "lonlat": "--target",
}  # fmt: skip
"""Options that people try, and what says it here: one, or several."""

POINTS = frozenset(
    (
        "at",
        "point",
        "points",
        "place",
        "location",
        "coords",
        "coordinates",
        "observer",
        "start",
        "end",
        "from",
        "to",
        "lat",
        "lon",
    )
)
"""Options that people try for the points of a measurement."""

_flags: dict[str, str] = {}
"""What the running verb calls its arguments."""


def flags_of(command: click.Command) -> dict[str, str]:
    """What a verb calls its arguments, by their Python names; a group's verbs together."""
    if isinstance(command, click.Group):
        return {k: v for one in command.commands.values() for k, v in flags_of(one).items()}
    options = [one for one in command.params if isinstance(one, click.Option)]
    return {str(one.name): max(one.opts, key=len) for one in options}


def speak(command: click.Command | None) -> None:
    """Use this verb's names for arguments from now on."""
    _flags.clear()
    _flags.update({} if command is None else flags_of(command))


def flag(name: str, flags: Mapping[str, str] | None = None) -> str:
    """The command-line name of an argument; ``flags``: by name (None: the running verb's)."""
    from orograph.scene import wording

    return (_flags if flags is None else flags).get(name) or wording.flag(name)


def spoken(text: str, flags: Mapping[str, str] | None = None) -> str:
    """A text whose Python in backticks is written as on the command line; ``flags``: as for ``flag``."""
    if "`" not in text:
        return text
    from orograph.scene import wording

    return wording.spoken(text, lambda name: flag(name, flags))


def lead(error: click.NoSuchOption) -> None:
    """Have an error suggest the option that a user of another tool's name may mean, if the verb has it."""
    from orograph.scene import wording

    there = {flag for one in (error.ctx.command.params if error.ctx else ()) for flag in one.opts}
    if "points" in there and error.option_name.lstrip("-").lower() in POINTS:
        setattr(error, "possibilities", [])  # noqa: B010 (given to a new error it would have to look alike)
        setattr(error, "message", f"{error.message} Points follow the file: E,N, or --lonlat LON,LAT.")  # noqa: B010
        return
    name = error.option_name.lstrip("-").lower().replace("-", "_")
    meant = wording.flag("uncertainty" if name in ("error", "sigma") else wording.MEANT.get(name, name))
    here = [one for one in SAID.get(name, meant).split(", ") if one.split()[0] in there]
    if here:
        setattr(error, "possibilities", here)  # noqa: B010 (given to a new error it would have to look alike)


def elsewhere(name: str) -> list[str]:
    """The command line for something that is a verb elsewhere (a light product, a measurement); []: none."""
    from orograph.lighting.products import MEANT, names
    from orograph.scene import wording

    product = name.replace("_", "-")
    if product in names() or product in MEANT:
        return [f"light --product {MEANT.get(product, product)}"]
    found = wording.ELSEWHERE.get(name.replace("-", "_"), "").partition("(")[0]
    return [found.replace(".", " ").replace("line_of_sight", "los").replace("heights", "pick")] if found else []
