"""The sun: by azimuth and altitude, or the real sun by date and time at the place; a day can be played."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imgui_bundle import imgui

from orograph.scene.parts import Light
from orograph.viewer.panels.tips import CLAMPED
from orograph.viewer.wording import spoken

if TYPE_CHECKING:
    from orograph.viewer.window import Window

PRESETS = (("Map", 315.0, 45.0), ("Morning", 100.0, 18.0), ("Noon", 180.0, 60.0), ("Evening", 280.0, 12.0))

WAYS: tuple[tuple[str, Light], ...] = (
    ("sky view", "relief"),
    ("ambient occlusion", "ao"),
    ("ambient aperture", "aperture"),
    ("rays", "raytraced"),
    ("none", "none"),
)
"""Ways of lighting (``Scene.light``): baked layers of the store are used if present; rays accumulate at rest."""


def draw(window: Window) -> None:
    """Draw the panel."""
    light = window.session.settings.sun
    if imgui.radio_button("placed", light.mode == "placed"):
        sun = light.sun(window.session.terrain)
        light.mode, light.azimuth, light.altitude = "placed", sun.azimuth, max(sun.altitude, 0.0)
    imgui.same_line()
    imgui.begin_disabled(light.place is None)
    if imgui.radio_button("date and time", light.mode == "moment"):
        light.mode = "moment"
    imgui.end_disabled()
    if light.place is None and imgui.is_item_hovered(imgui.HoveredFlags_.allow_when_disabled):
        imgui.set_tooltip(spoken(light.trouble))
    if light.mode == "placed":
        _, light.azimuth = imgui.slider_float("azimuth", light.azimuth, 0.0, 360.0, "%.0f°", CLAMPED)
        _, light.altitude = imgui.slider_float("altitude", light.altitude, 0.0, 90.0, "%.0f°", CLAMPED)
        for k, (name, azimuth, altitude) in enumerate(PRESETS):
            if k:
                imgui.same_line()
            if imgui.small_button(name):
                light.azimuth, light.altitude = azimuth, altitude
    else:
        _moment(window)
    settings = window.session.settings
    _, settings.shadows = imgui.checkbox("cast shadows", settings.shadows)
    imgui.same_line()
    _, settings.sky = imgui.checkbox("sky and haze", settings.sky)
    names = [name for name, _ in WAYS]
    here = next(k for k, (_, way) in enumerate(WAYS) if way == settings.light)
    changed, chosen = imgui.combo("light", here, names)
    if changed:
        settings.light = WAYS[chosen][1]
    _, settings.occlusion = imgui.slider_float("dark corners", settings.occlusion, 0.0, 1.0, "%.2f", CLAMPED)
    if imgui.is_item_hovered():
        imgui.set_tooltip("Ambient occlusion in screen space: fast, but only from what is in the picture.")


def _moment(window: Window) -> None:
    light = window.session.settings.sun
    imgui.text(f"{light.when:%d %B %Y  %H:%M}  UTC{light.zone:+g}".replace("-", "−"))
    moved, hour = imgui.slider_float("time", light.hour, 0.0, 24.0, "%.2f h", CLAMPED)
    if moved:
        light.hour = hour
    moved, day = imgui.slider_int("day", light.day, 1, 366, "%d", CLAMPED)
    if moved:
        light.day = day
    moved, year = imgui.input_int("year", light.when.year, 1, 10)
    if moved and 1900 <= year <= 2100:
        leap = (light.when.month, light.when.day) == (2, 29)
        light.when = light.when.replace(year=year, day=28 if leap else light.when.day)
    moved, zone = imgui.slider_float("zone", light.zone, -12.0, 14.0, "UTC %+.0f h", CLAMPED)
    if moved:
        light.zone = round(zone)
    if imgui.button("Pause" if light.playing else "Play the day"):
        light.playing = not light.playing
    imgui.same_line()
    imgui.set_next_item_width(90)
    flags = CLAMPED | imgui.SliderFlags_.logarithmic
    _, hours = imgui.slider_float("h/s", light.speed / 3600.0, 0.1, 6.0, "%.1f", flags)
    light.speed = hours * 3600.0
    sun = light.sun(window.session.terrain)
    below = ", below the horizon" if sun.altitude < 0 else ""
    imgui.text_wrapped(f"azimuth {sun.azimuth:.1f}°, altitude {sun.altitude:.1f}°{below}".replace("-", "−"))
