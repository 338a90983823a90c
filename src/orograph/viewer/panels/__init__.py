"""The panels: first docked to the right; they can be moved, stacked or floated; the layout is saved between
sessions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imgui_bundle import imgui

from orograph.viewer.panels import camera, data, detail, layers, light, plot, statistics, tour

if TYPE_CHECKING:
    from orograph.viewer.window import Area, Window

WIDTH = 300.0
PANELS = (
    ("Camera", camera.draw, "top"),
    ("Light", light.draw, "middle"),
    ("Layers", layers.draw, "middle"),
    ("Data", data.draw, "middle"),
    ("Plot", plot.draw, "middle"),
    ("Detail", detail.draw, "bottom"),
    ("Tour", tour.draw, "bottom"),
    ("Statistics", statistics.draw, "bottom"),
)
RAISED = ("Detail", "Light")
"""Panels that are on top in the initial layout."""
DOCK = 0x0609_2A11
"""The dock space's number in the layout file."""


def dock(window: Window) -> Area:
    """Lay out the dock space; returns the area left for the terrain."""
    viewport = imgui.get_main_viewport()
    whole = (viewport.pos.x, viewport.pos.y, viewport.size.x, viewport.size.y)
    if not window.session.settings.panels:
        # Without the second flag the space paints a background, which darkens the picture.
        flags = imgui.DockNodeFlags_.keep_alive_only | imgui.DockNodeFlags_.passthru_central_node
        imgui.dock_space_over_viewport(DOCK, viewport, flags)
        return whole
    if window.gui.fresh:
        window.gui.fresh = False
        _layout(viewport)
        shown = window.session.settings.shown is not None
        window.gui.raised = ["Data" if shown and name == "Light" else name for name in RAISED]
    flags = imgui.DockNodeFlags_.passthru_central_node | imgui.DockNodeFlags_.no_docking_over_central_node
    imgui.dock_space_over_viewport(DOCK, viewport, flags)
    node = imgui.internal.dock_builder_get_central_node(DOCK)
    if node is None or node.size.x < 16 or node.size.y < 16:
        return whole
    return node.pos.x, node.pos.y, node.size.x, node.size.y


def _layout(viewport: imgui.Viewport) -> None:
    """The initial layout."""
    build = imgui.internal
    build.dock_builder_remove_node(DOCK)
    build.dock_builder_add_node(DOCK, imgui.internal.DockNodeFlagsPrivate_.dock_space)
    build.dock_builder_set_node_size(DOCK, viewport.size)
    share = min(0.4, WIDTH / max(viewport.size.x, 1.0))
    _, right, _ = build.dock_builder_split_node_py(DOCK, imgui.Dir.right, share)
    _, top, rest = build.dock_builder_split_node_py(right, imgui.Dir.up, 0.315)
    _, middle, bottom = build.dock_builder_split_node_py(rest, imgui.Dir.up, 0.585)
    places = {"top": top, "middle": middle, "bottom": bottom}
    for name, _, place in PANELS:
        build.dock_builder_dock_window(name, places[place])
    build.dock_builder_finish(DOCK)


def draw(window: Window) -> None:
    """All panels."""
    if window.gui.raised and imgui.internal.find_window_by_name(window.gui.raised[0]) is not None:
        imgui.set_window_focus(window.gui.raised.pop(0))
    for name, content, _ in PANELS:
        imgui.set_next_window_size((WIDTH, 260), imgui.Cond_.first_use_ever)
        beside = imgui.internal.find_window_by_name(PANELS[-2 if name == "Statistics" else -1][0])
        if beside is not None and beside.dock_id:  # a panel unknown to the saved layout goes beside another
            imgui.set_next_window_dock_id(beside.dock_id, imgui.Cond_.first_use_ever)
        shown, _ = imgui.begin(name)
        if shown:
            imgui.push_item_width(-110.0)
            content(window)
            imgui.pop_item_width()
        imgui.end()
