"""What the measures of ``orograph measure`` share: points, options, the terrain, and how results are printed."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from orograph.cli.files import check_outputs
from orograph.cli.options import (
    FILE,
    F,
    Float,
    Numbers,
    grid_options,
    jobs_option,
    memory_option,
    progress_of,
    source_of,
    source_options,
    vertical_options,
    with_options,
)
from orograph.cli.sections import Verb
from orograph.errors import UsageError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from orograph.measuring import Places
    from orograph.store.terrain import Terrain

POINTS = {"ignore_unknown_options": True, "help_option_names": ["-h", "--help"]}
"""A point may begin with a minus; ``Measure`` reports what begins so and is neither a point nor an option."""


class Point(Numbers):
    """Two numbers separated by a comma."""

    def __init__(self) -> None:
        super().__init__("X,Y")


class Measure(Verb):
    """A measure: an argument that begins with a minus is a point if a number follows, else an option."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        options = [
            name
            for param in self.get_params(ctx)
            for name in (*param.opts, *param.secondary_opts)
            if name.startswith("-")
        ]
        for arg in args:
            name = arg.partition("=")[0]
            if arg == "--":
                break
            if name.startswith("--") and name not in options:
                near = difflib.get_close_matches(name, options)
                raise click.NoSuchOption(name, possibilities=near, ctx=ctx)
            if re.match(r"-[^-\d.]", arg) and arg[:2] not in options:
                raise click.NoSuchOption(arg[:2], ctx=ctx)
        return super().parse_args(ctx, args)


def of_terrain(function: F) -> F:
    """Give a measure the path of a terrain and, after its own options, those that say how to read the terrain.

    These go to ``ctx.obj``, where ``opened`` finds them, and not to the measure.
    """

    def run(**options: Any) -> Any:
        ctx = click.get_current_context()
        obj = {name: options.pop(name) for name in ("path", "max_memory", "jobs")}
        source = source_of({name: options.pop(name) for name in names}, ())
        ctx.obj.update(obj, source=source)
        return function(**options)

    for more in (jobs_option, memory_option, vertical_options, source_options, grid_options("measure")):
        more(run)
    common: list[click.Parameter] = run.__click_params__  # type: ignore[attr-defined]
    names = [str(p.name) for p in common if p.name not in ("max_memory", "jobs")]
    path = click.Argument(["path"], metavar="PATH")
    # Click lists parameters from the last to the first.
    run.__click_params__ = [*common, *function.__click_params__, path]  # type: ignore[attr-defined]
    run.__doc__ = function.__doc__
    return cast(F, run)


def points_option(function: F) -> F:
    """``--lonlat`` and ``--json``."""
    function = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")(function)
    return click.option("--lonlat", "degrees", is_flag=True, help="Points are LON,LAT in degrees instead of E,N.")(
        function
    )


def output_option(what: str) -> Callable[[F], F]:
    """``--output``, which may be repeated."""
    return click.option("--output", "-o", "outputs", type=FILE, multiple=True, metavar="OUT", help=what)


def sight_options(function: F) -> F:
    """The options that line of sight and viewshed share."""
    return with_options(
        function,
        click.option("--eye", type=Float(), default=1.7, show_default=True, metavar="M", help="Height of the eye "
                                                                                              "above ground."),
        click.option("--target", type=Float(), default=0.0, show_default=True, metavar="M",
                     help="Height of the target above ground."),
        click.option("--flat", is_flag=True, help="Ignore the curvature of the body and refraction."),
        click.option("--refraction", type=Float(), default=0.13, show_default=True, metavar="K",
                     help="Curvature of rays relative to that of the ground; 0 without air."),
    )  # fmt: skip


def opened(ctx: click.Context, outputs: tuple[str, ...] = (), others: tuple[str | None, ...] = ()) -> Terrain:
    """The terrain, opened once no output can overwrite it."""
    given = {f"--output {k}" if k > 1 else "--output": path for k, path in enumerate(outputs, 1)}
    check_outputs(
        {**given, "--picture": others[0] if others else None},
        {"the input": [ctx.obj["path"]], "the grid of --geoid": [ctx.obj["source"]["geoid"]]},
    )
    progress = progress_of(ctx)
    with progress.task("Loading Orograph"):
        from orograph.output import check_folder
        from orograph.store.prepare import prepare
    for path in (*outputs, *filter(None, others)):
        check_folder(Path(path))
    return prepare(
        [ctx.obj["path"]], max_memory=ctx.obj["max_memory"], jobs=ctx.obj["jobs"], progress=progress,
        **ctx.obj["source"],
    )  # fmt: skip


def check_points(points: tuple[tuple[float, ...], ...], least: int, what: str, most: int | None = None) -> None:
    """Raise UsageError unless there are as many points as a measure needs."""
    if len(points) < least or (most is not None and len(points) > most):
        count = f"{least}" if most == least else f"at least {least}"
        raise UsageError(f"{what} needs {count} point{'s' if least > 1 else ''}, not {len(points)}.")


def on_terrain(places: Places, points: tuple[tuple[float, ...], ...], degrees: bool) -> NDArray[np.float64]:
    """Points (n, 2) in the terrain's CRS."""
    import numpy as np

    return places.of_lonlat(points) if degrees else np.asarray(points, np.float64)


def kinds(outputs: tuple[str, ...], plots: bool, tables: tuple[str, ...] = (".csv",)) -> None:
    """Raise UsageError for endings other than a table's or a plot's; a missing matplotlib is reported at once."""
    from orograph.measuring.plot import ENDINGS, check_plot

    for path in outputs:
        if Path(path).suffix.lower() in tables:
            continue
        if not plots or Path(path).suffix.lower() not in ENDINGS:
            known = [*tables, *(ENDINGS if plots else ())]
            raise UsageError(f"--output must be a {', '.join(known[:-1])} or {known[-1]}.", path=path)
        check_plot(path)


def tell(ctx: click.Context, terrain: Terrain, told: dict[str, Any], results: Sequence[Any], as_json: bool,
         outputs: tuple[str, ...] = ()) -> None:  # fmt: skip
    """Print measurements, or rows of ``measuring.text``: names and values in columns, or JSON."""
    if as_json:
        from orograph.dem.inspect import crs_text

        crs = terrain.grid.crs
        click.echo(json.dumps({"crs": crs_text(crs), **told, "outputs": list(outputs)},
                              allow_nan=False))  # fmt: skip
        return
    from orograph.measuring.text import lines

    rows = [row for found in results for row in ([found] if isinstance(found, tuple) else lines(found))]
    width = max(len(name) for name, _, _ in rows)
    for name, value, aside in rows:
        click.echo(f"{name:<{width}}  {value}{aside}")
    for path in outputs:
        click.echo(f"{'':<{width}}  {path}")


def without(*names: str) -> Callable[[F], F]:
    """Remove options that ``camera_options`` added."""

    def change(function: F) -> F:
        kept = [p for p in function.__click_params__ if p.name not in names]  # type: ignore[attr-defined]
        function.__click_params__ = kept  # type: ignore[attr-defined]
        return function

    return change
