"""Data on the terrain: what comes first, which time, and what their colours mean."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from imgui_bundle import imgui

from orograph.errors import OrographError
from orograph.geovis.keys import Legend, Scale
from orograph.viewer.panels.tips import tip

if TYPE_CHECKING:
    from orograph.viewer.window import Window

SWITCHES = (
    ("terrain", "On: shaded relief. Off: contours and silhouettes, no shading."),
    ("data", "On: a continuous scale. Off: classes."),
    ("uncertainty", "On: signs of its own. Off: what the colours of the data lose."),
)
HIGH, STEPS = 14.0, 48


def draw(window: Window) -> None:
    """The content of the panel."""
    settings = window.session.settings
    shown = settings.shown
    if shown is None:
        imgui.text_wrapped("There are no data: name some as the window is opened.")
        return
    imgui.text_unformatted("what comes first")
    for name, what in SWITCHES:
        moved, on = imgui.checkbox(f"{name}##first", getattr(shown.priority, name))
        tip(what)
        if moved:
            change(window, priority=replace(shown.priority, **{name: on}))
    _times(window)
    for key in window.session.scene().keys:
        _key(key)


def change(window: Window, **changes: Any) -> None:
    """Show data with another priority or time; what is wrong with it is said in the window."""
    try:
        window.session.settings.show(window.session.terrain, **changes)
    except (OrographError, OSError) as error:
        window.session.messages.say(str(error))
    window.touch()


def _times(window: Window) -> None:
    """A slider over the times of a series; the data are read when it is let go."""
    shown = window.session.settings.shown
    if shown is None or len(shown.times) < 2:
        return
    at = shown.times.index(shown.time) + 1 if shown.time else 0
    at = int(window.texts.get("time", at))
    told = shown.times[at - 1].replace("T", " ") if at else "as given"
    imgui.set_next_item_width(-1)
    moved, at = imgui.slider_int("##time", at, 0, len(shown.times), told, imgui.SliderFlags_.always_clamp)
    if moved:
        window.texts["time"] = str(at)
    if imgui.is_item_deactivated_after_edit():
        at = int(window.texts.pop("time", at))
        change(window, time=shown.times[at - 1] if at else "")


def _key(key: Legend) -> None:
    """Scales and classes of data."""
    pen = imgui.get_window_draw_list()
    for scale in key.scales:
        imgui.text_unformatted(scale.words)
        _ramp(pen, scale)
        low, high = f"{scale.low:.4g}", f"{scale.high:.4g}"
        imgui.text_unformatted(low)
        imgui.same_line(max(imgui.get_content_region_avail().x - imgui.calc_text_size(high).x, 60.0))
        imgui.text_unformatted(high)
    for words, colors in (*key.classes, *key.swatches):
        at = imgui.get_cursor_screen_pos()
        rgb = np.asarray(colors).reshape(-1, 3)
        mean = rgb.mean(0) / (255.0 if rgb.dtype.kind in "iu" else 1.0)
        pen.add_rect_filled((at.x, at.y + 2), (at.x + HIGH, at.y + 2 + HIGH), _ink(mean))
        imgui.set_cursor_screen_pos((at.x + HIGH + 6, at.y))
        imgui.text_unformatted(words)
    for both in key.squares:
        imgui.text_unformatted(f"across: {both.across}")
        imgui.text_unformatted(f"up: {both.up}")
    if key.note:
        imgui.text_wrapped(key.note)


def _ramp(pen: Any, scale: Scale) -> None:
    at, wide = imgui.get_cursor_screen_pos(), max(imgui.get_content_region_avail().x, 20.0)
    table = np.asarray(scale.colors)
    table = table[np.linspace(0, len(table) - 1, STEPS).round().astype(int)]
    table = table / (255.0 if table.dtype.kind in "iu" else 1.0)
    for k, rgb in enumerate(table):
        left, right = at.x + wide * k / STEPS, at.x + wide * (k + 1) / STEPS
        pen.add_rect_filled((left, at.y), (right, at.y + HIGH), _ink(rgb))
    imgui.dummy((wide, HIGH + 2))


def _ink(rgb: Any) -> int:
    return int(imgui.get_color_u32((float(rgb[0]), float(rgb[1]), float(rgb[2]), 1.0)))
