"""BDAM: its selection against the reference, edges at all mixed levels, the promise by the referee, stores, budgets."""

from __future__ import annotations

import itertools
import math

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.dem.raster import Dem
from orograph.errors import StoreError, UsageError
from orograph.hierarchy import diamonds, triangles
from orograph.lod.bdam import Bdam
from orograph.lod.method import Goal, Ready, Resources
from orograph.lod.patches.shape import INSTANCE
from orograph.lod.reference import bdam as reference
from orograph.lod.registry import chosen
from orograph.lod.selection import TinBatches
from orograph.scene.camera import whole
from orograph.store import open as open_store
from orograph.store.build import build
from orograph.store.tin_build import Building, make_tins
from orograph.store.tin_diamonds import Workplace, tins_of
from orograph.viewpoint import Camera

SHAPES = [(65, 65), (100, 77), (33, 130), (129, 40), (17, 17), (9, 5), (2, 2)]


def make(t, legs=8, **more) -> Bdam:
    return chosen(",".join([f"bdam,legs={legs}", *(f"{k}={v}" for k, v in more.items())])).make(t)


def tables(method):
    """Errors and radii of the TINs, by (row, col) of the diamonds that have any ground."""
    t, found = method.terrain, {}
    top, q = t.levels - 1, method.legs.bit_length() - 1
    for level in range(t.levels):
        rows, cols = t.diamond_shape(level)
        errors, radii = method.tins.read(level, 0, rows, 0, cols)
        for i, j in np.ndindex(errors.shape):
            at = i << level, j << level
            if not diamonds.is_diamond(*at, t.n) or diamonds.octave(*at) < q:
                continue
            if (level == top or diamonds.octave(*at) == level) and radii[i, j] >= 0:
                found[at] = float(errors[i, j]), float(radii[i, j])
    return found


def triangle_of(instance, legs):
    L, omega = legs << int(instance["step"]), int(instance["omega"])
    return tuple(int(v) for v in triangles.with_apex(int(instance["col"]), int(instance["row"]), L, omega))


def instance_of(patch, t, legs):
    """A patch as the selection has it."""
    found = np.zeros(1, INSTANCE)
    _, _, L, omega = patch
    found["col"], found["row"] = triangles.apex(*patch)
    found["omega"], found["step"] = omega, (L // legs).bit_length() - 1
    found["level"] = min(int(found["step"][0]), t.levels - 1)
    corners = [triangles.apex(*patch), triangles.left_end(*patch), triangles.right_end(*patch)]
    found["tile_col"], found["tile_row"] = (min(c) >> (int(found["level"][0]) + 8) for c in zip(*corners))
    return found, min(c for c, _ in corners), min(r for _, r in corners)


@pytest.mark.cases(2)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_selection_is_the_reference_s(shape):
    rng = np.random.default_rng(shape)
    for k in range(6):
        t = plain.terrain(plain.rough(rng, shape, gaps=0.02 * (k % 2)), angle=float(rng.uniform(0, 360)))
        method = make(t, (4, 8)[k % 2], cull="no")
        known, arrays = tables(method), plain.Plain(t)
        arrays.e, arrays.r = np.zeros_like(arrays.e), np.zeros_like(arrays.r)
        for at, (e, r) in known.items():
            arrays.e[at], arrays.r[at] = math.inf if e < 0 else e, r
        view, tolerance = plain.random_view(rng, t), float(10 ** rng.uniform(-1, 1))
        pixels = arrays.sphere_errors(plain.Camera(view))
        _, wanted = reference.selected(
            t.n, method.legs, lambda at: bool(pixels[at] > tolerance or known[at][0] < 0), lambda at: at in known  # noqa: B023
        )  # fmt: skip
        found = method.patches(Camera.over(t.grid, view), tolerance, geomorph=False).instances
        got = {triangle_of(one, method.legs) for one in found}
        rows, cols = t.grid.shape
        corners = {
            patch: [f(*patch) for f in (triangles.apex, triangles.left_end, triangles.right_end)] for patch in wanted
        }
        there = {p for p, c in corners.items() if min(x for x, _ in c) < cols - 1 and min(y for _, y in c) < rows - 1}
        assert len(got) == len(found) and got == there


def vertices_on(vertices, corners, a, b):
    """The vertices (col, row) of triangles that lie on the segment between two samples (row, col)."""
    used = vertices[np.unique(corners)]
    line = {(c, r) for r, c in reference.samples_between(a, b)}
    return {(int(x), int(y)) for x, y in used[:, :2]} & line


def edges_of(terrain, tins, at, workplace):
    """What the TINs of a diamond list along each of their edges: by its ends, one set from each patch."""
    vertices, *patches = tins_of(terrain, tins, *at, workplace)
    found = []
    for side, corners in enumerate(patches):
        if len(corners):
            a, b, p = diamonds.end(*at, 0), diamonds.end(*at, 1), diamonds.apex(*at, side)
            for ends in ((a, b), (a, p), (b, p)):
                found.append((frozenset(ends), vertices_on(vertices, corners, *ends)))
    return found


def check_edges(terrain, tins, which):
    """All patches that may list vertices on an edge list the same: as a hypotenuse, and as a leg of the next level."""
    workplace, listed, count = Workplace(), {}, 0
    for at in which:
        for edge, found in edges_of(terrain, tins, at, workplace):
            listed.setdefault(edge, []).append(found)
    q = tins.legs.bit_length() - 1
    for edge, found in listed.items():
        a, b = tuple(edge)
        middle = (a[0] + b[0]) // 2, (a[1] + b[1]) // 2
        if diamonds.level(*middle, terrain.n) == 2 * (terrain.n - q):  # a finest patch's hypotenuse
            rows, cols = terrain.grid.shape
            found.append({(c, r) for r, c in reference.samples_between(a, b) if r < rows and c < cols})
        assert all(one == found[0] for one in found), (edge, found)
        count += len(found) > 1
    return count


@pytest.mark.parametrize("shape", [(65, 65), (50, 77), (129, 40), (64, 64), (70, 66)])
@pytest.mark.parametrize("legs", [4, 8, 16])
def test_both_sides_of_every_edge_list_the_same_vertices(shape, legs):
    """Exhaustive: an edge is a hypotenuse of one level and a leg of the next coarser, so these are all mixed levels."""
    for gaps in (0.0, 0.03):
        t = plain.terrain(plain.rough(np.random.default_rng(legs), shape, gaps=gaps))
        method = make(t, legs)
        which = [at for at, (error, _) in tables(method).items() if error >= 0]
        checked = check_edges(t, method.tins, which)
        assert checked > 0 or gaps or max(shape) <= 4 * legs + 2


@pytest.mark.stress
def test_edges_of_a_large_terrain():
    t = plain.terrain(plain.rough(np.random.default_rng(1), (1000, 777)))
    method = make(t, 8)
    clean = {at for at, (error, _) in tables(method).items() if error >= 0}
    rng = np.random.default_rng(2)
    some = [sorted(clean)[int(k)] for k in rng.integers(0, len(clean), 150)]
    near = {other for at in some for other in (*reference.children(at, t.n), *reference.parents(at, t.n))}
    assert check_edges(t, method.tins, sorted({*some, *near} & clean)) > 300


def test_every_front_is_a_mesh():
    """Random fronts, far more mixed than any view's: no T-junction, no overlap, no gap."""
    rng = np.random.default_rng(3)
    for shape in ((129, 129), (100, 150), (65, 40)):
        t = plain.terrain(plain.rough(rng, shape, gaps=0.01 if shape[0] == 65 else 0.0))
        method = make(t, 4)
        known = tables(method)
        for chance in (0.3, 0.6, 0.9):
            wishes = {at: bool(rng.random() < chance) for at in known}
            _, patches = reference.selected(
                t.n, 4, lambda at: known[at][0] < 0 or wishes[at], lambda at: at in known  # noqa: B023
            )  # fmt: skip
            made = [instance_of(patch, t, 4) for patch in sorted(patches)]
            rows, cols = t.grid.shape
            there = np.concatenate([one for one, x, y in made if x < cols - 1 and y < rows - 1])
            mesh = TinBatches(method="bdam", bound=None, batches=method._batches(there)).tessellation()
            assert verify.judge_mesh(mesh, t, whole(t, (320, 240))).defects == {}


@pytest.mark.parametrize("legs", [4, 8, 16])
def test_the_promise_is_kept(legs):
    rng = np.random.default_rng(legs)
    for k, shape in enumerate([(257, 257), (300, 200), (129, 421), (65, 65)]):
        t = plain.terrain(
            plain.rough(rng, shape, gaps=0.03 * (k % 2)), angle=float(rng.uniform(0, 360)), stretch=1.0 + k % 3
        )  # fmt: skip
        method = make(t, legs)
        for _ in range(4):
            view, tolerance = plain.random_view(rng, t), float(0.5 * 16 ** rng.uniform())
            exaggeration = float(rng.choice([0.5, 1.0, 2.0]))
            found = method.select(Camera.over(t.grid, view, exaggeration), Goal(tolerance))
            report = verify.judge_mesh(found.tessellation(), t, view, exaggeration=exaggeration)
            assert found.bound == tolerance and report.largest <= tolerance and report.defects == {}


def test_errors_are_saturated_and_spheres_hold_all_vertices():
    t = plain.terrain(plain.rough(np.random.default_rng(4), (100, 129)))
    method = make(t, 4)
    known, workplace = tables(method), Workplace()
    errors = {at: error for at, (error, _) in known.items()}
    assert {at: error for at, error in reference.saturated(errors, t.n).items() if at in known} == errors

    def place(row, col):
        r, c = min(row, 99), min(col, 128)
        return np.array([*t.grid.xy(c, r), t.heights[r, c]], float)

    for at, (error, radius) in known.items():
        for child in reference.children(at, t.n):
            if child in known:
                assert known[child][0] <= error
                assert np.linalg.norm(place(*at) - place(*child)) + known[child][1] <= radius * (1 + 1e-6)
        vertices, *corners = tins_of(t, method.tins, *at, workplace)
        used = vertices[np.unique(np.concatenate(corners))]
        x, y = t.grid.xy(used[:, 0], used[:, 1])
        assert np.linalg.norm(np.stack([x, y, used[:, 2]], 1) - place(*at), axis=1).max() <= radius * (1 + 1e-6)


@pytest.mark.stress
def test_smooth_ground_takes_less_than_half_of_regular_patches_triangles():
    y, x = np.mgrid[:513, :513]
    z = 60 * np.sin(x / 90) * np.cos(y / 70) + 25 * np.exp(-(((x - 300) / 12) ** 2)) + 3 * np.sin(x / 11 + y / 17)
    t = plain.terrain(z.astype(np.float32), cell=1.0)
    views = [plain.random_view(np.random.default_rng(k), t) for k in range(6)]
    counts = {
        name: sum(
            chosen(name).make(t).select(Camera.over(t.grid, view), Goal(1.0)).stats["triangles"] for view in views
        )
        for name in ("bdam", "triangle-patches")
    }  # fmt: skip
    assert 2 * counts["bdam"] <= counts["triangle-patches"]


def test_marks_in_files_make_the_same(tmp_path, monkeypatch):
    from orograph import folders
    from orograph.store import tin_build

    z = plain.rough(np.random.default_rng(7), (300, 411), gaps=0.01)
    dem = Dem(z, plain.terrain(z).grid)
    build(dem, tmp_path / "a.oro", tins=16, jobs=1, progress=False).close()
    monkeypatch.setattr(folders, "HELD", 0)
    monkeypatch.setattr(tin_build, "BAND", 1)
    build(dem, tmp_path / "b.oro", tins=16, jobs=3, progress=False).close()
    shards = sorted(p.relative_to(tmp_path / "a.oro") for p in (tmp_path / "a.oro" / "tins").rglob("c/*/*"))
    assert shards and all(
        (tmp_path / "b.oro" / s).read_bytes() == (tmp_path / "a.oro" / s).read_bytes() for s in shards
    )


def test_a_store_has_the_same(tmp_path):
    z = plain.rough(np.random.default_rng(5), (300, 421), gaps=0.01)
    t = plain.terrain(z)
    made = build(Dem(z, t.grid), tmp_path / "a.oro", tins=16, progress=False)
    assert made.has("tins", legs=16) and not made.has("tins", legs=8) and made.check() == []
    with pytest.raises(StoreError, match="no TINs"):
        made.derived("tins", legs=8)
    camera = Camera.over(t.grid, plain.random_view(np.random.default_rng(6), t))
    ours, theirs = (chosen("bdam").make(one).select(camera, Goal(1.0)).tessellation() for one in (t, made))
    np.testing.assert_array_equal(ours.vertices, theirs.vertices)
    np.testing.assert_array_equal(ours.triangles, theirs.triangles)
    assert open_store(tmp_path / "a.oro").has("tins", legs=16)


def test_damaged_tins_are_made_again(tmp_path):
    from orograph.store.repair import repair

    z = plain.rough(np.random.default_rng(7), (200, 150))
    build(Dem(z, plain.terrain(z).grid), tmp_path / "a.oro", tins=8, progress=False).close()
    shard = tmp_path / "a.oro" / "tins" / "octave-4" / "marks" / "c" / "0" / "0"
    before = shard.read_bytes()
    shard.write_bytes(before[:40] + bytes([before[40] ^ 255]) + before[41:])
    assert open_store(tmp_path / "a.oro").check() != []
    repair(str(tmp_path / "a.oro"))
    assert shard.read_bytes() == before and open_store(tmp_path / "a.oro").check() == []


def test_the_same_for_any_number_of_workers_and_bands(monkeypatch):
    t = plain.terrain(plain.rough(np.random.default_rng(8), (400, 333), gaps=0.01))
    one = make_tins(t, 8, jobs=1)
    monkeypatch.setattr("orograph.store.tin_build.AT_ONCE", 256)
    assert Building(t, 8).bands(3) > 8
    many = make_tins(t, 8, jobs=5)
    for level in range(t.levels):
        for a, b in zip((one.errors, one.radii), (many.errors, many.radii)):
            np.testing.assert_array_equal(a[level], b[level])
    assert all((one._marks[k] == many._marks[k]).all() for k in one._marks) and one.figures == many.figures


def test_budgets():
    t = plain.terrain(plain.rough(np.random.default_rng(9), (257, 257)))
    method = make(t, 8)
    camera = Camera.over(t.grid, plain.random_view(np.random.default_rng(10), t))
    for triangles_ in (600, 3000, 20_000):
        found = method.select(camera, Goal(triangles=triangles_))
        size = len(found.tessellation().triangles)
        assert size == found.stats["triangles"] <= triangles_ and found.stats["within_budget"]
        assert found.bound is None or verify.judge_mesh(found.tessellation(), t, camera.view).largest <= found.bound
    few = method.select(camera, Goal(triangles=2))
    assert not few.stats["within_budget"] and few.bound is None
    timed = method.select(camera, Goal(seconds=0.05))
    assert len(timed.tessellation().triangles) > 0
    assert method.select(camera, Goal(0.0)).bound == 0.0


@pytest.mark.stress
def test_tiles_that_are_lacking_are_told():
    t = plain.terrain(plain.rough(np.random.default_rng(11), (600, 600)))
    method = make(t, 16)
    camera = Camera.over(t.grid, whole(t, (1200, 900)))
    assert len(method.select(camera, Goal(0.05)).lacking) == 0
    nothing = np.zeros(len(method._all), np.uint8)
    lacking = method.select(camera, Goal(0.05), Ready(nothing)).lacking
    assert len(lacking) > 1 and (np.diff(lacking["pixels"]) <= 0).all()
    nothing[method.tiling.places(lacking)] = 1
    assert len(method.select(camera, Goal(0.05), Ready(nothing)).lacking) == 0


def test_halving_goes_on_where_legs_are_locked():
    """Half of the triangles below, at every level; the reference says which vertices were in whose hands."""
    t = plain.terrain(plain.rough(np.random.default_rng(12), (257, 257)))
    for legs in (8, 16):
        for f in make(t, legs).tins.figures:
            assert 0.45 <= f.triangles / f.below <= 0.56, f
    rough = make(t, 4).tins.figures  # (17 samples around a diamond of 32 triangles)
    assert all(f.triangles / f.below <= 0.75 for f in rough)


def test_who_may_move():
    """Of two successive levels: what lies on a leg was decided below, and stays."""
    t = plain.terrain(plain.rough(np.random.default_rng(13), (65, 65)))
    method, workplace = make(t, 4), Workplace()
    for at, _ in itertools.islice(tables(method).items(), 0, None, 3):
        vertices, *corners = tins_of(t, method.tins, *at, workplace)
        used = vertices[np.unique(np.concatenate(corners))][:, :2].astype(int)
        assert {reference.role(at, int(y), int(x)) for x, y in used} <= {"locked", "along", "free"}


def test_what_cannot_be_is_refused():
    t = plain.terrain(plain.rough(np.random.default_rng(14), (65, 65)))
    with pytest.raises(UsageError, match="legs"):
        chosen("bdam,legs=5")
    with pytest.raises(UsageError, match="error"):
        chosen("bdam,error=wedgie")
    with pytest.raises(UsageError, match="`tins` must be one of"):
        build(Dem(t.heights, t.grid), "nowhere.oro", tins=7, progress=False)


def test_too_large_a_terrain_is_not_made_in_memory(tmp_path):
    z = plain.rough(np.random.default_rng(15), (300, 300))
    made = build(Dem(z, plain.terrain(z).grid), tmp_path / "a.oro", progress=False)
    with pytest.raises(UsageError, match="no TINs"):
        chosen("bdam").make(made, Resources(max_memory=1 << 16))
