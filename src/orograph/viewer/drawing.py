"""Draw the terrain for a window: only when its picture would change, and despite errors.

If drawing a frame fails (a file vanished, a device was lost), a message says so and the last picture stays; drawing is
tried again when something changes or after ``RETRY`` seconds. A thread opens a new device in place of a lost one, while
panels keep working (``reopening``).
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from orograph.errors import OrographError
from orograph.gpu.device import Device
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewer.layered import Others, Standing
from orograph.viewer.reopening import Coming
from orograph.viewer.screen import TOO_SLOW, Draft, Screen
from orograph.viewpoint import View

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from orograph.rendering.standing import Stood
    from orograph.viewer.window import Window

RETRY = 2.0
PATIENCE = 0.4
"""Seconds of rest after which a slow device refines a picture."""

UNREAD = "Part of the picture cannot be read:"
UNDRAWN = "The terrain could not be drawn."
RENEWING = "The GPU was lost; the terrain is being prepared for a new device."


class Drawer(Protocol):
    """Draws terrain: ``rendering.gpu.renderer.Renderer``."""

    def draw(
        self, target: Any, format: str, scene: Scene, *, overlay: Any = ..., freeze: View | None = None,
        wait: bool = False, samples: int | None = None,
    ) -> Any:  # fmt: skip
        """Draw a scene into a texture's view; returns statistics."""

    def depth(self) -> NDArray[np.float32]:
        """View-space depth (height, width) of the last frame, metres, NaN where there is no ground."""

    @property
    def busy(self) -> bool:
        """Whether tiles are still loading."""

    @property
    def resting(self) -> bool:
        """Whether further frames of the same scene would be identical."""

    def close(self) -> None:
        """Release everything."""


class Drawing:
    """The terrain of a window, on a device.

    Args:
        window: whose session is drawn.
        make: makes the renderer on a device.
        format: of the picture's texture.

    Attributes:
        renderer: draws the terrain; screen: the picture that it drew last.
        stats: statistics of the terrain's last frame; drawn: number of its frames so far.
        draft: how large the picture is in motion.
        stood: the standing things in the picture, or None.
        failed: when drawing failed, on ``time.perf_counter``'s clock; 0 while it does not.
    """

    def __init__(self, window: Window, make: Callable[[Device, Terrain], Drawer], format: str) -> None:
        self.window, self.make = window, make
        self.renderer: Drawer = make(window.device, window.session.terrain)
        self.screen = Screen(window.device, format)
        self.draft = Draft(window.device.adapter.software)
        self.stats: Any = None
        self.drawn = 0
        self.failed = 0.0
        self.stood: Stood | None = None
        self._standing, self._others = Standing(), Others(window, make)
        self._told_missing = False
        self._scene: tuple[Any, ...] | None = None
        self._resting = True
        self._slow = False
        self._drawn_at = 0.0
        self._trouble = self._making = ""
        self._empty = False
        self._coming: Coming | None = None

    @property
    def eager(self) -> bool:
        """Whether the next frame should come at once: there is more to show, and the device is fast."""
        return not (self._resting or self._patient or self.coming or self.window.renewal.replaced())

    @property
    def done(self) -> bool:
        """Whether a frame was drawn and further ones would be identical."""
        return self.drawn > 0 and self._resting

    @property
    def waits(self) -> list[float]:
        """Seconds until drawing should be tried again."""
        return ([RETRY] if self.failed or self._lacks else []) + ([] if self._resting else [PATIENCE])

    @property
    def _lacks(self) -> bool:
        """Whether the last frame will improve later: something could not be read, or is being made."""
        return bool(getattr(self.stats, "failed", "") or getattr(self.stats, "making", ""))

    def _due(self, now: float) -> bool:
        """Whether it is time to check for what was lacking."""
        return self._lacks and now - self._drawn_at >= RETRY

    @property
    def _patient(self) -> bool:
        return self._slow and not self.renderer.busy

    def draw(self, scale: float, now: float) -> None:
        """Draw the terrain if its picture would change; ``scale``: of the picture's size."""
        if self.coming or self.window.renewal.replaced():
            return
        session, settings = self.window.session, self.window.session.settings
        state: tuple[Any, ...] = ()
        try:
            scene, overlay = session.scene(scale), settings.overlay()
            state = scene, overlay, settings.frozen
            same = state == self._scene
            if same and (self._resting if not self.failed else now - self.failed < RETRY) and not self._due(now):
                return
            if same and self._patient and not self.failed and now - self._drawn_at < PATIENCE:
                return  # on a slow device the pointer comes before refinement
            self.screen.prepare(scene.view.width, scene.view.height)
            self.stats = self.renderer.draw(
                self.screen.view, self.screen.format, scene, overlay=overlay, freeze=settings.frozen
            )  # fmt: skip
            self._stand(scene)
            rests = self._others.draw(scene, self.renderer, self.screen, {"freeze": settings.frozen})
            self._scene, self._resting = state, bool(self.renderer.resting) and rests
            self.drawn += 1
            self._drawn_at = time.perf_counter()
            self._slow = self._drawn_at - now > TOO_SLOW
            trouble = getattr(self.stats, "failed", "")
            before, self._trouble = self._trouble, trouble
            empty, self._empty = self._empty, self.stats.triangles + getattr(self.stats, "windows", 0) == 0
            if self._empty and not empty:
                session.messages.say("No ground is in view: press H to see all of it.")
            own = settings.painted.path if settings.painted is not None else None
            for note in getattr(self.stats, "notes", ()):
                if own is None or own not in note:  # the user gave no layer that a tool paints
                    session.messages.say(note)
            if self.window.renewal.replaced():
                self._trouble = before
            elif trouble and trouble != before:
                session.messages.drop(UNREAD)
                session.messages.say(f"{UNREAD} {trouble}", error=True)
            elif before and not trouble:
                session.messages.drop(UNREAD)
                session.messages.say("The whole picture can be read again.")
            made, self._making = self._making, getattr(self.stats, "making", "")
            if made != self._making:
                session.messages.drop(made)
                if self._making:
                    session.messages.say(self._making)
            if getattr(self.stats, "current", True) and settings.balance(int(self.stats.triangles)):
                self.window.touch()
            if self.failed:
                self.failed = 0.0
                session.messages.shown = [m for m in session.messages.shown if not m.error]
        except Exception as error:
            self._scene, self._resting = state, True
            self.screen.revert()
            self._fail(error, now)

    def exact(self, samples: int) -> None:
        """Draw the terrain with all tiles and ``samples`` samples per pixel.

        Raises:
            OrographError: a tile cannot be read.
        """
        if self._coming is not None:  # saving may take its time
            self._coming.join()
            self.ready()
        scene, settings = self.window.session.scene(), self.window.session.settings
        self.screen.prepare(scene.view.width, scene.view.height)
        self.renderer.draw(
            self.screen.view, self.screen.format, scene, overlay=settings.overlay(), freeze=settings.frozen, wait=True,
            samples=samples,
        )  # fmt: skip
        self._stand(scene)
        self._others.draw(
            scene, self.renderer, self.screen, {"freeze": settings.frozen, "wait": True, "samples": samples}
        )  # fmt: skip
        self._scene = None

    def _stand(self, scene: Scene) -> None:
        """Draw the standing things over the picture, with its depth, as in pictures."""
        self.stood = self._standing.draw(scene, self.renderer, self.screen)
        if self.stood is not None and self.stood.missing and not self._told_missing:
            self._told_missing = True
            told = f"{self.stood.missing} place(s) of the data have no ground: nothing stands there."
            self.window.session.messages.say(told)

    def thing_at(self, x: float, y: float) -> int:
        """The thing visible at a pixel of the view, −1 if there is none."""
        if self.stood is None:
            return -1
        rows, cols = self.stood.which.shape
        view = self.window.session.view
        i, j = int(y * rows / view.height), int(x * cols / view.width)
        return int(self.stood.which[i, j]) if 0 <= i < rows and 0 <= j < cols else -1

    def _fail(self, error: Exception, now: float) -> None:
        """Report that a frame could not be drawn, and try to get a new device if it was lost."""
        if self.lost(error):
            self.reopen()
            return
        if self.window.renewal.replaced():
            return
        first, self.failed = not self.failed, now
        expected = isinstance(error, (OrographError, OSError))
        what = str(error) if expected else f"{type(error).__name__}: {error}"
        self.window.session.messages.say(f"{UNDRAWN} {what}", error=True)
        if first and not expected:
            import traceback

            traceback.print_exc()

    def renew(self, renderer: Drawer) -> None:
        """Continue with another renderer, of another terrain."""
        if not self.coming:
            self.renderer.close()
        self._others.close()
        self.renderer, self.stats, self._scene, self._resting, self.failed = renderer, None, None, False, 0.0
        self.stood, self._standing = None, Standing()
        self._trouble = self._making = ""
        for said in (UNREAD, UNDRAWN):
            self.window.session.messages.drop(said)

    def close(self) -> None:
        """Release everything."""
        self._others.close()
        self.renderer.close()

    def check(self) -> None:
        """Raise wgpu's error if the device is lost: creating a buffer reports it, writing to one may crash the
        process."""
        self.window.device.buffer(4, "COPY_DST", "alive")

    def lost(self, error: Exception) -> bool:
        """Whether an error means that the device was lost."""
        return self.window.device.lost is not None or "lost" in str(error).lower()

    @property
    def coming(self) -> bool:
        """Whether the device was lost and a thread is making the renderer on a new one."""
        return self._coming is not None

    def reopen(self) -> None:
        """Start again on a new device, which a thread opens."""
        window, new = self.window, self._coming
        if new is not None and new.device is not window.device:
            return  # the same loss, reported again
        with contextlib.suppress(Exception):  # it is lost anyway
            self.renderer.close()
        with contextlib.suppress(Exception):
            self._others.close()
        with contextlib.suppress(Exception):
            window.context.unconfigure()  # releases textures of the lost device, which cannot be shown
        window.device.lost = window.device.lost or "lost while drawing"
        self._scene, self._resting = None, False
        scene, overlay, format = None, None, self.screen.format
        with contextlib.suppress(Exception):  # the first frame reports what is wrong with it
            scene, overlay = window.session.scene(), window.session.settings.overlay()

        def prepare(renderer: Any) -> None:
            if scene is not None and hasattr(renderer, "prepare"):
                renderer.prepare(format, scene, overlay=overlay)

        self._coming = Coming(window.adapter, window.session.terrain, self.make, prepare, window.refresh)
        self.renderer = self._coming

    def ready(self) -> bool:
        """Whether there is a device to draw panels with; takes over what a new device has ready since the last
        frame."""
        window, new = self.window, self._coming
        if new is None:
            return True
        try:
            if new.device is not None and new.device is not window.device:
                window.device = new.device
                window.context.configure(device=window.device.handle, format=self.screen.format)
                self.screen = Screen(window.device, self.screen.format)
                window.gui.rebuild(window.device, self.screen.format)
                window.plan.forget_texture()
                window.session.messages.say(RENEWING)
            if new.error is not None:
                raise new.error
        except Exception as error:
            self._coming, self.failed = None, time.perf_counter()
            window.device.lost = window.device.lost or "not to be drawn with"
            window.session.messages.say(f"The GPU was lost and cannot be opened again: {error}", error=True)
            again = threading.Timer(RETRY, window.refresh)
            again.daemon = True
            again.start()
            return False
        if new.renderer is not None:
            self.renderer, self._coming = new.renderer, None
            window.session.messages.drop(RENEWING)
            window.session.messages.say("The GPU was lost; drawing continues on a new device.")
            window.touch()
        return new.device is not None
