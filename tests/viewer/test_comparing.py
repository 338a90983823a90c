"""Data at picked places, how two differ, places that are typed, ranges that are open, and units beside numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

from orograph.errors import UsageError
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.priority import Priority
from orograph.viewer import comparing
from orograph.viewer.brushing import opened
from orograph.viewer.data import Found, ShownData
from orograph.viewer.panels import plot
from orograph.viewer.panels.plot import told
from orograph.viewer.typed_place import place_of

FIRST, SECOND = (40.0, 100.0), (200.0, 100.0)
"""Columns and rows of two places of the test terrain."""


def give(window, data):
    """Data to a window that is open, as it was opened with them."""
    settings = window.session.settings
    settings.shown = ShownData((data,), Priority.parse("T+D+U+"), window.session.terrain.grid)
    settings.show(window.session.terrain)
    window.touch()


def members(window, together):
    """Five members over the terrain that grow to the east by a little more than 3 in all; what makes them differ is
    common to all places, or not."""
    rows, cols = window.session.terrain.grid.shape
    ramp = np.linspace(0, 3, cols)
    common = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    own = np.array([0.2, -0.1, 0.0, 0.1, -0.2])
    if not together:
        common, own = common * 0, np.array([6.0, -6.0, 2.0, -2.0, 0.0])
    values = common[:, None] + ramp + own[:, None] * ramp / 3
    values = np.broadcast_to(values[:, None, :], (5, rows, cols)).astype(np.float32).copy()
    return Dataset(values, name="warmth", unit="K", uncertainty="spread"), values


def points_of(window):
    grid = window.session.terrain.grid
    return [(*(float(v) for v in grid.xy(*place)), 500.0) for place in (FIRST, SECOND)]


@pytest.mark.parametrize("together", [True, False])
def test_members_are_compared_one_by_one(window, together):
    data, values = members(window, together)
    give(window, data)
    shown, grid, at = window.session.settings.shown, window.session.terrain.grid, points_of(window)
    a, b = (values[:, round(row), round(col)] for col, row in (FIRST, SECOND))
    said = dict(comparing.rows(shown, grid, at))
    (one,) = shown.at(*at[1][:2])
    (other,) = shown.at(*at[0][:2])
    found = comparing.difference(shown, grid, at, other, one)
    assert found.value == pytest.approx((b - a).mean(), abs=1e-4)
    assert found.sigma == pytest.approx((b - a).std(ddof=1), rel=1e-4)
    assert (found.agreeing, found.members) == (((b - a) > 0).sum(), 5)
    assert other.value == pytest.approx(a.mean(), abs=0.02) and said["warmth"] == one.value_words
    assert said["at the first place"] == other.value_words
    assert said["difference"] == Found("", found.value, found.sigma, "K").value_words + " higher here"
    more = "more" if together else "less"  # as the spreads at the two places alone do not tell
    assert said[""] == f"{more} than its uncertainty, so in {found.agreeing} of 5"
    assert [name for name, _ in comparing.rows(shown, grid, at[:1])] == ["warmth"]


def test_errors_that_are_given_are_independent(window):
    rows, cols = window.session.terrain.grid.shape
    values = np.broadcast_to(np.linspace(0, 3, cols), (rows, cols)).astype(np.float32).copy()
    give(window, Dataset(values, name="rain", uncertainty=np.full_like(values, 0.6)))
    shown, grid, at = window.session.settings.shown, window.session.terrain.grid, points_of(window)
    (first,), (second,) = (shown.at(*point[:2]) for point in at)
    found = comparing.difference(shown, grid, at, first, second)
    assert found.sigma == pytest.approx(0.6 * math.sqrt(2), rel=1e-5) and found.members == 0
    assert found.words[1] == "more than its uncertainty"
    assert comparing.Difference("rain", "mm", 0.0).words == ["none (0 mm)"]


def test_picks_tell_data_and_follow_the_time(window, hand):
    data, _ = members(window, True)
    give(window, data)
    tools = window.tools
    tools.active, tools.kind = True, "pick"
    for point in points_of(window):
        tools.points.append(point)
        tools.measure()
    hand.until(lambda: tools.result is not None)
    assert [name for name, _ in tools.data_rows()] == ["warmth", "at the first place", "difference", ""]
    before = tools.data_rows()[0]
    give(window, data.but(source=np.asarray(data.source) + 1))
    assert tools.data_rows()[0] != before
    hand.frames(2)  # the panel
    tools.add("53.35 N 6.26 W")
    assert len(tools.points) == 2 and any("north" in m.text or "km" in m.text for m in window.session.messages.shown)


def test_a_typed_place(window):
    terrain = window.session.terrain
    x, y = (float(v) for v in terrain.grid.xy(*FIRST))
    from orograph.measuring import Places

    ((lon, lat),) = Places(terrain).lonlat(np.array([[x, y]]))
    degrees = [f"{lat:.7f}° N  {lon:.7f}° E", f"{lat:.7f} n, {lon:.7f} e", f"{lon:.7f}E {lat:.7f}N"]
    metres = [f"{x} {y}", f"{x},{y}", f"E {x:,.1f}   N {y:,.1f}".replace(",", " ")]
    for text in (*degrees, f"{-lat:.7f} S {-lon:.7f} W", *metres):
        assert place_of(text, terrain) == pytest.approx((x, y), abs=0.06), text
    for text in ("", "Dublin", "1 2 3", "53 N 6 N", "0 0"):
        with pytest.raises(UsageError):
            place_of(text, terrain)
    window.tools.active, window.tools.kind = True, "pick"
    window.tools.add(f"{x} {y}")
    assert window.tools.points == [pytest.approx((x, y, 500.0), abs=0.1)]


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


def test_a_range_that_reaches_the_end_of_a_plot_is_open(window):
    assert opened((0.9, 0.9355), (0.48, 0.9355)) == (0.9, math.inf)
    assert opened((np.float32(0.9), np.float32(0.93548387)), (0.48, 0.93548387)) == (pytest.approx(0.9), math.inf)
    assert opened((0.0, 0.6), (0.48, 0.9355)) == (-math.inf, 0.6)
    assert opened((0.95, 0.95), (0.48, 0.9355)) == (0.95, math.inf)
    assert [told(r, "m") for r in ((0.9, math.inf), (-math.inf, 2), (2, 3.5), (-math.inf, math.inf))] == [
        "0.9 m or more", "2 m or less", "2 to 3.5 m", "any",
    ]  # fmt: skip
    # A peak between the plot's places is selected with all that is high.
    rows, cols = window.session.terrain.grid.shape
    values = np.zeros((rows, cols), np.float32)
    values[:, :128], values[71, 71] = 1.0, 5.0
    give(window, Dataset(values, name="load", unit="t"))
    terrain, shown = window.session.terrain, window.session.settings.shown
    ends = float(np.nanmin(window.brush.ground(terrain, shown).values["load"])), 1.0
    plot.select(window, ranges={"load": opened((0.5, 1.0), ends)})
    x, y = terrain.grid.xy(np.array([71.0]), np.array([71.0]))
    veil = window.session.settings.veil
    import rasterio

    with rasterio.open(veil.path) as file:
        row, col = file.index(x[0], y[0])
        assert file.read(4)[row, col] == 0
    assert window.brush.units(terrain, shown) == {"Height": "m", "load": "t", "± load": "t"}


def test_a_limit_has_the_unit_of_the_data(window):
    data, _ = members(window, True)
    give(window, data)
    shown = window.session.settings.shown
    assert shown.exceeding.unit == "K"
    shown.exceeds = 1.0
    window.session.settings.show(window.session.terrain)
    assert shown.exceeding.unit == "" and shown.exceeding.field.limit_unit == "K"
