"""What is typed and clicked into panels: quickly, wrongly, too much; and what the window says to it."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

from imgui_bundle import imgui

from orograph.cli.measure import command
from orograph.scene.contours import Contours
from orograph.viewer.navigation import heading_pitch

PLAIN = 500.0


def place_of(hand, monkeypatch, label: str) -> tuple[float, float]:
    """Where a slider is: the middle of its rectangle, logical pixels."""
    found: list[tuple[float, float]] = []
    slider = imgui.slider_float

    def told(name, *args):
        out = slider(name, *args)
        if name == label:
            low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
            found.append((low.x + 0.3 * (high.x - low.x), (low.y + high.y) / 2))
        return out

    monkeypatch.setattr(imgui, "slider_float", told)
    hand.frames(1)
    monkeypatch.setattr(imgui, "slider_float", slider)
    return found[-1]


def test_nothing_is_hovered_when_the_pointer_has_left(window, hand, monkeypatch):
    """Neither lit nor explained; but a drag goes on outside."""
    window.session.settings.sun.mode = "placed"
    x, y = place_of(hand, monkeypatch, "azimuth")
    hand.move(x, y)
    hand.frames(3)
    assert imgui.is_mouse_pos_valid()
    hand.event("pointer_leave")
    hand.frames(3)
    assert not imgui.is_mouse_pos_valid()
    hand.press(x, y)
    hand.frames(2)
    before = window.session.settings.sun.azimuth
    hand.event("pointer_leave")
    hand.frames(2)
    assert window.session.settings.sun.azimuth == before
    hand.release(x, y)
    hand.frames(2)


@pytest.mark.stress
def test_ctrl_and_a_quick_click_type_into_a_slider(window, hand, monkeypatch):
    """Ctrl may be let go before a frame was drawn: it was down when the button was."""
    window.session.settings.sun.mode = "placed"
    hand.rest()
    x, y = place_of(hand, monkeypatch, "azimuth")
    before = window.session.settings.sun.azimuth
    hand.event("key_down", key="Control", modifiers=("Control",))
    hand.press(x, y, modifiers=("Control",))
    hand.release(x, y)
    hand.event("key_up", key="Control")
    hand.frames(8)
    assert window.session.settings.sun.azimuth == before  # it was not dragged there
    assert window.gui.typing
    for digit in "123":
        hand.event("char", data=digit)
    hand.key("Tab")  # to the next field
    hand.frames(4)
    assert window.session.settings.sun.azimuth == 123.0
    for digit in "30":
        hand.event("char", data=digit)
    hand.key("Enter")
    hand.frames(4)
    assert window.session.settings.sun.altitude == 30.0 and window.session.settings.panels


@pytest.mark.stress
def test_what_is_typed_at_once_into_a_field_is_no_command(window, hand):
    """Keys come before a frame was drawn that could tell that the field has the keyboard."""
    hand.rest()
    imgui.set_window_focus("Layers")
    hand.frames(4)
    layers = imgui.internal.find_window_by_name("Layers")
    wireframe, view = window.session.settings.wireframe, window.session.view
    hand.press(layers.pos.x + 40, layers.pos.y + 100)  # "any cmap name"
    hand.release(layers.pos.x + 40, layers.pos.y + 100)
    for letter in "x1.t":
        hand.event("key_down", key=letter)
        hand.event("char", data=letter)
        hand.event("key_up", key=letter)
    hand.frames(12)
    assert window.gui.typing
    assert window.texts["colormap"] == "x1.t"
    assert window.session.settings.wireframe == wireframe
    assert window.session.view == view and not window.session.messages.shown
    hand.key("Escape")
    hand.frames(4)
    hand.key("x")  # over the ground again
    assert window.session.settings.wireframe != wireframe


@pytest.mark.stress
@pytest.mark.parametrize("typed", [0.0, -1e30, math.inf])
def test_whatever_is_typed_the_window_goes_on(window, hand, monkeypatch, caplog, typed):
    """Every field of every panel is told a number that no slider has; those that clamp, clamp."""
    settings, touring = window.session.settings, window.touring
    settings.contours, settings.relief, settings.water = Contours(50.0), 1.0, 500.0
    settings.budget, settings.sun.mode = 50_000, "moment"
    hand.key("k")
    window.session.nav.view = window.session.nav.home
    hand.key("k")
    touring.chosen, touring.above_ground = 0, 50.0
    hand.key("m")
    window.tools.kind = "viewshed"

    def clamped(whole: bool, flags_at: int):
        def field(label, value, *args):
            low, high = args[0:2] if flags_at == 5 else args[1:3]
            flags = args[flags_at - 2] if len(args) > flags_at - 2 else 0
            out = min(max(typed, low), high) if flags & imgui.SliderFlags_.always_clamp.value else typed
            if whole:
                out = int(min(max(out, -(2**31)), 2**31 - 1))
            return True, out

        return field

    monkeypatch.setattr(imgui, "slider_float", clamped(False, 5))
    monkeypatch.setattr(imgui, "slider_int", clamped(True, 5))
    monkeypatch.setattr(imgui, "drag_float", clamped(False, 6))
    monkeypatch.setattr(imgui, "input_int", lambda *a: (True, int(min(max(typed, -(2**31)), 2**31 - 1))))
    for mode in ("moment", "placed"):
        settings.sun.mode = mode
        for name in ("Camera", "Light", "Layers", "Detail", "Tour", "Statistics"):
            imgui.set_window_focus(name)
            hand.frames(2)
    monkeypatch.undo()
    hand.frames(3)
    assert not [r.getMessage() for r in caplog.records if r.levelname == "ERROR"]  # rendercanvas logs what frames raise
    assert math.isfinite(settings.sun.azimuth) and -90 <= settings.sun.altitude <= 90
    assert 0 < settings.exaggeration <= 100
    assert np.isfinite(window.session.view.eye).all()
    said = [m.text for m in window.session.messages.shown if m.error]
    assert not said, said


def test_a_home_that_nobody_knows_is_told(window, hand):
    """``~name`` of nobody, in the field of a layer and in that of a tour."""
    from orograph.viewer.panels import layers

    assert not layers.add(window, "~nobody-of-that-name/x.tif")
    assert "nobody-of-that-name" in window.session.messages.shown[-1].text
    hand.key("k")
    window.texts["tour"] = "~nobody-of-that-name/tour.json"
    imgui.set_window_focus("Tour")
    hand.frames(3)


@pytest.mark.stress
def test_messages_lie_before_the_tool_and_within_the_window(window, hand):
    hand.key("m")
    hand.frames(3)
    for size in ((900, 600), (420, 400)):
        window.canvas.set_logical_size(*size)
        window.session.messages.say("Saved a profile in a folder with a name that is rather long, as they are.")
        hand.frames(6)
        newest = f"##message{len(window.session.messages.shown) - 1}"
        tool, said = (imgui.internal.find_window_by_name(name) for name in ("Measure", newest))
        order = imgui.internal.find_window_display_index
        assert order(said) > order(tool)
        assert said.pos.y > tool.pos.y + tool.size.y  # nor does it hide what the tool tells
        assert said.pos.y + said.size.y <= size[1]


@pytest.mark.parametrize("factor", [3.0, 0.4])
def test_exaggeration_keeps_what_is_looked_at(window, hand, factor):
    session = window.session
    session.nav.go_to((EAST + 3000.0, NORTH - 5000.0, PLAIN), 3.0)
    hand.still()
    point = session.nav.centre()
    before = heading_pitch(session.view, 1.0)
    far = math.dist(session.view.eye, point)
    session.stretch(factor)
    view = session.view
    assert view.project(np.array(point), factor)[0] == pytest.approx((view.width / 2, view.height / 2), abs=0.5)
    assert heading_pitch(view, factor) == pytest.approx(before, abs=1e-6)
    assert math.dist(np.array(view.eye) * [1, 1, factor], np.array(point) * [1, 1, factor]) == pytest.approx(far)


EAST, NORTH = 412_000.0, 4_987_000.0


def test_an_area_is_saved_as_what_measure_takes(window, hand, dem, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tools = window.tools
    hand.key("m")
    tools.choose("area")
    for x, y in ((200, 380), (420, 390), (300, 320)):
        hand.click(x, y)
    hand.until(lambda: tools.result is not None)
    line = tools._line()
    assert len(line) > 100 and np.allclose(line[0], line[-1])  # draped over the ground, closed
    assert line[:, 2] == pytest.approx(PLAIN, abs=1.0)
    tools.save()
    (path,) = tmp_path.glob("*.geojson")
    told = json.loads(path.read_text())
    assert told["properties"]["surface_m2"] == tools.result.surface
    ring = np.array(told["geometry"]["coordinates"][0])
    assert (ring[0] == ring[-1]).all()
    x, y = ring.T
    assert (x[:-1] * y[1:] - x[1:] * y[:-1]).sum() > 0  # counter-clockwise
    done = CliRunner().invoke(command, ["area", str(dem), "--geojson", str(path), "--json"], obj={"quiet": True})
    assert done.exit_code == 0, done.output
    assert json.loads(done.output)["surface_m2"] == pytest.approx(tools.result.surface, rel=1e-9)


@pytest.mark.stress
def test_the_tool_follows_the_terrain_until_it_is_moved(window, hand):
    hand.key("m")
    hand.frames(3)
    place = lambda: (found := imgui.internal.find_window_by_name("Measure").pos) and (found.x, found.y)  # noqa: E731
    first = place()
    hand.key("p")  # the plan takes half of the window
    hand.frames(4)
    assert place()[0] > first[0] + 50
    hand.key("p")
    hand.frames(4)
    x, y = place()
    hand.press(x + 100, y + 8)  # by its title
    hand.frames(3)
    hand.move(x + 140, y + 420)
    hand.frames(3)
    hand.release(x + 140, y + 420)
    hand.frames(3)
    assert place() == pytest.approx((x + 40, y + 412), abs=2)  # beside the places to dock at
    window.canvas.set_logical_size(500, 300)
    hand.frames(5)
    tool = imgui.internal.find_window_by_name("Measure")
    assert tool.pos.x + tool.size.x <= 500 and tool.pos.y + tool.size.y <= 300


@pytest.mark.stress
def test_what_is_under_a_resting_pointer_is_told_when_the_camera_moves(window, hand):
    hand.rest()
    hand.move(300, 430)
    hand.until(lambda: window.session.probe.hit is not None)
    before = window.session.probe.hit
    hand.key("o")
    hand.key("+")
    hand.key("]")
    hand.still()
    view, (x, y) = window.session.view, window.pointer

    def told() -> bool:
        hit = window.session.probe.hit
        return (
            hit is not None
            and abs(view.project(np.array([hit.easting, hit.northing, hit.height]))[0] - (x, y)).max() < 0.5
        )

    hand.until(told)
    assert window.session.probe.hit != before


def test_the_scale_is_known_near_the_ground(window, hand, monkeypatch):
    """Where the coarse ground lies above the eye."""
    probe = window.session.probe
    monkeypatch.setattr(probe, "pick_coarse", lambda *a: None)
    eye, target = (EAST + 3000.0, NORTH - 5000.0, PLAIN + 2.0), (EAST + 3000.0, NORTH - 4990.0, PLAIN)
    view = replace(window.session.view, eye=eye, target=target)
    found = probe.pick_about(view, view.width / 2, view.height / 2)
    assert found is not None and found[2] == pytest.approx(PLAIN, abs=1.0)
    assert view.project(np.array(found))[0] == pytest.approx((view.width / 2, view.height / 2), abs=0.1)
