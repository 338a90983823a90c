"""Measuring with the mouse: click points on the ground, see what they measure, save it.

All numbers are those of ``measuring``: the full-resolution surface in true metres, never the drawn mesh. A thread
computes them; the panel shows the newest. A viewshed is painted on the ground as an image, which replaces the user's
own image until it is cleared.

    pick       height, coordinates, slope and aspect         profile   lengths, climb and descent along a line
    area       plan, surface, perimeter                      los       whether one point is seen from another
    viewshed   what is seen from a point
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orograph import measuring
from orograph.errors import OrographError
from orograph.folders import temporary
from orograph.geovis.layers import Layer
from orograph.progress import Progress, Task
from orograph.viewer import comparing
from orograph.viewer.panels import measure
from orograph.viewer.results import Kind, paint, save, save_rgba
from orograph.viewer.traces import trace
from orograph.viewer.typed_place import place_of
from orograph.viewpoint import Point

if TYPE_CHECKING:
    from orograph.viewer.window import Window

MOST = {"pick": 2, "los": 2, "viewshed": 1}
"""Maximum number of points of a measurement; a further click starts again."""
Array = NDArray[np.float64]


class Tools:
    """The measuring tool of a window.

    Attributes:
        active: whether clicks measure. kind: the measurement. points: the clicked points, on the ground.
        result: the result of ``measure`` for these points, or None. trouble: why there is none, or "".
        eye, target: metres above the ground for lines of sight. radius: metres of viewsheds.
        marked: the place on the ground for the cursor's place on the profile, or None.
        put: where the panel was last put by itself, logical pixels.
    """

    def __init__(self, window: Window) -> None:
        self.window = window
        self.active = False
        self.kind: Kind = "profile"
        self.points: list[Point] = []
        self.result: Any = None
        self.trouble = ""
        self.eye, self.target, self.radius = 1.7, 0.0, 20_000.0
        self.part: float | None = None
        self._asked = 0
        self._running = 0
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self.marked: Point | None = None
        self.put: tuple[int, int] | None = None
        self._border: tuple[Any, measuring.Profile] | None = None
        self._ground: tuple[Any, Array] | None = None

    @property
    def busy(self) -> bool:
        """Whether something is being measured."""
        return self._running > 0

    def toggle(self) -> None:
        """Start or stop measuring."""
        if self.active:
            self.leave()
        else:
            self.active = True

    def leave(self) -> None:
        """Leave the tool; what it painted disappears."""
        self.active = False
        self.clear()

    def clear(self) -> None:
        """Forget the points and the result."""
        self.points, self.result, self.trouble, self.marked = [], None, "", None
        self._asked += 1
        self.window.session.settings.painted = None

    def renew(self, move: Callable[[Point], Point | None]) -> None:
        """Switch to a new terrain: the clicked points are measured there, if all lie on it."""
        places = [move(point) for point in self.points]
        self.clear()
        self._running = 0
        if None not in places:
            self.points = [point for point in places if point is not None]
            self.measure()

    def choose(self, kind: Kind) -> None:
        """Choose another measurement."""
        self.clear()
        self.kind = kind

    def hover(self) -> None:
        """The pointer moved: query what is under it."""
        window = self.window
        if window.pointer is None:
            window.session.probe.leave()
        else:
            session = window.session
            session.probe.hover(session.view, *window.pointer, session.settings.exaggeration)

    def click(self, x: float, y: float) -> None:
        """A click at a pixel of the view."""
        if not self.active:
            return
        session = self.window.session
        point = session.probe.pick(session.view, x, y, session.settings.exaggeration, 1.0)
        if point is None:
            session.messages.say("There is no ground there.")
            return
        self._put_point(point)

    def add(self, text: str) -> None:
        """Measure at a typed place, too; if it is out of the picture, fly there."""
        session = self.window.session
        try:
            x, y = place_of(text, session.terrain)
        except OrographError as error:
            session.messages.say(str(error))
            return
        height = session.probe.ground(x, y)
        point = x, y, height if math.isfinite(height) else session.view.target[2]
        self._put_point(point)
        (u, v), depth = session.view.project(np.array(point), session.settings.exaggeration)
        if not (depth > 0 and 0 <= u <= session.view.width and 0 <= v <= session.view.height):
            session.nav.go_to(point)
        self.window.touch()

    def _put_point(self, point: Point) -> None:
        if len(self.points) >= MOST.get(self.kind, 10_000):
            self.points = []
        self.points.append(point)
        self.measure()

    def data_rows(self) -> list[tuple[str, str]]:
        """(name, text) of the data at the picked places."""
        session = self.window.session
        shown = session.settings.shown
        if self.kind != "pick" or shown is None:
            return []
        key = "picked data", shown.painted, *self.points
        found: list[tuple[str, str]] = self.window.cached(
            key, lambda: comparing.rows(shown, session.terrain.grid, self.points)
        )
        return found

    def undo(self) -> None:
        """Remove the last point."""
        if self.points:
            self.points.pop()
            self.measure()

    def finish(self) -> None:
        """A double click ends a line: its second click repeats the first one's point."""
        if len(self.points) > 1 and math.dist(self.points[-1], self.points[-2]) < 1e-3 * self._scale():
            self.points.pop()
            self.measure()

    def _scale(self) -> float:
        return max(self.window.session.view.distance, 1.0)

    # ---- measuring -------------------------------------------------------------------------------------------------

    def measure(self) -> None:
        """Have the points measured."""
        self._asked += 1
        self.result, self.trouble, self.marked = None, "", None
        work = self._work([p[:2] for p in self.points])
        if work is None:
            return
        asked = self._asked
        self._running += 1

        def run() -> None:
            try:
                found = work()
                if asked == self._asked:
                    self.result = found
            except (OrographError, OSError) as error:
                if asked == self._asked:
                    self.trouble = str(error)
            finally:
                self._running = max(self._running - 1, 0)  # the terrain may have been replaced meanwhile
                self.part = None
                self.window.session.changed()

        self.window.session.probe.submit(run)

    def _work(self, at: list[tuple[float, float]]) -> Callable[[], Any] | None:
        """The measurement for the points, or None if there are too few."""
        terrain = self.window.session.terrain
        if self.kind == "pick" and at:
            return lambda: measuring.place(terrain, at[-1])
        if self.kind == "profile" and len(at) > 1:
            return lambda: measuring.profile(terrain, at)
        if self.kind == "area" and len(at) > 2:
            return lambda: self._area(at)
        if self.kind == "los" and len(at) == 2:
            return lambda: measuring.line_of_sight(terrain, at[0], at[1], self.eye, self.target)
        if self.kind == "viewshed" and at:
            asked = self._asked + 0
            return lambda: self._viewshed(at[0], asked)
        return None

    def _area(self, at: list[tuple[float, float]]) -> Any:
        """An area, and the ground along its border, for drawing."""
        terrain = self.window.session.terrain
        found = measuring.area(terrain, at, jobs=1)
        self._border = found, measuring.profile(terrain, [*at, at[0]])
        return found

    def _viewshed(self, at: tuple[float, float], asked: int) -> Any:
        terrain = self.window.session.terrain
        shed = measuring.viewshed(terrain, at, self.eye, self.target, radius=self.radius, jobs=1, progress=False)
        values = shed.values(_Part(self, asked))
        return shed, values, paint(values)

    def paint(self) -> None:
        """Lay a finished viewshed over the ground."""
        shed, _, pixels = self.result
        settings = self.window.session.settings
        if settings.painted is not None and self._shown is self.result:
            return
        self._folder = self._folder or temporary()
        path = Path(self._folder.name) / f"viewshed-{self._asked}.tif"
        save_rgba(path, pixels, shed.grid)
        settings.painted = Layer(str(path), name="viewshed")
        self._shown = self.result

    _shown: Any = None

    def _line(self) -> Array | None:
        """The ground along what was measured, (n, 3), at most about a thousand places; else the points."""
        border = self._border[1] if self._border is not None and self._border[0] is self.result else None
        along = {"profile": self.result, "los": getattr(self.result, "profile", None), "area": border}.get(self.kind)
        if along is None and self.kind == "pick":
            return None
        if along is None:
            points = [*self.points, *self.points[:1]] if self.kind == "area" else self.points
            return np.array(points) if len(points) > 1 else None
        if self._ground is None or self._ground[0] is not self.result:
            s = np.unique(np.append(np.linspace(0, along.distance[-1], 800), along.distance[along.vertices]))
            points, heights, _ = along.at(s)
            self._ground = self.result, np.column_stack([points, heights])
        return self._ground[1]

    # ---- on the screen ---------------------------------------------------------------------------------------------

    def draw(self) -> None:
        """Draw the panel, and the points on the ground."""
        if self.active:
            trace(self.window, self.kind, self.points, self._line(), self.result, self.marked)
            measure.draw(self)

    def save(self) -> None:
        """Save the result in the folder where the window was started."""
        session = self.window.session
        stem = "".join(c if c.isalnum() or c in "-_." else "-" for c in session.terrain.name)
        stem = f"{stem}-{self.kind}-{time.strftime('%Y%m%d-%H%M%S')}"
        try:
            shown, (*_, (x, y, _)) = session.settings.shown, self.points
            found = () if shown is None or self.kind != "pick" else shown.at(x, y)
            path = save(self.kind, self.result, self.points, session.terrain, Path.cwd() / stem, found)
        except (OrographError, OSError) as error:
            session.messages.say(f"The result was not saved: {error}", error=True)
        else:
            session.messages.say(f"Saved {path.name} in {path.parent}.")


class _Part(Progress):
    """Reports a viewshed's progress to the panel."""

    def __init__(self, tools: Tools, asked: int) -> None:
        self.tools, self.asked = tools, asked

    def task(self, what: str, total: float | None = None) -> Task:
        return _PartTask(self.tools, total)


class _PartTask(Task):
    def __init__(self, tools: Tools, total: float | None) -> None:
        self.tools, self.total, self.done = tools, total, 0.0

    def advance(self, n: float = 1) -> None:
        self.done += n
        if self.total:
            self.tools.part = self.done / self.total
