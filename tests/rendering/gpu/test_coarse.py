"""Large images without overviews on the GPU: frames go on while coarse levels are made, and end as the CPU draws."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from cielab import lab
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.geovis import coarse
from orograph.geovis.coarse import CoarseLevels
from orograph.geovis.layers import Layer
from orograph.gpu.device import Device
from orograph.rendering.cpu.draw import draw as cpu_draw
from orograph.rendering.gpu.draw import draw as gpu_draw
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.stream import imagery
from orograph.scene.camera import around
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain

SIDE = 9000
SIZE = (200, 130)


@pytest.fixture(scope="module")
def ground() -> Terrain:
    y, x = np.mgrid[:300, :300] * 20.0
    heights = 500 + 150 * np.sin(x / 700) * np.cos(y / 900)
    grid = Grid(heights.shape, Affine(20, 0, 500_000, 0, -20, 5_200_000), CRS.from_epsg(32632))
    return in_memory(Dem(heights.astype(np.float32), grid))


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("coarse") / "huge.tif"
    rng = np.random.default_rng(0)
    at = np.arange(SIDE) * 60 // SIDE
    cells = rng.integers(30, 220, (3, 60, 60), np.uint8)
    with rasterio.open(
        path, "w", driver="GTiff", count=3, height=SIDE, width=SIDE, dtype="uint8", crs=CRS(32632).to_wkt(),
        transform=Affine(6000 / SIDE, 0, 500_000, 0, -6000 / SIDE, 5_200_000), tiled=True, blockxsize=512,
        blockysize=512, photometric="rgb", compress="deflate", zlevel=1,
    ) as file:  # fmt: skip
        file.write(cells[:, at[:, None], at[None, :]])
    return str(path)


@pytest.fixture
def scene(ground: Terrain, image: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Scene:
    monkeypatch.setenv("OROGRAPH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(coarse, "MUCH", 1 << 22)
    monkeypatch.setattr(imagery, "MORE", 0.2)
    view = around(ground, SIZE, azimuth=200, pitch=12, distance=2500)
    return Scene.of(ground, view, layers=(Layer(image),), light="none", tolerance=0.5, samples=1, water=None)


class Screen:
    def __init__(self, device: Device, terrain: Terrain) -> None:
        self.device, self.renderer = device, Renderer(device, terrain, gpu_memory=1 << 27)
        self.texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")
        self.target = self.texture.create_view()

    def draw(self, scene: Scene, **options: object) -> NDArray[np.float64]:
        self.stats = self.renderer.draw(self.target, "rgba8unorm", scene, **options)  # type: ignore[arg-type]
        return lab(self.device.read_texture(self.texture, np.uint8, 4)[..., :3])


@pytest.mark.stress
def test_both_backends_draw_the_same(device: Device, scene: Scene) -> None:
    ours = gpu_draw(scene, device=device)
    kept = next(Path(coarse.cache_folder() / "images").iterdir())
    assert len(list(kept.glob("*_*"))) == 9
    caster = cpu_draw(scene.but(max_memory=200 << 20))
    both = np.isfinite(ours.depth) & np.isfinite(caster.depth)
    off = np.linalg.norm(lab(ours.pixels) - lab(caster.pixels), axis=-1)[both]
    assert off.mean() < 1.0 and np.percentile(off, 95) < 3.0
    bare = gpu_draw(scene.but(layers=()), device=device)
    assert np.linalg.norm(lab(ours.pixels) - lab(bare.pixels), axis=-1)[both].mean() > 10


@pytest.mark.stress
def test_frames_go_on_and_fill_in_while_levels_are_made(
    device: Device, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    go, read = threading.Semaphore(0), CoarseLevels._read

    def slowly(self: CoarseLevels, *more: object) -> None:
        assert go.acquire(timeout=60)
        read(self, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(CoarseLevels, "_read", slowly)
    screen = Screen(device, scene.terrain)
    bare = screen.draw(scene.but(layers=()))
    took, said, notes, shown = [], "", (), bare
    end = time.monotonic() + 30
    while time.monotonic() < end and not (said and screen.renderer.imagery.waiting):
        shown = screen.draw(scene)
        said, notes = screen.stats.making or said, notes + screen.stats.notes
    assert "huge.tif" in said and any("no overviews" in note for note in notes)
    for _ in range(20):
        shown = screen.draw(scene)
        took.append(screen.stats.submit_ms)
    assert np.median(took) < 33  # while making is held up, and a layer's tiles with it
    go.release(2)
    time.sleep(0.5)
    for _ in range(30):
        some = screen.draw(scene)
        time.sleep(0.02)
    go.release(100)
    end = time.monotonic() + 60
    while time.monotonic() < end and (screen.stats.making or not screen.renderer.resting):
        shown = screen.draw(scene)
    other = Screen(device, scene.terrain)  # everything is there
    whole = other.draw(scene)
    while time.monotonic() < end and not other.renderer.resting:
        whole = other.draw(scene)

    def far(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
        return float(np.linalg.norm(one - other, axis=-1).mean())

    assert far(bare, whole) > 10 and far(some, whole) < 0.9 * far(bare, whole)
    assert far(shown, whole) < 1  # (the first of a picture's samples at rest lies where the camera came to it)
    for one in (screen, other):
        one.renderer.close()


def test_what_cannot_be_kept_is_told(
    device: Device, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cache").write_text("a file")
    screen = Screen(device, scene.terrain)
    end = time.monotonic() + 30
    while (time.monotonic() < end and not getattr(screen, "stats", None)) or not screen.stats.failed:
        screen.draw(scene)
    assert "cannot be kept" in screen.stats.failed and "OROGRAPH_CACHE" in screen.stats.failed
    screen.renderer.close()
