"""``orograph compare``: every method on the same views or the same flight, measured by the same referee."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orograph.cli import refining
from orograph.cli.camera import SIZES, Size
from orograph.cli.options import FILE, progress_of, source_of
from orograph.cli.sections import Verb
from orograph.errors import OrographError

if TYPE_CHECKING:
    from orograph.verbs.compare import Comparison
    from orograph.verify.measure import Measurement


@click.command("compare", cls=Verb)
@click.argument("paths", nargs=-1, required=True, metavar="PATH...")
@click.option(
    "--views",
    type=FILE,
    metavar="FILE",
    help="A JSON list of views (like VIEW.json, each with an optional name).  [default: an overview, a low oblique "
    "view, straight down]",
)
@click.option(
    "--flight",
    type=FILE,
    metavar="FILE",
    help='Compare frame by frame along a flight instead: {"fps": 60, "seconds": 5, "keys": [{"time": 0, "eye": …, '
    '"target": …}, …]}.',
)
@refining.method_option("Which method to compare; may be repeated.", multiple=True)
@click.option(
    "--methods",
    "every",
    metavar="all|NAME,NAME…",
    help="All methods, or these, besides those of --method.  [default: all, without --method]",
)
@refining.goal_options
@click.option("--size", type=Size(), help=f"The views' size{SIZES}.  [default: 1280x720, or the files']")
@click.option(
    "--judged",
    type=click.IntRange(min=1),
    metavar="N",
    help="Frames of a flight that the referee judges, evenly spread.  [default: 12]",
)
@click.option("--json", "json_path", metavar="OUT|-", help="Write the table as JSON; - prints it instead of the text.")
@click.option("--picture", type=FILE, metavar="OUT.png", help="Draw the first view's meshes side by side.")
@refining.terrain_options("work")
@click.pass_context
def command(
    ctx: click.Context, /, paths: tuple[str, ...], views: str | None, flight: str | None,
    method: tuple[str, ...], every: str | None, size: tuple[int, int] | None, judged: int | None, json_path: str | None,
    picture: str | None, max_memory: int, jobs: int | None, **options: Any,
) -> None:  # fmt: skip
    """Measure methods side by side on a DEM (one file or many) or a store.

    For each: triangles, milliseconds to select them (the median), millions of triangles per second, errors in pixels as
    the referee finds them, tiles read, and whether the tolerance is promised; on a flight also the part of the mesh
    that changes from frame to frame.

    A mesh is judged at every full-resolution sample in view, and on all of the surface between them. Rays are judged by
    the depth of the picture: how far a pixel's point is from the surface, and how many pixels wrongly show ground or
    wrongly show none.

    \b
    Examples:
      orograph compare dem.tif
      orograph compare area.oro --flight flight.json --method roam --method soar --json -
      orograph compare dem.tif --method soar --method soar,metric=isotropic --picture a.png
      orograph compare dem.tif --methods all --method soar,error=wedgie
    """
    began = time.perf_counter()
    progress = progress_of(ctx)
    json_file = None if json_path in (None, "-") else json_path
    refining.check_written({"--json": json_file, "--picture": picture}, paths, options, views=views, flight=flight)
    with progress.task("Loading Orograph"):
        from orograph.documents import write
        from orograph.output import check_folder
        from orograph.verbs.compare import compare
    if json_file is not None:
        check_folder(Path(json_file))
    refine = {name: options[name] for name in refining.REFINE}
    found = compare(
        list(paths), views, flight=flight, judged=judged, methods=(*([every] if every else []), *method),
        size=size, picture=picture, max_memory=max_memory, jobs=jobs, progress=progress,
        **refine, **source_of(options, set(refining.REFINE)),
    )  # fmt: skip
    facts = _facts(found) | {"picture": picture, "seconds_in_all": round(time.perf_counter() - began, 3)}
    if flight is not None:
        facts["flight"] = flight
    if json_file is not None:
        write(facts, json_file)
    if json_path == "-":
        click.echo(json.dumps(facts, allow_nan=False))
    else:
        _table(facts, found)
    # Without a promise, the table says what is wrong with a mesh.
    if found.broken:
        raise OrographError(
            f"{' and '.join(found.broken)} broke the promised tolerance.",
            remedy="This is a fault of the method: please report it, with the terrain and the views.",
        )


def _facts(found: Comparison) -> dict[str, Any]:
    """The methods and what they were measured on, for the JSON."""
    terrain, goal = found.terrain, found.goal
    return {
        "terrain": terrain.name, "shape": list(terrain.grid.shape), goal.name: getattr(goal, goal.name),
        "exaggeration": found.exaggeration, "flight": None, "frames": len(found.views),
        "views": {} if found.flight else {k: v.to_dict() for k, v in found.views.items()},
        "methods": {k: {**asdict(m), "kept": m.kept} for k, m in found.items()}, "left_out": found.left_out,
    }  # fmt: skip


def _table(facts: dict[str, Any], found: Comparison) -> None:
    """Print the table; as plain text on a pipe."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(file=sys.stdout, highlight=False)
    if not console.is_terminal:
        console = Console(file=sys.stdout, highlight=False, width=160, no_color=True)
    flight = facts["flight"] is not None
    rows, cols = facts["shape"]
    asked = (
        f"tolerance {facts['tolerance']:g} px" if "tolerance" in facts else f"at most {facts['triangles']:,} triangles"
    )
    what = f"{facts['frames']} frames" if flight else ", ".join(facts["views"])
    console.print(f"{facts['terrain']}, {cols} × {rows} samples; {asked}; {what}", soft_wrap=True)
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
        console.print(f"errors over {judged} of {facts['frames']} frames", soft_wrap=True)
    for label, m in found.items():
        for defect, n in m.defects.items():
            console.print(f"{label}: {n:,} {defect.replace('_', ' ')}", style="red", soft_wrap=True)


def _px(value: float | None) -> str:
    return "no bound" if value is None else f"{value:.3f}"


def _promise(m: Measurement) -> tuple[str, str]:
    """The last column for a method, and its style."""
    if m.conservative and not m.judged:
        return "yes, not judged", "default"
    if m.kept is None:
        return "no", "yellow"
    return ("yes", "green") if m.kept else (f"BROKEN, promised {m.tolerance:g} px", "bold red")
