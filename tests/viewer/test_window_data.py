"""Data in the window, on an off-screen canvas: what stands, switches, what the pointer finds; and as traits."""

from __future__ import annotations

import time

import numpy as np
import pytest
import traitlets

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

import orograph
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.priority import Priority
from orograph.rendering.standing import stand
from orograph.viewer import overlay
from orograph.viewer.commands import change_data, step_data
from orograph.viewer.data import ShownData
from orograph.viewer.panels import data as panel
from orograph.viewer.panels import plot

EAST, NORTH = 412_000.0, 4_987_000.0


def give(window, *data, priority="T+D+U-"):
    """Data to a window that is open."""
    settings = window.session.settings
    settings.shown = ShownData(data, Priority.parse(priority))
    settings.show(window.session.terrain)
    window.touch()


def painted(window):
    """Until the thread has painted what was chosen."""
    while window.session.settings.finer.coming:
        panel.finish(window)
        time.sleep(0.01)


def bar(window):
    """Something large that stands in the middle of the ground that is seen, and the pixel of its middle."""
    at = window.session.nav.centre()
    points = {"x": [float(at[0])], "y": [float(at[1])], "load": [7.0]}
    return Dataset(points, variable="load", style="bars", size=600.0, range=(0, 7)), (float(at[0]), float(at[1]))


@pytest.mark.stress
def test_what_stands_is_seen_and_told(window, hand):
    hand.rest()
    bare = hand.frames(1).astype(int)
    data, (x, y) = bar(window)
    give(window, data)
    hand.rest()
    shown = hand.frames(1).astype(int)
    session = window.session
    (u, v), _ = session.view.project(np.array([x, y, 500.0 + 300.0]), session.settings.exaggeration)
    px, py = window.to_canvas(float(u), float(v))
    assert np.abs(shown - bare)[int(py), int(px)].max() > 30
    hand.move(px, py)
    hand.until(lambda: session.probe.hit is not None)
    (found, *_) = window.found()
    assert (found.name, found.value) == ("load", 7.0)
    # The same pixels as in a picture over the same ground.
    scene = session.scene()
    ground = window.drawing.renderer
    again = stand(session.settings.shown.things, window.drawing.screen.pixels(), ground.depth(), scene)
    np.testing.assert_array_equal(again.which, window.drawing.stood.which)


@pytest.mark.stress
def test_colour_bars_of_data_stand_over_that_of_heights(window, hand, monkeypatch):
    drawn = []
    monkeypatch.setattr(overlay, "_bar", lambda *about: drawn.append((about[2], about[-1])))
    monkeypatch.setattr(window.cover, "hides", lambda: False)
    hand.frames(1)
    assert [title for _, title in drawn] == ["m"]
    give(window, bar(window)[0].but(unit="t"))
    hand.rest()
    drawn.clear()
    hand.frames(1)
    (below, heights), *above = drawn
    assert heights == "m" and len(above) < 2 and all(low < below and title == "load (t)" for low, title in above)
    monkeypatch.setattr(window.cover, "hides", lambda: True)
    drawn.clear()
    hand.frames(1)
    assert [title for _, title in drawn] == ["load (t)"]


@pytest.mark.stress
def test_switches_change_the_picture_and_the_pointer_finds_values(window, hand):
    rows, cols = window.session.terrain.grid.shape
    members = np.random.default_rng(0).normal(np.linspace(0, 9, cols), 0.5, (6, rows, cols)).astype(np.float32)
    give(window, Dataset(members, band="all", uncertainty="spread", name="warmth", unit="K"))
    hand.rest()
    before = hand.frames(1).astype(int)
    hand.move(300, 330)
    hand.until(lambda: window.found())
    (found,) = window.found()
    hit = window.session.probe.hit
    col, _ = window.session.terrain.grid.index(hit.easting, hit.northing)
    assert found.name == "warmth" and found.unit == "K"
    assert found.value == pytest.approx(9 * float(col) / (cols - 1), abs=1.0)
    assert 0.05 < found.sigma < 1.2
    assert "warmth" in found.words and "±" in found.words
    shown = window.session.settings.shown
    old = shown.painted[0]
    change_data(window, priority=Priority.parse("T-D-U+"))  # a thread paints it, coarsely and finely; frames take that
    assert shown.painted[0] is old
    hand.until(lambda: shown.painted[0] is not old, 300)
    coarse = shown.painted[0]
    assert coarse.sign == "glyphs"
    hand.until(lambda: not window.session.settings.finer.coming, 300)
    assert max(shown.painted[0].over.shape) > max(coarse.over.shape)
    hand.rest()
    assert np.abs(hand.frames(1).astype(int) - before).mean() > 3
    change_data(window, time="1999")
    assert any("no time" in message.text for message in window.session.messages.shown)


def series(window):
    """A series of three times whose values are 0, 10 and 20 everywhere."""
    xr = pytest.importorskip("xarray")
    grid = window.session.terrain.grid
    x, _ = grid.xy(np.arange(grid.cols), np.zeros(grid.cols))
    _, y = grid.xy(np.zeros(grid.rows), np.arange(grid.rows))
    when = np.array(["2020-01-01T00", "2020-01-01T12", "2020-01-02T00"], "M8[ns]")
    cube = np.array([0.0, 10.0, 20.0])[:, None, None] + np.zeros((1, grid.rows, grid.cols))
    about = {"crs": grid.crs.to_wkt()} if grid.crs is not None else {}
    return Dataset(xr.DataArray(cube, coords={"time": when, "y": y, "x": x}, dims=("time", "y", "x"), attrs=about))


@pytest.mark.stress
def test_time_goes_step_by_step_between_and_by_itself(window, hand):
    settings = window.session.settings
    settings.shown = ShownData((series(window),), Priority.parse("T+D+U-"), window.session.terrain.grid)
    settings.show(window.session.terrain)
    shown = settings.shown
    x, y = (float(v) for v in window.session.nav.centre()[:2])

    def value():
        painted(window)
        return shown.at(x, y)[0].value

    step_data(window, 1)
    assert shown.time == "2020-01-01T00:00" and value() == pytest.approx(0)
    step_data(window, 1)
    assert shown.time == "2020-01-01T12:00" and value() == pytest.approx(10)
    step_data(window, -1)
    step_data(window, -1)  # there is none before
    assert shown.time == "2020-01-01T00:00"
    change_data(window, time=shown.at_part(0.25))
    assert value() == pytest.approx(5) and "linear between" in shown.time_text
    shown.playing = True
    assert panel.advance(window, panel.PLAYED)
    assert not panel.advance(window, panel.PLAYED)  # the thread reads and paints, and asks for a frame then
    part = 0.25 + panel.LONGEST / panel.PLAYED
    assert shown.part == pytest.approx(part, abs=1e-3) and value() == pytest.approx(20 * part, abs=0.05)
    hand.until(lambda: shown.part != pytest.approx(part, abs=1e-3))  # frames go on by themselves
    shown.playing = False
    assert not panel.advance(window, 1.0)
    hand.rest()


@pytest.mark.stress
def test_data_are_traits_of_a_cell(device, dem, monkeypatch):
    import sys
    import types

    from rendercanvas.offscreen import OffscreenRenderCanvas

    module = types.ModuleType("rendercanvas.anywidget")
    module.RenderCanvas = OffscreenRenderCanvas
    monkeypatch.setitem(sys.modules, "rendercanvas.anywidget", module)
    values = np.linspace(0, 1, 257 * 257, dtype=np.float32).reshape(257, 257)
    widget = orograph.view(str(dem), size=(240, 180), data=Dataset(values, name="part"), priority="T+D+U-")
    widget.canvas.draw()
    assert (widget.priority, widget.time) == ("T+D+U-", "")
    widget.priority = "T-D-U-"
    assert widget.priority == "T-D-U-" and widget.window.session.settings.light == "none"
    for name, wrong in (("priority", "X"), ("time", "1999"), ("found", ())):
        with pytest.raises(traitlets.TraitError):
            setattr(widget, name, wrong)
    assert widget.selection == {} and widget.times == ()
    widget.selection = {"ranges": {"part": (0.5, 1)}}
    assert widget.selection == {"ranges": {"part": (0.5, 1.0)}, "area": ()}
    assert widget.window.session.settings.veil is not None
    for wrong in ({"ranges": {"part": (1, 0)}}, {"rows": 3}, {"area": [(1, 2)]}):
        with pytest.raises(traitlets.TraitError):
            widget.selection = wrong
    plot.select(widget.window, ranges={}, area=())  # as the panel does
    widget.canvas.draw()
    assert widget.selection == {} and widget.window.session.settings.veil is None
    widget.window.session.settings.show(widget.window.session.terrain, priority=Priority.parse("T+D-U+"))
    widget.canvas.draw()
    assert widget.priority == "T+D-U+"
    widget.close()
    widget.window.gui.close()
    bare = orograph.view(str(dem), size=(120, 90))
    bare.canvas.draw()
    assert bare.priority == "" and bare.found == ()
    with pytest.raises(traitlets.TraitError, match="no data"):
        bare.priority = "T+D+U-"
    bare.close()
    bare.window.gui.close()


@pytest.mark.stress
def test_how_probably_values_are_above_one(window):
    rows, cols = window.session.terrain.grid.shape
    members = np.arange(4.0)[:, None, None] + np.linspace(0, 9, cols) + np.zeros((1, rows, 1))
    data = Dataset(members.astype(np.float32), band="all", uncertainty="spread", name="warmth", unit="K")
    settings = window.session.settings
    settings.shown = ShownData((data,), Priority.parse("T+D+U-"), window.session.terrain.grid)
    settings.show(window.session.terrain)
    shown, terrain = settings.shown, window.session.terrain
    assert list(window.brush.names(terrain, shown)) == ["Height", "warmth", "± warmth"]
    panel.exceed(window, 6.0)
    painted(window)
    x, y = (float(v[0]) for v in terrain.grid.xy(np.array([(cols - 1) / 2]), np.array([(rows - 1) / 2])))
    (found,) = shown.at(x, y)
    assert found.name == "P(warmth > 6 K)" and found.value == pytest.approx(0.5, abs=0.01)  # 4.5, 5.5, 6.5, 7.5
    plot.select(window, ranges={found.name: (0.9, 1.0)})
    ground = window.brush.ground(terrain, shown)
    truth = np.abs(ground.x - ground.x.min()) / np.ptp(ground.x) * 9 > 6
    assert (window.brush.holds(ground) == truth).mean() > 0.95
    panel.exceed(window, None)
    painted(window)
    assert shown.at(x, y)[0].name == "warmth"
    panel.exceed(window, float("nan"))
    painted(window)
    assert shown.exceeds is None and any("to exceed must be a number" in m.text for m in window.session.messages.shown)
