"""Data at picked places, how two differ, places that are typed, ranges that are open, and units beside numbers."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

from orograph import measuring
from orograph.dem.raster import Dem
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.painting import shown
from orograph.geovis.data.priority import Priority
from orograph.measuring import Places
from orograph.store import terrain as in_memory
from orograph.viewer import comparing
from orograph.viewer.brushing import Brush, opened
from orograph.viewer.data import Found, ShownData
from orograph.viewer.panels.plot import told
from orograph.viewer.results import save
from orograph.viewer.typed_place import place_of

FIRST, SECOND = (40.0, 100.0), (200.0, 100.0)
"""Columns and rows of two places of the test terrain."""


TEXELS = 256


@pytest.fixture(scope="module")
def terrain():
    """A plain at 500 m."""
    grid = Grid((129, 257), Affine(30, 0, 412_000, 0, -30, 4_987_000), CRS.from_epsg(32633))
    return in_memory(Dem(np.full(grid.shape, 500, np.float32), grid))


def painted(data, terrain):
    """Data as a window holds them that was opened with them, on a coarse image."""
    made = ShownData((data,), Priority.parse("T+D+U-"), terrain.grid)
    made.painted = tuple(shown(one, terrain.grid, TEXELS, made.priority) for one in made.current(terrain))
    return made


def members(terrain, together):
    """Five members over the terrain that grow to the east by a little more than 3 in all; what makes them differ is
    common to all places, or not."""
    rows, cols = terrain.grid.shape
    ramp = np.linspace(0, 3, cols)
    common = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    own = np.array([0.2, -0.1, 0.0, 0.1, -0.2])
    if not together:
        common, own = common * 0, np.array([6.0, -6.0, 2.0, -2.0, 0.0])
    values = common[:, None] + ramp + own[:, None] * ramp / 3
    values = np.broadcast_to(values[:, None, :], (5, rows, cols)).astype(np.float32).copy()
    return Dataset(values, name="warmth", unit="K", uncertainty="spread"), values


def points_of(terrain):
    grid = terrain.grid
    return [(*(float(v) for v in grid.xy(*place)), 500.0) for place in (FIRST, SECOND)]


@pytest.mark.parametrize("together", [True, False])
def test_members_are_compared_one_by_one(terrain, together):
    data, values = members(terrain, together)
    held, grid, at = painted(data, terrain), terrain.grid, points_of(terrain)
    a, b = (values[:, round(row), round(col)] for col, row in (FIRST, SECOND))
    said = dict(comparing.rows(held, grid, at))
    (one,) = held.at(*at[1][:2])
    (other,) = held.at(*at[0][:2])
    found = comparing.difference(held, grid, at, other, one)
    assert found.value == pytest.approx((b - a).mean(), abs=1e-4)
    assert found.sigma == pytest.approx((b - a).std(ddof=1), rel=1e-4)
    assert (found.agreeing, found.members) == (((b - a) > 0).sum(), 5)
    assert other.value == pytest.approx(a.mean(), abs=0.02) and said["warmth"] == one.value_words
    assert said["at the first place"] == other.value_words
    assert said["difference"] == Found("", found.value, found.sigma, "K").value_words + " higher here"
    more = "more" if together else "less"  # as the spreads at the two places alone do not tell
    assert said[""] == f"{more} than its uncertainty, so in {found.agreeing} of 5"
    assert [name for name, _ in comparing.rows(held, grid, at[:1])] == ["warmth"]


def test_errors_that_are_given_are_independent(terrain, tmp_path):
    rows, cols = terrain.grid.shape
    values = np.broadcast_to(np.linspace(0, 3, cols), (rows, cols)).astype(np.float32).copy()
    held = painted(Dataset(values, name="rain", uncertainty=np.full_like(values, 0.6)), terrain)
    grid, at = terrain.grid, points_of(terrain)
    (first,), (second,) = (held.at(*point[:2]) for point in at)
    found = comparing.difference(held, grid, at, first, second)
    assert found.sigma == pytest.approx(0.6 * math.sqrt(2), rel=1e-5) and found.members == 0
    assert found.words[1] == "more than its uncertainty"
    path = save("pick", measuring.place(terrain, at[1][:2]), at, terrain, tmp_path / "a", (second,))
    assert json.loads(path.read_text())["data"] == [
        {"name": "rain", "value": second.value, "uncertainty": pytest.approx(0.6), "unit": ""}
    ]
    assert comparing.Difference("rain", "mm", 0.0).words == ["none (0 mm)"]


@pytest.mark.stress
def test_picks_tell_data_and_follow_what_is_shown(window, hand):
    here = window.session.terrain
    rows, cols = here.grid.shape
    ramp = np.broadcast_to(np.linspace(0, 3, cols), (rows, cols)).astype(np.float32).copy()
    window.session.settings.shown = held = painted(Dataset(ramp, name="warmth", unit="K"), here)
    tools = window.tools
    tools.active, tools.kind = True, "pick"
    for point in points_of(here):
        tools.points.append(point)
        tools.measure()
    hand.until(lambda: tools.result is not None)
    assert [name for name, _ in tools.data_rows()] == ["warmth", "at the first place", "difference"]
    before = tools.data_rows()[0]
    held.painted = painted(Dataset(ramp + 1, name="warmth", unit="K"), here).painted
    assert tools.data_rows()[0] != before
    tools.add("53.35 N 6.26 W")
    assert len(tools.points) == 2 and any("km" in message.text for message in window.session.messages.shown)
    x, y = points_of(here)[0][:2]
    tools.add(f"{x} {y}")  # a third place: one begins anew
    assert tools.points == [pytest.approx((x, y, 500.0), abs=0.1)]


def test_a_typed_place(terrain):
    x, y = (float(v) for v in terrain.grid.xy(*FIRST))
    ((lon, lat),) = Places(terrain).lonlat(np.array([[x, y]]))
    degrees = [f"{lat:.7f}° N  {lon:.7f}° E", f"{lat:.7f} n, {lon:.7f} e", f"{lon:.7f}E {lat:.7f}N"]
    metres = [f"{x} {y}", f"{x},{y}", f"E {x:,.1f}   N {y:,.1f}".replace(",", " ")]
    for text in (*degrees, f"{-lat:.7f} S {-lon:.7f} W", *metres):
        assert place_of(text, terrain) == pytest.approx((x, y), abs=0.06), text
    for text in ("", "Dublin", "1 2 3", "53 N 6 N", "0 0"):
        with pytest.raises(UsageError):
            place_of(text, terrain)


@pytest.mark.parametrize(
    ("value", "sigma", "unit", "said"),
    [
        (9.6012, 2.004, "°C", "9.6 ± 2.0 °C"), (0.66, 0.583, "K", "0.66 ± 0.58 K"),
        (3412.3, 118.0, "m", "3412 ± 118 m"),
        (1.5, 0.9999, "", "1.5 ± 1.0"), (0.93487, None, "", "0.9349"), (7.0, 0.0, "m", "7 ± 0 m"),
        ("Forest", None, "", "Forest"),
    ],
)  # fmt: skip
def test_a_value_has_as_many_digits_as_its_uncertainty(value, sigma, unit, said):
    assert Found("", value, sigma, unit).value_words == said


def test_a_range_that_reaches_the_end_of_a_plot_is_open(terrain):
    assert opened((0.9, 0.9355), (0.48, 0.9355)) == (0.9, math.inf)
    assert opened((np.float32(0.9), np.float32(0.93548387)), (0.48, 0.93548387)) == (pytest.approx(0.9), math.inf)
    assert opened((0.0, 0.6), (0.48, 0.9355)) == (-math.inf, 0.6)
    assert opened((0.95, 0.95), (0.48, 0.9355)) == (0.95, math.inf)
    assert [told(r, "m") for r in ((0.9, math.inf), (-math.inf, 2), (2, 3.5), (-math.inf, math.inf))] == [
        "0.9 m or more", "2 m or less", "2 to 3.5 m", "any",
    ]  # fmt: skip
    # A peak between the plot's places is selected with all that is high.
    values = np.zeros(terrain.grid.shape, np.float32)
    values[:, :128], values[71, 71] = 1.0, 5.0
    held, brush = painted(Dataset(values, name="load", unit="t"), terrain), Brush()
    plotted = brush.ground(terrain, held).values["load"]
    brush.choose({"load": opened((0.5, 1.0), (float(np.nanmin(plotted)), 1.0))})
    brush.apply(terrain, held)
    with rasterio.open(brush.veil.path) as file:
        row, col = file.index(*terrain.grid.xy(71, 71))
        assert file.read(4)[row, col] == 0 and file.read(4).max() > 0
    assert brush.units(terrain, held) == {"Height": "m", "load": "t", "± load": "t"}


def test_a_limit_has_the_unit_of_the_data(terrain):
    data, _ = members(terrain, True)
    held = painted(data, terrain)
    assert held.exceeding.unit == "K"
    held.exceeds = 1.0
    held.painted = tuple(shown(one, terrain.grid, TEXELS, held.priority) for one in held.current(terrain))
    assert held.exceeding.unit == "" and held.exceeding.field.limit_unit == "K"
