"""Options of methods and scenes: each is a field of a dataclass with its help, unit and allowed values.

Each is declared once. ``split`` and ``parse`` read a method's options in the command line's form,
``NAME[,key=value…]``; the window's panel, ``orograph methods``, the table of the manual and ``compare`` show
``described``. A scene's (``scene.parts``) become keyword arguments and options of the command line: their help names
others in backticks, as Python does.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from numbers import Integral, Real
from typing import Any, Union, get_args, get_origin

from orograph.errors import UsageError


def option(
    default: Any, help: str, *, unit: str = "", choices: Sequence[Any] = (), least: float | None = None,
    most: float | None = None, read: Callable[[str], Any] | None = None,
    given: Callable[[Any, Any], Any] | None = None, flag: str | None = "", metavar: str = "", shown: str = "",
    multiple: bool = False, details: type | None = None,
) -> Any:  # fmt: skip
    """A field of an options dataclass.

    Args:
        default: a value, or a function that makes it.
        help: what it does, a sentence.
        unit: of a number ("pixels", "metres"…).
        choices: the allowed values; none: any.
        least, most: the range of a number, ends included.
        read: parses a text, if the option is not yes/no, a number or a word; raises ValueError with the reason.
        given: makes the value from what a user gave and the terrain (``scene.given``).
        flag: its name on the command line if different; None: it is not there.
        metavar: the placeholder of its value in the command line's help.
        shown: the default in words, if the value does not say it.
        multiple: the command line accepts it several times.
        details: the dataclass of its value, whose own options with a flag accompany it on the command line.
    """
    about = {
        "help": help, "unit": unit, "choices": tuple(choices), "least": least, "most": most, "read": read,
        "given": given, "flag": flag, "metavar": metavar, "shown": shown, "multiple": multiple, "details": details,
    }  # fmt: skip
    return (
        field(default_factory=default, metadata=about) if callable(default) else field(default=default, metadata=about)
    )


@dataclass(frozen=True, slots=True)
class Described:
    """One option, for people.

    Attributes:
        name: with underscores, as in Python. key: with hyphens, as on the command line.
        kind: bool, int, float, str, or of another (``read``) tuple; ``optional``: whether it may be None.
        annotation: its type, as written. default: None if a function makes it.
        The others: see ``option``.
    """

    name: str
    kind: type
    optional: bool
    annotation: str
    default: Any
    help: str
    unit: str
    choices: tuple[Any, ...]
    least: float | None
    most: float | None
    read: Callable[[str], Any] | None
    given: Callable[[Any, Any], Any] | None
    flag: str | None
    metavar: str
    shown: str
    multiple: bool
    details: type | None

    @property
    def key(self) -> str:
        return self.flag or self.name.replace("_", "-")

    @property
    def span(self) -> str:
        """The allowed values, in words."""
        if self.kind is bool:
            return "yes or no"
        if self.choices:
            return ", ".join(map(str, self.choices)) + (", none" if self.optional else "")
        words = {int: "a whole number", float: "a number", str: "a word"}.get(self.kind, "see its help")
        if self.least is not None and self.most is not None:
            words += f" from {_limit(self.least)} to {_limit(self.most)}"
        elif self.least is not None:
            words += f", {_limit(self.least)} or more"
        elif self.most is not None:
            words += f", {_limit(self.most)} or less"
        words += f" ({self.unit})" if self.unit else ""
        return words + (", or none" if self.optional else "")

    @property
    def _one_of(self) -> str:
        *others, last = map(str, self.choices)
        return f"{', '.join(others)} or {last}" if others else last

    def text(self, value: Any) -> str:
        """A value in the command line's form."""
        if value is None or value == ():
            return "none"
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, tuple):
            return "+".join(_written(part) for part in value)
        return f"{value:g}" if isinstance(value, float) else str(value)

    def value(self, text: str) -> Any:
        """The meaning of a word on the command line.

        Raises:
            UsageError: it is not a valid value of the option.
        """
        if self.optional and text == "none":
            return None
        if self.default == () and text in ("", "none"):
            return ()
        if self.kind is bool:
            words = {"yes": True, "true": True, "on": True, "": True, "no": False, "false": False, "off": False}
            if text.lower() not in words:
                raise UsageError(f"{self.key} must be yes or no, not {text!r}.")
            return words[text.lower()]
        if self.kind is str:
            return text
        try:
            return self.kind(text) if self.read is None else self.read(text)
        except ValueError as error:
            raise UsageError(
                f"{self.key} must be {self.span}, not {text!r}." if self.read is None else str(error)
            ) from None

    def worded(self, value: Any) -> Any:
        """Convert a value, which may be the command line's text for it.

        Raises:
            UsageError: the text cannot be read.
        """
        if self.read is None or self.kind is str or self.multiple or not isinstance(value, str):
            return value
        try:
            return self.value(value)
        except UsageError as error:
            raise UsageError(f"`{self.name}`: {error.what}", remedy=error.remedy) from error

    def check(self, value: Any, called: str = "") -> None:
        """Raise UsageError unless the option may have that value; ``called``: its name in the error."""
        called = called or self.key
        if value is None and self.optional:
            return
        if self.choices:
            if not any(isinstance(value, type(one)) and value == one for one in self.choices):
                raise UsageError(f"{called} must be {self._one_of}, not {value!r}.")
            return
        wanted = {bool: bool, int: Integral, float: Real, str: str}.get(self.kind, object)
        fits = isinstance(value, wanted) and (self.kind not in (int, float) or not isinstance(value, bool))
        if fits and self.kind in (int, float):
            # (Comparisons with NaN are false.)
            fits = (self.least is None or value >= self.least) and (self.most is None or value <= self.most)
            fits = fits and value == value and abs(value) != float("inf")
        if not fits:
            raise UsageError(f"{called} must be {self.span}, not {value!r}.")


def _limit(value: float) -> str:
    """A limit of a range, with all digits of a whole number."""
    return f"{value:,.0f}" if value == round(value) and abs(value) < 1e15 else f"{value:g}"


def _written(value: tuple[Any, ...]) -> str:
    """A place as numbers, or a line of places, as methods' options have them."""
    if isinstance(value[0], tuple):
        return "/".join(map(_written, value))
    return ":".join(repr(number).removesuffix(".0") for number in value)


def described(options: type) -> tuple[Described, ...]:
    """The options that a dataclass declares."""
    if options not in _DESCRIBED:
        _DESCRIBED[options] = tuple(_described(options))
    return _DESCRIBED[options]


_DESCRIBED: dict[type, tuple[Described, ...]] = {}


def _described(options: type) -> Iterator[Described]:
    for f in fields(options):
        if "help" not in f.metadata:
            continue
        annotation = f.type if isinstance(f.type, str) else getattr(f.type, "__name__", "")
        if get_origin(f.type) in (Union, types.UnionType):
            annotation = " | ".join(getattr(part, "__name__", "") for part in get_args(f.type))
        words = annotation.replace(" | NoneType", " | None").split(" | ")
        kinds = [word for word in words if word != "None"]
        kind = {"bool": bool, "int": int, "float": float, "str": str}.get(kinds[0], tuple) if len(kinds) == 1 else tuple
        default = None if f.default is MISSING else f.default
        yield Described(
            name=f.name, kind=kind, optional="None" in words, annotation=annotation, default=default, **f.metadata
        )


def check(options: Any, called: str = "{0.key}") -> None:
    """Raise UsageError if a field is out of range; called in ``__post_init__``.

    Args:
        called: an option's name in errors, a format of ``Described``.
    """
    for one in described(type(options)):
        one.check(getattr(options, one.name), called.format(one))


def make(options: type, given: Mapping[str, Any], method: str) -> Any:
    """Options of a method.

    Args:
        given: values by name.
        method: its name, for errors.

    Raises:
        UsageError: there is no such option, or its value is invalid.
    """
    known = {one.name: one for one in described(options)}
    for name in given:
        if name not in known:
            there = ", ".join(one.key for one in known.values()) or "none"
            raise UsageError(f"{method} has no option {name.replace('_', '-')!r}; it has {there}.")
    return options(**given)


def parse(options: type, given: Mapping[str, str], method: str) -> Any:
    """As ``make``, from words by key (``split``)."""
    known = {one.key: one for one in described(options)}
    values = {key: known[key].value(text) if key in known else text for key, text in given.items()}
    return make(options, {key.replace("-", "_"): value for key, value in values.items()}, method)


def split(text: str) -> tuple[str, dict[str, str]]:
    """Split ``NAME[,key=value…]`` into the name and the values by key; a key alone means yes.

    Raises:
        UsageError: there is no name, or a key is given twice.
    """
    name, *parts = (part.strip() for part in text.split(","))
    if not name or "=" in name:
        raise UsageError(f"A method must be NAME[,key=value…], not {text!r}.")
    given: dict[str, str] = {}
    for part in parts:
        key, _, value = part.partition("=")
        key = key.strip().replace("_", "-")
        if not key or key in given:
            raise UsageError(f"Give each option of a method once, as key=value: {text!r}.")
        given[key] = value.strip()
    return name, given


def changed(options: Any) -> dict[str, str]:
    """The options that differ from the defaults, by key, in the command line's form."""
    every = ((one, getattr(options, one.name)) for one in described(type(options)))
    return {one.key: one.text(value) for one, value in every if value != one.default}
