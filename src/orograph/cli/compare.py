"""``orograph compare``: every engine on the same views or the same flight, measured by the same referee."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orograph.cli.camera import Size
from orograph.cli.engines import REFINE, check_colors, color_errors, goal_of, make_engine, not_enough, refine_options
from orograph.cli.files import check_outputs
from orograph.cli.options import (
    FILE,
    ParamType,
    grid_options,
    jobs_option,
    memory_option,
    progress_of,
    source_options,
    vertical_options,
)
from orograph.errors import OrographError, ReadError, UsageError
from orograph.lod import ENGINES, engine_of

if TYPE_CHECKING:
    from orograph.progress import Progress
    from orograph.store.terrain import Terrain
    from orograph.verify.measure import Measurement
    from orograph.view import View

OWN = {*REFINE, "exaggeration"}
"""What is said about the meshes; all other options are about reading."""

JUDGED = 12
"""Frames of a flight that the referee sees unless more are asked for."""

Contender = tuple[str, str | None]


class Engines(ParamType):
    """all, or names separated by commas, each with a metric behind a colon if it is not to be the engine's own."""

    name = "all|NAME,NAME:METRIC…"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list[Contender]:
        if isinstance(value, list):
            return value
        if value == "all":
            return [(name, None) for name in ENGINES]
        found: list[Contender] = []
        for part in str(value).split(","):
            name, _, metric = part.strip().partition(":")
            if name not in ENGINES:
                self.fail(f"there is no engine {name!r}; there are {', '.join(ENGINES)}.", param, ctx)
            if (name, metric or None) not in found:
                found.append((name, metric or None))
        return found


@click.command("compare")
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "--views",
    "views_path",
    type=FILE,
    metavar="FILE",
    help="A JSON list of views (as VIEW.json, each with a name if you like).  "
    "[default: an overview, a low oblique view, straight down]",
)
@click.option(
    "--flight",
    "flight_path",
    type=FILE,
    metavar="FILE",
    help='Frame by frame instead: {"fps": 60, "seconds": 5, "keys": [{"time": 0, "eye": …, "target": …}, …]}.',
)
@click.option(
    "--engines",
    type=Engines(),
    default="all",
    show_default=True,
    metavar="NAMES",
    help="Which, separated by commas; NAME:METRIC for another metric than its own.",
)
@refine_options
@click.option(
    "--exaggeration", type=float, default=1.0, show_default=True, metavar="X", help="Stretch heights on the screen."
)
@click.option("--size", type=Size(), help="The views' size in pixels.  [default: 1280x720, or the files']")
@click.option(
    "--judged",
    type=click.IntRange(min=1),
    metavar="N",
    help="Frames of a flight that the referee sees, evenly spread.  [default: 12]",
)
@click.option(
    "--json", "json_path", metavar="OUT|-", help="Write the table as JSON; - is stdout, in place of the text."
)
@click.option("--picture", type=FILE, metavar="OUT.png", help="Draw the first view's meshes side by side.")
@grid_options("work")
@source_options
@vertical_options
@memory_option
@jobs_option
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], views_path: str | None, flight_path: str | None,
    engines: list[Contender], size: tuple[int, int] | None, judged: int | None, json_path: str | None,
    picture: str | None, max_memory: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Measure the engines side by side on a DEM (one file or many) or a store.

    For each: triangles, milliseconds to refine (the median), millions of triangles per second, the largest and the rms
    error in pixels over every full-resolution sample in view, as the referee finds them, tiles read, and whether the
    tolerance is a promise; on a flight also the part of the mesh that changes from frame to frame.

    \b
    Examples:
      orograph compare dem.tif
      orograph compare area.oro --flight flight.json --engines roam,soar --json -
      orograph compare dem.tif --engines roam,soar,soar:isotropic --triangles 5000 --picture a.png
    """
    began = time.perf_counter()
    progress = progress_of(ctx)
    if views_path is not None and flight_path is not None:
        raise UsageError("Give --views or --flight, not both.")
    if judged is not None and flight_path is None:
        raise UsageError("--judged is about the frames of a --flight; separate views are all judged.")
    check_colors(options)
    goal = goal_of(options, "tolerance", "triangles")
    json_file = None if json_path in (None, "-") else json_path
    check_outputs(
        {"--json": json_file, "--picture": picture},
        {"the input": paths, "the image of --drape": [options["drape"]], "the file of --views": [views_path],
         "the file of --flight": [flight_path], "the grid of --geoid": [options["geoid"]]},
    )  # fmt: skip
    source = {k: v for k, v in options.items() if k not in OWN}
    if source["band"] == 1:
        source["band"] = None
    with progress.task("Loading Orograph"):
        from orograph.lod.field import check_surface
        from orograph.output import Beside, check_folder
        from orograph.picture.prepare import prepare
        from orograph.picture.result import picture_format
        from orograph.picture.scene import check_exaggeration

        for name, metric in engines:
            engine_of(name).usable_metric(metric)
    check_exaggeration(options["exaggeration"])
    if picture is not None:
        picture_format(Path(picture))
    for file in filter(None, (json_file, picture)):
        check_folder(Path(file))
    terrain = prepare(list(paths), max_memory=max_memory, jobs=jobs, progress=progress, **source)
    check_surface(terrain)
    views = _views(terrain, views_path, flight_path, size, options["exaggeration"])
    color = color_errors(terrain, options, max_memory, jobs, progress)
    if color is not None and {name for name, _ in engines} == set(ENGINES):
        for name in [name for name in ENGINES if not engine_of(name).takes_colors]:
            progress.note(f"{name} heeds no colours and is left out.")
            engines = [contender for contender in engines if contender[0] != name]

    from orograph.verify.measure import measure_flight, measure_views

    found: dict[str, Measurement] = {}
    for name, metric in engines:
        label = f"{name}:{metric}" if metric else name
        with progress.task(label, total=len(views)) as task:
            engine = make_engine(name, terrain, options, color=color, max_memory=max_memory, jobs=jobs, metric=metric)
            about: dict[str, Any] = {"exaggeration": options["exaggeration"], "jobs": jobs, "task": task}
            if flight_path is None:
                found[label] = measure_views(engine, terrain, list(views.values()), goal, **about)
            else:
                found[label] = measure_flight(
                    engine, terrain, list(views.values()), goal, judged=judged or JUDGED, **about
                )
    for label, m in found.items():
        if m.beyond is not None:
            progress.warn(not_enough(goal["triangles"], label, m.beyond))
    if picture is not None:
        _draw(
            Path(picture),
            terrain,
            next(iter(views.values())),
            engines,
            goal,
            options,
            color,
            max_memory,
            jobs,
            progress,
        )
    told = {
        "terrain": terrain.name, "shape": list(terrain.grid.shape), **goal, "error": options["error"],
        "exaggeration": options["exaggeration"], "flight": flight_path, "frames": len(views),
        "views": {} if flight_path else {k: v.to_dict() for k, v in views.items()},
        "engines": {k: {**asdict(m), "kept": m.kept} for k, m in found.items()}, "picture": picture,
        "seconds_in_all": round(time.perf_counter() - began, 3),
    }  # fmt: skip
    if json_file is not None:
        with Beside(Path(json_file)) as part:
            part.write_text(json.dumps(told, allow_nan=False, indent=2) + "\n", encoding="utf-8")
    if json_path == "-":
        click.echo(json.dumps(told, allow_nan=False))
    else:
        _table(told, found)
    # Under a budget without a bound nothing was promised; what is wrong with such a mesh is in the table.
    broken = [k for k, m in found.items() if m.kept is False or (m.defects and "tolerance" in goal)]
    if broken:
        raise OrographError(
            f"What {' and '.join(broken)} promised does not hold.",
            remedy="This is a fault of Orograph: please report it, with the terrain and the views.",
        )


def _views(
    terrain: Terrain, views_path: str | None, flight_path: str | None, size: tuple[int, int] | None, exaggeration: float
) -> dict[str, View]:
    """The views by name; a flight's frames by number."""
    from orograph.tour import moves

    crs = terrain.grid.crs
    if flight_path is not None:
        frames = moves(flight_path, crs=crs).frames()
        views = {str(k): view for k, view in enumerate(frames)}
    elif views_path is not None:
        views = load_views(views_path, crs)
    else:
        from orograph.picture.comparison import usual_views

        return usual_views(terrain, size or (1280, 720), exaggeration)
    return views if size is None else {k: v.resized(*size) for k, v in views.items()}


def load_views(path: str, crs: Any = None) -> dict[str, View]:
    """A list of views from a JSON file, by their names, or their numbers from 1.

    Raises:
        ReadError: the file cannot be read, or is no list of objects. UsageError: a view is wrong, or two have one name.
    """
    from orograph.view import View

    try:
        values = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ReadError(f"The views cannot be read: {error.strerror}.", path=path) from error
    except ValueError as error:
        raise ReadError(f"This is not JSON: {error}.", path=path) from error
    if not isinstance(values, list) or not values or not all(isinstance(v, dict) for v in values):
        raise ReadError("Views are a JSON list of objects, each as a VIEW.json; there is at least one.", path=path)
    views: dict[str, View] = {}
    for i, value in enumerate(values, 1):
        name = str(value.get("name", i))
        if name in views:
            raise UsageError(f"Two views are called {name!r}.", path=path)
        try:
            views[name] = View.from_dict({k: v for k, v in value.items() if k != "name"}, crs=crs)
        except UsageError as error:
            raise UsageError(f"View {name}: {error.what}", path=path, remedy=error.remedy) from error
    return views


def _draw(
    out: Path, terrain: Terrain, view: View, engines: Sequence[Contender], goal: dict[str, Any],
    options: dict[str, Any], color: Any, max_memory: int, jobs: int | None, progress: Progress,
) -> None:  # fmt: skip
    """Refine for the panels of one sheet, judge, draw and write it."""
    import numpy as np

    from orograph import verify
    from orograph.picture.comparison import Panel, caption, panel_view, sheet
    from orograph.picture.result import Picture

    view = panel_view(view, len(engines))
    panels = []
    with progress.task("Drawing the meshes") as task:
        for name, metric in engines:
            engine = make_engine(name, terrain, options, color=color, max_memory=max_memory, jobs=jobs, metric=metric)
            mesh = engine.refine(view, **goal)
            report = verify.judge_mesh(mesh, terrain, view, exaggeration=options["exaggeration"], jobs=jobs)
            lines, alarm = caption(mesh.stats, report.largest_at_samples)
            panels.append(Panel(f"{name}:{metric}" if metric else name, mesh, lines, alarm))
            task.note(panels[-1].title)
        asked = f"tolerance {goal['tolerance']:g} px" if "tolerance" in goal else f"{goal['triangles']:,} triangles"
        rows, cols = terrain.grid.shape
        note = (
            f"{terrain.name}, {cols} × {rows} samples. Each mesh is refined for its panel of {view.width} × "
            f"{view.height} pixels ({asked}); errors are the referee's, over every full-resolution sample in view."
        )
        pixels = sheet(
            terrain, view, panels, note=note,
            title=f"The same view, {asked}" if len(panels) > 1 else f"{terrain.name}, {asked}",
            exaggeration=options["exaggeration"], jobs=jobs,
        )  # fmt: skip
        task.note("")
    Picture(pixels, np.empty((0, 0), np.float32), view).save(out)


def _table(told: dict[str, Any], found: dict[str, Measurement]) -> None:
    """Print the table; plain text on a pipe."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(file=sys.stdout, highlight=False)
    if not console.is_terminal:
        console = Console(file=sys.stdout, highlight=False, width=160, no_color=True)
    flight = told["flight"] is not None
    rows, cols = told["shape"]
    asked = f"tolerance {told['tolerance']:g} px" if "tolerance" in told else f"at most {told['triangles']:,} triangles"
    what = f"{told['frames']} frames" if flight else ", ".join(told["views"])
    console.print(f"{told['terrain']}, {cols} × {rows} samples; {asked}, {told['error']} error; {what}", soft_wrap=True)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    table.add_column("engine", no_wrap=True)
    heads = ["triangles", "ms", "Mtri/s", "largest px", "rms px"] + ["change/frame"] * flight + ["tiles"]
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("conservative", no_wrap=True)
    for label, m in found.items():
        cells = [f"{m.triangles:,.0f}", f"{m.ms:,.1f}", f"{m.mtri_per_s:,.1f}", _px(m.largest), _px(m.rms)]
        cells += [f"{100 * m.changes:.2f} %" if m.changes is not None else "-"] * flight + [f"{m.tiles_read:,}"]
        table.add_row(label, *cells, Text(*_promise(m)))
    console.print(table)
    if flight:
        judged = next(iter(found.values())).judged
        console.print(f"errors over {judged} of {told['frames']} frames", soft_wrap=True)
    for label, m in found.items():
        for defect, n in m.defects.items():
            console.print(f"{label}: {n:,} {defect.replace('_', ' ')}", style="red", soft_wrap=True)


def _px(value: float | None) -> str:
    return "no bound" if value is None else f"{value:.3f}"


def _promise(m: Measurement) -> tuple[str, str]:
    """What the last column says of an engine, and its style."""
    if m.kept is None:
        return "no", "yellow"
    return ("yes", "green") if m.kept else (f"BROKEN, promised {m.tolerance:g} px", "bold red")
