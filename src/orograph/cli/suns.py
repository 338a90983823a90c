"""``--sun`` on the command line: ``AZ,ALT`` in degrees, or a moment at the terrain's place.

``@sun_option()`` gives a verb the keyword argument ``sun``: a ``lighting.sun.SunSource``, whose ``over(grid)`` is the
sun.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from orograph.lighting.sun import Moment, Placed

    ParamType = click.ParamType[Any]
else:
    ParamType = click.ParamType

F = TypeVar("F", bound=Callable[..., Any])

HELP = (
    "Where the sun stands: degrees clockwise from grid north and degrees above the horizon (315,45), or a time with "
    "its zone (2026-06-21T12:00+02:00), which means the real sun over the terrain's middle, refraction included."
)


class SunType(ParamType):
    """``AZ,ALT``, or a time with its zone."""

    name = "AZ,ALT|TIME"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Placed | Moment:
        from orograph.errors import UsageError
        from orograph.lighting.sun import Moment, Placed, parse

        if isinstance(value, Placed | Moment):
            return value
        try:
            return parse(str(value))
        except UsageError as error:
            self.fail(str(error), param, ctx)


def sun_option(default: str | None = "315,45") -> Callable[[F], F]:
    """``--sun``; ``default`` None: the verb needs one to be given, or goes without."""
    return click.option("--sun", type=SunType(), default=default, show_default=default is not None, help=HELP)
