"""ROAM from frame to frame: against plain recursion from scratch, and against the referee on real ground."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import plain
import pytest
import rasterio

from orograph import verify
from orograph.geo.grid import Grid
from orograph.lod import look_ahead as ahead
from orograph.lod import pace
from orograph.lod.reference import roam as reference
from orograph.lod.reference import top_down
from orograph.lod.reference.children import corners
from orograph.lod.reference.terrain import Ground
from orograph.lod.roam import Roam, bounds, mesh, method, priorities, queues
from orograph.store.memory import MemoryTerrain
from orograph.viewpoint import View


class Recursion:
    """The smallest conforming mesh that keeps a tolerance, from the definition: volumes go down the tree.

    A triangle's volume is its footprint (the squeezed bounding box where it reaches beyond the raster) between two
    heights: the parent's, the sphere of its diamond, and its corners' ± its error.
    """

    def __init__(self, p: plain.Plain, camera: plain.Camera, tolerance: float, cull: bool, metric: str):
        self.p, self.camera, self.tolerance, self.cull, self.metric = p, camera, tolerance, cull, metric
        side = p.z.shape[0]
        self.wanted: set[frozenset] = set()
        self.out: set[tuple] = set()
        self.spheres = p.sphere_errors(camera, loose=True)
        low, high = p.t.height_range
        n = side - 1
        self.pruned = 0
        self.visit((0, 0), (n, n), (0, n), low, high)
        self.visit((n, n), (0, 0), (n, 0), low, high)
        self.T = top_down.refine(p.n, lambda t: frozenset(corners(t)) in self.wanted)

    def visit(self, a, b, c, low, high, hidden=False):
        """Whether the triangle is to be split for its own sake or that of one below it."""
        p = self.p
        m = ((a[0] + b[0]) // 2, (a[1] + b[1]) // 2)
        finest = (a[0] + b[0]) % 2 or (a[1] + b[1]) % 2
        rows, cols = (np.array(v) for v in zip(a, b, c))
        squeezed = bool((rows >= p.t.grid.rows).any() or (cols >= p.t.grid.cols).any())
        z = p.z[rows, cols]
        e = 0.0 if finest else p.e[m]
        if (not finest and p.r[m] < 0) or rows.min() >= p.t.grid.rows - 1 or cols.min() >= p.t.grid.cols - 1:
            return False  # nothing there, on this side of the hypotenuse at least
        if not finest:
            low, high = max(low, p.filled[m] - p.r[m]), min(high, p.filled[m] + p.r[m])
        if not squeezed and math.isfinite(e) and not np.isnan(z).any():
            low, high = max(low, z.min() - e), min(high, z.max() + e)
        i, j = p.i[rows, cols], p.j[rows, cols]
        if squeezed:
            i, j = np.array([i.min(), i.max(), i.min(), i.max()]), np.array([j.min(), j.min(), j.max(), j.max()])
        x, y = p.t.grid.xy(j, i)
        volume = np.stack([np.tile(x, 2), np.tile(y, 2), np.repeat([low, high], len(x))], -1)
        q = self.camera.to_camera(volume)
        planes = self.camera.planes()
        out = hidden or bool(((q @ planes[:, :3].T + planes[:, 3]).max(0) < 0).any())
        if out:
            self.out.add(tuple(sorted((a, b, c))))
        if finest:
            return False
        if self.metric in ("wedgie", "localised"):
            depth = q[:, 2].min()
            size = self.camera.stretch_of(q).max()
            near = max(depth, self.camera.view.near)
            moved = max(depth, near - e * abs(self.camera.up[2]))
            bound = (
                0.0
                if e == 0
                else math.inf
                if moved <= 0 or math.isinf(e)
                else self.camera.focal * e * size / near / moved
            )
        else:
            bound = self.spheres[m]
        wanted = (bound > self.tolerance and not out) or (math.isinf(e) and not self.cull)
        below = [self.visit(c, a, m, low, high, out), self.visit(b, c, m, low, high, out)]
        if wanted and self.metric == "localised" and math.isfinite(e) and not squeezed and not any(below):
            r = p.r[m] * max(1.0, self.camera.exaggeration)
            near = r > ahead.nearness(self.tolerance) * (self.camera.to_camera(p.at[m])[2] - r)
            wanted = not near or self.displacement((a, b, c)) > self.tolerance
            self.pruned += not wanted
        if wanted:
            self.wanted.add(frozenset(zip(cols.tolist(), rows.tolist())))
        return wanted

    def displacement(self, triangle) -> float:
        """Of a sample in view under a triangle, the largest; or a bound of a finest triangle in view, if larger."""
        return max(self.p.displacement(self.camera, triangle), self.p.finest_bound(self.camera, triangle))

    def mesh(self, ground: Ground) -> set:
        """The corners (col, row) of the triangles that are drawn."""
        drawn = [t for t in self.T if ground.has_ground(t) and ground.is_known(t)]
        if self.cull:
            drawn = [t for t in drawn if tuple(sorted((y, x) for x, y in corners(t))) not in self.out]
        return {frozenset(ground.places(t)) for t in drawn}


def flight(rng: np.random.Generator, t: MemoryTerrain, frames: int, **options):
    """A smooth flight over the terrain: the eye drifts, the view turns and dips a little in each frame."""
    view = plain.random_view(rng, t, **options)
    eye, ahead = np.array(view.eye), np.array(view.target) - view.eye
    cell = math.sqrt(abs(t.grid.transform.determinant))
    speed = rng.normal(size=3) * cell * 0.5
    for _ in range(frames):
        yield replace(view, eye=tuple(eye), target=tuple(eye + ahead))
        eye = eye + speed
        angle = rng.normal() * 0.03
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        ahead = np.array([*(turn @ ahead[:2]), ahead[2] * (1 + rng.normal() * 0.02)])


def keys_of(made: Roam, view: View, **goal) -> set:
    m, _ = made.mesh(view, **goal)
    keys = np.stack([m.keys[:-2], m.keys[1:-1], m.keys[2:]], 1) if m.is_strip else m.keys
    keys = np.sort(keys, 1)
    keys = keys[(keys[:, 0] != keys[:, 1]) & (keys[:, 1] != keys[:, 2])]
    found = {tuple(k) for k in keys.tolist()}
    assert len(found) == m.triangles == len(keys)  # none is drawn twice
    return found


@pytest.mark.cases(1)
@pytest.mark.parametrize("shape", plain.SHAPES)
@pytest.mark.parametrize("metric", ["wedgie", "anisotropic"])
def test_the_mesh_is_the_smallest_that_keeps_the_tolerance(shape, metric):
    rng = np.random.default_rng([*shape, len(metric)])
    for case in range(4):
        z = plain.rough(rng, shape, gaps=0.15 * (case % 2))
        if np.isnan(z).all():
            continue
        t = plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=float(rng.choice([1, 2.5])))
        p = plain.Plain(t)
        exaggeration, cull = float(rng.choice([1.0, 2.0])), bool(case < 3)
        tolerance, near = float(10 ** rng.uniform(-0.5, 1)), float(rng.choice([0, 50]))
        carried = plain.refiner(Roam, t, cull=cull, exaggeration=exaggeration, metric=metric, outside=0.0)
        ground, both = Ground.of(t), reference.Roam(t.n)
        for view in flight(rng, t, 4, near=near):
            found = carried.refine(view, tolerance=tolerance)
            camera = plain.Camera(view, exaggeration)
            want = Recursion(p, camera, tolerance, cull, metric)
            assert plain.triangles_of(found) == want.mesh(ground)
            assert both.frame(lambda t, w=want: float(frozenset(corners(t)) in w.wanted), tolerance=0.5) == want.T
            assert verify.judge_mesh(found, t, view, exaggeration=exaggeration).ok(tolerance)


@pytest.mark.stress
@pytest.mark.parametrize("shape", [(9, 9), (8, 9), (5, 7)])
def test_looking_ahead_leaves_what_looking_everywhere_allows(shape):
    """On 9² samples six halvings reach every finest triangle."""
    rng = np.random.default_rng([4, *shape])
    pruned = fewer = 0
    for case in range(16):
        t = plain.terrain(plain.rough(rng, shape, amplitude=60.0, gaps=0.1 * (case % 3 == 2)), angle=30.0 * case)
        p, exaggeration = plain.Plain(t), float(rng.choice([0.5, 1.0, 3.0]))
        tolerance, ground = float(10 ** rng.uniform(-0.3, 1.7)), Ground.of(t)
        carried = plain.refiner(Roam, t, exaggeration=exaggeration)
        for view in flight(rng, t, 6):
            found = carried.refine(view, tolerance=tolerance)
            camera = plain.Camera(view, exaggeration)
            want = Recursion(p, camera, tolerance, True, "localised")
            assert plain.triangles_of(found) == want.mesh(ground)
            assert verify.judge_mesh(found, t, view, exaggeration=exaggeration).ok(tolerance)
            pruned += want.pruned
            fewer += len(Recursion(p, camera, tolerance, True, "wedgie").T) - len(want.T)
    assert min(pruned, fewer) > 50


def real(shared_data, name: str) -> MemoryTerrain:
    path, window = {
        "bigtujunga": ("bigtujunga-srtm30m-utm/srtm_bigtujunga30m_utm11.tif", ((100, 400), (100, 520))),
        "rainier": ("osgearth-srtm90m-volcano-voids/mt_rainier_90m.tif", ((0, 400), (0, 377))),
    }[name]
    with rasterio.open(shared_data / path) as file:
        z = file.read(1, window=window).astype(np.float32)
        z[z == np.float32(file.nodata if file.nodata is not None else np.nan)] = np.nan
    return plain.terrain(z, cell=30.0 if name == "bigtujunga" else 90.0)


@pytest.mark.cases(1)
@pytest.mark.parametrize("name", ["bigtujunga", "rainier"])
@pytest.mark.parametrize(
    "error, metric", [("exact", "localised"), ("exact", "wedgie"), ("wedgie", "wedgie"), ("exact", "isotropic")]
)
def test_flights_over_real_ground_keep_the_promise_and_depend_on_the_view_alone(shared_data, name, error, metric):
    t = real(shared_data, name)
    rng = np.random.default_rng(len(name) + len(error) * 10 + len(metric))
    carried, eager = (plain.refiner(Roam, t, error=error, metric=metric, deferral=d) for d in (True, False))
    saved = 0
    for _ in range(4):
        tolerance = float(rng.choice([0.7, 1.5, 4.0]))
        for view in flight(rng, t, 10):
            found = keys_of(carried, view, tolerance=tolerance)
            assert found == keys_of(eager, view, tolerance=tolerance)
            stats, all_of_it = carried.mesh(view, tolerance=tolerance)[0].stats, eager._state.counts[mesh.COMPUTED]
            assert stats["splits"] == stats["merges"] == stats["changed"] == stats["recomputed"] == 0  # a still camera
            saved += int(all_of_it)
        assert found == keys_of(plain.refiner(Roam, t, error=error, metric=metric), view, tolerance=tolerance)
        made = carried.refine(view, tolerance=tolerance)
        assert len(np.unique(made.triangles)) == len(made.vertices)
        report = verify.judge_mesh(made, t, view)
        assert report.ok(tolerance), report
    assert saved > 0


@pytest.mark.parametrize("shape, cull", [((257, 33), True), ((33, 140), True), ((257, 33), False)])
def test_a_mesh_on_a_narrow_raster_forgets_what_it_was(shape, cull):
    """Squeezed out of a much larger square: triangles beyond the border, of no area, must not ask for splits; and what
    is in view (not culled) must count for no less than what goes out of it."""
    split = 0
    for seed in (0, 3):
        rng = np.random.default_rng([seed, *shape])
        t = plain.terrain(plain.rough(rng, shape))
        carried, tolerance = plain.refiner(Roam, t, cull=cull), float(rng.choice([0.7, 1.5, 4.0]))
        for k, view in enumerate(flight(rng, t, 24)):
            found = keys_of(carried, view, tolerance=tolerance)
            if k % 4 == 2:
                assert found == keys_of(plain.refiner(Roam, t, cull=cull), view, tolerance=tolerance), (seed, k)
                split = max(split, len(found))
    assert split > 50


def test_what_cannot_have_crossed_the_threshold_is_not_computed_again():
    rng = np.random.default_rng(5)
    t = plain.terrain(plain.rough(rng, (257, 257), amplitude=60))
    carried, eager = plain.refiner(Roam, t), plain.refiner(Roam, t, deferral=False)
    x, y = t.grid.xy(128, 250)
    counts = []
    for k in range(40):
        view = View(
            (float(x), float(y) + 1.5 * k, 400.0), (float(x), float(y) + 1e4 + 1.5 * k, -1000.0), width=400, height=300
        )
        a, b = carried.mesh(view, tolerance=1)[0], eager.mesh(view, tolerance=1)[0]
        assert a.triangles == b.triangles > 500
        counts.append((a.stats["recomputed"], b.stats["recomputed"]))
    few, many = np.sum(counts[1:], axis=0)
    assert few < many / 10


@pytest.mark.parametrize("gaps", [0.0, 0.1])
def test_budgets_of_triangles_are_kept_and_used(gaps):
    rng = np.random.default_rng(int(gaps * 10))
    t = plain.terrain(plain.rough(rng, (200, 257), gaps=gaps))
    carried = plain.refiner(Roam, t)
    for budget in (2, 50, 1000, 1000, 3000):
        for view in flight(rng, t, 6):
            found = carried.refine(view, triangles=budget)
            if len(found.triangles) > budget:  # what holes force, and no more
                assert gaps > 0 and not found.stats["conservative"]
                assert queues.lowest(carried._state.occupied, queues.MERGE) >= queues.HOLES
            report = verify.judge_mesh(found, t, view)
            assert not report.defects
            if found.stats["conservative"]:
                assert report.ok(found.stats["tolerance"])
        # The best of its size: scratch needs about as much for the tolerance that was reached.
        if gaps == 0 and found.stats["tolerance"]:
            fresh = plain.refiner(Roam, t, metric="wedgie").mesh(view, tolerance=found.stats["tolerance"])[0]
            assert fresh.triangles <= budget
            finer = plain.refiner(Roam, t, metric="wedgie").mesh(view, tolerance=found.stats["tolerance"] / 1.2)[0]
            assert finer.triangles >= min(budget, len(found.triangles)) * 0.98


@pytest.mark.stress
def test_with_a_budget_priorities_are_known_to_a_bucket_where_the_queues_cross():
    """Those between the thresholds are at most ``STALE`` off; the others are on their side of them, to that."""
    rng = np.random.default_rng(5)
    t = plain.terrain(plain.rough(rng, (257, 257)))
    roam = plain.refiner(Roam, t)
    compared, swept, off = 0, 0, []
    first, second = list(flight(rng, t, 2))
    step = 0.3 * (np.array(second.eye) - first.eye)
    for frame in range(40):
        view = replace(first, eye=tuple(first.eye + frame * step), target=tuple(first.target + frame * step))
        roam.refine(view, triangles=1500)
        s = roam._state
        before, counts = s.nodes.copy(), s.counts.copy()
        low, high = s.options[[mesh.LEAST, mesh.MOST]]
        swept += s.counts[mesh.SWEPT] > 0
        nodes = s.nodes[: s.counts[mesh.TOP]]
        live = (nodes["state"] == mesh.LEAF) | ((nodes["flags"] & mesh.MERGEABLE) > 0)
        live &= nodes["state"] != mesh.FREE
        known = nodes["priority"].astype(np.float64)
        for i in np.flatnonzero(live):
            args = (
                s.nodes,
                s.pages,
                s.cameras[0],
                s.clock,
                s.counts,
                s.options,
                s.terms,
                s.waiting,
                s.scratch,
            )
            priorities.priority_of(*args, i)
        true = s.nodes["priority"][: len(known)].astype(np.float64)
        s.nodes[:], s.counts[:] = before, counts
        inside = live & (known > low) & (known <= high) & (high < math.inf)
        near = 1 + bounds.STALE * (1 + 1e-6)
        assert (true[inside] <= known[inside] * near).all() and (true[inside] * near >= known[inside]).all()
        assert (true[live & (known <= low)] <= low * near).all()
        assert (true[live & (known > high)] * near > high).all()
        compared += inside.sum()
        off.append(np.abs(true[inside] / known[inside] - 1).max(initial=0.0))
    assert compared > 500 and swept and max(off) > 0  # the thresholds moved; some priorities were not computed again


def test_the_second_frame_of_a_budget_costs_no_more_than_those_after_it():
    """Where the queues cross is known when the first frame ends, and only what is near it is kept up to date."""
    rng = np.random.default_rng(6)
    t = plain.terrain(plain.rough(rng, (257, 257)))
    first, second = list(flight(rng, t, 2))
    step = 0.1 * (np.array(second.eye) - first.eye)
    roam, computed = plain.refiner(Roam, t), []
    for frame in range(12):
        view = replace(first, eye=tuple(first.eye + frame * step), target=tuple(first.target + frame * step))
        made = roam.mesh(view, triangles=3000)[0]
        computed.append(made.stats["recomputed"])
    assert 2500 < made.triangles <= 3000
    assert computed[1] < 2 * max(computed[2:]) and computed[1] < 0.5 * made.stats["leaves"]


@pytest.mark.stress
def test_a_budget_of_time_ends_in_a_sound_mesh_and_goes_on_in_the_next_frame(monkeypatch):
    monkeypatch.setattr(pace, "LEAST", 40)
    monkeypatch.setattr(method, "CAPACITY", 1 << 11)
    rng = np.random.default_rng(3)
    t = plain.terrain(plain.rough(rng, (257, 257)))
    carried = plain.refiner(Roam, t)
    view = plain.random_view(rng, t)
    carried.refine(view, tolerance=50)
    carried.restart()
    sizes, said = [], 0
    for _ in range(2000):
        found = carried.refine(view, seconds=1e-5)
        kept = found.stats["tolerance"]
        if len(sizes) % 4 == 0:
            report = verify.judge_mesh(found, t, view)
            assert report.ok(kept) if kept is not None else not report.defects
            said += kept is not None and report.largest > method.FINEST
        sizes.append(len(found.triangles))
        if kept == method.FINEST:
            break
    assert said > 2  # (tolerances that were still coarse, and were kept)
    assert len(sizes) > 3 and sizes[-1] > sizes[1]
    assert found.stats["conservative"] and found.stats["tolerance"] == method.FINEST
    assert keys_of(carried, view, seconds=10.0) == keys_of(plain.refiner(Roam, t), view, tolerance=method.FINEST)


def test_a_budget_of_time_leaves_nothing_in_view_out(monkeypatch):
    """However late it is: what comes into view by a move, a turn or another lens is drawn, if coarsely."""
    monkeypatch.setattr(pace, "LEAST", 10)
    rng = np.random.default_rng(12)
    t = plain.terrain(plain.rough(rng, (200, 257)))
    x, y = t.grid.xy(128, 100)
    eye, angle = np.array([float(x), float(y), t.height_range[1] + 20]), 0.0
    carried = plain.refiner(Roam, t)
    behind = 0
    for k in range(40):
        angle += 0.25
        eye[:2] += [3 * math.cos(angle), 3 * math.sin(angle)]
        ahead = (math.cos(angle), math.sin(angle), -0.6)
        view = View(tuple(eye), tuple(eye + ahead), fov_y=40 if k % 10 < 8 else 60, width=300, height=200)
        found = carried.refine(view, seconds=10.0 if k % 10 == 0 else 1e-9)
        assert len(found.triangles) > 0
        report = verify.judge_mesh(found, t, view)
        assert not report.defects, (k, report)
        behind += carried._is_behind
    assert behind > 20


@pytest.mark.parametrize("goal", [{"triangles": 50}, {"seconds": 1e-9}])
@pytest.mark.parametrize("options", [{}, {"cull": False}, {"back_facing": 0.0, "occluded": 0.0}])
def test_no_budget_bridges_or_leaves_out_ground_at_holes(monkeypatch, goal, options):
    monkeypatch.setattr(pace, "LEAST", 10)
    rng = np.random.default_rng(21)
    z = plain.rough(rng, (150, 180))
    for row, col in rng.integers(10, 130, (5, 2)):
        z[row : row + 7, col : col + 9] = np.nan
    t = plain.terrain(z)
    carried = plain.refiner(Roam, t, **options)
    for view in flight(rng, t, 8):
        found = carried.refine(view, **goal)
        report = verify.judge_mesh(found, t, view)
        assert not report.defects
        if found.stats["conservative"]:
            assert report.ok(found.stats["tolerance"])
            assert "seconds" in goal or len(found.triangles) <= 50
    assert len(found.triangles) > 50


def test_what_is_not_culled_is_refined_out_of_view():
    t = plain.terrain(plain.rough(np.random.default_rng(22), (129, 129)))
    x, y = t.grid.xy(64, 128)
    view = View((float(x), float(y), t.height_range[1] + 20), (float(x), float(y) - 100, 0.0), width=300, height=200)
    sizes = [
        len(plain.refiner(Roam, t, cull=False, **o).refine(view).triangles)
        for o in ({}, {"outside": 1.0}, {"outside": 0.0})
    ]
    assert sizes[0] == sizes[1] > 4 * sizes[2]


@pytest.mark.cases(1)
@pytest.mark.parametrize("metric, memory", [("wedgie", 5), ("localised", 8)])
def test_pages_that_leave_take_nothing_of_the_mesh_with_them(metric, memory):
    t = plain.terrain(plain.rough(np.random.default_rng(11), (1025, 1025), amplitude=3000), cell=30)
    small, large = plain.refiner(Roam, t, metric=metric, max_memory=memory << 20), plain.refiner(Roam, t, metric=metric)
    for view in across(t, 8):
        assert keys_of(small, view, tolerance=2) == keys_of(large, view, tolerance=2)
    assert small.field.tiles_read > large.field.tiles_read > memory >= len(small.field.pages.used)
    assert not verify.judge_mesh(small.refine(view, tolerance=2), t, view).defects


def test_where_memory_is_too_small_to_look_ahead_bounds_decide_alone():
    t = plain.terrain(plain.rough(np.random.default_rng(11), (1025, 1025), amplitude=3000), cell=30)
    small, plainly = plain.refiner(Roam, t, max_memory=5 << 20), plain.refiner(Roam, t, metric="wedgie")
    for view in across(t, 4):
        found = keys_of(small, view, tolerance=2)
    assert small._blind and found == keys_of(plainly, view, tolerance=2)
    assert (
        keys_of(small, view, tolerance=40) == keys_of(plain.refiner(Roam, t), view, tolerance=40) and not small._blind
    )


def across(t: MemoryTerrain, frames: int):
    """Over 1025² samples, from west to east."""
    for k in range(frames):
        x, y = t.grid.xy(100 + 100 * k, 512)
        eye = (float(x), float(y), t.height_range[1] + 200)
        yield View(eye, (eye[0] + 3000, eye[1] + 1000 * k - 3500, eye[2] - 2500), width=300, height=200)


def test_colors_split_what_heights_do_not():
    z = np.zeros((65, 65), np.float32)
    t = plain.terrain(z)

    def color(level, row0, row1, col0, col1):
        """Colours are wrong by 10 ΔE wherever a diamond reaches into the western half, down to the finest."""
        rows, cols = np.meshgrid(np.arange(row0, row1), np.arange(col0, col1), indexing="ij")
        reach = (rows | cols) & -(rows | cols)
        return np.where((cols - reach << level) < 32, 10.0, 0.0).astype(np.float32)

    x, y = t.grid.xy(32, 32)
    view = View((float(x), float(y), 3000.0), (float(x), float(y), 0.0), up=(0.0, 1.0, 0.0), fov_y=45)
    flat = plain.refiner(Roam, t).refine(view)
    left = plain.refiner(Roam, t, color=color, color_tolerance=5.0).refine(view)
    assert len(flat.triangles) == 2
    assert len(plain.refiner(Roam, t, color=color, color_tolerance=11.0).refine(view).triangles) == 2
    p, q, r = (left.vertices[left.triangles[:, k], :2] for k in range(3))
    sizes = np.abs((q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0])
    middle = ((p + q + r) / 3)[:, 0]
    assert (sizes[middle < 31] == 1).all() and (sizes[middle > 40] > 1).all()


def test_without_culling_colors_count_out_of_view():
    """As with the other methods: on ground behind the eye, down to a pixel at its distance; in view no less."""
    t = plain.terrain(np.zeros((65, 65), np.float32))

    def color(level, row0, row1, col0, col1):
        return np.full((row1 - row0, col1 - col0), 10.0, np.float32)

    (x, y), (u, v) = t.grid.xy(60, 32), t.grid.xy(64, 32)
    view = View((float(x), float(y), 100.0), (float(u), float(v), 0.0), width=64, height=48)
    sizes = []
    for options in ({}, {"cull": False}):
        made = plain.refiner(Roam, t, color=color, color_tolerance=5.0, **options).refine(view)
        p, q, r = (made.vertices[made.triangles[:, k], :2] for k in range(3))
        size = np.abs((q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0])
        sizes.append((len(size), size[((p + q + r) / 3)[:, 0] < 40]))
    assert sizes[1][0] > sizes[0][0]
    assert len(sizes[1][1]) > 500 and np.median(sizes[1][1]) == 1
    calm = plain.refiner(Roam, t, color=color, color_tolerance=11.0, cull=False).refine(view)
    assert len(calm.triangles) == 2


def test_another_grid_of_the_same_ground_moves_nothing():
    """South-up rasters: the same triangles, turned as the map wants them."""
    rng = np.random.default_rng(2)
    z = plain.rough(rng, (33, 33))
    t = plain.terrain(z)
    flipped = t.grid.transform @ type(t.grid.transform)(1, 0, 0, 0, -1, 33)
    u = MemoryTerrain(np.ascontiguousarray(z[::-1]), Grid(z.shape, flipped), "south-up")
    view = plain.random_view(rng, t)
    for found, terrain in ((plain.refiner(Roam, t).refine(view), t), (plain.refiner(Roam, u).refine(view), u)):
        assert verify.judge_mesh(found, terrain, view).ok(1.0)


def test_strips_kept_strips_rebuilt_and_lists_hold_the_same_triangles():
    rng = np.random.default_rng(14)
    t = plain.terrain(plain.rough(rng, (129, 100), gaps=0.05))
    both = [plain.refiner(Roam, t, strips=kind) for kind in ("kept", "rebuilt", None)]
    for _ in range(3):
        for view in flight(rng, t, 8):
            kept, rebuilt, listed = (keys_of(e, view, tolerance=1.0) for e in both)
            assert kept == rebuilt == listed
    m = both[0].mesh(view, tolerance=1.0)[0]
    assert m.is_strip and len(m.keys) < 4.5 * m.triangles + 500
