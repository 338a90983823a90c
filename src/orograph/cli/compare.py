"""``orograph compare``: every method on the same views or the same flight, measured by the same referee."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orograph.cli import refining
from orograph.cli.camera import Size
from orograph.cli.options import FILE, progress_of
from orograph.documents import parse
from orograph.errors import OrographError, ReadError, UsageError
from orograph.lod.registry import METHODS

if TYPE_CHECKING:
    from orograph.lod.method import Goal
    from orograph.lod.registry import Choice
    from orograph.progress import Progress
    from orograph.store.terrain import Terrain
    from orograph.verify.measure import Measurement
    from orograph.viewpoint import View

JUDGED = 12
"""Frames of a flight that the referee sees unless more are asked for."""


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
@refining.method_option("Which; can be given several times.", multiple=True)
@click.option(
    "--methods", "every", type=click.Choice(["all"]), help="All methods, besides those of --method.  [default]"
)
@refining.goal_options
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
@refining.terrain_options("work")
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], views_path: str | None, flight_path: str | None,
    method: tuple[str, ...], every: str | None, size: tuple[int, int] | None, judged: int | None, json_path: str | None,
    picture: str | None, max_memory: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Measure methods side by side on a DEM (one file or many) or a store.

    For each: triangles, milliseconds to select them (the median), millions of triangles per second, errors in pixels as
    the referee finds them, tiles read, and whether the tolerance is a promise; on a flight also the part of the mesh
    that changes from frame to frame.

    A mesh is judged at every full-resolution sample in view, and on all of the surface between them. Rays are judged by
    the depth of the picture: how far from the surface a pixel's point is, and how many pixels show ground where there
    is none, or none where there is some.

    \b
    Examples:
      orograph compare dem.tif
      orograph compare area.oro --flight flight.json --method roam --method soar --json -
      orograph compare dem.tif --method soar --method soar,metric=isotropic --picture a.png
      orograph compare dem.tif --methods all --method soar,error=wedgie
    """
    began = time.perf_counter()
    progress = progress_of(ctx)
    if views_path is not None and flight_path is not None:
        raise UsageError("Give --views or --flight, not both.")
    if judged is not None and flight_path is None:
        raise UsageError("--judged is about the frames of a --flight; separate views are all judged.")
    json_file = None if json_path in (None, "-") else json_path
    refining.check_written(
        {"--json": json_file, "--picture": picture}, paths, options, views=views_path, flight=flight_path
    )
    with progress.task("Loading Orograph"):
        from orograph.lod.field import check_surface
        from orograph.output import Beside, check_folder
        from orograph.rendering.picture import picture_format
        from orograph.scene.parts import check_exaggeration

        goal = refining.goal_of(options, "tolerance", "triangles")
        choices = _contenders(method, every is not None, options["conservative"], goal, progress)
        refining.check_colors(options, choices)
    check_exaggeration(options["exaggeration"])
    if picture is not None:
        picture_format(Path(picture))
    for file in filter(None, (json_file, picture)):
        check_folder(Path(file))
    terrain = refining.terrain_of(paths, options, (), choices, max_memory, jobs, progress)
    check_surface(terrain)
    views = _views(terrain, views_path, flight_path, size, options["exaggeration"])

    from orograph.verify.measure import measure_flight, measure_views

    found: dict[str, Measurement] = {}
    for choice in choices:
        with progress.task(str(choice), total=len(views)) as task:
            made = refining.make_method(choice, terrain, options, max_memory, jobs, progress)
            about: dict[str, Any] = {"exaggeration": options["exaggeration"], "jobs": jobs, "task": task}
            if flight_path is None:
                found[str(choice)] = measure_views(made, terrain, list(views.values()), goal, **about)
            else:
                found[str(choice)] = measure_flight(
                    made, terrain, list(views.values()), goal, judged=judged or JUDGED, **about
                )
            made.close()
    for label, m in found.items():
        if m.beyond is not None and goal.triangles is not None:
            progress.warn(refining.not_enough(goal.triangles, label, m.beyond))
    if picture is not None:
        drawn = [choice for choice in choices if choice.info.kind != "rays"]
        _draw(Path(picture), terrain, next(iter(views.values())), drawn, goal, options, max_memory, jobs, progress)
    told = {
        "terrain": terrain.name, "shape": list(terrain.grid.shape), goal.name: getattr(goal, goal.name),
        "exaggeration": options["exaggeration"], "flight": flight_path, "frames": len(views),
        "views": {} if flight_path else {k: v.to_dict() for k, v in views.items()},
        "methods": {k: {**asdict(m), "kept": m.kept} for k, m in found.items()}, "picture": picture,
        "seconds_in_all": round(time.perf_counter() - began, 3),
    }  # fmt: skip
    if json_file is not None:
        with Beside(Path(json_file)) as part:
            part.write_text(json.dumps(told, allow_nan=False, indent=2) + "\n", encoding="utf-8")
    if json_path == "-":
        click.echo(json.dumps(told, allow_nan=False))
    else:
        _table(told, found)
    # Where nothing was promised, what is wrong with a mesh is in the table.
    broken = [k for k, m in found.items() if m.kept is False]
    if broken:
        raise OrographError(
            f"What {' and '.join(broken)} promised does not hold.",
            remedy="This is a fault of Orograph: please report it, with the terrain and the views.",
        )


def _contenders(
    given: Sequence[str], every: bool, conservative: bool, goal: Goal, progress: Progress
) -> list[Choice]:  # fmt: skip
    """The methods to measure, each once; of all, those that can reach the goal.

    Raises:
        UsageError: one that is given cannot, or is refused.
    """
    found: dict[str, Choice] = {}
    if every or not given:
        for name in METHODS:
            choice = refining.choice_of(name, conservative)
            if goal.name in choice.info.goals:
                found[str(choice)] = choice
            else:
                progress.note(f"{name} cannot aim at {goal.name} and is left out.")
    for text in given:
        choice = refining.choice_of(text, conservative)
        choice.info.check_goal(goal.name)
        found[str(choice)] = choice
    return list(found.values())


def _views(
    terrain: Terrain, views_path: str | None, flight_path: str | None, size: tuple[int, int] | None, exaggeration: float
) -> dict[str, View]:
    """The views by name; a flight's frames by number."""
    from orograph.touring import moves

    crs = terrain.grid.crs
    if flight_path is not None:
        frames = moves(flight_path, crs=crs).frames()
        views = {str(k): view for k, view in enumerate(frames)}
    elif views_path is not None:
        views = load_views(views_path, crs)
    else:
        from orograph.rendering.comparison import usual_views

        return usual_views(terrain, size or (1280, 720), exaggeration)
    return views if size is None else {k: v.resized(*size) for k, v in views.items()}


def load_views(path: str, crs: Any = None) -> dict[str, View]:
    """A list of views from a JSON file, by their names, or their numbers from 1.

    Raises:
        ReadError: the file cannot be read, or is no list of objects. UsageError: a view is wrong, or two have one name.
    """
    from orograph.viewpoint import View

    try:
        values = parse(Path(path).read_text(encoding="utf-8"))
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
    out: Path, terrain: Terrain, view: View, choices: Sequence[Choice], goal: Goal, options: dict[str, Any],
    max_memory: int, jobs: int | None, progress: Progress,
) -> None:  # fmt: skip
    """Select for the panels of one sheet, judge, draw and write it."""
    import numpy as np

    from orograph import verify
    from orograph.rendering.comparison import Panel, caption, panel_view, sheet
    from orograph.rendering.picture import Picture
    from orograph.viewpoint import Camera

    view = panel_view(view, len(choices))
    panels = []
    with progress.task("Drawing the meshes") as task:
        for choice in choices:
            selection = refining.make_method(choice, terrain, options, max_memory, jobs, progress).select(
                Camera.over(terrain.grid, view, options["exaggeration"]), goal
            )
            mesh = selection.tessellation()
            report = verify.judge_mesh(mesh, terrain, view, exaggeration=options["exaggeration"], jobs=jobs)
            lines, alarm = caption(
                len(mesh.triangles), selection.bound, selection.stats.get("tolerance"), report.largest
            )
            panels.append(Panel(str(choice), mesh, lines, alarm))
            task.note(panels[-1].title)
        asked = f"{goal.triangles:,} triangles" if goal.triangles is not None else f"tolerance {goal.tolerance:g} px"
        rows, cols = terrain.grid.shape
        note = (
            f"{terrain.name}, {cols} × {rows} samples. Each mesh is refined for its panel of {view.width} × "
            f"{view.height} pixels ({asked}); errors are the referee's, over all of the surface in view."
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
    console.print(f"{told['terrain']}, {cols} × {rows} samples; {asked}; {what}", soft_wrap=True)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    table.add_column("method", no_wrap=True)
    errors = ["rms px\nat samples", "largest px\nat samples", "largest px\non surface"]
    errors += ["largest px\nin picture", "wrong\npixels"] * any(m.mismatches is not None for m in found.values())
    heads = ["triangles", "ms", "Mtri/s", *errors, *["change/frame"] * flight, "tiles"]
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("conservative", no_wrap=True)
    for label, m in found.items():
        many = "-" if m.triangles is None else f"{m.triangles:,.0f}"
        pace = "-" if m.mtri_per_s is None else f"{m.mtri_per_s:,.1f}"
        mesh, picture = m.judged and m.mismatches is None, m.mismatches is not None
        pixels = [_px(v) if mesh else "-" for v in (m.rms, m.largest_at_samples, m.largest)]
        pixels += [_px(m.largest_in_picture) if picture else "-", f"{m.mismatches:,}" if picture else "-"]
        cells = [many, f"{m.ms:,.1f}", pace, *pixels[: len(errors)]]
        cells += [f"{100 * m.changes:.2f} %" if m.changes is not None else "-"] * flight + [f"{m.tiles_read:,}"]
        table.add_row(label, *cells, Text(*_promise(m)))
    console.print(table)
    if flight:
        judged = max(m.judged for m in found.values())
        console.print(f"errors over {judged} of {told['frames']} frames", soft_wrap=True)
    for label, m in found.items():
        for defect, n in m.defects.items():
            console.print(f"{label}: {n:,} {defect.replace('_', ' ')}", style="red", soft_wrap=True)


def _px(value: float | None) -> str:
    return "no bound" if value is None else f"{value:.3f}"


def _promise(m: Measurement) -> tuple[str, str]:
    """What the last column says of a method, and its style."""
    if m.conservative and not m.judged:
        return "yes, not judged", "default"
    if m.kept is None:
        return "no", "yellow"
    return ("yes", "green") if m.kept else (f"BROKEN, promised {m.tolerance:g} px", "bold red")
