"""Options of methods: each a field of the method's own dataclass, with its help, its unit and what it may be.

They are declared once. ``parse`` reads them as the command line has them, ``NAME[,key=value…]``; the window's panel,
``help()``, the table of the manual and ``compare`` show ``described``.
"""

from __future__ import annotations

import types
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, Union, get_args, get_origin, get_type_hints

from orograph.errors import UsageError


def option(
    default: Any, help: str, *, unit: str = "", choices: Sequence[str] = (), least: float | None = None,
    most: float | None = None,
) -> Any:  # fmt: skip
    """A field of an options dataclass.

    Args:
        help: what it does, a sentence.
        unit: of a number ("pixels", "metres"…).
        choices: what a word may be; none: anything.
        least, most: the range of a number, ends included.
    """
    return field(
        default=default, metadata={"help": help, "unit": unit, "choices": choices, "least": least, "most": most}
    )


@dataclass(frozen=True, slots=True)
class Described:
    """One option, for people.

    Attributes:
        name: with underscores, as in Python. key: with hyphens, as on the command line.
        kind: bool, int, float or str; ``optional``: whether it may be None.
        default, help, unit, choices, least, most: see ``option``.
    """

    name: str
    kind: type
    optional: bool
    default: Any
    help: str
    unit: str
    choices: tuple[str, ...]
    least: float | None
    most: float | None

    @property
    def key(self) -> str:
        return self.name.replace("_", "-")

    def value(self, text: str) -> Any:
        """What a word on the command line means.

        Raises:
            UsageError: it cannot be that option's value.
        """
        if self.optional and text == "none":
            return None
        if self.kind is bool:
            words = {"yes": True, "true": True, "on": True, "": True, "no": False, "false": False, "off": False}
            if text.lower() not in words:
                raise UsageError(f"{self.key} is yes or no, not {text!r}.")
            return words[text.lower()]
        if self.kind is str:
            return text
        try:
            return self.kind(text)
        except ValueError:
            what = "a whole number" if self.kind is int else "a number"
            raise UsageError(f"{self.key} is {what}, not {text!r}.") from None

    def check(self, value: Any) -> None:
        """Raise UsageError unless the option may have that value."""
        if value is None and self.optional:
            return
        if self.choices and value not in self.choices:
            raise UsageError(f"There is no {self.key} {value!r}; there are {', '.join(self.choices)}.")
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if self.kind in (int, float) and not number:
            raise UsageError(f"{self.key} is a number, not {value!r}.")
        low = self.least is not None and number and not value >= self.least
        high = self.most is not None and number and not value <= self.most
        if low or high:
            span = f"from {self.least:g}" if self.least is not None else ""
            span += f" to {self.most:g}" if self.most is not None else ""
            raise UsageError(
                f"{self.key} is a number {span.strip()}{f' {self.unit}' if self.unit else ''}, not {value}."
            )


def described(options: type) -> tuple[Described, ...]:
    """The options that a dataclass declares."""
    hints = get_type_hints(options)
    found = []
    for f in fields(options):
        hint, optional = hints[f.name], False
        if get_origin(hint) in (Union, types.UnionType):
            parts = [part for part in get_args(hint) if part is not type(None)]
            hint, optional = parts[0], True
        kind = hint if hint in (bool, int, float) else str
        default = None if f.default is MISSING else f.default
        m = f.metadata
        found.append(Described(
            f.name, kind, optional, default, m["help"], m["unit"], tuple(m["choices"]), m["least"], m["most"]
        ))  # fmt: skip
    return tuple(found)


def check(options: Any) -> None:
    """Raise UsageError where a field is out of its range: call it in ``__post_init__``."""
    for one in described(type(options)):
        one.check(getattr(options, one.name))


def make(options: type, given: dict[str, str], method: str) -> Any:
    """Options of a method from words.

    Args:
        given: by key, with hyphens or underscores.

    Raises:
        UsageError: there is no such option, or it cannot have that value.
    """
    known = {one.name: one for one in described(options)}
    values = {}
    for key, text in given.items():
        name = key.replace("-", "_")
        if name not in known:
            there = ", ".join(one.key for one in known.values()) or "none"
            raise UsageError(f"{method} has no option {key!r}; it has {there}.")
        values[name] = known[name].value(text)
    return options(**values)


def split(text: str) -> tuple[str, dict[str, str]]:
    """``NAME[,key=value…]`` taken apart: the name, and the values by key; a key alone stands for yes.

    Raises:
        UsageError: there is no name, or a key is given twice.
    """
    name, *parts = (part.strip() for part in text.split(","))
    if not name or "=" in name:
        raise UsageError(f"A method is NAME[,key=value…], not {text!r}.")
    given: dict[str, str] = {}
    for part in parts:
        key, _, value = part.partition("=")
        if not key.strip() or key.strip() in given:
            raise UsageError(f"Each option of a method is given once, as key=value: {text!r}.")
        given[key.strip()] = value.strip()
    return name, given
