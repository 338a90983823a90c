"""Describe the methods as text: for ``orograph methods``, ``orograph.methods()`` and the manual.

Everything comes from ``info`` and the options' fields, so a new method is described as soon as it is registered.
"""

from __future__ import annotations

import html
import textwrap
from collections.abc import Sequence
from pathlib import Path

from orograph._named import answering
from orograph.cards import table
from orograph.lod.method import MethodInfo
from orograph.lod.options import described
from orograph.lod.registry import AUTO, METHODS, method_of

WIDTH = 100

KINDS = {
    "triangles": "a mesh of triangles", "patches": "patches of triangles", "batches": "batches of triangles",
    "rings": "nested rings", "rays": "windows for rays: no triangles",
}  # fmt: skip
"""Kinds of selections, in words."""

PAGE = Path(__file__).parents[3] / "docs/methods/README.md"
"""The manual's page, in a checkout."""

BEGIN, END = "<!-- methods: written by python -m orograph.lod.describe -->\n", "\n<!-- end of methods -->"
"""Markers around the table in the manual."""


class Said(str):
    """A text that prints as such, and in notebooks as a table if it has ``rows`` (headings first)."""

    rows: Sequence[Sequence[str]] = ()

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        return table(self.rows) if self.rows else f"<pre>{html.escape(self)}</pre>"


@answering
def methods(name: str | None = None) -> Said:
    """The list of methods, or a method's options with their help and units, as a text.

    Args:
        name: of a method; None: all of them.

    Raises:
        UsageError: there is no method of that name.
    """
    said = Said(about_all() if name is None else about(name))
    said.rows = _rows(_infos()) if name is None else _options(method_of(name).info)
    return said


def _rows(infos: Sequence[MethodInfo]) -> list[tuple[str, ...]]:
    head = ("method", "the idea", "selects", "promise", "source")
    return [head, *((i.name, i.title, i.kind, _promise(i), i.paper) for i in infos)]


def _options(info: MethodInfo) -> list[tuple[str, ...]]:
    head = ("option", "what it does", "values", "default")
    return [head, *((one.key, one.help, one.span, one.text(one.default)) for one in described(info.options))]


def about_all() -> str:
    """A paragraph on each method."""
    parts = [f"{info.name}\n{_filled(f'{info.title}. {info.paper}.')}" for info in _infos()]
    auto = ", ".join(f"{name} on the {backend.upper()}" for backend, name in AUTO.items())
    return "\n".join([*parts, "", _filled(f"auto is {auto}. Options: orograph methods NAME.", "")])


def about(name: str) -> str:
    """A method's paper and promise, and its options.

    Raises:
        UsageError: there is no method of that name.
    """
    info = method_of(name).info
    lines = [
        f"{info.name}: {info.title}.", f"Source: {info.paper}.", f"It selects {KINDS[info.kind]}.",
        _promise_in_words(info),
        *([] if info.conforming else ["Its meshes may have cracks."]),
        "It continues from the previous frame." if info.incremental else "Every frame starts from scratch.",
        f"Possible goals: {', '.join(info.goals)}.",
    ]  # fmt: skip
    text = "\n".join(_filled(line, "") for line in lines)
    options = described(info.options)
    if not options:
        return f"{text}\n\nIt has no options."
    text += f'\n\nOptions, as `method="{info.name},key=value"`:'
    for one in options:
        head = f"{one.key}: {one.span}  [default: {one.text(one.default)}]"
        text += f"\n  {head}\n{_filled(one.help)}"
    return text


def markdown() -> str:
    """The manual's table, which ``PAGE`` has between ``BEGIN`` and ``END``."""
    rows = [
        "| method | the idea | selects | from one frame to the next | promise | source |",
        "|---|---|---|---|---|---|",
    ]
    for info in _infos():
        rows.append(
            f"| [`{info.name}`]({info.name}.md) | {info.title} | {info.kind} | "
            f"{'goes on' if info.incremental else 'begins anew'} | "
            f"{_promise(info)} | {info.paper} |"
        )
    return "\n".join(rows)


def _infos() -> list[MethodInfo]:
    return [method_of(name).info for name in METHODS]


def _promise(info: MethodInfo) -> str:
    """Whether a method promises its tolerance, for a table."""
    if info.conservative(info.options()):
        return "yes"
    options = ",".join(f"{key}={value}" for key, value in info.promising.items())
    return f"with {options}" if options else "no"


def _promise_in_words(info: MethodInfo) -> str:
    promise = _promise(info)
    if promise == "yes":
        return "With the default options the tolerance is promised for every sample in view."
    return f"With the default options the tolerance is not promised{'' if promise == 'no' else f'; {promise} it is'}."


def _filled(text: str, indent: str = "    ") -> str:
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=indent)


if __name__ == "__main__":
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(before + BEGIN + markdown() + END + rest.partition(END)[2], encoding="utf-8")
