"""A hand on a window in the process: events as ``rendercanvas`` gives them, frames drawn one by one."""

from __future__ import annotations

import time

import numpy as np

from orograph.viewer.window import Window

PLAIN = 500.0
"""Metres: the height of the test terrain (conftest)."""


class Hand:
    """Moves the mouse and presses keys on a window, and lets it draw."""

    def __init__(self, window: Window) -> None:
        self.window = window

    def event(self, kind: str, **values) -> None:
        self.window.canvas.submit_event({"event_type": kind, "modifiers": (), "buttons": (), **values})

    def frames(self, n: int = 3) -> np.ndarray:
        for _ in range(n):
            self.window.canvas._process_events()  # what a loop would do
            out = self.window.canvas.draw()
        return np.asarray(out)[..., :3]

    def move(self, x, y) -> None:
        self.event("pointer_move", x=x, y=y, button=0)

    def press(self, x, y, button=1, modifiers=()) -> None:
        self.move(x, y)
        self.event("pointer_down", x=x, y=y, button=button, modifiers=modifiers)

    def release(self, x, y, button=1) -> None:
        self.event("pointer_up", x=x, y=y, button=button)

    def click(self, x, y) -> None:
        self.press(x, y)
        self.frames(1)
        self.release(x, y)
        self.frames(2)

    def key(self, name, *modifiers) -> None:
        self.event("key_down", key=name, modifiers=modifiers)
        self.event("key_up", key=name, modifiers=modifiers)
        self.frames(1)

    def until(self, what, seconds=60) -> None:
        end, frames = time.monotonic() + seconds, 0
        while not what():
            # A busy machine may stop this process for a while: it had its chance when it drew so many frames.
            assert time.monotonic() < end or frames < 200, "waited in vain"
            self.frames(1)
            frames += 1
            time.sleep(0.01)

    def still(self) -> None:
        """Until the camera stands."""
        self.until(lambda: not self.window.session.moving)

    def rest(self) -> None:
        """Until the camera stands and the picture is as good as it gets; what was changed is drawn once, at least."""
        self.frames(1)
        self.until(lambda: not self.window.session.moving and self.window.drawing.renderer.resting)


def ground_pixel(window, x, y):
    """Where canvas position (x, y) is on the plain, by the view's own rays."""
    px, py = window.to_picture(x, y)
    o0, _, _, d0, du, dv = window.session.view.ray_basis()
    d = d0 + px * du + py * dv
    return o0 + d * (PLAIN - o0[2]) / d[2]
