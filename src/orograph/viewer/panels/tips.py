"""Small helpers for panels: tool tips, rows that wrap in a narrow panel, typed paths."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import imgui

from orograph.viewer.wording import spoken

CLAMPED = imgui.SliderFlags_.always_clamp
"""Values typed into a slider (Ctrl + click) are clamped to its range."""


def tip(text: str) -> None:
    """A tool tip on the last item, even if it is disabled."""
    if imgui.is_item_hovered(imgui.HoveredFlags_.allow_when_disabled | imgui.HoveredFlags_.delay_short):
        imgui.set_tooltip(spoken(text))


def beside(wide: float) -> None:
    """Put the next item, ``width`` logical pixels wide, beside the last one if it fits into the panel."""
    room = imgui.get_cursor_screen_pos().x + imgui.get_content_region_avail().x - imgui.get_item_rect_max().x
    if room > wide + 2 * imgui.get_style().item_spacing.x:
        imgui.same_line()


def path_of(text: str) -> Path:
    """A path as typed, with ``~`` expanded; an unknown user's stays as it is."""
    try:
        return Path(text).expanduser()
    except RuntimeError:
        return Path(text)
