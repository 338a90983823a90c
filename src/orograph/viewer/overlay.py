"""What is drawn over the terrain: north arrow, scale bar, colour bar, read-out, messages, the help.

Everything lies on dark translucent panels, legible on snow and shade alike. Lengths are logical pixels; the scale bar
applies to the middle of the picture, in metres on the ground (not of a distorted grid).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from imgui_bundle import imgui

from orograph.geovis.color import linear_to_srgb, tint_of
from orograph.measuring.text import about
from orograph.rendering.furniture.legend import north_on_screen, stretch
from orograph.rendering.furniture.pieces import bar_length, number, ticks
from orograph.viewer.keys import HELD, MOUSE, help_rows
from orograph.viewer.navigation import heading_pitch
from orograph.viewer.session import Message

if TYPE_CHECKING:
    from orograph.viewer.window import Window

MARGIN = 14.0
PAD = 8.0
BESIDE = 190.0
"""Space that scale bar and colour bar take beside the read-out."""
BAR, BANDS = 208.0, 64
"""Height of a colour bar with its title, and its bands of colour."""
FOOT, NARROW, HIGH_FOOT = 34.0, 850.0, 120.0
"""Space of the read-out at the bottom of the terrain's area; the width below which its lines are above the scale bar;
and the space they take there."""


def color(r: float, g: float, b: float, a: float = 1.0) -> int:
    """A colour as an ImGui number."""
    return int(imgui.get_color_u32((r, g, b, a)))


def slip(draw: Any, x: float, y: float, w: float, h: float) -> None:
    """The panel behind a piece at (x, y)."""
    draw.add_rect_filled((x, y), (x + w, y + h), color(0.06, 0.07, 0.08, 0.62), 5.0)


def furniture(window: Window) -> None:
    """North arrow, scale bar, colour bar and read-out, in the corners of the terrain's area."""
    draw = imgui.get_background_draw_list()
    x, y, w, h = window.area
    if w < 240 or h < 160:
        return
    _north(window, draw, x + w - MARGIN - 46, y + MARGIN)
    _scale(window, draw, x + MARGIN, y + h - MARGIN - 40)
    if h > 360:
        _colors(window, draw, x + w - MARGIN, y + h - MARGIN, y + 2 * MARGIN + 62)
    _readout(window, draw, x + w / 2, y + h - MARGIN - 24)


def _north(window: Window, draw: Any, x: float, y: float) -> None:
    """A needle that points to grid north, foreshortened like the ground."""
    session = window.session
    scene = session.scene()
    angle = north_on_screen(scene)
    size = 46.0
    slip(draw, x, y, size, size + 16)
    cx, cy = x + size / 2, y + size / 2
    if angle is not None:
        a = math.radians(angle)
        _, pitch = heading_pitch(session.view, session.settings.exaggeration)
        length = 18.0 * max(0.45, abs(math.sin(math.radians(pitch))))
        up, side = (math.sin(a), -math.cos(a)), (math.cos(a), math.sin(a))
        tip = cx + up[0] * length, cy + up[1] * length
        tail = cx - up[0] * length, cy - up[1] * length
        left, right = ((cx - s * side[0] * 6, cy - s * side[1] * 6) for s in (1, -1))
        draw.add_triangle_filled(tip, left, right, color(0.86, 0.27, 0.22))
        draw.add_triangle_filled(tail, left, right, color(0.85, 0.87, 0.9))
    text = f"{heading_pitch(session.view, session.settings.exaggeration)[0]:.0f}°".replace("360", "0")
    wide = imgui.calc_text_size(text).x
    draw.add_text((cx - wide / 2, y + size - 2), color(0.95, 0.95, 0.95), text)


def _scale(window: Window, draw: Any, x: float, y: float) -> None:
    """A scale bar for the ground in the middle of the picture."""
    view = window.session.view
    point = window.middle()
    if point is None:
        return
    depth = float(view.project(point, window.session.settings.exaggeration)[1])
    metres = depth * view.pixel_slope * window.ratio / window.cached("stretch", lambda: stretch(window.session.scene()))
    if not (metres > 0 and math.isfinite(metres)):
        return
    length, parts, text = bar_length(160.0 * metres)
    wide = length / metres
    slip(draw, x, y, wide + 2 * PAD, 38)
    draw.add_text((x + PAD, y + 4), color(0.95, 0.95, 0.95), text)
    for k in range(parts):
        shade = color(0.95, 0.95, 0.95) if k % 2 == 0 else color(0.35, 0.37, 0.4)
        draw.add_rect_filled(
            (x + PAD + wide * k / parts, y + 25), (x + PAD + wide * (k + 1) / parts, y + 31), shade
        )  # fmt: skip


def _colors(window: Window, draw: Any, right: float, bottom: float, top: float) -> None:
    """The colours of heights, unless they are hidden, and above them those of data, down from the uppermost; as many as
    there is room for."""
    settings = window.session.settings
    bars = [(one.low, one.high, _shades(one.colors), one.words)
            for key in reversed(window.session.scene().keys) for one in reversed(key.scales)]  # fmt: skip
    if not window.cover.hides():
        name, span = settings.colormap, settings.range
        bars.insert(0, (*window.cached(("tint", name, span), lambda: _table(window, name, span)), "m"))
    room = max(1, int((bottom - top) / (BAR + MARGIN)))
    for k, bar in enumerate(bars[-room:]):
        _bar(draw, right, bottom - k * (BAR + MARGIN), *bar)


def _bar(draw: Any, right: float, bottom: float, low: float, high: float, table: list[int], title: str) -> None:
    """Colours from a value to another, highest on top."""
    tall, wide = BAR - 2 * PAD - 30, 14.0
    marks = ticks(low, high, 6)
    texts = [number(v, marks) for v in marks]
    space = max((imgui.calc_text_size(t).x for t in texts), default=0.0)
    w, named = wide + space + 3 * PAD, imgui.calc_text_size(title).x + 2 * PAD
    x, y = right - w, bottom - BAR
    if named > w:  # a slip of its own, so that less ground is hidden
        slip(draw, right - named, y, named, 21)
        slip(draw, x, y + 23, w, BAR - 23)
    else:
        slip(draw, x, y, w, BAR)
    draw.add_text((min(x, right - named) + PAD, y + 3), color(0.95, 0.95, 0.95), title)
    top = y + PAD + 26
    n = len(table)
    for k in range(n):
        a, b = top + tall * k / n, top + tall * (k + 1) / n
        draw.add_rect_filled((x + PAD, a), (x + PAD + wide, b + 0.5), table[n - 1 - k])
    for v, text in zip(marks, texts):
        at = top + tall * (high - v) / (high - low)
        draw.add_line((x + PAD + wide, at), (x + PAD + wide + 4, at), color(0.95, 0.95, 0.95))
        draw.add_text((x + 2 * PAD + wide, at - 8), color(0.95, 0.95, 0.95), text)


def _table(
    window: Window, name: str | None, span: tuple[float, float] | None
) -> tuple[float, float, list[int]]:  # fmt: skip
    low, high, linear = tint_of(window.session.terrain, name, span=span).scale(BANDS)
    return low, high, _shades(linear_to_srgb(linear))


def _shades(colors: Any) -> list[int]:
    """ImGui's numbers of at most ``BANDS`` of the colours (n, 3), sRGB, bytes or 0 to 1."""
    table = np.asarray(colors)
    table = table[np.linspace(0, len(table) - 1, min(BANDS, len(table))).round().astype(int)]
    return [color(*(float(v) for v in one)) for one in table / (255.0 if table.dtype.kind in "iu" else 1.0)]


def _readout(window: Window, draw: Any, middle: float, y: float) -> None:
    """The ground position and height under the cursor."""
    hit = window.session.probe.hit
    if hit is None or window.pointer is None:
        return
    parts = [f"E {hit.easting:,.1f}   N {hit.northing:,.1f}".replace(",", " ")]
    if hit.longitude is not None and hit.latitude is not None:
        parts.append(lonlat(hit.longitude, hit.latitude))
    if hit.height is not None:
        parts.append(f"{hit.height:.1f} m" + (f" ({about(hit.height_error)})" if hit.height_error is not None else ""))
    if hit.slope is not None:
        parts.append(f"slope {hit.slope:.0f}°")
    parts += [one.words for one in window.found()]
    lines = ["    ".join(parts)]
    left, _, area, _ = window.area
    if imgui.calc_text_size(lines[0]).x > area - 2 * BESIDE:  # a single line would cover scale and colours
        lines = parts
        y -= 46 + 20 * (len(lines) - 1)
        middle = left + MARGIN + PAD + max(imgui.calc_text_size(t).x for t in lines) / 2
    wide = max(imgui.calc_text_size(t).x for t in lines)
    slip(draw, middle - wide / 2 - PAD, y, wide + 2 * PAD, 4 + 20 * len(lines))
    for k, text in enumerate(lines):
        draw.add_text((middle - wide / 2, y + 4 + 20 * k), color(0.95, 0.95, 0.95), text)


def lonlat(lon: float, lat: float) -> str:
    """Degrees with their hemispheres."""
    return f"{abs(lat):.5f}° {'N' if lat >= 0 else 'S'}  {abs(lon):.5f}° {'E' if lon >= 0 else 'W'}"


def pivot(window: Window) -> None:
    """A mark at the centre of the orbit."""
    point = window.session.nav.pivot
    if point is None:
        return
    (px, py), depth = window.session.view.project(np.array(point), window.session.settings.exaggeration)
    if depth > 0:
        at = window.to_canvas(float(px), float(py))
        draw = imgui.get_background_draw_list()
        draw.add_circle(at, 6.0, color(0, 0, 0, 0.6), 24, 3.5)
        draw.add_circle(at, 6.0, color(1, 1, 1), 24, 1.5)


def messages(window: Window) -> None:
    """Messages above the bottom of the terrain's area, in front of all panels; errors have a button."""
    x, y, w, h = window.area
    bottom = y + h - MARGIN - FOOT
    if window.session.settings.furniture and w < NARROW:  # there the read-out is above the scale bar
        bottom -= HIGH_FOOT
    for k, message in reversed(list(enumerate(window.session.messages.shown))):
        imgui.set_next_window_pos((x + w / 2, max(bottom, y + 60.0)), imgui.Cond_.always, (0.5, 1.0))
        imgui.set_next_window_size_constraints((120, 0), (max(200.0, 0.7 * w), 10_000))
        flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.always_auto_resize
        flags |= imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_focus_on_appearing
        flags |= imgui.WindowFlags_.no_saved_settings | imgui.WindowFlags_.no_nav
        imgui.push_style_color(
            imgui.Col_.window_bg, (0.42, 0.12, 0.10, 0.95) if message.error else (0.10, 0.12, 0.14, 0.9)
        )
        imgui.begin(f"##message{k}", None, flags)
        imgui.internal.bring_window_to_display_front(imgui.internal.get_current_window())
        _message(window, message, max(180.0, 0.6 * w))
        bottom -= imgui.get_window_size().y + 6
        imgui.end()
        imgui.pop_style_color()


def _message(window: Window, message: Message, wide: float) -> None:
    imgui.push_text_wrap_pos(wide)
    imgui.text_wrapped(message.text) if imgui.calc_text_size(message.text).x > wide else imgui.text(message.text)
    imgui.pop_text_wrap_pos()
    if message.error and imgui.button("OK"):
        window.session.messages.dismiss(message)


def help(window: Window) -> None:
    """All keys, in the middle of the window; scrollable in a small window."""
    wide, tall = imgui.get_io().display_size
    imgui.set_next_window_pos((wide / 2, tall / 2), imgui.Cond_.always, (0.5, 0.5))
    imgui.set_next_window_size_constraints((0, 0), (max(wide - 2 * PAD, 60.0), max(tall - 2 * PAD, 60.0)))
    imgui.set_next_window_bg_alpha(0.97)
    flags = imgui.WindowFlags_.no_title_bar | imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_move
    flags |= imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_docking
    flags |= imgui.WindowFlags_.no_saved_settings | imgui.WindowFlags_.horizontal_scrollbar
    imgui.begin("##help", None, flags)
    for title, rows in (("Mouse", MOUSE), ("Flying", HELD), ("Keys", help_rows())):
        imgui.separator_text(title)
        if imgui.begin_table(title, 2 if title != "Keys" else 4, imgui.TableFlags_.sizing_fixed_fit):
            for key, what in rows:
                imgui.table_next_column()
                imgui.text_colored((0.62, 0.80, 0.96, 1), key)
                imgui.table_next_column()
                imgui.text(what + "   ")
            imgui.end_table()
    imgui.end()
