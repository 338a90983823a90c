"""Python's names in messages and help, as the command line has them.

The library writes Python in backticks: an argument (```tolerance```), with a value (```tolerance=2```), or a call
(```orograph.bake(store, ["openness"], overwrite=True)```). Here that becomes ``--tolerance``, ``--tolerance 2`` and
``orograph bake STORE --products openness --overwrite``: options are called as the verb that runs calls them.
"""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Mapping

import click

from orograph.scene.parts import OPTIONS

_flags: dict[str, str] = {}
"""What the verb that runs calls its arguments."""

VERBS = {
    "orograph.store.repair.repair": "orograph build --repair",
    "orograph.geovis.color_store.store_colors": "orograph build --color-errors",
}
"""Functions that are options of a verb; others are called as their verb."""

PLACES = {"orograph.bake": ("", "--products"), "orograph.build": ("", "-o")}
"""The options of arguments that a call gives by their places; "": the verb takes it by its place, too."""


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
    """What an argument is called on the command line."""
    known = _flags if flags is None else flags
    if name in known:
        return known[name]
    return f"--{OPTIONS[name].key if name in OPTIONS else name.replace('_', '-')}"


def spoken(text: str, flags: Mapping[str, str] | None = None) -> str:
    """A text with its Python in backticks as the command line has it; ``flags``: by name (None: the running verb's)."""
    return re.sub("`([^`]+)`", lambda found: _said(found[1], flags), text)


def _said(code: str, flags: Mapping[str, str] | None) -> str:
    try:
        tree = ast.parse(f"f({code})", mode="eval").body
    except SyntaxError:
        return f"`{code}`"
    assert isinstance(tree, ast.Call)
    words = [_word(one, flags) for one in tree.args]
    for given in tree.keywords:
        words += _option(given, flags)
    return " ".join(words)


def _word(tree: ast.expr, flags: Mapping[str, str] | None) -> str:
    """An argument by its name; or a function of the package, called or not."""
    if isinstance(tree, ast.Name):
        return flag(tree.id, flags)
    call = tree if isinstance(tree, ast.Call) else ast.Call(tree, [], [])
    name = ast.unparse(call.func)
    if not name.startswith("orograph."):
        return ast.unparse(tree)
    words = [VERBS.get(name, name.replace(".", " "))]
    for one, place in zip(call.args, [*PLACES.get(name, ()), *[""] * len(call.args)], strict=False):
        if not (isinstance(one, ast.Constant) and one.value is ...):
            words += [*filter(None, [place]), _value(one, "," if place else " ").strip()]
    for given in call.keywords:
        words += _option(given, {})
    return " ".join(words)


def _option(given: ast.keyword, flags: Mapping[str, str] | None) -> list[str]:
    name = flag(given.arg or "", flags)
    if isinstance(given.value, ast.Constant) and given.value.value is True:
        return [name]
    if isinstance(given.value, ast.Constant) and given.value.value is False:
        return [f"--no-{name[2:]}"]
    return [name, _value(given.value, "x" if given.arg == "size" else ",")]


def _value(tree: ast.expr, between: str = ",") -> str:
    """A value as words of the command line; a name stands for what the user has."""
    if isinstance(tree, ast.Tuple | ast.List):
        return between.join(_value(one) for one in tree.elts)
    if isinstance(tree, ast.Constant):
        return "none" if tree.value is None else shlex.quote(str(tree.value))
    return ast.unparse(tree).upper() if isinstance(tree, ast.Name) else ast.unparse(tree)
