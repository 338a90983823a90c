"""Parameter types of ``orograph build`` that are not plain numbers or words."""

from __future__ import annotations

import click


class ErrorKinds(click.ParamType[tuple[str, ...]]):
    """Kinds of errors separated by commas, or "none"; converted to a tuple of names."""

    name = "KINDS"

    def convert(
        self, value: str | tuple[str, ...], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        from orograph.error import KINDS

        if not isinstance(value, str):
            return value
        wanted = () if value == "none" else tuple(word.strip() for word in value.split(","))
        for word in wanted:
            if word not in KINDS:
                self.fail(f"{word!r} is not one of {', '.join(KINDS)}, none.", param, ctx)
        return wanted


class MaxError(click.ParamType[str | float]):
    """A number of metres, or a word."""

    name = "METRES"

    def convert(self, value: str | float, param: click.Parameter | None, ctx: click.Context | None) -> str | float:
        if value in ("lossless", "auto"):
            return value
        try:
            return float(value)
        except ValueError:
            self.fail(f"{value!r} is neither lossless, auto nor a number of metres.", param, ctx)
