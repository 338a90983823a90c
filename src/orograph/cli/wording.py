"""Python's names in messages and help, as the command line has them: options are called as the verb that runs does."""

from __future__ import annotations

from collections.abc import Mapping

import click

from orograph.scene import wording

_flags: dict[str, str] = {}
"""What the verb that runs calls its arguments."""


def flags_of(command: click.Command) -> dict[str, str]:
    """What a verb calls its arguments, by their names in Python; a group's verbs together."""
    if isinstance(command, click.Group):
        return {k: v for one in command.commands.values() for k, v in flags_of(one).items()}
    options = [one for one in command.params if isinstance(one, click.Option)]
    return {str(one.name): max(one.opts, key=len) for one in options}


def speak(command: click.Command | None) -> None:
    """Call arguments as this verb does, from now on."""
    _flags.clear()
    _flags.update({} if command is None else flags_of(command))


def flag(name: str, flags: Mapping[str, str] | None = None) -> str:
    """What an argument is called on the command line; ``flags``: by name (None: the running verb's)."""
    return (_flags if flags is None else flags).get(name) or wording.flag(name)


def spoken(text: str, flags: Mapping[str, str] | None = None) -> str:
    """A text with its Python in backticks as the command line has it; ``flags``: as for ``flag``."""
    return wording.spoken(text, lambda name: flag(name, flags))


MEANT = {
    **dict.fromkeys(("legend", "scale-bar", "scalebar", "north-arrow", "colorbar", "attribution"), "furniture"),
    **dict.fromkeys(("cmap", "palette", "color", "colors"), "colormap"),
    **dict.fromkeys(("ve", "vertical-exaggeration", "z-factor", "zscale"), "exaggeration"),
    **dict.fromkeys(("layer", "layers", "overlay", "image", "imagery", "basemap"), "drape"),
    **dict.fromkeys(("threads", "cores", "workers", "n-jobs"), "jobs"),
    **dict.fromkeys(("dpi", "width", "height", "figsize"), "size"),
    **dict.fromkeys(("hillshade", "shading", "lighting"), "light"),
    **dict.fromkeys(("engine", "algorithm"), "method"),
    **dict.fromkeys(("error", "sigma"), "uncertainty"),
    "camera": "view",
}  # fmt: skip
"""What options are called elsewhere, and here."""


def lead(error: click.NoSuchOption) -> None:
    """Have an error suggest the option that a user who knows another name for it may mean, if its verb has that."""
    there = {flag for one in (error.ctx.command.params if error.ctx else ()) for flag in one.opts}
    flag = "--" + MEANT.get(error.option_name.lstrip("-").lower().replace("_", "-"), "")
    if flag in there:
        setattr(error, "possibilities", [flag])  # noqa: B010 (given to a new error it would have to look alike)
