"""Data on the terrain: priorities, time, and the meaning of their colours."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from imgui_bundle import imgui

from orograph.errors import OrographError
from orograph.geovis.data.times import written
from orograph.geovis.keys import Legend, Scale
from orograph.viewer.commands import change_data, step_data
from orograph.viewer.panels.tips import tip

if TYPE_CHECKING:
    from orograph.viewer.data import ShownData
    from orograph.viewer.window import Window

SWITCHES = (
    ("terrain", "On: shaded relief. Off: contours and silhouettes, no shading."),
    ("data", "On: a continuous scale. Off: classes."),
    ("uncertainty", "On: separate glyphs. Off: shown in the colours of the data."),
)
HIGH, STEPS = 14.0, 48
PLAYED = 20.0
"""Seconds in which the data's whole time span is played."""
LONGEST = 0.5
"""Seconds of that which pass at most from one picture to the next, however long reading takes."""


def draw(window: Window) -> None:
    """Draw the panel."""
    settings = window.session.settings
    shown = settings.shown
    if shown is None:
        imgui.text_wrapped("There are no data: give some when opening the window.")
        return
    imgui.text_unformatted("priority" + (" (being painted)" if settings.painting else ""))
    if shares := settings.variants.shares_text:
        imgui.text_wrapped(f"{shares} (as the camera is high and fast)")
    for name, what in () if shares else SWITCHES:
        moved, on = imgui.checkbox(f"{name}##first", getattr(shown.priority, name))
        tip(what)
        if moved:
            change_data(window, priority=replace(shown.priority, **{name: on}))
    _exceeding(window)
    _turns(window)
    _times(window)
    for key in window.session.scene().keys:
        _key(key)


def finish(window: Window) -> None:
    """Show the data that the thread has painted, if ready; errors appear in the window."""
    settings = window.session.settings
    try:
        if settings.finish():
            window.touch()
            turns = None if settings.shown is None else settings.shown.turns
            if turns is not None and turns.on and not turns.members:
                window.session.messages.say("There are no members at this time.")
    except (OrographError, OSError) as error:
        window.session.messages.say(str(error))
        window.touch()


def _exceeding(window: Window) -> None:
    """Choose between values and the probability of exceeding one."""
    shown = window.session.settings.shown
    if shown is None or (k := shown.doubtful) is None:
        return
    moved, on = imgui.checkbox("probability above##exceeds", shown.exceeds is not None)
    tip(
        "Counted over all members or times, or from the normal distribution; use the panel Plot to select where it "
        "is, say, 90 %."
    )
    first = shown.exceeding
    if moved and first is not None:
        exceed(window, float(f"{(first.scale.low + first.scale.high) / 2:.3g}") if on else None)
    elif shown.exceeds is not None:
        unit = "" if first is None else first.field.limit_unit or first.unit
        imgui.same_line()
        imgui.set_next_item_width(-imgui.calc_text_size(unit).x - imgui.get_style().item_spacing.x if unit else -1)
        _, value = imgui.input_float(f"##above{k}", float(window.texts.get("exceeds", shown.exceeds)), format="%.4g")
        if imgui.is_item_active():
            window.texts["exceeds"] = str(value)
        if imgui.is_item_deactivated_after_edit():
            window.texts.pop("exceeds", None)
            exceed(window, value)
        if unit:
            imgui.same_line()
            imgui.text_unformatted(unit)


def _turns(window: Window) -> None:
    """Choose between all members at once and one after the other."""
    shown = window.session.settings.shown
    if shown is None or (turns := shown.turns) is None or shown.exceeds is not None:
        return
    moved, on = imgui.checkbox("members in turn##turns", turns.on)
    tip(f"Shows each member for a moment, {turns.rate:g} a second: what is uncertain moves.")
    if turns.on and turns.member:
        imgui.same_line()
        imgui.text_unformatted(f"{turns.member} of {len(turns.members)}")
    if moved:
        turn(window, on)


def turn(window: Window, on: bool) -> None:
    """Show the members of the data in turn, or all of them."""
    shown = window.session.settings.shown
    if shown is None or shown.turns is None:
        return
    shown.turns.on = on
    change_data(window)


def exceed(window: Window, value: float | None) -> None:
    """Show the probability that the first raster's values exceed one; None: show the values."""
    shown = window.session.settings.shown
    if shown is None:
        return
    shown.exceeds = value
    change_data(window)


def _times(window: Window) -> None:
    """A slider over all time; the data are read when it is released, or while playing as fast as they can be read."""
    shown = window.session.settings.shown
    if shown is None or shown.span is None:
        return
    imgui.separator_text("time (UTC)")
    part = float(window.texts.get("time", shown.part))
    imgui.set_next_item_width(-1)
    label = shown.at_part(part).replace("T", " ") if shown.time or "time" in window.texts else "as given"
    moved, part = imgui.slider_float("##time", part, 0.0, 1.0, label, imgui.SliderFlags_.always_clamp)
    if moved:
        window.texts["time"] = str(part)
    if imgui.is_item_deactivated_after_edit():
        shown.playing = False
        change_data(window, time=shown.at_part(float(window.texts.pop("time", part))))
    if imgui.button("Pause" if shown.playing else "Play##time"):
        shown.playing = not shown.playing
        if shown.playing:
            window.touch()
        else:
            change_data(window)  # finely again
    tip(f"Plays the span below in {PLAYED:g} seconds, or as fast as the data are read.")
    for words, way in (("<##earlier", -1), (">##later", 1)):
        imgui.same_line()
        if imgui.button(words):
            step_data(window, way)
        tip("The previous time (key ,)." if way < 0 else "The next time (key .).")
    imgui.same_line()
    if imgui.button("As given##time"):
        shown.playing = False
        change_data(window, time="")
    _limits(window, shown)
    if shown.time:
        imgui.text_wrapped(shown.time_text)


def _limits(window: Window, shown: ShownData) -> None:
    """Choose the span that is played."""
    assert shown.limits is not None
    first, last = (written(end).replace("T", " ") for end in shown.limits)
    imgui.text_wrapped(f"plays {first} to {last}")
    if imgui.button("From here##time"):
        limit(window, first=shown.time)
    tip("The span that is played begins at the time that is shown.")
    imgui.same_line()
    if imgui.button("To here##time"):
        limit(window, last=shown.time)
    tip("The span that is played ends at the time that is shown.")
    imgui.same_line()
    if imgui.button("All##time"):
        limit(window)


def limit(window: Window, **ends: str) -> None:
    """Play from or to a moment; without one, everything."""
    shown = window.session.settings.shown
    if shown is None or shown.span is None:
        return
    if "" in ends.values():
        window.session.messages.say("Choose a time first: drag the slider, or press >.")
        return
    try:
        shown.limit(**ends)
    except OrographError as error:
        window.session.messages.say(str(error))
    window.touch()


def advance(window: Window, seconds: float) -> bool:
    """Advance the data's time, and the turns of members; returns whether anything goes on by itself."""
    shown = window.session.settings.shown
    if shown is None or not shown.changing:
        return False
    shown.waited += seconds
    if window.session.settings.finer.coming:  # (the thread asks for the next frame; members are seen from then on)
        return False
    passed, shown.waited = min(shown.waited, LONGEST), 0.0
    turned = shown.turns is not None and shown.turns.advance(seconds)
    if shown.playing:
        change_data(window, time=shown.play(passed / PLAYED))
    elif turned:
        change_data(window)
    return True


def _key(key: Legend) -> None:
    """Scales and classes of data."""
    pen = imgui.get_window_draw_list()
    for scale in key.scales:
        imgui.text_wrapped(scale.words)
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
        imgui.text_wrapped(f"across: {both.across}")
        imgui.text_wrapped(f"up: {both.up}")
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
