"""Maps of light that follow a camera, without a GPU: what is there when, and that it follows who never stands still."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pyproj
import pytest
from affine import Affine

from orograph.dem import Dem
from orograph.geo import Grid
from orograph.lod.patches.shape import INSTANCE
from orograph.memo import Memo
from orograph.rendering.gpu.shade import following
from orograph.rendering.gpu.shade.following import Following
from orograph.scene import camera
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory

NONE = np.zeros(0, INSTANCE)


class VoidFill:
    """Takes membranes, and keeps how often it was given some."""

    def __init__(self) -> None:
        self.loads = 0

    def load(self, *args) -> None:
        self.loads += 1


@pytest.fixture(scope="module")
def terrain():
    row, col = np.mgrid[:257, :257]
    z = (300 * np.exp(-(((row - 120) / 25.0) ** 2 + ((col - 130) / 18.0) ** 2))).astype(np.float32)
    return in_memory(Dem(z, Grid((257, 257), Affine(10, 0, 5e5, 0, -10, 5e6), pyproj.CRS("EPSG:32633")), name="hill"))


def scene_of(terrain, azimuth=315.0):
    from orograph.lighting.sun import Sun

    view = camera.whole(terrain, (320, 200))
    return Scene.of(terrain, view, sun=Sun(azimuth, 20.0))


def settle(follow, scene, what, seconds=60.0):
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end
        follow.aside(scene, NONE)
        follow.go_on()
        time.sleep(0.005)


def test_quick_shadows_come_first_and_then_all_of_the_light(terrain):
    void_fill = VoidFill()
    follow = Following(terrain, Memo(), void_fill, 32)
    scene = scene_of(terrain)
    seen = []
    follow.aside(scene, NONE)
    follow.go_on()
    assert len(follow.maps.windows) == 0  # there is something to draw with at once
    settle(follow, scene, lambda: seen.append(follow.maps) or not follow.busy)
    kinds = list(dict.fromkeys(id(m) for m in seen))
    quick, fine = seen[[id(m) for m in seen].index(kinds[-2])], follow.maps
    assert len(quick.windows) > 0
    assert quick.light[1:3] == (1, 1)  # an open sky
    assert fine.light[1] > 50
    assert quick.strength == fine.strength
    assert quick.pool.size < fine.pool.size
    assert void_fill.loads == 1
    for maps in (quick, fine):  # both have the hill's shadow
        offset, rows, cols = maps.windows[-1][:3]
        assert (maps.pool[offset : offset + rows * cols] > 0).mean() > 0.01


def test_no_maps_of_shadows_are_made_where_none_fall(terrain):
    follow = Following(terrain, Memo(), VoidFill(), 32)
    scene = scene_of(terrain).but(shadows=False)
    settle(follow, scene, lambda: follow.maps is not None and not follow.busy)
    assert len(follow.maps.windows) == 0


def test_a_camera_that_never_rests_is_followed(terrain, monkeypatch):
    monkeypatch.setattr(following, "RENEWED", 0.05)
    follow = Following(terrain, Memo(), VoidFill(), 32)
    scene = scene_of(terrain)
    settle(follow, scene, lambda: follow.maps is not None and not follow.busy)
    met = {id(follow.maps): follow.maps}
    end = time.monotonic() + 60
    step = 0
    while len(met) < 3:
        assert time.monotonic() < end, "the maps stay where they were"
        step += 1
        x, y, z = scene.view.eye
        e, n, h = scene.view.target
        d = 40.0 * step
        moved = scene.but(view=replace(scene.view, eye=(x + d, y, z), target=(e + d, n, h)))
        follow.aside(moved, NONE)
        follow.go_on()
        assert follow._moved >= time.monotonic() - following.SETTLED  # it is never at rest
        met[id(follow.maps)] = follow.maps
        time.sleep(0.002)


def test_a_flight_gets_new_maps_only_so_often(terrain, monkeypatch):
    monkeypatch.setattr(following, "RENEWED", 1e6)
    follow = Following(terrain, Memo(), VoidFill(), 32)
    scene = scene_of(terrain)
    settle(follow, scene, lambda: follow.maps is not None and not follow.busy)
    first = follow.maps
    for step in range(1, 60):
        x, y, z = scene.view.eye
        follow.aside(scene.but(view=replace(scene.view, eye=(x + 100.0 * step, y, z))), NONE)
        follow.go_on()
        time.sleep(0.002)
    assert follow.maps is first
    turned = scene_of(terrain, azimuth=90.0)  # a new sun is not waited with
    follow.aside(turned, NONE)
    follow.go_on()
    assert follow._aside.busy
