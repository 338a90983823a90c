"""The window on an off-screen canvas: real renderer, real panels, events as ``rendercanvas`` gives them."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from affine import Affine

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

from hand import Hand, ground_pixel
from imgui_bundle import imgui
from rendercanvas.offscreen import RenderCanvas

from orograph.errors import StoreError
from orograph.store.prepare import prepare
from orograph.viewer.app import renderer_of
from orograph.viewer.keys import bindings, help_rows
from orograph.viewer.navigation import heading_pitch
from orograph.viewer.session import Session
from orograph.viewer.window import Window

PLAIN = 500.0


@pytest.mark.stress
def test_it_draws_and_then_rests(window, hand):
    hand.rest()
    picture = hand.frames(2)
    assert picture.shape == (600, 900, 3)
    terrain = picture[:, : int(window.area[2])]
    assert terrain.std() > 15
    drawn = window.drawing.drawn
    again = hand.frames(5)
    assert window.drawing.drawn == drawn  # nothing changed: the terrain is not drawn again
    assert np.array_equal(again, picture)


def test_home_shows_all_of_the_terrain_in_what_panels_leave(window, hand):
    view = window.session.view
    assert (view.width, view.height) == tuple(round(v) for v in window.area[2:])
    assert view.width < 900
    west, south, east, north = window.session.terrain.grid.bounds()
    corners = [(x, y, PLAIN) for x in (west, east) for y in (south, north)]
    pixels, _ = view.project(corners)
    assert ((pixels > -5) & (pixels < np.array([view.width, view.height]) + 5)).all()
    hand.key("Tab")
    hand.frames(2)
    assert window.session.view.width == 900


def test_a_drag_over_a_panel_is_the_panels(window, hand):
    before = window.session.view
    hand.press(800, 300)  # a move and a press in one batch, over the light panel
    hand.move(820, 320)
    hand.frames(2)
    hand.release(820, 320)
    hand.frames(2)
    assert window.session.view == before
    hand.press(200, 400)
    hand.move(260, 400)
    hand.frames(1)
    hand.release(260, 400)
    assert window.session.view != before


def test_a_drag_that_ends_over_a_panel_goes_on(window, hand):
    place = ground_pixel(window, 300, 420)
    hand.press(300, 420)
    hand.frames(1)
    for x in (400, 600, 850):
        hand.move(x, 420)
        hand.frames(1)
    pixel = window.session.view.project(place)[0]
    assert window.to_canvas(*pixel) == pytest.approx((850, 420), abs=1e-6)
    hand.release(850, 420)


def test_hovering_reads_the_height(window, hand):
    hand.move(300, 430)
    hand.until(lambda: window.session.probe.hit is not None)
    hit = window.session.probe.hit
    assert hit.height == pytest.approx(PLAIN, abs=0.01)
    assert (hit.easting, hit.northing) == pytest.approx(tuple(ground_pixel(window, 300, 430)[:2]), abs=0.01)


@pytest.mark.stress
def test_views_in_the_clipboard(window, hand):
    hand.key("o")
    hand.rest()
    kept = window.session.view
    hand.key("c", "Control")
    hand.key("t")
    hand.rest()
    hand.key("v", "Control")
    hand.rest()
    assert window.session.view.eye == pytest.approx(kept.eye, abs=1e-6)
    window.clipboard[1]("no view at all")
    hand.key("v", "Control")
    assert "no view" in window.session.messages.shown[-1].text
    window.clipboard[1]('{"eye": [15.0, 45.0, 2000.0], "target": [15.01, 45.0, 500.0], "crs": "EPSG:4326"}')
    hand.key("v", "Control")
    hand.rest()
    assert 100_000 < window.session.view.eye[0] < 900_000


@pytest.mark.stress
def test_what_fails_is_said_and_survived(window, hand, monkeypatch):
    hand.rest()
    before = hand.frames(1)
    draw = window.drawing.renderer.draw

    def fail(*args, **kwargs):
        raise StoreError("The chunk c/0/0 is gone.", path="area.oro")

    monkeypatch.setattr(window.drawing.renderer, "draw", fail)
    hand.key("o")
    hand.frames(3)
    texts = [m.text for m in window.session.messages.shown if m.error]
    assert any("area.oro: The chunk c/0/0 is gone." in t for t in texts)
    after = hand.frames(1)
    corner = np.s_[300:500, 20:300]
    assert np.abs(after[corner].astype(int) - before[corner]).mean() < 40  # the last picture stays
    monkeypatch.setattr(window.drawing.renderer, "draw", draw)
    hand.key("t")
    hand.rest()
    assert not [m for m in window.session.messages.shown if m.error]


@pytest.mark.stress
def test_a_lost_device_is_opened_anew(window, hand, monkeypatch):
    hand.rest()
    first, renderer = window.device, window.drawing.renderer

    def lost(*args, **kwargs):
        raise RuntimeError("Validation Error: Parent device is lost")

    monkeypatch.setattr(renderer, "draw", lost)
    hand.key("o")
    hand.rest()
    assert window.device is not first
    assert window.drawing.renderer is not renderer
    assert any("new device" in m.text for m in window.session.messages.shown)
    assert hand.frames(2)[:, : int(window.area[2])].std() > 15
    first.lost = None


@pytest.mark.stress
@pytest.mark.parametrize("when", ["drawing", "at rest", "twice"])
def test_a_device_that_is_really_lost_is_opened_anew(dem, monkeypatch, when):
    from orograph.gpu import device as devices

    monkeypatch.setattr(devices, "_OPEN", {})
    session = Session(prepare([str(dem)]), size=(640, 480), tolerance=4.0)
    window = Window(session, RenderCanvas(size=(900, 600)), renderer_of(64 << 20))
    hand = Hand(window)
    hand.rest()
    hand.until(lambda: window.plan.view is not None and not window.plan.busy, 120)
    hand.frames(2)
    before = hand.frames(1)
    for _ in range(2 if when == "twice" else 1):
        first = window.device
        first.handle.destroy()
        if when == "at rest":
            hand.move(300, 300)
        else:
            hand.key("n")
        hand.until(lambda lost=first: window.device is not lost)
        assert any("new device" in m.text for m in session.messages.shown)
        session.messages.shown.clear()
        hand.move(-5, -5)
        hand.until(lambda: window.plan.view is not None and not window.plan.busy, 120)
        hand.rest()
        after = hand.frames(3)
        assert np.abs(after.astype(int) - before).mean() < 3  # panels, their letters, the plan and the ground
        assert not [m.text for m in session.messages.shown if m.error]
    window.canvas.close()
    window.gui.close()


@pytest.mark.stress
def test_panels_go_on_while_the_renderer_is_made_on_a_new_device(dem, monkeypatch):
    from orograph.gpu import device as devices

    monkeypatch.setattr(devices, "_OPEN", {})
    held, made = threading.Event(), []
    plain = renderer_of(64 << 20)

    def make(device, terrain):
        if made:
            assert held.wait(120)
        made.append(device)
        return plain(device, terrain)

    session = Session(prepare([str(dem)]), size=(640, 480), tolerance=4.0)
    window = Window(session, RenderCanvas(size=(900, 600)), make)
    hand = Hand(window)
    hand.rest()
    first = window.device
    first.handle.destroy()
    hand.key("n")
    hand.until(lambda: window.device is not first)
    told = [m.text for m in session.messages.shown]
    shown = hand.frames(3)
    assert len(made) == 1 and window.drawing.coming and not window.drawing.done
    assert any("prepared for a new device" in text for text in told)
    panels = shown[:, int(window.area[0] + window.area[2]) + 2 :]
    assert panels.std() > 10 and np.median(shown[100:400, 50:300]) < 40  # panels are drawn, the ground is not yet
    held.set()
    hand.rest()
    assert len(made) == 2 and not window.drawing.coming
    ground = hand.frames(2)
    assert ground[:, : int(window.area[2])].std() > 15 and np.median(ground[100:400, 50:300]) > 60
    assert not any("prepared" in m.text for m in session.messages.shown)
    window.canvas.close()
    window.gui.close()


@pytest.mark.stress
def test_no_new_device_is_told_and_tried_again(dem, monkeypatch):
    from orograph.gpu import device as devices
    from orograph.viewer import drawing, reopening

    monkeypatch.setattr(devices, "_OPEN", {})
    monkeypatch.setattr(drawing, "RETRY", 0.05)
    session = Session(prepare([str(dem)]), size=(640, 480), tolerance=4.0)
    window = Window(session, RenderCanvas(size=(900, 600)), renderer_of(64 << 20))
    hand = Hand(window)
    hand.rest()
    opened, tried = reopening.open_device, []

    def none_at_first(adapter):
        tried.append(adapter)
        if len(tried) < 3:
            raise RuntimeError("There is no GPU.")
        return opened(adapter)

    monkeypatch.setattr(reopening, "open_device", none_at_first)
    first = window.device
    first.handle.destroy()
    hand.key("n")
    hand.until(lambda: len(tried) > 1)
    assert any("cannot be opened again: There is no GPU." in m.text for m in session.messages.shown)
    hand.until(lambda: window.device is not first)
    hand.rest()
    assert hand.frames(2)[:, : int(window.area[2])].std() > 15
    assert not [m.text for m in session.messages.shown if m.error]
    window.canvas.close()
    window.gui.close()


@pytest.mark.parametrize("size", [(300, 200), (1, 1), (80, 900)])
def test_any_size(window, hand, size):
    window.canvas.set_logical_size(*size)
    assert hand.frames(4).shape[:2] == size[::-1]
    window.canvas.set_logical_size(700, 500)
    hand.frames(4)
    assert window.session.view.height == 500


def test_a_new_size_is_drawn_at_once(window, hand, monkeypatch):
    hand.rest()
    asked = []
    monkeypatch.setattr(window.canvas, "request_draw", lambda *_: asked.append(True))
    window.canvas._size_info.set_physical_size(700, 500, 1.0)
    window.canvas._process_events()
    assert asked
    hand.frames(2)
    assert window.session.view.height == 500


def test_the_help_fits_a_small_window(window, hand):
    window.canvas.set_logical_size(360, 240)
    hand.key("F1")
    hand.frames(4)
    shown = imgui.internal.find_window_by_name("##help")
    assert shown.pos.x >= 0 and shown.pos.y >= 0
    assert shown.pos.x + shown.size.x <= 360 and shown.pos.y + shown.size.y <= 240
    assert shown.scroll_max.y > 0  # the rest is scrolled to


@pytest.mark.stress
def test_panels_that_are_hidden_from_the_first_leave_the_picture_alone_and_dock_when_they_come(
    device, dem, own_config, monkeypatch
):
    own_config.mkdir(parents=True)
    (own_config / "layout.ini").write_text("[Docking][Data]\nDockSpace ID=0x06092A11 Pos=0,0 Size=0,0 CentralNode=1\n")
    session = Session(prepare([str(dem)]), size=(640, 480), tolerance=4.0)
    session.settings.panels = False
    window = Window(session, RenderCanvas(size=(900, 600)), renderer_of(64 << 20), device=device)
    hand = Hand(window)
    hand.rest()
    shown, terrain = hand.frames(2)[300:320, 440:460], window.drawing.screen.pixels()[300:320, 440:460]
    assert np.abs(shown.astype(int) - terrain).max() <= 2  # nothing lies over it
    hand.key("Tab")
    hand.frames(6)
    assert window.area[2] < 700  # they are docked, not strewn over the picture
    window.canvas.close()
    window.gui.close()


def test_tab_shows_panels_and_gives_no_field_the_keyboard(device, dem, own_config):
    """ImGui takes a key a frame: Tab may come to it when the panels are there already."""
    session = Session(prepare([str(dem)]), size=(640, 480), tolerance=4.0)
    session.settings.panels = False
    window = Window(session, RenderCanvas(size=(900, 600)), renderer_of(64 << 20), device=device)
    hand = Hand(window)
    hand.rest()
    for _ in range(3):
        for kind, held in (("key_down", ("Control",)), ("key_up", ())):
            for name in ("Control", "c"):
                hand.event(kind, key=name, modifiers=held)
    hand.key("Tab")
    hand.frames(20)
    assert session.settings.panels
    assert not window.gui.typing
    window.canvas.close()
    window.gui.close()


def test_every_key_does_something_and_is_in_the_help(window, hand):
    said = dict(help_rows())
    for b in bindings():
        assert said[b.label]
        if b.key in ("q", "F12"):
            continue
        hand.key(b.key, *(("Control",) if b.control else ()))
        hand.frames(1)
    hand.key("Escape")
    assert window.session.settings.sun.playing
    hand.key(" ")
    hand.still()
    assert not [m.text for m in window.session.messages.shown if m.error]


@pytest.mark.stress
def test_a_key_that_waits_for_a_frame_may_close_the_window(window, hand, monkeypatch, capsys):
    """Keys that follow a press on a panel are decided some frames later, the last of which has nothing to draw on."""
    hand.rest()
    composed: list[int] = []
    monkeypatch.setattr(window, "compose", lambda *args: composed.append(1))
    hand.press(800, 300)
    hand.event("key_down", key="q", modifiers=("Control",))
    window.canvas._process_events()
    assert not window.canvas.get_closed()
    frames = 0
    while not window.canvas.get_closed():
        window._frame()
        frames += 1
        assert frames < 10
    assert len(composed) == frames - 1
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.stress
def test_keys_that_are_held_fly(window, hand):
    before = window.session.view
    hand.event("key_down", key="w")
    for _ in range(6):
        hand.frames(1)
        time.sleep(0.02)
    hand.event("key_up", key="w")
    hand.rest()
    moved = np.subtract(window.session.view.eye, before.eye)
    assert moved @ before.axes()[2] > 0
    assert heading_pitch(window.session.view) == pytest.approx(heading_pitch(before), abs=1e-6)


def test_a_terrain_that_says_not_where_it_is(device):
    """No CRS, rectangular cells, a hole: what depends on a place says so, the rest works."""

    from orograph.dem import Dem
    from orograph.geo import Grid
    from orograph.store import terrain as in_memory

    z = np.add.outer(np.arange(40.0), np.arange(60.0)).astype(np.float32)
    z[10:20, 10:20] = np.nan
    terrain = in_memory(Dem(z, Grid((40, 60), Affine(2, 0, 0, 0, -3, 0)), name="nowhere"))
    canvas = RenderCanvas(size=(700, 500))
    window = Window(Session(terrain, size=(400, 500)), canvas, renderer_of(64 << 20), device=device)
    hand = Hand(window)
    hand.frames(4)
    hand.key(" ")
    assert "where on Earth" in window.session.messages.shown[-1].text
    assert not window.session.settings.sun.playing
    hand.key("t")
    hand.still()
    hand.move(200, 250)
    hand.until(lambda: window.session.probe.hit is not None)
    assert window.session.probe.hit.longitude is None
    assert not [m.text for m in window.session.messages.shown if m.error]
    canvas.close()
    window.gui.close()
