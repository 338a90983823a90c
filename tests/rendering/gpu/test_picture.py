"""Pictures by the GPU are those by the CPU: the promise in pixels, colours within a stated difference, on real data.

The truth for the promise is the full-resolution surface itself, interpolated here in the triangles of the hierarchy.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cielab import lab
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from orograph.dem.raster import Dem
from orograph.errors import NothingInViewError, UsageError
from orograph.geovis.layers import Layer
from orograph.gpu.device import Device
from orograph.lighting.aperture import Lamp
from orograph.lighting.sun import Sun
from orograph.rendering.cpu.draw import draw as cpu_draw
from orograph.rendering.gpu.draw import draw as gpu_draw
from orograph.scene.camera import around, plan, whole
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.prepare import prepare
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

SETS = {
    "bigtujunga": "bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif",
    "n44w072": "n44w072-hgt/N44W072.hgt",
    "rainier": "osgearth-srtm90m-volcano-voids/mt_rainier_90m.tif",
    "fortbragg": "fortbragg-1m-dem-ortho/elevation_2016.tif",
    "city": "nrw-dom1-1m/dom1_32_356_5699_1_nw_2020.tif",
    "fuji": "osgearth-srtm90m-volcano-voids/mt_fuji_90m.tif",
}

SIZE = (320, 200)


def surface(terrain: Terrain, col: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of the full-resolution surface: every cell is cut from its (even, even) or (odd, odd) corners."""
    rows, cols = terrain.grid.shape
    z = terrain.read(0, 0, rows, 0, cols).astype(np.float64)
    j, i = np.clip(np.floor(col).astype(int), 0, cols - 2), np.clip(np.floor(row).astype(int), 0, rows - 2)
    u, v = col - j, row - i
    a, b, c, d = z[i, j], z[i, j + 1], z[i + 1, j], z[i + 1, j + 1]
    falling = np.where(u >= v, a + u * (b - a) + v * (d - b), a + v * (c - a) + u * (d - c))
    rising = np.where(u + v <= 1, a + u * (b - a) + v * (c - a), d + (1 - u) * (c - d) + (1 - v) * (b - d))
    return np.where((i + j) % 2 == 0, falling, rising)


def open_set(shared_data: Path, name: str) -> Terrain:
    path = shared_data / SETS[name]
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return prepare([str(path)])


def scene_of(terrain: Terrain, kind: str) -> Scene:
    """All of a terrain, a part from near by, or a plan."""
    reach = min(terrain.grid.shape) * float(np.mean(terrain.grid.spacing))
    views = {
        "whole": lambda: whole(terrain, SIZE),
        "near": lambda: around(terrain, SIZE, azimuth=200, pitch=18, distance=0.2 * reach),
        "plan": lambda: plan(terrain, SIZE),
    }
    return Scene.of(terrain, views[kind](), sky=kind != "plan", tolerance=1.0)


def displacement(terrain: Terrain, view: View, depth: NDArray[np.float32]) -> NDArray[np.float64]:
    """Pixels on the screen between what was hit and the surface above or below it."""
    y, x = np.nonzero(np.isfinite(depth))
    o0, ou, ov, d0, du, dv = view.ray_basis()
    px, py, t = (x + 0.5)[:, None], (y + 0.5)[:, None], depth[y, x].astype(np.float64)[:, None]
    hit = o0 + px * ou + py * ov + t * (d0 + px * du + py * dv)
    col, row = terrain.grid.index(hit[:, 0], hit[:, 1])
    rows, cols = terrain.grid.shape
    true = hit.copy()
    true[:, 2] = surface(terrain, np.clip(col, 0, cols - 1), np.clip(row, 0, rows - 1))
    a, b = view.project(hit)[0], view.project(true)[0]
    off = np.hypot(*(a - b).T)
    return off[np.isfinite(off)]


def beside_edges(seen: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    """Pixels up to so far from where ground and no ground meet."""
    around = np.ones((2 * pixels + 1, 2 * pixels + 1), bool)
    return np.asarray(binary_dilation(seen, around) & binary_dilation(~seen, around))


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", sorted(SETS))
@pytest.mark.parametrize("kind", ["whole", "near", "plan"])
def test_it_is_the_cpus_picture(device: Device, shared_data: Path, name: str, kind: str) -> None:
    terrain = open_set(shared_data, name)
    scene = scene_of(terrain, kind)
    ours = gpu_draw(scene, device=device)
    caster = cpu_draw(Scene.of(terrain, scene.view, sky=scene.lighting.sky, tolerance=0.0))

    assert displacement(terrain, scene.view, ours.depth).max() <= 1.0 + 0.02
    seen, theirs = np.isfinite(ours.depth), np.isfinite(caster.depth)
    if ours.void_filled is not None and caster.void_filled is not None:  # ground may show beyond what is missing
        seen, theirs = seen | ours.void_filled, theirs | caster.void_filled
    # Two pixels from where ground ends there is ground in both, or in neither.
    assert not (seen != theirs)[2:-2, 2:-2][~beside_edges(theirs, 2)[2:-2, 2:-2]].any()
    difference = np.linalg.norm(lab(ours.pixels) - lab(caster.pixels), axis=-1)
    assert difference.mean() < 1.0
    assert np.percentile(difference, 95) < 3.0
    assert not (ours.pixels == 0).all(-1).any()


def test_imagery_lies_where_the_cpu_lays_it(device: Device, shared_data: Path) -> None:
    terrain = open_set(shared_data, "fortbragg")
    image = shared_data / "fortbragg-1m-dem-ortho/naip_2014_rgb.tif"
    view = around(terrain, SIZE, azimuth=150, pitch=30, distance=900)
    scene = Scene.of(terrain, view, layers=(Layer(str(image)),), tolerance=1.0)
    difference = lab(gpu_draw(scene, device=device).pixels) - lab(cpu_draw(scene).pixels)
    assert np.linalg.norm(difference, axis=-1).mean() < 1.5


@pytest.mark.cases(1)
@pytest.mark.parametrize("light", ["none", "ao", "aperture", "lamps", "raytraced", "lamps by rays", "unhidden"])
def test_light_falls_as_on_the_cpu(device: Device, shared_data: Path, light: str) -> None:
    terrain = open_set(shared_data, "bigtujunga")
    view = around(terrain, SIZE, azimuth=200, pitch=20, distance=9000)
    more: dict[str, Any] = {}
    if light == "unhidden":  # where nothing casts shadows all discs shine
        more["discs"] = ((Sun(90, 30, 10.0), (0.2, 0.2, 0.6)),)
        more["shadows"], light = False, "aperture"
    if light.startswith("lamps"):
        high = float(terrain.read(0, 400, 401, 600, 601)[0, 0]) + 300
        more["lamps"] = (Lamp(600.0, 300.0, high, (4e5, 2e5, 1e5)),)
        more["discs"] = ((Sun(90, 30, 10.0), (0.2, 0.2, 0.6)),)
        light = "raytraced" if light == "lamps by rays" else "aperture"
    scene = Scene.of(terrain, view, sun=Sun(290, 20), light=light, tolerance=1.0, rays=16, **more)  # type: ignore[arg-type]
    ours, caster = gpu_draw(scene, device=device), cpu_draw(scene)
    difference = np.linalg.norm(lab(ours.pixels) - lab(caster.pixels), axis=-1)
    assert difference.mean() < 1.0
    assert np.percentile(difference, 95) < 3.0


@pytest.mark.stress
@pytest.mark.parametrize("name", ["bigtujunga", "city"])
def test_edges_of_long_shadows_lie_where_the_cpus_do(device: Device, shared_data: Path, name: str) -> None:
    """The sun low, the ground seen from the side: hardly more pixels differ visibly than where rays find all light.

    Most of either are silhouettes, where samples meet other triangles. (Of maps of horizons ten times as many.)
    """
    terrain = open_set(shared_data, name)
    far = 0.35 * max(terrain.grid.shape) * min(terrain.grid.spacing)
    view = around(terrain, SIZE, azimuth=225, pitch=8, distance=far)
    plainly: dict[str, Any] = {"sky": False, "colormap": "grey", "water": None, "samples": 4, "tolerance": 0.5}

    def differing(light: Any) -> float:
        scene = Scene.of(terrain, view, sun=Sun(300, 6), light=light, **plainly)
        difference = lab(gpu_draw(scene, device=device).pixels) - lab(cpu_draw(scene).pixels)
        return float((np.linalg.norm(difference, axis=-1) > 6).mean())

    assert differing("ao") <= 1.1 * differing("raytraced")


@pytest.mark.stress
def test_missing_ground_is_hatched_and_has_no_depth(device: Device, shared_data: Path) -> None:
    terrain = open_set(shared_data, "rainier")
    scene = Scene.of(terrain, plan(terrain, SIZE), samples=1)
    ours, caster = gpu_draw(scene, device=device), cpu_draw(scene)
    assert ours.void_filled is not None and caster.void_filled is not None
    # A hole's edge is off by a triangle at most, and those there are no larger than a pixel.
    assert (ours.void_filled != caster.void_filled).mean() < 0.01
    rows, cols = terrain.grid.shape
    row, col = np.nonzero(np.isnan(terrain.read(0, 0, rows, 0, cols)))
    x, y = scene.view.project(np.stack([*terrain.grid.xy(col, row), 0.0 * col], -1))[0].T
    truth = np.zeros(ours.void_filled.shape, bool)
    inside = (x >= 0) & (x < SIZE[0]) & (y >= 0) & (y < SIZE[1])
    truth[y[inside].astype(int), x[inside].astype(int)] = True
    assert not ours.void_filled[~binary_dilation(truth, np.ones((5, 5), bool))].any()
    assert not np.isfinite(ours.depth[ours.void_filled]).any()


@pytest.mark.stress
@pytest.mark.parametrize("kind", ["whole", "near", "plan"])
@pytest.mark.parametrize("name", ["rainier", "fuji"])
def test_voids_look_as_on_the_cpu(device: Device, shared_data: Path, name: str, kind: str) -> None:
    """Also where hundreds of them are a few pixels large: their hatching, and where they end."""
    terrain = open_set(shared_data, name)
    scene = scene_of(terrain, kind)
    ours = gpu_draw(scene, device=device)
    caster = cpu_draw(Scene.of(terrain, scene.view, sky=scene.lighting.sky, tolerance=0.0))
    voids = np.zeros(SIZE[::-1], bool)
    for picture in (ours, caster):
        if picture.void_filled is not None:
            voids |= picture.void_filled
    if not voids.any():
        pytest.skip("no voids are in view")
    difference = np.linalg.norm(lab(ours.pixels) - lab(caster.pixels), axis=-1)
    assert difference[voids].mean() < 1.0


@pytest.mark.stress
def test_heights_may_be_radii_of_a_body(device: Device, shared_data: Path) -> None:
    """Heights in the millions of metres are ground, and holes among them are holes."""
    low = open_set(shared_data, "rainier")
    rows, cols = low.grid.shape
    terrain = in_memory(Dem(low.read(0, 0, rows, 0, cols) + np.float32(1_737_400), low.grid))
    scene = Scene.of(terrain, whole(terrain, SIZE), samples=1, tolerance=1.0)
    ours, caster = gpu_draw(scene, device=device), cpu_draw(scene)
    assert ours.void_filled is not None and caster.void_filled is not None and caster.void_filled.any()
    assert (ours.void_filled != caster.void_filled).mean() < 0.01
    assert (np.isfinite(ours.depth) != np.isfinite(caster.depth)).mean() < 0.01
    assert np.isfinite(ours.depth).mean() > 0.2
    both = np.isfinite(ours.depth) & np.isfinite(caster.depth)
    assert np.percentile(np.abs(ours.depth - caster.depth)[both] / caster.depth[both], 95) < 0.01


@pytest.mark.stress
def test_exaggeration_stretches_the_picture_only(device: Device, shared_data: Path) -> None:
    terrain = open_set(shared_data, "bigtujunga")
    scene = Scene.of(terrain, whole(terrain, SIZE, exaggeration=3.0), exaggeration=3.0, tolerance=1.0)
    ours, caster = gpu_draw(scene, device=device), cpu_draw(scene)
    both = np.isfinite(ours.depth) & np.isfinite(caster.depth)
    assert (np.isfinite(ours.depth) != np.isfinite(caster.depth)).mean() < 0.005
    assert np.percentile(np.abs(ours.depth - caster.depth)[both] / caster.depth[both], 95) < 0.01


def test_an_empty_picture_is_an_error(device: Device, shared_data: Path) -> None:
    terrain = open_set(shared_data, "bigtujunga")
    up = View((390000.0, 3800000.0, 5000.0), (390000.0, 3800000.1, 9000.0), width=64, height=48)
    with pytest.raises(NothingInViewError):
        gpu_draw(Scene.of(terrain, up), device=device)


def test_a_picture_too_large_for_the_device_is_refused(device: Device, shared_data: Path) -> None:
    terrain = open_set(shared_data, "bigtujunga")
    with pytest.raises(UsageError, match="at most"):
        gpu_draw(Scene.of(terrain, whole(terrain, (200_000, 64))), device=device)
