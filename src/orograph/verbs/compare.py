"""``orograph.compare``: compare methods on the same views or the same flight, measured by the same referee."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orograph import verify
from orograph._named import answering
from orograph.compiling import expect
from orograph.documents import parse
from orograph.errors import ReadError, UsageError
from orograph.flight import Flight
from orograph.folders import Amount, bytes_of
from orograph.lod.method import Goal, Resources, check_surface
from orograph.lod.needs import kinds_of
from orograph.lod.registry import METHODS, Choice
from orograph.output import check_folder
from orograph.progress import Progress, Task
from orograph.rendering.comparison import Panel, caption, panel_view, sheet, usual_views
from orograph.rendering.picture import Picture, picture_format
from orograph.reporting import reporting
from orograph.scene.methods import MEMORY, made
from orograph.scene.parts import check_exaggeration
from orograph.scene.sizes import Size, dpi_of, size_of
from orograph.store.opening import terrain as opened
from orograph.store.terrain import Terrain
from orograph.touring import Tour, moves
from orograph.verbs.goals import check_colors, choice_of, goal_of, not_enough
from orograph.verify.measure import Measurement, measure_flight, measure_views
from orograph.viewpoint import Camera, View

COLUMNS: dict[str, Callable[[Measurement], str]] = {
    "triangles": lambda m: "-" if m.triangles is None else f"{m.triangles:,.0f}", "ms": lambda m: f"{m.ms:,.1f}",
    "rms px": lambda m: _pixels(m.rms), "largest px": lambda m: _pixels(m.largest),
    "conservative": lambda m: "yes" if m.conservative else "no",
}  # fmt: skip
"""The columns of a table of measurements, and their formats."""

SIZE = (1280, 720)
"""Size of the default views, pixels."""

JUDGED = 12
"""Default number of frames of a flight that the referee judges."""


class Comparison(dict[str, Measurement]):
    """Measurements by method, which read as a table.

    Attributes:
        terrain: its name. goal: the goal that was given. exaggeration: of heights on the screen.
        views: the cameras by name; of a flight its frames by number. flight: whether they are a flight's.
        left_out: methods that cannot be measured here (one that needs more memory than is allowed), and why.
    """

    def __init__(self, terrain: Terrain, goal: Goal, views: dict[str, View], flight: bool, exaggeration: float) -> None:
        super().__init__()
        self.terrain, self.goal, self.views, self.flight = terrain, goal, views, flight
        self.exaggeration = exaggeration
        self.left_out: dict[str, str] = {}

    @property
    def broken(self) -> list[str]:
        """Methods that broke their promise: a fault of theirs."""
        return [name for name, m in self.items() if m.kept is False]

    def rows(self) -> list[list[str]]:
        """The table's cells, headings first."""
        return [
            ["method", *COLUMNS],
            *([name, *(text_of(m) for text_of in COLUMNS.values())] for name, m in self.items()),
        ]

    def __repr__(self) -> str:
        rows = self.rows()
        wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return "\n".join(
            "  ".join([row[0].ljust(wide[0]), *(cell.rjust(w) for cell, w in zip(row[1:], wide[1:], strict=True))])
            for row in rows
        )

    def _repr_html_(self) -> str:
        from orograph.cards import table

        return table(self.rows())


@dataclass(frozen=True, slots=True)
class _Means:
    """What methods are created with."""

    terrain: Terrain
    goal: Goal
    drape: Any
    exaggeration: float
    max_memory: int
    jobs: int | None
    progress: Progress

    def method(self, choice: Choice) -> Any:
        return made(choice, self.terrain, Resources(self.max_memory // 2, self.jobs, self.progress), self.drape)


@answering
def compare(
    terrain: Any,
    views: Sequence[View] | Mapping[str, View] | str | os.PathLike[str] | None = None,
    *,
    flight: Flight | Tour | str | os.PathLike[str] | None = None,
    judged: int | None = None,
    methods: Sequence[str] | str = (),
    tolerance: float | None = None,
    triangles: int | None = None,
    conservative: bool = False,
    drape: Any = None,
    exaggeration: float = 1.0,
    size: Size | None = None,
    picture: str | os.PathLike[str] | None = None,
    max_memory: Amount | None = None,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    **reading: Any,
) -> Comparison:
    """Measure methods side by side on a terrain: triangles, milliseconds, errors in pixels as the referee finds them.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options (``reading``).
        views: the cameras, or the path of a JSON list of them; None: an overview, a low oblique view, straight down.
        flight: compare frame by frame along a flight, a tour, or the path of one. judged: how many of its frames the
            referee judges, evenly spread; None: 12.
        methods: which, NAME[,key=value…]; "all", or none: all that can reach the goal.
        tolerance: pixels; None: 1, unless ``triangles`` (at most this many) are the goal.
        conservative: as of ``tessellate``, for each method.
        drape: the image whose colours a method's color-tolerance looks at; the picture shows it.
        exaggeration: how heights are stretched on the screen.
        size: of the views, pixels, or on paper ("16x9cm@300"); None: their own; of the default views, 1280 × 720.
        picture: also draw the first view's meshes side by side, into this file.
        max_memory: bytes that heights may take. jobs: threads. progress: gets progress reports; False: silent.

    Returns:
        a ``verify.measure.Measurement`` by method; they print as a table. Of several methods, those that cannot be
        measured here are left out, with a warning.

    Raises:
        UsageError: there is no such method, or it cannot reach the goal; none can be measured here. ReadError,
            StoreError: the terrain, or a file of views, cannot be read. OutputError: the picture cannot be written.
    """
    max_memory, size = bytes_of(max_memory), None if size is None else size_of(size)
    heard, goal = reporting(progress), goal_of(tolerance=tolerance, triangles=triangles)
    if views is not None and flight is not None:
        raise UsageError("Give `views` or `flight`, not both.")
    if judged is not None and flight is None:
        raise UsageError("`judged` applies to the frames of a `flight`; separate views are all judged.")
    choices = _contenders([methods] if isinstance(methods, str) else methods, conservative, goal, heard)
    check_colors(drape, choices)
    check_exaggeration(exaggeration)
    drawn = [str(choice) for choice in choices if choice.info.kind != "rays"] if picture is not None else []
    if picture is not None:
        if not drawn:
            raise UsageError("`picture` draws meshes, and rays make none.", remedy="Name a method that makes one.")
        picture_format(Path(picture))
        check_folder(Path(picture))
    errors = kinds_of(need for choice in choices for need in choice.method.needs(choice.options))
    expect("compare")
    ground = opened(terrain, heard, max_memory=max_memory, jobs=jobs, errors=errors, called="compare", **reading)
    check_surface(ground)
    seen = _views(ground, views, flight, size, exaggeration)
    means = _Means(ground, goal, drape, exaggeration, max_memory or MEMORY, jobs, heard)
    found, judges = Comparison(ground, goal, seen, flight is not None, exaggeration), judged or JUDGED
    view = panel_view(next(iter(seen.values())), len(drawn))
    panels: list[Panel] = []
    for choice in choices:
        try:
            if conservative:
                choice.check_promise(ground)
            with heard.task(str(choice), total=len(seen)) as task, closing(means.method(choice)) as method:
                found[str(choice)] = _measured(method, means, found, judges, task)
                if str(choice) in drawn:
                    panels.append(_panel(method, str(choice), means, view))
        except UsageError as error:
            if not found and choice is choices[-1]:
                raise
            found.left_out[str(choice)] = str(error)
            if str(choice) in drawn:
                panels.append(Panel(str(choice), None, ("left out",), True))
            heard.warn(f"{choice} is left out: {error}")
    for name, m in found.items():
        if m.beyond is not None and goal.triangles is not None:
            heard.warn(not_enough(goal.triangles, name, m.beyond))
    if picture is not None:
        _drawn(panels, means, view).save(picture, dpi=dpi_of(size))
    return found


def _contenders(given: Sequence[str], conservative: bool, goal: Goal, progress: Progress) -> list[Choice]:
    """The methods to measure, each once, also of a list of names; for "all", those that can reach the goal.

    Raises:
        UsageError: one that is given cannot, or is refused.
    """
    found: dict[str, Choice] = {}
    given = [
        name for text in given for name in (text.split(",") if {*text.split(",")} <= {*METHODS, "all"} else [text])
    ]
    for name in METHODS if not given or "all" in given else ():
        try:
            choice = choice_of(name, conservative)
        except UsageError:
            progress.note(f"{name} does not promise the tolerance and is left out.")
            continue
        if goal.name in choice.info.goals:
            found[str(choice)] = choice
        else:
            progress.note(f"{name} does not support the goal {goal.name} and is left out.")
    for text in given:
        if text != "all":
            choice = choice_of(text, conservative)
            choice.info.check_goal(goal.name)
            found[str(choice)] = choice
    return list(found.values())


def _views(
    terrain: Terrain, views: Any, flight: Any, size: tuple[int, int] | None, exaggeration: float
) -> dict[str, View]:  # fmt: skip
    """The views by name; a flight's frames by number."""
    crs = terrain.grid.crs
    if flight is not None:
        gone = flight if isinstance(flight, Flight | Tour) else moves(flight, crs=crs)
        found = {str(k): view for k, view in enumerate(gone.frames())}
    elif views is None:
        return usual_views(terrain, size or SIZE, exaggeration)
    elif isinstance(views, str | os.PathLike):
        found = load_views(views, crs)
    elif isinstance(views, Mapping):
        found = dict(views)
    else:
        found = {str(k): view for k, view in enumerate(views, 1)}
    return found if size is None else {name: view.resized(*size) for name, view in found.items()}


def load_views(path: str | os.PathLike[str], crs: Any = None) -> dict[str, View]:
    """A list of views from a JSON file, by their names, or their numbers from 1.

    Raises:
        ReadError: the file cannot be read, or is no list of objects. UsageError: a view is wrong, or two have one name.
    """
    try:
        values = parse(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ReadError(f"The views cannot be read: {error.strerror}.", path=path) from error
    except ValueError as error:
        raise ReadError(f"This is not JSON: {error}.", path=path) from error
    if not isinstance(values, list) or not values or not all(isinstance(v, dict) for v in values):
        raise ReadError("Views must be a JSON list of at least one object, each like a VIEW.json.", path=path)
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


def _measured(method: Any, means: _Means, found: Comparison, judged: int, task: Task) -> Measurement:
    """Measure a method on the comparison's views; on a flight the referee judges ``judged`` frames."""
    about: dict[str, Any] = {"exaggeration": means.exaggeration, "jobs": means.jobs, "task": task}
    views = list(found.views.values())
    if not found.flight:
        return measure_views(method, means.terrain, views, means.goal, **about)
    return measure_flight(method, means.terrain, views, means.goal, judged=judged, **about)


def _panel(method: Any, name: str, means: _Means, view: View) -> Panel:
    """The mesh that a method selects for a panel, judged."""
    selection = method.select(Camera.over(means.terrain.grid, view, means.exaggeration), means.goal)
    mesh = selection.tessellation()
    report = verify.judge_mesh(mesh, means.terrain, view, exaggeration=means.exaggeration, jobs=means.jobs)
    lines, alarm = caption(len(mesh.triangles), selection.bound, selection.stats.get("tolerance"), report.largest)
    return Panel(name, mesh, lines, alarm)


def _drawn(panels: Sequence[Panel], means: _Means, view: View) -> Picture:
    """The panels side by side."""
    import numpy as np

    terrain, goal = means.terrain, means.goal
    asked = f"{goal.triangles:,} triangles" if goal.triangles is not None else f"tolerance {goal.tolerance:g} px"
    rows, cols = terrain.grid.shape
    note = (
        f"{terrain.name}, {cols} × {rows} samples. Each mesh is refined for its panel of {view.width} × "
        f"{view.height} pixels ({asked}); errors are the referee's, over all of the surface in view."
    )
    with means.progress.task("Drawing the meshes"):
        pixels = sheet(
            terrain, view, panels, note=note,
            title=f"The same view, {asked}" if len(panels) > 1 else f"{terrain.name}, {asked}",
            drape=means.drape, exaggeration=means.exaggeration, jobs=means.jobs,
        )  # fmt: skip
    return Picture(pixels, np.empty((0, 0), np.float32), view)


def _pixels(value: float | None) -> str:
    return "no bound" if value is None else f"{value:.3f}"
