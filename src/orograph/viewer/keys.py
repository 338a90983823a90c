"""The keys and what they do: one table for the window, which executes it, and the help, which prints it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from orograph.viewer import commands

if TYPE_CHECKING:
    from orograph.viewer.window import Window

MOUSE = (
    ("Left drag", "move the ground under the cursor"),
    ("Right drag, Shift + left drag", "orbit the point under the cursor"),
    ("Middle drag, Ctrl + left drag", "look around"),
    ("Wheel", "zoom to the cursor"),
    ("Double click", "go there"),
)
HELD = (
    ("W A S D", "fly forward, left, back, right"),
    ("E Q", "fly up, down"),
    ("Arrows", "turn"),
    ("Shift, Ctrl", "while held: faster, slower"),
)


@dataclass(frozen=True, slots=True)
class Binding:
    """A key.

    Attributes:
        key: ``rendercanvas``'s name, letters in lower case. control: with Ctrl (or Cmd).
        label: for the help. what: the effect, in a few words. do: the effect.
    """

    key: str
    what: str
    do: Callable[[Window], None]
    control: bool = False
    shown: str = ""

    @property
    def label(self) -> str:
        """The key as it is written."""
        name = self.shown or (self.key.upper() if len(self.key) == 1 else self.key)
        return f"Ctrl + {name}" if self.control else name


def _recall(window: Window, slot: str) -> None:
    window.session.recall_view(slot)


def _keep(window: Window, slot: str) -> None:
    window.session.keep_view(slot)


def bindings() -> tuple[Binding, ...]:
    """All keys that trigger something when pressed."""
    digits = [
        *(Binding(d, "go to a kept view", partial(_recall, slot=d), shown="1 … 9") for d in "123456789"),
        *(Binding(d, "keep this view", partial(_keep, slot=d), control=True, shown="1 … 9") for d in "123456789"),
    ]
    return (
        Binding("h", "home: all of the terrain", lambda w: w.session.nav.go_home(), shown="H, Home"),
        Binding("Home", "home: all of the terrain", lambda w: w.session.nav.go_home(), shown="H, Home"),
        Binding("n", "north up", lambda w: w.session.nav.north_up()),
        Binding("t", "straight down", lambda w: w.session.nav.straight_down()),
        Binding("o", "oblique", lambda w: w.session.nav.oblique()),
        Binding("[", "turn by a quarter", lambda w: w.session.nav.turn_quarter(-1), shown="[ ]"),
        Binding("]", "turn by a quarter", lambda w: w.session.nav.turn_quarter(1), shown="[ ]"),
        Binding("=", "nearer, farther", lambda w: commands.zoom_middle(w, 1.0), shown="+ -"),
        Binding("-", "nearer, farther", lambda w: commands.zoom_middle(w, -1.0), shown="+ -"),
        *digits,
        Binding("c", "copy the view as JSON", commands.copy_view, control=True),
        Binding("v", "go to the view in the clipboard", commands.paste_view, control=True),
        Binding("Tab", "panels", commands.toggle_panels),
        Binding("p", "plan: inset, half, none", lambda w: w.plan.cycle()),
        Binding("m", "measure", lambda w: w.tools.toggle()),
        Binding("Escape", "leave the help, a tour, the tool or a flight", commands.escape),
        Binding(",", "the data's previous time, next time", partial(commands.step_data, way=-1), shown=", ."),
        Binding(".", "the data's previous time, next time", partial(commands.step_data, way=1), shown=", ."),
        Binding(" ", "play the day", commands.play_day, shown="Space"),
        Binding("k", "add this camera to the tour", commands.add_stop),
        Binding("l", "play the tour", commands.play_tour),
        Binding("Backspace", "remove the last point", lambda w: w.tools.undo()),
        Binding("x", "wireframe", commands.toggle_wireframe),
        Binding("f", "freeze the mesh and fly around it", commands.toggle_freeze),
        Binding("q", "close the window", lambda w: w.canvas.close(), control=True),
        Binding("F12", "save a picture", lambda w: w.pictures.ask()),
        Binding("F1", "this help", commands.toggle_help, shown="F1, ?"),
    )


def help_rows() -> list[tuple[str, str]]:
    """(key, effect), one row for similar keys."""
    rows: dict[str, str] = {}
    for b in bindings():
        rows.setdefault(b.label, b.what)
    return list(rows.items())
