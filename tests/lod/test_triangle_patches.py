"""Triangle patches: patches against the hierarchy, the selection against whole arrays, the promise by the referee."""

from __future__ import annotations

import gc
import itertools
import math
import threading
import time
import weakref

import numpy as np
import plain
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph import verify
from orograph.errors import StoreError, UsageError
from orograph.hierarchy import diamonds, triangles
from orograph.lod.method import Resources
from orograph.lod.patches.expand import expand
from orograph.lod.patches.shape import MAY_MISS, STEPS
from orograph.lod.registry import chosen
from orograph.lod.triangle_patches import INSTANCE, TrianglePatches, patch_indices, patch_vertices
from orograph.store.memory import MemoryTerrain
from orograph.store.patches import KAPPA, SATURATION, patch_errors
from orograph.store.terrain import tile_shape
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera, View

SHAPES = [(33, 33), (65, 65), (50, 77), (129, 40), (34, 33), (18, 120)]


def mesh_of(t, instances, legs):
    keys, heights = expand(t, instances, legs)
    return Tessellation.from_triangles(t.grid, keys, heights, clockwise=False)


def triangle_of(instance, legs):
    """(x, y, L, ω) of a patch."""
    omega, L = int(instance["omega"]), legs << int(instance["step"])
    x, y, _, _ = triangles.with_apex(int(instance["col"]), int(instance["row"]), L, omega)
    return x, y, L, omega


def surface(t, instances, legs):
    """Heights of the drawn surface at all samples."""
    from matplotlib.tri import LinearTriInterpolator, Triangulation

    mesh = mesh_of(t, instances, legs)
    if not len(mesh.triangles):
        return np.full(t.grid.shape, np.nan)
    v = mesh.vertices
    cols, rows = np.meshgrid(np.arange(t.grid.cols), np.arange(t.grid.rows))
    found = LinearTriInterpolator(Triangulation(v[:, 0], v[:, 1], mesh.triangles), v[:, 2])(cols, rows)
    return np.ma.filled(found, np.nan)


def ground_of(z):
    """Which samples are corners of unit triangles that exist (cells are cut from their (even, even) to (odd, odd))."""
    there, found = ~np.isnan(z), np.zeros(z.shape, bool)
    for i in range(z.shape[0] - 1):
        for j in range(z.shape[1] - 1):
            a, b, c, d = (i, j), (i, j + 1), (i + 1, j), (i + 1, j + 1)
            for unit in ((a, b, d), (a, c, d)) if (i + j) % 2 == 0 else ((a, b, c), (b, c, d)):
                if all(there[at] for at in unit):
                    found[tuple(zip(*unit))] = True
    return found


# ---- the patch -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("legs", [2, 4, 8, 16])
def test_a_patch_is_the_hierarchys_triangle_bisected(legs):
    n = legs.bit_length() + 1
    points, faces = patch_vertices(legs).astype(int), patch_indices(legs)
    assert faces.shape == (legs**2, 3) and len(points) == (legs + 1) * (legs + 2) // 2
    depth = 2 * (legs.bit_length() - 1)
    for level in range(2 * n - depth + 1):
        for x, y, L, omega in zip(*triangles.of_level(n, level)):
            wanted = [(int(x), int(y), int(L), int(omega))]
            for _ in range(depth):
                wanted = [tuple(int(v) for v in triangles.child(*w, k)) for w in wanted for k in (0, 1)]
            corners = {
                tuple(map(tuple, (triangles.apex(*w), triangles.left_end(*w), triangles.right_end(*w)))) for w in wanted
            }
            ax, ay = triangles.apex(x, y, L, omega)
            e1, e2 = STEPS[omega].astype(int) * (int(L) // legs)
            rows = int(ay) + points[:, 0] * e1[0] + points[:, 1] * e2[0]
            cols = int(ax) + points[:, 0] * e1[1] + points[:, 1] * e2[1]
            found = {tuple((int(cols[i]), int(rows[i])) for i in face) for face in faces}
            assert {frozenset(f) for f in found} == {frozenset(c) for c in corners}
            for a, b, c in found:  # counter-clockwise, rows downwards
                assert (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0


def test_triangles_of_a_patch_follow_a_curve():
    faces = patch_indices(16)
    for a, b in itertools.pairwise(faces):
        assert len(set(a.tolist()) & set(b.tolist())) == 2


def test_new_points_are_middles_of_the_parents_edges():
    """The points with odd i + j are those the coarser patch lacks, and lie between their neighbours on the odd axis."""
    points = {tuple(p) for p in patch_vertices(16).astype(int).tolist()}
    faces = patch_vertices(16)[patch_indices(16)].astype(int)
    for i, j in points:
        if (i + j) % 2:
            odd = (i % 2, j % 2)
            before, after = (i - odd[0], j - odd[1]), (i + odd[0], j + odd[1])
            assert before in points and after in points
            # No triangle's side crosses the point: it is a right-angled apex of those on both sides of that edge.
            around = [set(map(tuple, f)) for f in faces.tolist() if (i, j) in map(tuple, f)]
            assert all(sum((u + v) % 2 for u, v in f) == 1 for f in around)
            assert sum(before in f for f in around) >= 1 and sum(after in f for f in around) >= 1
    assert INSTANCE.itemsize == 32


# ---- tables --------------------------------------------------------------------------------------------------------


def below(at, n, depth):
    """The diamonds so many levels below one."""
    found = {at}
    for _ in range(depth):
        children = (diamonds.child(*one, k, n) for one in found for k in range(4))
        found = {(int(r), int(c)) for r, c in children if r >= 0}
    return found


def brute_tables(t, legs):
    """P and saturated P′ of every patch diamond, by following the DAG's arrows one by one."""
    n, d = t.n, 2 * (legs.bit_length() - 1)
    p = plain.Plain(t)
    exact, saturated = {}, {}
    for level in range(2 * n - d - 1, -1, -1):
        for row, col in zip(*(v.tolist() for v in diamonds.of_level(n, level))):
            exact[row, col] = max(float(p.e[q]) for q in below((row, col), n, d))
            children = [tuple(int(v) for v in diamonds.child(row, col, k, n)) for k in range(4)]
            deeper = [saturated[q] for q in children if q in saturated]
            saturated[row, col] = max([exact[row, col], *(SATURATION * v for v in deeper)])
    return exact, saturated


@pytest.mark.cases(3)
@pytest.mark.parametrize(
    ("shape", "legs"),
    [((65, 65), 4), ((65, 65), 8), ((50, 61), 4), pytest.param((300, 280), 16, marks=pytest.mark.stress)],
)
def test_errors_of_patches(shape, legs):
    t = plain.terrain(plain.rough(np.random.default_rng(3), shape))
    found, top = patch_errors(t, "exact", legs), t.levels - 1
    _, saturated = brute_tables(t, legs)
    assert saturated
    for (row, col), value in saturated.items():
        level = min(int(diamonds.octave(row, col)), top)
        i, j = row >> level, col >> level
        if i < found[level].shape[0] and j < found[level].shape[1]:
            assert found[level][i, j] == pytest.approx(value, rel=1e-5)
        else:
            assert value == 0.0


def test_errors_where_ground_is_missing_are_finite_and_marked():
    t = plain.terrain(plain.rough(np.random.default_rng(4), (129, 129), gaps=0.2))
    p, legs = plain.Plain(t), 4
    found = patch_errors(t, "exact", legs)
    assert all(np.isfinite(level).all() for level in found)
    for level, row, col in ((2, 4, 4), (2, 8, 4), (2, 12, 16), (5, 32, 32), (6, 64, 64)):
        at = min(level, t.levels - 1)
        assert (found[at][row >> at, col >> at] < 0) == np.isinf(p.e[row, col])


# ---- the selection -------------------------------------------------------------------------------------------------


class Reference:
    """The selection with whole arrays: the closure of the criterion, its front, what of it is in view."""

    def __init__(self, t, legs):
        self.p, self.legs, self.t = plain.Plain(t), legs, t
        p, errors, top = self.p, patch_errors(t, "exact", legs), t.levels - 1
        self.q = legs.bit_length() - 1
        signed = np.zeros_like(p.e)
        octave = np.array([[diamonds.octave(r, c) if r | c else 0 for c in range(t.side)] for r in range(t.side)])
        for level in range(top + 1):
            mine = (octave == level if level < top else octave >= level) & (octave >= self.q)
            if errors[level].size:
                inside = mine & (p.row >> level < errors[level].shape[0]) & (p.col >> level < errors[level].shape[1])
                signed[inside] = errors[level][p.row[inside] >> level, p.col[inside] >> level]
        self.mixed, p.e = signed < 0, np.abs(signed)
        self.coarse = octave >= self.q
        edge = diamonds.kind(p.row, p.col) == diamonds.EDGE
        # The longest edge of a patch's triangles: the diagonal of a cell, or the side of one of twice the size.
        x = t.grid.transform
        sides = math.hypot(x.a, x.d), math.hypot(x.b, x.e)
        diagonal = max(math.hypot(x.a + x.b, x.d + x.e), math.hypot(x.a - x.b, x.d - x.e))
        size = max(*sides, diagonal / math.sqrt(2))
        spacing = 2.0 ** (octave - self.q)
        self.longest = np.where(edge, 2 * spacing, 2 * math.sqrt(2) * spacing) * size

    def select(self, view, tolerance, exaggeration=1.0, cull=True, exact_holes=False):
        """(triangles of all patches, those of them in view, pixels by vertex)."""
        p, camera = self.p, plain.Camera(view, exaggeration)
        pixels = p.sphere_errors(camera)
        radius = np.abs(p.r) * max(1.0, exaggeration)
        at = camera.to_camera(p.at)
        with np.errstate(invalid="ignore", divide="ignore"):
            nearest = np.maximum(at[..., 2] - radius, view.near)
            e = self.longest * np.linalg.norm(camera.up)
            hole = camera.focal * e * (np.linalg.norm(at, axis=-1) + radius) / (nearest * (nearest - e))
            hole = np.where(nearest > e, hole, np.inf)
        pixels = np.where(self.mixed, np.maximum(pixels, np.inf if exact_holes else hole), pixels)
        out = p.spheres_outside(camera) if cull else np.zeros(p.z.shape, bool)
        active = (pixels > tolerance / KAPPA) & ~out & self.coarse & (p.r >= 0)
        corners = np.ix_((0, -1), (0, -1))
        active[corners] = False
        closed = diamonds.closure(active)
        n, finest = p.n, 2 * (p.n - self.q)
        waiting = [tuple(int(v) for v in triangles.root(k, n)) for k in (0, 1)]
        drawn = set()
        while waiting:
            triangle = waiting.pop()
            row, col = (int(v) for v in diamonds.of_triangle(*triangle))
            level = int(triangles.level(triangle[2], triangle[3], n))
            if level < finest and closed[row, col]:
                waiting += [tuple(int(v) for v in triangles.child(*triangle, k)) for k in (0, 1)]
            elif level == finest or (not out[row, col] and p.r[row, col] >= 0):
                drawn.add(triangle)
        return drawn, pixels, camera

    def hidden(self, triangle, camera):
        """Whether a patch is outside a plane whatever its heights within its diamond's sphere (or its parent's)."""
        _, _, L, omega = triangle
        p = self.p
        level = int(triangles.level(L, omega, p.n))
        at = triangles.parent(*triangle) if level == 2 * (p.n - self.q) else triangle
        row, col = int(at[1]), int(at[0])
        ends = [f(*triangle) for f in (triangles.apex, triangles.left_end, triangles.right_end)]
        rows, cols = np.array([e[1] for e in ends]), np.array([e[0] for e in ends])
        if (rows >= self.t.grid.rows).any() or (cols >= self.t.grid.cols).any():
            return False
        points = np.concatenate([p.at[rows, cols][:, :2], np.full((3, 1), p.filled[row, col])], 1)
        return bool(p.outside(camera, points[None], np.array([abs(p.r[row, col])]))[0])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("gaps", [0.0, 0.15])
def test_selection_is_the_closure_of_the_criterion(shape, gaps):
    rng = np.random.default_rng([*shape, int(gaps * 100)])
    for case in range(6):
        z = plain.rough(rng, shape, gaps=gaps)
        t = plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=float(rng.choice([1, 2.5])))
        legs = int(rng.choice([2, 4, 8]))
        method, reference = plain.refiner(TrianglePatches, t, legs=legs), Reference(t, legs)
        view = plain.random_view(rng, t)
        tolerance, exaggeration = float(10 ** rng.uniform(-1, 1)), float(rng.choice([1.0, 2.0]))
        cull, exact = bool(case % 2), bool(case % 3 == 0)
        made = method.patches(view, tolerance, cull=cull, exaggeration=exaggeration, rim=None if exact else 1.0)
        found = {tuple(int(v) for v in triangle_of(i, legs)) for i in made.instances}
        assert len(found) == len(made.instances)
        wanted, pixels, camera = reference.select(view, tolerance, exaggeration, cull, exact)
        assert found <= wanted
        rows, cols = t.grid.shape
        for missing in wanted - found:  # beyond the raster, empty, or out of view by itself
            ends = [f(*missing) for f in (triangles.apex, triangles.left_end, triangles.right_end)]
            beyond = min(e[1] for e in ends) >= rows - 1 or min(e[0] for e in ends) >= cols - 1
            level = int(triangles.level(missing[2], missing[3], t.n))
            up = tuple(int(v) for v in triangles.apex(*missing))
            gone = level == 2 * (t.n - reference.q) and (
                reference.p.r[up[1], up[0]] < 0 or (cull and reference.p.spheres_outside(camera)[up[1], up[0]])
            )
            assert beyond or gone or (cull and reference.hidden(missing, camera)), missing
        for i in made.instances:
            x, y, L, omega = (int(v) for v in triangle_of(i, legs))
            up = tuple(int(v) for v in triangles.apex(x, y, L, omega))
            if int(triangles.level(L, omega, t.n)):
                u = pixels[up[1], up[0]]
                m = 1.0 if u >= tolerance else (u - tolerance / KAPPA) / (tolerance - tolerance / KAPPA)
                assert i["morph"] == pytest.approx(m, abs=1e-4)
            assert i["pixels"] <= tolerance * (1 + 1e-6)
            assert i["level"] == min(i["step"], t.levels - 1) and i["slot"] == -1


def test_instances_name_tiles_that_hold_them():
    t = plain.terrain(plain.rough(np.random.default_rng(5), (700, 1100), gaps=0.02))
    for legs in (4, 16, 64):
        method = plain.refiner(TrianglePatches, t, legs=legs)
        made = method.patches(plain.random_view(np.random.default_rng(6), t), 0.5, cull=False).instances
        points = patch_vertices(legs).astype(int)
        for i in made[:: max(1, len(made) // 500)]:
            e1, e2 = STEPS[i["omega"]].astype(int) << int(i["step"])
            cells = np.array([i["row"], i["col"]]) + points[:, :1] * e1 + points[:, 1:] * e2
            tile = np.array([i["tile_row"], i["tile_col"]], int) * 256 << int(i["level"])
            assert (cells >= tile).all() and (cells <= tile + (256 << int(i["level"]))).all()
            rows, cols = np.minimum(cells, np.array(t.grid.shape) - 1).T
            assert i["flags"] & MAY_MISS or not np.isnan(t.heights[rows, cols]).any()


# ---- the promise ---------------------------------------------------------------------------------------------------

CASES = {
    "rows": st.integers(2, 140), "cols": st.integers(2, 140), "gaps": st.sampled_from([0.0, 0.0, 0.1, 0.4]),
    "stretch": st.sampled_from([1.0, 1.0, 0.4, 3.0]), "legs": st.sampled_from([2, 4, 8, 16, 32]),
    "tolerance": st.floats(0.2, 20.0), "exaggeration": st.sampled_from([1.0, 1.0, 3.0]), "cull": st.booleans(),
    "seed": st.integers(0, 2**32 - 1),
}  # fmt: skip
"""Odd rasters, squeezed borders, holes, rectangular cells."""


def scene(rows, cols, gaps, stretch, seed):
    rng = np.random.default_rng(seed)
    z = plain.rough(rng, (rows, cols), gaps=gaps, amplitude=float(10 ** rng.uniform(0.5, 2.5)))
    if np.isnan(z).all():
        z[:] = 0.0
    t = plain.terrain(z, angle=float(rng.uniform(0, 360)), stretch=stretch)
    return rng, t, plain.random_view(rng, t)


@settings(max_examples=60)
@given(geomorph=st.booleans(), **CASES)
def test_the_promise_is_kept_in_every_state_of_a_geomorph(
    rows, cols, gaps, stretch, legs, tolerance, exaggeration, cull, seed, geomorph
):
    _, t, view = scene(rows, cols, gaps, stretch, seed)
    method = plain.refiner(TrianglePatches, t, legs=legs, cull=cull, exaggeration=exaggeration, geomorph=geomorph)
    mesh = method.refine(view, tolerance=tolerance)
    report = verify.judge_mesh(mesh, t, view, exaggeration=exaggeration)
    defects = {name for name in report.defects if not (geomorph and name == "wrong_heights")}
    assert not defects
    assert report.largest_at_samples <= tolerance
    assert mesh.stats["conservative"]


@pytest.mark.stress
@settings(max_examples=25)
@given(**CASES)
def test_edges_of_missing_ground_are_off_by_less_than_the_tolerance(
    rows, cols, gaps, stretch, legs, tolerance, exaggeration, cull, seed
):
    _, t, view = scene(rows, cols, gaps or 0.2, stretch, seed)
    method = plain.refiner(TrianglePatches, t, legs=legs, cull=cull, exaggeration=exaggeration)
    made = method.patches(view, tolerance)
    assert made.stats["pixels"] <= tolerance * (1 + 1e-6)
    mesh = mesh_of(t, made.instances, method.legs)
    report = verify.judge_mesh(mesh, t, view, exaggeration=exaggeration)
    # What is not covered, or covers a gap, is near the edge; nothing else is wrong but heights on their way.
    assert set(report.defects) <= {"uncovered", "holes", "bridged", "inner", "wrong_heights"}
    assert report.largest_at_samples <= tolerance
    # Ground that is not covered has a missing sample within the tolerance.
    drawn = ~np.isnan(surface(t, made.instances, method.legs))
    ground = ground_of(t.heights)
    missing = np.stack(np.nonzero(np.isnan(t.heights)), 1)
    row, col = np.nonzero(ground & ~drawn)
    x, y = t.grid.xy(col, row)
    z = t.heights[row, col]
    pixels, depth = view.project(np.stack([x, y, z], -1), exaggeration)
    seen = (depth > view.near) & (pixels >= 0).all(-1) & (pixels <= [view.width, view.height]).all(-1)
    for k in np.flatnonzero(seen)[::7]:
        ox, oy = t.grid.xy(missing[:, 1], missing[:, 0])
        away, _ = view.project(np.stack([ox, oy, np.full(len(ox), z[k])], -1), exaggeration)
        assert np.nanmin(np.linalg.norm(away - pixels[k], axis=-1)) <= tolerance * (1 + 1e-6)


@pytest.mark.stress
@settings(max_examples=40)
@given(share=st.sampled_from([0.0, 0.2, 0.6, 0.9]), **CASES)
def test_whatever_tiles_are_there_patches_conform(
    share, rows, cols, gaps, stretch, legs, tolerance, exaggeration, cull, seed
):
    # 256 cells a tile: larger rasters, of which nothing is measured but the mesh.
    rng, t, view = scene(rows * 6, cols * 6, 0.0, stretch, seed)
    method = plain.refiner(TrianglePatches, t, legs=legs, cull=False, exaggeration=exaggeration)
    everything = method.patches(view, tolerance)
    instances, wanted = everything.instances.copy(), everything.wanted
    resident = [np.zeros(tile_shape(t.grid.shape, level), np.uint8) for level in range(t.levels)]
    for level in resident:
        level[...] = rng.random(level.shape) < share
    made = method.patches(view, tolerance, resident=resident)
    for i in made.instances:
        root = i["level"] == t.levels - 1
        assert root or resident[i["level"]][i["tile_row"], i["tile_col"]]
    assert np.array_equal(np.sort(made.wanted), np.sort(wanted))
    named = {tuple(w) for w in wanted[["level", "row", "col"]].tolist()}
    used = {tuple(i) for i in instances[["level", "tile_row", "tile_col"]].tolist()}
    assert used <= named and (np.diff(wanted["pixels"]) <= 0).all()
    report = verify.judge_mesh(mesh_of(t, made.instances, method.legs), t, view, exaggeration=exaggeration)
    assert set(report.defects) <= {"wrong_heights"}


@pytest.mark.cases(1)
@pytest.mark.parametrize(("legs", "size", "seed"), [(2, 65, 1), (4, 65, 2), (8, 129, 3), (16, 257, 4)])
def test_nothing_jumps_when_patches_are_split_or_merged(legs, size, seed):
    rng = np.random.default_rng(seed)
    t = plain.terrain(plain.rough(rng, (size, size), amplitude=200))
    method = plain.refiner(TrianglePatches, t, legs=legs, cull=False)
    begin, end = (plain.random_view(rng, t) for _ in range(2))

    def at(where):
        eye, target = (tuple(np.add(np.multiply(1 - where, a), np.multiply(where, b)))
                       for a, b in ((begin.eye, end.eye), (begin.target, end.target)))  # fmt: skip
        return View(eye, target, fov_y=50.0, width=320, height=200)

    def select(where):
        return method.patches(at(where), 5.0).instances.copy()

    def same(one, other):
        return len(one) == len(other) and all((one[v] == other[v]).all() for v in ("row", "col", "omega", "step"))

    def patches(of):
        return {tuple(i) for i in of[["row", "col", "omega", "step"]].tolist()}

    changes, turned = 0, set()
    steps = np.linspace(0, 1, {2: 40, 4: 40, 8: 16, 16: 10}[legs])
    for a, b in itertools.pairwise(steps.tolist()):
        before, after = select(a), select(b)
        while not same(before, after) and abs(b - a) > 1e-12:  # to where a split happens
            middle = select((a + b) / 2)
            if same(before, middle):
                a, before = (a + b) / 2, middle
            else:
                b, after = (a + b) / 2, middle
        if not same(before, after):
            changes += 1
            turned |= {omega for _, _, omega, _ in patches(before) ^ patches(after)}
            assert np.nanmax(np.abs(surface(t, before, legs) - surface(t, after, legs))) < 1e-3
    assert changes > 5 and turned == set(range(8))


def test_without_geomorphs_something_would_jump():
    """The test above can fail: the same path, new points at their own heights at once."""
    rng = np.random.default_rng(3)
    t = plain.terrain(plain.rough(rng, (65, 65), amplitude=200))
    method = plain.refiner(TrianglePatches, t, legs=8, cull=False)
    view = plain.random_view(rng, t)
    a, b = (method.patches(view, tolerance, geomorph=False).instances.copy() for tolerance in (24.0, 20.0))
    assert len(a) != len(b) and np.nanmax(np.abs(surface(t, a, 8) - surface(t, b, 8))) > 0.1


# ---- the method ----------------------------------------------------------------------------------------------------


def test_in_a_plan_edges_of_missing_ground_are_seen():
    t = plain.terrain(plain.rough(np.random.default_rng(8), (257, 257), gaps=0.2))
    x, y = (float(v) for v in t.grid.xy(128, 128))
    method = plain.refiner(TrianglePatches, t)
    counts = []
    for above in (3000.0, 12000.0, 48000.0):
        view = View((x, y, above), (x, y, 0.0), width=400, height=400, projection="plan")
        made = method.patches(view, 1.0, cull=False)
        size = view.pixel_metres
        rough = made.instances[made.instances["flags"] & MAY_MISS > 0]
        assert (30.0 * 2.0 ** rough["step"] <= size).all() or rough["step"].max() == 0
        counts.append(len(made.instances))
    assert counts[0] >= counts[1] > counts[2] >= 2


def test_a_lights_volume_selects_with_the_eyes_errors():
    t = plain.terrain(plain.rough(np.random.default_rng(9), (257, 257), amplitude=200))
    rng = np.random.default_rng(10)
    view = plain.random_view(rng, t)
    method = plain.refiner(TrianglePatches, t, legs=8)
    same = method.patches(view, 1.0, frustum=view.frustum()).instances.copy()
    assert np.array_equal(np.sort(same), np.sort(method.patches(view, 1.0).instances))
    # A volume that holds everything has the patches in view as the eye has them, and others besides.
    half_space = np.array([[0.0, 0.0, 1.0, 1e6]])
    everything = {i.tobytes() for i in method.patches(view, 1.0, frustum=half_space).instances}
    share = sum(i.tobytes() in everything for i in same) / len(same)
    assert share > 0.9 and len(everything) > len(same)
    report = verify.judge_mesh(mesh_of(t, method.patches(view, 1.0, frustum=half_space).instances, 8), t, view)
    assert set(report.defects) <= {"wrong_heights"} and report.largest_at_samples <= 1.0


def test_a_raster_smaller_than_a_patch():
    for shape in ((2, 2), (3, 5), (9, 9), (17, 12)):
        t = plain.terrain(plain.rough(np.random.default_rng(1), shape))
        method = plain.refiner(TrianglePatches, t)
        view = plain.random_view(np.random.default_rng(2), t)
        report = verify.judge_mesh(method.refine(view, tolerance=1.0), t, view)
        assert method.legs <= 16 and report.ok(1.0)


@pytest.mark.cases(1)
@pytest.mark.parametrize("holes", [False, True])
def test_budgets_are_kept_by_an_eye_near_the_ground(holes):
    """Errors around it have no bound, and no tolerance leads to few triangles; edges of missing ground stay."""
    rng = np.random.default_rng(17)
    z = plain.rough(rng, (1025, 1025))
    if holes:
        z[300:308, 500:511] = z[700:703, 90:94] = np.nan
    t = plain.terrain(z)
    x, y = (float(v) for v in t.grid.xy(512, 900))
    height = float(z[900, 512]) + 2
    view = View((x, y, height), (x, y + 1000, height - 50), fov_y=50, width=1280, height=720)
    method = plain.refiner("triangle-patches", t)
    least = len(method.refine(view, tolerance=1e6).triangles)
    for budget in (least // 4, 2 * least):
        mesh = method.refine(view, triangles=budget)
        within = mesh.stats["within_budget"]
        assert within == (len(mesh.triangles) <= budget) and within >= (budget > least or not holes)
        assert budget / 4 < len(mesh.triangles) < max(budget + 1, 0.75 * least)
        assert not verify.judge_mesh(mesh, t, view).defects
        assert mesh.stats["conservative"] == (budget > least)


def test_budgets():
    t = plain.terrain(plain.rough(np.random.default_rng(12), (257, 257)))
    view = plain.random_view(np.random.default_rng(14), t)  # the eye is above the ground, not in it
    method = plain.refiner(TrianglePatches, t, legs=8)
    for budget in (1000, 5000, 20000):
        mesh = method.refine(view, triangles=budget)
        assert budget / 4 < len(mesh.triangles) <= budget and mesh.stats["within_budget"]


def test_what_is_refused():
    t = plain.terrain(np.zeros((9, 9), np.float32))
    view = plain.random_view(np.random.default_rng(0), plain.terrain(plain.rough(np.random.default_rng(0), (9, 9))))
    with pytest.raises(UsageError, match="not 12"):
        plain.refiner(TrianglePatches, t, legs=12)
    with pytest.raises(UsageError, match="needs colours"):
        plain.refiner(TrianglePatches, t, color_tolerance=1.0)
    method = plain.refiner(TrianglePatches, t)
    before = method.patches(view, 1.0).instances.copy()
    method.patches(view, 1.0, exaggeration=5.0)
    assert np.array_equal(method.patches(view, 1.0).instances, before) and method.exaggeration == 1.0
    with pytest.raises(UsageError, match="exaggeration"):
        method.patches(view, 1.0, exaggeration=0.0)
    with pytest.raises(UsageError, match="0 or more pixels"):
        method.patches(view, -1.0)
    with pytest.raises(UsageError, match="Readiness of tiles"):
        method.patches(view, 1.0, resident=[np.zeros((1, 2), np.uint8)])
    with pytest.raises(UsageError, match="at most 6 planes"):
        method.patches(view, 1.0, frustum=np.zeros((7, 4)))


@pytest.mark.parametrize("gaps", [0.0, 0.1])
def test_stores_have_the_same_tables(tmp_path, gaps):
    from orograph.store.build import build

    heights = plain.rough(np.random.default_rng(14), (700, 450), gaps=gaps)
    t = plain.terrain(heights)
    store = build(t_source(t), tmp_path / "t.oro", shard=512, chunk=256, jobs=2)
    assert store.has("patches", error="exact", legs=16) and not store.has("patches", error="exact", legs=8)
    assert not t.has("patches", error="exact", legs=16) and not store.check()
    made = patch_errors(store, "exact", 16)
    for level, wanted in enumerate(made):
        if wanted.size:
            found = store.derived("patches", error="exact", legs=16).read(level, 0, wanted.shape[0], 0, wanted.shape[1])
            assert np.array_equal(found, wanted)
    # Errors of stores are rounded up: what they decide is conservative as well.
    view = plain.random_view(np.random.default_rng(15), t)
    method = plain.refiner(TrianglePatches, store)
    report = verify.judge_mesh(method.refine(view, tolerance=1.0), store, view)
    assert report.ok(1.0)
    few = plain.refiner(TrianglePatches, store, max_memory=16 << 20).patches(view, 0.5).instances
    assert np.array_equal(few, method.patches(view, 0.5).instances)


def t_source(t):
    from orograph.store.source import ArraySource

    return ArraySource(t.heights, t.grid, t.name, None)


class Slow(MemoryTerrain):
    """A terrain whose diamonds are slow to come, or do not come at all."""

    gate: threading.Event | None = None
    broken = False

    def derived(self, name, **options):
        table = super().derived(name, **options)
        return Gated(self, table) if name == "diamonds" else table


class Gated:
    """A table behind a terrain's gate."""

    def __init__(self, terrain, table):
        self.terrain, self.table = terrain, table

    def read(self, *what):
        if self.terrain.gate is not None:
            self.terrain.gate.wait()
        if self.terrain.broken:
            raise StoreError("The disk is on fire.")
        return self.table.read(*what)


@pytest.mark.stress
def test_a_view_need_not_wait_for_errors(monkeypatch):
    from orograph.lod.patches import pager

    monkeypatch.setattr(pager, "AGAIN", 0.01)
    heights = plain.rough(np.random.default_rng(16), (1500, 1100))
    t = Slow(heights, plain.terrain(heights).grid, "slow")
    view = plain.random_view(np.random.default_rng(17), t)
    wanted = plain.refiner(TrianglePatches, t, legs=2).patches(view, 1.0).instances.copy()
    method = plain.refiner(TrianglePatches, t, legs=2)
    t.gate = threading.Event()
    counts = []
    for _ in range(3):
        made = method.patches(view, 1.0, wait=False, cull=False)
        counts.append(len(made.instances))
        assert made.stats["absent"] and method.field.pending
    assert set(counts) == {2}  # the roots stand in
    assert not verify.judge_mesh(mesh_of(t, made.instances, 2), t, view).defects
    t.broken = True
    t.gate.set()
    for _ in range(500):
        method.patches(view, 1.0, wait=False)
        if method.field.failure is not None:
            break
        time.sleep(0.01)
    assert "on fire" in str(method.field.failure)
    t.broken = False
    for _ in range(500):
        made = method.patches(view, 1.0, wait=False)
        if not made.stats["absent"]:
            break
        time.sleep(0.01)
    assert np.array_equal(made.instances, wanted) and method.field.failure is None
    assert np.array_equal(method.patches(view, 1.0).instances, wanted)


@pytest.mark.stress
def test_pages_that_are_used_stay_while_others_come():
    t = plain.terrain(plain.rough(np.random.default_rng(18), (1500, 1100)))
    method = plain.refiner(TrianglePatches, t, legs=2, max_memory=12 << 20)
    whole = plain.refiner(TrianglePatches, t, legs=2)
    rng = np.random.default_rng(19)
    for _ in range(6):
        view = plain.random_view(rng, t, fov_y=20.0)
        for _ in range(300):
            made = method.patches(view, 4.0, wait=False)
            if not made.stats["absent"]:
                break
            time.sleep(0.005)
        assert np.array_equal(made.instances, whole.patches(view, 4.0).instances)


def test_readers_end_with_their_method():
    """A thread that held its method would keep all of its memory."""
    t = plain.terrain(plain.rough(np.random.default_rng(18), (300, 200)))
    method = plain.refiner(TrianglePatches, t, legs=2)
    method.patches(plain.random_view(np.random.default_rng(19), t), 1.0, wait=False)
    readers, gone = method.field._readers, weakref.ref(method.field)
    method.field.finish()
    assert readers
    del method
    gc.collect()
    for reader in readers:
        reader.join(5.0)
    assert gone() is None and not any(reader.is_alive() for reader in readers)


# ---- colours -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("shape", "legs"), [((129, 129), 4), ((100, 141), 8)])
def test_colors_split_patches_that_are_large_enough_to_be_seen(shape, legs):
    """No drawn patch has a triangle whose colours are off by more than γ, unless it is smaller than a pixel."""
    from orograph.error.screen import to_camera
    from orograph.geovis.color_errors import ColorErrors

    t = plain.terrain(plain.rough(np.random.default_rng(5), shape))
    colors, top = ColorErrors(t, jobs=1), t.levels - 1
    tables = [colors(level, 0, rows, 0, cols) for level in range(t.levels) for rows, cols in [t.diamond_shape(level)]]

    def error(row, col):
        level = min(int(diamonds.octave(row, col)), top)
        i, j = row >> level, col >> level
        return float(tables[level][i, j]) if i < tables[level].shape[0] and j < tables[level].shape[1] else 0.0

    spheres, counts = plain.Plain(t), {}
    for gamma in (None, 12.0, 4.0):
        text = f"triangle-patches,legs={legs},cull=no" + ("" if gamma is None else f",color-tolerance={gamma}")
        method = chosen(text).make(t, Resources(color=colors))
        for seed in range(3):
            camera = Camera.over(t.grid, plain.random_view(np.random.default_rng(seed), t))
            found = method.patches(camera, 64.0, geomorph=False)
            counts[gamma] = counts.get(gamma, 0) + len(found.instances)
            mesh = mesh_of(t, found.instances, legs)
            assert verify.judge_mesh(mesh, t, camera.view).defects == {}
            lens, ends = method._lens(camera, 64.0), {}
            for patch in (triangle_of(one, legs) for one in found.instances if gamma is not None):
                (x, y), (u, v) = triangles.left_end(*patch), triangles.right_end(*patch)
                ends[(int(y + v) // 2, int(x + u) // 2)] = patch
            for row, col in ends:
                depth, octave = 2 * (legs.bit_length() - 1), int(diamonds.octave(row, col))
                if octave < legs.bit_length() - 1:
                    continue  # the samples themselves
                worst = max(error(*one) for one in below((row, col), t.n, depth))
                if worst > gamma and spheres.r[row, col] > 0:
                    r, c = min(row, t.grid.rows - 1), min(col, t.grid.cols - 1)
                    w = to_camera(lens, float(c), float(r), float(t.heights[r, c]))[2]
                    radius = float(spheres.r[row, col]) * lens.stretch
                    assert radius <= lens.texel * (w - radius) * (1 + 1e-6), (row, col)
    assert counts[None] < counts[12.0] < counts[4.0]
