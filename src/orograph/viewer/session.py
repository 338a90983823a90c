"""The state behind a window: terrain, camera, settings, measurements, messages.

Window, notebook and tests share it; it has no GUI. Views go to the clipboard as the JSON that ``render --view`` takes.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from orograph.documents import parse
from orograph.errors import OrographError, UsageError
from orograph.scene import camera
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewer.bookmarks import Bookmarks
from orograph.viewer.navigation import Limits
from orograph.viewer.navigator import Navigator
from orograph.viewer.probe import Probe
from orograph.viewer.settings import Settings
from orograph.viewer.wording import spoken
from orograph.viewpoint import Point, View

HOME_PITCH, HOME_FOV = 42.0, 30.0
"""Azimuth and pitch of the home view, degrees, as in ``camera.whole``."""
SHOWN = 4.0
"""Seconds that a message is shown; errors stay until dismissed."""


@dataclass(slots=True)
class Message:
    """A message to the user.

    Attributes:
        text: the message; ``error``: whether it stays until dismissed; ``until``: on ``time.monotonic``'s clock.
    """

    text: str
    error: bool = False
    until: float = math.inf


@dataclass(slots=True)
class Messages:
    """The messages to show, the newest last; no message appears twice."""

    shown: list[Message] = field(default_factory=list)

    def say(self, text: str, *, error: bool = False) -> None:
        """Show a message, in the window's words."""
        text = spoken(text)
        self.shown = [m for m in self.shown if m.text != text]
        self.shown.append(Message(text, error, math.inf if error else time.monotonic() + SHOWN))
        del self.shown[:-5]

    def advance(self) -> bool:
        """Drop messages that have been shown long enough; returns whether another will expire."""
        now = time.monotonic()
        self.shown = [m for m in self.shown if m.until > now]
        return any(not m.error for m in self.shown)

    def hush(self) -> None:
        """Drop all messages that would expire: the user should watch something now."""
        self.shown = [m for m in self.shown if m.error]

    def drop(self, beginning: str) -> None:
        """Drop messages that begin with this text."""
        beginning = spoken(beginning)
        self.shown = [m for m in self.shown if not beginning or not m.text.startswith(beginning)]

    def dismiss(self, message: Message) -> None:
        """Drop one."""
        self.shown = [m for m in self.shown if m is not message]


@dataclass(frozen=True, slots=True)
class Ground:
    """A session's terrain and what belongs to it.

    Attributes:
        terrain: the terrain. outline: points (n, 3) that a view of all of it, and of what stands on it, must contain,
            by the exaggeration. home: that view. probe: its ground.
    """

    terrain: Terrain
    outline: Callable[[float], Any]
    home: View
    probe: Probe

    @classmethod
    def of(cls, terrain: Terrain, session: Session, size: tuple[int, int] | None = None) -> Ground:
        """Prepare a terrain for a session; ``size``: of its picture (None: unchanged).

        Raises:
            NothingInViewError: it has no valid sample. UsageError: it cannot be drawn with these settings.
        """
        size = size or (session.view.width, session.view.height)
        bare, stretch = camera.outline(terrain), session.settings.exaggeration
        home = home_of(bare, size, stretch)
        # (Reports what cannot be drawn before there is a window.)
        things = session.settings.scene(terrain, home).theme.things

        @lru_cache(maxsize=2)
        def outline(exaggeration: float) -> Any:
            from orograph.rendering.standing import extent

            return bare if things is None else camera.joined(bare, extent(things, terrain, exaggeration))

        home = home_of(outline(stretch), size, stretch)
        return cls(terrain, outline, home, Probe(terrain, lambda: session.changed()))

    @property
    def limits(self) -> Limits:
        """The limits of the camera."""
        return Limits(self.probe.ground, farthest=20.0 * max(math.dist(self.home.eye, self.home.target), 1000.0))


def home_of(outline: Any, size: tuple[int, int], exaggeration: float) -> View:
    """All of a terrain in a picture of this size."""
    return camera.fit(outline, camera.direction(180.0, HOME_PITCH), HOME_FOV, size, exaggeration)


class Session:
    """A terrain being viewed.

    Args:
        terrain: the terrain.
        view: the first view; None: all of it, from the south.
        size: (width, height), pixels.
        paths: what the terrain was opened from, for displayed command lines.
        changed: called, from any thread, when the picture should be drawn again.
        options: initial settings by name (``Settings``); None: the defaults.
    """

    def __init__(
        self,
        terrain: Terrain,
        view: View | None = None,
        *,
        size: tuple[int, int] = (1280, 720),
        paths: Sequence[str] = (),
        changed: Callable[[], None] = lambda: None,
        **options: Any,
    ) -> None:
        self.paths = tuple(paths)
        self.changed = changed
        self.settings = Settings(terrain, **{name: value for name, value in options.items() if value is not None})
        self._ground = ground = Ground.of(terrain, self, size)
        self.nav = Navigator(ground.home, ground.home, self._pick, ground.limits, self.settings.exaggeration)
        if view is not None:
            self.nav.jump(view.resized(*size))
        self.messages = Messages()
        self.bookmarks = Bookmarks(terrain.grid, terrain.name)
        if self.bookmarks.trouble:
            self.messages.say(f"Kept views cannot be read: {self.bookmarks.trouble}", error=True)

    @property
    def terrain(self) -> Terrain:
        """The current terrain."""
        return self._ground.terrain

    @property
    def probe(self) -> Probe:
        """Its ground."""
        return self._ground.probe

    def _home(self, size: tuple[int, int], exaggeration: float) -> View:
        """All of the terrain in a picture of this size."""
        return home_of(self._ground.outline(exaggeration), size, exaggeration)

    def renew(self, ground: Ground, moved: Callable[[View], View | None]) -> str:
        """Switch to another terrain: camera, light, and kept views stay, as far as they make sense there.

        Args:
            moved: a view of the old terrain as one of the new; None if it does not look at that.

        Returns:
            A sentence that names what does not stay; "" if all does.
        """
        nav, at_home = self.nav, self.nav.view == self.nav.home
        nav.stop()
        self._ground.probe.close()
        before, self._ground = self._ground.terrain.grid, ground
        nav.home = self._home((self.view.width, self.view.height), nav.exaggeration)
        nav.limits = ground.limits
        view = None if at_home else moved(nav.view)
        nav.jump(nav.home if view is None else view)
        lost = self.settings.renew(ground.terrain, before)
        kept, self.bookmarks = self.bookmarks, Bookmarks(ground.terrain.grid, ground.terrain.name)
        self.bookmarks.carry(kept, moved)
        if view is None and not at_home:
            lost.insert(0, "the camera, which looked elsewhere")
        return f"It does not keep {' and '.join(lost)}." if lost else ""

    def resize(self, width: int, height: int) -> None:
        """The picture has a new size; a camera still at home shows all of the terrain in it."""
        nav = self.nav
        at_home = nav.view == nav.home
        nav.home = self._home((max(width, 1), max(height, 1)), nav.exaggeration)
        if at_home:
            nav.view = nav.home
        else:
            nav.resize(width, height)

    def _pick(self, x: float, y: float) -> Point | None:
        return self.probe.pick(self.nav.view, x, y, self.nav.exaggeration)

    @property
    def view(self) -> View:
        """The camera."""
        return self.nav.view

    def scene(self, scale: float = 1.0) -> Scene:
        """The scene to draw; ``scale``: of the picture's size, for drafts."""
        view = self.view
        if scale != 1.0:
            view = view.resized(max(1, round(view.width * scale)), max(1, round(view.height * scale)))
        return self.settings.scene(self.terrain, view)

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self.nav.advance(seconds)
        self.settings.sun.advance(seconds)
        self.settings.variants.advance(self.view, seconds)

    @property
    def moving(self) -> bool:
        """Whether the picture changes over time."""
        light = self.settings.sun
        return self.nav.moving or self.settings.variants.moving or (light.playing and light.mode == "moment")

    def stretch(self, exaggeration: float, *, hold: bool = True) -> None:
        """Set the exaggeration; a camera still at home shows all of the stretched terrain.

        Args:
            hold: move the camera so that what it looks at stays in the picture; otherwise the caller places it.
        """
        nav = self.nav
        at_home = nav.view == nav.home
        self.settings.exaggeration = exaggeration
        nav.home = self._home((self.view.width, self.view.height), exaggeration)
        if not hold:
            nav.exaggeration = exaggeration
            return
        nav.stretch(exaggeration)
        if at_home:
            nav.view = nav.home

    def freeze(self, on: bool) -> None:
        """Freeze the mesh of this view while the camera goes elsewhere; or let it follow again."""
        self.settings.frozen = self.view if on else None

    # ---- views in and out ----------------------------------------------------------------------------------------

    def view_json(self) -> str:
        """The view as ``render --view`` takes it."""
        return json.dumps(self.view.to_dict(), indent=2)

    def paste_view(self, text: str) -> bool:
        """Fly to the view in a text; reports what is wrong with it. Returns whether it was a view."""
        try:
            values = parse(text)
            if not isinstance(values, dict):
                raise UsageError("A view must be a JSON object with eye and target.")
            view = View.from_dict(values, crs=self.terrain.grid.crs)
        except ValueError:
            self.messages.say("The clipboard holds no view (JSON with eye and target).")
            return False
        except OrographError as error:
            self.messages.say(f"The clipboard holds no view: {error}")
            return False
        self.nav.go(view)
        return True

    def keep_view(self, slot: str) -> None:
        """Keep the view under "1" to "9"."""
        try:
            self.bookmarks.keep(slot, self.view)
        except OrographError as error:
            self.messages.say(f"The view is kept until the window closes: {error}", error=True)
        else:
            self.messages.say(f"View {slot} is kept.")

    def recall_view(self, slot: str) -> None:
        """Fly to a view kept under "1" to "9"."""
        view = self.bookmarks.get(slot)
        if view is None:
            self.messages.say(f"There is no view {slot} yet: Ctrl+{slot} keeps this one.")
        else:
            self.nav.go(view)

    def close(self) -> None:
        """Stop all threads."""
        self.probe.close()
        self.settings.finer.close()
