"""Options that several verbs share, each declared once.

``@file_options`` gives a verb the options of ``orograph.dem.Source.open`` as keyword arguments ``band``, ``nodata``,
``spacing``, ``assume_crs``, ``encoding``, ``vertical_unit`` and ``assume_vertical``; ``@points_options`` those of files
of points, ``@source_options`` both; ``@vertical_options`` gives
``to_vertical`` and ``geoid``, ``@area_options`` ``bbox`` and ``clip``, ``@grid_options(…)`` these, ``crs`` and
``resolution``, ``@memory_option`` ``max_memory`` (bytes, int), ``@jobs_option`` ``jobs`` (int or None: all processors).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import click

from orograph.errors import UsageError
from orograph.folders import parse_bytes

if TYPE_CHECKING:
    from orograph.cli.progress import LineProgress

    ParamType = click.ParamType[Any]
else:
    ParamType = click.ParamType

F = TypeVar("F", bound=Callable[..., Any])

FILE = click.Path(dir_okay=False)

DEFAULT_MEMORY = "1GiB"
LEAST_MEMORY = 64 << 20
MOST_JOBS = 1024
_VERTICALS = ("ellipsoidal", "orthometric")  # orograph.dem.undulation.DIRECTIONS
_ENCODINGS = ("mapbox", "terrarium")  # orograph.dem.encode.ENCODINGS, without importing NumPy for --help


class Bytes(ParamType):
    """An amount of memory."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if isinstance(value, int):
            return value
        try:
            size = parse_bytes(str(value))
        except ValueError as error:
            self.fail(f"{error}.", param, ctx)
        if size < LEAST_MEMORY:
            self.fail(
                f"{value!r} is less than 64MiB, which is too little to work with (write it like 1GiB).", param, ctx
            )
        return size


def grid_options(doing: str, own_resampling: bool = False) -> Callable[[F], F]:
    """Give a verb ``crs`` and ``resolution`` of the grid to bring terrain to, how that is done, and the
    ``area_options``.

    Args:
        doing: what the verb does in that CRS ("draw", "measure"…). own_resampling: it declares ``--resampling``
            itself.
    """
    crs = click.option("--crs", help=f"Projected CRS to {doing} in.  [default: the file's own, or its UTM zone]")
    resolution = click.option(
        "--resolution", type=Float(), metavar="METRES", help="Distance between samples.  [default: the files']"
    )
    how = () if own_resampling else (resampling_option,)
    return lambda function: with_options(function, area_options, crs, resolution, *how)


def resampling_option(function: F) -> F:
    """``--resampling``: how samples come onto another grid."""
    return click.option(
        "--resampling",
        type=click.Choice(["nearest", "bilinear", "cubic"]),
        help="How samples are interpolated if they must be resampled to another grid.  [default: bilinear]",
    )(function)


def area_options(function: F) -> F:
    """``--bbox`` and ``--clip``: the part of the ground that is read."""
    return with_options(
        function,
        click.option("--bbox", type=Numbers("W,S,E,N"), help="Read only this area, in degrees.  [default: all of it]"),
        click.option("--clip", type=FILE, help="Read only the ground in these polygons (GeoJSON)."),
    )


MOST = 1e12
"""The largest number that an option accepts: no sensible metres, seconds or factors exceed it."""


class Float(click.types.FloatParamType):
    """A finite number of at most MOST."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return _number(self, super().convert(value, param, ctx), param, ctx)


class Direction(Float):
    """Degrees clockwise from north, or a point of the compass."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from orograph.scene.bearings import bearing

        try:
            return super().convert(bearing(value), param, ctx)
        except UsageError as error:
            self.fail(str(error), param, ctx)


class Length(Float):
    """A number, or "inf" for no limit."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return math.inf if value in ("inf", math.inf) else super().convert(value, param, ctx)


class FloatRange(click.FloatRange):
    """A number within limits that is not "nan" nor beyond MOST, both of which click accepts."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return _number(self, super().convert(value, param, ctx), param, ctx)


def _number(kind: click.ParamType[Any], value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
    if value is not None and not abs(value) <= MOST:
        kind.fail("nan is not a number." if value != value else f"{value:g} is too large.", param, ctx)
    return value


class Classes(click.ParamType[tuple[int, ...]]):
    """Whole numbers from 0 to 255, separated by commas."""

    name = "N[,N…]"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:  # fmt: skip
        if isinstance(value, tuple):
            return value
        words = str(value).split(",")
        if not all(word.strip().isdigit() and int(word) < 256 for word in words):
            self.fail(f"{value!r} are not classes: give whole numbers from 0 to 255, such as 2,9.", param, ctx)
        return tuple(map(int, words))


class Numbers(ParamType):
    """A fixed count of numbers separated by commas."""

    def __init__(self, names: str, optional: int = 0) -> None:
        self.name, self.optional = names, optional

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        from orograph.scene.given import numbers

        try:
            return numbers(str(value), self.name, self.optional)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Nodata(ParamType):
    """A number as stored in the file, or "none"."""

    name = "number|none"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | float:
        text = str(value).strip().lower()
        try:
            return text if text == "none" or text.lstrip("+-").isdigit() else float(text)
        except ValueError:
            self.fail(f"{value!r} is neither a number nor 'none'.", param, ctx)


def with_options(function: F, *options: Callable[[F], F]) -> F:
    """Give a verb options, which its help lists in this order."""
    for option in reversed(options):
        function = option(function)
    return function


def source_of(options: Mapping[str, Any], own: Collection[str]) -> dict[str, Any]:
    """The options that say how files are read: all that are not the verb's own."""
    source = {name: value for name, value in options.items() if name not in own}
    return {**source, "band": None if source["band"] == 1 else source["band"]}


def source_options(function: F) -> F:
    """Give a verb the options that say how to interpret files of heights and of points."""
    return with_options(function, file_options, points_options)


def file_options(function: F) -> F:
    """Give a verb the options that say how to interpret elevation files."""
    return with_options(
        function,
        click.option(
            "--band", type=click.IntRange(min=1), default=1, show_default=True, help="Which band holds the heights."
        ),
        click.option(
            "--nodata",
            type=Nodata(),
            help="The stored number that means 'no height here', instead of the one that the file declares; 'none': "
            "no number does.",
        ),
        click.option(
            "--spacing",
            type=Float(),
            metavar="METRES",
            help="Distance between samples, for files without georeferencing.  [default: 1]",
        ),
        click.option("--assume-crs", metavar="CRS", help="The CRS of files that declare none, e.g. EPSG:4326."),
        click.option(
            "--encoding",
            type=click.Choice(_ENCODINGS),
            help="Decode heights from the colours of terrain-RGB pictures.",
        ),
        click.option(
            "--vertical-unit",
            metavar="UNIT",
            help="The unit of the heights (m, ft, us-ft, cm…), instead of the one that the file declares.",
        ),
        click.option(
            "--assume-vertical",
            metavar="DATUM",
            help="The vertical datum of files that declare none: EGM96, EGM2008, ellipsoidal, EPSG:5703…",
        ),
    )


def points_options(function: F) -> F:
    """Give a verb the options that say how to interpret files of points."""
    return with_options(
        point_file_options(function),
        click.option(
            "--max-edge",
            type=Length(),
            metavar="METRES",
            help="For points: leave out triangles with a longer side, as missing ground; inf: keep all, even slivers "
            "along the rim.  [default: leave out slivers only]",
        ),
    )


def point_file_options(function: F) -> F:
    """Give a verb the options that say what to read from a file of points."""
    return with_options(
        function,
        click.option(
            "--height-column",
            metavar="NAME",
            help="For points: the column or attribute that holds the heights.  [default: z, height, elevation…]",
        ),
        click.option("--point-layer", metavar="NAME", help="For points: which of several layers of a file."),
        click.option(
            "--point-classes",
            type=Classes(),
            metavar="N[,N…]",
            help="For LAS and LAZ: the classes to read.  [default: 2, the ground; without any, all but noise]",
        ),
    )


def vertical_options(function: F) -> F:
    """Give a verb the options that convert heights to another vertical datum, on request only."""
    for option in (
        click.option(
            "--geoid",
            metavar="GRID",
            help="The geoid grid to convert heights with (egm96_15.gtx, us_nga_egm08_25.tif… from cdn.proj.org).",
        ),
        click.option(
            "--to-vertical",
            type=click.Choice(_VERTICALS),
            help="Convert heights above the geoid to heights above the ellipsoid, or back; needs --geoid.  "
            "[default: heights stay as they are]",
        ),
    ):
        function = option(function)
    return function


def memory_option(function: F) -> F:
    """``--max-memory``: the bytes that a verb may use for its own blocks and caches."""
    return click.option("--max-memory", type=Bytes(), default=DEFAULT_MEMORY, show_default=True, help="Memory limit.")(
        function
    )


def jobs_option(function: F) -> F:
    """``--jobs``: threads; None means all processors."""
    return click.option(
        "--jobs",
        "-j",
        type=click.IntRange(1, MOST_JOBS),
        default=None,
        help="Threads to use.  [default: all processors]",
    )(function)


def cluster_options(doing: str, shared: str = "") -> Callable[[F], F]:
    """``--workers`` and ``--dask``: ``workers`` (int or None) and ``dask`` (an address or None).

    Args:
        doing: "Build". shared: what help says about the workers' memory.
    """
    workers = click.option(
        "--workers", type=click.IntRange(1), metavar="N", help=f"{doing} in this many processes{shared} (Dask)."
    )
    dask = click.option(
        "--dask", metavar="ADDRESS", help=f"{doing} on the workers of this Dask scheduler (tcp://HOST:8786)."
    )
    return lambda function: workers(dask(function))


def sort_last_option(first: str) -> Callable[[F], F]:
    """``--sort-last``. Args: first: what workers draw without it."""
    return click.option(
        "--sort-last",
        is_flag=True,
        help=f"With --workers or --dask: each worker draws a part of the terrain, not {first}; the parts are "
        "composited by depth.",
    )


def progress_of(ctx: click.Context) -> LineProgress:
    """The progress line of this run: silent with ``--quiet``; warnings are collected by the verb in any case."""
    from orograph.cli.progress import LineProgress

    return LineProgress(quiet=bool((ctx.obj or {}).get("quiet", False)))
