"""The texts of shaders: WGSL files that include others, with parts that depend on constants."""

from __future__ import annotations

import re
from importlib.resources import files

_INCLUDE = re.compile(r"^//\s*include:\s*(\S+)\s*$", re.MULTILINE)
_WHEN = re.compile(r"^ *//\s*(when|unless):\s*(\w+)\s*\n(.*?)^ *//\s*end: \2\s*$", re.MULTILINE | re.DOTALL)


def source(name: str, constants: dict[str, int | float] | None = None) -> str:
    """The text of ``shaders/NAME.wgsl`` with its includes and constants.

    ``// include: OTHER.wgsl`` is replaced by that file, once. Lines between ``// when: NAME`` and ``// end: NAME`` are
    left out unless there is a constant of that name that is not 0; those between ``// unless: NAME`` and its end, if
    there is one.
    """
    seen: set[str] = set()
    given = constants or {}

    def chosen(text: str) -> str:
        return _WHEN.sub(lambda m: chosen(m[3]) if (m[1] == "when") == bool(given.get(m[2])) else "", text)

    def load(file: str) -> str:
        if file in seen:
            return ""
        seen.add(file)
        text = files("orograph.gpu").joinpath("shaders", file).read_text(encoding="utf-8")
        return _INCLUDE.sub(lambda m: load(m.group(1)), chosen(text))

    text = load(f"{name}.wgsl")
    for key, value in given.items():
        text = text.replace("{{" + key + "}}", str(value))
    return text
