"""JSON files that people read and write (views, flights, tours); errors say which file is wrong and where."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from orograph.errors import ReadError, UsageError
from orograph.output import Beside


def parse(text: str) -> Any:
    """What a JSON text holds.

    Raises:
        ValueError: it is not JSON, or nested too deeply for any document of ours.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def write(values: Any, path: str | Path) -> None:
    """Write a JSON file, whole or not at all.

    Raises:
        OutputError: it cannot be written.
    """
    with Beside(Path(path)) as part:
        part.write_text(json.dumps(values, allow_nan=False, indent=2) + "\n", encoding="utf-8")


def load_object(path: str | Path, what: str, holds: str) -> dict[str, Any]:
    """The JSON object in a file.

    Args:
        what: what the file is, for messages: "view".
        holds: what such an object has: "eye, target and fov_y".

    Raises:
        ReadError: the file cannot be read, is not JSON, or no JSON object.
    """
    try:
        values = parse(Path(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ReadError(f"The {what} cannot be read: {error.strerror}.", path=path) from error
    except ValueError as error:
        raise ReadError(f"This is not JSON: {error}.", path=path) from error
    if not isinstance(values, dict):
        raise ReadError(f"A {what} is a JSON object with {holds}.", path=path)
    return values


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Within it a UsageError gets the file's name."""
    try:
        yield
    except UsageError as error:
        raise UsageError(error.what, path=path, remedy=error.remedy) from error


def number(value: Any, what: str) -> float:
    """A finite JSON number.

    Raises:
        UsageError: it is none; the message begins with ``what``.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise UsageError(f"{what} must be a number, not {value!r}.")
    return float(value)
