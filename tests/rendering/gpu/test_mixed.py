"""Patches and rays in one picture: each block is, to the bit, what patches alone or rays alone draw there."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from test_surface_rays import GROUNDS, SETS, SIZE, look, over, rough, views

from orograph.errors import UsageError
from orograph.gpu.device import Device
from orograph.gpu.recording import write
from orograph.lod.method import Goal
from orograph.lod.patches.footprints import Screen, footprints
from orograph.lod.patches.shape import STEPS, patch_vertices
from orograph.lod.registry import chosen
from orograph.rendering.gpu.camera import camera_of
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.frame import FrameStats
from orograph.rendering.gpu.readback import depth_of
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.surface import mixer
from orograph.rendering.gpu.surface.mixed import Cast, Mixed
from orograph.rendering.gpu.surface.mixer import _frame
from orograph.rendering.gpu.surface.rays import SPACING
from orograph.rendering.gpu.surface.shares import Costs, Frame, count_over, kept, over_blocks, share
from orograph.rendering.gpu.targets import Targets
from orograph.rendering.projection import Projection
from orograph.scene.methods import mesh_choice
from orograph.scene.scene import Scene
from orograph.store.prepare import prepare
from orograph.store.terrain import Terrain
from orograph.verify.depth import judge_depth
from orograph.viewpoint import Camera, View

SIDE = 32


@contextmanager
def drawing(device: Device, terrain: Terrain) -> Iterator[Drawing]:
    """What draws a terrain, closed in the end."""
    found = Drawing(device, terrain)
    try:
        yield found
    finally:
        found.renderer.close()


class Drawing:
    """Draws the ground of a terrain by patches, by rays, and by both."""

    def __init__(self, device: Device, terrain: Terrain) -> None:
        self.device, self.terrain = device, terrain
        self.renderer, self.targets = Renderer(device, terrain), Targets(device, *SIZE)
        self.ground = self.renderer._ground

    def chosen(self, view: View, tolerance: float, exaggeration: float, method: str = f"hybrid,block={SIDE}") -> Any:
        scene = Scene.of(self.terrain, view, tolerance=tolerance, exaggeration=exaggeration, method=method)
        return self.ground.choose(scene, None, tolerance, wait=True)

    def depth(self, view: View, exaggeration: float, drawn: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        """Depth and marks of what is drawn."""
        camera = camera_of(view, self.terrain, exaggeration)
        write(self.device, self.renderer._camera, camera)
        encoder = self.device.handle.create_command_encoder()
        self.ground.draw(encoder, self.targets, drawn)
        self.device.queue.submit([encoder.finish()])
        depth = depth_of(self.device, self.targets, camera)
        return depth, self.device.read_texture(self.targets.marks, np.uint32, 1)[..., 0]

    def boxes(self, view: View, exaggeration: float, patches: Any) -> tuple[Screen, NDArray[np.int64]]:
        screen = Screen.of(view, self.terrain.grid, exaggeration, SIDE)
        rows, cols = self.terrain.grid.shape
        legs = self.renderer.method.legs
        return screen, footprints(patches.instances, patches.spans, legs, (rows - 1, cols - 1), screen)


def pixels_of(by_rays: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.kron(by_rays, np.ones((SIDE, SIDE), bool))[: SIZE[1], : SIZE[0]]


def hold(device: Device, terrain: Terrain, count: int, seed: int = 1) -> None:
    """So many views: blocks at random, most by rays, so that as many patches as can be are left out."""
    rng, left_out, ground = np.random.default_rng(seed), 0, 0
    with drawing(device, terrain) as it:
        for name, view, tolerance, exaggeration in views(terrain, count, seed):
            found = it.chosen(view, tolerance, exaggeration)
            patches = found.patches.kept()
            windows = found.selection.cast.windows
            screen, boxes = it.boxes(view, exaggeration, patches)
            whole = Cast(windows, np.zeros(screen.shape, bool), SIDE)
            by_patches = it.depth(view, exaggeration, replace(found, selection=Mixed(patches.instances, whole)))
            whole = replace(whole, by_rays=np.ones(screen.shape, bool))
            by_rays = it.depth(view, exaggeration, replace(found, selection=Mixed(patches.instances, whole)))
            ground += int(np.isfinite(by_patches[0]).sum())
            for labels in (rng.random(screen.shape) < 0.85, found.selection.cast.by_rays):
                some = patches.instances[kept(boxes, labels)]
                left_out += len(patches.instances) - len(some)
                both = it.depth(view, exaggeration, replace(found, selection=Mixed(some, Cast(windows, labels, SIDE))))
                for mixed, own, other in zip(both, by_patches, by_rays, strict=True):
                    np.testing.assert_array_equal(mixed, np.where(pixels_of(labels), other, own), str((name, view)))
    assert left_out > 0 and ground > 0


@pytest.mark.cases(3)
@pytest.mark.parametrize("name", [name for name in GROUNDS if name != "few samples"])
def test_blocks_are_those_of_either(device: Device, name: str) -> None:
    """No pixel is lost where they meet, and no patch is left out that shows: whatever is drawn, one way drew it."""
    hold(device, GROUNDS[name](), 8, seed=4)


@pytest.mark.stress
@pytest.mark.parametrize("name", SETS)
def test_blocks_are_those_of_either_on_real_ground(device: Device, shared_data: Path, name: str) -> None:
    hold(device, prepare([str(shared_data / SETS[name])]), 32, seed=5)


def test_terrains_of_few_samples_are_drawn(device: Device) -> None:
    for shape in ((3, 5), (2, 2), (2, 90)):
        terrain = over(rough(*shape, 40.0), GROUNDS["few samples"]().grid.transform)
        x, y = (float(v) for v in terrain.grid.xy((shape[1] - 1) / 2, (shape[0] - 1) / 2))
        view = View((x, y - 300.0, 250.0), (x, y, 20.0), width=SIZE[0], height=SIZE[1])
        with drawing(device, terrain) as it:
            turns = it.chosen(view, 0.5, 1.0, f"hybrid,block={SIDE},shares=turns")
            there = np.isfinite(it.depth(view, 1.0, turns)[0])
            rays = np.isfinite(it.depth(view, 1.0, it.chosen(view, 0.5, 1.0, "raycast"))[0])
            assert there.sum() > 20 and (there != rays).sum() <= 0.02 * rays.sum() + 4


def test_no_vertex_lies_outside_of_its_patchs_footprint(device: Device) -> None:
    """Of every patch all vertices, projected by another's hand, geomorphs and squeezed ones included."""
    seen = 0
    for name in ("holes", "oblong cells, rows northwards", "turned"):
        terrain = GROUNDS[name]()
        rows, cols = terrain.grid.shape
        z = terrain.read(0, 0, rows, 0, cols).astype(np.float64)
        with drawing(device, terrain) as it:
            legs = it.renderer.method.legs
            lattice = patch_vertices(legs).astype(np.int64)
            for _, view, tolerance, exaggeration in views(terrain, 8, seed=6):
                patches = it.chosen(view, tolerance, exaggeration).patches
                _, boxes = it.boxes(view, exaggeration, patches)
                lens = Projection.of(Camera.over(terrain.grid, view, exaggeration))
                e = STEPS[patches.instances["omega"]].astype(np.int64) << patches.instances["step"][:, None, None]
                at = np.stack([patches.instances["row"], patches.instances["col"]], -1)[:, None] + lattice @ e
                at = np.minimum(at, [rows - 1, cols - 1])
                high = z[at[..., 0], at[..., 1]]
                places = np.stack([at[..., 1], at[..., 0], high], -1) - lens.o
                x, y, w = np.moveaxis(places @ lens.matrix().T, -1, 0)
                if lens.perspective:
                    with np.errstate(divide="ignore", invalid="ignore"):
                        x, y = np.where(w > 0.05, x / w, np.nan), np.where(w > 0.05, y / w, np.nan)
                inside = (x >= 0) & (x < SIZE[0]) & (y >= 0) & (y < SIZE[1])
                which = np.broadcast_to(np.arange(len(at))[:, None], x.shape)[inside]
                i, j = (y[inside] // SIDE).astype(int), (x[inside] // SIDE).astype(int)
                x0, y0, x1, y1 = boxes[which].T
                assert ((x0 <= j) & (j < x1) & (y0 <= i) & (i < y1)).all(), (name, view)
                seen += int(inside.sum())
    assert seen > 50_000


def test_borders_keep_the_promise(device: Device) -> None:
    """The referee's verdict on pictures whose blocks take turns, beside those of either."""
    terrain = over(rough(700, 900, 500.0), GROUNDS["nested windows"]().grid.transform)
    eye = (*(float(v) for v in terrain.grid.xy(450.0, 600.0)), 700.0)
    for tolerance in (0.5, 2.0):
        view = look(eye, 20.0, -18.0, 2000.0)
        with drawing(device, terrain) as it:
            drawn = it.chosen(view, tolerance, 1.0, f"hybrid,block={SIDE},shares=turns")
            depth, marks = it.depth(view, 1.0, drawn)
        there = np.isfinite(depth)
        assert 0.2 < (marks[there] & 4 > 0).mean() < 0.8
        report = judge_depth(depth, terrain, view)
        assert report.hits > 10_000 and report.largest <= tolerance, (tolerance, report)


# ---- who draws what ------------------------------------------------------------------------------------------------

COSTS = Costs(100.0, 20.0, 30.0, 5.0, 700.0, 900.0)


def recount(frame: Frame, labels: NDArray[np.bool_]) -> float:
    """What drawing takes, patch by patch and block by block."""
    each = COSTS.begin * labels.any() + COSTS.both * (labels.any() and not labels.all())
    for x0, y0, x1, y1 in frame.boxes:
        each += any(not labels[i, j] for i in range(y0, y1) for j in range(x0, x1)) * COSTS.triangle * frame.triangles
    for i, j in np.ndindex(labels.shape):
        each += (
            COSTS.ray * frame.ground[i, j] + COSTS.step * frame.steps[i, j]
            if labels[i, j] else COSTS.pixel * frame.ground[i, j]
        )  # fmt: skip
    return each


@st.composite
def frames(draw: Any, most: int = 3) -> Frame:
    down, across = draw(st.integers(1, most)), draw(st.integers(1, most))
    boxes = []
    for _ in range(draw(st.integers(0, 12))):
        x, y = sorted(draw(st.lists(st.integers(0, across), min_size=2, max_size=2))), sorted(
            draw(st.lists(st.integers(0, down), min_size=2, max_size=2))
        )  # fmt: skip
        boxes.append((x[0], y[0], x[1], y[1]))
    cells = st.lists(st.integers(0, 64), min_size=down * across, max_size=down * across)
    ground, steps = (np.array(draw(cells), float).reshape(down, across) for _ in range(2))
    pixels = np.full((down, across), 64.0)
    return Frame(np.array(boxes, np.int64).reshape(-1, 4), 16, pixels, ground, steps * 40)


@settings(max_examples=80, deadline=None)
@given(frames())
def test_shares_are_no_dearer_than_either_way(frame: Frame) -> None:
    found, shape = share(frame, COSTS, 0.15), frame.pixels.shape
    assert found.cost == pytest.approx(recount(frame, found.by_rays))
    assert found.patches == pytest.approx(recount(frame, np.zeros(shape, bool)))
    assert found.rays == pytest.approx(recount(frame, np.ones(shape, bool)))
    assert found.cost <= min(found.patches, found.rays) * (1 + 1e-12)
    best = min(
        recount(frame, np.reshape(bits, shape)) for bits in itertools.product((False, True), repeat=frame.pixels.size)
    )
    assert best * (1 - 1e-12) <= found.cost <= 1.5 * best + 1e-9


@settings(max_examples=60, deadline=None)
@given(frames(4), st.data())
def test_sums_over_blocks_are_those_of_loops(frame: Frame, data: Any) -> None:
    shape, boxes = frame.pixels.shape, frame.boxes
    values = np.arange(1.0, len(boxes) + 1)
    labels = np.array(data.draw(st.lists(st.booleans(), min_size=frame.pixels.size, max_size=frame.pixels.size)))
    labels = labels.reshape(shape)
    sums, counts = np.zeros(shape), np.zeros(len(boxes), int)
    for k, (x0, y0, x1, y1) in enumerate(boxes):
        sums[y0:y1, x0:x1] += values[k]
        counts[k] = labels[y0:y1, x0:x1].sum()
    np.testing.assert_allclose(over_blocks(boxes, values, shape), sums)
    np.testing.assert_array_equal(count_over(boxes, labels), counts)


def test_blocks_go_to_the_cheaper_way_and_stay() -> None:
    """Tiny triangles on the left, none but the largest on the right; what sways a little changes nobody's part."""
    tiny = [(x, y, x + 1, y + 1) for x in range(4) for y in range(4) for _ in range(50)]
    frame = Frame(
        np.array([*tiny, (4, 0, 8, 4)]), 256, np.full((4, 8), 4096.0), np.full((4, 8), 4096.0), np.full((4, 8), 4e4)
    )
    found = share(frame, COSTS, 0.15)
    assert found.by_rays[:, :4].all() and not found.by_rays[:, 4:].any()
    assert found.cost < 0.65 * min(found.patches, found.rays)
    # Rays of one block come to cost what its patches do, a little more or less from frame to frame.
    even = (50 * 256 * COSTS.triangle + COSTS.pixel * 4096 - COSTS.ray * 4096) / COSTS.step
    rng, labels, changes, free = np.random.default_rng(1), found.by_rays, 0, 0
    for _ in range(50):
        steps = frame.steps.copy()
        steps[1, 1] = even * rng.uniform(0.9, 1.1)
        now = share(frame._replace(steps=steps), COSTS, 0.15, labels).by_rays
        free += int(share(frame._replace(steps=steps), COSTS, 0.0, labels).by_rays[1, 1] != labels[1, 1])
        changes, labels = changes + int((now != labels).sum()), now
    assert changes == 0 and free > 10
    steps[1, 1] = 2 * even
    assert not share(frame._replace(steps=steps), COSTS, 0.15, labels).by_rays[1, 1]


def test_steps_of_rays_are_counted_where_they_are_taken(device: Device) -> None:
    """Rays into the sky take none but what there is above all ground; along a rough plain they take many."""
    terrain = GROUNDS["nested windows"]()
    eye = (*(float(v) for v in terrain.grid.xy(1200.0, 900.0)), 420.0)
    view = look(eye, 20.0, -6.0, 2000.0)
    with drawing(device, terrain) as it:
        found = it.chosen(view, 1.0, 1.0)
        counted = it.ground._selected.selection.steps
        depth, _ = it.depth(view, 1.0, it.chosen(view, 1.0, 1.0, "raycast"))
        screen, boxes = it.boxes(view, 1.0, found.patches)
    assert counted.shape == (SIZE[1] // SPACING, SIZE[0] // SPACING)
    middles = np.isfinite(depth[SPACING // 2 :: SPACING, SPACING // 2 :: SPACING])
    assert (middles == (counted & 1 > 0)).mean() > 0.98 and 0.1 < middles.mean() < 0.95
    sky = ~middles & (np.arange(len(middles))[:, None] == 0)
    assert (counted >> 1)[middles].mean() > 3 * max((counted >> 1)[sky].mean(), 1)
    frame = _frame(boxes, 256, screen, counted)
    true = np.add.reduceat(np.add.reduceat(np.isfinite(depth), np.arange(0, SIZE[1], SIDE), 0),
                           np.arange(0, SIZE[0], SIDE), 1)  # fmt: skip
    assert frame.pixels.sum() == SIZE[0] * SIZE[1]
    assert np.abs(frame.ground - true).mean() < 0.15 * SIDE**2


# ---- frames and pictures -------------------------------------------------------------------------------------------


@pytest.mark.stress
def test_frames_measure_what_they_take_and_show_no_hole(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Flights that wait for nothing: patches at first, then both; no pixel within the terrain is left out."""
    monkeypatch.setattr(mixer, "_COSTS", {})
    measured: list[Costs] = []
    measure = mixer.Mixer.measure
    monkeypatch.setattr(mixer.Mixer, "measure", lambda *a: measured.append(measure(*a)) or measured[-1])
    terrain = GROUNDS["nested windows"]()
    renderer, target = Renderer(device, terrain), device.texture(SIZE, "rgba8unorm", "RENDER_ATTACHMENT").create_view()
    eye = (*(float(v) for v in terrain.grid.xy(1200.0, 900.0)), 500.0)
    scene = Scene.of(terrain, look(eye, 20.0, -15.0, 2000.0), method=f"hybrid,block={SIDE}", tolerance=0.3)
    plain = scene.but(samples=1, light="none", shadows=False, method="auto")

    def fly(scene: Scene) -> Iterator[tuple[FrameStats, View]]:
        until = time.monotonic() + 60
        for n in itertools.count(1):
            view = look((eye[0] + 2.0 * n, eye[1] + 3.0 * n, eye[2]), 20.0 + 0.2 * n, -15.0, 2000.0)
            stats = renderer.draw(target, "rgba8unorm", scene.but(view=view))
            yield stats, view
            assert time.monotonic() < until
            time.sleep(0.01)

    try:
        frames = [stats for stats, _ in itertools.takewhile(lambda _: not measured, fly(scene))]
        assert frames[0].patches > 0 and frames[0].windows == 0 and not frames[0].current
        (found,) = measured
        assert all(np.isfinite(v) and v >= 0 for v in found) and max(found[:2]) > 0 < max(found[2:])
        looked = 0
        for stats, view in fly(scene.but(method=f"hybrid,block={SIDE},shares=turns")):
            if looked == 2:
                break
            if stats.windows and stats.patches:
                inside = binary_erosion(np.isfinite(draw(plain.but(view=view), device=device).depth), iterations=2)
                assert inside.mean() > 0.3 and np.isfinite(renderer.depth())[inside].all()
                looked += 1
        # Far from what its windows are for rays would be too coarse, so patches draw all.
        there = look((*(float(v) for v in terrain.grid.xy(2700.0, 300.0)), 300.0), 200.0, -15.0, 2000.0)
        assert renderer.draw(target, "rgba8unorm", scene.but(view=there)).windows == 0
        until = time.monotonic() + 60
        while not renderer.resting and time.monotonic() < until:
            renderer.draw(target, "rgba8unorm", scene.but(view=there))
        assert renderer.resting
    finally:
        renderer.close()


@pytest.mark.stress
def test_tiles_of_a_picture_show_the_same_ground(device: Device) -> None:
    terrain = GROUNDS["nested windows"]()
    view = look((*(float(v) for v in terrain.grid.xy(1200.0, 900.0)), 700.0), 20.0, -15.0, 2000.0)
    scene = Scene.of(terrain, view, method="hybrid", tolerance=0.3, samples=1, light="none", shadows=False)
    whole, again = (draw(scene, device=device) for _ in range(2))
    np.testing.assert_array_equal(whole.pixels, again.pixels)  # costs are stated: the same each time
    part = draw(scene.but(view=view.tile(96, 64, 96, 64)), device=device)
    there = whole.depth[64:128, 96:192]
    assert np.isfinite(there).mean() > 0.5 and whole.facts["rays"]["method"] == "hybrid"
    np.testing.assert_array_equal(np.isfinite(part.depth), np.isfinite(there))
    close = np.abs(part.depth - there) <= 1e-5 * there
    assert (close | ~np.isfinite(there)).mean() > 0.6  # others were drawn the other way, and are within the tolerance
    assert judge_depth(part.depth, terrain, view.tile(96, 64, 96, 64)).ok(0.3)


def test_it_selects_both_and_makes_no_mesh() -> None:
    terrain = GROUNDS["holes"]()
    method = chosen("hybrid").make(terrain)
    view = look((*(float(v) for v in terrain.grid.xy(200.0, 250.0)), 900.0), 20.0, -15.0, 2000.0)
    found = method.select(Camera.over(terrain.grid, view), Goal(1.0))
    assert found.bound == 1.0 and len(found.windows) >= 1 and found.stats["method"] == "hybrid"
    assert len(found.select_patches().instances) > 0 and found.select_patches().bound == 1.0
    with pytest.raises(UsageError, match="no triangles"):
        found.tessellation()
    with pytest.raises(UsageError, match=r"hybrid cannot be drawn"):
        mesh_choice("hybrid", "cpu")
    with pytest.raises(UsageError, match="block"):
        chosen("hybrid,block=33")
