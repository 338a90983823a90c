"""What keys and buttons do to a window, one function each; ``keys`` binds them, panels call them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from orograph.errors import OrographError

if TYPE_CHECKING:
    from orograph.viewer.window import Window


def zoom_middle(window: Window, notches: float) -> None:
    """Zoom towards the middle of the picture."""
    view = window.session.view
    window.session.nav.wheel(view.width / 2, view.height / 2, notches)


def copy_view(window: Window) -> None:
    """Copy the view to the clipboard as JSON."""
    window.clipboard[1](window.session.view_json())
    window.session.messages.say("The view is in the clipboard: save it as a file to draw pictures with it.")


def paste_view(window: Window) -> None:
    """Go to the view in the clipboard."""
    window.session.paste_view(window.clipboard[0]() or "")


def toggle_panels(window: Window) -> None:
    """Show or hide all panels."""
    window.session.settings.panels = not window.session.settings.panels


def toggle_help(window: Window) -> None:
    """Show or hide the keys."""
    window.help = not window.help


def toggle_wireframe(window: Window) -> None:
    """Show or hide the edges of triangles."""
    window.session.settings.wireframe = not window.session.settings.wireframe


def toggle_freeze(window: Window) -> None:
    """Freeze the mesh of this view, or let it follow again."""
    frozen = window.session.settings.frozen is None
    window.session.freeze(frozen)
    window.session.messages.say(
        "The mesh of this view is frozen: fly around it; F lets it follow again."
        if frozen
        else "The mesh follows the view again."
    )


def play_day(window: Window) -> None:
    """Start or stop the passing of the sun's time."""
    light = window.session.settings.sun
    if light.place is None:
        window.session.messages.say(light.trouble)
        return
    light.mode, light.playing = "moment", not light.playing


def add_stop(window: Window) -> None:
    """Add this camera to the tour."""
    touring = window.touring
    touring.add()
    k = touring.chosen or 0
    window.session.messages.say(f"Stop {k + 1} of {len(touring.stops)}, at {touring.times[k]:.1f} s of the tour.")


def play_tour(window: Window) -> None:
    """Play the tour, or pause it."""
    window.touring.play()


def escape(window: Window) -> None:
    """Close the first of these that is active: the help, the tool, or a flight."""
    if window.help:
        window.help = False
    elif window.touring.playing:
        window.touring.playing = False
    elif window.tools.active:
        window.tools.leave()
    else:
        window.session.nav.stop()


def change_data(window: Window, **changes: Any) -> None:
    """Show data with another priority or time; errors appear in the window."""
    try:
        window.session.settings.show(window.session.terrain, **changes, finer=window.refresh)
    except (OrographError, OSError) as error:
        window.session.messages.say(str(error))
    window.touch()


def step_data(window: Window, way: int) -> None:
    """Show the data's next or previous time; for tracks alone, step by a fiftieth of all time."""
    shown = window.session.settings.shown
    if shown is None or shown.span is None:
        return
    if len(shown.times) < 2:
        change_data(window, time=shown.at_part(min(max(shown.part + way / 50, 0.0), 1.0)))
        return
    after = [time for time in shown.times if time > shown.time]
    before = [time for time in shown.times if time < shown.time]
    following = after[:1] if way > 0 else before[-1:]
    if following:
        change_data(window, time=following[0])
