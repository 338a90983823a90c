"""Focus, flight, ghosted surfaces and walls in the window: what is blended where, against each picture alone."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("imgui_bundle")
pytest.importorskip("rendercanvas")

from orograph.errors import UsageError
from orograph.geovis.color import linear_to_srgb, srgb_to_linear
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.focus import Focus
from orograph.geovis.data.priority import Priority
from orograph.scene.aids import Aids
from orograph.scene.flying import Flight
from orograph.scene.ghosts import Ghost
from orograph.viewer import settings as settings_of_windows
from orograph.viewer.data import ShownData
from orograph.viewer.settings import Settings
from orograph.viewer.variants import BLENDED, Variants


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Data are painted as while time passes, which takes less long."""
    monkeypatch.setattr(settings_of_windows, "PAINTED", settings_of_windows.PLAYED)


def values(terrain):
    rows, cols = terrain.grid.shape
    members = np.random.default_rng(0).normal(np.linspace(0, 9, cols), 0.5, (6, rows, cols)).astype(np.float32)
    return Dataset(members, band="all", uncertainty="spread", name="warmth", unit="K")


def alike(one, other, where=...):
    """Whether pictures are the same; how many samples a pixel has at rest differs a little."""
    apart = np.abs(one - other).max(-1)[where]
    return apart.mean() < 1 and (apart > 2).mean() < 0.01 and apart.max() < 20


def seen(window, hand, **options):
    """The terrain's picture with these options, and data."""
    settings, terrain = window.session.settings, window.session.terrain
    for name, none in (("focus", None), ("ghosts", ()), ("aids", None)):
        settings.options[name] = options.get(name, none)
    settings.shown = ShownData((values(terrain),), Priority.parse(options.get("priority", "T+D+U-")))
    settings.show(terrain)
    window.touch()
    hand.frames(2)
    hand.until(lambda: window.drawing.done)
    return window.drawing.screen.pixels().astype(int)


@pytest.mark.stress
def test_a_lens_shows_its_priority_and_the_rest_the_other(window, hand):
    around, within = seen(window, hand), seen(window, hand, priority="T-D-U-")
    both = seen(window, hand, focus=Focus("lens", priority="T-D-U-", radius=0.3, blend=0.1))
    rows, cols = both.shape[:2]
    x, y = (np.arange(cols) + 0.5) / rows - cols / rows / 2, (np.arange(rows) + 0.5) / rows - 0.5
    far = np.hypot(x[None], y[:, None])
    assert np.abs(around - within).mean() > 5
    assert alike(both, within, far < 0.24)
    assert alike(both, around, far > 0.36)
    assert any("focus" in scale.label for key in window.session.scene().keys for scale in key.scales)
    window.touch()
    drawn = window.drawing.drawn
    hand.frames(3)
    assert window.drawing.drawn == drawn  # nothing changes, so nothing is drawn again


@pytest.mark.stress
def test_a_surface_over_the_ground_covers_it_by_its_opacity(window, hand):
    terrain = window.session.terrain
    over = np.full(terrain.grid.shape, 520.0, np.float32)
    bare, half, full = (
        seen(window, hand, **({} if k is None else {"ghosts": (Ghost(over, opacity=k, name="Water"),)}))
        for k in (None, 0.5, 1.0)
    )
    middle = (slice(half.shape[0] // 2, half.shape[0] // 2 + 40), slice(200, 300))
    mean = (srgb_to_linear(bare[middle] / 255) + srgb_to_linear(full[middle] / 255)) / 2
    assert np.abs(bare - full)[middle].mean() > 20
    assert alike(half[middle], linear_to_srgb(mean) * 255)
    assert any("Water" in name for key in window.session.scene().keys for name, _ in key.classes)


@pytest.mark.stress
def test_walls_stand_beside_the_terrain(window, hand):
    bare, walled = seen(window, hand), seen(window, hand, aids=Aids(walls=True))
    beyond = np.isnan(window.drawing.renderer.depth())
    assert (np.abs(walled - bare).max(-1)[beyond] > 30).sum() > 200


def test_walls_need_no_data(window, hand):
    settings = Settings(window.session.terrain, aids="walls")
    first, second = (settings.scene(window.session.terrain, window.session.view) for _ in range(2))
    assert len(first.theme.things) > 100 and first == second


def test_scenarios_follow_height_and_speed(window):
    terrain, view = window.session.terrain, window.session.view
    made = Variants()
    made.take(Variants.made({"flight": Flight(100, 300, 10, 50)}, terrain, (320, 200)))
    x, y = (float(v) for v in terrain.grid.xy(200.0, 200.0))

    def at(height, east=0.0):
        return replace(view, eye=(x + east, y, 500.0 + height), target=(x, y + 100.0, 500.0))

    made.advance(at(50), 0.1)
    assert made.shares == (1, 0, 0) and not made.moving
    before = made.shares
    for _ in range(40):  # it rests high above: it re-plans, by degrees
        made.advance(at(400), 0.1)
        assert max(abs(a - b) for a, b in zip(made.shares, before)) <= 0.1 / BLENDED + 1e-9
        assert sum(made.shares) == pytest.approx(1)
        before = made.shares
    assert made.shares == pytest.approx((0, 0, 1)) and not made.moving
    assert made.shares_text == "replanning 100%"
    for k in itertools.count():
        made.advance(at(400, 6.0 * (k + 1)), 0.1)  # 60 metres a second
        if not made.moving:
            break
    assert k == pytest.approx(BLENDED / 0.1, abs=2) and made.shares == pytest.approx((0, 1, 0))


@pytest.mark.stress
def test_a_flight_is_shown_and_refuses_priorities(window):
    terrain = window.session.terrain
    settings = Settings(terrain, flight="100:300:10:50", data=values(terrain))
    assert [one.name for one in settings.scene(terrain, window.session.view).variants] == ["overflight", "replanning"]
    with pytest.raises(UsageError, match="flight"):
        settings.show(terrain, Priority.parse("T-D-U-"))
    for more in ({"priority": "T+D-U-"}, {"focus": "lens"}):
        with pytest.raises(UsageError, match="flight"):
            Settings(terrain, flight="auto", data=values(terrain), **more)
