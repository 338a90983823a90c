"""A store behind a web server that is slow, silent, busy or broken: frames go on at their rate, say what is wrong, and
become whole again when it answers."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS
from webserver import Web, serving, until

from orograph import store
from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.lod.patches import pager
from orograph.rendering.gpu.frame import FrameStats
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.stream.streamer import Streamer
from orograph.scene.scene import Scene
from orograph.store import storage
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

pytest.importorskip("obstore")

SIZE = (120, 80)
FRAME = 1 / 30
"""Seconds that the loop may wait for anything but drawing."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stalls")
    y, x = np.mgrid[:1400, :1600] * 20.0
    z = (300 + 200 * np.sin(x / 900) * np.cos(y / 700) + 8 * np.sin(x / 31) * np.sin(y / 37)).astype(np.float32)
    grid = Grid(z.shape, Affine(20, 0, 700_000, 0, -20, 5_300_000), CRS.from_epsg(32632))
    store.build(Dem(z, grid), path / "area.oro", shard=512, chunk=256)
    return path


@pytest.fixture
def web(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Web]:
    monkeypatch.setattr(storage, "SILENCE", 2.0)
    monkeypatch.setattr(storage, "AGAIN", (0.02, 0.05))
    monkeypatch.setattr(pager, "AGAIN", 0.1)
    monkeypatch.setattr(Streamer, "RETRY", 0.3)
    with serving(folder) as server:
        yield server


class Loop:
    """A render loop, as a window has it."""

    def __init__(self, device: Device, terrain: Terrain) -> None:
        self.device, self.terrain = device, terrain
        self.renderer = Renderer(device, terrain, gpu_memory=1 << 27)
        self.texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
        self.target = self.texture.create_view()
        x, y = (float(v) for v in terrain.grid.xy(800, 700))
        view = View((x, y - 1.0, 20_000.0), (x, y, 300.0), width=SIZE[0], height=SIZE[1])
        self.scene = Scene.of(terrain, view, tolerance=0.05, shadows=False)

    def frame(self, scene: Scene | None = None) -> FrameStats:
        stats = self.renderer.draw(self.target, "rgba8unorm", scene or self.scene)
        self.device.wait()
        assert np.isfinite(self.renderer.depth()).all()  # no hole
        return stats

    def pixels(self) -> NDArray[np.int16]:
        return self.device.read_texture(self.texture, np.uint8, 4)[..., :3].astype(np.int16)

    def whole(self, scene: Scene | None = None, seconds: float = 60.0) -> FrameStats:
        """Frames until nothing is missing."""
        end = time.monotonic() + seconds
        while True:
            stats = self.frame(scene)
            if not stats.tiles_wanted and not stats.failed:
                return stats
            assert time.monotonic() < end, stats


@pytest.fixture
def loop(device: Device, web: Web) -> Iterator[Loop]:
    made = Loop(device, store.open(f"{web.url}/area.oro", cache_bytes=0))
    made.frame()  # compiles
    yield made
    made.renderer.close()


@pytest.mark.cases(1)
@pytest.mark.parametrize("mood", ["mute", "busy", "short", "cut"])
def test_a_store_that_fails_never_holds_a_frame_up_and_recovers(loop: Loop, web: Web, mood: str) -> None:
    loop.whole()
    x, y, _ = loop.scene.view.target
    near = replace(loop.scene.view, eye=(x + 3000, y, 1500.0), target=(x + 3000, y + 400, 300.0))
    there = loop.scene.but(view=near)  # a jump
    fine = loop.whole(there)
    loop.renderer.close()

    again = Loop(loop.device, store.open(f"{web.url}/area.oro", cache_bytes=0))
    web.mood = mood
    took, told = [], []
    for _ in range(20):
        stats = again.frame(there)
        took.append(stats.cpu_ms / 1e3)
        told.append(stats)
    assert statistics.median(took) < FRAME and max(took) < 1.0, took
    assert told[0].triangles < fine.triangles and told[0].tiles_wanted > 0
    failed: list[str] = []
    assert until(lambda: failed.append(again.frame(there).failed) or failed[-1]), "nobody was told"
    web.mood = "well"
    assert until(lambda: again.renderer.busy), "a window that rests while nothing comes would never ask again"
    assert again.whole(there).triangles == fine.triangles
    again.renderer.close()


@pytest.mark.stress
def test_a_slow_store_fills_in_while_frames_go_on(device: Device, web: Web, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage, "SILENCE", 10.0)
    loop = Loop(device, store.open(f"{web.url}/area.oro", cache_bytes=0))
    loop.frame()
    web.mood, web.seconds = "slow", 0.7
    begun, took, first = time.monotonic(), [], None
    while time.monotonic() - begun < 60:
        stats = loop.frame()
        first = first or stats
        took.append(stats.cpu_ms / 1e3)
        assert stats.failed == ""
        if not stats.tiles_wanted:
            break
    assert time.monotonic() - begun > 0.7 and stats.tiles_wanted == 0 and stats.triangles > first.triangles
    assert statistics.median(took) < FRAME and max(took) < web.seconds, max(took)
    loop.renderer.close()


@pytest.mark.stress
def test_what_must_be_compiled_holds_no_frame_up(device: Device, folder: Path) -> None:
    """Another way to shade: the last one serves until it is there, and the picture comes to rest as if it had been."""
    loop = Loop(device, store.open(folder / "area.oro"))
    plain = loop.scene.but(colormap="grey", water=None)
    loop.whole(plain)
    bare = plain.but(light="none")
    held: list[float] = []
    wanted = loop.renderer._shading.pipeline

    def slowly(flags: int, entry: str = "fragment") -> object:
        if (flags, entry) not in loop.renderer._shading._pipelines:
            time.sleep(0.5)
        return wanted(flags, entry)

    loop.renderer._shading.pipeline = slowly  # type: ignore[method-assign, assignment]
    for _ in range(5):
        held.append(loop.frame(bare).cpu_ms / 1e3)
    assert statistics.median(held) < FRAME and max(held) < 0.4, held
    assert loop.renderer.busy
    assert until(lambda: loop.frame(bare) and loop.renderer.resting)
    shown = loop.pixels()
    loop.renderer.draw(loop.target, "rgba8unorm", bare, wait=True, samples=16)
    assert np.abs(shown - loop.pixels()).mean() < 1.0
    loop.renderer.close()
