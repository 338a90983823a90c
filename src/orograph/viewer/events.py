"""Dispatch mouse and keyboard events to panels, the camera, the tool, or a key's command.

Events are ``rendercanvas``'s; positions are logical pixels of the canvas. A press that begins over a panel belongs to
the panel, and typing belongs to a text field while it has the keyboard.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from orograph.viewer import commands
from orograph.viewer.keys import bindings

if TYPE_CHECKING:
    from orograph.viewer.window import Window


class Events:
    """The handlers of a window's events."""

    def __init__(self, window: Window) -> None:
        self.window = window
        self._keys = {(b.key, b.control): b for b in bindings()}
        self._later: list[dict[str, Any]] = []
        for handler, *kinds in (
            (self._on_pointer, "pointer_move", "pointer_down", "pointer_up", "double_click", "wheel"),
            (self._on_leave, "pointer_leave"),
            (self._on_key, "key_down", "key_up"),
            (self._on_text, "char"),
            (self._on_resize, "resize"),
            (self._on_close, "close"),
        ):
            window.canvas.add_event_handler(handler, *kinds)

    def _on_pointer(self, event: dict[str, Any]) -> None:
        kind, x, y = event["event_type"], event["x"], event["y"]
        nav = self.window.session.nav
        self.window.touch()
        self.window.gui.pointer(x, y)
        px, py = self.window.to_picture(x, y)
        if kind == "pointer_move":
            nav.move(px, py)
            self.window.pointer = None if not nav.dragging and self.window.gui.over(x, y) else (px, py)
            self.window.tools.hover()
            return
        if kind == "pointer_up":
            self.window.gui.button(event["button"], False)
            if nav.release(event["button"], px, py) and event["button"] == 1:
                self.window.tools.click(px, py)
            return
        over = self.window.gui.over(x, y)
        if kind == "pointer_down":
            self.window.gui.button(event["button"], True)
            if over:
                self.window.gui.pressed()
            else:
                nav.press(event["button"], px, py, event["modifiers"])
        elif kind == "wheel":
            self.window.gui.wheel(event["dx"] / 100.0, -event["dy"] / 100.0)
            if not over:
                nav.wheel(px, py, -event["dy"] / 100.0)
        elif kind == "double_click" and not over:
            if self.window.tools.active:
                self.window.tools.finish()
            elif event["button"] == 1:
                nav.double_click(px, py)

    def _on_leave(self, event: dict[str, Any]) -> None:
        self.window.pointer = None
        self.window.gui.left()
        self.window.session.probe.leave()
        self.window.touch()

    def _on_key(self, event: dict[str, Any]) -> None:
        self.window.touch()
        if event["key"] != "Tab":
            self.window.gui.key(event["key"], event["event_type"] == "key_down")
        self._later.append(event)
        self.decide()

    def _on_text(self, event: dict[str, Any]) -> None:
        self.window.touch()
        self.window.gui.text(_text(event))
        self._later.append(event)
        self.decide()

    def decide(self) -> None:
        """Run the commands of pressed keys that are not for a text field. It runs in every frame, because keys that
        follow a press on a panel wait until that is drawn."""
        while self._later and not self.window.gui.undecided:
            event = self._later.pop(0)
            if event["event_type"] != "char":
                self._key(event)
            elif _text(event) == "?" and not self.window.gui.typing:
                commands.toggle_help(self.window)

    def _key(self, event: dict[str, Any]) -> None:
        key, modifiers = event["key"], event["modifiers"]
        nav, down, typing = self.window.session.nav, event["event_type"] == "key_down", self.window.gui.typing
        if key == "Tab" and (typing or not down):  # elsewhere it would go to a field of the panels that Tab shows
            self.window.gui.key(key, down)
        if not down:
            nav.key_up(key, modifiers)
            return
        if typing and key != "Escape":
            return
        control = "Control" in modifiers or "Meta" in modifiers
        name = key.lower() if len(key) == 1 else key
        binding = self._keys.get((name, control))
        if binding is not None:
            binding.do(self.window)
        else:
            nav.key_down(key, modifiers)

    def _on_resize(self, event: dict[str, Any]) -> None:
        self.window.touch()  # (rendercanvas may tell of a new size and not draw)

    def _on_close(self, event: dict[str, Any]) -> None:
        self.window.renewal.close()
        self.window.session.close()
        self.window.drawing.close()


def _text(event: dict[str, Any]) -> str:
    """Handle typed text."""
    return event.get("data") or event.get("char_str") or ""
