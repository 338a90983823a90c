"""One selection of plots, ground and notebook, on an off-screen canvas and against plain counting."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

from orograph.errors import UsageError
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.priority import Priority
from orograph.viewer.brushing import HEIGHT, Brush, inside
from orograph.viewer.data import ShownData
from orograph.viewer.panels import plot


def give(window, *data):
    settings = window.session.settings
    settings.shown = ShownData(data, Priority.parse("T+D+U+"), window.session.terrain.grid)
    settings.show(window.session.terrain)
    window.touch()


def ramp(window):
    """Values from 0 in the west to 10 in the east."""
    rows, cols = window.session.terrain.grid.shape
    return Dataset(np.broadcast_to(np.linspace(0, 10, cols, dtype=np.float32), (rows, cols)).copy(), name="ramp")


def posts(window):
    """Four bars, two in the west and two in the east."""
    grid = window.session.terrain.grid
    x, y = grid.xy(np.array([0.1, 0.2, 0.8, 0.9]) * (grid.cols - 1), np.full(4, (grid.rows - 1) / 2))
    return Dataset({"x": x, "y": y, "load": [1.0, 2.0, 3.0, 4.0]}, variable="load", style="bars", name="load")


def test_places_within_a_polygon():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-2, 2, (2, 2000))
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [0.0, 0.0], [-1.0, 1.0]])
    truth = (np.abs(x) <= 1) & (y >= -1) & (y <= np.abs(x))
    np.testing.assert_array_equal(inside(x, y, corners), truth)


@pytest.mark.stress
def test_what_is_brushed_is_selected_on_the_ground_and_among_things(window, hand):
    give(window, ramp(window), posts(window))
    terrain, shown = window.session.terrain, window.session.settings.shown
    brush = window.brush
    assert brush.names(terrain, shown) == [HEIGHT, "ramp", "load"]
    assert brush.describe(terrain, shown) == "100 % of the ground, 4 of 4 things"
    hand.rest()
    before = hand.frames(1).astype(int)
    plot.select(window, ranges={"ramp": (5.0, 10.0)})
    hand.until(lambda: np.abs(hand.frames(1).astype(int) - before).mean() > 1)
    ground = brush.ground(terrain, shown)
    np.testing.assert_array_equal(brush.holds(ground), ground.values["ramp"] >= 5)
    assert "2 of 4 things" in brush.describe(terrain, shown)
    pale = brush.seen(terrain, shown)
    less = np.abs(pale.rgb - shown.things.rgb).max(1) > 0.05
    west = shown.things.x < np.median(ground.x)
    np.testing.assert_array_equal(less, west & (shown.things.shown >= 0))
    # A variable of things leaves the ground as it is; an area joins in.
    plot.select(window, ranges={"load": (1.5, 3.5)})
    assert window.session.settings.veil is None and "100 % of the ground, 2 of 4" in brush.describe(terrain, shown)
    left, right = ground.x.min() - 1, np.median(ground.x)
    low, high = ground.y.min() - 1, ground.y.max() + 1
    plot.select(window, area=[(left, low), (right, low), (right, high), (left, high)])
    np.testing.assert_array_equal(brush.holds(ground), ground.x < right)
    assert "1 of 4" in brush.describe(terrain, shown) and len(brush.places(terrain, shown)) == 1
    plot.select(window, ranges={}, area=())
    assert brush.empty and window.session.settings.veil is None
    hand.rest()


@pytest.mark.stress
def test_the_veil_hides_what_is_not_selected_texel_by_texel(window):
    give(window, ramp(window))
    plot.select(window, ranges={"ramp": (0.0, 2.5)})
    veil = window.session.settings.veil
    with rasterio.open(veil.path) as file:
        opaque = file.read(4) > 0
    assert (~opaque).mean() == pytest.approx(0.25, abs=0.02) and not opaque[0, 0] and opaque[0, -1]
    plot.select(window, ranges={"ramp": (-1.0, 99.0)})
    assert not window.brush.empty and window.session.settings.veil is None  # nothing is left to hide
    plot.select(window, ranges={"ramp": (0.0, 2.5)})
    # Other data are shown: the selection is made anew.
    give(window, Dataset(10 - np.asarray(ramp(window).source), name="ramp"))
    assert window.brush.stale(window.session.terrain, window.session.settings.shown)


@pytest.mark.stress
def test_dragging_over_a_histogram_selects(window, hand):
    give(window, ramp(window))
    window.gui.raised = ["Plot"]
    window.session.settings.panels = True
    window.touch()
    hand.until(lambda: window.plotted is not None)
    hand.frames(4)
    x, y, wide, tall = window.plotted.box
    assert window.plotted.names == ("ramp",)
    hand.press(x + 0.25 * wide, y + tall / 2)
    hand.frames(3)
    hand.move(x + 0.5 * wide, y + tall / 2)
    hand.frames(3)
    hand.release(x + 0.5 * wide, y + tall / 2)
    hand.until(lambda: not window.brush.empty)
    low, high = window.brush.ranges["ramp"]
    assert low == pytest.approx(2.5, abs=0.2) and high == pytest.approx(5.0, abs=0.2)
    window.texts["plot y"] = HEIGHT
    hand.frames(3)
    assert window.plotted.names == ("ramp", HEIGHT)
    hand.click(x + 0.25 * wide, y + tall / 2)  # a click lets the plot's variables go
    hand.until(lambda: window.brush.empty)


@pytest.mark.stress
def test_the_best_view_of_a_selection_is_flown_to(window, hand):
    give(window, posts(window))
    before = window.session.view
    window.finder.find()
    assert any("Nothing is selected" in one.text for one in window.session.messages.shown)
    plot.select(window, ranges={"load": (3.5, 4.0)})
    window.finder.find()
    hand.until(lambda: any("best view shows 100 %" in one.text for one in window.session.messages.shown))
    hand.frames(2)
    hand.still()
    view = window.session.view
    assert view != before
    x, y = window.brush.places(window.session.terrain, window.session.settings.shown)[0]
    (u, v), depth = view.project(np.array([x, y, 500.0]), window.session.settings.exaggeration)
    assert depth > 0 and abs(u - view.width / 2) < 30 and abs(v - view.height / 2) < 30


def test_a_stretched_terrain_looks_as_the_terrain_does_stretched(window):
    from orograph.touring.stretched import Stretched
    from orograph.viewpoint import View

    terrain = window.session.terrain
    made = Stretched(terrain, 3.0)
    np.testing.assert_array_equal(made.read(0, 2, 9, 3, 8), terrain.read(0, 2, 9, 3, 8) * np.float32(3))
    x, y = terrain.grid.xy(np.array([40.0, 90.0]), np.array([70.0, 20.0]))
    eye, target = (x[0] - 5000.0, y[0] - 7000.0, 4000.0), (x[0], y[0], 700.0)
    view = View(eye, target, fov_y=35.0, width=300, height=200)
    here = view.project(np.stack([x, y, np.array([600.0, 900.0])], 1), 1.0)[0]
    there = made.back(view).project(np.stack([x, y, np.array([200.0, 300.0])], 1), 3.0)[0]
    np.testing.assert_allclose(here, there, atol=1e-6)


@pytest.mark.parametrize(
    "wrong", [{"ranges": {"a": (2, 1)}}, {"ranges": {"a": ("x", 1)}}, {"area": [(1, 2)]}, {"area": [(1,), 2, 3]}]
)
def test_what_is_no_selection_is_refused(wrong):
    with pytest.raises(UsageError):
        Brush().choose(**wrong)


@pytest.mark.stress
def test_what_the_best_view_hides_is_told_and_marked(window, hand):
    """Around the hill: what is hidden lies behind its top, as seen from the camera, and only while that is there."""
    x, y = (float(v) for v in window.session.terrain.grid.xy(128.0, 50.0))
    half = 1200.0
    plot.select(window, area=[(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)])
    assert "of the ground within the measured area" in window.brush.describe(window.session.terrain, None)
    window.finder.find()
    hand.until(lambda: any("Dots on the plan" in one.text for one in window.session.messages.shown))
    hand.frames(2)
    hand.still()
    finder, eye = window.finder, window.session.view.eye
    assert finder.at_best and 0 < len(finder.hidden) < 0.5 * finder.looked_for
    behind = (finder.hidden - [x, y]) @ (np.array(eye[:2]) - [x, y])
    assert (behind < 0).all()
    window.session.nav.jump(window.session.view.resized(640, 480))
    hand.key("t")
    hand.still()
    assert not finder.at_best
