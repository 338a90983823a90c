"""How fine the mesh is: pixels of tolerance, or triangles to keep near; edges, levels, and a mesh that stands still."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imgui_bundle import imgui

if TYPE_CHECKING:
    from orograph.viewer.window import Window


def draw(window: Window) -> None:
    """The content of the panel."""
    settings = window.session.settings
    flags = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
    by_budget = settings.budget is not None
    if imgui.radio_button("tolerance", not by_budget):
        settings.budget = None
    imgui.same_line()
    if imgui.radio_button("triangles", by_budget):
        settings.budget = settings.budget or 500_000
    if settings.budget is None:
        _, settings.tolerance = imgui.slider_float("pixels", settings.tolerance, 0.1, 50.0, "%.2f px", flags)
    else:
        _, settings.budget = imgui.slider_int("##budget", settings.budget, 10_000, 20_000_000, "%d", flags)
        imgui.text_disabled(f"gives {settings.tolerance:.2f} px")
    _, settings.wireframe = imgui.checkbox("wireframe", settings.wireframe)
    imgui.same_line()
    _, settings.levels = imgui.checkbox("colours of levels", settings.levels)
    moved, frozen = imgui.checkbox("freeze the mesh, fly around it", settings.frozen is not None)
    if moved:
        window.session.freeze(frozen)
