"""What lies on the ground: the tint of heights, an image over it, water; and how far heights are stretched."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from imgui_bundle import imgui

from orograph.errors import OrographError
from orograph.geovis.colour import TINTS, colour_table
from orograph.picture.contours import Contours
from orograph.picture.kept import Kept

if TYPE_CHECKING:
    from orograph.viewer.window import Window

COLOURS = (
    None, *(t for t in TINTS if t != "sea"), "viridis", "gist_earth", "cmocean:topo", "crameri:batlow",
    "crameri:oleron",     "crameri:bukavu",
)  # fmt: skip
WATERS = ("auto", "none", "level")


def draw(window: Window) -> None:
    """The content of the panel."""
    session, settings = window.session, window.session.settings
    moved, factor = imgui.slider_float(
        "exaggeration", settings.exaggeration, 0.2, 10.0, "× %.2f", imgui.SliderFlags_.logarithmic
    )
    if moved and factor > 0:
        session.stretch(1.0 if abs(factor - 1.0) < 0.03 else factor)
    names = ["automatic" if c is None else c for c in COLOURS]
    at = COLOURS.index(settings.colormap) if settings.colormap in COLOURS else 0
    if settings.colormap not in COLOURS:
        names[0] = str(settings.colormap)
    moved, at = imgui.combo("colours", at, names)
    if moved:
        settings.colormap = COLOURS[at]
    _colour_by_name(window)
    nature = settings.relief is not None
    moved, nature = imgui.checkbox("slopes shaded as", nature)
    if moved:
        settings.relief = 1.0 if nature else None
    if settings.relief is not None:
        imgui.same_line()
        imgui.set_next_item_width(-60)
        _, settings.relief = imgui.slider_float("##relief", settings.relief, 0.0, 6.0, "× %.1f")
    kind = 0 if settings.water == "auto" else 1 if settings.water is None else 2
    moved, kind = imgui.combo("water", kind, list(WATERS))
    if moved:
        settings.water = ("auto", None, max(session.terrain.height_range[0], 0.0))[kind]
    if isinstance(settings.water, float):
        low, high = session.terrain.height_range
        _, settings.water = imgui.slider_float("water level", settings.water, low, high, "%.1f m")
    _drape(window)
    _contours(window)
    _, settings.furniture = imgui.checkbox("north, scale, colours", settings.furniture)


def _contours(window: Window) -> None:
    """Lines of equal height: the interval, by itself or by hand, and how they are drawn."""
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
        fitted = lines.fitted(window.session.terrain, window.session.view, Kept())
        lines = replace(lines, interval=fitted.interval if by_hand else None)
    if lines.interval is not None:
        flags = imgui.SliderFlags_.logarithmic
        moved, metres = imgui.slider_float("every", lines.interval, 0.5, 1000.0, "%.4g m", flags)
        if moved:
            lines = replace(lines, interval=max(float(f"{metres:.2g}"), 0.5))
    moved, opacity = imgui.slider_float("lines", lines.opacity, 0.0, 1.0, "%.2f")
    if moved:
        lines = replace(lines, opacity=min(max(opacity, 0.0), 1.0))
    moved, index = imgui.slider_int("thick ones: every", lines.index, 0, 10)
    if moved:
        lines = replace(lines, index=min(max(index, 0), 100))
    if lines.index:
        moved, labels = imgui.checkbox("heights on them", lines.labels)
        if moved:
            lines = replace(lines, labels=labels)
    settings.contours = lines


def _colour_by_name(window: Window) -> None:
    """Any name of the catalogue."""
    settings = window.session.settings
    entered, text = imgui.input_text_with_hint(
        "##colormap", "any cmap name, Enter", window.texts.get("colormap", ""), imgui.InputTextFlags_.enter_returns_true
    )
    window.texts["colormap"] = text
    if entered and text.strip():
        try:
            colour_table(text.strip())
        except OrographError as error:
            window.session.messages.say(str(error))
        else:
            settings.colormap = text.strip()


def _drape(window: Window) -> None:
    settings = window.session.settings
    if settings.drape is not None:
        _, settings.draped = imgui.checkbox(f"image: {Path(settings.drape).name}", settings.draped)
        if settings.draped:
            _, settings.opacity = imgui.slider_float("opacity", settings.opacity, 0.0, 1.0, "%.2f")
        imgui.same_line()
        if imgui.small_button("remove"):
            settings.drape = None
    entered, text = imgui.input_text_with_hint(
        "##image", "an image to lay over it, Enter", window.texts.get("drape", ""),
        imgui.InputTextFlags_.enter_returns_true,
    )  # fmt: skip
    window.texts["drape"] = text
    if entered and text.strip():
        path = Path(text.strip().strip("'\"")).expanduser()
        if path.is_file():
            settings.drape, settings.draped = str(path), True
        else:
            window.session.messages.say(f"There is no file {path}.")
