"""SMART: mesh and promise, masks and closure, strips that are kept, threads, memory, budgets."""

from __future__ import annotations

import functools

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.error.screen import camera_parameters
from orograph.errors import UsageError
from orograph.hierarchy import diamonds
from orograph.lod.block_boxes import box_bound
from orograph.lod.method import Resources
from orograph.lod.reference.camera import Camera as ReferenceCamera
from orograph.lod.reference.children import corners
from orograph.lod.reference.criterion import Spheres
from orograph.lod.reference.smart import Smart as Reference
from orograph.lod.reference.terrain import Ground
from orograph.lod.smart import Smart
from orograph.lod.smart_blocks import thresholds
from orograph.lod.smart_strip import ZONES, mask, masked_strip, shape_of
from orograph.raycast.select import Boxes, distances, off_axis
from orograph.viewpoint import Camera


def make(t, **options):
    return plain.refiner(Smart, t, **{"cells": 16} | options)


def case(rng, shape, gaps, amplitude=80.0):
    """A terrain, an exaggeration, a view, a tolerance; None where there is no ground."""
    z = plain.rough(rng, shape, gaps=gaps, amplitude=amplitude)
    if np.isnan(z).all():
        return None
    t = plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=float(rng.choice([1, 2.5])))
    return t, float(rng.choice([0.5, 1.0, 2.0])), plain.random_view(rng, t), float(10 ** rng.uniform(-1, 1.5))


@functools.cache
def hilly():
    return plain.terrain(plain.rough(np.random.default_rng(11), (257, 257), amplitude=500.0))


def as_drawn(ground, tree):
    """The squeezed corners (col, row) of what is drawn of the reference's triangles."""
    shown = [t for t in tree.triangles() if ground.is_known(t) and ground.has_ground(t)]
    return {frozenset(ground[v].place for v in corners(t)) for t in shown}


# ---- the reference -------------------------------------------------------------------------------------------------


@pytest.mark.cases(3)
@pytest.mark.parametrize("shape", [(65, 65), (40, 70), (17, 17), (9, 30), (2, 2), (3, 5)])
def test_mesh_is_the_reference_s(shape):
    rng = np.random.default_rng(shape)
    for k in range(3):
        found = case(rng, shape, 0.15 if k % 2 else 0.0)
        if found is None:
            continue
        t, exaggeration, view, tolerance = found
        ground = Ground.of(t, exaggeration=exaggeration)
        cull = k < 2
        mesh = make(t, cull=cull, exaggeration=exaggeration, jobs=1, ranges=2, boxes=False).refine(
            view, tolerance=tolerance
        )
        spheres = Spheres(ground, ReferenceCamera.of(view, exaggeration), cull=cull)
        m = min(4, t.n)
        tree = Reference(spheres, m, (thresholds(2) * exaggeration).tolist(), tolerance)
        tree.divide((t.n, 0, 0))
        tree.balance()
        assert mesh.stats["blocks"] == len(tree.drawn)
        assert plain.triangles_of(mesh) == as_drawn(ground, tree)


def test_the_finest_mesh_is_the_surface():
    t = plain.terrain(np.random.default_rng(5).normal(0, 20, (65, 65)).astype(np.float32))
    view = plain.random_view(np.random.default_rng(6), t)
    mesh = make(t, cull=False).refine(view, tolerance=0.0)
    assert len(mesh.triangles) == 2 * 64 * 64
    assert verify.judge_mesh(mesh, t, view).ok(0.0)


# ---- masks ---------------------------------------------------------------------------------------------------------


def closed(rng, m, count):
    """A random closed set of a block's vertices, (side, side) bool, and with its corners."""
    side = (1 << m) + 1
    seeds = np.zeros((side, side), bool)
    seeds[tuple(rng.integers(0, side, (2, count)))] = True
    found = diamonds.closure(seeds)
    found[:: side - 1, :: side - 1] = True
    return found


def leaves_of(active, falls):
    """The triangles of bisection by a closed set, as sets of vertex numbers: recursion, no strip."""
    side = len(active)
    last = side - 1
    nw, ne, sw, se = 0, last, last * side, last * side + last
    e, x, first, second = (nw, se, ne, sw) if falls else (ne, sw, nw, se)
    found = []

    def halve(e, x, a):
        m = (e + x) // 2
        even = (e // side + x // side) % 2 == 0 and (e % side + x % side) % 2 == 0
        if even and active.flat[m]:
            halve(e, a, m)
            halve(a, x, m)
        else:
            found.append(tuple(sorted((e, x, a))))

    halve(e, x, first)
    halve(x, e, second)
    return sorted(found)


@pytest.mark.parametrize("falls", [True, False])
@pytest.mark.parametrize("m", [1, 2, 4, 6])
def test_a_masked_strip_is_the_mesh(m, falls):
    """All triangles, once each, turning left, for random closed sets."""
    rng, shape = np.random.default_rng([m, falls]), shape_of(m)
    side, ratios = shape.side, []
    for _ in range(20):
        active = closed(rng, m, int(rng.integers(0, 1 + 4**m // 3)))
        if not falls:
            active = np.ascontiguousarray(active[:, ::-1])
        out = np.empty(2 * shape.strips.shape[1] + 8, np.int16)
        strip = out[: masked_strip(shape, falls, active.ravel().astype(np.uint8), out)].astype(int)
        found = []
        for i, (a, b, c) in enumerate(zip(strip, strip[1:], strip[2:])):
            if len({a, b, c}) == 3:
                (ay, ax), (by, bx), (cy, cx) = (divmod(v, side) for v in (a, b, c))
                turn = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
                assert (turn < 0) == (i % 2 == 0) and turn
                found.append(tuple(sorted((a, b, c))))
        assert sorted(found) == leaves_of(active, falls)
        ratios.append(len(strip) / len(found))
    assert m < 4 or np.median(ratios) < 1.7


def test_regions_hold_those_of_children_and_zones_are_what_they_touch():
    shape = shape_of(4)
    side, cells = 17, 16
    y, x = np.mgrid[:side, :side].reshape(2, -1)
    spacing = np.minimum(*(np.where(v % cells == 0, cells, v & -v) for v in (y, x)))
    reach = np.where((y // spacing % 2 == 1) & (x // spacing % 2 == 1), 3, 2) * spacing
    seen = 0
    for child in np.flatnonzero(spacing < cells):
        seeds = np.zeros((side, side), bool)
        seeds[y[child], x[child]] = True
        for v in np.flatnonzero(diamonds.closure(seeds).ravel() & (spacing < cells)):
            assert max(abs(y[v] - y[child]), abs(x[v] - x[child])) + reach[child] <= reach[v]
            seen += v != child
    assert seen > 500
    for v in range(side * side):
        if spacing[v] == cells:
            assert not shape.zones[v]
            continue
        for z, (i, j) in enumerate(ZONES):
            cells_of = np.mgrid[i * 8 : i * 8 + 8, j * 8 : j * 8 + 8].reshape(2, -1) + 0.5
            touched = ((np.abs(cells_of - [[y[v]], [x[v]]])).max(0) < reach[v]).any()
            assert touched == bool(shape.zones[v] >> z & 1)


def test_masks_are_nested_and_closed():
    """By ranges, whatever is around the block: what is active in a range is so in all finer ones."""
    rng, shape = np.random.default_rng(3), shape_of(5)
    side = shape.side
    # Ranks that never rise on the way up: of the first of some nested closed sets that a vertex is in.
    ranks = np.full((side, side), 9, np.uint8)
    found = np.zeros((side, side), bool)
    for rank in range(8):
        found |= closed(rng, 5, 12 << rank // 2)
        found = diamonds.closure(found)
        ranks[found & (ranks == 9)] = rank
    before = None
    for own in range(9):
        wanted = np.full(len(ZONES) + 2, own, np.uint8)
        wanted[1:-1] = np.maximum(own, rng.integers(0, 9, len(ZONES))) if before is not None else own
        wanted[-1] = 0
        active = np.empty(side * side, np.uint8)
        mask(shape, ranks.ravel(), wanted, active)
        assert diamonds.is_closed(active.reshape(side, side) > 0)
        alone = np.empty(side * side, np.uint8)
        mask(shape, ranks.ravel(), np.r_[np.full(len(ZONES) + 1, own), 0].astype(np.uint8), alone)
        assert (active >= alone).all() and (before is None or (alone >= before).all())
        before = alone


# ---- the promise ---------------------------------------------------------------------------------------------------


def test_promise_and_no_defect():
    rng = np.random.default_rng(21)
    for k in range(24):
        shape = tuple(int(v) for v in rng.integers(2, 300, 2))
        found = case(rng, shape, float(rng.choice([0, 0.03, 0.3])))
        if found is None:
            continue
        t, exaggeration, _, _ = found
        cells, ranges = int(rng.choice([16, 16, 32])), int(rng.choice([1, 4, 7]))
        method = make(t, cells=cells, ranges=ranges, exaggeration=exaggeration, cull=k != 3)
        for _ in range(3):
            near, far = float(rng.choice([0, 0, 50])), float(rng.choice([np.inf, np.inf, 3000]))
            view = plain.random_view(rng, t, near=near, far=far)
            tolerance = float(rng.choice([0.5, 1, 2, 4, 8]))
            mesh = method.refine(view, tolerance=tolerance)
            assert mesh.stats["conservative"]
            report = verify.judge_mesh(mesh, t, view, exaggeration=exaggeration)
            assert report.ok(tolerance), (shape, report)


def test_bounds_of_boxes_hold_for_what_is_in_view():
    """Against points of boxes, displaced along the vertical, that are projected one by one."""
    rng, seen = np.random.default_rng(2), 0
    for _ in range(300):
        t = plain.terrain(plain.rough(rng, (40, 60)), angle=float(rng.uniform(0, 360)), stretch=2.5)
        exaggeration, view = float(rng.choice([0.5, 1, 2])), plain.random_view(rng, t)
        west, north = rng.uniform(0, 30, 2)
        low = float(rng.uniform(*t.height_range))
        box = (west, west + rng.uniform(0, 20), north, north + rng.uniform(0, 20), low, low + rng.uniform(0, 200))
        e = float(10 ** rng.uniform(-1, 2))
        lens = camera_parameters(Camera.over(t.grid, view, exaggeration))
        away = distances(t, view, exaggeration, Boxes(*(np.array([v]) for v in box)))[0]
        bound = box_bound(lens, box, float(away), float(np.sqrt(off_axis(view))), e)
        share = rng.choice([0, 0.5, 1], (200, 3))
        col, row = (lo + share[:, k] * (hi - lo) for k, (lo, hi) in enumerate((box[:2], box[2:4])))
        z = box[4] - e + share[:, 2] * (box[5] - box[4] + 2 * e)
        camera = plain.Camera(view, exaggeration)
        at = camera.to_camera(np.stack([*t.grid.xy(col, row), z], -1))
        planes = camera.planes()
        at = at[(at @ planes[:, :3].T + planes[:, 3] >= 0).all(1)]
        for sign in (-e, e) if len(at) else ():
            moved = at + sign * camera.up
            off = moved[:, :2] / moved[:, 2:] - at[:, :2] / at[:, 2:]
            most = camera.focal * np.hypot(*off.T).max() if (moved[:, 2] > 0).all() else np.inf
            assert most <= bound * (1 + 1e-9)
            seen += np.isfinite(bound)
    assert seen > 100


def test_blocks_of_several_levels_meet():
    """Most blocks of a low view are coarse, some fine, and those that touch are at most twice as small."""
    t = plain.terrain(plain.rough(np.random.default_rng(4), (1025, 1025), amplitude=300.0))
    x, y = t.grid.xy(100, 900)
    z = float(t.heights[900, 100])
    view = plain.View(
        (float(x), float(y), z + 60), (float(x) + 9e3, float(y) + 9e3, z), fov_y=50, width=640, height=400
    )
    method = make(t)
    mesh = method.refine(view, tolerance=4.0)
    assert verify.judge_mesh(mesh, t, view).ok(4.0)
    tree = method.tree
    levels = np.full((64, 64), -1)
    for level, (base, width) in enumerate(zip(tree.base, tree.width)):
        for i, j in np.argwhere(tree.states[base : base + width**2].reshape(width, width) == 1):
            s = 1 << level
            levels[i * s : i * s + s, j * s : j * s + s] = level
    assert set(np.unique(levels)) >= {-1, 0, 1, 2}
    for a, b in ((levels[1:], levels[:-1]), (levels[:, 1:], levels[:, :-1]), (levels[1:, 1:], levels[:-1, :-1])):
        both = (a >= 0) & (b >= 0)
        assert np.abs(a - b)[both].max() == 1


# ---- strips that are kept ------------------------------------------------------------------------------------------


def test_strips_are_kept_and_change_nothing():
    kept, anew = make(hilly()), make(hilly(), cache=False)
    made = []
    x, y = (float(v) for v in hilly().grid.xy(30, 220))
    for step in range(12):
        view = plain.View(
            (x + 20 * step, y + 20 * step, 1500.0), (x + 4e3, y + 4e3, 0.0), fov_y=45, width=640, height=400
        )
        a, b = kept.refine(view, tolerance=1.0), anew.refine(view, tolerance=1.0)
        assert np.array_equal(a.strip, b.strip) and np.array_equal(a.vertices, b.vertices)
        assert b.stats["triangulated"] == b.stats["blocks"] == a.stats["blocks"]
        made.append(a.stats["triangulated"] / a.stats["blocks"])
    assert made[0] == 1 and np.mean(made[1:]) < 0.5
    assert kept.refine(view, tolerance=1.0).stats["triangulated"] == 0
    assert not anew._strips and anew._bytes == 0


def test_strip_and_triangles_are_the_same_set():
    rng = np.random.default_rng(8)
    for gaps in (0.0, 0.1):
        t = plain.terrain(plain.rough(rng, (100, 129), amplitude=300.0, gaps=gaps))
        mesh = make(t).refine(plain.random_view(rng, t), tolerance=1.0)
        found = [tuple(sorted(t)) for t in zip(mesh.strip, mesh.strip[1:], mesh.strip[2:]) if len(set(t)) == 3]
        assert sorted(found) == sorted(tuple(sorted(t)) for t in mesh.triangles.tolist())


# ---- threads, memory, budgets --------------------------------------------------------------------------------------


def test_threads_change_nothing():
    for seed in range(3):
        view = plain.random_view(np.random.default_rng(seed), hilly())
        one, *others = (make(hilly(), jobs=jobs).refine(view, tolerance=1.0) for jobs in (1, 2, 5))
        for other in others:
            assert np.array_equal(one.strip, other.strip) and np.array_equal(one.vertices, other.vertices)


def test_memory_changes_what_is_read_but_not_the_mesh():
    rng = np.random.default_rng(12)
    t = plain.terrain(plain.rough(rng, (1025, 900), amplitude=900.0, gaps=0.01))
    free, tight = make(t, jobs=2), make(t, jobs=2, max_memory=26 << 20)
    tight.method.resources = Resources(1 << 20, 2)  # of which a quarter is for strips
    for k in (*range(5), 0):
        x, y = (float(v) for v in t.grid.xy(100 + 160 * k, 900 - 160 * k))
        view = plain.View((x - 3000, y - 1000, 4000.0), (x, y, 0.0), fov_y=20.0, width=640, height=400)
        a, b = free.refine(view, tolerance=2.0), tight.refine(view, tolerance=2.0)
        assert np.array_equal(a.strip, b.strip) and np.array_equal(a.vertices, b.vertices)
    assert tight.field.resident <= 13 < free.field.resident and tight._bytes <= 1 << 18 < free._bytes
    wide = plain.random_view(rng, t, fov_y=120.0)
    with pytest.raises(UsageError, match="One view needs more than"):
        make(t, max_memory=26 << 20, cull=False).refine(wide, tolerance=0.001)


def test_budgets():
    t = hilly()
    method, view = make(t), plain.random_view(np.random.default_rng(5), t)
    for budget in (5000, 20_000):
        found = method.refine(view, triangles=budget)
        assert len(found.triangles) <= budget and found.stats["within_budget"]
        assert verify.judge_mesh(found, t, view).ok(found.stats["tolerance"])
    slow = method.refine(view, seconds=0.1)
    assert verify.judge_mesh(slow, t, view).ok(slow.stats["tolerance"])


@pytest.mark.parametrize("boxes", [True, False])
def test_colors_split_what_is_large_enough_to_be_seen(boxes):
    """Every vertex in view whose colours count is there; a γ above all errors changes nothing."""
    rng, patch = np.random.default_rng(8), np.zeros((129, 129), bool)
    patch[60:72, 30:41] = True
    table = np.where(diamonds.closure(patch), 9.0, 1.0).astype(np.float32)

    def color(level, row0, row1, col0, col1):
        return table[:: 1 << level, :: 1 << level][row0:row1, col0:col1]

    for gaps in (0.0, 0.1):
        t, counts = plain.terrain(plain.rough(rng, (129, 120), amplitude=20.0, gaps=gaps)), {}
        arrays = plain.Plain(t)
        plainly = (arrays.r > 0) & np.isfinite(arrays.e) & (arrays.col < 120)  # whole ground around it
        for gamma in (None, 10.0, 5.0, 0.5):
            method = make(t, boxes=boxes, color=color, color_tolerance=gamma)
            for seed in range(4):
                view = plain.random_view(np.random.default_rng(seed), t)
                mesh, camera = method.refine(view, tolerance=20.0), plain.Camera(view)
                assert verify.judge_mesh(mesh, t, view).ok(20.0)
                counts[gamma] = counts.get(gamma, 0) + len(mesh.triangles)
                at = camera.to_camera(arrays.at)
                seen = ((at @ camera.frustum[:, :3].T + camera.frustum[:, 3]) > 0).all(-1)
                seen &= plainly & (arrays.r * camera.focal > at[..., 2] - arrays.r)
                there = {(int(row), int(col)) for col, row, _ in mesh.vertices}
                for row, col in np.argwhere(seen & (table > (gamma or np.inf))).tolist():
                    assert (row, col) in there
        assert counts[None] == counts[10.0] < counts[5.0] < counts[0.5]


@pytest.mark.stress
@pytest.mark.parametrize("name", plain.GROUND)
def test_the_referee_finds_the_promise_kept(shared_data, name):
    """42 views of each of five terrains, by blocks of 16 and 32 cells."""
    t = plain.ground(shared_data, name)
    rng = np.random.default_rng(1)
    methods = [make(t, cells=cells) for cells in (16, 32)]
    for k in range(42):
        view = plain.random_view(rng, t, width=1280, height=720)
        tolerance = float(2 ** rng.uniform(-1, 3))
        method = methods[k % 2]
        report = verify.judge_mesh(method.refine(view, tolerance=tolerance), t, view)
        assert report.ok(tolerance), (method.options.cells, view, tolerance, report)
