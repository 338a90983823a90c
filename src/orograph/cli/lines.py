"""Lines on the ground, on the command line: contour lines and silhouettes, for all verbs that draw."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.options import FloatRange, ParamType

if TYPE_CHECKING:
    from orograph.scene.contours import Contours
    from orograph.scene.silhouettes import Silhouettes


class Interval(ParamType):
    """auto, or metres."""

    name = "auto|METRES"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | float:
        if isinstance(value, float) or value == "auto":
            return float(value) if isinstance(value, float) else "auto"
        try:
            metres = float(value)
        except ValueError:
            metres = -1.0
        if not 0 < metres < float("inf"):
            self.fail(f"{value!r} is neither auto nor a number of metres.", param, ctx)
        return metres


LINES = ("contours", "contour_index", "contour_labels", "contour_opacity", "silhouettes", "silhouette_width", "creases")
"""Options of lines on the ground."""

LINE_OPTIONS: tuple[Callable[[Any], Any], ...] = (
    click.option(
        "--contours",
        type=Interval(),
        metavar="auto|METRES",
        help="Draw contour lines; auto: at the interval that suits the relief and the scale.",
    ),
    click.option(
        "--contour-index",
        type=click.IntRange(min=0),
        default=5,
        show_default=True,
        metavar="N",
        help="Every how many contour lines a thick one; 0: none.",
    ),
    click.option(
        "--contour-labels/--no-contour-labels",
        default=True,
        show_default=True,
        help="Whether thick contour lines bear their height.",
    ),
    click.option("--contour-opacity", type=FloatRange(0, 1), default=0.7, show_default=True, help="Of the lines."),
    click.option("--silhouettes", is_flag=True, help="Draw lines along ridges and creases."),
    click.option(
        "--silhouette-width",
        type=FloatRange(0.25, 32),
        default=2.0,
        show_default=True,
        metavar="PX",
        help="Of the nearest ones; farther ones are thinner.",
    ),
    click.option(
        "--creases",
        type=FloatRange(0, 1),
        default=0.6,
        show_default=True,
        help="How heavy silhouettes are where ground turns away and back but hides nothing; 0: none there.",
    ),
)
"""The options themselves."""


def contours_of(options: Mapping[str, Any]) -> Contours | None:
    """The contour lines of a scene, or None."""
    if options["contours"] is None:
        return None
    from orograph.scene.contours import Contours

    interval = None if options["contours"] == "auto" else options["contours"]
    return Contours(
        interval, options["contour_index"], opacity=options["contour_opacity"], labels=options["contour_labels"]
    )


def silhouettes_of(options: Mapping[str, Any]) -> Silhouettes | None:
    """The silhouettes of a scene, or None."""
    if not options["silhouettes"]:
        return None
    from orograph.scene.silhouettes import Silhouettes

    return Silhouettes(options["silhouette_width"], creases=options["creases"])
