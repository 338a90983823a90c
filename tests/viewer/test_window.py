"""The window on an off-screen canvas: real renderer, real panels, events as ``rendercanvas`` gives them."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from affine import Affine

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

from imgui_bundle import imgui
from rendercanvas.offscreen import RenderCanvas

from orograph.errors import StoreError
from orograph.picture.contours import Contours
from orograph.picture.prepare import prepare
from orograph.viewer import panels
from orograph.viewer.app import renderer_of
from orograph.viewer.keys import bindings, help_rows
from orograph.viewer.navigation import heading_pitch
from orograph.viewer.panels import layers, statistics
from orograph.viewer.panels.detail import METHODS
from orograph.viewer.session import Session
from orograph.viewer.window import Window

PLAIN = 500.0


class Hand:
    """Moves the mouse and presses keys on a window, and lets it draw."""

    def __init__(self, window: Window) -> None:
        self.window = window

    def event(self, kind: str, **values) -> None:
        self.window.canvas.submit_event({"event_type": kind, "modifiers": (), "buttons": (), **values})

    def frames(self, n: int = 3) -> np.ndarray:
        for _ in range(n):
            self.window.canvas._process_events()  # what a loop would do
            out = self.window.canvas.draw()
        return np.asarray(out)[..., :3]

    def move(self, x, y) -> None:
        self.event("pointer_move", x=x, y=y, button=0)

    def press(self, x, y, button=1, modifiers=()) -> None:
        self.move(x, y)
        self.event("pointer_down", x=x, y=y, button=button, modifiers=modifiers)

    def release(self, x, y, button=1) -> None:
        self.event("pointer_up", x=x, y=y, button=button)

    def click(self, x, y) -> None:
        self.press(x, y)
        self.frames(1)
        self.release(x, y)
        self.frames(2)

    def key(self, name, *modifiers) -> None:
        self.event("key_down", key=name, modifiers=modifiers)
        self.event("key_up", key=name, modifiers=modifiers)
        self.frames(1)

    def until(self, what, seconds=60) -> None:
        end, frames = time.monotonic() + seconds, 0
        while not what():
            # A busy machine may stop this process for a while: it had its chance when it drew so many frames.
            assert time.monotonic() < end or frames < 200, "waited in vain"
            self.frames(1)
            frames += 1
            time.sleep(0.01)

    def still(self) -> None:
        """Until the camera stands."""
        self.until(lambda: not self.window.session.moving)

    def rest(self) -> None:
        """Until the camera stands and the picture is as good as it gets."""
        self.until(lambda: not self.window.session.moving and self.window.drawing.renderer.resting)


@pytest.fixture
def window(device, dem, monkeypatch) -> Iterator[Window]:
    monkeypatch.setattr("orograph.viewer.session.SHOWN", 600.0)  # a slow machine may take longer than a message stays
    session = Session(prepare([str(dem)]), size=(640, 480), tolerance=4.0)
    canvas = RenderCanvas(size=(900, 600))
    kept: list[str] = [""]
    window = Window(
        session,
        canvas,
        renderer_of(64 << 20),
        device=device,
        clipboard=(lambda: kept[0], lambda t: kept.__setitem__(0, t)),
    )
    yield window
    canvas.close()
    window.gui.close()


@pytest.fixture
def hand(window) -> Hand:
    hand = Hand(window)
    hand.frames(3)
    return hand


def ground_pixel(window, x, y):
    """Where canvas position (x, y) is on the plain, by the view's own rays."""
    px, py = window.to_picture(x, y)
    o0, _, _, d0, du, dv = window.session.view.ray_basis()
    d = d0 + px * du + py * dv
    return o0 + d * (PLAIN - o0[2]) / d[2]


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


@pytest.mark.parametrize("pause", [0, 1, 3])
def test_a_quick_click_on_a_tab_is_not_lost(window, hand, monkeypatch, pause):
    shown: list[str] = []
    told = [(n, lambda w, f=f, n=n: (shown.append(n), f(w)), p) for n, f, p in panels.PANELS]
    monkeypatch.setattr(panels, "PANELS", tuple(told))
    hand.rest()
    hand.frames(3)
    for name in ("Layers", "Tour", "Light", "Statistics"):
        inner = imgui.internal.find_window_by_name(name).dock_node
        tabs = {t.window.name: t for t in inner.tab_bar.tabs}
        bar, tab = inner.tab_bar.bar_rect, tabs[name]
        hand.move(bar.min.x + tab.offset + tab.width / 2, (bar.min.y + bar.max.y) / 2)
        if pause:
            hand.frames(pause)
        x, y = bar.min.x + tab.offset + tab.width / 2, (bar.min.y + bar.max.y) / 2
        hand.event("pointer_down", x=x, y=y, button=1)
        hand.event("pointer_up", x=x, y=y, button=1)
        hand.frames(6)
        shown.clear()
        hand.frames(1)
        assert name in shown
        hand.move(200, 300)
        hand.frames(2)


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


def test_measuring(window, hand):
    tools = window.tools
    hand.key("m")
    places = []
    for x, y in ((200, 330), (320, 350)):
        places.append(ground_pixel(window, x, y))
        hand.click(x, y)
    hand.until(lambda: tools.result is not None)
    assert tools.result.grid == pytest.approx(math.dist(*places), rel=1e-6)
    hand.frames(2)  # the plot
    tools.choose("area")
    hand.click(200, 330)
    hand.click(320, 350)
    hand.click(260, 280)
    hand.until(lambda: tools.result is not None)
    assert tools.result.mean_height == pytest.approx(PLAIN, abs=0.01)
    hand.key("Backspace")
    assert len(tools.points) == 2
    tools.choose("sight")
    hand.click(300, 330)
    hand.click(300, 350)
    hand.until(lambda: tools.result is not None)
    assert tools.result.visible
    hand.key("Escape")
    assert not tools.active
    assert not window.session.messages.shown


def test_a_viewshed_is_painted_and_goes_again(window, hand):
    tools = window.tools
    hand.key("m")
    tools.choose("viewshed")
    tools.radius = 3000.0
    hand.click(300, 330)
    hand.until(lambda: window.session.settings.painted is not None, 120)
    hand.rest()
    painted = hand.frames(1)
    hand.key("Escape")
    assert window.session.settings.painted is None
    hand.rest()
    assert np.abs(hand.frames(1).astype(int) - painted).max() > 40


def test_layers_by_hand(window, hand, tmp_path):
    settings = window.session.settings
    grid = window.session.terrain.grid
    paths = []
    for name, colour in (("red", (220, 20, 20)), ("blue", (20, 20, 220))):
        paths.append(tmp_path / f"{name}.tif")
        with rasterio.open(
            paths[-1], "w", "GTiff", 64, 64, 3, dtype="uint8", crs=grid.crs.to_wkt(),
            transform=grid.transform @ Affine.scale(grid.cols / 64, grid.rows / 64),
        ) as file:  # fmt: skip
            file.write(np.broadcast_to(np.array(colour, np.uint8)[:, None, None], (3, 64, 64)))

    def ground() -> np.ndarray:
        return hand.frames(1)[380:420, 280:320].reshape(-1, 3).mean(0)

    def until(reached) -> None:
        end = time.monotonic() + 60
        while not reached(ground()):
            assert time.monotonic() < end
            window.touch()

    settings.water = None  # level ground would be a lake
    assert layers.add(window, str(paths[0])) and layers.add(window, f"'{paths[1]}'")
    until(lambda c: c[2] > c[0] + 60)  # the last one lies above
    settings.layers = settings.layers[::-1]
    until(lambda c: c[0] > c[2] + 60)
    settings.layers = [settings.layers[0], replace(settings.layers[1], opacity=0.5)]
    until(lambda c: c[0] > 60 and c[2] > 60)
    settings.layers = [replace(layer, visible=False) for layer in settings.layers]
    until(lambda c: abs(c[0] - c[2]) < 60)
    assert not window.session.messages.shown
    assert not layers.add(window, str(tmp_path / "none.tif"))
    assert "none.tif" in window.session.messages.shown[-1].text
    far = tmp_path / "far.tif"
    with rasterio.open(far, "w", "GTiff", 4, 4, 3, dtype="uint8", crs=grid.crs.to_wkt(),
                       transform=Affine(30, 0, 0, 0, -30, 100)) as file:  # fmt: skip
        file.write(np.ones((3, 4, 4), np.uint8))
    assert not layers.add(window, str(far))
    assert "does not overlap" in window.session.messages.shown[-1].text
    words = tmp_path / "words.txt"
    words.write_text("no raster")
    assert not layers.add(window, str(words))
    assert "words.txt" in window.session.messages.shown[-1].text
    settings.layers = []
    hand.rest()


def test_hovering_reads_the_height(window, hand):
    hand.move(300, 430)
    hand.until(lambda: window.session.probe.hit is not None)
    hit = window.session.probe.hit
    assert hit.height == pytest.approx(PLAIN, abs=0.01)
    assert (hit.easting, hit.northing) == pytest.approx(tuple(ground_pixel(window, 300, 430)[:2]), abs=0.01)


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


@pytest.mark.parametrize("size", [(300, 200), (1, 1), (80, 900)])
def test_any_size(window, hand, size):
    window.canvas.set_logical_size(*size)
    assert hand.frames(4).shape[:2] == size[::-1]
    window.canvas.set_logical_size(700, 500)
    hand.frames(4)
    assert window.session.view.height == 500


def test_the_help_fits_a_small_window(window, hand):
    window.canvas.set_logical_size(360, 240)
    hand.key("F1")
    hand.frames(4)
    shown = imgui.internal.find_window_by_name("##help")
    assert shown.pos.x >= 0 and shown.pos.y >= 0
    assert shown.pos.x + shown.size.x <= 360 and shown.pos.y + shown.size.y <= 240
    assert shown.scroll_max.y > 0  # the rest is scrolled to


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


def test_every_key_does_something_and_is_in_the_help(window, hand):
    said = dict(help_rows())
    for b in bindings():
        assert said[b.label]
        if b.key in ("q", "F12"):
            continue
        hand.key(b.key, *(("Control",) if b.control else ()))
        hand.frames(1)
    hand.key("Escape")
    assert window.session.settings.light.playing
    hand.key(" ")
    hand.still()
    assert not [m.text for m in window.session.messages.shown if m.error]


def test_every_panel_draws_in_every_state(window, hand):
    settings = window.session.settings
    for mode in ("placed", "moment"):
        settings.light.mode = mode
        settings.water = 510.0
        settings.budget = 50_000 if mode == "moment" else None
        settings.contours = Contours(50.0)
        settings.relief = 2.0
        hand.frames(2)
    assert len(panels.PANELS) == 6
    for name, content, _ in panels.PANELS:
        assert name and callable(content)


def test_the_mesh_can_be_frozen_and_a_budget_is_kept(window, hand):
    settings = window.session.settings
    hand.key("f")
    assert settings.frozen == window.session.view
    hand.key("t")
    hand.rest()
    assert settings.frozen != window.session.view
    hand.key("f")
    assert settings.frozen is None
    settings.budget = 20_000
    hand.until(lambda: 0.5 < window.drawing.stats.triangles / 20_000 <= 1.06, 60)


def test_the_plan_is_drawn_and_takes_one_there(window, hand):
    plan = window.plan
    hand.until(lambda: plan.view is not None and not plan.busy, 120)
    hand.frames(2)
    x, y, w, h = plan._rect
    place = plan.to_ground(x + 0.3 * w, y + 0.7 * h)
    assert plan.to_screen(np.array([place]))[0] == pytest.approx((x + 0.3 * w, y + 0.7 * h))
    hand.click(x + 0.3 * w, y + 0.7 * h)
    hand.rest()
    view = window.session.view
    pixel, _ = view.project(np.array([*place, PLAIN]))
    assert pixel == pytest.approx((view.width / 2, view.height / 2), abs=5.0)
    hand.key("p")
    hand.frames(3)
    assert window.session.view.width < 0.6 * 900
    hand.key("p")
    hand.frames(3)
    assert plan.mode == "none"


def test_pictures(window, hand, tmp_path, monkeypatch):
    from PIL import Image

    monkeypatch.chdir(tmp_path)
    hand.rest()
    hand.key("F12")
    hand.until(lambda: list(tmp_path.glob("*.json")))
    (path,) = tmp_path.glob("*.png")
    picture = np.asarray(Image.open(path))
    assert picture.shape == (window.session.view.height, window.session.view.width, 3)
    window.pictures.write(tmp_path / "all.png", panels=True)
    assert Image.open(tmp_path / "all.png").size == (900, 600)


def test_a_played_day_moves_the_sun(window, hand):
    light = window.session.settings.light
    hand.key(" ")
    before = light.when
    hand.frames(5)
    assert light.when != before
    hand.key(" ")
    assert not light.playing
    assert light.sun(window.session.terrain).altitude > -90


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
    from affine import Affine

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
    assert not window.session.settings.light.playing
    hand.key("t")
    hand.still()
    hand.move(200, 250)
    hand.until(lambda: window.session.probe.hit is not None)
    assert window.session.probe.hit.longitude is None
    assert not [m.text for m in window.session.messages.shown if m.error]
    canvas.close()
    window.gui.close()


@pytest.mark.parametrize("engine", [name for name, _ in METHODS if name])
def test_every_engine_draws_the_ground_and_says_what_it_made(window, hand, engine):
    settings = window.session.settings
    settings.tolerance = 2.0
    hand.rest()
    before = hand.frames(1)
    settings.engine = engine
    made = lambda: window.drawing.renderer.mesh is not None and window.drawing.renderer.resting  # noqa: E731
    hand.until(made, 300)  # its kernels may have to be compiled
    assert window.drawing.stats.triangles == len(window.drawing.renderer.mesh.triangles) > 2
    rows = dict(statistics.rows(window))
    assert rows[engine].endswith(" ms")
    after = hand.frames(1)
    ground = np.s_[250:560, 20:560]
    assert np.abs(after[ground].astype(int) - before[ground]).mean() < 6  # the same ground in the same light
    hand.key("x")
    hand.until(lambda: np.abs(hand.frames(1)[ground].astype(int) - after[ground]).mean() > 0.3)  # its edges
    hand.key("f")
    made = window.drawing.renderer.mesh
    hand.key("t")
    hand.rest()
    assert window.drawing.renderer.mesh is made  # it stands still
    hand.key("f")
    hand.rest()
    assert window.drawing.renderer.mesh is not made
    settings.engine = None
    hand.until(lambda: window.drawing.renderer.mesh is None)
    assert not [m.text for m in window.session.messages.shown if m.error]


def test_normals_are_chosen(window, hand):
    settings = window.session.settings
    settings.tolerance = 16.0
    hand.rest()
    smooth = hand.frames(1)[:, :560].astype(int)
    settings.normals = "derivatives"
    hand.until(lambda: np.abs(hand.frames(1)[:, :560] - smooth).max() > 10)  # facets


def test_a_tour_is_made_played_and_drawn_in_the_plan(window, hand, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    touring = window.touring
    hand.key("l")
    assert "keep some cameras" in window.session.messages.shown[-1].text
    home = window.session.view
    window.session.nav.view = replace(
        home, eye=(413_000.0, 4_980_500.0, 3000.0), target=(415_000.0, 4_983_000.0, 500.0)
    )
    hand.key("k")
    hand.key("o")
    hand.still()
    hand.key("]")
    hand.still()
    hand.key("k")
    assert len(touring.stops) == 2
    first, last = (s.key.view for s in touring.stops)
    hand.until(lambda: window.plan.view is not None and not window.plan.busy, 120)
    hand.frames(2)
    with_way = hand.frames(1)
    x, y, w, h = (round(v) for v in window.plan._rect)
    kept, touring.stops = touring.stops, []
    without = hand.frames(2)
    assert np.abs(with_way.astype(int) - without)[y : y + h, x : x + w].max() > 60
    touring.stops = kept
    touring.stops[0].leg = 0.5
    hand.key("l")
    assert touring.playing
    hand.until(lambda: not touring.playing)
    assert window.session.view.eye == pytest.approx(last.eye, abs=1e-6)
    touring.show(0.0)
    assert window.session.view.eye == pytest.approx(first.eye, abs=1e-6)
    touring.stops[0].leg = 100.0
    hand.key("l")
    hand.frames(3)
    assert touring.playing
    hand.press(300, 400)  # a hand takes the camera
    hand.move(340, 400)
    hand.frames(2)
    hand.release(340, 400)
    assert not touring.playing
    hand.key("l")
    hand.key("Escape")
    assert not touring.playing
    for loop, above, chosen in ((True, 30.0, 0), (False, None, 1)):
        touring.loop, touring.above_ground, touring.chosen = loop, above, chosen
        touring.change(0, path="orbit" if loop else "spline")
        imgui.set_window_focus("Tour")
        hand.frames(2)
    assert touring.save(tmp_path / "tour.json")
    assert not [m.text for m in window.session.messages.shown if m.error]
