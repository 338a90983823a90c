"""Tool tips: a sentence on what the pointer rests on."""

from __future__ import annotations

from imgui_bundle import imgui


def tip(text: str) -> None:
    """A tool tip on the last item, also where it is disabled."""
    if imgui.is_item_hovered(imgui.HoveredFlags_.allow_when_disabled | imgui.HoveredFlags_.delay_short):
        imgui.set_tooltip(text)
