"""The manual's pictures of the window: python examples/window_pictures.py DEM docs/images [NAME ...]

Each is the whole window as it would be on a screen of 1280 × 800, drawn off screen, set by the same calls that mouse,
keys and panels make. The DEM is the tile of the White Mountains (SRTM N44W072); that of ``DATA`` is the orography of
the Met Office's UK model, with ERA5's temperature and its spread (``--data era5.grib,time=T12``). Needs the extra
``view``.
"""

from __future__ import annotations

import argparse
import datetime
import math
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rendercanvas.offscreen import RenderCanvas

from orograph.geovis.data.dataset import Dataset
from orograph.scene.contours import Contours
from orograph.store.prepare import prepare
from orograph.viewer import commands
from orograph.viewer.app import renderer_of
from orograph.viewer.panels import data, plot
from orograph.viewer.results import Kind
from orograph.viewer.session import Session
from orograph.viewer.window import Window
from orograph.viewpoint import View

SIZE = (1280, 800)
EVENING = datetime.datetime(2026, 9, 27, 17, 15, tzinfo=datetime.timezone(datetime.timedelta(hours=-4)))
WASHINGTON, ADAMS = (316_181.0, 4_904_514.0), (317_278.0, 4_909_999.0)
"""Summits, UTM zone 19N."""


class Maker:
    """A window, and what is done in it."""

    def __init__(self, dem: str, **options: Any) -> None:
        self.session = Session(prepare([dem]), size=SIZE, **options)
        self.window = Window(self.session, RenderCanvas(size=SIZE), renderer_of())

    def look(self, east: float, north: float, height: float, heading: float, pitch: float, fov: float = 30.0) -> None:
        """Be at a place, looking that way."""
        a, p = math.radians(heading), math.radians(pitch)
        way = np.array([math.cos(p) * math.sin(a), math.cos(p) * math.cos(a), math.sin(p)])
        self.frames(2)  # panels take their part of the window
        view = self.session.view
        target = np.array([east, north, height]) + 10_000.0 * way
        self.session.nav.jump(
            View((east, north, height), tuple(target), fov_y=fov, width=view.width, height=view.height)
        )

    def evening(self) -> None:
        """The real sun, low in the west."""
        light = self.session.settings.sun
        light.mode, light.when = "moment", EVENING

    def point(self, x: float, y: float) -> None:
        """The mouse is there."""
        event = {"event_type": "pointer_move", "x": x, "y": y, "button": 0, "modifiers": (), "buttons": ()}
        self.window.canvas.submit_event(event)

    def frames(self, n: int = 3) -> None:
        for _ in range(n):
            self.window.canvas._process_events()
            self.window.canvas.draw()

    def until(self, what: Callable[[], Any], seconds: float = 180.0) -> None:
        """Draw until something is so."""
        end = time.monotonic() + seconds
        while not what() and time.monotonic() < end:
            self.frames(1)
            time.sleep(0.02)

    def measure(self, kind: Kind, *places: tuple[float, float]) -> None:
        """Measure at places."""
        tools = self.window.tools
        tools.active = True
        tools.choose(kind)
        tools.points = [(x, y, self.session.probe.ground(x, y)) for x, y in places]
        tools.measure()
        self.until(lambda: tools.result is not None or tools.trouble)

    def raise_panel(self, name: str) -> None:
        """Bring a panel to the top of its stack."""
        self.window.gui.raised.append(name)

    def save(self, path: Path) -> None:
        """The whole window, as good as it gets."""
        window = self.window
        self.until(lambda: not window.session.moving and window.drawing.done and not window.plan.wanted)
        window.session.messages.hush()
        self.frames(8)
        with tempfile.TemporaryDirectory() as folder:
            png = Path(folder) / "window.png"
            window.pictures.write(png, panels=True)
            Image.open(png).save(path, quality=88, optimize=True, progressive=True)
        window.canvas.close()


def viewer(m: Maker) -> None:
    m.evening()
    m.look(319_321.8, 4_890_645.7, 6_176.9, 350.0, -17.0)
    m.point(480, 330)


def frozen(m: Maker) -> None:
    settings = m.session.settings
    settings.tolerance = 3.0
    m.look(319_321.8, 4_890_645.7, 6_176.9, 350.0, -17.0)
    m.frames()
    commands.toggle_freeze(m.window)
    settings.wireframe = settings.levels = True
    m.look(336_500.0, 4_889_800.0, 20_500.0, 310.0, -36.0)
    m.raise_panel("Detail")


def method(m: Maker) -> None:
    m.evening()
    m.session.settings.method, m.session.settings.tolerance = "roam", 4.0
    m.session.settings.wireframe = True
    m.look(306_980.4, 4_895_256.8, 2_750.0, 44.2, -6.8, 35.0)
    m.frames(20)


def plan(m: Maker) -> None:
    m.session.settings.sun.altitude = 35.0
    m.session.settings.contours = Contours()
    m.window.plan.cycle()
    m.look(319_321.8, 4_888_000.0, 7_200.0, 350.0, -19.0)
    m.raise_panel("Layers")
    m.frames(30)


def tour(m: Maker) -> None:
    m.evening()
    touring = m.window.touring
    for heading in (30.0, 95.0, 160.0, 225.0):
        a = math.radians(heading)
        m.look(WASHINGTON[0] - 13_000 * math.sin(a), WASHINGTON[1] - 13_000 * math.cos(a), 3_900.0, heading, -9.5, 35.0)
        touring.add()
    touring.show(6.0)
    touring.chosen = 1
    m.raise_panel("Tour")


def profile(m: Maker) -> None:
    m.session.settings.sun.altitude = 35.0
    m.look(309_500.0, 4_889_500.0, 11_500.0, 24.0, -30.0)
    m.measure("profile", (309_600.0, 4_901_700.0), WASHINGTON, ADAMS, (325_000.0, 4_912_500.0))
    m.frames(3)
    m.point(345, 260)
    m.frames(4)


def viewshed(m: Maker) -> None:
    m.session.settings.sun.altitude = 35.0
    m.look(316_250.0, 4_872_500.0, 36_000.0, 0.0, -48.0)
    m.window.tools.radius = 25_000.0
    m.measure("viewshed", WASHINGTON)


def question(m: Maker) -> None:
    """Where is it above 7 °C with 90 % certainty?"""
    m.until(lambda: m.session.settings.shown and m.session.settings.shown.painted)
    data.exceed(m.window, 7.0)
    m.until(lambda: not m.session.settings.painting)
    name = "P(2 metre temperature > 7 °C)"
    plot.select(m.window, ranges={name: (0.9, 1.0)})
    m.window.texts["plot x"] = name
    m.frames(6)
    m.raise_panel("Plot")
    m.frames(20)


def brushing(m: Maker) -> None:
    """What is warmer than 9 °C, on the ground and beside the height."""
    name = "2 metre temperature"
    plot.select(m.window, ranges={name: (9.0, 13.0)})
    m.window.texts |= {"plot x": name, "plot y": "Height"}
    m.frames(6)
    m.raise_panel("Plot")
    m.frames(20)


DATA = {"question": question, "brushing": brushing}
PICTURES = {
    "viewer": viewer, "viewer-frozen": frozen, "viewer-method": method, "viewer-plan": plan, "viewer-tour": tour,
    "viewer-profile": profile, "viewer-viewshed": viewshed,
}  # fmt: skip


def main() -> None:
    """Make all of them, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dem")
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", choices=[*PICTURES, *DATA, []])
    parser.add_argument("--data", help="shown over the DEM (for those of DATA)")
    parser.add_argument("--exaggeration", type=float, default=20.0, help="of those of DATA")
    given = parser.parse_args()
    shown = {}
    if given.data:
        shown["data"] = Dataset.parse(given.data).but(uncertainty="spread")
        shown["exaggeration"] = given.exaggeration
    for name in given.names or PICTURES:
        with tempfile.TemporaryDirectory() as config:
            os.environ["OROGRAPH_CONFIG"] = config  # nobody's layout but the first one
            maker = Maker(given.dem, **shown)
            {**PICTURES, **DATA}[name](maker)
            maker.save(given.folder / f"{name}.jpg")
        print(given.folder / f"{name}.jpg", flush=True)


if __name__ == "__main__":
    main()
