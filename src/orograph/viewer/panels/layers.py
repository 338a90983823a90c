"""Layers on the ground: the tint of heights, images and rasters over it, water; and the exaggeration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from imgui_bundle import imgui

from orograph.errors import OrographError
from orograph.geovis.basemaps import PREFIX
from orograph.geovis.color import TINTS, color_table, tint_of
from orograph.geovis.layers import Layer, check_count
from orograph.geovis.laying import Laid
from orograph.memo import Memo
from orograph.scene.contours import Contours
from orograph.scene.silhouettes import Silhouettes
from orograph.viewer.panels.tips import CLAMPED, path_of, tip

if TYPE_CHECKING:
    from orograph.store.terrain import Terrain
    from orograph.viewer.settings import Settings
    from orograph.viewer.window import Window

COLOURS = (
    None, *(t for t in TINTS if t != "sea"), "viridis", "gist_earth", "cmocean:topo", "crameri:batlow",
    "crameri:oleron",     "crameri:bukavu",
)  # fmt: skip
WATERS = ("auto", "none", "level")
FLATTEST, STEEPEST = 0.01, 100.0
"""Exaggerations beyond which nothing useful is visible."""


def draw(window: Window) -> None:
    """Draw the panel."""
    session, settings = window.session, window.session.settings
    moved, factor = imgui.slider_float(
        "exaggeration", settings.exaggeration, 0.2, 10.0, "× %.2f", imgui.SliderFlags_.logarithmic
    )
    if moved and factor > 0:  # values beyond the slider can be typed
        session.stretch(1.0 if abs(factor - 1.0) < 0.03 else min(max(factor, FLATTEST), STEEPEST))
    names = ["automatic" if c is None else c for c in COLOURS]
    at = COLOURS.index(settings.colormap) if settings.colormap in COLOURS else 0
    if settings.colormap not in COLOURS:
        names[0] = str(settings.colormap)
    moved, at = imgui.combo("colours", at, names)
    if moved:
        settings.colormap = COLOURS[at]
    _color_by_name(window)
    _color_range(settings, session.terrain)
    nature = settings.relief is not None
    moved, nature = imgui.checkbox("slope shading", nature)
    if moved:
        settings.relief = 1.0 if nature else None
    if settings.relief is not None:
        imgui.same_line()
        imgui.set_next_item_width(-60)
        _, settings.relief = imgui.slider_float("##relief", settings.relief, 0.0, 6.0, "× %.1f", CLAMPED)
    kind = 0 if settings.water == "auto" else 1 if settings.water is None else 2
    moved, kind = imgui.combo("water", kind, list(WATERS))
    if moved:
        settings.water = ("auto", None, max(session.terrain.height_range[0], 0.0))[kind]
    if isinstance(settings.water, float):
        low, high = session.terrain.height_range
        _, settings.water = imgui.slider_float("water level", settings.water, low, high, "%.1f m", CLAMPED)
    _layers(window)
    _contours(window)
    _silhouettes(window)
    _, settings.furniture = imgui.checkbox("north, scale, colours", settings.furniture)


def _silhouettes(window: Window) -> None:
    """Lines along ridges and creases, and their width."""
    settings = window.session.settings
    moved, on = imgui.checkbox("silhouettes", settings.silhouettes is not None)
    if moved:
        settings.silhouettes = Silhouettes() if on else None
    if settings.silhouettes is not None:
        imgui.same_line()
        imgui.set_next_item_width(-60)
        moved, width = imgui.slider_float("##silhouettes", settings.silhouettes.width, 0.5, 6.0, "%.1f px")
        if moved:
            settings.silhouettes = replace(settings.silhouettes, width=min(max(width, 0.25), 32.0))


def _contours(window: Window) -> None:
    """Contour lines: the interval, automatic or manual, and how they are drawn."""
    settings = window.session.settings
    moved, on = imgui.checkbox("contours", settings.contours is not None)
    if moved:
        settings.contours = Contours() if on else None
    lines = settings.contours
    if lines is None:
        return
    imgui.same_line()
    moved, by_hand = imgui.checkbox("interval", lines.interval is not None)
    if moved:
        fitted = lines.fitted(window.session.terrain, window.session.view, Memo())
        lines = replace(lines, interval=fitted.interval if by_hand else None)
    if lines.interval is not None:
        flags = imgui.SliderFlags_.logarithmic
        moved, metres = imgui.slider_float("every", lines.interval, 0.5, 1000.0, "%.4g m", flags)
        if moved:
            lines = replace(lines, interval=min(max(float(f"{metres:.2g}"), 0.5), 10_000.0))
    moved, opacity = imgui.slider_float("##lines", lines.opacity, 0.0, 1.0, "opacity %.2f")
    if moved:
        lines = replace(lines, opacity=min(max(opacity, 0.0), 1.0))
    moved, index = imgui.slider_int("thick lines: every", lines.index, 0, 10)
    if moved:
        lines = replace(lines, index=min(max(index, 0), 100))
    if lines.index:
        moved, labels = imgui.checkbox("height labels", lines.labels)
        if moved:
            lines = replace(lines, labels=labels)
    settings.contours = lines


def _color_by_name(window: Window) -> None:
    """Any name from the catalogue."""
    settings = window.session.settings
    entered, text = imgui.input_text_with_hint(
        "##colormap", "any cmap name, Enter", window.texts.get("colormap", ""), imgui.InputTextFlags_.enter_returns_true
    )
    window.texts["colormap"] = text
    if entered and text.strip():
        try:
            color_table(text.strip())
        except OrographError as error:
            window.session.messages.say(str(error))
        else:
            settings.colormap = text.strip()


def _color_range(settings: Settings, terrain: Terrain) -> None:
    """The heights at the ends of the colours: the terrain's own, or given ones."""
    moved, given = imgui.checkbox("from, to (m)", settings.range is not None)
    tip("The heights at the ends of the colours, so that two terrains can share a scale.")
    if moved:
        tint = tint_of(terrain, settings.colormap)
        settings.range = (round(tint.floor if len(tint.sea) else tint.low), round(tint.high)) if given else None
    if settings.range is not None:
        imgui.same_line()
        imgui.set_next_item_width(-1)
        moved, (low, high) = imgui.drag_float2("##range", list(settings.range), 1.0, 0.0, 0.0, "%.0f")
        if moved and low < high:
            settings.range = low, high


def _layers(window: Window) -> None:
    """Images and rasters over the ground, the topmost first."""
    settings = window.session.settings
    stack = settings.layers
    change: Callable[[], None] | None = None
    for k in range(len(stack) - 1, -1, -1):
        layer = stack[k]
        imgui.push_id(k)
        moved, visible = imgui.checkbox("##visible", layer.visible)
        if moved:
            _set(window, k, visible=visible)
        imgui.same_line()
        imgui.text_unformatted(layer.label)
        if imgui.is_item_hovered():
            imgui.set_tooltip(_tooltip(layer))
        moved, opacity = imgui.slider_float("##opacity", layer.opacity, 0.0, 1.0, "opacity %.2f")
        if moved:
            _set(window, k, opacity=min(max(opacity, 0.0), 1.0))
        imgui.same_line()
        imgui.begin_disabled(k == len(stack) - 1)
        if imgui.arrow_button("up", imgui.Dir.up):
            change = partial(_swap, stack, k, k + 1)
        imgui.end_disabled()
        imgui.same_line()
        imgui.begin_disabled(k == 0)
        if imgui.arrow_button("down", imgui.Dir.down):
            change = partial(_swap, stack, k, k - 1)
        imgui.end_disabled()
        imgui.same_line()
        if imgui.small_button("x"):
            change = partial(stack.__delitem__, k)
        if imgui.is_item_hovered():
            imgui.set_tooltip("remove")
        moved, multiply = imgui.checkbox("multiply", layer.blend == "multiply")
        if moved:
            _set(window, k, blend="multiply" if multiply else "normal")
        imgui.pop_id()
    if change is not None:
        change()
    entered, text = imgui.input_text_with_hint(
        "##image", "a layer's path, Enter", window.texts.get("layer", ""),
        imgui.InputTextFlags_.enter_returns_true,
    )  # fmt: skip
    if imgui.is_item_hovered():
        imgui.set_tooltip(
            "A file in any CRS, or one dropped on the window.\nA raster: rain.tif,colormap=viridis,range=0:80"
        )
    window.texts["layer"] = text
    if entered and text.strip() and add(window, text):
        window.texts["layer"] = ""


def _swap(stack: list[Layer], a: int, b: int) -> None:
    stack[a], stack[b] = stack[b], stack[a]


def _set(window: Window, k: int, **values: Any) -> None:
    """Change one layer, unless a picture cannot take it."""
    stack = list(window.session.settings.layers)
    stack[k] = replace(stack[k], **values)
    try:
        check_count(stack)
    except OrographError as error:
        window.session.messages.say(str(error))
    else:
        window.session.settings.layers = stack


def _tooltip(layer: Layer) -> str:
    """The settings of a layer, for its tooltip."""
    parts = [layer.path]
    if layer.colormap is not None:
        span = "" if layer.range is None else f" from {layer.range[0]:g} to {layer.range[1]:g}"
        parts.append(f"band {layer.band} coloured by {layer.colormap}{span}")
    return "\n".join(parts)


def add(window: Window, text: str) -> bool:
    """Lay a file over all others (``Layer.parse``); errors appear in the window. Returns whether it was added."""
    session = window.session
    try:
        layer = Layer.parse(text.strip().strip("'\""))
        if not layer.path.startswith(PREFIX):
            layer = replace(layer, path=str(path_of(layer.path)))
        if "://" not in layer.path:  # the drawing threads wait for remote files
            Laid.open(layer, session.terrain.grid)
        check_count([*session.settings.layers, layer])
    except OrographError as error:
        session.messages.say(str(error))
        return False
    session.settings.layers = [*session.settings.layers, layer]
    return True
