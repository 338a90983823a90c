"""The five questions of ``docs/questions.md``, answered by hand in the window, and by NumPy from the files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from scipy.ndimage import map_coordinates

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

from hand import Hand
from imgui_bundle import imgui
from pyproj import Transformer

from orograph.geovis.data.dataset import Dataset
from orograph.viewer.commands import change_data
from orograph.viewer.panels import plot

pytestmark = pytest.mark.stress

DEM, SERIES = "ukv-theta-over-orography/uk_orography_2km.tif", "fields-and-points/era5-2mt-2019-03-uk.grib"
NAME = "2 metre temperature"
SUMMIT, CITY = (-3.942352, 53.164637), (-6.26, 53.35)
"""Longitude and latitude: the highest sample of the terrain, and Dublin."""

KINDS = ("checkbox", "button", "small_button", "input_float", "input_float2", "input_text_with_hint", "combo")


class Truth:
    """The same from the files: heights (rows, cols), and temperatures at the terrain's samples, linear in space."""

    def __init__(self, folder: Path) -> None:
        with rasterio.open(folder / DEM) as dem:
            self.heights, place, crs = dem.read(1), dem.transform, dem.crs
        rows, cols = self.heights.shape
        self.col, self.row = np.meshgrid(np.arange(cols), np.arange(rows))
        self.back = Transformer.from_crs(crs, 4326, always_xy=True).transform
        self.forth = Transformer.from_crs(4326, crs, always_xy=True).transform
        self.x, self.y = place @ (self.col + 0.5, self.row + 0.5)
        with rasterio.open(folder / SERIES) as file:
            self.hours, self.image = file.read().astype(np.float64) - 273.15, file.transform

        self.noon = self.hours[12::24]

    def over(self, values: np.ndarray, x: Any = None, y: Any = None) -> np.ndarray:
        """What the series' samples (rows, cols) say at places of the terrain: at all of its samples, if none are
        named. (A probability, or a spread, is that of a sample; the window interpolates it, too.)"""
        col, row = ~self.image @ self.back(*((self.x, self.y) if x is None else (x, y)))
        found = map_coordinates(values, [np.atleast_1d(row - 0.5), np.atleast_1d(col - 0.5)], order=1)
        return np.asarray(found).reshape(np.shape(row))

    def place(self, lonlat: tuple[float, float]) -> tuple[float, float]:
        return self.forth(*lonlat)


@pytest.fixture(scope="module")
def truth(shared_data: Path) -> Truth:
    for name in (DEM, SERIES):
        if not (shared_data / name).exists():
            pytest.skip(f"{name} is not there")
    return Truth(shared_data)


class Analyst(Hand):
    """A hand that finds controls by their labels."""

    def __init__(self, window: Any, patch: pytest.MonkeyPatch) -> None:
        super().__init__(window)
        self.seen: dict[str, tuple[float, float, float, float]] = {}
        self.combos: dict[str, list[str]] = {}
        for kind in KINDS:
            patch.setattr(imgui, kind, self._watched(getattr(imgui, kind)))

    def _watched(self, control: Any) -> Any:
        def called(label: str, *more: Any, **named: Any) -> Any:
            out = control(label, *more, **named)
            low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
            self.seen[label] = low.x, low.y, high.x, high.y
            return out

        return called

    def panel(self, name: str) -> None:
        self.window.gui.raised = [name]
        self.seen.clear()
        self.window.touch()
        self.frames(6)

    def at(self, label: str, part: float = 0.5) -> tuple[float, float]:
        self.seen.pop(label, None)
        self.window.touch()
        self.until(lambda: label in self.seen)
        x0, y0, x1, y1 = self.seen[label]
        return x0 + part * (x1 - x0), (y0 + y1) / 2

    def push(self, label: str) -> None:
        self.click(*self.at(label, 0.1))

    def write(self, label: str, *numbers: float) -> None:
        """Type numbers into the fields of a label, and press Enter."""
        for k, number in enumerate(numbers):
            self.enter(label, f"{number:g}", (k + 0.3) / 2 if label.startswith("##range") else 0.3)

    def enter(self, label: str, text: str, part: float = 0.3) -> None:
        """Type a text into a field, and press Enter."""
        self.click(*self.at(label, part))
        self.frames(2)
        self.event("key_down", key="Control", modifiers=("Control",))
        self.event("key_down", key="a", modifiers=("Control",))
        self.event("key_up", key="a", modifiers=("Control",))
        self.event("key_up", key="Control")
        self.frames(2)
        for letter in text:
            self.event("char", data=letter)
        self.frames(2)
        self.key("Enter")
        self.frames(4)

    def painted(self) -> None:
        """Until what is chosen is shown."""
        self.until(lambda: not self.window.session.settings.painting, 300)

    def choose(self, label: str, words: str) -> None:
        """Open a list and click one of its lines."""
        self.painted()
        names = self.window.brush.names(self.window.session.terrain, self.window.session.settings.shown)
        if label == "##plot y":
            names = ["(histogram)", *names]
        x, y = self.at(label)
        self.click(x, y)
        self.frames(3)
        bottom = self.seen[label][3]
        line = imgui.get_text_line_height_with_spacing()
        self.click(x, bottom + 4 + (names.index(words) + 0.5) * line)
        self.frames(4)

    @property
    def selected(self) -> float:
        """The part of the ground that is selected, as the panel Plot says."""
        session = self.window.session
        words = self.window.brush.describe(session.terrain, session.settings.shown)
        return float(re.match(r"([\d.e-]+) % of the ground", words)[1]) / 100

    def point(self, lonlat: tuple[float, float]) -> Any:
        """Point at a place; what the read-out says of the data there."""
        session = self.window.session
        x, y = Transformer.from_crs(4326, session.terrain.grid.crs, always_xy=True).transform(*lonlat)
        col, row = (round(float(v)) for v in session.terrain.grid.index(x, y))
        height = float(session.terrain.read(0, row, row + 1, col, col + 1)[0, 0])
        (u, v), _ = session.view.project(np.array([x, y, height]), session.settings.exaggeration)
        self.move(*self.window.to_canvas(float(u), float(v)))
        self.frames(3)
        self.until(lambda: session.probe.hit is not None and bool(self.window.found()))
        hit = session.probe.hit
        assert np.hypot(hit.easting - x, hit.northing - y) < 6000
        return self.window.found()[0]


@pytest.fixture(scope="module")
def opened(truth: Truth, shared_data: Path, device: Any) -> Iterator[Analyst]:
    """As after ``orograph view DEM --data SERIES,time=T12 --uncertainty spread``, but smaller and unlit."""
    from rendercanvas.offscreen import RenderCanvas

    from orograph.store.prepare import prepare
    from orograph.viewer.app import renderer_of
    from orograph.viewer.session import Session
    from orograph.viewer.window import Window

    data = Dataset(str(shared_data / SERIES), time="T12", uncertainty="spread")
    terrain = prepare([str(shared_data / DEM)])
    with pytest.MonkeyPatch.context() as patch:
        session = Session(terrain, size=(320, 240), tolerance=4.0, data=data, light="none", samples=1, water="none")
        canvas = RenderCanvas(size=(900, 900))  # (high enough for all of the panel Plot)
        window = Window(session, canvas, renderer_of(64 << 20), device=device)
        hand = Analyst(window, patch)
        hand.frames(3)
        hand.rest()
        yield hand
        canvas.close()
        window.gui.close()


@pytest.fixture
def analyst(opened: Analyst) -> Analyst:
    """The window as it was opened, whatever was asked before."""
    window, shown = opened.window, opened.window.session.settings.shown
    plot.select(window, ranges={}, area=())
    window.texts.clear()
    if shown.exceeds is not None or shown.time:
        shown.exceeds = None
        change_data(window, time="")
        opened.painted()
    return opened


def test_where_is_it_above_a_value_with_90_percent_certainty(analyst, truth):
    analyst.panel("Data")
    analyst.push("probability above##exceeds")
    analyst.write("##above0", 7)
    analyst.panel("Plot")
    analyst.choose("##plot x", f"P({NAME} > 7 °C)")
    analyst.write(f"##range P({NAME} > 7 °C)", 0.9)
    part = truth.over((truth.noon > 7).mean(0))
    assert analyst.selected == pytest.approx((part >= 0.9).mean(), abs=0.01)
    analyst.panel("Data")
    analyst.write("##above0", 15)
    analyst.panel("Plot")
    analyst.write(f"##range P({NAME} > 15 °C)", 0.9, 1)
    assert analyst.selected == 0 == (truth.over((truth.noon > 15).mean(0)) >= 0.9).mean()


def test_where_is_it_least_certain(analyst, truth):
    analyst.panel("Plot")
    analyst.choose("##plot x", f"± {NAME}")
    spread = truth.over(truth.noon.std(0, ddof=1))
    assert analyst.window.plotted.ends[0] == pytest.approx((spread.min(), spread.max()), abs=0.02)
    analyst.write(f"##range ± {NAME}", 2.2, 3)
    assert analyst.selected == pytest.approx((spread >= 2.2).mean(), abs=0.01)


def test_when_is_it_warmest_at_a_place(analyst, truth):
    analyst.panel("Data")
    hours = []
    shown, place = analyst.window.session.settings.shown, truth.place(SUMMIT)
    for hour in range(24):
        analyst.push(">##later")
        analyst.until(lambda hour=hour: shown.time == f"2019-03-01T{hour:02d}:00")
        analyst.painted()
        hours.append((shown.at(*place)[0].value, shown.time))  # (what the read-out would say)
    warmest = max(hours)[1]
    while shown.time > warmest:
        before = shown.time
        analyst.push("<##earlier")
        analyst.until(lambda before=before: shown.time < before)
        analyst.painted()
    assert shown.time == warmest and analyst.point(SUMMIT).value == pytest.approx(max(hours)[0], abs=0.1)
    own = [float(truth.over(hour, *truth.place(SUMMIT))) for hour in truth.hours[:24]]
    np.testing.assert_allclose([value for value, _ in hours], own, atol=0.1)
    assert warmest == f"2019-03-01T{int(np.argmax(own)):02d}:00"


def test_is_one_place_warmer_than_another_beyond_doubt(analyst, truth):
    """Typed places, and what picks tell of them: each, and their difference day by day."""
    analyst.panel("Camera")
    analyst.push("Measure")
    tools = analyst.window.tools
    analyst.until(lambda: tools.active)
    tools.choose("pick")
    for lon, lat in (SUMMIT, CITY):
        analyst.enter("##place", f"{lat:.6f} N {-lon:.6f} W")
    analyst.until(lambda: len(tools.points) == 2 and tools.result is not None)
    said = dict(tools.data_rows())
    days = []
    for place, name in ((SUMMIT, "at the first place"), (CITY, NAME)):
        at = truth.place(place)
        days.append(np.array([float(truth.over(noon, *at)) for noon in truth.noon]))
        value, sigma = (float(word) for word in re.match(r"([\d.]+) ± ([\d.]+) °C", said[name]).groups())
        assert value == pytest.approx(days[-1].mean(), abs=0.15)
        assert sigma == pytest.approx(float(truth.over(truth.noon.std(0, ddof=1), *at)), abs=0.1)
    apart = days[1] - days[0]
    value, sigma = (float(word) for word in re.match(r"([\d.]+) ± ([\d.]+) °C higher", said["difference"]).groups())
    assert (value, sigma) == pytest.approx((apart.mean(), apart.std(ddof=1)), abs=0.02)
    assert said[""] == f"less than its uncertainty, so in {(apart > 0).sum()} of 31"
    found = analyst.point(CITY)
    assert found.value == pytest.approx(days[1].mean(), abs=0.1)
    tools.leave()


def test_how_much_of_the_high_ground_is_cold(analyst, truth):
    analyst.panel("Plot")
    analyst.choose("##plot x", "Height")
    analyst.choose("##plot y", NAME)
    analyst.write("##range Height", 300, 2000)
    high = analyst.selected
    assert high == pytest.approx((truth.heights >= 300).mean(), abs=0.006)
    analyst.write(f"##range {NAME}", -10, 8)
    cold = truth.over(truth.noon.mean(0)) <= 8
    assert analyst.selected == pytest.approx((cold & (truth.heights >= 300)).mean(), abs=0.006)
