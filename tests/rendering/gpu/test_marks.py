"""Contour lines and their labels on the GPU: the CPU's, and holding still while the camera moves."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from affine import Affine
from cielab import lab
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.rendering.cpu.draw import draw as draw_cpu
from orograph.rendering.gpu.draw import draw as draw_gpu
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.lines.label_spots import POINTS
from orograph.rendering.lines.label_type import Labels
from orograph.rendering.lines.labels import Placer
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.scene.silhouettes import Silhouettes
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

SIZE = (360, 240)
EAST, NORTH = 700_000.0, 5_300_000.0


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    y, x = np.mgrid[:501, :620] * 20.0
    z = 500 + 300 * np.sin(x / 1900) * np.cos(y / 1700) + 60 * np.sin(x / 670 + y / 830)
    grid = Grid(z.shape, Affine(20.0, 0, EAST, 0, -20.0, NORTH), CRS.from_epsg(32632))
    return in_memory(Dem(z.astype(np.float32), grid))


def scenes(terrain: Terrain) -> dict[str, Scene]:
    middle = (EAST + 6200.0, NORTH - 5000.0, 500.0)
    slanted = View((EAST + 6000.0, NORTH - 14_000.0, 5000.0), middle, width=SIZE[0], height=SIZE[1])
    plan = View((middle[0], middle[1], 12_000.0), middle, projection="plan", width=SIZE[0], height=SIZE[1])
    near = View((EAST + 5100.0, NORTH - 6350.0, 620.0), (EAST + 5150.0, NORTH - 6250.0, 528.0), width=360, height=240)
    lines = Contours(20.0)
    return {
        name: Scene.of(terrain, view, samples=4, tolerance=0.5, contours=lines, sky=name == "slanted")
        for name, view in (("slanted", slanted), ("plan", plan))
    } | {"beyond samples": Scene.of(terrain, near, samples=4, tolerance=0.5, contours=Contours(1.0))}


@pytest.mark.stress
@pytest.mark.parametrize("name", ["slanted", "plan", "beyond samples"])
def test_both_backends_draw_the_same_lines_and_labels(device: Device, terrain: Terrain, name: str) -> None:
    scene = scenes(terrain)[name]
    scene = scene.but(contours=replace(scene.annotations.contours, casing=0.6 if name == "slanted" else None))
    cpu, gpu = draw_cpu(scene), draw_gpu(scene, device=device)
    assert cpu.facts["shader"]["contours"]["labels"] >= 3
    apart = np.linalg.norm(lab(cpu.pixels) - lab(gpu.pixels), axis=-1)
    assert apart.mean() < 1.0 and np.quantile(apart, 0.95) < 3.0, (apart.mean(), np.quantile(apart, 0.95))
    bare = draw_gpu(scene.but(contours=None), device=device)
    marked = np.linalg.norm(lab(bare.pixels) - lab(gpu.pixels), axis=-1) > 8
    assert marked.mean() > 0.03 and apart[marked].mean() < 3.0, apart[marked].mean()


@pytest.mark.parametrize("water", [None, "auto"])
def test_both_backends_draw_the_same_coast(device: Device, water: str | None) -> None:
    """A level sea beside samples of many pixels."""
    y, x = np.mgrid[:40, :40]
    z = np.maximum(0, 400 - 45 * np.hypot(x - 20, y - 20)).astype(np.float32)
    grid = Grid(z.shape, Affine(2000.0, 0, EAST, 0, -2000.0, NORTH), CRS.from_epsg(32632))
    middle = (EAST + 40_000.0, NORTH - 40_000.0, 0.0)
    view = View((*middle[:2], 50_000.0), middle, projection="plan", width=SIZE[0], height=SIZE[1])
    lines = Contours(100.0, casing=0.6, labels=False)
    scene = Scene.of(in_memory(Dem(z, grid)), view, samples=4, contours=lines, light="none", water=water)
    cpu, gpu = draw_cpu(scene), draw_gpu(scene, device=device)
    apart = np.linalg.norm(lab(cpu.pixels) - lab(gpu.pixels), axis=-1)
    assert apart.mean() < 0.5 and (apart > 8).mean() < 1e-3, (apart.mean(), (apart > 8).mean())


@pytest.mark.cases(1)
@pytest.mark.parametrize("method", ["auto", "soar"])
def test_both_backends_draw_the_same_silhouettes(device: Device, terrain: Terrain, method: str) -> None:
    """On a mesh, too, whose creases are those of the terrain."""
    scene = scenes(terrain)["slanted"]
    low = replace(scene.view, eye=(scene.view.eye[0], scene.view.eye[1], 1500.0))
    scene = scene.but(view=low, contours=None, silhouettes=Silhouettes(2.5, creases=1.0, casing=0.6), method=method)
    if method != "auto":
        scene = scene.but(tolerance=6.0, light="none")
    cpu, gpu, bare = draw_cpu(scene), draw_gpu(scene, device=device), draw_cpu(scene.but(silhouettes=None))
    apart = np.linalg.norm(lab(cpu.pixels) - lab(gpu.pixels), axis=-1)
    assert apart.mean() < 1.0 and np.quantile(apart, 0.95) < 3.0, (apart.mean(), np.quantile(apart, 0.95))
    if method != "auto":
        assert (apart > 8).mean() < 5e-4, (apart > 8).mean()
    lines = np.linalg.norm(lab(bare.pixels) - lab(cpu.pixels), axis=-1) > 8
    assert lines.mean() > 0.002 and apart[lines].mean() < 5.0, (lines.mean(), apart[lines].mean())


def test_labels_hold_still_and_fade_while_the_camera_moves(device: Device, terrain: Terrain) -> None:
    """A slow pan in a plan: labels move with the ground, by whole pixels here, and none appears in one frame."""
    scene = scenes(terrain)["plan"]
    scene = scene.but(light="none", colormap="grey", contours=Contours(20.0, fading=True))
    renderer = Renderer(device, terrain)
    texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    target = texture.create_view()
    step = scene.view.pixel_metres
    frames = []
    try:
        for k in range(12):
            view = replace(
                scene.view, eye=(scene.view.eye[0] + k * step, *scene.view.eye[1:]),
                target=(scene.view.target[0] + k * step, *scene.view.target[1:]),
            )  # fmt: skip
            renderer.draw(target, "rgba8unorm", scene.but(view=view), wait=True, samples=1)
            frames.append(device.read_texture(texture, np.uint8, 4)[..., :3].astype(int))
    finally:
        renderer.close()
    for before, after in pairwise(frames):
        moved = np.abs(after[:, 20:-21] - before[:, 21:-20]).max(-1)
        assert (moved > 60).sum() < 12, (moved > 60).sum()  # a label that came at once would change dozens


def test_frames_do_not_wait_for_labels(device: Device, terrain: Terrain) -> None:
    scene = scenes(terrain)["slanted"]
    renderer = Renderer(device, terrain)
    texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    target = texture.create_view()
    try:
        renderer.draw(target, "rgba8unorm", scene)
        assert renderer._letters.view is None and renderer.busy
        end = time.perf_counter() + 60
        while renderer.busy and time.perf_counter() < end:
            time.sleep(0.02)
            renderer.draw(target, "rgba8unorm", scene)
        assert renderer._letters.view is not None
        renderer.draw(target, "rgba8unorm", scene.but(contours=None))
        assert renderer._letters.view is None
    finally:
        renderer.close()


@pytest.mark.cases(1)
@pytest.mark.parametrize("wireframe", [False, True])
def test_both_backends_draw_the_terrains_lines_over_a_coarse_mesh(
    device: Device, terrain: Terrain, wireframe: bool
) -> None:
    """They are those of the terrain: where the mesh is pixels off, they are where they are without it."""
    scene = scenes(terrain)["slanted"].but(method="soar", tolerance=8.0, wireframe=wireframe, sky=False,
        contours=Contours(20.0, labels=wireframe),
    )  # fmt: skip
    cpu, gpu = draw_cpu(scene), draw_gpu(scene, device=device)
    bare = scene.but(contours=None)
    without = draw_cpu(bare), draw_gpu(bare, device=device)
    # (Edges of triangles, a pixel wide, are drawn by other means on each.)
    alike = np.linalg.norm(lab(without[0].pixels) - lab(without[1].pixels), axis=-1) < 1.5
    assert alike.mean() > (0.7 if wireframe else 0.95)
    apart = np.linalg.norm(lab(cpu.pixels) - lab(gpu.pixels), axis=-1)[alike]
    assert apart.mean() < 1.0 and np.quantile(apart, 0.95) < 3.0, (apart.mean(), np.quantile(apart, 0.95))
    marked = np.linalg.norm(lab(without[1].pixels) - lab(gpu.pixels), axis=-1)[alike] > 8
    assert marked.mean() > 0.03 and apart[marked].mean() < 3.0, apart[marked].mean()


@pytest.mark.parametrize("slow", [False, True])
def test_labels_stand_on_the_mesh_that_is_drawn(device: Device, terrain: Terrain, slow: bool) -> None:
    """However far off the mesh is: where a ray through a label's middle meets it, the terrain has that height."""
    scene = scenes(terrain)["slanted"].but(method="soar", tolerance=25.0, sky=False, samples=1)
    placed = []
    place = Placer.place

    def remembered(self: Placer, *args: object) -> Labels:
        placed.append(place(self, *args))  # type: ignore[arg-type]
        return placed[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Placer, "place", remembered)
        picture = draw_cpu(scene) if slow else draw_gpu(scene, device=device)
    middle = placed[-1].lines[:, POINTS // 2]
    assert len(middle) >= 3
    pixels, depth = scene.view.project(middle)
    shown = picture.depth[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    assert (np.abs(shown / depth - 1) < 0.01).all()
    assert np.abs(middle[:, 2] - placed[-1].heights).max() > 5.0  # the mesh is elsewhere than the terrain
