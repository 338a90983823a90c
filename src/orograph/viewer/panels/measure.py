"""The panel of the measuring tool: what is measured, its numbers, a profile, and a field for typed places."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from imgui_bundle import imgui, implot

from orograph.viewer.panels.tips import CLAMPED, beside, tip
from orograph.viewer.results import KINDS, Kind, rows
from orograph.viewer.wording import spoken

if TYPE_CHECKING:
    from orograph.viewer.tools import Tools

HINTS: dict[Kind, str] = {
    "pick": "Click a place, and another one to compare their data.",
    "profile": "Click points along a line; Backspace removes the last.",
    "area": "Click the corners of an area.",
    "los": "Click the eye, then the target.",
    "viewshed": "Click the place of the eye.",
}
LONG = {"los": "line of sight"}
"""Labels of measurements whose names are short."""
VALUES = 130.0
"""Where values begin in the panel, logical pixels."""
FIELD = 90.0
"""Width of a number field, logical pixels."""


def draw(tools: Tools) -> None:
    """Draw the panel."""
    x, y, w, _ = tools.window.area
    inset = tools.window.plan.inset_width
    _follow(tools, (math.floor(x + inset + 28), math.floor(y + 14)))
    imgui.set_next_window_size((min(460.0, max(w - inset - 100.0, 260.0)), 0), imgui.Cond_.always)
    shown, opened = imgui.begin("Measure", True, imgui.WindowFlags_.no_focus_on_appearing)
    if shown:
        _panel(tools)
    imgui.end()
    if not opened:
        tools.leave()


def _follow(tools: Tools, place: tuple[int, int]) -> None:
    """Keep the panel at the corner of the terrain's area, even if that changes, until it is moved by hand; then it
    stays there, within the window."""
    panel: Any = imgui.internal.find_window_by_name("Measure")
    if panel is None or tools.put is None:
        imgui.set_next_window_pos(place, imgui.Cond_.first_use_ever)
        tools.put = place
        return
    if panel.dock_id:
        return
    x, y, w, h = panel.pos.x, panel.pos.y, panel.size.x, panel.size.y
    if (x, y) == tools.put:
        imgui.set_next_window_pos(place)
        tools.put = place
        return
    wide, tall = imgui.get_io().display_size
    inside = max(min(x, wide - w), 0.0), max(min(y, tall - h), 0.0)
    if inside != (x, y) and not imgui.is_mouse_down(0):
        imgui.set_next_window_pos(inside)


def _panel(tools: Tools) -> None:
    for k, kind in enumerate(KINDS):
        label = LONG.get(kind, kind)
        if k:
            beside(imgui.get_frame_height() + imgui.calc_text_size(label).x)
        if imgui.radio_button(f"{label}##{kind}", tools.kind == kind) and tools.kind != kind:
            tools.choose(kind)
    if tools.kind in ("los", "viewshed"):
        _heights(tools)
    _typed(tools)
    if tools.trouble:
        imgui.text_wrapped(spoken(tools.trouble))
    elif tools.result is None:
        waiting = "Measuring …" if tools.part is None else f"Measuring … {tools.part:.0%}"
        imgui.text_disabled(waiting if tools.busy else HINTS[tools.kind])
    else:
        if tools.kind == "viewshed":
            tools.paint()
        for name, value in [*rows(tools.kind, tools.result), *tools.data_rows()]:
            imgui.text_disabled(name)
            imgui.same_line(max(VALUES, imgui.calc_text_size(name).x + 2 * imgui.get_style().item_spacing.x))
            imgui.text(value)
        if tools.kind in ("profile", "los"):
            _plot(tools)
    if imgui.small_button("Clear"):
        tools.clear()
    imgui.same_line()
    imgui.begin_disabled(tools.result is None)
    if imgui.small_button("Save"):
        tools.save()
    imgui.end_disabled()


def _typed(tools: Tools) -> None:
    """A field for places: what is typed is measured as if it had been clicked."""
    imgui.set_next_item_width(-1)
    entered, text = imgui.input_text_with_hint(
        "##place", "or type a place: 53.35 N 6.26 W", tools.window.texts.get("place", ""),
        imgui.InputTextFlags_.enter_returns_true,
    )  # fmt: skip
    tip("Degrees with N, S, E, W, or easting and northing; Enter adds the place.")
    tools.window.texts["place"] = text
    if entered and text.strip():
        tools.window.texts["place"] = ""
        tools.add(text)
        imgui.set_keyboard_focus_here(-1)  # for another place


def _heights(tools: Tools) -> None:
    """Heights of eye and target above the ground, and the radius of a viewshed: a change measures again."""
    imgui.push_item_width(FIELD)
    changed = False
    for name in ("eye", "target"):
        if name == "target":
            beside(FIELD + imgui.calc_text_size(name).x)
        moved, value = imgui.drag_float(name, getattr(tools, name), 0.1, 0.0, 10_000.0, "%.1f m", CLAMPED)
        if moved:
            setattr(tools, name, value)
        changed |= imgui.is_item_deactivated_after_edit()
    if tools.kind == "viewshed":
        beside(FIELD + imgui.calc_text_size("radius").x)
        flags = CLAMPED | imgui.SliderFlags_.logarithmic
        moved, value = imgui.drag_float("radius", tools.radius, 100.0, 100.0, 500_000.0, "%.0f m", flags)
        if moved:
            tools.radius = value
        changed |= imgui.is_item_deactivated_after_edit()
    imgui.pop_item_width()
    if changed and tools.points:
        tools.measure()


def _plot(tools: Tools) -> None:
    """Heights along the line; the cursor on the plot marks its place on the ground."""
    profile = tools.result.profile if tools.kind == "los" else tools.result
    x, z = profile.distance / 1000.0, profile.surface_heights
    if not np.isfinite(z).any():
        return
    low, high = float(np.nanmin(z)), float(np.nanmax(z))
    sight = tools.result.line if tools.kind == "los" else None
    if sight is not None:
        high = max(high, float(np.nanmax(sight)))
    room = 0.08 * max(high - low, 1.0)
    tools.marked = None
    flags = implot.Flags_.no_legend | implot.Flags_.no_menus | implot.Flags_.no_mouse_text
    if implot.begin_plot("##profile", (-1, 170), flags):
        implot.setup_axes("km", "m")
        implot.setup_axes_limits(0.0, max(float(x[-1]), 1e-6), low - room, high + room, implot.Cond_.always)
        implot.plot_shaded("ground", x, np.ascontiguousarray(z), low - room)
        implot.plot_line("ground", x, np.ascontiguousarray(z))
        if sight is not None:
            implot.plot_line("sight", x, np.ascontiguousarray(sight))
        if implot.is_plot_hovered():
            at = min(max(implot.get_plot_mouse_pos().x * 1000.0, 0.0), float(profile.distance[-1]))
            points, heights, _ = profile.at(at)
            tools.marked = float(points[0, 0]), float(points[0, 1]), float(heights[0])
            implot.plot_inf_lines("here", np.array([at / 1000.0]))
            imgui.set_tooltip(f"{at / 1000.0:.3f} km   {heights[0]:.1f} m")
        implot.end_plot()
