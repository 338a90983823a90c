"""The window: a canvas, the terrain drawn on it, panels, and the loop that draws when something changed.

Nothing is drawn while nothing happens. A frame advances the camera, draws the terrain into its own texture if its scene
changed or tiles arrived (``drawing``), and panels and furniture over it. The terrain has the area that panels leave.
The canvas may be any of ``rendercanvas``: a glfw window, or a notebook's widget. ``events``, ``keys`` and ``commands``
handle mouse and keyboard.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from imgui_bundle import imgui

from orograph.gpu.device import Device, open_device
from orograph.store.terrain import Terrain
from orograph.viewer import overlay, panels
from orograph.viewer.brushing import Brush
from orograph.viewer.cover import Cover
from orograph.viewer.data import Found
from orograph.viewer.drawing import Drawer, Drawing
from orograph.viewer.events import Events
from orograph.viewer.finding import Finder
from orograph.viewer.opening import Opened, open_canvas
from orograph.viewer.panels.plot import Plotted
from orograph.viewer.pictures import Pictures
from orograph.viewer.plan import Plan
from orograph.viewer.replacing import Move, Renewal
from orograph.viewer.session import Session
from orograph.viewer.tools import Tools
from orograph.viewer.touring import Touring
from orograph.viewpoint import Point, View

PROGRESS = 0.2
"""Seconds between frames that show the progress of a measurement."""
ASKED = 0.1
"""Seconds between queries of what is under the pointer while the camera moves."""
SETTLED = 0.12
"""Seconds without motion after which the picture is drawn at full size."""
AFTER = 6
"""Frames drawn after an event: ImGui takes some events one by one, and shows a tab one frame after it is chosen."""

LITTLE = 150.0
"""Width below which the terrain is hardly visible, logical pixels."""

Area = tuple[float, float, float, float]


class Window:
    """A session on a canvas.

    Args:
        session: the terrain and its state.
        canvas: a ``rendercanvas`` canvas without a context.
        make: makes the renderer on a device.
        device: where to draw; None: the one from ``open_device``.
        clipboard: functions that get and set the clipboard's text.
        opened: the result of ``open_canvas``, if something was already drawn on the canvas.

    Attributes:
        drawing: the terrain's picture; pictures: what saves it; plan, tools: the map inset and the measuring tool.
        renewal: watches for a replaced store.
        brush: what is selected; finder: finds the best view of it. plotted, dragged: the plot that is shown, and where
            in it dragging began.
        touring: the tour being made or played. cover: how much layers hide of the colours of heights.
        area: where the terrain is: (x, y, width, height), logical pixels.
        pointer: where the mouse is over the terrain, pixels of the view, or None.
        interval: seconds between frames in motion.
        help: whether the keys are shown; texts: what is being typed into panels.
        on_frame: called after every frame.
    """

    def __init__(
        self,
        session: Session,
        canvas: Any,
        make: Callable[[Device, Terrain], Drawer],
        *,
        device: Device | None = None,
        clipboard: tuple[Callable[[], str], Callable[[str], None]] | None = None,
        adapter: str | None = None,
        opened: Opened | None = None,
    ) -> None:
        self.session, self.canvas, self.adapter = session, canvas, adapter
        self.clipboard = clipboard or (lambda: imgui.get_clipboard_text(), lambda text: imgui.set_clipboard_text(text))
        self.device = device or open_device(adapter)
        self.gui, self.context, format = opened or open_canvas(canvas, self.device, clipboard)
        self.drawing = Drawing(self, make, format)
        self.renewal = Renewal(self, make)
        self.plan = Plan(self)
        self.tools = Tools(self)
        self.touring = Touring(session)
        self.brush, self.finder = Brush(), Finder(self)
        session.settings.seen = lambda: self.brush.seen(session.terrain, session.settings.shown)
        self.plotted: Plotted | None = None
        self.dragged: tuple[float, float] | None = None
        self.cover = Cover(session)
        self.pictures = Pictures(self)
        self.area: Area = (0.0, 0.0, *canvas.get_logical_size())
        self.interval = 0.0
        self.help = False
        self.pointer: tuple[float, float] | None = None
        self.texts: dict[str, str] = {}
        self.on_frame: list[Callable[[Window], None]] = []
        self._last = time.perf_counter()
        self._was_moving = False
        self._viewed: View | None = None
        self._asked: tuple[View, float] | None = None
        self._moved = 0.0
        self._pending = AFTER
        self._alarm: threading.Timer | None = None
        self._warned = False
        self._cache: dict[Any, tuple[Any, Any]] = {}
        session.changed = self.refresh
        self.events = Events(self)
        canvas.request_draw(self._frame)

    def refresh(self) -> None:
        """Request a frame; from any thread."""
        self._pending = max(self._pending, 1)
        self.canvas.request_draw()

    def touch(self) -> None:
        """Something happened: draw the few frames that ImGui needs to see it."""
        self._pending = AFTER
        self.canvas.request_draw()

    # ---- places and what is known of them ------------------------------------------------------------------------

    @property
    def ratio(self) -> float:
        """Physical pixels per logical pixel."""
        return float(self.canvas.get_pixel_ratio()) or 1.0

    def to_picture(self, x: float, y: float) -> tuple[float, float]:
        """Logical pixels of the canvas → pixels of the view."""
        ratio = self.ratio
        return (x - self.area[0]) * ratio, (y - self.area[1]) * ratio

    def to_canvas(self, x: float, y: float) -> tuple[float, float]:
        """Pixels of the view → logical pixels of the canvas."""
        ratio = self.ratio
        return x / ratio + self.area[0], y / ratio + self.area[1]

    def middle(self) -> Point | None:
        """The approximate ground in the middle of the picture, looked up once per view."""
        view = self.session.view
        found: Point | None = self.cached(
            ("middle", view, self.session.settings.exaggeration),
            lambda: self.session.probe.pick_about(
                view, view.width / 2, view.height / 2, self.session.settings.exaggeration
            ),
        )
        return found

    def found(self) -> tuple[Found, ...]:
        """Data under the pointer: the visible thing's, then those painted on the ground."""
        shown, hit = self.session.settings.shown, self.session.probe.hit
        if shown is None or self.pointer is None:
            return ()
        thing = shown.of_thing(self.drawing.thing_at(*self.pointer))
        return thing if hit is None else (*thing, *shown.at(hit.easting, hit.northing))

    def cached(self, key: Any, make: Callable[[], Any]) -> Any:
        """The result of ``make``, computed once per key; the last of each kind (the key's first part) is kept."""
        kind = key[0] if isinstance(key, tuple) else key
        held = self._cache.get(kind)
        if held is None or held[0] != key:
            held = self._cache[kind] = key, make()
        return held[1]

    def renew(self, renderer: Drawer, move: Move, moved: Callable[[View], View | None]) -> None:
        """Show the session's new terrain.

        Args:
            renderer: draws it.
            move, moved: from places on the old terrain, and views of it, to those of the new one.
        """
        self.drawing.renew(renderer)
        self.cover = Cover(self.session)
        self.plan.forget()
        self.tools.renew(move)
        self.touring.renew(moved)
        self._cache.clear()
        self._viewed = self._asked = None
        self.canvas.set_title(f"{self.session.terrain.name} — Orograph")
        self.touch()

    # ---- frames --------------------------------------------------------------------------------------------------

    def _frame(self) -> None:
        """Draw a frame; if the device is lost meanwhile, a later frame is drawn on another."""
        if not self.drawing.ready():
            return
        try:
            self.drawing.check()
            self.renewal.take()
            self._draw()
        except Exception as error:
            if not self.drawing.lost(error):
                raise
            self.drawing.reopen()
            self.touch()

    def _draw(self) -> None:
        now = time.perf_counter()
        passed, self._last = now - self._last, now
        session = self.session
        gone = min(passed, 0.25) if self._was_moving else 1 / 60
        session.advance(gone)
        self.touring.advance(gone)
        playing = panels.data.advance(self, min(passed, 0.5))
        panels.data.finish(self)
        self.finder.take()
        if self.brush.stale(session.terrain, session.settings.shown):
            panels.plot.select(self)
        moving = session.moving or self.touring.playing
        if moving or session.view != self._viewed:
            if self._was_moving:
                self.interval = passed
                self.drawing.draft.tell(passed)
            self._moved, self._was_moving, self._viewed = now, True, session.view
        else:
            self._was_moving = False
        self._pending = max(self._pending - 1, 0)
        self._ask(now, moving)
        size = self.canvas.get_physical_size()
        self.events.decide()
        if self.canvas.get_closed():  # by a key that waited for this frame
            return
        self.gui.begin(self.canvas.get_logical_size(), self.ratio, min(max(passed, 1 / 240), 0.1))
        try:
            self._panels()
        finally:
            panels_drawn = self.gui.end()
        settled = now - self._moved > SETTLED
        self.drawing.draw(1.0 if settled else self.drawing.draft.scale, now)
        if self.device.lost is not None:  # the panels' device resources are lost too
            self.touch()
            return
        self.compose(self.context.get_current_texture().create_view(), size, panels_drawn)
        for hook in list(self.on_frame):
            hook(self)
        if self.pictures.asked is not None and self._pending == 0 and not session.settings.finer.coming:
            self.pictures.save()
        self._go_on(moving or not settled or playing)

    def _ask(self, now: float, moving: bool) -> None:
        """Query what is under a resting pointer while the camera moves."""
        view = self.session.view
        if self._asked is None:
            self._asked = view, now
        elif self._asked[0] != view and (not moving or now - self._asked[1] > ASKED):
            self._asked = view, now
            if self.pointer is not None:
                self.tools.hover()

    def _go_on(self, moving: bool) -> None:
        """Request the next frame: at once, later, or when something happens."""
        talking = self.session.messages.advance()
        if moving or self._pending or self.gui.waiting or self.pictures.asked is not None or self.drawing.eager:
            self.canvas.request_draw()
            return
        waits = self.drawing.waits
        if self.tools.busy:
            waits.append(PROGRESS)
        if talking:
            waits.append(1.0)
        if waits and (self._alarm is None or not self._alarm.is_alive()):
            self._alarm = threading.Timer(min(waits), self.refresh)
            self._alarm.daemon = True
            self._alarm.start()

    def compose(self, target: Any, size: tuple[int, int], panels_drawn: Any) -> None:
        """Terrain and panels onto a texture's view of ``size`` pixels."""
        encoder = self.device.handle.create_command_encoder()
        x, y, w, h = (round(v * self.ratio) for v in self.area)
        done = self.drawing.screen.present(encoder, target, (x, y, w, h), size)
        self.gui.backend.render(panels_drawn, done)
        done.end()
        self.device.queue.submit([encoder.finish()])

    def _panels(self) -> None:
        """Draw panels and furniture; finds the area that they leave to the terrain."""
        self.area = panels.dock(self)
        if self.session.settings.panels and self.area[2] < LITTLE and not self._warned:
            self._warned = True
            self.session.messages.say("The panels leave little of the terrain: Tab hides them.")
        self.area = self.plan.place(self.area)
        width, height = (max(1, round(v * self.ratio)) for v in self.area[2:])
        if (width, height) != (self.session.view.width, self.session.view.height):
            self.session.resize(width, height)
        self.tools.draw()
        if self.session.settings.furniture:
            overlay.furniture(self)
        overlay.pivot(self)
        self.plan.draw()
        if self.session.settings.panels:
            panels.draw(self)
        overlay.messages(self)
        if self.help:
            overlay.help(self)
