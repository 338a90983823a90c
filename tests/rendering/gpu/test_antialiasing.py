"""A moving picture: it flickers no more than a finely sampled one, leaves no ghosts, and comes to rest as if it was."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.rendering.gpu.renderer import Renderer
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.viewpoint import View

SIZE = (160, 100)


class Camera:
    """Draws views of rough ground."""

    def __init__(self, device: Device) -> None:
        rng = np.random.default_rng(3)
        y, x = np.mgrid[:500, :500]
        z = 150 * np.sin(x / 40) * np.cos(y / 50) + 4.0 * rng.choice([-1.0, 1.0], (500, 500))
        grid = Grid(z.shape, Affine(30, 0, 500_000, 0, -30, 5_300_000), CRS.from_epsg(32632))
        self.device, self.terrain = device, in_memory(Dem(z.astype(np.float32), grid))
        self.renderer = Renderer(device, self.terrain, gpu_memory=1 << 27)
        self.next = 0.0
        self.texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
        self.target = self.texture.create_view()
        view = View((501_500.0, 5_292_500.0, 700.0), (506_000.0, 5_292_500.0, 150.0), width=SIZE[0], height=SIZE[1])
        self.scene = Scene.of(self.terrain, view, tolerance=1.0, shadows=False, water=None, colormap="grey", sky=True)

    def moved(self, metres: float) -> Scene:
        view = self.scene.view
        step = np.array([0.8, 0.6, 0.0]) * metres
        eye, target = (tuple(float(v) for v in np.add(p, step)) for p in (view.eye, view.target))
        return self.scene.but(view=replace(view, eye=eye, target=target))

    def draw(self, scene: Scene, **options: object) -> NDArray[np.float64]:
        """A frame, of 12 a second at most, as many as software draws: haze is renewed once a second."""
        time.sleep(max(0.0, self.next - time.perf_counter()))
        self.next = time.perf_counter() + 1 / 12
        self.renderer.draw(self.target, "rgba8unorm", scene, **options)  # type: ignore[arg-type]
        return self.device.read_texture(self.texture, np.uint8, 4)[..., :3].astype(np.float64)

    def settle(self, scene: Scene) -> None:
        """Have what is made aside, tiles, light and the range of haze; then begin a picture anew."""
        end = time.monotonic() + 60
        self.draw(scene)
        while self.renderer.busy and time.monotonic() < end:
            self.draw(scene)
        self.renderer._antialiasing.forget()


@pytest.fixture
def camera(device: Device) -> Iterator[Camera]:
    made = Camera(device)
    made.draw(made.scene, wait=True, samples=1)
    yield made
    made.renderer.close()


def change(frames: list[NDArray[np.float64]]) -> float:
    return float(np.sqrt((np.diff(np.stack(frames), axis=0) ** 2).mean()))


@pytest.mark.cases(1)
@pytest.mark.parametrize("projection", ["perspective", "plan"])
def test_a_slow_flight_changes_no_more_than_a_fine_one(camera: Camera, projection: str) -> None:
    if projection == "plan":
        view = replace(camera.scene.view, eye=(507_500.0, 5_292_500.0, 9000.0), target=(507_500.0, 5_292_500.0, 0.0))
        camera.scene = camera.scene.but(view=replace(view, projection="plan", fov_y=40.0))
    slow = camera.scene.view.pixel_slope * 4000.0 / 5
    scenes = [camera.moved(slow * k) for k in range(18)]
    rough = change([camera.draw(s, wait=True, samples=1) for s in scenes[-6:]])
    fine = change([camera.draw(s, wait=True, samples=16) for s in scenes[-6:]])
    camera.settle(scenes[0])
    drawn = [camera.draw(s) for s in scenes]
    assert rough > (1.3 if projection == "perspective" else 1.1) * fine  # there is something to shimmer
    assert change(drawn[-6:]) < 1.05 * fine
    # And it is not bought by blur: as near to the fine picture as one of a single sample.
    if projection == "plan":
        return  # (haze over whole plans differs by a shade while it is made aside)
    last = [camera.draw(scenes[-1], wait=True, samples=n) for n in (1, 16)]
    assert np.abs(drawn[-1] - last[1]).mean() < np.abs(last[0] - last[1]).mean()


@pytest.mark.stress
def test_the_horizon_does_not_follow_every_sample(camera: Camera) -> None:
    """Hills a pixel high, one behind another, seen at a grazing angle: the samples of a frame tell little of the mean,
    and nor do those of the pixels around it."""
    slow = camera.scene.view.pixel_slope * 3000.0 / 5
    scenes = [camera.moved(slow * k) for k in range(40)]
    fine = [camera.draw(s, wait=True, samples=16) for s in scenes[-6:]]
    there = np.isfinite(camera.renderer.depth())
    top, row = np.where(there.any(0), there.argmax(0), SIZE[1]), np.arange(SIZE[1])[:, None]
    band = (row >= top - 1) & (row < top + 8)
    rough = [camera.draw(s, wait=True, samples=1) for s in scenes[-6:]]
    camera.settle(scenes[0])
    drawn = [camera.draw(s) for s in scenes][-6:]

    def flicker(frames: list[NDArray[np.float64]]) -> float:
        return change([frame[band] for frame in frames])

    assert flicker(rough) > 2 * flicker(fine)
    assert flicker(drawn) < 1.3 * flicker(fine)
    assert np.abs(drawn[-1] - fine[-1])[band].mean() < 0.5 * np.abs(rough[-1] - fine[-1])[band].mean()


@pytest.mark.stress
def test_what_a_ridge_uncovers_has_no_ghost_of_it(camera: Camera) -> None:
    """A bright wall before dark ground, passed sideways by a pixel a frame: beside it the ground is dark."""
    z = np.full((300, 300), 0.0, np.float32)
    z[150:152, 100:140] = 300.0
    grid = Grid(z.shape, Affine(30, 0, 500_000, 0, -30, 5_300_000), CRS.from_epsg(32632))
    terrain = in_memory(Dem(z, grid))
    renderer, made = camera.renderer, camera
    made.renderer = Renderer(made.device, terrain, gpu_memory=1 << 27)
    renderer.close()
    eye, target = (503_600.0, 5_294_000.0, 400.0), (503_600.0, 5_296_000.0, 100.0)
    view = View(eye, target, width=SIZE[0], height=SIZE[1])
    scene = Scene.of(terrain, view, tolerance=0.5, shadows=False, water=None, colormap="grey", light="none")
    step = np.array([view.pixel_slope * 1500.0, 0.0, 0.0])

    def moved(k: int) -> Scene:
        here = (tuple(float(v) for v in np.add(p, k * step)) for p in (eye, target))
        return scene.but(view=replace(view, **dict(zip(("eye", "target"), here, strict=True))))

    made.draw(moved(0), wait=True, samples=1)
    drawn = [made.draw(moved(k)) for k in range(24)][-1]
    fine = made.draw(moved(23), wait=True, samples=16)
    assert np.ptp(fine) > 40  # the wall stands out
    assert np.quantile(np.abs(drawn - fine), 0.98) < 6


def test_a_jump_leaves_no_ghost(camera: Camera) -> None:
    for k in range(8):
        camera.draw(camera.moved(2.0 * k))
    there = camera.moved(2500.0)
    shown, plain = camera.draw(there), camera.draw(there, wait=True, samples=1)
    for k in range(8):
        camera.draw(camera.moved(2.0 * k))
    camera.renderer._antialiasing.forget()
    alone = camera.draw(there)
    # As far from the plain frame as one that knows nothing of what was before.
    assert np.abs(shown - plain).mean() < np.abs(alone - plain).mean() + 3.0


@pytest.mark.stress
def test_at_rest_it_is_the_mean_of_its_own_samples(camera: Camera) -> None:
    for k in range(8):
        camera.draw(camera.moved(2.0 * k))
    scene, end = camera.moved(16.0), time.monotonic() + 60
    shown = camera.draw(scene)
    while not camera.renderer.resting and time.monotonic() < end:
        shown = camera.draw(scene)
    fine = camera.draw(scene, wait=True, samples=16)
    assert np.abs(shown - fine).mean() < 1.0 and np.quantile(np.abs(shown - fine), 0.99) < 8
