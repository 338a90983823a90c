"""BDAM's geomorphs: overlays against fractions, the promise by the referee, and how far a surface jumps."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import plain
import pytest
from scipy.spatial import Delaunay

from orograph import verify
from orograph.hierarchy import diamonds
from orograph.lod.method import Goal
from orograph.lod.reference import bdam as reference
from orograph.lod.registry import chosen
from orograph.lod.tin_morphs import Separated, share_of
from orograph.lod.tin_overlay import Flat, overlaid
from orograph.scene.camera import whole
from orograph.store.patches import KAPPA
from orograph.viewpoint import Camera


def make(t, **options):
    return chosen(",".join(["bdam", *(f"{k}={v}" for k, v in options.items())])).make(t)


def flat(points, rng):
    """A triangulation of integer points in a square, whose corners are among them."""
    corners = Delaunay(points, qhull_options="QJ Qbb").simplices
    a, b, c = (points[corners[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    corners = np.where(area[:, None] < 0, corners[:, ::-1], corners)[area != 0]
    x, y = np.ascontiguousarray(points.T.astype(np.int64))
    return Flat(x, y, rng.normal(size=len(x)), corners.astype(np.int32))


def edges(m):
    return {tuple(sorted((t[k], t[(k + 1) % 3]))) for t in m.corners.tolist() for k in range(3)}


def crossings(a, b):
    """Where edges of two triangulations cross within both, exactly."""
    found = set()
    for (p, q), (u, v) in itertools.product(edges(a), edges(b)):
        px, py, qx, qy = (int(w) for w in (a.x[p], a.y[p], a.x[q], a.y[q]))
        ux, uy, vx, vy = (int(w) for w in (b.x[u], b.y[u], b.x[v], b.y[v]))
        down = (qx - px) * (vy - uy) - (qy - py) * (vx - ux)
        if down:
            s = Fraction((ux - px) * (vy - uy) - (uy - py) * (vx - ux), down)
            t = Fraction((ux - px) * (qy - py) - (uy - py) * (qx - px), down)
            if 0 < s < 1 and 0 < t < 1:
                found.add((px + s * (qx - px), py + s * (qy - py)))
    return found


def height(m, x, y):
    """The height of a triangulation, in fractions; whichever triangle holds the place."""
    for a, b, c in m.corners.tolist():
        (ax, ay), (bx, by), (cx, cy) = ((int(m.x[v]), int(m.y[v])) for v in (a, b, c))
        whole = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        u = (x - ax) * (cy - ay) - (y - ay) * (cx - ax)
        v = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
        if u >= 0 and v >= 0 and u + v <= whole:
            return float(m.z[a]) + float(Fraction(u) / whole) * float(m.z[b] - m.z[a]) + float(
                Fraction(v) / whole
            ) * float(m.z[c] - m.z[a])  # fmt: skip
    raise AssertionError


@pytest.mark.parametrize("side", [3, 6, 40])
def test_an_overlay_has_all_vertices_of_both_and_all_crossings(side):
    """A small side makes edges that lie in one line, and vertices of one mesh on edges of the other."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        around = np.array([(0, 0), (side, 0), (0, side), (side, side)])
        fine, coarse = (
            flat(np.unique(np.concatenate([around, rng.integers(0, side + 1, (n, 2))]), axis=0), rng) for n in (12, 7)
        )
        vertices, corners = overlaid(fine, coarse, 2.0**30)
        wanted = {(Fraction(int(x)), Fraction(int(y))) for m in (fine, coarse) for x, y in zip(m.x, m.y)}
        wanted |= crossings(fine, coarse)
        rounded = {tuple(float(round(v * 2**30)) / 2**30 for v in at) for at in wanted}
        assert {tuple(at) for at in vertices[:, :2].tolist()} == rounded and len(vertices) == len(wanted)
        a, b, c = (vertices[corners[:, k], :2] for k in range(3))
        area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        assert (area > 0).all() and area.sum() == pytest.approx(2 * side * side)
        used = [tuple(sorted((t[k], t[(k + 1) % 3]))) for t in corners.tolist() for k in range(3)]
        inner = [edge for edge in set(used) if used.count(edge) == 2]
        assert all(used.count(edge) <= 2 for edge in set(used)) and 2 * len(inner) + 4 <= len(used)
        # (By Euler: a disk of V vertices, of which some are on its border, has 2 V − 2 − border triangles.)
        border = sum(x in (0, side) or y in (0, side) for x, y in vertices[:, :2].tolist())
        assert len(corners) == 2 * len(vertices) - 2 - border
        for x, y, z_fine, z_coarse in vertices[:: max(1, len(vertices) // 25)].tolist():
            at = Fraction(x), Fraction(y)
            tolerance = 0.0 if (x, y) == (int(x), int(y)) else 1e-7
            # (A corner that was moved may be in another triangle of the mesh, by 2^-30.)
            assert abs(height(fine, *at) - z_fine) <= tolerance + 1e-12
            assert abs(height(coarse, *at) - z_coarse) <= tolerance + 1e-12


def test_errors_are_kept_apart():
    """Each is at least κ times those below it in the DAG, no less than it was, and infinite where it was."""
    for shape, gaps in (((100, 129), 0.0), ((300, 65), 0.01), ((270, 300), 0.0)):
        t = plain.terrain(plain.rough(np.random.default_rng(4), shape, gaps=gaps))
        method = make(t, legs=4)
        table, top = Separated(t, method.tins), t.levels - 1
        known = {}
        for level in range(t.levels):
            rows, cols = t.diamond_shape(level)
            (before, radii), after = (one.read(level, 0, rows, 0, cols) for one in (method.tins, table))
            assert (after[1] == radii).all()
            for i, j in np.ndindex(before.shape):
                at = i << level, j << level
                if not diamonds.is_diamond(*at, t.n) or diamonds.octave(*at) < 2 or radii[i, j] < 0:
                    continue
                if level == top or diamonds.octave(*at) == level:
                    known[at] = float(before[i, j]), float(after[0][i, j])
        for at, (before, after) in known.items():
            assert after == before if before < 0 else after >= before
            children = [known[child] for child in reference.children(at, t.n) if child in known]
            if before >= 0:
                assert all(after >= KAPPA * child for _, child in children)
                assert after <= max([before, *(1.002 * KAPPA * child for _, child in children)]) * (1 + 1e-6)


@pytest.mark.cases(2)
@pytest.mark.parametrize("legs", [4, 8, 16])
def test_the_promise_is_kept_while_patches_grow(legs):
    rng = np.random.default_rng(legs)
    grown = 0
    for k, shape in enumerate([(257, 257), (300, 200), (129, 421)]):
        t = plain.terrain(
            plain.rough(rng, shape, gaps=0.01 * (k % 2)), angle=float(rng.uniform(0, 360)), stretch=1.0 + k % 3
        )  # fmt: skip
        method = make(t, legs=legs, geomorph="yes")
        for _ in range(4):
            view, tolerance = plain.random_view(rng, t), float(0.5 * 16 ** rng.uniform())
            exaggeration = float(rng.choice([0.5, 1.0, 2.0]))
            found = method.select(Camera.over(t.grid, view, exaggeration), Goal(tolerance))
            mesh = found.tessellation()
            report = verify.judge_mesh(mesh, t, view, exaggeration=exaggeration)
            assert found.bound == tolerance and report.largest <= tolerance and report.defects == {}
            assert found.stats["triangles"] == len(mesh.triangles)
            grown += sum(0 < one.share < 1 for one in found.batches if one.coarse is not None)
    assert grown > 20


def largest_jump(t, meshes, view):
    """How far what is over random places moves on the screen from a mesh to the next one at most, pixels."""
    rows, cols = t.grid.shape
    x, y = np.random.default_rng(0).uniform(0, 1, (2, 500)) * [[cols - 1], [rows - 1]]
    screens = []
    for mesh in meshes:
        places = np.stack([*t.grid.xy(x, y), plain.on_mesh(mesh, x, y)], 1)
        screens.append(view.project(places)[0])
    return max(float(np.hypot(*(b - a).T).max()) for a, b in itertools.pairwise(screens))


@pytest.mark.stress
def test_the_surface_moves_without_a_jump():
    """Through tolerances two thousandths apart: without geomorphs something pops, with them nothing does."""
    t = plain.terrain(plain.rough(np.random.default_rng(3), (129, 129)))
    view = whole(t, (640, 480))
    jumps = {}
    for geomorph in ("no", "yes"):
        method = make(t, legs=4, geomorph=geomorph, cull="no")
        found = [method.select(Camera.over(t.grid, view), Goal(2.0 * 1.002**k)) for k in range(13)]
        jumps[geomorph] = largest_jump(t, (one.tessellation() for one in found), view)
    # (A patch grows while its bound goes through a fifth of the tolerance, from a surface to one that is twice the
    # tolerance away at most: two thousandths more of the tolerance take two hundredths of it.)
    assert jumps["no"] > 0.5 and jumps["yes"] < 0.042


def test_how_far_a_patch_has_grown():
    assert share_of(2.0 / KAPPA, 2.0) == 0.0 == share_of(0.1, 2.0) and share_of(2.0, 2.0) == 1.0
    assert share_of((1 + 1 / KAPPA), 2.0) == pytest.approx(0.5) and share_of(0.0, 0.0) == 0.0


def test_patches_grow_alike_for_any_number_of_threads_and_however_little_is_kept():
    from orograph.lod.method import Resources

    t = plain.terrain(plain.rough(np.random.default_rng(6), (257, 300)))
    cameras = [Camera.over(t.grid, plain.random_view(np.random.default_rng(k), t)) for k in range(3)]
    few, many = (chosen("bdam,legs=8,geomorph=yes").make(t, Resources(1 << 25, jobs)) for jobs in (1, 4))
    few._morphs._most = few._most = 1
    for camera in [*cameras, *cameras]:
        a, b = (method.select(camera, Goal(1.0)).tessellation() for method in (few, many))
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.triangles, b.triangles)
