"""The ground by rays on the GPU: the hits of the CPU's caster on the same windows, wherever the camera stands."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from affine import Affine
from cielab import lab
from numpy.typing import NDArray
from pyproj import CRS

from orograph.dem.raster import Dem
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.lod.method import Goal, Resources
from orograph.lod.raycast import RayCast, RayCastOptions
from orograph.raycast.caster import Caster
from orograph.raycast.select import load
from orograph.rendering.cpu.draw import draw as draw_cpu
from orograph.rendering.gpu.camera import CAMERA, camera_of
from orograph.rendering.gpu.draw import draw as draw_gpu
from orograph.rendering.gpu.frame import FrameStats
from orograph.rendering.gpu.readback import depth_of
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.surface.left import DEPTH_ONLY
from orograph.rendering.gpu.surface.rays import BEAM, RayPass
from orograph.rendering.gpu.surface.windows import CastWindows, Windows, gaps
from orograph.rendering.gpu.targets import Targets
from orograph.rendering.projection import Projection
from orograph.rendering.ray_surface import RaySurface
from orograph.scene.contours import Contours
from orograph.scene.scene import Scene
from orograph.scene.silhouettes import Silhouettes
from orograph.store import terrain as in_memory
from orograph.store.prepare import prepare
from orograph.store.terrain import Terrain
from orograph.verify.depth import judge_depth, vertical_pixels
from orograph.verify.frustum import Camera as Lens
from orograph.viewpoint import Camera, View

SIZE = (240, 160)
ALIKE = 1e-5
"""By how much of a depth two hits may differ that are the same."""

SETS = {
    "bigtujunga, 30 m": "bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif",
    "fuji, 90 m, degrees": "osgearth-srtm90m-volcano-voids/mt_fuji_90m.tif",
    "rainier, 90 m, voids": "osgearth-srtm90m-volcano-voids/mt_rainier_90m.tif",
    "a city, 1 m": "nrw-dom1-1m/dom1_32_356_5699_1_nw_2020.tif",
    "fort bragg, 1 m, voids": "fortbragg-1m-dem-ortho/elevation_2016.tif",
    "spearfish, oblong, voids": "spearfish-sfdem-utm13/sfdem.tiff",
    "white mountains, 3″": "n44w072-hgt/N44W072.hgt",
    "vinschgau": "terra-vinschgau/elev_vinschgau.tif",
}


@dataclass(frozen=True)
class Compared:
    """Pixels of a view.

    Attributes:
        pixels, hits: all, and those with ground on the GPU.
        other: that the CPU tells otherwise. wrong: of these those beyond the tolerance, and on no edge.
        worst: the largest distance of the others' points from the surface, pixels.
    """

    pixels: int
    hits: int
    other: int
    wrong: int
    worst: float


class Both:
    """Casts a terrain's windows on the GPU and on the CPU."""

    def __init__(self, device: Device, terrain: Terrain, most: int = 1 << 28) -> None:
        self.device, self.terrain = device, terrain
        self.method = RayCast(terrain, RayCastOptions(), Resources())
        self.windows = Windows(device, terrain, most)
        self.buffer = device.buffer(CAMERA.itemsize, "UNIFORM", "camera")
        self.rays = RayPass(device, self.buffer)
        self.targets = Targets(device, *SIZE)

    def selected(self, view: View, tolerance: float, exaggeration: float = 1.0) -> CastWindows:
        camera = Camera.over(self.terrain.grid, view.whole, exaggeration)
        select = lambda pixels: self.method.select(camera, Goal(pixels))  # noqa: E731
        return self.windows.ready(select(tolerance), select)

    def on_gpu(self, view: View, windows: CastWindows, exaggeration: float = 1.0) -> NDArray:
        camera = camera_of(view, self.terrain, exaggeration)
        self.device.queue.write_buffer(self.buffer, 0, camera.tobytes())
        encoder = self.device.handle.create_command_encoder()
        self.rays.draw(encoder, self.targets, windows, DEPTH_ONLY)
        self.device.queue.submit([encoder.finish()])
        return depth_of(self.device, self.targets, camera)

    def on_cpu(self, view: View, windows: CastWindows, exaggeration: float = 1.0) -> RaySurface:
        caster = Caster(load(self.terrain, windows.windows), self.terrain.grid.shape)
        return RaySurface(caster, Projection.of(Camera.over(self.terrain.grid, view, exaggeration)))

    def compared(self, view: View, tolerance: float, exaggeration: float = 1.0) -> Compared:
        windows = self.selected(view, tolerance, exaggeration)
        surface = self.on_cpu(view, windows, exaggeration)
        gpu, cpu = self.on_gpu(view, windows, exaggeration), surface.draw((0, view.height, 0, view.width)).depth
        hit, there = np.isfinite(gpu), np.isfinite(cpu)
        with np.errstate(invalid="ignore"):
            same = (hit == there) & (~there | (np.abs(gpu - cpu) <= ALIKE * cpu))
        rest = hit & ~same
        off = np.zeros(gpu.shape)
        if rest.any():
            lens = Lens.of(view, self.terrain.grid, exaggeration)
            off[rest] = vertical_pixels(gpu, rest, self.terrain, view, lens)
        lost = ~same & (~hit | ~(off <= tolerance))
        wrong = [at for at in np.argwhere(lost) if not _on_edge(surface, gpu[tuple(at)], *at)]
        return Compared(gpu.size, int(hit.sum()), int((~same).sum()), len(wrong), float(np.nan_to_num(off).max()))


def _on_edge(surface: RaySurface, depth: float, y: int, x: int) -> bool:
    """Whether the CPU's rays a hundredth of a pixel around a pixel's middle see the same."""
    around = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]) * 0.01 + 0.5
    near = surface.at(x + around[:, 0], y + around[:, 1]).depth
    return bool((np.isnan(near) if math.isnan(depth) else np.abs(near - depth) <= 1e-3 * depth).any())


def look(eye: tuple[float, ...], azimuth: float, pitch: float, far: float) -> View:
    """From a place, azimuth and pitch in degrees."""
    a, p = math.radians(azimuth), math.radians(pitch)
    way = math.sin(a) * math.cos(p), math.cos(a) * math.cos(p), math.sin(p)
    x, y, z = eye
    target = x + far * way[0], y + far * way[1], z + far * way[2]
    return View((x, y, z), target, fov_y=50.0, width=SIZE[0], height=SIZE[1])


def placed(
    kind: int, grid: Grid, at: tuple[float, float, float], heights: tuple[float, float], rng: np.random.Generator
) -> tuple[str, View]:
    """A camera of a kind at a place of the ground, among so low and high ones."""
    (x, y, z), (low, high), (width, height) = at, heights, SIZE
    spacing = float(np.mean(grid.spacing))
    span, azimuth = spacing * math.hypot(*grid.shape), float(rng.uniform(0, 360))
    small, far = spacing * float(rng.uniform(0.05, 3.0)), span / 10

    def pitch(least: float, most: float) -> float:
        return float(rng.uniform(least, most))

    if kind == 0:
        return "grazing", look((x, y, z + small), azimuth, pitch(-4, 2), far)
    if kind == 1:
        return "in a valley", look((x, y, z + small), azimuth, pitch(-5, 20), far)
    if kind == 2:
        above = high + span * float(rng.uniform(0.01, 0.5))
        return "straight down", View((x, y, above), (x, y, z), fov_y=60, width=width, height=height)
    if kind == 3:
        above = high + span * float(rng.uniform(0.005, 1.0))
        return "plan", View((x, y, above), (x, y, z), projection="plan", width=width, height=height)
    if kind == 4:
        a, p, d = math.radians(azimuth), math.radians(pitch(2, 40)), span * float(rng.uniform(2, 12))
        eye = x - d * math.sin(a) * math.cos(p), y - d * math.cos(a) * math.cos(p), z + d * math.sin(p)
        return "far", View(eye, (x, y, z), fov_y=math.degrees(0.6 * span / d), width=width, height=height)
    if kind == 5:
        above = z + span * float(rng.uniform(0.02, 0.2))
        return "slanted", look((x, y, above), azimuth, pitch(-60, -15), far)
    if kind == 6:
        west = float(grid.xy(-0.3 * grid.shape[1], 0.0)[0])
        eye = west, y, low + (high - low) * float(rng.uniform(-0.2, 1.2))
        return "beside", look(eye, 90 + pitch(-20, 20), pitch(-5, 5), far)
    return "below", look((x, y, z - small - 1.0), azimuth, pitch(-5, 45), far)


def views(terrain: Terrain, count: int, seed: int = 1) -> Iterator[tuple[str, View, float, float]]:
    """Cameras of all kinds in turn at random places of the ground: name, view, tolerance, exaggeration."""
    rng = np.random.default_rng(seed)
    rows, cols = terrain.grid.shape
    level = min(max(int(math.log2(max(rows, cols) / 512)), 0) if max(rows, cols) > 512 else 0, terrain.levels - 1)
    coarse = terrain.read(level, 0, terrain.shape(level)[0], 0, terrain.shape(level)[1]).astype(np.float64)
    known = np.argwhere(np.isfinite(coarse))
    for k in range(count):
        i, j = (int(v) for v in known[rng.integers(len(known))])
        if k % 8 == 1:  # the lowest of what is around
            top, left = max(i - 8, 0), max(j - 8, 0)
            around = coarse[top : i + 9, left : j + 9]
            i, j = (int(v) for v in np.unravel_index(int(np.nanargmin(around)), around.shape))
            i, j = top + i, left + j
        x, y = (float(v) for v in terrain.grid.xy(min(j << level, cols - 1), min(i << level, rows - 1)))
        name, view = placed(k % 8, terrain.grid, (x, y, float(coarse[i, j])), terrain.height_range, rng)
        yield name, view, float(rng.choice([0.5, 1.0, 3.0])), float(rng.choice([1.0, 1.0, 2.5]))


def hold(device: Device, terrain: Terrain, count: int, seed: int = 1, most: int = 1 << 28) -> None:
    """So many views: fails where a pixel is wrong, or more than one in ten thousand is another than the CPU's."""
    both, pixels, hits, other = Both(device, terrain, most), 0, 0, 0
    for name, view, tolerance, exaggeration in views(terrain, count, seed):
        found = both.compared(view, tolerance, exaggeration)
        assert found.wrong == 0, (name, view, tolerance, exaggeration, found)
        pixels, hits, other = pixels + found.pixels, hits + found.hits, other + found.other
    assert other <= 1e-4 * pixels and 0.05 < hits / pixels < 1.0, (other, hits, pixels)


@pytest.mark.parametrize("name", SETS)
def test_hits_are_the_cpus_on_real_ground(device: Device, shared_data: Path, name: str) -> None:
    hold(device, prepare([str(shared_data / SETS[name])]), 8)


@pytest.mark.stress
@pytest.mark.parametrize("name", SETS)
def test_hits_are_the_cpus_in_many_views(device: Device, shared_data: Path, name: str) -> None:
    hold(device, prepare([str(shared_data / SETS[name])]), 80, seed=2)


@pytest.mark.stress
@pytest.mark.parametrize("mebibytes", [256, 24])
def test_hits_are_the_cpus_on_a_store_of_many_tiles(device: Device, shared_data: Path, mebibytes: int) -> None:
    tiles = sorted(map(str, (shared_data / "california-3s-tiles").glob("*.tif")))
    hold(device, prepare(tiles), 48, seed=3, most=mebibytes << 20)


def rough(rows: int, cols: int, relief: float = 900.0, seed: int = 3) -> NDArray[np.float32]:
    """Ground with detail at all scales."""
    rng = np.random.default_rng(seed)
    k = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None])
    k[0, 0] = np.inf
    z = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(rows, cols))) / k**1.7, s=(rows, cols))
    return ((z - z.min()) / np.ptp(z) * relief).astype(np.float32)


def over(heights: NDArray[np.float32], transform: Affine) -> Terrain:
    return in_memory(Dem(heights, Grid(heights.shape, transform, CRS.from_epsg(32632))))


def holed(rows: int, cols: int) -> NDArray[np.float32]:
    """The same with ground missing: a lake's size, single samples, a corner."""
    z, rng = rough(rows, cols), np.random.default_rng(5)
    z[rows // 3 : rows // 2, cols // 4 : cols // 3] = np.nan
    z[rng.random(z.shape) < 0.01] = np.nan
    z[-20:, :30] = np.nan
    return z


GROUNDS: dict[str, Callable[[], Terrain]] = {
    "holes": lambda: over(holed(300, 421), Affine(20.0, 0, 7e5, 0, -20.0, 5.3e6)),
    "oblong cells, rows northwards": lambda: over(rough(700, 260), Affine(30.0, 0, 7e5, 0, 10.0, 5.3e6)),
    "turned": lambda: over(rough(310, 300), Affine(12.0, 16.0, 7e5, 16.0, -12.0, 5.3e6)),
    "nested windows": lambda: over(rough(1100, 2900, 400.0), Affine(5.0, 0, 7e5, 0, -5.0, 5.3e6)),
    "few samples": lambda: over(rough(3, 5, 40.0), Affine(10.0, 0, 7e5, 0, -10.0, 5.3e6)),
    "long": lambda: over(rough(66, 40_001, 300.0), Affine(1.0, 0, 7e5, 0, -1.0, 5.3e6)),
}


@pytest.mark.parametrize("name", GROUNDS)
def test_hits_are_the_cpus_whatever_the_grid(device: Device, name: str) -> None:
    hold(device, GROUNDS[name](), 16, seed=4)


@pytest.mark.parametrize("name", ["holes", "nested windows", "turned"])
def test_rays_begin_above_all_ground(device: Device, name: str) -> None:
    """The coarse pass: no ray begins behind what it meets, and most begin well on their way to it."""
    terrain = GROUNDS[name]()
    both, part = Both(device, terrain), []
    for kind, view, tolerance, exaggeration in views(terrain, 16, seed=9):
        depth = both.on_gpu(view, both.selected(view, tolerance, exaggeration), exaggeration)
        starts = device.read_buffer(both.rays._beams.starts(SIZE), np.float32).reshape(SIZE[1] // BEAM, SIZE[0] // BEAM)
        blocks = np.where(np.isnan(depth), np.inf, depth).reshape(SIZE[1] // BEAM, BEAM, SIZE[0] // BEAM, BEAM)
        nearest = blocks.min((1, 3))
        assert (starts <= nearest * (1 + 1e-5)).all(), (kind, view)
        if kind == "slanted":
            part.append(np.median(starts[np.isfinite(nearest)] / nearest[np.isfinite(nearest)]))
        if kind == "plan":
            assert (starts == starts[0, 0]).all()
    assert min(part) > 0.3, part


def test_level_ground_is_hit_wherever_it_is(device: Device) -> None:
    """A plain is a slab of no thickness; seen along itself, and from high above."""
    terrain = over(np.full((200, 300), 1234.5, np.float32), Affine(10.0, 0, 7e5, 0, -10.0, 5.3e6))
    both = Both(device, terrain)
    x, y = (float(v) for v in terrain.grid.xy(150.0, 100.0))
    for above in (0.01, 2.0, 1e6):
        fov = 0.1 if above > 1000 else 40.0
        eye, target = (x, y, 1234.5 + above), (x + 50.0, y + 20.0, 1234.5 - above)
        view = View(eye, target, fov_y=fov, width=SIZE[0], height=SIZE[1])
        found = both.compared(view, 1.0)
        assert found.hits > 0 and found.wrong == 0 and found.other <= 4, (above, found)


def test_what_memory_does_not_hold_is_coarser_and_says_so(device: Device) -> None:
    terrain = GROUNDS["nested windows"]()
    name, view, *_ = next(v for v in views(terrain, 8) if v[0] == "slanted")
    roomy, tight = Both(device, terrain), Both(device, terrain, 6 * 200_000)
    plenty, scarce = roomy.selected(view, 0.2), tight.selected(view, 0.2)
    assert plenty.windows.samples > 200_000 >= scarce.windows.samples
    assert plenty.bound == pytest.approx(0.2) and scarce.bound is not None and scarce.bound > 0.2
    report = judge_depth(tight.on_gpu(view, scarce), terrain, view)
    assert report.hits > 5000 and report.ok(scarce.bound), (name, report)
    assert judge_depth(roomy.on_gpu(view, plenty), terrain, view).ok(0.2)


def test_memory_for_no_window_around_the_eye_leaves_the_finest_out(device: Device) -> None:
    """Closer to the ground than a coarse level's error no tolerance is large enough for it."""
    terrain = GROUNDS["nested windows"]()
    x, y = (float(v) for v in terrain.grid.xy(1200.0, 900.0))
    view = look((x, y, float(terrain.read(0, 900, 901, 1200, 1201)[0, 0]) + 2.0), 10.0, -10.0, 1000.0)
    coarsest = math.prod(terrain.shape(terrain.levels - 1))
    tight = Both(device, terrain, 6 * (coarsest + 1))
    scarce = tight.selected(view, 0.5)
    assert scarce.bound == np.inf and len(scarce.windows) < len(Both(device, terrain).selected(view, 0.5).windows)
    assert np.isfinite(tight.on_gpu(view, scarce)).mean() > 0.3


def test_windows_that_stay_are_not_brought_again(device: Device) -> None:
    terrain = GROUNDS["nested windows"]()
    both = Both(device, terrain)
    x, y = (float(v) for v in terrain.grid.xy(1200.0, 900.0))
    first = both.selected(look((x, y, 900.0), 10.0, -20.0, 1000.0), 1.0)
    same = both.selected(look((x + 1.0, y, 900.0), 10.0, -20.0, 1000.0), 1.0)
    assert same.pool is first.pool and len(first.windows) > 1
    assert same.held is first.held
    other = both.selected(look((x, y, 900.0), 190.0, -20.0, 1000.0), 1.0)
    assert other.pool is first.pool and other.held is not first.held
    shared = set(first.windows) & set(other.windows)
    assert shared and all(first.held[where] is other.held[where] for where in shared)


@pytest.mark.parametrize("room", [1 << 27, 3 << 21])
def test_windows_of_frames_that_may_still_be_drawn_stay_as_they_are(device: Device, room: int) -> None:
    """Those of the last selection and of the one before it, whatever is brought, with plenty of memory and little."""
    terrain = GROUNDS["nested windows"]()
    both, rng, moved = Both(device, terrain, room), np.random.default_rng(4), 0
    made, expected = list[CastWindows](), list[list[NDArray[np.float32]]]()

    def values(windows: CastWindows) -> list[NDArray[np.float32]]:
        pool = device.read_buffer(windows.pool, np.float32)
        return [pool[at : at + lying.size] for lying, at in windows.held.values()]

    for _ in range(12):
        x, y = (float(v) for v in terrain.grid.xy(*rng.uniform(300, 1200, 2)))
        camera = look((x, y, 900.0), float(rng.uniform(0, 360)), -20.0, 1000.0)
        made.append(both.selected(camera, 1.0))
        expected.append(values(Both(device, terrain, room).selected(camera, 1.0)))
        moved += len(made) > 1 and made[-1].pool is not made[-2].pool
        for one, right in zip(made[-2:], expected[-2:], strict=True):
            assert all(np.array_equal(a, b) for a, b in zip(values(one), right, strict=True))
    assert moved == 0 if room > 1 << 26 else moved > 3


def test_gaps_are_between_what_is_taken() -> None:
    assert gaps([], 10, [4, 6]) == [0, 4]
    assert gaps([], 10, [4, 7]) is None
    assert gaps([(2, 4), (3, 6), (8, 9)], 12, [2, 3, 2]) == [0, 9, 6]
    assert gaps([(0, 12)], 12, [1]) is None and gaps([(0, 12)], 12, []) == []


# ---- pictures and frames -------------------------------------------------------------------------------------------


def delta(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> NDArray[np.float64]:
    """ΔE*ab of every pixel."""
    a, b = (lab(p) for p in (one, other))
    return np.asarray(np.linalg.norm(a - b, axis=-1))


SCENES: dict[str, dict[str, Any]] = {
    "plain": {},
    "antialiased": {"samples": 4},
    "lines and labels": {"contours": Contours(100.0), "silhouettes": Silhouettes(), "sky": True},
    "rays of light": {"light": "raytraced", "rays": 8},
    "stretched": {"exaggeration": 2.0},
}


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", SCENES)
def test_pictures_are_the_cpus(device: Device, name: str) -> None:
    terrain = GROUNDS["holes"]()
    middle = tuple(float(v) for v in terrain.grid.xy(210.0, 150.0))
    for view in (
        View((middle[0] - 3000, middle[1] - 5000, 2500.0), (*middle, 400.0), width=SIZE[0], height=SIZE[1]),
        View((*middle, 9000.0), (*middle, 400.0), projection="plan", width=SIZE[0], height=SIZE[1]),
    ):
        scene = Scene.of(terrain, view, **{"samples": 1, "tolerance": 0.5, "method": "raycast", **SCENES[name]})
        gpu, cpu = draw_gpu(scene, device=device), draw_cpu(scene)
        assert gpu.facts["rays"]["windows"] >= 1 and "mesh" not in gpu.facts and gpu.facts["triangles"] == 0
        off = delta(gpu.pixels, cpu.pixels)
        assert off.mean() < 0.6 and np.quantile(off, 0.95) < 3, (name, view.projection, off.mean())
        assert gpu.pixels.std() > 10


@pytest.mark.stress
def test_a_plan_has_the_heights_of_its_pixels(device: Device) -> None:
    """From straight above no height moves anything, but it has a colour, and lines."""
    terrain = GROUNDS["nested windows"]()
    middle = tuple(float(v) for v in terrain.grid.xy(1450.0, 550.0))
    view = View((*middle, 4000.0), (*middle, 200.0), projection="plan", width=SIZE[0], height=SIZE[1])
    scene = Scene.of(terrain, view, samples=4, method="raycast", contours=Contours(20.0, labels=False), tolerance=1.0)
    off = delta(draw_gpu(scene, device=device).pixels, draw_cpu(scene).pixels)
    assert off.mean() < 0.6 and np.quantile(off, 0.95) < 3, (off.mean(), np.quantile(off, 0.95))


def test_faces_are_those_of_the_triangles_that_are_hit(device: Device) -> None:
    """Light on facets: rays at all samples, and patches whose triangles are as small."""
    terrain = over(rough(130, 130, 300.0), Affine(20.0, 0, 7e5, 0, 20.0, 5.3e6))
    x, y = (float(v) for v in terrain.grid.xy(64.0, 64.0))
    view = View((x - 300, y - 900, 700.0), (x, y, 150.0), width=SIZE[0], height=SIZE[1])
    scene = Scene.of(
        terrain, view, tolerance=0.01, samples=1, normals="faces", shadows=False, relief=1.0, colormap="grey",
        water=None,
    )  # fmt: skip
    rays, patches = (draw_gpu(scene.but(method=m), device=device).pixels for m in ("raycast", "auto"))
    off = delta(rays, patches)
    assert np.median(off) < 0.5 and np.quantile(off, 0.9) < 3, (np.median(off), np.quantile(off, 0.9))


@pytest.mark.stress
def test_tiles_of_a_picture_are_the_picture(device: Device) -> None:
    terrain = GROUNDS["nested windows"]()
    view = look((*(float(v) for v in terrain.grid.xy(1200.0, 900.0)), 700.0), 20.0, -15.0, 2000.0)
    scene = Scene.of(terrain, view, method="raycast", tolerance=1.0, samples=1)
    whole = draw_gpu(scene, device=device)
    part = draw_gpu(scene.but(view=view.tile(100, 60, 96, 64)), device=device)
    there = whole.depth[60:124, 100:196]
    assert np.isfinite(there).mean() > 0.5
    np.testing.assert_array_equal(np.isfinite(part.depth), np.isfinite(there))
    np.testing.assert_allclose(part.depth, there, rtol=1e-5)


@pytest.mark.stress
def test_frames_do_not_wait_for_windows(device: Device) -> None:
    """Patches stand in at first, then windows that were there before, until those of the view are."""
    terrain = GROUNDS["nested windows"]()
    renderer = Renderer(device, terrain)
    target = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC").create_view()
    eye = (*(float(v) for v in terrain.grid.xy(1200.0, 900.0)), 700.0)
    scene = Scene.of(terrain, look(eye, 20.0, -15.0, 2000.0), method="raycast", tolerance=1.0)

    def settled(scene: Scene) -> FrameStats:
        until = time.monotonic() + 60
        while time.monotonic() < until:
            stats = renderer.draw(target, "rgba8unorm", scene)
            if stats.current and stats.windows and renderer.resting:
                return stats
            time.sleep(0.005)
        raise AssertionError("no windows came")

    try:
        first = renderer.draw(target, "rgba8unorm", scene)
        assert first.patches > 0 and first.windows == 0 and not first.current
        stats = settled(scene)
        assert stats.patches == stats.triangles == 0 and stats.error_px == pytest.approx(1.0)
        before = renderer.windows
        turned = scene.but(view=look(eye, 200.0, -15.0, 2000.0))
        renderer.draw(target, "rgba8unorm", turned)
        assert renderer.windows is before and np.isfinite(renderer.depth()).mean() > 0.3
        settled(turned)
        assert renderer.windows is not before
        own, waited = renderer.depth(), draw_gpu(turned, device=device).depth
        # (The last frame's samples lie elsewhere in their pixels.)
        assert (np.isfinite(own) == np.isfinite(waited)).mean() > 0.99
        patches = renderer.draw(target, "rgba8unorm", scene.but(method="auto"))
        assert patches.windows == 0 and patches.patches > 0
    finally:
        renderer.close()


@pytest.mark.stress
def test_tiles_of_heights_are_read_only_where_something_is_drawn_out_of_them(device: Device) -> None:
    """Rays meet windows; lines are looked up in tiles. A view that stays has the same patches, until a tile comes."""
    terrain = GROUNDS["nested windows"]()
    renderer = Renderer(device, terrain)
    target = device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC").create_view()
    eye = (*(float(v) for v in terrain.grid.xy(1200.0, 900.0)), 700.0)

    def settled(scene: Scene) -> tuple[int, int]:
        until = time.monotonic() + 60
        while time.monotonic() < until:
            renderer.draw(target, "rgba8unorm", scene)
            if not renderer.busy:
                return renderer.heights.count, renderer.slopes.count
            time.sleep(0.005)
        raise AssertionError("it did not come to rest")

    scene = Scene.of(terrain, look(eye, 20.0, -15.0, 2000.0), method="raycast", tolerance=1.0)
    try:
        heights, slopes = settled(scene)
        turned = scene.but(view=look(eye, 200.0, -15.0, 2000.0))
        there, more = settled(turned)
        assert there == heights and more > slopes
        assert settled(turned.but(contours=Contours(100.0)))[0] > there
        plain = scene.but(method="auto")
        settled(plain)
        choose = lambda: renderer.tiles.choose(plain.view, 1.0, 1.0, wait=False).patches  # noqa: E731
        same = choose()
        assert choose() is same
        renderer.heights.changes += 1
        other = choose()
        assert other is not same and np.array_equal(other.instances, same.instances)
    finally:
        renderer.close()
