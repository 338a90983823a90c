"""How the mesh is made: the method; its fineness, in pixels of tolerance or in triangles; its edges and levels; a
frozen mesh to fly around; detail beyond the data; and the source of the normals for lighting."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from imgui_bundle import imgui

from orograph.errors import UsageError
from orograph.lod.options import Described, described
from orograph.lod.registry import AUTO, Choice, chosen, method_of, names
from orograph.rendering.gpu.frame import Normals
from orograph.scene.detail import Detail
from orograph.viewer.panels.tips import tip

if TYPE_CHECKING:
    from orograph.viewer.window import Window

NORMALS: tuple[tuple[Normals, str, str], ...] = (
    ("computed", "from heights", "for every pixel from the heights: finer than the mesh, and filtered"),
    ("stored", "at vertices", "stored at the mesh's vertices and interpolated between them: detail in between is lost"),
    ("sampled", "by heights around", "from heights half a pixel to every side, filtered like a texture"),
    (
        "derivatives",
        "by derivatives",
        "of the position on the screen, as in a shader without normals: facets are visible",
    ),
    ("faces", "of faces", "of the triangles as they are drawn"),
)
"""Sources of normals: value, label, and explanation."""


def draw(window: Window) -> None:
    """Draw the panel."""
    session, settings = window.session, window.session.settings
    _method(window)
    flags = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
    by_budget = settings.budget is not None
    if imgui.radio_button("tolerance", not by_budget):
        settings.budget = None
    tip("On the screen no visible sample is farther from the mesh than this.")
    imgui.same_line()
    if imgui.radio_button("triangles", by_budget):
        settings.budget = settings.budget or 500_000
    tip("Adjusts the tolerance to reach about this many triangles.")
    if settings.budget is None:
        _, settings.tolerance = imgui.slider_float("pixels", settings.tolerance, 0.1, 50.0, "%.2f px", flags)
    else:
        _, settings.budget = imgui.slider_int("##budget", settings.budget, 10_000, 20_000_000, "%d", flags)
        imgui.text_disabled(f"gives {settings.tolerance:.2f} px")
    _, settings.wireframe = imgui.checkbox("wireframe", settings.wireframe)
    tip("Key: X")
    imgui.same_line()
    imgui.begin_disabled(not settings.leveled)
    _, settings.levels = imgui.checkbox("colours of levels", settings.levels)
    imgui.end_disabled()
    tip("One colour for each patch size; only patches have levels.")
    moved, frozen = imgui.checkbox("freeze the mesh, fly around it", settings.frozen is not None)
    tip("Key: F")
    if moved:
        session.freeze(frozen)
    moved, invented = imgui.checkbox("detail beyond the data", settings.detail is not None)
    tip("Invented where samples are coarser than pixels, as rough as the data; measurements ignore it.")
    if moved:
        settings.detail = Detail() if invented else None
    at = next(k for k, (value, _, _) in enumerate(NORMALS) if value == settings.normals)
    moved, at = imgui.combo("normals", at, [name for _, name, _ in NORMALS])
    tip(NORMALS[at][2])
    if moved:
        settings.normals = NORMALS[at][0]


def drawable() -> tuple[str, ...]:
    """The methods that the window can draw, its own first."""
    found = names("triangles", "patches", "batches", "rings", "rays")
    return (AUTO["gpu"], *(name for name in found if name != AUTO["gpu"]))


def _method(window: Window) -> None:
    """The method, and its options."""
    settings = window.session.settings
    choice = chosen(settings.method, "gpu")
    every = drawable()
    moved, at = imgui.combo("method", every.index(choice.info.name), list(every))
    tip(f"{choice.info.title}. {choice.info.paper}.")
    if moved and every[at] != choice.info.name:
        kind = method_of(every[at])
        choice = Choice(kind, kind.info.options())
        settings.method = str(choice)
    options = described(choice.info.options)
    if not options or not imgui.tree_node("its options"):
        return
    for one in options:
        try:
            moved, value = _widget(one, getattr(choice.options, one.name))
            tip(f"{one.help} ({one.span})")
            if moved:
                choice = replace_option(choice, one.name, value)
                settings.method = str(choice)
        except UsageError as error:  # it is invalid, or conflicts with another option
            window.session.messages.say(str(error))
    imgui.tree_pop()


def replace_option(choice: Choice, name: str, value: Any) -> Choice:
    """A choice with a different value of an option.

    Raises:
        UsageError: the option does not accept it.
    """
    return replace(choice, options=replace(choice.options, **{name: value}))


def _widget(one: Described, value: Any) -> tuple[bool, Any]:
    """A widget for an option by its kind: (whether it was changed, its value)."""
    flags = imgui.SliderFlags_.always_clamp
    label = one.key
    if one.kind is bool:
        return imgui.checkbox(label, value)
    if one.choices:
        values = [*([None] if one.optional else []), *one.choices]
        moved, at = imgui.combo(label, values.index(value), [one.text(v) for v in values])
        return moved, values[at]
    if one.read is not None:
        moved, text = imgui.input_text(label, one.text(value), imgui.InputTextFlags_.enter_returns_true)
        return moved, one.value(text) if moved else value
    if one.kind is str:
        return imgui.input_text(label, value or "", imgui.InputTextFlags_.enter_returns_true)
    if one.optional:
        given = value is not None
        moved, given = imgui.checkbox(f"##{label}", given)
        if moved:
            return True, (one.kind(max(one.least or 0, min(1, one.most or 1))) if given else None)
        imgui.same_line()
        if value is None:
            imgui.text_disabled(label)
            return False, None
    least = one.least if one.least is not None else 0
    most = one.most if one.most is not None else max(10, 4 * least, 2 * value)
    if one.kind is int:
        return imgui.slider_int(label, value, int(least), int(most), f"%d {one.unit}", flags)
    return imgui.slider_float(label, value, float(least), float(most), f"%.3f {one.unit}".rstrip(), flags)
