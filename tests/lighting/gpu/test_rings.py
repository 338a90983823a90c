"""The ground around a tile: which samples of which level, its bound, and occlusion by rings beside all of it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from affine import Affine

from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.gpu.device import Device
from orograph.lighting.arrays import context_of
from orograph.lighting.context import Options
from orograph.lighting.gpu import cone_tracing, occlusion_frames, occlusion_maps
from orograph.lighting.gpu.occlusion_maps import Maps, Settings
from orograph.lighting.gpu.rings import bound, rings
from orograph.lighting.occlusion import ambient_occlusion
from orograph.lighting.rho import transmission
from orograph.store.memory import MemoryTerrain

CELL = np.diag([30.0, -30.0])


def terrain_of(heights: np.ndarray) -> MemoryTerrain:
    return MemoryTerrain(heights, Grid(heights.shape, Affine(30.0, 0, 0, 0, -30.0, 0)), "test")


@pytest.mark.parametrize("shape", [(700, 1400), (1, 900), (333, 2), (257, 257), (1, 1)])
@pytest.mark.parametrize("reach", [16, 100])
def test_rings_cover_what_is_within_reach_once(shape: tuple[int, int], reach: int) -> None:
    """Every sample within R of the tile lies in one ring and in no hole of it; near ones in level 0."""
    terrain = terrain_of(np.zeros(shape, np.float32))
    rows, cols = shape
    for tile in ((0, min(32, rows), 0, min(32, cols)), (rows // 2, rows, cols // 3, cols // 3 + 1)):
        for radius in (90.0, 6000.0, math.inf):
            around = rings(terrain, tile, CELL, radius, reach)
            assert [r.where.level for r in around] == list(range(len(around)))
            n = np.zeros(shape, int)
            for ring in around:
                w, k = ring.where, ring.where.level
                assert w.row0 % 2 == w.col0 % 2 == 0 and w.row1 <= terrain.shape(k)[0]
                assert w.samples <= (32 + 2 * reach + 2 * 64 + 2) ** 2 or k == terrain.levels - 1
                part = np.s_[w.row0 << k : ((w.row1 - 1) << k) + 1, w.col0 << k : ((w.col1 - 1) << k) + 1]
                n[part] += 1
                if ring.hole is not None:
                    a, b, c, d = ring.hole
                    assert w.row0 <= a and b < w.row1 and w.col0 <= c and d < w.col1
                    n[a << k : (b << k) + 1, c << k : (d << k) + 1] -= 1
            far = radius / 30.0
            near = np.s_[max(tile[0] - int(min(far, 1e6)), 0) : tile[1] + int(min(far, 1e6)),
                         max(tile[2] - int(min(far, 1e6)), 0) : tile[3] + int(min(far, 1e6))]  # fmt: skip
            assert (n[near] == 1).all()
            fine = around[0].where
            assert fine.row0 <= max(tile[0] - min(far, reach), 0) and fine.row1 >= min(tile[1] + min(far, reach), rows)
            assert fine.col0 <= max(tile[2] - min(far, reach), 0) and fine.col1 >= min(tile[3] + min(far, reach), cols)


@pytest.fixture(scope="module")
def mountains(shared_data: Path) -> np.ndarray:
    """600 × 800 samples of the San Gabriel Mountains, 30 m apart."""
    import rasterio

    with rasterio.open(next((shared_data / "bigtujunga-srtm30m-utm").glob("*.tif"))) as file:
        return file.read(1, window=((50, 650), (100, 900))).astype(np.float32)


@pytest.mark.stress
def test_coarse_rings_keep_their_bound(device: Device, mountains: np.ndarray) -> None:
    """With rings of 16 samples instead of 512 no elevation is off by more than ``bound``, so that of the light at most
    twice as much is (the cosine's integral over azimuths is 2 at most)."""
    context = context_of(mountains, CELL, Options())
    ways = transmission("step", None)
    made = []
    for reach in (2048, 16):
        maps = Maps(device, context, ways, 64, 0, Settings(tile=64, reach=reach))
        made.append(maps.tile(64, 128, 128, 192))
    assert len(rings(context.terrain, (64, 128, 128, 192), CELL, math.inf, 16)) == 3
    assert len(rings(context.terrain, (64, 128, 128, 192), CELL, math.inf, 2048)) == 1
    allowed = bound(context.terrain, reach=16)
    d = made[1].astype(float) - made[0]
    assert 0.02 < allowed < 0.2 and np.abs(d).max() > 0
    assert np.abs(d).max() < 2 * allowed and abs(d.mean()) < 1e-3 and np.abs(d).mean() < 2e-3


def test_no_ray_slips_in_under_a_ring(device: Device) -> None:
    """A plateau over a plain, whose edge lies in a coarse ring: it hides as much as if it were drawn finely."""
    h = np.zeros((600, 600), np.float32)
    h[:, 140:] = 3000.0
    context, ways = context_of(h, CELL, Options()), transmission("step", None)
    fine, coarse = (
        Maps(device, context, ways, 256, 0, Settings(tile=8, reach=reach)).tile(96, 104, 40, 48) for reach in (512, 16)
    )
    assert fine.mean() < 0.97
    # One of 256 directions may pass the edge, which lies between other samples of the coarse ring, on the other side.
    assert np.abs(coarse - fine).max() < 6e-3 and np.abs(coarse - fine).mean() < 1e-3


def test_planes_stay_open_across_rings(device: Device) -> None:
    y, x = np.mgrid[:150, :170]
    for plane in (0 * x, 12 * x - 7 * y):
        context = context_of(plane.astype(np.float32), CELL, Options())
        maps = Maps(device, context, transmission("step", None), 48, 0, Settings(tile=32, reach=16))
        np.testing.assert_allclose(maps.tile(64, 96, 64, 96), 1.0, atol=5e-4)


def test_a_radius_is_exact_whatever_the_device_holds(
    device: Device, mountains: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Devices that bind no more than 1 MiB divide their tiles; what comes out is the same but for float32."""
    made = []
    for most in (device.largest, 1 << 20):
        monkeypatch.setattr(Device, "largest", property(lambda self, most=most: most))
        monkeypatch.setattr(occlusion_maps, "SETTINGS", Settings(tile=32, reach=64))
        made.append(ambient_occlusion(mountains[:64, :64], CELL, radius=1500.0, method="shadow-maps", rays=24))
    d = np.abs(made[0] - made[1])
    assert d.max() < 0.1 and (d > 1e-5).mean() < 0.01


@pytest.mark.stress
def test_voxels_out_of_coarse_samples_are_those_of_all(
    device: Device, mountains: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cone_tracing, "TILE", 64)
    made = []
    for dense in (20, cone_tracing.DENSE, 2):
        monkeypatch.setattr(cone_tracing, "DENSE", dense)
        context = context_of(mountains, CELL, Options())
        tracer = cone_tracing.Tracer(device, context, transmission("step", None), 40)
        assert tracer.levels > 5
        made.append(tracer.tile(64, 128, 128, 192).astype(float))
    for other, mean, largest in ((made[1], 2e-4, 4e-3), (made[2], 6e-4, 1e-2)):
        assert np.abs(other - made[0]).mean() < mean and np.abs(other - made[0]).max() < largest


@pytest.mark.parametrize("method", ["shadow-maps", "cone-tracing"])
def test_rasters_larger_than_the_device_and_the_memory_allowed(
    device: Device, mountains: np.ndarray, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A device that binds half of the raster, and memory for less: no refusal, and the same as without limits."""
    small = mountains[:100, :120]
    monkeypatch.setattr(occlusion_maps, "SETTINGS", Settings(tile=64, reach=16))
    monkeypatch.setattr(cone_tracing, "TILE", 64)
    run = {"shadow-maps": occlusion_maps.run, "cone-tracing": cone_tracing.run}[method]
    made = []
    for memory in (1 << 40, 1):
        options = Options(rays=12, more={"method": method, "cones": 12})
        context = context_of(small, CELL, options)
        context.max_memory = memory
        out = np.full(small.shape, np.nan, np.float32)
        for row, col, values in run(context, replace(device)):
            out[row : row + values.shape[1], col : col + values.shape[2]] = values[0]
        made.append(out)
    assert np.isfinite(made[0]).all()
    np.testing.assert_array_equal(*made)


def test_nothing_depends_on_how_much_a_submission_draws(device: Device, mountains: np.ndarray) -> None:
    """Few cells at a time: a driver's watchdog is not kept waiting."""
    made = []
    for cells in (occlusion_frames.MOST_CELLS, 9000):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(occlusion_frames, "MOST_CELLS", cells)
            context = context_of(mountains[:64, :64], CELL, Options())
            maps = Maps(device, context, transmission("step", None), 40, 0, Settings(tile=32))
            made.append(maps.tile(0, 32, 32, 64))
    np.testing.assert_array_equal(*made)


def test_what_was_made_is_kept(
    device: Device, mountains: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted in its second tile, the map goes on from the first."""
    from orograph.lighting.raster_resume import Checkpoint

    monkeypatch.setattr(cone_tracing, "TILE", 64)
    context = context_of(mountains[:64, :128], CELL, Options(radius=300.0, more={"method": "cone-tracing"}))
    tile = cone_tracing.Tracer.tile
    asked: list[int] = []

    def counted(self: object, *window: int) -> np.ndarray:
        asked.append(window[2])
        return tile(self, *window)  # type: ignore[arg-type]

    monkeypatch.setattr(cone_tracing.Tracer, "tile", counted)
    context.kept = Checkpoint(tmp_path / "kept", {"what": "test"})
    blocks = cone_tracing.run(context)
    next(blocks)
    blocks.close()  # type: ignore[attr-defined]
    whole = list(cone_tracing.run(context))
    assert asked == [0, 64] and len(whole) == 2


def test_the_round_earth_is_not_for_them(device: Device) -> None:
    context = context_of(np.zeros((4, 4), np.float32), CELL, Options(curvature=True, more={"method": "shadow-maps"}))
    with pytest.raises(UsageError, match="curvature"):
        occlusion_maps.run(context)


@pytest.mark.parametrize("radius", [None, 1200.0])
def test_blocks_that_no_ray_meets_are_passed_over(
    device: Device, mountains: np.ndarray, monkeypatch: pytest.MonkeyPatch, radius: float | None
) -> None:
    """Drawn or not they change nothing, and most are not drawn."""
    context, ways = context_of(mountains, CELL, Options()), transmission("step", radius)
    found: list[np.ndarray] = []
    drawn: list[int] = []
    met = occlusion_frames._Blocks.met
    for every in (False, True):

        def all_of_them(blocks: occlusion_frames._Blocks, *args: object, every: bool = every) -> object:
            some, holes = met(blocks, *args)
            some = np.arange(len(blocks.instances)) if every else some
            drawn.append(len(some))
            return some, holes

        monkeypatch.setattr(occlusion_frames._Blocks, "met", all_of_them)
        maps = Maps(device, context, ways, 24, 0, Settings(tile=32, reach=64))
        found.append(maps.tile(96, 128, 352, 384))
    np.testing.assert_array_equal(found[0], found[1])
    assert sum(drawn[: len(drawn) // 2]) < 0.25 * sum(drawn)


def test_a_hole_far_from_the_light_costs_nothing(device: Device, mountains: np.ndarray) -> None:
    """Faces towards the light are drawn only where rays may pass through a hole."""
    h = mountains.copy()
    h[:20, :20] = np.nan
    context = context_of(h, CELL, Options())
    maps = Maps(device, context, transmission("step", 900.0), 24, 0, Settings(tile=32))
    flags = []
    for window in ((300, 332, 400, 432), (48, 80, 48, 80)):
        around = rings(context.terrain, window, CELL, 900.0, 512)
        held = maps.store.load(tuple(r.where for r in around))
        slopes = context.gradient(*window)
        frames = occlusion_frames.Frames(maps, window, (window[0], window[2]), around, held, context.heights(*window),
                                         (slopes[0].astype(float), slopes[1].astype(float)), 1.0)  # fmt: skip
        flags.append(frames.holes)
    assert not flags[0].any() and flags[1].any() and not flags[1].all()
