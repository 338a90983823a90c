"""The ground under eye and cursor against ``measuring``, and what happens where reading is slow or fails."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from orograph import measuring
from orograph.errors import StoreError
from orograph.scene import camera
from orograph.store import terrain as in_memory
from orograph.store.prepare import prepare
from orograph.viewer import probe as module
from orograph.viewer.probe import Probe


@pytest.fixture(scope="module")
def terrain(dem):
    return prepare([str(dem)])


def places(terrain, n=200):
    rng = np.random.default_rng(3)
    rows, cols = terrain.grid.shape
    return np.stack(terrain.grid.xy(rng.uniform(0, cols - 1, n), rng.uniform(0, rows - 1, n)), 1)


def test_the_ground_is_the_surface(terrain):
    probe = Probe(terrain)
    for x, y in places(terrain):
        assert probe.ground(x, y) == pytest.approx(measuring.place(terrain, (x, y)).surface_height, abs=1e-3)
    west, south, *_ = terrain.grid.bounds()
    assert np.isnan(probe.ground(west - 100, south))
    probe.close()


def test_coarse_ground_becomes_the_surface(large, monkeypatch):
    monkeypatch.setattr(module, "COARSE", 10_000)
    probe = Probe(large)
    assert probe.level > 0
    at = places(large, 20)
    for x, y in at:
        assert abs(probe.ground(x, y) - measuring.place(large, (x, y)).height) < 5.0
    end = time.monotonic() + 20
    while probe._asked and time.monotonic() < end:
        time.sleep(0.01)
    for x, y in at:
        assert probe.ground(x, y) == pytest.approx(measuring.place(large, (x, y)).height, abs=1e-3)
    probe.close()


def test_picks(terrain):
    probe = Probe(terrain)
    view = camera.whole(terrain, (200, 150))
    for x, y in ((100, 90), (60, 80), (150, 110), (100, 5)):
        found, truth = probe.pick(view, x, y, patience=30.0), measuring.pick(terrain, view, (x, y))
        assert (found is None) == (truth is None)
        if truth is not None:
            assert found == pytest.approx((*truth.point, truth.height), abs=1e-6)
            assert probe.pick_coarse(view, x, y) == pytest.approx(found, abs=1e-3)
    probe.close()


class Slow:
    """A terrain whose full resolution does not answer, or fails."""

    def __init__(self, terrain, gate: threading.Event, error: Exception | None = None) -> None:
        self._terrain, self._gate, self._error = terrain, gate, error

    def __getattr__(self, name):
        return getattr(self._terrain, name)

    @property
    def __class__(self):
        return type(self._terrain)

    def read(self, level, *window):
        if level == 0:
            self._gate.wait(30)
            if self._error is not None:
                raise self._error
        return self._terrain.read(level, *window)


@pytest.fixture
def large():
    """A terrain of more than one level."""
    from affine import Affine

    from orograph.dem import Dem
    from orograph.geo import Grid

    side = 600
    z = 100 * np.sin(np.arange(side) / 40)[:, None] + np.zeros(side, np.float32)
    return in_memory(Dem(z.astype(np.float32), Grid((side, side), Affine(10, 0, 5e5, 0, -10, 5e6))))


def test_nothing_waits_for_a_disk(large, monkeypatch):
    monkeypatch.setattr(module, "COARSE", 10_000)
    gate = threading.Event()
    probe = Probe(Slow(large, gate))
    assert probe.level > 0
    view = camera.whole(large, (200, 150))
    begun = time.monotonic()
    for _ in range(50):
        x, y = large.grid.xy(300, 300)
        assert np.isfinite(probe.ground(float(x), float(y)))
    assert probe.pick(view, 100, 80) is not None
    probe.hover(view, 100, 80)
    probe.close()
    assert time.monotonic() - begun < 5
    gate.set()


def test_what_cannot_be_read_is_told(large, monkeypatch):
    monkeypatch.setattr(module, "COARSE", 10_000)
    gate = threading.Event()
    gate.set()
    told = threading.Event()
    probe = Probe(Slow(large, gate, StoreError("It is gone.", path="x.oro")), told.set)
    view = camera.whole(large, (200, 150))
    assert probe.pick(view, 100, 80, patience=30.0) is not None  # the coarse one
    probe.hover(view, 100, 80)
    assert told.wait(20)
    assert "x.oro" in probe.trouble
    probe.close()
