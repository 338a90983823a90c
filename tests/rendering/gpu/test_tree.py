"""The tree that lives on the GPU: every update against the CPU's pool and the paper, what it ends at against the other
methods and the referee, with what memory and tiles there are; and that no frame looks at it."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from orograph import verify
from orograph.geovis.color_errors import ColorErrors
from orograph.gpu.device import Device
from orograph.hierarchy import fronts
from orograph.lod.cbt import Cbt
from orograph.lod.cbt.pool import Pool
from orograph.lod.field import Vertices
from orograph.lod.method import Goal
from orograph.lod.reference import stateless
from orograph.lod.reference.camera import Camera as ReferenceCamera
from orograph.lod.reference.children import corners
from orograph.lod.reference.criterion import Spheres
from orograph.lod.reference.terrain import Ground
from orograph.lod.registry import chosen
from orograph.lod.triangle_patches import TrianglePatches
from orograph.rendering.gpu.draw import draw
from orograph.rendering.gpu.renderer import Renderer
from orograph.rendering.gpu.stream.diamonds import DiamondPages, packed
from orograph.rendering.gpu.surface.growing import Growing, living
from orograph.rendering.gpu.surface.tree import LEAST, Tree
from orograph.scene.scene import Scene
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import Camera, View

sys.path.append(str(Path(__file__).parents[2] / "lod"))
import plain
from test_cbt import checked


def tree_of(device: Device, t: MemoryTerrain, budget: int = 64 << 20, **options: Any) -> Tree:
    vertices = Vertices(t)
    return Tree(device, t, vertices.corners, DiamondPages(device, vertices, budget), LEAST, **options)


def settled(tree: Tree, view: View, tolerance: float, exaggeration: float = 1.0) -> Pool:
    """The pool at the end, with all pages that the tree asks for."""
    before = -1
    while True:
        tree.update(view, tolerance, exaggeration, 4)
        changes = tree.counts().changes
        if changes == before and not tree.pages.take_asked(tree.take_asked()):
            return tree.pool()[0]
        before = changes


def valid(pool: Pool, n: int) -> bool:
    return fronts.is_valid(fronts.Front.of(n, *pool.shape[pool.leaves].T))


def vertices_of(pool: Pool) -> set[int]:
    return set(pool.corners(pool.leaves).ravel().tolist())


def unpacked(words: NDArray[np.uint32]) -> NDArray[np.float32]:
    """The vertices (…, 4) that ``packed`` made so."""
    out = np.empty((*words.shape[:-1], 4), np.float32)
    out[..., 0] = words[..., 0].view(np.float32)
    for k, least in enumerate((2.0**-16, 2.0**-8)):
        code = (words[..., 1] >> (15 * k) & 0x7FFF).astype(np.int64)
        value = least * 2.0 ** (code >> 10) * (1 + (code & 1023) / 1024)
        out[..., 1 + k] = np.where(code == 0, 0.0, np.where(code == 0x7FFF, np.inf, value))
    out[..., 2] = np.where(words[..., 1] & 0x3FFFFFFF == 0x7FFF, -1.0, out[..., 2])
    color = np.where(words[..., 1] >> 30 & 1, 1e3, 0.0)
    out[..., 3] = np.where(words[..., 1] >> 31, -1.0 - color, color)
    return out


def test_vertices_are_packed_a_little_too_large(device: Device) -> None:
    rng = np.random.default_rng(3)
    page = np.empty((1000, 4), np.float32)
    page[:, 0] = rng.normal(0, 1e4, 1000)
    page[:, 1:3] = 10.0 ** rng.uniform([-4.5, -2], [4.5, 7], (1000, 2))
    page[:, 3] = 0.0
    page[:4, 1], page[4:9, 2], page[5:7, 3] = (0.0, np.inf, 1e9, 1e-30), (0.0, -1.0, -5e5, 1e20, 1e-9), (-1.0, -1.5)
    found = unpacked(packed(page))
    assert np.array_equal(found[:, 0], page[:, 0]) and np.array_equal(found[:, 3] < 0, page[:, 3] < 0)
    assert np.array_equal(found[:, 2] < 0, page[:, 2] < 0)
    assert (found[[0, 4], [1, 2]] == 0).all() and np.isinf(found[[1, 2, 7], [1, 1, 2]]).all()
    for k, least in ((1, 2.0**-16), (2, 2.0**-8)):
        given = np.maximum(page[:, k], 0)
        usual = np.isfinite(found[:, k]) & (page[:, k] > 0)
        assert (found[usual, k] >= given[usual]).all()
        assert (found[usual, k] <= np.maximum(given[usual], least) * (1 + 2.0**-10)).all()


GAMMA = 12.0


@pytest.fixture
def rounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The CPU has the GPU's errors and radii: those that are packed and unpacked again."""
    real = Vertices.page

    def page(self: Vertices, *args: int) -> NDArray[np.float32]:
        return unpacked(packed(real(self, *args), GAMMA))

    monkeypatch.setattr(Vertices, "page", page)


@pytest.mark.parametrize(
    ("shape", "gaps"),
    [((17, 17), 0.0), ((33, 18), 0.15), ((20, 31), 0.15), ((9, 30), 0.0), ((2, 2), 0.0), ((3, 5), 0.0)],
)
def test_what_it_ends_at_lies_between_the_references(device: Device, shape: tuple[int, int], gaps: float) -> None:
    """Float32 counts a little worse than it is: at least the reference's triangles, at most those of 0.2 % less."""
    rng = np.random.default_rng([*shape, int(gaps * 100), 1])
    t = plain.terrain(plain.rough(rng, shape, gaps=gaps), angle=float(rng.uniform(0, 360)), stretch=2.5)
    if np.isnan(t.heights).all():
        return
    ground, same = Ground.of(t, exaggeration=2.0), 0
    tree = tree_of(device, t)
    for _ in range(3):
        view, tolerance = plain.random_view(rng, t), float(10 ** rng.uniform(-1, 1))
        pool = settled(tree, view, tolerance, 2.0)
        checked(pool, t.n)
        spheres = Spheres(ground, ReferenceCamera.of(view, 2.0))

        def kept(pixels: float, spheres: Spheres = spheres) -> set[int]:
            """Vertices that are there because of the criterion."""
            found = stateless.refine(t.n, lambda i: not ground[i].empty and spheres.priority(i) > pixels)
            return {y << 32 | x for triangle in found for x, y in corners(triangle)}

        assert kept(tolerance) <= vertices_of(pool)
        expected = plain.sphere_mesh(ground, view, tolerance, exaggeration=2.0)
        found = plain.triangles_of(tree.tessellation({}))
        same += found == expected
        finer = plain.sphere_mesh(ground, view, 0.998 * tolerance, exaggeration=2.0)
        assert len(found) <= max(len(finer), len(expected)) * 1.01 + 2
    assert same >= 2


def test_every_update_leaves_a_conforming_mesh_and_right_sums(device: Device) -> None:
    rng = np.random.default_rng(4)
    t = plain.terrain(plain.rough(rng, (129, 150), amplitude=400, gaps=0.05))
    tree = tree_of(device, t)
    for _ in range(3):
        view = plain.random_view(rng, t)
        for _ in range(6):
            tree.update(view, 1.0, 1.0, 1)
            tree.pages.take_asked(tree.take_asked())
            pool, shown = tree.pool()
            assert valid(pool, t.n)
            assert not (shown & ~pool.used).any()
            # The sums are those of the bits, and lead thread i to the i-th of them.
            words = device.read_buffer(tree.bits, np.uint32)
            sums = device.read_buffer(tree.sums, np.uint32)
            level = np.array([int(word).bit_count() for word in words])
            while len(level):
                assert np.array_equal(sums[len(level) : 2 * len(level)], level)
                level = level[::2] + level[1::2] if len(level) > 1 else level[:0]
            listed = device.read_buffer(tree.list, np.uint32)[: sums[1]]
            assert np.array_equal(listed, pool.leaves)
        checked(pool, t.n)


@pytest.mark.parametrize("metric", ["anisotropic", "isotropic"])
@pytest.mark.usefixtures("rounded")
def test_the_promise_holds_and_the_cpu_makes_the_same_mesh(device: Device, metric: str) -> None:
    rng = np.random.default_rng(5)
    t = plain.terrain(plain.rough(rng, (257, 300), amplitude=300, gaps=0.04), stretch=0.7)
    method, tree = Cbt(t, metric=metric), tree_of(device, t, isotropic=metric == "isotropic")
    same = 0
    for _ in range(3):
        view = plain.random_view(rng, t)
        settled(tree, view, 1.5)
        found = tree.tessellation({})
        report = verify.judge_mesh(found, t, view)
        assert report.ok(1.5) and not report.defects
        expected = method.select(Camera.over(t.grid, view, 1.0), Goal(1.5)).mesh
        same += plain.triangles_of(found) == plain.triangles_of(expected)
        assert abs(len(found.triangles) - len(expected.triangles)) <= 1 + 1e-3 * len(expected.triangles)
    assert same >= 2


@pytest.mark.parametrize("tolerance", [1.5, 1e6])
@pytest.mark.usefixtures("rounded")
def test_colours_split_where_the_cpu_splits_for_them(device: Device, tolerance: float) -> None:
    rng = np.random.default_rng(8)
    t = plain.terrain(plain.rough(rng, (180, 257), amplitude=300, gaps=0.04), stretch=0.7)
    colors = ColorErrors(t)
    method = plain.refiner(Cbt, t, color=colors, color_tolerance=GAMMA)
    vertices = Vertices(t, color=colors)
    tree = Tree(device, t, vertices.corners, DiamondPages(device, vertices, 64 << 20, gamma=GAMMA), LEAST)
    same = more = 0
    for _ in range(4):
        view = plain.random_view(rng, t)
        settled(tree, view, tolerance)
        found, expected = tree.tessellation({}), method.refine(view, tolerance=tolerance)
        same += plain.triangles_of(found) == plain.triangles_of(expected)
        assert abs(len(found.triangles) - len(expected.triangles)) <= 1 + 1e-3 * len(expected.triangles)
        more += len(expected.triangles) > len(plain.refiner(Cbt, t).refine(view, tolerance=tolerance).triangles)
    assert same >= 3 and more >= 3


@pytest.mark.usefixtures("rounded")
def test_in_a_plan_colours_split_what_is_larger_than_a_pixel(device: Device) -> None:
    rng = np.random.default_rng(9)
    t = plain.terrain(plain.rough(rng, (180, 257), amplitude=300, gaps=0.04), stretch=0.7)
    colors = ColorErrors(t)
    method = plain.refiner(Cbt, t, color=colors, color_tolerance=GAMMA)
    vertices = Vertices(t, color=colors)
    tree = Tree(device, t, vertices.corners, DiamondPages(device, vertices, 64 << 20, gamma=GAMMA), LEAST)
    counts = []
    for away in (60_000.0, 15_000.0, 3000.0):
        x, y = t.grid.xy(*rng.uniform(60, 120, 2))
        view = View((x, y, away), (x, y, 0.0), fov_y=20, width=90, height=60, projection="plan")
        settled(tree, view, 1.0)
        found = plain.triangles_of(tree.tessellation({}))
        assert found == plain.triangles_of(method.refine(view, tolerance=1.0))
        counts.append((len(found), len(plain.refiner(Cbt, t).refine(view).triangles)))
    assert all(found > holes for found, holes in counts), counts


def test_triangles_squeezed_to_a_line_are_not_drawn(device: Device) -> None:
    """Beyond the raster's end vertices have no ground: such triangles would stand on it as spikes."""
    rng = np.random.default_rng(10)
    t = plain.terrain(500 + plain.rough(rng, (40, 51), amplitude=90))
    x, y = t.grid.xy(25, 20)
    tree = tree_of(device, t)
    settled(tree, View((x, y - 1500, 1200.0), (x, y, 500.0), width=320, height=200), 1e-3)
    pool, shown = tree.pool()
    keys = pool.corners(np.flatnonzero(shown))
    row, col = np.minimum(keys >> 32, 39), np.minimum(keys & 0xFFFFFFFF, 50)
    assert len(keys) > 3800
    assert (np.ptp(row, axis=1) > 0).all() and (np.ptp(col, axis=1) > 0).all()


def test_a_pool_that_is_full_and_pages_that_are_not_there_leave_a_conforming_mesh(device: Device) -> None:
    rng = np.random.default_rng(6)
    t = plain.terrain(plain.rough(rng, (900, 700), amplitude=900))
    x, y = t.grid.xy(350, 450)
    view = View((x, y - 20000, 9000.0), (x, y, 0.0), width=1280, height=720)
    tree = tree_of(device, t)
    for _ in range(8):
        tree.update(view, 3.0, 1.0, 4)  # the coarsest pages alone
    pool, _ = tree.pool()
    coarse = len(pool.leaves)
    assert valid(pool, t.n)
    assert (pool.shape[pool.leaves, 2] >= 1 << t.levels - 2).all() and coarse < LEAST // 2
    assert tree.take_asked().any()
    for _ in range(8):
        tree.update(view, 0.2, 1.0, 4)
        tree.pages.take_asked(tree.take_asked())
    pool, _ = tree.pool()
    assert valid(pool, t.n)
    counts = tree.counts()
    assert coarse < LEAST - 2 <= counts.triangles <= LEAST and counts.wanted > LEAST - counts.triangles
    for _ in range(8):  # and it comes back
        tree.update(view, 200.0, 1.0, 4)
    assert tree.counts().triangles < coarse
    assert valid(tree.pool()[0], t.n)


@pytest.mark.stress
def test_a_picture_says_when_the_tree_is_full(device: Device) -> None:
    rng = np.random.default_rng(6)
    t = plain.terrain(plain.rough(rng, (300, 300), amplitude=900))
    x, y = t.grid.xy(150, 150)
    view = View((x, y - 8000, 5000.0), (x, y, 0.0), width=160, height=90)
    picture = draw(Scene.of(t, view, method=f"cbt,slots={LEAST}", tolerance=0.02, light="none"), device=device)
    assert any(f"slots={2 * LEAST}" in warning for warning in picture.facts["warnings"])
    whole = draw(Scene.of(t, view, method="cbt", tolerance=0.1, light="none"), device=device)
    assert not whole.facts["warnings"]
    assert verify.judge_depth(whole.depth, t, view).largest <= 0.12


@pytest.mark.parametrize("method", ["cbt", pytest.param("cbt,color-tolerance=4", marks=pytest.mark.stress)])
def test_frames_come_to_rest_at_the_same_tree_and_nothing_is_read_back(
    device: Device, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    rng = np.random.default_rng(9)
    t = plain.terrain(plain.rough(rng, (700, 800), amplitude=600))
    x, y = t.grid.xy(400, 350)
    views = [View((x + 200 * k, y - 9000, 4000.0), (x + 200 * k, y, 0.0), width=160, height=90) for k in range(6)]
    scene = Scene.of(t, views[0], method=method, tolerance=0.7, light="none")
    target = device.texture((160, 90), "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC").create_view()
    renderer = Renderer(device, t, gpu_memory=64 << 20)
    growing = renderer._ground.growing
    while growing.selection is None:  # it is planted in a thread; patches stand in
        stats = renderer.draw(target, "rgba8unorm", scene)
        assert growing.selection is not None or (stats.patches > 0 and not stats.current)
        time.sleep(0.01)
    with monkeypatch.context() as patched:
        for name in ("counts", "take_asked", "pool"):
            patched.setattr(Tree, name, lambda self: pytest.fail("A frame reads the tree back."))
        for view in views:
            stats = renderer.draw(target, "rgba8unorm", scene.but(view=view))
            assert stats.patches == 0 and not stats.failed and not stats.current
    end = time.monotonic() + 60
    while renderer.busy and time.monotonic() < end:
        stats = renderer.draw(target, "rgba8unorm", scene.but(view=views[-1]))
        time.sleep(0.002)
    assert stats.current and stats.error_px == 0.7
    found = renderer.tree.tessellation()
    assert stats.triangles >= len(found.triangles)
    renderer.close()
    other, still = Growing(device, t, 64 << 20), scene.but(view=views[-1])
    patches = TrianglePatches(t).patches(Camera.over(t.grid, views[-1], 1.0), 0.7)
    other.at_once(still, views[-1], living(still), patches)
    expected = other.selection.tessellation()
    assert plain.triangles_of(found) == plain.triangles_of(expected)
    assert verify.judge_mesh(found, t, views[-1]).ok(0.7)
    other.close()


def test_what_cannot_be_is_told(device: Device) -> None:
    scene = Scene.of(plain.terrain(np.zeros((9, 9), np.float32)), View((0, 0, 100.0), (1, 1, 0.0)), method="cbt")
    assert living(scene.but(triangles=100)) is None and living(scene.but(method="soar")) is None
    assert chosen("cbt,slots=20000").options.slots == 20000
