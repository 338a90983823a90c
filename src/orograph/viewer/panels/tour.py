"""The tour: cameras kept as stops, played like a film, saved as TOUR.json for ``orograph movie``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from imgui_bundle import imgui

from orograph.lighting.sun import Placed
from orograph.viewer.panels.tips import CLAMPED, path_of, tip
from orograph.viewer.touring import SHORTEST
from orograph.viewer.wording import spoken

if TYPE_CHECKING:
    from orograph.touring.keys import Key
    from orograph.viewer.touring import Touring
    from orograph.viewer.window import Window

PATHS = ("spline", "orbit", "zoom")
FILE = "tour.json"


def draw(window: Window) -> None:
    """Draw the panel."""
    touring = window.touring
    if imgui.button("Add this camera"):
        touring.add()
    tip("Adds the current camera, light and exaggeration as a stop after the chosen one. Key: K")
    imgui.same_line()
    imgui.begin_disabled(not touring.stops)
    if imgui.button("Pause" if touring.playing else "Play"):
        touring.play()
    imgui.same_line()
    if imgui.button("Start again"):
        touring.clear()
    imgui.end_disabled()
    if not touring.stops:
        imgui.text_wrapped("Fly to a place, add its camera; fly on, add the next: the tour goes through all of them.")
    else:
        _scrub(touring)
        _stops(touring)
        if touring.chosen is not None and touring.chosen < len(touring.stops):
            _chosen(touring, touring.chosen)
        _whole(touring)
    _file(window)


def _scrub(touring: Touring) -> None:
    """The time line."""
    if touring.trouble:
        imgui.text_wrapped(spoken(touring.trouble))
    duration = touring.duration
    imgui.set_next_item_width(-1)
    moved, time = imgui.slider_float(
        "##time", min(touring.time, duration), 0.0, max(duration, 1e-3), f"%.1f of {duration:.1f} s", CLAMPED
    )
    if moved:
        touring.playing = False
        touring.show(time)


def _stops(touring: Touring) -> None:
    """A row for every stop: its time, its view, and its actions."""
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_fixed_fit | imgui.TableFlags_.scroll_y
    tall = min(len(touring.stops), 6) * (imgui.get_frame_height() + 4.0) + 4.0
    change: Any = None
    if imgui.begin_table("stops", 3, flags, (0, tall)):
        imgui.table_setup_column("time", imgui.TableColumnFlags_.width_fixed, 64)
        imgui.table_setup_column("what", imgui.TableColumnFlags_.width_stretch)
        imgui.table_setup_column("do", imgui.TableColumnFlags_.width_fixed, 74)
        for k, (stop, time) in enumerate(zip(list(touring.stops), touring.times)):
            imgui.push_id(k)
            imgui.table_next_column()
            imgui.set_next_item_width(-1)
            moved, value = imgui.drag_float("##at", time, 0.05, 0.0, 36_000.0, "%.1f s", CLAMPED)
            if moved:
                change = touring.retime, (k, value)
            tip("When the camera is here; later stops follow. Drag, or double-click to type.")
            imgui.table_next_column()
            if imgui.selectable(_label(k, stop.key), touring.chosen == k)[0]:
                touring.chosen, touring.playing = k, False
                touring.show(time)
            tip(_all(stop.key))
            imgui.table_next_column()
            for name, do, able in (
                ("up", (touring.move, (k, -1)), k > 0),
                ("down", (touring.move, (k, 1)), k < len(touring.stops) - 1),
            ):
                imgui.begin_disabled(not able)
                if imgui.arrow_button(name, getattr(imgui.Dir, name)):
                    change = do
                imgui.end_disabled()
                imgui.same_line(0.0, 2.0)
            if imgui.button("x"):
                change = touring.remove, (k,)
            tip("Remove this stop.")
            imgui.pop_id()
        imgui.end_table()
    if change is not None:
        change[0](*change[1])


def _label(k: int, key: Key) -> str:
    """A stop as short text: its direction and distance."""
    e, t = key.view.eye, key.view.target
    heading = math.degrees(math.atan2(t[0] - e[0], t[1] - e[1])) % 360.0
    far = key.view.distance
    distance = f"{far / 1000:.1f} km" if far >= 1000 else f"{far:.0f} m"
    return f"{k + 1}: {heading:.0f}°, {distance}"


def _all(key: Key) -> str:
    """The details of a stop, for its tool tip."""
    lines = ["Heading and distance of this stop. Click to go there."]
    if isinstance(key.sun, Placed):
        lines.append(f"Sun: azimuth {key.sun.azimuth:.0f}°, altitude {key.sun.altitude:.0f}°.")
    elif key.sun is not None:
        lines.append(f"Sun: {key.sun.when:%d %B %Y %H:%M}.")
    lines.append(f"Exaggeration: × {key.exaggeration or 1.0:.2f}.")
    return "\n".join(lines)


def _chosen(touring: Touring, k: int) -> None:
    """Settings of the chosen stop."""
    stop = touring.stops[k]
    key = stop.key
    last = k == len(touring.stops) - 1 and not touring.loop
    if not last:
        moved, leg = imgui.drag_float("to the next", stop.leg, 0.05, SHORTEST, 3600.0, "%.1f s", CLAMPED)
        if moved:
            stop.leg = max(leg, SHORTEST)
    moved, hold = imgui.drag_float("stay here", key.hold, 0.05, 0.0, 3600.0, "%.1f s", CLAMPED)
    if moved:
        touring.change(k, hold=max(hold, 0.0))
    if not last:
        moved, at = imgui.combo("way", PATHS.index(key.path), ["smooth curve", "around the target", "up and across"])
        if moved:
            touring.change(k, path=PATHS[at], turns=key.turns if PATHS[at] == "orbit" else 0)
        if key.path == "orbit":
            moved, turns = imgui.input_int("full turns", key.turns)
            if moved:
                touring.change(k, turns=turns)
    if imgui.small_button("Set to this camera"):
        touring.put(k)
    tip("The chosen stop takes the current camera, light and exaggeration.")


def _whole(touring: Touring) -> None:
    """Settings of the whole tour."""
    imgui.separator()
    _, touring.loop = imgui.checkbox("loop", touring.loop)
    tip("The last stop leads to the first again.")
    imgui.same_line()
    _, touring.ease = imgui.checkbox("ease", touring.ease)
    tip("The tour begins and ends at rest.")
    imgui.same_line()
    above = touring.above_ground is not None
    moved, above = imgui.checkbox("above ground", above)
    tip("Lifts the camera smoothly wherever its path comes nearer to the ground than this.")
    if moved:
        touring.above_ground = 50.0 if above else None
    if touring.above_ground is not None:
        moved, metres = imgui.drag_float("metres above", touring.above_ground, 1.0, 0.0, 10_000.0, "%.0f m", CLAMPED)
        if moved:
            touring.above_ground = max(metres, 0.0)


def _file(window: Window) -> None:
    """Where it is saved, and the command line that films it."""
    touring = window.touring
    imgui.separator()
    name = window.texts.get("tour", FILE)
    imgui.set_next_item_width(-110)
    _, window.texts["tour"] = imgui.input_text("##file", name)
    path = path_of(window.texts["tour"].strip() or FILE)
    tip(f"{path.resolve()}")
    imgui.same_line()
    if imgui.button("Save"):
        touring.save(path)
    imgui.same_line()
    if imgui.button("Load"):
        touring.load(path)
    if touring.tour is not None:
        line = touring.command(path, window.session.paths)
        if imgui.small_button("Copy the command that films it"):
            window.clipboard[1](line)
            window.session.messages.say("The command line is in the clipboard. Save the tour first.")
        tip(line)
