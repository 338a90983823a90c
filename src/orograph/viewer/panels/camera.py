"""The camera's position, in the terrain's CRS and in longitude and latitude; preset and kept views."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from imgui_bundle import imgui

from orograph.measuring import Places
from orograph.viewer import commands
from orograph.viewer.navigation import heading_pitch
from orograph.viewer.overlay import lonlat
from orograph.viewer.panels.tips import tip

if TYPE_CHECKING:
    from orograph.viewer.window import Window


def draw(window: Window) -> None:
    """Draw the panel."""
    session, nav, view = window.session, window.session.nav, window.session.view
    x, y, z = view.eye
    imgui.text(f"E {x:,.1f}   N {y:,.1f}".replace(",", " "))
    places: Places = window.cached("places", lambda: Places(session.terrain))
    found = window.cached(("lonlat", round(x, 1), round(y, 1)), lambda: places.lonlat(_row(x, y)))
    if found is not None:
        imgui.text(lonlat(float(found[0, 0]), float(found[0, 1])))
    ground = session.probe.ground(x, y)
    above = f"   {z - ground:,.0f} m above ground".replace(",", " ") if ground == ground else ""
    imgui.text(f"{z:,.1f} m{above}".replace(",", " "))
    heading, pitch = heading_pitch(view, session.settings.exaggeration)
    imgui.text(f"heading {round(heading, 1) % 360:.1f}°   pitch {pitch:.1f}°".replace("-", "−"))
    moved, fov = imgui.slider_float("field of view", view.fov_y, 5.0, 100.0, "%.0f°", imgui.SliderFlags_.always_clamp)
    if moved:
        nav.view = replace(view, fov_y=fov)
    for k, (name, do) in enumerate(
        (("Home", nav.go_home), ("North up", nav.north_up), ("Down", nav.straight_down), ("Oblique", nav.oblique))
    ):
        if k:
            imgui.same_line()
        if imgui.small_button(name):
            do()
    if imgui.small_button("Copy JSON"):
        commands.copy_view(window)
    imgui.same_line()
    if imgui.small_button("Paste"):
        commands.paste_view(window)
    imgui.same_line()
    if imgui.small_button("Save picture"):
        window.pictures.ask()
    imgui.same_line()
    if imgui.small_button("Measure"):
        window.tools.toggle()
        window.touch()
    tip("Heights, data, lengths, areas and what is seen, by clicks on the ground (key M).")
    imgui.text_disabled("kept views (Ctrl + digit to keep)")
    for slot in "123456789":
        if slot != "1":
            imgui.same_line(0.0, 3.0)
        imgui.begin_disabled(slot not in session.bookmarks)
        if imgui.small_button(f" {slot} "):
            session.recall_view(slot)
        imgui.end_disabled()
    imgui.text_disabled(window.session.terrain.grid.crs_name)


def _row(x: float, y: float):  # type: ignore[no-untyped-def]
    import numpy as np

    return np.array([[x, y]])
