"""Panels, plan, measuring, tours and methods of the window on an off-screen canvas, used as a person would."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest
import rasterio
import toy
from affine import Affine

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

from hand import ground_pixel
from imgui_bundle import imgui

from orograph.lod.registry import names
from orograph.scene.contours import Contours
from orograph.viewer import panels
from orograph.viewer.panels import detail, layers, statistics

PLAIN = 500.0


@pytest.mark.stress
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
    tools.choose("los")
    hand.click(300, 330)
    hand.click(300, 350)
    hand.until(lambda: tools.result is not None)
    assert tools.result.visible
    hand.key("Escape")
    assert not tools.active
    assert not window.session.messages.shown


@pytest.mark.stress
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
    for name, color in (("red", (220, 20, 20)), ("blue", (20, 20, 220))):
        paths.append(tmp_path / f"{name}.tif")
        with rasterio.open(
            paths[-1], "w", "GTiff", 64, 64, 3, dtype="uint8", crs=grid.crs.to_wkt(),
            transform=grid.transform @ Affine.scale(grid.cols / 64, grid.rows / 64),
        ) as file:  # fmt: skip
            file.write(np.broadcast_to(np.array(color, np.uint8)[:, None, None], (3, 64, 64)))

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


def test_every_panel_draws_in_every_state(window, hand):
    settings = window.session.settings
    for mode in ("placed", "moment"):
        settings.sun.mode = mode
        settings.water = 510.0
        settings.budget = 50_000 if mode == "moment" else None
        settings.contours = Contours(50.0)
        settings.relief = 2.0
        hand.frames(2)
    assert len(panels.PANELS) == 8
    for name, content, _ in panels.PANELS:
        assert name and callable(content)


@pytest.mark.stress
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


@pytest.mark.stress
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


@pytest.mark.stress
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
    light = window.session.settings.sun
    hand.key(" ")
    before = light.when
    hand.frames(5)
    assert light.when != before
    hand.key(" ")
    assert not light.playing
    assert light.sun(window.session.terrain).altitude > -90


USUAL = ("quadtin", "roam", "smart")
"""Methods of three kinds, which are tried every time; the others take a quarter of a minute each."""


@pytest.mark.stress
@pytest.mark.parametrize(
    "method", [pytest.param(name, marks=() if name in USUAL else pytest.mark.stress) for name in names("triangles")]
)
def test_every_method_draws_the_ground_and_says_what_it_made(window, hand, method):
    settings = window.session.settings
    settings.tolerance = 2.0
    hand.rest()
    before = hand.frames(1)
    settings.method = method
    renderer = window.drawing.renderer
    drawn = lambda: renderer.mesh or renderer.tree  # noqa: E731 (a tree has its triangles on the GPU)
    hand.until(lambda: drawn() is not None and renderer.resting, 300)  # its kernels may have to be compiled
    assert window.drawing.stats.triangles > 2
    assert renderer.mesh is None or window.drawing.stats.triangles == len(renderer.mesh.triangles)
    rows = dict(statistics.rows(window))
    assert rows[method].endswith(" ms") if renderer.mesh is not None else rows[method] == "at rest"
    after = hand.frames(1)
    ground = np.s_[250:560, 20:560]
    assert np.abs(after[ground].astype(int) - before[ground]).mean() < 6  # the same ground in the same light
    hand.key("x")
    hand.until(lambda: np.abs(hand.frames(1)[ground].astype(int) - after[ground]).mean() > 0.3)  # its edges
    if renderer.mesh is None:
        return
    hand.key("f")
    made = renderer.mesh
    hand.key("t")
    hand.rest()
    assert renderer.mesh is made  # it stands still
    hand.key("f")
    hand.rest()
    assert renderer.mesh is not made
    settings.method = "auto"
    hand.until(lambda: window.drawing.renderer.mesh is None)
    assert not [m.text for m in window.session.messages.shown if m.error]


def test_a_method_that_is_added_is_in_the_panel(window, hand, monkeypatch, tmp_path):
    settings, seen = window.session.settings, {}

    def spy(kind, original):
        def call(label, value, *more):
            seen[label] = kind, more
            moved, value = original(label, value, *more)
            return (True, 12.0) if label == "ratio" else (moved, value)

        return call

    for kind in ("combo", "slider_float", "slider_int", "checkbox"):
        monkeypatch.setattr(imgui, kind, spy(kind, getattr(imgui, kind)))
    opened = imgui.TreeNodeFlags_.default_open
    monkeypatch.setattr(imgui, "tree_node", lambda label: imgui.tree_node_ex(label, opened))
    monkeypatch.setattr(panels, "PANELS", tuple((name, detail.draw, place) for name, _, place in panels.PANELS))
    with toy.added(tmp_path):
        settings.method = toy.NAME
        hand.until(lambda: window.drawing.renderer.mesh is not None and window.drawing.renderer.resting, 120)
        hand.frames(2)
        assert toy.NAME in seen["method"][1][0] and "soar" in seen["method"][1][0]
        assert seen["ratio"][0] == "slider_float" and seen["coarsest"][0] == "slider_int"
        assert settings.method == f"{toy.NAME},ratio=12"
        rows = dict(statistics.rows(window))
        assert float(rows[toy.NAME].removesuffix(" ms")) > 0 and "error" not in rows  # measured; promised by nobody
        settings.method = "roam"
        hand.frames(2)
        assert seen["deferral"][0] == "checkbox" and seen["strips"] == ("combo", (["none", "kept", "rebuilt"],))
        settings.method = "auto"
        hand.until(lambda: window.drawing.renderer.mesh is None)
        hand.frames(2)
        assert seen["legs"][0] == "combo" and not [m.text for m in window.session.messages.shown if m.error]


@pytest.mark.stress
def test_normals_are_chosen(window, hand):
    settings = window.session.settings
    settings.tolerance = 16.0
    hand.rest()
    smooth = hand.frames(1)[:, :560].astype(int)
    settings.normals = "derivatives"
    hand.until(lambda: np.abs(hand.frames(1)[:, :560] - smooth).max() > 10)  # facets


@pytest.mark.stress
def test_a_tour_is_made_played_and_drawn_in_the_plan(window, hand, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    touring = window.touring
    hand.key("l")
    assert "add some cameras" in window.session.messages.shown[-1].text
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
