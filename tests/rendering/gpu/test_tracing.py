"""Light by rays frame by frame: shares of lattices, parts of pictures, what gathers at rest, terrain around cameras."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.lighting.sun import Sun
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.shade import ray_field as rays
from orograph.rendering.gpu.shade import tracing
from orograph.rendering.gpu.shade.ray_field import _spread
from orograph.rendering.gpu.shade.tracing import Share, parts_of
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

SIZE = (96, 64)


def ground(side: int = 257) -> Terrain:
    y, x = np.mgrid[:side, :side] * 30.0
    z = 400 + 300 * np.sin(x / 500) * np.cos(y / 700) + 60 * np.sin(x / 170 + y / 230)
    return in_memory(Dem(z.astype(np.float32), Grid(z.shape, Affine(30, 0, 7e5, 0, -30, 5.3e6), CRS.from_epsg(32632))))


def seen(terrain: Terrain, **how: Any) -> Scene:
    x, y = (float(v) for v in terrain.grid.xy(128, 160))
    view = View((x, y - 5000, 2500.0), (x, y, 400.0), width=SIZE[0], height=SIZE[1])
    return Scene.of(
        terrain, view, sun=Sun(290, 12), light="raytraced", tolerance=1.0, colormap="grey", water=None, samples=1, **how
    )


@pytest.mark.parametrize("total", [1, 2, 3, 7, 16, 64, 100, 1000])
def test_numbers_are_spread_and_none_is_left_out(total: int) -> None:
    numbers = [k * _spread(total) % total for k in range(total)]
    assert sorted(numbers) == list(range(total))
    for part in (total // 8, total // 4, total // 2):
        if part > 3:  # what follows each other leaves no gap larger than multiples of the golden ratio do: φ² / n
            some = np.sort(numbers[:part])
            assert np.diff(np.append(some, some[0] + total)).max() <= 2.7 * total / part


def test_frames_at_rest_trace_every_ray_of_a_lattice_and_bounded_work(device: Device) -> None:
    scene = seen(ground(33), rays=64)
    for size, most in ((SIZE, 4), ((2560, 1440), 1)):
        there = scene.but(view=replace(scene.view, width=size[0], height=size[1]))
        shares = [Share.of(device, there, k, 16) for k in range(64)]
        assert shares[0].rays == most and shares[0].frames == 64 // most
        some = [(s.first + k) % s.total for s in shares[: shares[0].frames] for k in range(s.rays)]
        assert sorted(some) == list(range(64))
    # A picture's samples have lattices of their own, as the CPU's have.
    of = Share.of(device, scene, 2, 16, samples=4, shift=(0.25, -0.25))
    assert (of.first, of.rays, of.total, of.corner) == (0, 16, 16, (0.25, -0.25))
    assert Share.of(device, scene.but(rays=4), 0, 16, samples=4).rays == 4


@pytest.mark.parametrize("work", [1, 700, 10**4, 10**9])
def test_parts_hold_every_pixel_once(device: Device, work: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracing, "WORK", {True: work, False: work})
    count = np.zeros((37, 211), int)
    for x, y, width, height in parts_of(device, (211, 37), 5):
        count[y : y + height, x : x + width] += 1
        assert width * height * 5 <= max(work, 64 * 5)
    assert (count == 1).all()


def test_a_picture_is_the_same_in_whatever_parts(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = seen(ground(), rays=8)
    heard: list[float] = []
    whole = draw(scene, device=device)
    monkeypatch.setattr(tracing, "WORK", {True: 20_000, False: 20_000})
    np.testing.assert_array_equal(draw(scene, device=device).pixels, whole.pixels)
    assert whole.facts["light"] == "8 rays"
    renderer = Renderer(device, scene.terrain)
    try:
        texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
        renderer.draw(texture.create_view(), "rgba8unorm", scene, wait=True, samples=2, advance=heard.append)
    finally:
        renderer.close()
    assert len(heard) > 4 and sum(heard) <= 1.0


@pytest.fixture
def open_renderer(device: Device) -> Iterator[Any]:
    made: list[Renderer] = []

    def make(terrain: Terrain) -> Renderer:
        made.append(Renderer(device, terrain))
        return made[-1]

    yield make
    for renderer in made:
        renderer.close()


def test_a_picture_at_rest_becomes_the_one_that_is_waited_for(device: Device, open_renderer: Any) -> None:
    terrain = ground()
    scene = seen(terrain, rays=64)
    renderer = open_renderer(terrain)
    texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    target = texture.create_view()
    before = time.monotonic()
    first = None
    while not renderer.resting or first is None:
        renderer.draw(target, "rgba8unorm", scene)
        if first is None and not renderer.busy:
            first = device.read_texture(texture, np.uint8, 4).astype(int)
        assert time.monotonic() - before < 120
    gathered = device.read_texture(texture, np.uint8, 4).astype(int)
    renderer.draw(target, "rgba8unorm", scene, wait=True, samples=16)
    whole = device.read_texture(texture, np.uint8, 4).astype(int)
    assert np.abs(gathered - whole).mean() < 1.0 < np.abs(first - whole).mean() < 8.0


@pytest.mark.stress
def test_terrain_too_large_to_be_held_is_met_in_windows(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    terrain = ground(2049)
    x, y = (float(v) for v in terrain.grid.xy(300, 1700))
    view = View((x, y, 1500.0), (x + 800, y + 300, 400.0), width=SIZE[0], height=SIZE[1])
    scene = seen(terrain, rays=8).but(tolerance=0.25, view=view)
    exact = draw(scene, device=device)
    for module in (rays, tracing):
        monkeypatch.setattr(module, "EXACT", 1000)
        monkeypatch.setattr(module, "samples_in", lambda most: 1_500_000)
    monkeypatch.setattr(rays, "MARGIN", 64)
    chosen = rays.choose(terrain, scene.view, 1.0, 0.25, 1_500_000)
    assert len(chosen) > 2 and chosen[-1].level == 0
    nested = draw(scene, device=device)
    assert np.abs(nested.pixels.astype(int) - exact.pixels).mean() < 1.0


def test_rays_meet_the_mesh_that_a_picture_shows(device: Device) -> None:
    """As the CPU's do: at 20 pixels a mesh leaves out the ridges whose shadows the terrain casts."""
    from orograph.rendering.cpu.draw import draw as on_cpu

    scene = seen(ground(), rays=16).but(method="soar", tolerance=20.0)
    theirs = on_cpu(scene).pixels.astype(int)
    ours = draw(scene, device=device).pixels.astype(int)
    on_patches = draw(scene.but(method="auto"), device=device).pixels.astype(int)
    d = np.abs(ours - theirs)
    assert d.mean() < 1.0 and np.percentile(d, 95) < 4
    assert np.abs(on_patches - theirs).mean() > 6.0
