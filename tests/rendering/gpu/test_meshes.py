"""Meshes of other methods on the GPU: the same surface as the CPU's cast of the same mesh, wherever the eye stands."""

from __future__ import annotations

import time

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.rendering.cpu.draw import draw as draw_cpu
from orograph.rendering.gpu.draw import draw as draw_gpu
from orograph.rendering.gpu.frame import Overlay
from orograph.rendering.gpu.renderer import Renderer
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

SIZE = (200, 140)
EAST, NORTH = 700_000.0, 5_300_000.0


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    """Hills, a hole in them, on a raster that is no power of two a side."""
    y, x = np.mgrid[:301, :420] * 20.0
    z = 300 + 200 * np.sin(x / 900) * np.cos(y / 700) + 60 * np.sin(x / 170 + y / 230)
    z[100:110, 200:215] = np.nan
    return in_memory(
        Dem(
            z.astype(np.float32),
            Grid(z.shape, Affine(20.0, 0, EAST, 0, -20.0, NORTH), CRS.from_epsg(32632)),
        )
    )


def views() -> dict[str, View]:
    middle = (EAST + 4200.0, NORTH - 3000.0, 300.0)
    return {
        "slanted": View((EAST + 4000.0, NORTH - 12_000.0, 4000.0), middle, width=SIZE[0], height=SIZE[1]),
        "near": View((EAST + 4200.0, NORTH - 4200.0, 520.0), middle, width=SIZE[0], height=SIZE[1]),
        "plan": View((middle[0], middle[1], 9000.0), middle, projection="plan", width=SIZE[0], height=SIZE[1]),
    }


@pytest.mark.cases(1)
@pytest.mark.parametrize(
    "method",
    [
        "soar",
        "roam",
        "top-down",
        "stateless",
        "threshold-spheres",
        "triangle-patches,legs=8",
        "restricted-quadtree",
        "smart,cells=16",
        "seamless-patches",
        "cdlod",
        "chunked-lod,cells=16",
        "chunked-lod,cells=16,compressed=yes",
        "bdam",
        "bdam,legs=8,geomorph=yes",
        "clipmap,n=63",
        "cbt",
    ],
)
def test_depths_are_those_of_the_cast_of_the_same_mesh(device: Device, terrain: Terrain, method: str) -> None:
    for name, view in views().items():
        scene = Scene.of(terrain, view, method=method, tolerance=3.0, samples=1)
        drawn = draw_gpu(scene, device=device)
        cast = draw_cpu(scene)
        assert drawn.facts["mesh"]["triangles"] == cast.facts["mesh"]["triangles"], name
        both = np.isfinite(drawn.depth) & np.isfinite(cast.depth)
        assert (np.isfinite(drawn.depth) == np.isfinite(cast.depth)).mean() > 0.995, name
        off = np.abs(drawn.depth - cast.depth)[both] / cast.depth[both]
        # Beside a ridge the two may see either side of it: such pixels are few. (Hardware moves vertices to 1/256 of a
        # pixel, and by that the depths beside them.)
        usual = 2e-6 if device.adapter.software else 1e-5
        assert np.quantile(off, 0.99) < 1e-4 and np.median(off) < usual, (name, np.quantile(off, 0.99))


@pytest.mark.stress
def test_the_gpu_streams_patches_unless_they_are_asked_for_otherwise(device: Device, terrain: Terrain) -> None:
    scene = Scene.of(terrain, views()["slanted"], tolerance=3.0, samples=1)
    own = draw_gpu(scene, device=device)
    named = draw_gpu(scene.but(method="triangle-patches"), device=device)
    assert "mesh" not in named.facts and named.facts["patches"] == own.facts["patches"] > 0
    np.testing.assert_array_equal(own.pixels, named.pixels)
    few = draw_gpu(scene.but(method="triangle-patches", tolerance=None, triangles=100_000), device=device)
    assert 50_000 < few.facts["mesh"]["triangles"] <= 100_000
    with pytest.raises(UsageError, match="mesh that a method makes"):
        draw_gpu(scene.but(method="raycast", tolerance=None, triangles=1000), device=device)


@pytest.mark.stress
def test_a_mesh_for_another_camera_and_its_edges(device: Device, terrain: Terrain) -> None:
    """Refined for the near view, seen from afar: coarse where that did not look, edges drawn."""
    scene = Scene.of(terrain, views()["slanted"], method="soar", tolerance=2.0, mesh_view=views()["near"], samples=1)
    from_near, own = draw_gpu(scene, device=device), draw_gpu(scene.but(mesh_view=None), device=device)
    assert from_near.facts["mesh"]["triangles"] != own.facts["mesh"]["triangles"]
    # As much ink as on the CPU: edges of triangles of a few pixels are fainter.
    for tolerance in (0.3, 2.0, 8.0):
        framed = scene.but(mesh_view=None, wireframe=True, tolerance=tolerance)
        plain = draw_gpu(scene.but(method="auto", mesh_view=None), device=device).pixels.astype(int)
        edges, theirs = draw_gpu(framed, device=device).pixels.astype(int), draw_cpu(framed).pixels.astype(int)
        ink, ours = float((plain - theirs).mean()), float((plain - edges).mean())
        assert ink > 2.0 and 0.7 < ours / ink < 1.4, (tolerance, ours, ink)


def test_faces_are_flat_and_lit_as_the_cpu_lights_them(device: Device, terrain: Terrain) -> None:
    scene = Scene.of(
        terrain, views()["near"], method="soar", tolerance=8.0, samples=1, shadows=False, colormap="grey", water=None,
        relief=1.0,
    )  # fmt: skip
    drawn, cast = draw_gpu(scene, device=device).pixels.astype(int), draw_cpu(scene).pixels.astype(int)
    assert np.quantile(np.abs(drawn - cast).max(-1), 0.75) <= 8


def test_frames_do_not_wait_for_the_method(device: Device, terrain: Terrain) -> None:
    """Patches stand in at first; then the mesh follows the camera, and what is drawn says whether it has caught up."""
    renderer = Renderer(device, terrain)
    texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    target = texture.create_view()
    scene = Scene.of(terrain, views()["slanted"], method="roam", tolerance=2.0)
    try:
        first = renderer.draw(target, "rgba8unorm", scene)
        assert first.patches > 0 and not first.current and renderer.busy
        counts = []
        for view in (views()["slanted"], views()["near"]):
            end = time.perf_counter() + 300  # (its kernels may have to be compiled)
            stats = renderer.draw(target, "rgba8unorm", scene.but(view=view))
            while not stats.current and time.perf_counter() < end:
                time.sleep(0.01)
                stats = renderer.draw(target, "rgba8unorm", scene.but(view=view))
                assert np.isfinite(renderer.depth()).any()
            assert stats.current and stats.patches == 0
            counts.append(stats.triangles)
        assert counts[0] != counts[1]
        frozen = renderer.draw(target, "rgba8unorm", scene, freeze=views()["near"])
        assert frozen.current and frozen.triangles == counts[1]
        assert renderer.draw(target, "rgba8unorm", scene.but(method="auto")).patches > 0
    finally:
        renderer.close()


def test_a_method_that_cannot_says_why_and_patches_stay(device: Device, terrain: Terrain) -> None:
    renderer = Renderer(device, terrain)
    texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
    scene = Scene.of(terrain, views()["slanted"], method="soar", tolerance=2.0, exaggeration=1.0)
    object.__setattr__(scene.surface, "method", "unheard-of")
    try:
        end = time.perf_counter() + 30
        stats = renderer.draw(texture.create_view(), "rgba8unorm", scene)
        while not stats.failed and time.perf_counter() < end:
            time.sleep(0.01)
            stats = renderer.draw(texture.create_view(), "rgba8unorm", scene, overlay=Overlay(levels=True))
        assert "unheard-of" in stats.failed and stats.patches > 0
    finally:
        renderer.close()
