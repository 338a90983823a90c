"""Find the best view of the selection in a thread, then fly to it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from orograph.errors import OrographError
from orograph.viewpoint import View

if TYPE_CHECKING:
    from orograph.viewer.window import Window

MOST = 400
"""Places of a selection that are considered, evenly spread."""


class Finder:
    """Finds views for a window.

    Attributes:
        busy: whether a search is running.
        hidden: (n, 2) the places of the selection that the ground hides in the last view found, of ``looked_for``.
    """

    def __init__(self, window: Window) -> None:
        self.window, self.busy = window, False
        self._found: View | None = None
        self.hidden, self.looked_for = np.zeros((0, 2)), 0
        self._here: tuple[View, Any] | None = None

    def find(self) -> None:
        """Look for the camera that shows most of the selection, and fly there."""
        window, session = self.window, self.window.session
        places = window.brush.places(session.terrain, session.settings.shown)
        if self.busy:
            return
        if window.brush.empty or not len(places):
            session.messages.say("Nothing is selected: drag over a plot, or select a measured area.")
            return
        if len(places) > MOST:
            places = places[np.linspace(0, len(places) - 1, MOST).round().astype(int)]
        self.busy = True
        session.messages.say("Looking for the best view of what is selected.")
        view, terrain, stretch = session.view, session.terrain, session.settings.exaggeration
        chosen = window.brush.chosen

        def look() -> None:
            from orograph.touring.best_view import search
            from orograph.touring.stretched import Stretched

            try:
                seen = Stretched(terrain, stretch)
                found = search(seen, places, 1, size=(view.width, view.height), fovs=(view.fov_y,))
                if not len(found):
                    session.messages.say("No camera sees any of what is selected.")
                elif session.terrain is terrain:
                    best = found[0]
                    self.hidden, self.looked_for = places[np.array(best.geometries) < 0.5], len(places)
                    self._found = seen.back(best.view)
                    self._here = self._found, chosen
                    more = " Dots on the plan mark what is hidden." if len(self.hidden) else ""
                    session.messages.say(f"The best view shows {100 * best.visible:.0f} % of what is selected.{more}")
            except (OrographError, OSError) as error:
                session.messages.say(str(error))
            finally:
                self.busy = False
                window.touch()

        session.probe.submit(look)

    @property
    def at_best(self) -> bool:
        """Whether the camera is where the last view found is, and the selection is as it was."""
        if self._here is None or self._here[1] != self.window.brush.chosen:
            return False
        best, view = self._here[0], self.window.session.view
        near = 1e-3 * best.distance
        return math.dist(best.eye, view.eye) < near and math.dist(best.target, view.target) < near

    def take(self) -> None:
        """Fly to the view found."""
        found, self._found = self._found, None
        if found is not None:
            session = self.window.session
            session.nav.go(found.resized(session.view.width, session.view.height))
            self.window.touch()
