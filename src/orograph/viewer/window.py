"""The window: a canvas, a renderer, panels, and the loop that draws when something changed.

Nothing is drawn while nothing happens. A frame advances the camera, draws the terrain into its own texture if its scene
changed or tiles came (``screen``), and panels and furniture over it. The terrain has the area that docked panels leave.

Whatever fails while a frame is drawn (a file that vanished, a device that was lost) becomes a message in the window;
the last picture stays, and drawing is tried again when something changes or after ``RETRY`` seconds. The canvas may be
any of ``rendercanvas``: a glfw window, or a notebook's widget.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from imgui_bundle import imgui

from orograph.errors import OrographError
from orograph.gpu.device import Device, open_device
from orograph.picture.scene import Scene
from orograph.store.terrain import Terrain
from orograph.view import Point, View
from orograph.viewer import overlay, panels
from orograph.viewer.keys import bindings
from orograph.viewer.opening import Opened, open_canvas
from orograph.viewer.plan import Plan
from orograph.viewer.screen import TOO_SLOW, Draft, Screen
from orograph.viewer.session import Session
from orograph.viewer.tools import Tools

RETRY = 2.0
PROGRESS = 0.2
"""Seconds between frames that show how far a measurement is."""
SETTLED = 0.12
"""Seconds without motion after which the picture is drawn at full size."""
PATIENCE = 0.4
"""Seconds of rest after which a slow device makes a picture smoother."""
PICTURE_SAMPLES = 16
AFTER = 3
"""Frames drawn after an event: ImGui takes some events one by one."""

Area = tuple[float, float, float, float]


class Drawer(Protocol):
    """What draws terrain: ``gpu.renderer.Renderer``."""

    def draw(
        self, target: Any, format: str, scene: Scene, *, overlay: Any = ..., freeze: View | None = None,
        wait: bool = False, samples: int | None = None,
    ) -> Any:  # fmt: skip
        """Draw a scene into a texture's view; statistics."""

    @property
    def busy(self) -> bool:
        """Whether tiles are on their way."""

    @property
    def resting(self) -> bool:
        """Whether further frames of the same scene would be the same."""

    def close(self) -> None:
        """Let go of everything."""


class Window:
    """A session on a canvas.

    Args:
        session: what is looked at.
        canvas: a ``rendercanvas`` canvas, with no context yet.
        make: makes the renderer on a device.
        device: where; None: the one ``open_device`` gives.
        clipboard: functions that get and set the clipboard's text.
        opened: what ``open_canvas`` gave for the canvas, if something was drawn on it before.

    Attributes:
        stats: what the last frame of the terrain told; interval: seconds between frames in motion; drawn: how many
            frames of the terrain were drawn.
        area: where the terrain is: (x, y, width, height), logical pixels.
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
        self.session, self.canvas, self.make, self.adapter = session, canvas, make, adapter
        self.clipboard = clipboard or (lambda: imgui.get_clipboard_text(), lambda text: imgui.set_clipboard_text(text))
        self.device = device or open_device(adapter)
        self.gui, self.context, self.format = opened or open_canvas(canvas, self.device, clipboard)
        self.renderer: Drawer = make(self.device, session.terrain)
        self.screen = Screen(self.device, self.format)
        self.plan = Plan(self)
        self.tools = Tools(self)
        self.draft = Draft(self.device.adapter.software)
        self.area: Area = (0.0, 0.0, *canvas.get_logical_size())
        self.stats: Any = None
        self.interval = 0.0
        self.drawn = 0
        self._drawn_at = 0.0
        self.help = False
        self.pointer: tuple[float, float] | None = None
        self._scene: tuple[Any, ...] | None = None
        self._resting = True
        self._failed = 0.0
        self._last = time.perf_counter()
        self._was_moving = False
        self._viewed: View | None = None
        self._trouble = ""
        self._alarm: threading.Timer | None = None
        self._moved = 0.0
        self._pending = AFTER
        self._held = False
        self._keys = {(b.key, b.control): b for b in bindings()}
        self.on_frame: list[Callable[[Window], None]] = []
        self._cache: dict[Any, tuple[Any, Any]] = {}
        self._slow = False
        self._saving: Path | None = None
        self.texts: dict[str, str] = {}
        session.changed = self.refresh
        for handler, *kinds in (
            (self._on_pointer, "pointer_move", "pointer_down", "pointer_up", "double_click", "wheel"),
            (self._on_leave, "pointer_leave"),
            (self._on_key, "key_down", "key_up"),
            (self._on_text, "char"),
            (self._on_close, "close"),
        ):
            canvas.add_event_handler(handler, *kinds)
        canvas.request_draw(self._frame)

    # ---- events --------------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Draw again soon; from any thread."""
        self._pending = max(self._pending, 1)
        self.canvas.request_draw()

    def _touch(self) -> None:
        self._pending = AFTER
        self.canvas.request_draw()

    def to_picture(self, x: float, y: float) -> tuple[float, float]:
        """Logical pixels of the canvas → pixels of the view."""
        ratio = self.ratio
        return (x - self.area[0]) * ratio, (y - self.area[1]) * ratio

    def to_canvas(self, x: float, y: float) -> tuple[float, float]:
        """Pixels of the view → logical pixels of the canvas."""
        ratio = self.ratio
        return x / ratio + self.area[0], y / ratio + self.area[1]

    @property
    def ratio(self) -> float:
        """Physical pixels in a logical one."""
        return float(self.canvas.get_pixel_ratio()) or 1.0

    def _on_pointer(self, event: dict[str, Any]) -> None:
        kind, x, y = event["event_type"], event["x"], event["y"]
        nav = self.session.nav
        self._touch()
        self.gui.pointer(x, y)
        px, py = self.to_picture(x, y)
        if kind == "pointer_move":
            nav.move(px, py)
            self.pointer = None if not nav.dragging and self.gui.over(x, y) else (px, py)
            self.tools.hover()
            return
        if kind == "pointer_up":
            self.gui.button(event["button"], False)
            if nav.release(event["button"], px, py) and event["button"] == 1:
                self.tools.click(px, py)
            return
        over = self.gui.over(x, y)
        if kind == "pointer_down":
            self.gui.button(event["button"], True)
            if not over:
                nav.press(event["button"], px, py, event["modifiers"])
        elif kind == "wheel":
            self.gui.wheel(event["dx"] / 100.0, -event["dy"] / 100.0)
            if not over:
                nav.wheel(px, py, -event["dy"] / 100.0)
        elif kind == "double_click" and not over:
            if self.tools.active:
                self.tools.finish()
            elif event["button"] == 1:
                nav.double_click(px, py)

    def _on_leave(self, event: dict[str, Any]) -> None:
        self.pointer = None
        self.session.probe.leave()
        self._touch()

    def _on_key(self, event: dict[str, Any]) -> None:
        down, key, modifiers = event["event_type"] == "key_down", event["key"], event["modifiers"]
        nav = self.session.nav
        self._touch()
        self.gui.key(key, down)
        if not down:
            nav.key_up(key, modifiers)
            return
        if self.gui.typing and key != "Escape":
            return
        control = "Control" in modifiers or "Meta" in modifiers
        name = key.lower() if len(key) == 1 else key
        binding = self._keys.get((name, control))
        if binding is not None:
            binding.do(self)
        else:
            nav.key_down(key, modifiers)

    def _on_text(self, event: dict[str, Any]) -> None:
        text = event.get("data") or event.get("char_str") or ""
        self.gui.text(text)
        if text == "?" and not self.gui.typing:
            self.toggle_help()
        self._touch()

    def _on_close(self, event: dict[str, Any]) -> None:
        self.session.close()
        self.renderer.close()

    # ---- what keys and buttons do --------------------------------------------------------------------------------

    def zoom_middle(self, notches: float) -> None:
        """Zoom to the middle of the picture."""
        view = self.session.view
        self.session.nav.wheel(view.width / 2, view.height / 2, notches)

    def copy_view(self) -> None:
        """The view, as JSON, into the clipboard."""
        self.clipboard[1](self.session.view_json())
        self.session.messages.say("The view is in the clipboard: render --view takes it from a file.")

    def paste_view(self) -> None:
        """Go to the view in the clipboard."""
        self.session.paste_view(self.clipboard[0]() or "")

    def toggle_panels(self) -> None:
        """Show or hide all panels."""
        self.session.settings.panels = not self.session.settings.panels

    def toggle_help(self) -> None:
        """Show or hide the keys."""
        self.help = not self.help

    def toggle_wireframe(self) -> None:
        """Show or hide the edges of triangles."""
        self.session.settings.wireframe = not self.session.settings.wireframe

    def toggle_freeze(self) -> None:
        """Keep the mesh of this view, or let it follow again."""
        frozen = self.session.settings.frozen is None
        self.session.freeze(frozen)
        self.session.messages.say(
            "The mesh is that of this view: fly around it; F lets it follow again." if frozen else "The mesh follows."
        )

    def play_day(self) -> None:
        """Let the sun's time pass, or stop it."""
        light = self.session.settings.light
        if light.place is None:
            self.session.messages.say(light.trouble)
            return
        light.mode, light.playing = "moment", not light.playing

    def escape(self) -> None:
        """Leave the help, the tool, or a flight: the first that is on."""
        if self.help:
            self.help = False
        elif self.tools.active:
            self.tools.leave()
        else:
            self.session.nav.stop()

    def save_picture(self) -> None:
        """Save what is seen of the terrain, and the view beside it, when this frame is drawn."""
        stem = "".join(c if c.isalnum() or c in "-_." else "-" for c in self.session.terrain.name)
        self._saving = Path.cwd() / f"{stem}-{time.strftime('%Y%m%d-%H%M%S')}.png"
        self.session.messages.say("Saving a picture, with all tiles and smooth edges.")

    def _save(self, path: Path) -> None:
        try:
            self.write_picture(path)
            path.with_suffix(".json").write_text(self.session.view_json() + "\n", encoding="utf-8")
        except (OrographError, OSError) as error:
            self.session.messages.say(f"The picture was not saved: {error}", error=True)
        else:
            self.session.messages.say(f"Saved {path.name}, and its view as {path.stem}.json, in {path.parent}.")
        self._touch()

    def write_picture(self, path: Path, *, panels: bool = False) -> None:
        """Write the terrain's picture as it is with all tiles there; ``panels``: the whole window's.

        Raises:
            OutputError: it cannot be written.
        """
        from PIL import Image

        from orograph.output import Beside

        scene, settings = self.session.scene(), self.session.settings
        self.screen.prepare(scene.view.width, scene.view.height)
        self.renderer.draw(
            self.screen.view, self.format, scene, overlay=settings.overlay(), freeze=settings.frozen, wait=True,
            samples=PICTURE_SAMPLES,
        )  # fmt: skip
        self._scene = None
        if panels:
            size = self.canvas.get_physical_size()
            texture = self.device.texture(size, self.format, "RENDER_ATTACHMENT|COPY_SRC", label="window")
            self._compose(texture.create_view(), size, imgui.get_draw_data())
            pixels = self.screen.read(texture)
        else:
            pixels = self.screen.pixels()
        with Beside(path) as part:
            Image.fromarray(pixels).save(part, format="PNG")

    def middle(self) -> Point | None:
        """The ground in the middle of the picture, coarsely: looked up once for a view."""
        view = self.session.view
        found: Point | None = self.cached(
            ("middle", view, self.session.settings.exaggeration),
            lambda: self.session.probe.pick_coarse(
                view, view.width / 2, view.height / 2, self.session.settings.exaggeration
            ),
        )
        return found

    def cached(self, key: Any, make: Callable[[], Any]) -> Any:
        """What ``make`` gives, made once for a key; the last of each kind (the key's first part) is kept."""
        kind = key[0] if isinstance(key, tuple) else key
        held = self._cache.get(kind)
        if held is None or held[0] != key:
            held = self._cache[kind] = key, make()
        return held[1]

    # ---- frames --------------------------------------------------------------------------------------------------

    def _frame(self) -> None:
        now = time.perf_counter()
        passed, self._last = now - self._last, now
        session = self.session
        session.advance(min(passed, 0.25) if self._was_moving else 1 / 60)
        moving = session.moving
        if moving or session.view != self._viewed:
            if self._was_moving:
                self.interval = passed
                self.draft.tell(passed)
            self._moved, self._was_moving, self._viewed = now, True, session.view
        else:
            self._was_moving = False
        self._pending = max(self._pending - 1, 0)
        size = self.canvas.get_physical_size()
        self.gui.begin(self.canvas.get_logical_size(), self.ratio, min(max(passed, 1 / 240), 0.1))
        try:
            self._gui()
        finally:
            drawing = self.gui.end()
        settled = now - self._moved > SETTLED
        self._draw_terrain(1.0 if settled else self.draft.scale, now)
        self._compose(self.context.get_current_texture().create_view(), size, drawing)
        for hook in list(self.on_frame):
            hook(self)
        if self._saving is not None and self._pending == 0:
            path, self._saving = self._saving, None
            self._save(path)
        self._go_on(moving or not settled)

    def _go_on(self, moving: bool) -> None:
        """Ask for the next frame: at once, later, or not before something happens."""
        talking = self.session.messages.advance()
        patient = self._slow and not self.renderer.busy
        if moving or self._pending or self._saving is not None or not (self._resting or patient):
            self.canvas.request_draw()
            return
        waits = [RETRY] if self._failed else []
        if not self._resting:
            waits.append(PATIENCE)
        if self.tools.busy:
            waits.append(PROGRESS)
        if talking:
            waits.append(1.0)
        if waits and (self._alarm is None or not self._alarm.is_alive()):
            self._alarm = threading.Timer(min(waits), self.refresh)
            self._alarm.daemon = True
            self._alarm.start()

    def _compose(self, target: Any, size: tuple[int, int], drawing: Any) -> None:
        """Terrain and panels onto a texture's view."""
        encoder = self.device.handle.create_command_encoder()
        x, y, w, h = (round(v * self.ratio) for v in self.area)
        done = self.screen.present(encoder, target, (x, y, w, h), size)
        self.gui.backend.render(drawing, done)
        done.end()
        self.device.queue.submit([encoder.finish()])

    def _gui(self) -> None:
        """Panels and furniture; finds the area that they leave to the terrain."""
        self.area = panels.dock(self)
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

    def _draw_terrain(self, scale: float, now: float) -> None:
        """Draw the terrain if its picture would be another one."""
        session, settings = self.session, self.session.settings
        state: tuple[Any, ...] = ()
        try:
            scene, overlay = session.scene(scale), settings.overlay()
            state = scene, overlay, settings.frozen
            same = state == self._scene
            if same and (self._resting if not self._failed else now - self._failed < RETRY):
                return
            calm = self._slow and not self._failed and not self.renderer.busy
            if same and calm and now - self._drawn_at < PATIENCE:
                return  # on a slow device the pointer comes before a smoother picture
            self.screen.prepare(scene.view.width, scene.view.height)
            self.stats = self.renderer.draw(
                self.screen.view, self.format, scene, overlay=overlay, freeze=settings.frozen
            )  # fmt: skip
            self._scene, self._resting = state, bool(self.renderer.resting)
            self.drawn += 1
            self._drawn_at = time.perf_counter()
            self._slow = self._drawn_at - now > TOO_SLOW
            trouble = getattr(self.stats, "failed", "")
            before, self._trouble = self._trouble, trouble
            if trouble and trouble != before:
                session.messages.say(f"A part of the terrain cannot be read: {trouble}", error=True)
            if settings.balance(int(self.stats.triangles)):
                self._touch()
            if self._failed:
                self._failed = 0.0
                session.messages.shown = [m for m in session.messages.shown if not m.error]
        except Exception as error:
            self._scene, self._resting = state, True
            self.screen.revert()
            self._fail(error, now)

    def _fail(self, error: Exception, now: float) -> None:
        """A frame could not be drawn: say so, and try to get a device again if it was lost."""
        first, self._failed = not self._failed, now
        expected = isinstance(error, (OrographError, OSError))
        what = str(error) if expected else f"{type(error).__name__}: {error}"
        self.session.messages.say(f"The terrain could not be drawn. {what}", error=True)
        if first and not expected:
            import traceback

            traceback.print_exc()
        if self.device.lost is not None or "lost" in str(error).lower():
            self._reopen()

    def _reopen(self) -> None:
        """Begin again on a new device."""
        with contextlib.suppress(Exception):  # it is lost anyway
            self.renderer.close()
        try:
            self.device.lost = self.device.lost or "lost while drawing"
            self.device = open_device(self.adapter)
            self.context.configure(device=self.device.handle, format=self.format)
            self.renderer = self.make(self.device, self.session.terrain)
            self.screen = Screen(self.device, self.format)
            self.gui.rebuild(self.device, self.format)
            self.plan.forget_texture()
        except Exception as error:
            self.session.messages.say(f"The GPU was lost and is not to be had again: {error}", error=True)
        else:
            self._scene = None
            self.session.messages.say("The GPU was lost; drawing goes on with a new device.")
