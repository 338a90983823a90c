"""Layers on the GPU: the CPU's picture within a stated difference, streamed without a hole, within a fixed memory."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from cielab import lab
from numpy.typing import NDArray
from pyproj import CRS, Transformer

from orograph.dem.raster import Dem
from orograph.errors import ReadError
from orograph.geo.grid import Grid, apply
from orograph.geovis.color import color_table, linear_to_srgb, srgb_to_linear
from orograph.geovis.keys import Legend
from orograph.geovis.layers import Layer
from orograph.gpu.device import Device
from orograph.rendering.cpu.draw import draw as cpu_draw
from orograph.rendering.gpu.draw import draw as gpu_draw
from orograph.rendering.gpu.frame import FrameStats
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.stream.image_tiles import SIDE, ImageTiles
from orograph.scene.camera import around, plan
from orograph.scene.scene import Scene
from orograph.store import terrain as in_memory
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

EAST, NORTH, METRES, SAMPLES = 500_000.0, 5_200_000.0, 20.0, 300
SPAN = METRES * SAMPLES
SIZE = (200, 130)
RED = np.array([200, 40, 40], np.uint8)


@pytest.fixture(scope="module")
def ground() -> Terrain:
    y, x = np.mgrid[:SAMPLES, :SAMPLES] * METRES
    heights = 500 + 150 * np.sin(x / 700) * np.cos(y / 900) + 20 * np.sin(x / 130 + y / 170)
    return in_memory(
        Dem(
            heights.astype(np.float32),
            Grid(heights.shape, Affine(METRES, 0, EAST, 0, -METRES, NORTH), CRS.from_epsg(32632)),
        )
    )


def write(path: Path, pixels: NDArray[np.uint8], transform: Affine | None = None, crs: Any = 32632, **more: Any) -> str:
    """pixels (rows, cols, bands), over the ground unless said otherwise."""
    rows, cols, bands = pixels.shape
    transform = transform or Affine(SPAN / cols, 0, EAST, 0, -SPAN / rows, NORTH)
    with rasterio.open(
        path, "w", driver="GTiff", count=bands, height=rows, width=cols, dtype=pixels.dtype, transform=transform,
        crs=CRS(crs).to_wkt(), tiled=True, **more,
    ) as file:  # fmt: skip
        file.write(np.moveaxis(pixels, -1, 0))
    return str(path)


def geographic(rows: int, cols: int) -> Affine:
    """A grid of degrees that covers the ground with something to spare."""
    x, y = np.meshgrid(EAST + SPAN * np.array([-0.02, 1.02]), NORTH - SPAN * np.array([-0.02, 1.02]))
    lon, lat = Transformer.from_crs(32632, 4326, always_xy=True).transform(x, y)
    west, east, south, north = lon.min(), lon.max(), lat.min(), lat.max()
    return Affine((east - west) / cols, 0, west, 0, -(north - south) / rows, north)


def patches(rows: int, cols: int, cells: int, seed: int = 0) -> NDArray[np.uint8]:
    """Random colours in squares, that many along a side."""
    colors = np.random.default_rng(seed).integers(20, 200, (cells, cells, 3), dtype=np.uint8)
    r, c = np.arange(rows) * cells // rows, np.arange(cols) * cells // cols
    return colors[r[:, None], c[None, :]]


def difference(scene: Scene, device: Device) -> NDArray[np.float64]:
    """ΔE*ab of both backends' pictures, where both show ground."""
    ours, caster = gpu_draw(scene, device=device), cpu_draw(scene)
    both = np.isfinite(ours.depth) & np.isfinite(caster.depth)
    return np.asarray(np.linalg.norm(lab(ours.pixels) - lab(caster.pixels), axis=-1)[both])


@pytest.mark.parametrize("kind", ["near", "grazing", "plan", "stretched"])
def test_two_layers_in_foreign_crs_are_the_cpus(device: Device, ground: Terrain, tmp_path: Path, kind: str) -> None:
    below = Layer(write(tmp_path / "a.tif", patches(1300, 1700, 40), geographic(1300, 1700), 4326))
    x0, y0 = Transformer.from_crs(32632, 3857, always_xy=True).transform(EAST + 700, NORTH - 900)
    pixels = np.dstack([patches(900, 900, 300, 1), np.full((900, 900, 1), 255, np.uint8)])
    pixels[200:300, :, 3] = 0
    pixels[300:400, :, 3] = 128
    above = write(tmp_path / "b.tif", pixels, Affine(6, 0, x0, 0, -6, y0), 3857)
    layers = (below, Layer(above, 0.6), Layer(above, 0.3, blend="multiply"))
    views = {
        "near": lambda: around(ground, SIZE, azimuth=210, pitch=35, distance=4000),
        "grazing": lambda: around(ground, SIZE, azimuth=160, pitch=5, distance=3000),
        "plan": lambda: plan(ground, SIZE),
        "stretched": lambda: around(ground, SIZE, azimuth=20, pitch=25, distance=6000, exaggeration=2.5),
    }
    scene = Scene.of(
        ground, views[kind](), layers=layers, light="none", tolerance=0.5, samples=1, water=None,
        exaggeration=2.5 if kind == "stretched" else 1.0,
    )  # fmt: skip
    off = difference(scene, device)
    assert off.mean() < 1.0
    assert np.percentile(off, 95) < 3.0


@pytest.mark.stress
def test_positions_are_good_to_a_tenth_of_a_texel(device: Device, ground: Terrain, tmp_path: Path) -> None:
    """An image of 30,000 pixels a side in degrees whose colour tells the column (8 levels a pixel), from so near that a
    pixel of it is many of the picture's. Beside what pyproj says of the ground under every pixel of the picture,
    colours are off by less than a tenth of a pixel's step, and a byte's rounding."""
    side = 30_000
    transform = geographic(side, side)
    path = tmp_path / "wide.tif"
    with rasterio.open(
        path, "w", driver="GTiff", count=1, height=side, width=side, dtype="uint8", transform=transform,
        crs=CRS(4326).to_wkt(), tiled=True, compress="deflate", sparse_ok=True, photometric="minisblack",
    ) as file:  # fmt: skip
        at = 24_000
        ramp = (40 + 8 * (np.arange(1024) % 16)).astype(np.uint8)
        file.write(np.broadcast_to(ramp, (1024, 1024)), 1, window=((at, at + 1024), (at, at + 1024)))
    lon, lat = apply(transform, at + 512, at + 512)
    to_metres = Transformer.from_crs(4326, 32632, always_xy=True)
    x, y = to_metres.transform(lon, lat)
    col, row = (round(float(v)) for v in ground.grid.index(x, y))
    z = float(ground.read(0, row, row + 1, col, col + 1)[0, 0]) + 2
    view = View((x, y - 3, z + 5), (x, y, z), fov_y=40, width=160, height=110)
    layer = Layer(str(path), colormap="grey", range=(0, 255))
    scene = Scene.of(ground, view, layers=(layer,), light="none", samples=1, water=None, tolerance=0.1)
    drawn = gpu_draw(scene, device=device).pixels[..., 0]
    depth = cpu_draw(scene.but(layers=(), tolerance=0.0)).depth
    py, px = np.mgrid[: view.height, : view.width][..., None] + 0.5
    o0, ou, ov, d0, du, dv = view.ray_basis(1.0)
    places = o0 + px * ou + py * ov + depth[..., None] * (d0 + px * du + py * dv)
    east, _ = to_metres.transform(places[..., 0], places[..., 1], direction="INVERSE")
    column = (east - transform.c) / transform.a - 0.5
    whole = np.floor(column).astype(int)
    told = whole % 16 != 15  # not where the ramp begins anew
    table = 255 * linear_to_srgb(color_table("grey", 256)[:, 0]).astype(float)
    expected = np.interp(40 + 8 * (whole % 16 + column - whole), np.arange(256), table)
    step = np.ptp(table) * 8 / 255
    off = (drawn - expected)[told]
    assert np.ptp(drawn) > 15  # the ramp is there
    assert told.mean() > 0.9
    assert abs(off.mean()) < 0.1 * step
    assert np.abs(off).mean() < 0.1 * step + 0.25
    assert np.percentile(np.abs(off), 99) < 0.1 * step + 1


@pytest.mark.stress
def test_there_are_no_seams_at_the_borders_of_tiles(device: Device, ground: Terrain, tmp_path: Path) -> None:
    """A smooth image of many tiles: no pixel is off by more than rounding, at any scale."""
    rows = np.linspace(30, 190, 1800)[:, None] + np.linspace(0, 30, 1800)[None, :]
    pixels = np.repeat(np.round(rows).astype(np.uint8)[..., None], 3, 2)
    beyond = Affine(SPAN * 1.04 / 1800, 0, EAST - 0.02 * SPAN, 0, -SPAN * 1.04 / 1800, NORTH + 0.02 * SPAN)
    layer = Layer(write(tmp_path / "smooth.tif", pixels, beyond))
    for distance in (900, 3000, 9000):
        view = around(ground, SIZE, azimuth=30, pitch=50, distance=distance)
        scene = Scene.of(ground, view, layers=(layer,), light="none", samples=1, water=None, tolerance=0.5)
        ours, caster = gpu_draw(scene, device=device), cpu_draw(scene)
        both = np.isfinite(ours.depth) & np.isfinite(caster.depth)
        off = np.abs(ours.pixels.astype(int) - caster.pixels).max(-1)[both]
        assert np.percentile(off, 99.5) <= 2
        assert off.max() <= 6  # silhouettes


def test_tiles_are_means_of_the_file_whether_it_has_overviews_or_not(ground: Terrain, tmp_path: Path) -> None:
    pixels = np.random.default_rng(3).integers(0, 255, (1801, 1703, 3), dtype=np.uint8)
    path = write(tmp_path / "a.tif", pixels)
    sheet = ImageTiles(Layer(path), ground)
    assert sheet.base == 1  # level 0 is read from the file, others are held
    linear = np.where(pixels / 255.0 <= 0.04045, pixels / 255.0 / 12.92, ((pixels / 255.0 + 0.055) / 1.055) ** 2.4)
    for place in (0, sheet.count // 2, sheet.count - 1):
        k = sheet.level_of(place)
        level = sheet.levels[k - sheet.finest]
        row, col = divmod(place - level.first, level.shape[1])
        tile = sheet.tile(place) / 255.0
        got = np.where(tile <= 0.04045, tile / 12.92, ((tile + 0.055) / 1.055) ** 2.4)
        for i, j in ((1, 1), (5, 9), (100, 30)):
            r, c = ((row + level.row0) * 256 + i - 1) << k, ((col + level.col0) * 256 + j - 1) << k
            block = linear[r : r + (1 << k), c : c + (1 << k)]
            if block.size:
                np.testing.assert_allclose(got[i, j, :3], block.mean((0, 1)), atol=0.006)
    with rasterio.open(path, "r+") as file:
        file.build_overviews([2, 4, 8], rasterio.enums.Resampling.average)
    again = ImageTiles(Layer(path), ground)
    assert (again.base, again.laid.overviews) == (1, (2, 4, 8))
    np.testing.assert_array_equal(again.tile(again.count - 1), sheet.tile(sheet.count - 1))


# ---- streaming ---------------------------------------------------------------------------------------------------


class Frames:
    """A renderer, and a target for its frames."""

    def __init__(self, device: Device, terrain: Terrain, gpu_memory: int = 1 << 28) -> None:
        self.device, self.renderer = device, Renderer(device, terrain, gpu_memory=gpu_memory)
        self.texture = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC")

    def draw(self, scene: Scene, **more: Any) -> tuple[FrameStats, NDArray[np.uint8]]:
        stats = self.renderer.draw(self.texture.create_view(), "rgba8unorm", scene, **more)
        return stats, self.device.read_texture(self.texture, np.uint8, 4)[..., :3].copy()

    def until(self, scene: Scene, done: Any, seconds: float = 60.0) -> tuple[FrameStats, NDArray[np.uint8]]:
        end = time.monotonic() + seconds
        while True:
            stats, pixels = self.draw(scene)
            if done(stats, pixels):
                return stats, pixels
            assert time.monotonic() < end, "it never came"
            time.sleep(0.02)


@pytest.fixture
def frames(device: Device, ground: Terrain) -> Iterator[Frames]:
    made = Frames(device, ground)
    yield made
    made.renderer.close()


def is_red(pixels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return (pixels[..., 0] > 100) & (pixels[..., 1] < 90) & (pixels[..., 2] < 90)


def noisy_red(side: int) -> NDArray[np.uint8]:
    noise = np.random.default_rng(0).integers(-20, 20, (side, side, 1))
    return np.clip(RED + noise, 0, 255).astype(np.uint8)


def scene_of(ground: Terrain, *layers: Layer, distance: float = 1500.0) -> Scene:
    view = around(ground, SIZE, azimuth=200, pitch=60, distance=distance)
    return Scene.of(ground, view, layers=layers, light="none", water=None, tolerance=1.0, depths=(1.0, 1e5))


@pytest.mark.stress
def test_a_coarser_tile_stands_in_and_there_is_never_a_hole(
    frames: Frames, ground: Terrain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layer = Layer(write(tmp_path / "red.tif", noisy_red(4000)))
    gate, read, plain = threading.Event(), [], ImageTiles.tile

    def tile(sheet: ImageTiles, place: int) -> NDArray[np.uint8]:
        read.append(place)
        if sheet.level_of(place) < sheet.base:
            assert gate.wait(60)
        return plain(sheet, place)

    monkeypatch.setattr(ImageTiles, "tile", tile)
    scene = scene_of(ground, layer, distance=250.0)
    frames.draw(scene.but(layers=()), wait=True)
    begun = time.perf_counter()
    frames.draw(scene)
    assert time.perf_counter() - begun < 5  # the file is opened by another thread
    stats, _ = frames.until(scene, lambda _, pixels: is_red(pixels).all())
    assert stats.tiles_wanted > 0 and frames.renderer.busy
    for _ in range(3):
        assert is_red(frames.draw(scene)[1]).all()
    _, coarse = frames.draw(scene, samples=1)
    gate.set()
    stats, fine = frames.until(scene, lambda stats, _: stats.tiles_wanted == 0)
    assert is_red(fine).all()
    _, fine = frames.draw(scene, samples=1)
    truth = cpu_draw(scene.but(samples=1)).pixels.astype(int)
    assert np.abs(fine - truth).mean() < 0.5 < 0.5 * np.abs(coarse - truth).mean()  # detail came
    # Another order, opacity, or a layer hidden for a while: nothing is read again.
    count = len(read)
    for other in (replace(layer, opacity=0.5), replace(layer, visible=False), layer, replace(layer, blend="multiply")):
        frames.draw(scene.but(layers=(other,)))
    frames.until(scene, lambda stats, _: stats.tiles_wanted == 0)
    assert len(read) == count
    np.testing.assert_array_equal(frames.draw(scene, samples=1)[1], frames.draw(scene, samples=1, wait=True)[1])


def test_painted_data_stay_until_those_that_replace_them_are_there(
    frames: Frames, ground: Terrain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate, plain = threading.Event(), ImageTiles.tile

    def tile(sheet: ImageTiles, place: int) -> NDArray[np.uint8]:
        assert "new" not in sheet.laid.layer.path or gate.wait(60)
        return plain(sheet, place)

    monkeypatch.setattr(ImageTiles, "tile", tile)
    green = np.zeros((300, 300, 3), np.uint8) + np.array([10, 200, 10], np.uint8)
    old, new = (
        Layer(write(tmp_path / name, pixels), key=Legend(note=name))
        for name, pixels in (("old.tif", noisy_red(300)), ("new.tif", green))
    )
    plainly = replace(new, key=None)
    frames.draw(scene_of(ground, old), wait=True)
    for _ in range(8):  # while its tiles are kept from coming
        assert is_red(frames.draw(scene_of(ground, new))[1]).all()
        time.sleep(0.02)
    gate.set()
    _, pixels = frames.until(scene_of(ground, new), lambda stats, _: stats.tiles_wanted == 0)
    assert (pixels[..., 1] > 150).all()
    # What does not replace data, or is no data, leaves nothing behind.
    assert not is_red(frames.draw(scene_of(ground))[1]).any()
    frames.until(scene_of(ground, old), lambda _, pixels: is_red(pixels).all())
    assert not is_red(frames.draw(scene_of(ground, plainly))[1]).any()


@pytest.mark.stress
def test_a_file_that_vanishes_is_told_and_what_is_there_stays(frames: Frames, ground: Terrain, tmp_path: Path) -> None:
    path = Path(write(tmp_path / "red.tif", noisy_red(4000)))
    far, near = (scene_of(ground, Layer(str(path)), distance=d) for d in (6000.0, 300.0))
    frames.draw(far, wait=True)
    path.unlink()
    stats, pixels = frames.until(near, lambda stats, _: bool(stats.failed))
    assert "red.tif" in stats.failed and is_red(pixels).all()
    with pytest.raises(ReadError, match=r"red\.tif"):
        frames.draw(near, wait=True)


def test_a_layer_that_cannot_be_opened_is_told_and_the_rest_is_drawn(
    frames: Frames, ground: Terrain, tmp_path: Path
) -> None:
    good = Layer(write(tmp_path / "red.tif", noisy_red(300)))
    bad = Layer(str(tmp_path / "none.tif"))
    scene = scene_of(ground, good, bad)
    stats, _ = frames.until(scene, lambda stats, pixels: bool(stats.failed) and is_red(pixels).all())
    assert "none.tif" in stats.failed
    with pytest.raises(ReadError, match=r"none\.tif"):
        frames.draw(scene, wait=True)
    stats, _ = frames.draw(scene.but(layers=(good,)), wait=True)
    assert not stats.failed


@pytest.mark.stress
def test_memory_is_fixed_whatever_is_wanted(device: Device, ground: Terrain, tmp_path: Path) -> None:
    frames = Frames(device, ground, gpu_memory=48 << 20)
    try:
        imagery = frames.renderer.imagery
        frames.draw(scene_of(ground), wait=True)
        assert imagery._atlas is None  # a scene without layers has none
        layers = [Layer(write(tmp_path / f"{k}.tif", noisy_red(3000)), 0.4) for k in range(4)]
        scene = scene_of(ground, *layers, distance=2500.0)
        frames.draw(scene, wait=True)
        assert imagery.full
        atlas = imagery._atlas
        assert atlas is not None and atlas.bytes <= 12 << 20 and atlas.count <= atlas.capacity
        assert atlas.capacity * SIDE * SIDE * 4 == atlas.bytes
        frames.draw(scene_of(ground, layers[0]), wait=True)
        held = set(imagery._held)
        assert held == {layers[0].content}
        assert {key[0] for key in atlas._slots} == held  # what is gone left its places
    finally:
        frames.renderer.close()


@pytest.mark.stress
def test_near_by_a_huge_image_both_backends_show_its_pixels(device: Device, ground: Terrain, tmp_path: Path) -> None:
    """20,000 pixels a side, of which a part has colours: no memory holds it, and a view from near by shows each."""
    side, at, span = 20_000, 9_000, 1536
    path = tmp_path / "huge.tif"
    pixels = patches(span, span, span // 12, 4)
    with rasterio.open(
        path, "w", driver="GTiff", count=3, height=side, width=side, dtype="uint8", crs=CRS(32632).to_wkt(),
        transform=Affine(SPAN / side, 0, EAST, 0, -SPAN / side, NORTH), tiled=True, compress="deflate", sparse_ok=True,
        photometric="rgb", BIGTIFF="YES", blockxsize=512, blockysize=512,
    ) as file:  # fmt: skip
        file.write(np.moveaxis(pixels, -1, 0), window=((at, at + span), (at, at + span)))
    pixel = SPAN / side
    x, y = EAST + pixel * (at + span / 2), NORTH - pixel * (at + span / 2)
    col, row = (round(float(v)) for v in ground.grid.index(x, y))
    z = float(ground.read(0, row, row + 1, col, col + 1)[0, 0])
    view = View((x, y - 75, z + 180), (x, y, z), fov_y=40, width=200, height=130)
    scene = Scene.of(
        ground, view, layers=(Layer(str(path)),), light="none", samples=1, water=None, tolerance=0.1,
        max_memory=400 << 20,
    )  # fmt: skip
    off = difference(scene, device)
    assert off.mean() < 1.0
    assert np.percentile(off, 95) < 3.0
    # It is the image: what the nearest pixels under 64 rays of every pixel show.
    o0, ou, ov, d0, du, dv = view.ray_basis(1.0)
    depth = cpu_draw(scene.but(layers=(), tolerance=0.0)).depth.astype(np.float64)
    py, px = np.mgrid[: view.height, : view.width][..., None] + 0.5
    total, drawn = np.zeros((view.height, view.width, 3)), cpu_draw(scene)
    for i, j in np.ndindex(8, 8):
        a, b = px + (j - 3.5) / 8, py + (i - 3.5) / 8
        places = o0 + a * ou + b * ov + depth[..., None] * (d0 + a * du + b * dv)
        c = np.clip((places[..., 0] - EAST) / pixel - at, 0, span - 1).astype(int)
        r = np.clip((NORTH - places[..., 1]) / pixel - at, 0, span - 1).astype(int)
        total += srgb_to_linear(pixels[r, c] / 255.0)
    ours = srgb_to_linear(drawn.pixels / 255.0)
    assert np.sqrt(np.mean((ours - total / 64) ** 2)) < 0.04  # of a contrast (rms) of 0.16
    assert np.std(ours) > 0.9 * np.std(total / 64) > 0.05


def test_an_image_covers_water_as_on_the_cpu(device: Device, tmp_path: Path) -> None:
    y, x = np.mgrid[:SAMPLES, :SAMPLES]
    heights = np.where(x < 180, 0, 40 + 30 * np.sin(x / 9) * np.cos(y / 11)).astype(np.float32)
    lake = in_memory(
        Dem(heights, Grid(heights.shape, Affine(METRES, 0, EAST, 0, -METRES, NORTH), CRS.from_epsg(32632)))
    )
    pixels = np.zeros((60, 60, 4), np.uint8)
    pixels[:30] = *RED, 255
    layer = Layer(write(tmp_path / "i.tif", pixels))
    scene = Scene.of(lake, plan(lake, SIZE), layers=(layer,), light="none", tolerance=0.5)
    ours, caster = gpu_draw(scene, device=device), cpu_draw(scene)
    assert np.linalg.norm(lab(ours.pixels) - lab(caster.pixels), axis=-1).mean() < 0.5
    red = (np.abs(ours.pixels.astype(int) - RED).max(-1) <= 2)[np.isfinite(ours.depth)]
    assert abs(red.mean() - 0.5) < 0.03
    for what in ("water", "draped"):
        assert abs(ours.facts["shown"][what] - caster.facts["shown"][what]) < 0.02 * red.size
    assert ours.facts["shown"]["water"] > 0.2 * red.size
