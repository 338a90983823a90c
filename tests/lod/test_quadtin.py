"""QuadTIN: the hierarchy is the reference's, nothing folds, and the promise holds over rasters and over points."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import plain
import pytest
from affine import Affine

from orograph import verify
from orograph.dem.delaunay import Gridded, lattice_bits, on_lattice, triangulate
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.lod.method import Goal, Resources
from orograph.lod.quadtin import QuadTin
from orograph.lod.reference import quadtin as reference
from orograph.store.memory import MemoryTerrain
from orograph.store.quadtin_grow import Making
from orograph.verify.points import _distance, _lens


class Points:
    """What a terrain of points was made of."""

    def __init__(self, surface):
        self.surface = surface

    def heights_at(self, x, y):
        raise NotImplementedError


def scattered(rng, shape, count, *, whole=True, coarse=False, cell=30.0, stretch=1.0, angle=0.0, amplitude=80.0):
    """A terrain of random points on a fractal; with points all along its rectangle, it has ground everywhere."""
    rows, cols = shape
    col, row = rng.uniform(0.5, cols - 1.5, count), rng.uniform(0.5, rows - 1.5, count)
    if coarse:  # middles, and middles of these, stay on the lattice
        col, row = np.round(col * 32) / 32, np.round(row * 32) / 32
    if whole:
        across, down = np.arange(cols), np.arange(1, rows - 1)
        col = np.r_[col, across, across, 0 * down, 0 * down + cols - 1]
        row = np.r_[row, 0 * across, 0 * across + rows - 1, down, down]
    z = plain.surface(plain.rough(rng, (rows + 1, cols + 1), amplitude=amplitude).astype(float), col, row)
    bits = lattice_bits(rows, cols)
    surface = triangulate(on_lattice(col, row, z, bits), bits, "points")
    transform = Affine.translation(5e5, 4e6) @ Affine.rotation(angle) @ Affine.scale(cell * stretch, -cell)
    made = MemoryTerrain(Gridded(surface).read(0, rows, 0, cols), Grid(shape, transform, None), "points")
    made.samples = Points(surface)
    return made


def faces(tree, leaves):
    """Corners of triangles, as a set of sets of places."""
    return {frozenset((float(x), float(y)) for x, y, _ in tree.vertices[c]) for c in tree.corners[leaves]}


def referred(terrain, finest):
    """The reference's hierarchy of a terrain."""
    making = Making(terrain, finest, False)
    truth, bits = making._truth(0)[0], making.layout.bits
    points = [
        (Fraction(int(x), 1 << bits), Fraction(int(y), 1 << bits), Fraction(float(z)))
        for x, y, z in zip(truth.x, truth.y, truth.z)
    ]
    rows, cols = terrain.grid.shape
    return reference.QuadTin([tuple(points[v] for v in t) for t in truth.triangles], cols - 1, rows - 1, finest)


# ---- the hierarchy -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["raster 5x5", "raster 4x5", "raster 2x3", "points"])
def test_the_hierarchy_and_its_meshes_are_the_reference_s(kind):
    rng = np.random.default_rng(len(kind))
    if kind == "points":
        t = scattered(rng, (4, 5), 5, coarse=True)
    else:
        t = plain.terrain(plain.rough(rng, tuple(map(int, kind.split()[1].split("x")))))
    finest = 6.0 if kind == "raster 5x5" else 12.0
    method, wanted = plain.refiner(QuadTin, t, finest=finest, cull=False), referred(t, finest)
    tree = method.tree
    every = {frozenset((float(x), float(y)) for x, y, _ in face) for face in wanted.drawn(lambda p: True)}
    assert faces(tree, np.flatnonzero(tree.child < 0)) == every
    assert tree.points + tree.steiner == len(tree.vertices) - 4
    fewer = 0
    for seed in range(6):
        view = plain.random_view(np.random.default_rng(seed), t)
        for tolerance in (1.0, 8.0, 40.0):
            mesh = method.refine(view, tolerance=tolerance)
            there = {(float(x), float(y)) for x, y, _ in tree.vertices[4:][method._active[4:] == 1]}
            drawn = list(wanted.drawn(lambda p: (float(p[0]), float(p[1])) in there))  # noqa: B023
            assert len(drawn) == len(mesh.triangles)
            mine = [frozenset(map(tuple, mesh.vertices[c][:, :2].tolist())) for c in mesh.triangles]
            assert mine == [frozenset((float(x), float(y)) for x, y, _ in face) for face in drawn]  # in this order
            fewer += len(drawn) < len(every)
    assert fewer > 3 or kind == "raster 2x3"


def test_errors_are_the_reference_s():
    t = scattered(np.random.default_rng(5), (4, 5), 5, coarse=True)
    tree, wanted = plain.refiner(QuadTin, t, finest=20.0).tree, referred(t, 20.0)
    found = {}

    def walk(triangle):
        found[frozenset((float(x), float(y)) for x, y, _ in triangle.face)] = float(wanted.error(triangle))
        for child in triangle.children or ():
            walk(child)

    for root in wanted.roots:
        walk(root)
    assert len(found) == len(tree.child)
    for corners, off in zip(tree.corners, tree.off):
        places = frozenset((float(x), float(y)) for x, y, _ in tree.vertices[corners])
        assert off == pytest.approx(found[places], rel=2e-7, abs=1e-7)  # float32, rounded up


@pytest.mark.parametrize("split", ["nearest", "deviation"])
@pytest.mark.parametrize("points", [True, False])
def test_nothing_folds_and_errors_are_saturated(points, split):
    rng = np.random.default_rng(17)
    t = scattered(rng, (40, 61), 900) if points else plain.terrain(plain.rough(rng, (40, 61)), stretch=2.5)
    tree = plain.refiner(QuadTin, t, split=split).tree
    at = np.ldexp(tree.vertices[:, :2], lattice_bits(40, 61)).astype(np.int64)
    a, b, c = (at[tree.corners[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert area.min() > 0
    leaves = tree.child < 0
    assert area[leaves].sum() == area[:2].sum()  # they cover the rectangle, once
    assert tree.off[leaves].max() <= tree.finest * (1 + 2e-7) and tree.whole and not tree.stuck
    for v in range(5, len(tree.vertices)):
        for p in tree.parents[v]:
            assert p < v
            if p > 3:
                assert tree.error[p] >= tree.error[v]
                d = tree.vertices[p] - tree.vertices[v]
                away = np.linalg.norm([d[0] * t.grid.spacing[0], d[1] * t.grid.spacing[1], d[2]])
                assert tree.radius[p] >= away + tree.radius[v] - 1e-9
    split_ = np.flatnonzero(~leaves)
    assert (tree.off[split_] <= tree.error[tree.node[split_]]).all()


def test_a_lattice_of_samples_is_the_regular_hierarchy():
    """Over a raster of 2^n + 1 samples the nearest sample is the middle itself: no Steiner point, nothing left."""
    t = plain.terrain(np.random.default_rng(5).normal(0, 20, (17, 17)).astype(np.float32))
    tree = plain.refiner(QuadTin, t, finest=1e-6).tree
    assert tree.steiner == 0 and (tree.child < 0).sum() == 2 * 16 * 16
    view = plain.random_view(np.random.default_rng(6), t)
    mesh = plain.refiner(QuadTin, t, finest=1e-6, cull=False).refine(view, tolerance=0.0)
    assert verify.judge_mesh(mesh, t, view).ok(1e-6)


# ---- the strip -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("whole", [True, False])
def test_the_strip_is_the_triangles(whole):
    t = scattered(np.random.default_rng(3), (50, 40), 700, whole=whole)
    method = plain.refiner(QuadTin, t)
    for seed in range(5):
        mesh = method.refine(plain.random_view(np.random.default_rng(seed), t), tolerance=2.0)
        strip = mesh.strip
        found = []
        for i in range(len(strip) - 2):
            a, b, c = strip[i : i + 3]
            if a != b and b != c and a != c:
                found.append((a, b, c) if i % 2 == 0 else (b, a, c))
        turned = [tuple(np.roll(f, -int(np.argmin(f)))) for f in found]
        assert sorted(turned) == sorted(tuple(np.roll(f, -int(np.argmin(f)))) for f in mesh.triangles)
        if whole:
            assert len(strip) < 1.75 * len(mesh.triangles) + 10


# ---- the promise ---------------------------------------------------------------------------------------------------


def kept(t, views, seed, exaggeration=1.0, **options):
    """Whether the bound holds in random views; how many had more than one triangle, and were promised."""
    rng = np.random.default_rng(seed)
    method = plain.refiner(QuadTin, t, exaggeration=exaggeration, **options)
    promised = 0
    for _ in range(views):
        view, tolerance = plain.random_view(rng, t), float(10 ** rng.uniform(-0.3, 0.9))
        selection = method.select(method.camera(view), Goal(tolerance=tolerance))
        if selection.bound is None:
            continue
        report = verify.judge_mesh(selection.mesh, t, view, exaggeration=exaggeration)
        assert report.ok(selection.bound), (seed, tolerance, selection.bound, str(report))
        promised += len(selection.mesh.triangles) > 2
    return promised


def ground(k, rng):
    """The k-th kind of terrain."""
    shape = [(33, 33), (40, 57), (2, 9), (57, 30), (64, 21)][k % 5]
    how = {"stretch": float(rng.choice([1, 2.5])), "angle": float(rng.uniform(0, 360))}
    if k % 2:
        return scattered(rng, (max(shape[0], 12), shape[1]), 500, whole=k % 4 == 1, **how)
    return plain.terrain(plain.rough(rng, shape), **how)


def test_the_promise_is_kept():
    promised = 0
    for k in range(8):
        rng = np.random.default_rng(k)
        promised += kept(ground(k, rng), 5, k, float(rng.choice([0.5, 1, 2])))
    assert promised > 30


@pytest.mark.stress
def test_the_promise_is_kept_in_hundreds_of_views(shared_data):
    promised = sum(kept(ground(k, np.random.default_rng(k)), 8, k) for k in range(40))
    from orograph.store.opening import terrain

    path = shared_data / "bigtujunga-srtm30m-utm" / "srtm_bigtujunga30m_utm11.tif"
    whole = terrain(str(path), progress=False)
    part = MemoryTerrain(whole.heights[100:357, 200:500], whole.grid.window(100, 357, 200, 500), "part")
    promised += kept(part, 20, 99)
    assert promised >= 300


def test_where_ground_is_missing_there_is_no_bound_and_no_crack():
    t = plain.terrain(plain.rough(np.random.default_rng(9), (40, 50), gaps=0.2))
    method = plain.refiner(QuadTin, t)
    for seed in range(4):
        view = plain.random_view(np.random.default_rng(seed), t)
        selection = method.select(method.camera(view), Goal(tolerance=1.0))
        report = verify.judge_mesh(selection.mesh, t, view)
        assert selection.bound is None and len(selection.mesh.triangles) > 10
        assert not {"t_junctions", "overlaps", "crowded", "reversed", "flat", "bridged"} & set(report.defects)


def test_budgets():
    t = scattered(np.random.default_rng(4), (60, 60), 1500)
    method = plain.refiner(QuadTin, t)
    view = plain.random_view(np.random.default_rng(2), t)
    selection = method.select(method.camera(view), Goal(triangles=900))
    assert 450 < len(selection.mesh.triangles) <= 900 and selection.stats["within_budget"]
    assert selection.bound is None or verify.judge_mesh(selection.mesh, t, view).ok(selection.bound)
    assert len(method.refine(view, seconds=0.05).triangles) > 2


def test_what_does_not_fit_is_refused():
    t = plain.terrain(plain.rough(np.random.default_rng(1), (200, 200)))
    with pytest.raises(UsageError, match="hierarchy of a QuadTIN"):
        QuadTin(t, resources=Resources(max_memory=1 << 20))
    with pytest.raises(UsageError, match="There is no ground"):
        QuadTin(plain.terrain(np.full((5, 5), np.nan, np.float32)))


# ---- the referee over points ---------------------------------------------------------------------------------------


def test_the_referee_of_points_finds_what_dense_sampling_finds():
    rng = np.random.default_rng(12)
    t = scattered(rng, (12, 14), 40)
    method = plain.refiner(QuadTin, t, finest=5.0)
    surface = t.samples.surface
    for seed in range(4):
        view = plain.random_view(np.random.default_rng(seed), t)
        mesh = method.refine(view, tolerance=20.0)
        report = verify.judge_mesh(mesh, t, view)
        col, row = rng.uniform(0, 13, 6000), rng.uniform(0, 11, 6000)
        true, drawn = Gridded(surface).at(col, row), plain.on_mesh(mesh, col, row)
        lens, planes = _lens(view, t, 1.0)
        places = np.stack([col, row, true], -1)
        seen = (np.c_[places, np.ones(len(places))] @ planes.T >= 0).all(1) & ~np.isnan(true + drawn)
        camera = plain.Camera(view)
        off = [_distance(lens, p, h) for p, h in zip(places[seen], drawn[seen])]
        x, y = t.grid.xy(col[seen], row[seen])
        p, q = (camera.to_camera(np.stack([x, y, h], -1)) for h in (true[seen], drawn[seen]))
        plainly = camera.focal * np.hypot(*(p[:, :2] / p[:, 2:] - q[:, :2] / q[:, 2:]).T)
        assert np.allclose(off, plainly, rtol=1e-6, atol=1e-9)
        most = max(off, default=0.0)
        assert most <= report.largest * (1 + 1e-6) + 1e-9
        assert report.largest == 0 or most > 0.7 * report.largest
    lowered = type(mesh)(mesh.vertices - [0, 0, 50], mesh.triangles, None, dict(mesh.stats))
    assert verify.judge_mesh(lowered, t, view).largest > report.largest
    holed = type(mesh)(mesh.vertices, mesh.triangles[len(mesh.triangles) // 2 :], None, dict(mesh.stats))
    assert verify.judge_mesh(holed, t, view).uncovered > 0 or report.samples < 3
