"""ROAM's optional terms: what is decided on the mesh, against brute force on the full-resolution surface."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.errors import UsageError
from orograph.lod.roam import Roam
from orograph.viewpoint import View


def crossings(p, q) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(col, row, height) of a line where it meets any edge a mesh can have: all that is linear bends nowhere else."""
    p, q = np.array(p, float), np.array(q, float)
    ts = [np.array([0.0, 1.0])]
    for f in (lambda v: v[0], lambda v: v[1], lambda v: v[0] - v[1], lambda v: v[0] + v[1]):
        a, b = f(p), f(q)
        if a != b:
            k = np.arange(math.ceil(min(a, b)), math.floor(max(a, b)) + 1)
            ts.append((k - a) / (b - a))
    t = np.unique(np.concatenate(ts).clip(0, 1))[:, None]
    return tuple((p + t * (q - p)).T)


def far_view(t) -> View:
    x, y = t.grid.xy(t.grid.cols / 2, t.grid.rows / 2)
    return View((float(x), float(y) - 10, 1e6), (float(x), float(y), 0.0), width=200, height=200)


@pytest.mark.parametrize("shape", [(65, 65), (50, 70)])
def test_lines_of_sight_on_the_mesh_are_those_on_the_surface(shape):
    rng = np.random.default_rng(shape[0])
    z = plain.rough(rng, shape)
    t = plain.terrain(z)
    lines = []
    for _ in range(24):
        ends = rng.uniform(0, 1, (2, 2)) * (shape[1] - 1, shape[0] - 1)
        heights = plain.surface(z, ends[:, 0], ends[:, 1]) + rng.choice([1.0, 5.0, 15.0])
        lines.append(tuple((float(c), float(r), float(h)) for (c, r), h in zip(ends, heights)))
    method = plain.refiner(Roam, t, line_of_sight=lines, cull=False)
    coarse = plain.refiner(Roam, t, cull=False).refine(far_view(t), tolerance=50)
    found = method.refine(far_view(t), tolerance=50)
    assert 2 <= len(coarse.triangles) < len(found.triangles) < 2 * (shape[0] - 1) * (shape[1] - 1)
    assert not verify.judge_mesh(found, t, far_view(t)).defects
    seen, wrong = [], 0
    for p, q in lines:
        col, row, height = crossings(p, q)
        free = bool((plain.surface(z, col, row) <= height).all())
        assert bool((plain.on_mesh(found, col, row) <= height).all()) == free
        wrong += bool((plain.on_mesh(coarse, col, row) <= height).all()) != free
        seen.append(free)
    assert 3 < sum(seen) < 21 and wrong > 0  # there was something to decide, and without the term it is wrong


@pytest.mark.parametrize("metres", [0.0, 2.0])
def test_the_ground_beneath_objects_is_exact(metres):
    rng = np.random.default_rng(4)
    z = plain.rough(rng, (65, 65))
    t = plain.terrain(z)
    col, row, radius = 20.3, 41.0, 4.5
    view = far_view(t)
    plainly = plain.refiner(Roam, t, cull=False).refine(view, tolerance=100)
    found = plain.refiner(Roam, t, cull=False, objects=[(col, row, radius)], object_tolerance=metres).refine(
        view, tolerance=100
    )
    at, turn = np.sqrt(rng.uniform(0, 1, 800)) * radius, rng.uniform(0, 2 * np.pi, 800)
    c, r = col + at * np.cos(turn), row + at * np.sin(turn)
    assert np.abs(plain.on_mesh(found, c, r) - plain.surface(z, c, r)).max() <= metres + 1e-4
    assert np.abs(plain.on_mesh(plainly, c, r) - plain.surface(z, c, r)).max() > 5
    assert len(found.triangles) < 2000


def facing(t, found, view) -> np.ndarray:
    """For each triangle's ground: does all (1), some (0), none (−1) of the full-resolution surface face the eye?"""
    z = t.heights.astype(float)
    col, row = t.grid.index(*view.eye[:2])
    result = []
    for corners in found.vertices[found.triangles]:
        c0, r0 = corners[:, :2].min(0).astype(int)
        c1, r1 = corners[:, :2].max(0).astype(int)
        signs = set()
        (x0, y0), (x1, y1), (x2, y2) = corners[:, :2]
        for i in range(r0, r1):
            for j in range(c0, c1):
                a, b, c, d = z[i, j], z[i, j + 1], z[i + 1, j], z[i + 1, j + 1]
                # (gradients, where the middle is; b and c lie on both triangles or on one each)
                two = (
                    ((b - a, d - b, 2, 1), (d - c, c - a, 1, 2)) if (i + j) % 2 == 0
                    else ((b - a, c - a, 1, 1), (d - c, d - b, 2, 2))
                )  # fmt: skip
                for h_c, h_r, u, v in two:
                    x, y = j + u / 3, i + v / 3
                    sides = [(p - x) * (s - y) - (q - y) * (r - x)
                             for p, q, r, s in ((x0, y0, x1, y1), (x1, y1, x2, y2), (x2, y2, x0, y0))]  # fmt: skip
                    if min(sides) < 0 < max(sides):
                        continue
                    k, m, height = (i + 1, j, c) if v == 2 else (i, j + 1, b)
                    signs.add(view.eye[2] - height - h_c * (col - m) - h_r * (row - k) > 0)
        result.append(1 if signs == {True} else -1 if signs == {False} else 0)
    return np.array(result)


def ridge() -> tuple:
    """A long ridge with a rough crest and flanks, and an eye to the south of it."""
    rng = np.random.default_rng(8)
    rows = np.arange(129)[:, None]
    z = (2000 - 30.0 * np.abs(rows - 64) + 2 * rng.normal(size=(129, 129))).astype(np.float32)
    t = plain.terrain(z, cell=30)
    x, y = t.grid.xy(64, 128)
    low = View((float(x), float(y) - 1500, 600.0), (float(x), float(y) + 2000, 1000.0), fov_y=70, width=300, height=200)
    return t, low


@pytest.mark.parametrize("term", ["back_facing", "occluded"])
def test_what_is_turned_away_or_hidden_gets_coarser_and_the_rest_stays(term):
    t, view = ridge()
    usual = plain.refiner(Roam, t, cull=False).refine(view, tolerance=0.1)
    method = plain.refiner(Roam, t, cull=False, **{term: 0.0})
    found = method.refine(view, tolerance=0.1)
    assert not verify.judge_mesh(found, t, view).defects and not found.stats["conservative"]

    def beyond(m):
        return int((m.vertices[m.triangles, 1].max(1) < 60).sum())

    assert beyond(found) < 0.6 * beyond(usual)
    near = {c for c in plain.triangles_of(usual) if min(r for _, r in c) > 70}
    assert len(near) > 100 and near <= plain.triangles_of(found)
    carried = plain.refiner(Roam, t, cull=False, **{term: 0.0})
    for k in range(20):
        moved = replace(view, eye=(view.eye[0] + 4 * k, view.eye[1] + 170 * k, view.eye[2] + 150 * k))
        now = carried.refine(moved, tolerance=0.1)
    fresh = plain.refiner(Roam, t, cull=False, deferral=False, **{term: 0.0}).refine(moved, tolerance=0.1)
    assert plain.triangles_of(now) == plain.triangles_of(fresh)
    assert beyond(now) > 2 * beyond(found)  # from higher up the far flank is seen


def test_only_what_is_hidden_is_taken_for_hidden():
    """By rays against the surface: no sample of a triangle that stayed coarse for being hidden is seen."""
    t, view = ridge()
    usual = plain.refiner(Roam, t).refine(view, tolerance=0.1)
    found = plain.refiner(Roam, t, occluded=0.0).refine(view, tolerance=0.1)
    z = t.heights.astype(float)
    col, row = (float(v) for v in t.grid.index(*view.eye[:2]))
    known = plain.triangles_of(usual)
    coarser = [v for v in found.vertices[found.triangles] if frozenset(map(tuple, v[:, :2])) not in known]
    checked = 0
    for corners in coarser:
        for c, r, h in corners:
            s = np.linspace(0, 1, 2000)[1:-1]
            cs, rs = col + s * (c - col), row + s * (r - row)
            on = (cs >= 0) & (cs <= 128) & (rs >= 0) & (rs <= 128)
            above = plain.surface(z, cs[on], rs[on]) - (view.eye[2] + s[on] * (h - view.eye[2]))
            if min(corners[:, 1]) < 55:
                assert above.max() > 0
                checked += 1
    assert checked > 10


def test_ground_turned_away_gets_coarser_wherever_it_lies():
    """Waves, seen from low: their far sides are turned away, and near sides of the same blocks are not."""
    rng = np.random.default_rng(3)
    rows = np.arange(129)[:, None]
    z = 120 * np.cos(rows * 2 * np.pi / 32) + 2 * rng.normal(size=(129, 129))
    t = plain.terrain(z.astype(np.float32), cell=30)
    x, y = (float(v) for v in t.grid.xy(64, 128))
    view = View((x, y - 500, 300.0), (x, y + 4000, 0.0), fov_y=60, width=800, height=600)
    usual = plain.refiner(Roam, t).refine(view, tolerance=0.5)
    found = plain.refiner(Roam, t, back_facing=0.0).refine(view, tolerance=0.5)
    turned, left = (facing(t, mesh, view) for mesh in (usual, found))
    assert (turned == -1).sum() > 1000 and (left == -1).sum() < 0.5 * (turned == -1).sum()
    towards = {frozenset(map(tuple, v[:, :2])) for v in usual.vertices[usual.triangles[turned == 1]]}
    assert len(towards) > 1000 and len(towards & plain.triangles_of(found)) > 0.95 * len(towards)


def test_silhouettes_get_finer_and_only_where_they_can_run():
    rng = np.random.default_rng(9)
    rows, cols = np.mgrid[:129, :129]
    z = 900 * np.exp(-((rows - 64) ** 2 + (cols - 64) ** 2) / 900) + 0.5 * rng.normal(size=(129, 129))
    t, view = plain.terrain(z.astype(np.float32)), ridge()[1]
    usual = plain.refiner(Roam, t, cull=False).refine(view, tolerance=0.4)
    found = plain.refiner(Roam, t, cull=False, silhouette=8.0).refine(view, tolerance=0.4)
    finer = plain.refiner(Roam, t, cull=False).refine(view, tolerance=0.4 / 8)
    assert found.stats["conservative"]
    assert len(usual.triangles) < len(found.triangles) < len(finer.triangles)
    # Along a silhouette some ground faces the eye and some does not: there the mesh is as fine as eight times finer.
    everywhere = plain.triangles_of(finer)
    mixed = facing(t, finer, view) == 0
    there = {frozenset(map(tuple, v[:, :2])) for v in finer.vertices[finer.triangles[mixed]]}
    assert len(there) > 100 and there <= everywhere & plain.triangles_of(found)


def test_ground_out_of_view_is_coarser_by_the_factor():
    rng = np.random.default_rng(6)
    t = plain.terrain(plain.rough(rng, (129, 129)))
    view = plain.random_view(rng, t)
    sizes = []
    for factor in (0.0, 0.5, 1.0):
        carried = plain.refiner(Roam, t, cull=False, outside=factor)
        for k in range(6):
            now = carried.refine(replace(view, eye=(view.eye[0], view.eye[1] + 5 * k, view.eye[2])), tolerance=1)
        fresh = plain.refiner(Roam, t, cull=False, outside=factor, deferral=False).refine(
            replace(view, eye=(view.eye[0], view.eye[1] + 25, view.eye[2])), tolerance=1
        )
        assert plain.triangles_of(now) == plain.triangles_of(fresh)
        assert now.stats["conservative"] and verify.judge_mesh(
            now, t, replace(view, eye=(view.eye[0], view.eye[1] + 25, view.eye[2]))
        ).ok(1.0)
        sizes.append(len(now.triangles))
    assert sizes[0] <= sizes[1] <= sizes[2] > sizes[0]


def test_options_that_make_no_sense_are_refused():
    t = plain.terrain(np.zeros((5, 5), np.float32))
    for options in ({"back_facing": 2.0}, {"occluded": -1}, {"silhouette": 0.5}, {"object_tolerance": -1.0}):
        with pytest.raises(UsageError):
            plain.refiner(Roam, t, **options)
    with pytest.raises(UsageError, match="bound"):
        plain.refiner(Roam, t, error="midpoint", objects=[(1, 1, 1)])
