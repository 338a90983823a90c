"""Find the best view of the selection in a thread, then fly to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

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
    """

    def __init__(self, window: Window) -> None:
        self.window, self.busy = window, False
        self._found: View | None = None

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
                    self._found = seen.back(best.view)
                    session.messages.say(f"The best view shows {100 * best.visible:.0f} % of what is selected.")
            except (OrographError, OSError) as error:
                session.messages.say(str(error))
            finally:
                self.busy = False
                window.touch()

        session.probe.submit(look)

    def take(self) -> None:
        """Fly to the view found."""
        found, self._found = self._found, None
        if found is not None:
            session = self.window.session
            session.nav.go(found.resized(session.view.width, session.view.height))
            self.window.touch()
