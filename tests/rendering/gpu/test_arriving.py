"""A slow flight while tiles stream in: away from the new tiles the picture changes no more than when all are there."""

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
from orograph.rendering.gpu.stream import residency
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.terrain import TILE
from orograph.viewpoint import View

SIZE = (200, 120)
LEAD, FRAMES = 40, 24
Floats = NDArray[np.float64]


class Flight:
    """Hills with every sample 4 m up or down, passed low and slowly."""

    def __init__(self, device: Device) -> None:
        rng = np.random.default_rng(3)
        y, x = np.mgrid[:1800, :1800]
        z = 150 * np.sin(x / 40) * np.cos(y / 50) + 4.0 * rng.choice([-1.0, 1.0], x.shape)
        grid = Grid(z.shape, Affine(30, 0, 500_000, 0, -30, 5_300_000), CRS.from_epsg(32632))
        self.device, self.terrain = device, in_memory(Dem(z.astype(np.float32), grid))
        self.renderer = Renderer(device, self.terrain, gpu_memory=1 << 28)
        self.next = 0.0
        self.texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
        self.target = self.texture.create_view()
        view = View((508_000.0, 5_273_000.0, 900.0), (520_000.0, 5_273_000.0, -300.0), width=SIZE[0], height=SIZE[1])
        self.scene = Scene.of(self.terrain, view, tolerance=1.0, shadows=False, water=None, colormap="grey", sky=True)

    def moved(self, frame: int) -> Scene:
        view = self.scene.view
        step = np.array([0.8, 0.6, 0.0]) * view.pixel_slope * 3000.0 / 5 * frame
        eye, target = (tuple(float(v) for v in np.add(p, step)) for p in (view.eye, view.target))
        return self.scene.but(view=replace(view, eye=eye, target=target))

    def draw(self, scene: Scene, **options: object) -> Floats:
        """A frame, of 12 a second at most, as many as software draws: haze is renewed once a second."""
        time.sleep(max(0.0, self.next - time.perf_counter()))
        self.next = time.perf_counter() + 1 / 12
        self.stats = self.renderer.draw(self.target, "rgba8unorm", scene, **options)  # type: ignore[arg-type]
        return self.device.read_texture(self.texture, np.uint8, 4)[..., :3].astype(np.float64)

    def samples(self, scene: Scene) -> Floats:
        """Column and row (height, width, 2) of the ground in the last frame's pixels, NaN where there is none."""
        depth = self.renderer.depth().astype(np.float64)[..., None]
        o0, ou, ov, d0, du, dv = scene.view.ray_basis(1.0)
        px, py = np.arange(SIZE[0])[None, :, None] + 0.5, np.arange(SIZE[1])[:, None, None] + 0.5
        at = o0 + px * ou + py * ov + depth * (d0 + px * du + py * dv)
        return np.stack(self.terrain.grid.index(at[..., 0], at[..., 1]), -1)


@pytest.fixture
def flight(device: Device, monkeypatch: pytest.MonkeyPatch) -> Iterator[Flight]:
    made = Flight(device)
    made.renderer.tiles.look_ahead = False
    yield made
    made.renderer.close()


def flicker(frames: list[Floats], mask: NDArray[np.bool_]) -> float:
    return float(np.sqrt((np.diff(np.stack(frames), axis=0)[:, mask] ** 2).mean()))


@pytest.mark.stress
def test_what_is_away_from_new_tiles_does_not_flicker(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [flight.moved(k) for k in range(LEAD + FRAMES)]
    flight.draw(scenes[-1], wait=True, samples=1)  # everything is there, and compiled
    where = flight.samples(scenes[-1])
    horizon = np.isfinite(where).all(-1)
    top = np.where(horizon.any(0), horizon.argmax(0), SIZE[1])
    band = (np.arange(SIZE[1])[:, None] >= top - 1) & (np.arange(SIZE[1])[:, None] < top + 10)

    def flown() -> list[Floats]:
        flight.renderer._antialiasing.forget()
        return [flight.draw(scene) for scene in scenes][-FRAMES:]

    settled = flown()
    # The same again, but tiles right before the camera come anew in every frame.
    near = tuple(int(v) // TILE for v in np.nanmedian(where[-8:], axis=(0, 1)))
    insert, key = residency.Residency._upload, (0, near[1], near[0])

    def upload(self: residency.Residency, wait: bool) -> None:
        insert(self, wait)
        self.came.append(key)

    monkeypatch.setattr(residency.Residency, "_upload", upload)
    streaming = flown()
    rows, cols = (where[..., k] // TILE == near[1 - k] for k in (1, 0))
    away = band & ~np.asarray((where[..., 0] // TILE == near[0]) & (where[..., 1] // TILE == near[1]))
    assert rows.any() and cols.any() and away.mean() > 0.05
    assert (~away & horizon).mean() > 0.05
    assert flicker(streaming, away) <= 1.02 * flicker(settled, away)


@pytest.mark.stress
def test_tiles_that_come_leave_nothing_of_what_was_there(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    """One tile a frame: after the last one the picture is as good as one that was begun then, with all of them."""
    monkeypatch.setattr(residency, "UPLOAD", 1)
    # Maps of light and the range of haze come when they come.
    flight.scene = flight.scene.but(light="none", sky=False)
    came: list[int] = []
    k = since = 0
    end = time.monotonic() + 60
    while since < 13 and time.monotonic() < end:
        shown = flight.draw(flight.moved(k))
        came.append(flight.stats.tiles_loaded)
        k += 1
        since = since + 1 if k > 10 and not came[-1] and not flight.renderer.busy else 0
    assert sum(came) > 12
    fine = flight.draw(flight.moved(k - 1), wait=True, samples=16)
    flight.renderer._antialiasing.forget()
    for frame in range(k - 13, k):
        begun = flight.draw(flight.moved(frame))
    off = [float(np.abs(picture - fine).mean()) for picture in (shown, begun)]
    assert off[0] < 1.1 * off[1]
