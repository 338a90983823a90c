"""Everything that draws keeps to what every browser with WebGPU has: its default limits, and no optional feature."""

from __future__ import annotations

import re
from importlib.resources import files
from typing import Any

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu import device as devices
from orograph.gpu.device import Device, open_device
from orograph.gpu.sources import source
from orograph.lighting.aperture import CapField, Lamp, Lights
from orograph.lighting.gpu import aperture
from orograph.lighting.occlusion import ambient_occlusion
from orograph.lighting.sun import Sun
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.shade.ray_field import HeightWindow, RayField, blocked
from orograph.rendering.gpu.shade.ssao import screen_occlusion
from orograph.rendering.gpu.surface import rays
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.scene.silhouettes import Silhouettes
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.synthesis.detailed import Detailed
from orograph.synthesis.exemplar import Exemplar
from orograph.synthesis.gpu import EndlessOnGpu
from orograph.synthesis.windows import Endless, Range
from orograph.viewer.screen import Screen
from orograph.viewpoint import View

SIZE = (96, 64)


@pytest.fixture
def portable(device: Device, monkeypatch: pytest.MonkeyPatch) -> Device:
    """A device of the portable tier, which whoever asks for a device gets."""
    found = open_device(portable=True)
    usual = next(key for key, value in devices._OPEN.items() if value is device)
    monkeypatch.setitem(devices._OPEN, usual, found)
    return found


def ground(void: bool = True) -> Terrain:
    y, x = np.mgrid[:129, :129] * 30.0
    z = 400 + 300 * np.sin(x / 500) * np.cos(y / 700) + 60 * np.sin(x / 170 + y / 230)
    if void:
        z[40:50, 60:75] = np.nan
    return in_memory(Dem(z.astype(np.float32), Grid(z.shape, Affine(30, 0, 7e5, 0, -30, 5.3e6), CRS.from_epsg(32632))))


def seen(terrain: Terrain, **how: Any) -> Scene:
    x, y = (float(v) for v in terrain.grid.xy(64, 70))
    view = View((x, y - 2500, 1800.0), (x, y, 400.0), width=SIZE[0], height=SIZE[1])
    return Scene.of(terrain, view, sun=Sun(290, 20), tolerance=1.0, **{"samples": 1, **how})


LIGHTS: dict[str, Any] = {
    "lamps": (Lamp(60.0, 60.0, 900.0, (4e5, 2e5, 1e5)),),
    "discs": ((Sun(90, 30, 10.0), (0.2, 0.2, 0.6)),),
}
SCENES: dict[str, dict[str, Any]] = {
    "lines": {"contours": Contours(50.0), "silhouettes": Silhouettes(), "sky": True, "furniture": True},
    "apertures": {"light": "aperture", **LIGHTS},
    "rays": {"light": "raytraced", "rays": 4, **LIGHTS},
    "mesh": {"method": "soar", "wireframe": True},
    "tree": {"method": "cbt", "wireframe": True},
    "chunks": {"method": "chunked-lod,cells=16,compressed=yes", "wireframe": True},
    "batches": {"method": "bdam,legs=8,geomorph=yes", "wireframe": True},
    "pieces": {"method": "seamless-patches,segments=8", "wireframe": True},
    "cast": {"method": "raycast", "normals": "faces"},
    "cast, light by the ground": {"method": "raycast"},
    "cast at breaks": {"method": "raycast,antialias=breaks", "samples": 2},
    "both": {"method": "hybrid,shares=turns,block=32", "normals": "faces"},
}


@pytest.mark.cases(5)
@pytest.mark.parametrize("name", SCENES)
def test_pictures_are_the_same(device: Device, name: str) -> None:
    scene = seen(ground(), **SCENES[name])
    usual, portable = (draw(scene, device=d).pixels.astype(int) for d in (device, open_device(portable=True)))
    assert np.abs(usual - portable).mean() < 0.05
    assert usual.std() > 10


@pytest.mark.cases(5)
@pytest.mark.parametrize("name", SCENES)
def test_compute_shaders_show_what_fragments_show(device: Device, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """As on hardware, and within the limits."""
    scene = seen(ground(), **SCENES[name])
    by_fragments = draw(scene, device=device).pixels.astype(int)
    monkeypatch.setattr(Device, "computes", True)
    computed = draw(scene, device=open_device(portable=True)).pixels.astype(int)
    assert np.abs(by_fragments - computed).mean() < 0.05
    assert computed.std() > 10


@pytest.mark.parametrize("name", ["cast", "both"])
def test_hits_that_no_buffer_holds_are_those_of_fragments(
    device: Device, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    scene = seen(ground(), **SCENES[name])
    monkeypatch.setattr(Device, "computes", True)
    computed = draw(scene, device=device).pixels
    monkeypatch.setattr(rays, "HIT", 1 << 24)
    np.testing.assert_array_equal(draw(scene, device=device).pixels, computed)


def move(device: Device, scene: Scene) -> None:
    """Draw two frames of a moving picture, as a window does."""
    target = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC").create_view()
    renderer = Renderer(device, scene.terrain)
    for k in range(2):
        view = scene.view
        moved = View(view.eye, (view.target[0] + k, *view.target[1:]), width=SIZE[0], height=SIZE[1])
        renderer.draw(target, "rgba8unorm", scene.but(view=moved), wait=True)
    renderer.close()


def test_every_shader_is_used_within_the_limits(portable: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = seen(ground())
    with monkeypatch.context() as as_hardware:
        as_hardware.setattr(Device, "computes", True)
        draw(seen(scene.terrain, **SCENES["cast at breaks"]), device=portable)
        move(portable, scene)
    for how in SCENES.values():
        draw(seen(scene.terrain, **how), device=portable)
    draw(seen(ground(void=False), method="clipmap,n=63"), device=portable)  # (rings around voids are triangles)
    screen_occlusion(np.ones((8, 8)), np.dstack([np.zeros((8, 8, 2)), -np.ones((8, 8))]), 0.1, radius=1.0)
    move(portable, scene)
    Screen(portable, "rgba8unorm")
    heights = scene.terrain.read(0, 0, 65, 0, 65)[:32, :32].copy()
    for method in ("cone-tracing", "shadow-maps"):
        ambient_occlusion(heights, np.diag([30.0, -30.0]), method=method, rays=8, cones=16)
    caps = np.dstack([np.zeros((8, 8, 2)), np.ones((8, 8)), np.zeros((8, 8))]).astype(np.float32)
    lights = Lights(suns=[(Sun(300, 15, 30.0), (1.0, 0.9, 0.8))], lamps=[*LIGHTS["lamps"]], ambient=(0.2, 0.3, 0.4))
    aperture.light(CapField(caps, np.diag([30.0, -30.0])), np.array([[2.0, 2.0, 5.0]]), np.zeros((1, 2)), lights)
    field = RayField.of([HeightWindow(0, 0, 0, heights)], heights.shape, np.diag([30.0, -30.0]))
    blocked(field, np.array([[2.0, 2.0, 900.0]]), np.array([[0.0, 0.0, 1.0]]))
    EndlessOnGpu(Endless(Exemplar.of(heights, jobs=1), 1), portable).heights(Range(0, 4, 0, 4))
    Detailed(scene.terrain, 2, 1, device=portable).read(0, 0, 9, 0, 9)

    used: set[str] = set()
    for key in portable._modules:
        pending = {re.match(r"\w+", key)[0]}  # type: ignore[index]
        while pending:
            name = pending.pop()
            used.add(name)
            text = (files("orograph.gpu") / "shaders" / f"{name}.wgsl").read_text()
            pending |= set(re.findall(r"include: (\w+)\.wgsl", text)) - used
    there = {f.name.removesuffix(".wgsl") for f in (files("orograph.gpu") / "shaders").iterdir()}
    assert used == there
    assert source("shade", {"RAYS": 1}).count("var<storage") == 8
