"""Options of detail beyond the data."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

from orograph.errors import UsageError

HOW = "detail is fractal, or exemplar=FILE[,seed=N]"


@dataclass(frozen=True, slots=True)
class Detail:
    """The detail to draw between the samples of a terrain (``orograph.synthesis``).

    Attributes:
        exemplar: fine terrain to take the detail from, whatever ``orograph.terrain`` takes; None: fractal noise, as
            rough as the data. seed: each number gives different detail.
    """

    exemplar: Any = None
    seed: int = 1

    @classmethod
    def parse(cls, text: str) -> Detail:
        """Parse ``fractal`` or ``exemplar=FILE``, and ``seed=N``.

        Raises:
            ValueError: it is neither.
        """
        exemplar, seed, parts = None, 1, text.split(",")
        for number, part in enumerate(parts):
            key, equals, value = part.partition("=")
            if key == "exemplar" and value:
                exemplar = value
            elif key == "seed" and value.lstrip("-").isdigit():
                seed = int(value)
            elif number or equals or key != "fractal":
                raise ValueError(f"{HOW}, not {text!r}.")
        return cls(exemplar, seed)

    @property
    def words(self) -> str:
        """The note that pictures carry about it."""
        name = getattr(self.exemplar, "name", self.exemplar)
        if self.exemplar is None:
            return "detail beyond the data is invented: fractal"
        called = os.path.splitext(os.path.basename(name))[0] if isinstance(name, str | os.PathLike) else "an example"  # noqa: PTH119, PTH122
        return f"detail beyond the data is invented, after {called}"


def detail_of(value: Any) -> Detail | None:
    """Detail in any form that users give: a ``Detail``, a text (``Detail.parse``), True (fractal), False or None.

    Raises:
        UsageError: it is none of these.
    """
    if value is None or value is False:
        return None
    if value is True:
        return Detail()
    if isinstance(value, str):
        try:
            return Detail.parse(value)
        except ValueError as error:
            raise UsageError(str(error)) from None
    if not isinstance(value, Detail):
        raise UsageError(f"{HOW}, a Detail, or True; not {value!r}.")
    return value
