"""A histogram or a scatter plot of the data; dragging over it selects on the ground too."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from imgui_bundle import imgui

from orograph.errors import OrographError
from orograph.viewer.brushing import opened
from orograph.viewer.panels.tips import tip

if TYPE_CHECKING:
    from orograph.viewer.brushing import Array, Mask, Range, Sampled
    from orograph.viewer.window import Window

BINS, CELLS = 48, (48, 36)
"""Bins of a histogram, and of a scatter plot along x and y."""

TALL, LEAST = 104.0, 3.0
"""Height of a plot, and the minimum drag, logical pixels."""

NONE = "(histogram)"


class Plotted(NamedTuple):
    """A plot's rectangle (x, y, width, height), variables, and ranges."""

    box: tuple[float, float, float, float]
    names: tuple[str, ...]
    ends: tuple[tuple[float, float], ...]


def draw(window: Window) -> None:
    """Draw the panel."""
    session, brush = window.session, window.brush
    terrain, shown = session.terrain, session.settings.shown
    names = brush.names(terrain, shown)
    first = _chosen(window, "plot x", names, names[min(1, len(names) - 1)])
    other = _chosen(window, "plot y", [NONE, *names], NONE)
    wanted = (first,) if other == NONE else (first, other)
    at = brush.table(wanted, terrain, shown)
    known = np.all([np.isfinite(at.values[name]) for name in wanted], 0)
    if not known.any():
        imgui.text_wrapped("No place has a value.")
        return
    held = brush.holds(at) & known
    plot = _frame(wanted, at, known)
    _pixels(plot, at, known, held, brush.empty)
    _dragged(window, plot)
    # (Above the ranges: their tips appear below the pointer.)
    imgui.text_wrapped("Drag over the plot, or type, to select." if brush.empty else brush.describe(terrain, shown))
    units = brush.units(terrain, shown)
    for name, ends in zip(wanted, plot.ends):
        _typed(window, name, units.get(name, ""), ends)
    for name, range_ in brush.ranges.items():
        if name not in wanted:
            imgui.text_unformatted(f"{name} {told(range_, units.get(name, ''))}")
    if imgui.button("Select measured area"):
        select(window, area=[point[:2] for point in window.tools.points])
    tip("The corners clicked while measuring an area (M).")
    imgui.begin_disabled(brush.empty)
    if imgui.button("All again"):
        select(window, ranges={}, area=())
    imgui.same_line()
    if imgui.button("Best view"):
        window.finder.find()
    tip("Fly to the camera that shows most of what is selected; dots on the plan mark what it does not show.")
    imgui.end_disabled()
    if window.finder.at_best:
        hidden, of = len(window.finder.hidden), max(window.finder.looked_for, 1)
        imgui.text_wrapped(
            f"{100 * hidden / of:.0f} % of the selection is hidden" + (" (dots on the plan)" * (hidden > 0))
        )


def select(window: Window, **changes: Any) -> None:
    """Select by ranges or an area; errors appear in the window."""
    session = window.session
    try:
        window.brush.choose(**changes)
        window.brush.apply(session.terrain, session.settings.shown)
    except OrographError as error:
        session.messages.say(str(error))
    session.settings.veil = window.brush.veil
    window.touch()


def told(range_: Range, unit: str) -> str:
    """A range in words: "0.9 or more", "2 to 3 °C"."""
    low, high = range_
    if low == -math.inf and high == math.inf:
        return "any"
    words = f"{low:.4g} to {high:.4g}" if math.isfinite(high - low) else f"{low if math.isfinite(low) else high:.4g}"
    more = "" if math.isfinite(high - low) else " or more" if math.isfinite(low) else " or less"
    return f"{words} {unit}".rstrip() + more


def _typed(window: Window, name: str, unit: str, ends: tuple[float, float]) -> None:
    """The range of a variable, editable; where it is open, the ends of its values."""
    key = f"range {name}"
    low, high = window.brush.ranges.get(name, ends)
    given = [min(ends[0], high) if low == -math.inf else low, max(ends[1], low) if high == math.inf else high]
    imgui.text_disabled(f"{name}, from and to" + (f" ({unit})" if unit else ""))
    typed = window.texts.get(key)
    imgui.set_next_item_width(-1)
    _, values = imgui.input_float2(f"##{key}", [float(v) for v in typed.split()] if typed else given, "%.4g")
    tip(f"{name}, from and to; Enter selects.")
    if imgui.is_item_active():
        window.texts[key] = f"{values[0]!r} {values[1]!r}"
    if imgui.is_item_deactivated_after_edit():
        window.texts.pop(key, None)
        low, high = values[0], values[1]
        if low > high:  # what was typed counts, and the other end follows
            low, high = (low, low) if low != given[0] else (high, high)
        select(window, ranges={**window.brush.ranges, name: opened((low, high), ends)})
    elif not imgui.is_item_active():
        window.texts.pop(key, None)


def _chosen(window: Window, key: str, names: list[str], usual: str) -> str:
    now = window.texts.get(key, usual)
    at = names.index(now) if now in names else names.index(usual)
    imgui.set_next_item_width(-1)
    moved, at = imgui.combo(f"##{key}", at, names)
    if moved:
        window.texts[key] = names[at]
    return names[at]


def _frame(names: tuple[str, ...], at: Sampled, known: Mask) -> Plotted:
    corner, wide = imgui.get_cursor_screen_pos(), max(imgui.get_content_region_avail().x, 40.0)
    ends = []
    for name in names:
        values = at.values[name][known]
        low, high = float(values.min()), float(values.max())
        ends.append((low, high) if low < high else (low - 0.5, high + 0.5))
    return Plotted((corner.x, corner.y, wide, TALL), names, tuple(ends))


def _pixels(plot: Plotted, at: Sampled, known: Mask, held: Mask, all_of_it: bool) -> None:
    """The bars of a histogram, or the cells of a scatter plot; the selection in colour."""
    pen, (x, y, wide, tall) = imgui.get_window_draw_list(), plot.box
    pen.add_rect_filled((x, y), (x + wide, y + tall), _ink(0.11, 0.12, 0.14))
    values = [at.values[name] for name in plot.names]
    pale, bright = _ink(0.42, 0.44, 0.48), _ink(0.35, 0.71, 0.91)
    chosen = known if all_of_it else held
    if len(values) == 1:
        every, some = (_counts(values[0][mask], plot.ends[0]) for mask in (known, chosen))
        most = max(float(every.max()), 1.0)
        for k in range(BINS):
            left, right = x + wide * k / BINS, x + wide * (k + 1) / BINS - 1
            for count, ink in ((every[k], pale), (some[k], bright)):
                if count:
                    pen.add_rect_filled((left, y + tall * (1 - count / most)), (right, y + tall), ink)
        return
    every, some = (
        np.histogram2d(values[0][mask], values[1][mask], CELLS, plot.ends)[0] for mask in (known, chosen)
    )  # fmt: skip
    size, most = (wide / CELLS[0], tall / CELLS[1]), np.log1p(every.max())
    for i, j in np.argwhere(every > 0).tolist():
        strength = 0.35 + 0.65 * np.log1p(every[i, j]) / most
        red, green, blue = (0.35, 0.71, 0.91) if some[i, j] else (0.42, 0.44, 0.48)
        left, top = x + i * size[0], y + tall - (j + 1) * size[1]
        ink = _ink(red * strength, green * strength, blue * strength)
        pen.add_rect_filled((left, top), (left + size[0], top + size[1]), ink)


def _counts(values: Array, ends: tuple[float, float]) -> Array:
    return np.asarray(np.histogram(values, BINS, ends)[0], np.float64)


def _dragged(window: Window, plot: Plotted) -> None:
    """Select the dragged range; a click alone clears the selection of the plot's variables."""
    x, y, wide, tall = plot.box
    imgui.invisible_button("##plot", (wide, tall))
    window.plotted = plot
    mouse = imgui.get_mouse_pos()
    place = min(max((mouse.x - x) / wide, 0.0), 1.0), min(max(1 - (mouse.y - y) / tall, 0.0), 1.0)
    if imgui.is_item_activated():
        window.dragged = place
    if window.dragged is None:
        return
    start = window.dragged
    flat = len(plot.names) == 1
    low, high = ([min(a, b) for a, b in zip(start, place)], [max(a, b) for a, b in zip(start, place)])
    if imgui.is_item_active():
        top, bottom = (y, y + tall) if flat else (y + tall * (1 - high[1]), y + tall * (1 - low[1]))
        pen = imgui.get_window_draw_list()
        pen.add_rect((x + wide * low[0], top), (x + wide * high[0], bottom), _ink(1.0, 1.0, 1.0))
        return
    window.dragged = None
    ranges = dict(window.brush.ranges)
    far = max((high[0] - low[0]) * wide, 0.0 if flat else (high[1] - low[1]) * tall)
    for k, (name, (first, last)) in enumerate(zip(plot.names, plot.ends)):
        ranges.pop(name, None)
        if far >= LEAST:
            dragged = first + low[k] * (last - first), first + high[k] * (last - first)
            ranges[name] = opened(dragged, (first, last))
    select(window, ranges=ranges)


def _ink(red: float, green: float, blue: float) -> int:
    return int(imgui.get_color_u32((float(red), float(green), float(blue), 1.0)))
