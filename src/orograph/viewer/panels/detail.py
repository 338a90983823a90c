"""How the mesh is made: by which method, and how fine, in pixels of tolerance or in triangles; its edges, its levels, a
mesh that stands still while one flies around it; and where the normals come from that light falls on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imgui_bundle import imgui

from orograph.rendering.gpu.frame import Normals
from orograph.viewer.panels.tips import tip

if TYPE_CHECKING:
    from orograph.viewer.window import Window

METHODS: tuple[tuple[str | None, str], ...] = (
    (None, "batched: patches of triangles on the GPU, tiles streamed (the window's own)"),
    ("soar", "soar: a nested error, refined anew for every view, one strip (Lindstrom & Pascucci)"),
    ("roam", "roam: carried on from frame to frame by splits and merges (Duchaineau)"),
    ("top-down", "top-down: the smallest conforming mesh within the tolerance"),
    ("stateless", "stateless: no memory of earlier frames, nothing stored (soar's mesh)"),
    ("blow", "blow: nested spheres and a front that moves (Blow)"),
)
"""Engines and what they are."""

NORMALS: tuple[tuple[Normals, str, str], ...] = (
    ("computed", "from heights", "for every pixel from the heights: finer than the mesh, and filtered"),
    ("stored", "at vertices", "stored at the mesh's vertices and blended between them: what lies between is not seen"),
    ("derivatives", "by derivatives", "of the position on the screen, as in a shader without normals: facets show"),
    ("faces", "of faces", "of the triangles as they are drawn"),
)
"""Where normals come from: value, name, and what that is."""


def draw(window: Window) -> None:
    """The content of the panel."""
    session, settings = window.session, window.session.settings
    names = [name or "batched" for name, _ in METHODS]
    at = next(k for k, (name, _) in enumerate(METHODS) if name == settings.engine)
    moved, at = imgui.combo("engine", at, names)
    tip(METHODS[at][1])
    if moved:
        settings.engine = METHODS[at][0]
    flags = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
    by_budget = settings.budget is not None
    if imgui.radio_button("tolerance", not by_budget):
        settings.budget = None
    tip("No sample of the ground in view is farther from the mesh on the screen than that.")
    imgui.same_line()
    if imgui.radio_button("triangles", by_budget):
        settings.budget = settings.budget or 500_000
    tip("The tolerance is changed until there are about so many triangles.")
    if settings.budget is None:
        _, settings.tolerance = imgui.slider_float("pixels", settings.tolerance, 0.1, 50.0, "%.2f px", flags)
    else:
        _, settings.budget = imgui.slider_int("##budget", settings.budget, 10_000, 20_000_000, "%d", flags)
        imgui.text_disabled(f"gives {settings.tolerance:.2f} px")
    _, settings.wireframe = imgui.checkbox("wireframe", settings.wireframe)
    tip("Key: X")
    imgui.same_line()
    imgui.begin_disabled(settings.engine is not None)
    _, settings.levels = imgui.checkbox("colours of levels", settings.levels)
    imgui.end_disabled()
    tip("A colour for every size of patches; other engines have none.")
    moved, frozen = imgui.checkbox("freeze the mesh, fly around it", settings.frozen is not None)
    tip("Key: F")
    if moved:
        session.freeze(frozen)
    at = next(k for k, (value, _, _) in enumerate(NORMALS) if value == settings.normals)
    moved, at = imgui.combo("normals", at, [name for _, name, _ in NORMALS])
    tip(NORMALS[at][2])
    if moved:
        settings.normals = NORMALS[at][0]
