"""What variants of one scene share: read once, and the same to the bit."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio

from orograph.geovis.data import painting
from orograph.geovis.data.dataset import Dataset
from orograph.geovis.data.focus import Focus
from orograph.geovis.data.shared import once, sharing
from orograph.scene.scene import Scene
from orograph.store import terrain
from orograph.viewpoint import View


def test_a_thing_is_made_once_within_and_anew_outside():
    made = []

    def make():
        made.append(len(made))
        return made[-1]

    source = np.zeros(3)
    assert [once("a", source, make) for _ in range(2)] == [0, 1]
    with sharing():
        assert [once("a", (source, 1.0), make) for _ in range(2)] == [2, 2]
        with sharing():
            assert once("a", (source, 1.0), make) == 2
        assert once("a", (source.copy(), 1.0), make) == 3  # told by what it is, not by what it holds
        assert once("a", (source, 1), make) == 4 and once("b", (source, 1.0), make) == 5
    assert once("a", (source, 1.0), make) == 6


def image(layer):
    with rasterio.open(layer.path) as file:
        return file.read()


@pytest.mark.cases(1)
@pytest.mark.parametrize("within", ["T-D-U-", "T-D+U-"])
def test_a_focus_reads_and_samples_its_data_once(monkeypatch, within):
    ground = terrain(np.random.default_rng(1).normal(100, 5, (33, 40)).astype(np.float32))
    members = np.random.default_rng(0).normal(0, 1, (6, 33, 40)).astype(np.float32)
    data = Dataset(members, band="all", uncertainty="spread", name="warmth", unit="K")
    view = View((20.0, 16.0, 300.0), (20.0, 17.0, 100.0), width=64, height=48)
    alone = [Scene.of(ground, view, data=data, priority=one) for one in ("T+D+U-", within)]
    counted = []
    read = painting.read_data
    monkeypatch.setattr(painting, "read_data", lambda *given: (counted.append(1), read(*given))[1])
    both = Scene.of(ground, view, data=data, priority="T+D+U-", focus=Focus("lens", priority=within))
    assert len(counted) == 1
    for one, other in zip(alone, (both, both.variants[0].scene)):
        a, b = (scene.data.layers[0] for scene in (one, other))
        assert a.key is not None and b.key is not None and a.key.note == b.key.note
        np.testing.assert_array_equal(image(a), image(b))
