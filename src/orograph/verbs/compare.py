"""``orograph.compare``: methods on the same views, measured by the same referee."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from orograph.lod.field import check_surface
from orograph.lod.method import Resources
from orograph.lod.needs import kinds_of
from orograph.lod.registry import METHODS
from orograph.progress import Progress
from orograph.rendering.comparison import usual_views
from orograph.reporting import reporting
from orograph.scene.methods import MEMORY, made
from orograph.scene.parts import check_exaggeration
from orograph.store.opening import terrain as opened
from orograph.verbs.goals import choice_of, goal_of
from orograph.verify.measure import Measurement, measure_views
from orograph.viewpoint import View

COLUMNS: dict[str, Callable[[Measurement], str]] = {
    "triangles": lambda m: "-" if m.triangles is None else f"{m.triangles:,.0f}", "ms": lambda m: f"{m.ms:,.1f}",
    "rms px": lambda m: _pixels(m.rms), "largest px": lambda m: _pixels(m.largest),
    "conservative": lambda m: "yes" if m.conservative else "no",
}  # fmt: skip
"""What a table of measurements tells of each."""


class Comparison(dict[str, Measurement]):
    """Measurements by method, which read as a table."""

    def rows(self) -> list[list[str]]:
        """The table's cells, its heads first."""
        return [["method", *COLUMNS], *([name, *(tell(m) for tell in COLUMNS.values())] for name, m in self.items())]

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


def compare(
    terrain: Any,
    views: Sequence[View] | Mapping[str, View] | None = None,
    *,
    methods: Sequence[str] = (),
    tolerance: float | None = None,
    triangles: int | None = None,
    conservative: bool = False,
    drape: Any = None,
    exaggeration: float = 1.0,
    size: tuple[int, int] = (1280, 720),
    max_memory: int | None = None,
    jobs: int | None = None,
    progress: Progress | bool | None = None,
    **reading: Any,
) -> Comparison:
    """Measure methods side by side on a terrain: triangles, milliseconds, errors in pixels as the referee finds them.

    Args:
        terrain: whatever ``orograph.terrain`` takes, with its options (``reading``).
        views: the cameras; None: an overview, a low oblique view, straight down.
        methods: which, NAME[,key=value…]; none: all that can reach the goal.
        tolerance: pixels; None: 1, unless ``triangles`` (at most so many) are the goal.
        conservative: refuse methods with which the tolerance is no promise.
        drape: the image whose colours a method's color-tolerance looks at.
        exaggeration: how heights are stretched on the screen. size: of the usual views, pixels.
        max_memory: bytes that heights may take. jobs: threads. progress: hears of it; False: nothing is said.

    Returns:
        ``verify.measure.Measurement``s by method; they print as a table.

    Raises:
        UsageError: there is no such method, or it cannot reach the goal. ReadError, StoreError: the terrain cannot be
            read.
    """
    heard, goal = reporting(progress), goal_of(tolerance=tolerance, triangles=triangles)
    check_exaggeration(exaggeration)
    choices = [choice_of(name, conservative) for name in (methods or METHODS)]
    if methods:
        for choice in choices:
            choice.info.check_goal(goal.name)
    choices = [choice for choice in choices if goal.name in choice.info.goals]
    errors = kinds_of(need for choice in choices for need in choice.method.needs(choice.options))
    ground = opened(terrain, heard, max_memory=max_memory, jobs=jobs, errors=errors, called="compare", **reading)
    check_surface(ground)
    if views is None:
        views = usual_views(ground, size, exaggeration)
    seen = list(views.values() if isinstance(views, Mapping) else views)
    found = Comparison()
    for choice in choices:
        with heard.task(str(choice), total=len(seen)) as task:
            method = made(choice, ground, Resources((max_memory or MEMORY) // 2, jobs, heard), drape)
            found[str(choice)] = measure_views(
                method, ground, seen, goal, exaggeration=exaggeration, jobs=jobs, task=task
            )
            method.close()
    return found


def _pixels(value: float | None) -> str:
    return "no bound" if value is None else f"{value:.3f}"
