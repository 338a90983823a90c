"""Continue with the new store when the one being viewed is replaced.

A thread checks every ``EVERY`` seconds whether the store is still the same (at a URL as rarely as ``store.watch``;
there a failed read tells sooner). If not, the thread opens the new store and makes what a window needs (the probe, a
renderer prepared for its first frame), while the last picture stays; the next frame takes it all over. If a new store
cannot be opened or shown, a message says so, and it is tried again.

Coordinates are metres in the terrains' CRSs.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from orograph.errors import OrographError
from orograph.geo.grid import Grid
from orograph.geo.transform import transformer
from orograph.gpu.device import Device
from orograph.store.stored import StoredTerrain
from orograph.store.terrain import Terrain
from orograph.viewer.session import Ground
from orograph.viewpoint import Point, View

if TYPE_CHECKING:
    from orograph.viewer.drawing import Drawer
    from orograph.viewer.window import Window

EVERY = 1.0
REPLACED = "The store was replaced"
AROUND = 0.5
"""How far beyond the terrain's border a camera's target may lie, as a part of its extent."""

Move = Callable[[Point], Point | None]


def move_of(old: Grid, new: Grid) -> Move:
    """A map from places on the old grid to the same places on the new grid; None: the grids are not near each other."""
    if old.crs == new.crs:
        to = None
    else:
        try:
            to = transformer(old.crs, new.crs)
        except OrographError:
            return lambda point: None
    west, south, east, north = new.bounds()
    wide, tall = AROUND * (east - west), AROUND * (north - south)

    def move(point: Point) -> Point | None:
        x, y = point[:2] if to is None else (float(v) for v in to(*point[:2]))
        near = west - wide <= x <= east + wide and south - tall <= y <= north + tall
        return (x, y, point[2]) if near else None

    return move


def moved(view: View, old: Grid, new: Grid) -> View | None:
    """A view of the old grid's terrain as a view of the new grid's; None if it does not look at that."""
    target = move_of(old, new)(view.target)
    if target is None:
        return None
    if old.crs == new.crs:
        return view
    x, y = (float(v) for v in transformer(old.crs, new.crs)(*view.eye[:2]))
    return replace(view, eye=(x, y, view.eye[2]), target=target) if math.isfinite(x + y) else None


class Renewal:
    """Checks whether a window's store is still the same, and prepares its replacement if not.

    Args:
        window: the window.
        make: makes the renderer on a device.
    """

    def __init__(self, window: Window, make: Callable[[Device, Terrain], Drawer]) -> None:
        self.window, self.make = window, make
        self._made: tuple[Ground, Drawer, Device] | None = None
        self._reported = ""
        self._closed = False
        self._wake = threading.Event()
        if getattr(window.session.terrain, "watch", None) is not None:
            threading.Thread(target=self._work, name="replaced", daemon=True).start()

    def replaced(self) -> bool:
        """Whether the terrain's store has been replaced, so that reading on is useless."""
        watch = getattr(self.window.session.terrain, "watch", None)
        found = watch is not None and watch.replaced
        if found:
            self._wake.set()
        return found

    def close(self) -> None:
        """Stop the thread."""
        self._closed = True
        self._wake.set()

    def take(self) -> None:
        """Switch the window to the new store, if it is ready."""
        window, session = self.window, self.window.session
        if self._made is None or window.drawing.coming:
            return
        (ground, renderer, device), self._made = self._made, None
        if device is not window.device:  # the device was lost meanwhile: make the renderer again
            renderer.close()
            ground.probe.close()
            return
        old, new = session.terrain.grid, ground.terrain.grid
        lost = session.renew(ground, lambda view: moved(view, old, new))
        window.renew(renderer, move_of(old, new), lambda view: moved(view, old, new))
        session.messages.drop(REPLACED)
        session.messages.say(f"{REPLACED}, and the new one was opened. {lost}".strip())
        self._reported = ""

    def _work(self) -> None:
        while not self._closed:
            self._wake.wait(EVERY)
            self._wake.clear()
            terrain = self.window.session.terrain
            assert isinstance(terrain, StoredTerrain) and terrain.watch is not None
            with contextlib.suppress(OrographError, OSError):  # readers report what is missing for now
                terrain.watch()
            if terrain.watch.replaced and self._made is None and not self._closed and not self._renewed(terrain):
                time.sleep(EVERY)

    def _renewed(self, terrain: StoredTerrain) -> bool:
        """Prepare what the next frame takes, or report why not; returns whether it succeeded."""
        session, device = self.window.session, self.window.device
        try:
            ground = Ground.of(terrain.reopen(), session)
            renderer = self.make(device, ground.terrain)
            if hasattr(renderer, "prepare"):
                with contextlib.suppress(Exception):  # the first frame reports what is wrong
                    scene = session.settings.scene(ground.terrain, ground.home)
                    renderer.prepare(self.window.drawing.screen.format, scene, overlay=session.settings.overlay())
        except Exception as error:
            what = str(error) if isinstance(error, (OrographError, OSError)) else f"{type(error).__name__}: {error}"
            if what != self._reported:
                self._reported = what
                session.messages.drop(REPLACED)
                session.messages.say(f"{REPLACED}, but the new one cannot be shown: {what}", error=True)
                self.window.refresh()
            return False
        self._made = ground, renderer, device
        if self._closed:
            renderer.close()
        self.window.refresh()
        return True
