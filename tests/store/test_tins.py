"""The kernels of TINs against plain ones: who is on a leg, what is farthest off, how far TINs are from the surface."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine

from orograph.geo.grid import Grid
from orograph.hierarchy import diamonds
from orograph.lod.reference import bdam as reference
from orograph.store.memory import MemoryTerrain
from orograph.store.tin_build import Building
from orograph.store.tin_diamonds import Place, Workplace
from orograph.store.tin_greedy import deviation, simplify, worst
from orograph.store.tin_kernels import triangulate
from orograph.store.tin_windows import clipped, in_region, legs_of, look, on_leg
from orograph.store.tins import EDGE, FINER, SQUARE, lattice, octaves

SHAPES = [(65, 65), (40, 61), (70, 33)]


def ground(shape, seed=0) -> MemoryTerrain:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    z = 20 * np.sin(x / 9) * np.cos(y / 7) + rng.normal(0, 2, shape)
    return MemoryTerrain(z.astype(np.float32), Grid(shape, Affine(10, 0, 0, 0, -7, 0), None), "test")


def diamonds_of(t, legs):
    """Those with ground, each with its place."""
    for octave in octaves(t.grid.shape, legs):
        for kind in (diamonds.SQUARE, diamonds.EDGE):
            for at in zip(*Building(t, legs)._diamonds(octave, kind)):
                yield (int(at[0]), int(at[1])), Place(t, int(at[0]), int(at[1]), legs)


def surface_at(z, x, y):
    """The full-resolution surface at a place: cells are cut from their (even, even) to their (odd, odd) corner."""
    j, i = min(int(x), z.shape[1] - 2), min(int(y), z.shape[0] - 2)
    u, v = x - j, y - i
    a, b, c, d = (float(z[i + p, j + q]) for p in (0, 1) for q in (0, 1))
    if (i + j) % 2 == 0:
        return a + u * (b - a) + v * (d - b) if u >= v else a + v * (c - a) + u * (d - c)
    return a + u * (b - a) + v * (c - a) if u + v <= 1 else d + (1 - u) * (c - d) + (1 - v) * (b - d)


def tin(t, at, place, seed=1, chance=0.2):
    """A TIN of random marks: the work, the marks and the heights."""
    heights = place.read(t)
    marks = (np.random.default_rng(seed).random(heights.shape) < chance).astype(np.uint8)
    work = Workplace().room(8, marks)
    assert triangulate(place.window, work, heights, place.ends, marks) > 0
    return work, marks, heights


def corners_of(m):
    """Of triangles in patches: (t, 3, 3) column, row, height in the window."""
    count = int(m.counts[1])
    live = np.flatnonzero(m.live[:count])
    v = m.corner[: 3 * count].reshape(-1, 3)[live]
    return np.stack([m.x[v], m.y[v], m.z[v]], -1).astype(float), live


@pytest.mark.cases(1)
@pytest.mark.parametrize("shape", SHAPES)
def test_regions_and_legs_are_the_reference_s(shape):
    t = ground(shape)
    for at, place in diamonds_of(t, 4):
        w = place.window
        for y in range(w.height + 1):
            for x in range(w.width + 1):
                role = reference.role(at, place.y0 + y, place.x0 + x)
                assert in_region(w, x, y) == (role != "outside"), (at, x, y)
                assert (in_region(w, x, y) and on_leg(w, x, y)) == (role == "locked")


@pytest.mark.parametrize("shape", SHAPES)
def test_edges_end_on_the_raster(shape):
    t = ground(shape)
    for at, place in diamonds_of(t, 4):
        ends = [diamonds.end(*at, k) for k in (0, 1)]
        apexes = [diamonds.apex(*at, k) for k in (0, 1)]
        whole = [ends, *((a, p) for p in apexes for a in ends)]
        wanted = {
            frozenset((c, r) for r, c in reference.samples_between(*edge) if 0 <= r < shape[0] and 0 <= c < shape[1])
            for edge in whole
        }
        got = set()
        for edge in range(5):
            ax, ay, dx, dy, low, high = clipped(place.window, edge)
            got.add(frozenset((place.x0 + ax + k * dx, place.y0 + ay + k * dy) for k in range(low, high + 1)))
        assert got - {frozenset()} == wanted - {frozenset()}, at


@pytest.mark.parametrize("shape", SHAPES)
def test_patches_cover_their_triangles(shape):
    """All that is on the raster of a diamond, once; each patch on its side of the hypotenuse."""
    t = ground(shape)
    for at, place in diamonds_of(t, 4):
        work, _, _ = tin(t, at, place)
        corners, live = corners_of(work.mesh)
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
        assert (area > 0).all()
        middle = corners.mean(1)
        for side in (0, 1):
            mine = work.mesh.live[live] == side + 1
            end, other, apex = diamonds.end(*at, 0), diamonds.end(*at, 1), diamonds.apex(*at, side)

            def turned(p, q, r):
                return (q[1] - p[1]) * (r[0] - p[0]) - (q[0] - p[0]) * (r[1] - p[1])

            sign = np.sign(turned(end, other, apex))
            for x, y in middle[mine][:, :2] + [place.x0, place.y0]:
                assert np.sign(turned(end, other, (y, x))) == sign
        s = place.window.s
        y, x = np.mgrid[place.y0 : place.y1, place.x0 : place.x1]
        inside = 0.0  # (the area by halves of cells, whose middles are a third from the corners)
        for u, v in ((1 / 3, 2 / 3), (2 / 3, 1 / 3)) if diamonds.kind(*at) == diamonds.SQUARE else ():
            inside += 0.5 * ((abs(x + u - at[1]) < s) & (abs(y + v - at[0]) < s)).sum()
        if diamonds.kind(*at) == diamonds.EDGE:
            fine = (np.arange(8) + 0.5) / 8
            for v in fine:
                for u in fine + 1e-9:
                    inside += (abs(x + u - at[1]) + abs(y + v - at[0]) < s).sum() / 64
        assert area.sum() == pytest.approx(inside, rel=0.08, abs=1.0)


@pytest.mark.cases(1)
@pytest.mark.parametrize("shape", SHAPES)
def test_deviation_is_that_of_the_surface(shape):
    """Brute force over a fine net of places on each triangle's edges and at all samples; never more than is told."""
    t, z = ground(shape), ground(shape).heights
    for number, (at, place) in enumerate(diamonds_of(t, 8)):
        if number % 4:
            continue
        work, _, _ = tin(t, at, place, seed=number)
        told = deviation(work.mesh, np.ascontiguousarray(z[place.y0 : place.y1 + 1, place.x0 : place.x1 + 1]), -1.0)
        largest = 0.0
        for a, b, c in corners_of(work.mesh)[0]:
            for p, q in ((a, b), (b, c), (c, a)):
                for f in np.linspace(0, 1, 1 + 8 * int(max(abs(q - p)[:2]))):
                    x, y, h = p + f * (q - p)
                    largest = max(largest, abs(h - surface_at(z, x + place.x0, y + place.y0)))
            low, high = np.floor(np.min([a, b, c], 0)).astype(int), np.max([a, b, c], 0).astype(int)
            det = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
            for y in range(low[1], high[1] + 1):
                for x in range(low[0], high[0] + 1):
                    u = ((x - a[0]) * (c - a)[1] - (y - a[1]) * (c - a)[0]) / det
                    v = ((b - a)[0] * (y - a[1]) - (b - a)[1] * (x - a[0])) / det
                    if min(u, v, 1 - u - v) >= -1e-9:
                        h = a[2] + u * (b - a)[2] + v * (c - a)[2]
                        largest = max(largest, abs(h - z[y + place.y0, x + place.x0]))
        assert largest <= told * (1 + 1e-9) and told <= largest * 1.1 + 1e-6


@pytest.mark.stress
def test_the_worst_sample_of_a_triangle():
    t = ground((200, 180))
    for number, (at, place) in enumerate(diamonds_of(t, 4)):
        if number % 7:
            continue
        work, _, heights = tin(t, at, place, seed=number, chance=0.03)
        w, free = place.window, (np.random.default_rng(number).random(heights.shape) < 0.7).astype(np.uint8)
        candidates, shift = np.where(free > 0, heights, np.float32(np.nan)), w.step.bit_length() - 1
        rows, cols = heights.shape
        y, x = np.minimum(np.arange(rows) * w.step, w.height), np.minimum(np.arange(cols) * w.step, w.width)
        X, Y = np.meshgrid(x, y)
        for (a, b, c), u in zip(*corners_of(work.mesh)):
            off, i, j = worst(w, shift, 1, work.mesh, candidates, u)
            det = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
            p = ((X - a[0]) * (c - a)[1] - (Y - a[1]) * (c - a)[0]) / det
            q = ((b - a)[0] * (Y - a[1]) - (b - a)[1] * (X - a[0])) / det
            inside = (np.minimum(np.minimum(p, q), 1 - p - q) >= -1e-9) & (free > 0)
            deviations = np.where(inside, abs(a[2] + p * (b - a)[2] + q * (c - a)[2] - heights), 0.0)
            assert off == pytest.approx(deviations.max(), abs=1e-6)
            if off > 1e-6:
                assert deviations[i, j] == pytest.approx(off, abs=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_simplifying_inserts_and_moves_nothing_on_legs(shape):
    t = ground(shape)
    for at, place in diamonds_of(t, 4):
        heights = place.read(t)
        marks, every = np.zeros(heights.shape, np.uint8), np.zeros((2, 2), np.uint8)
        legs_of(place.window, every, 1, 0, marks)
        before = marks.copy()
        work = Workplace().room(4, marks)
        count, off = simplify(place.window, work, heights, place.ends, marks, 400, 0.5)
        assert count > 0 and (marks >= before).all()
        step, free = place.window.step, np.argwhere(marks > before)
        for i, j in free:
            row, col = min(place.y0 + i * step, place.y1), min(place.x0 + j * step, place.x1)
            assert reference.role(at, row, col) in ("free", "along")
        a, b, c = corners_of(work.mesh)[0][:, :, :2].transpose(1, 2, 0)
        area = ((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]).sum()
        wanted = 400 * area / ((8 if place.window.shape == 0 else 4) * place.window.s**2)
        assert off <= 0.5 or count >= wanted


@pytest.mark.parametrize("shape", SHAPES)
def test_the_mesh_of_the_insertion_is_that_of_its_marks(shape):
    """So it need not be made again, and what is known of its error is that of what will be drawn."""
    z = ground(shape).heights.copy()
    z[5:40, 3:30] = np.round(z[5:40, 3:30])  # many samples at the same distance
    t = MemoryTerrain(z, ground(shape).grid, "test")

    def drawn(m):
        return {frozenset(zip(c[:, 0].tolist(), c[:, 1].tolist())) for c in corners_of(m)[0]}

    for at, place in diamonds_of(t, 4):
        heights, w = place.read(t), place.window
        full = np.ascontiguousarray(t.heights[place.y0 : place.y1 + 1, place.x0 : place.x1 + 1])
        for wanted in (40, 200):
            marks = np.zeros(heights.shape, np.uint8)
            legs_of(w, np.zeros((2, 2), np.uint8), 1, 0, marks)
            work = Workplace().room(4, marks)
            _, off = simplify(w, work, heights, place.ends, marks, wanted, 0.1)
            ours, told = drawn(work.mesh), deviation(work.mesh, full, off if w.step == 1 else -1.0)
            assert told == pytest.approx(deviation(work.mesh, full, -1.0), abs=1e-9)
            triangulate(w, work, heights, place.ends, marks)
            assert drawn(work.mesh) == ours, at


@pytest.mark.stress
def test_greedy_insertion_begins_where_the_reference_s_does():
    t = ground((65, 65))
    for at, place in diamonds_of(t, 4):
        heights, w, s = place.read(t), place.window, place.window.s
        if min(at) - s < 0 or max(at) + s > 64:
            continue
        given = np.zeros(heights.shape, np.uint8)
        legs_of(w, np.zeros((2, 2), np.uint8), 1, 0, given)
        work = Workplace().room(4, given)
        y, x = np.mgrid[: heights.shape[0], : heights.shape[1]]
        role = {
            (i, j): reference.role(at, place.y0 + i * w.step, place.x0 + j * w.step) for i, j in np.ndindex(x.shape)
        }

        def marked(points):
            marks = np.zeros(heights.shape, np.uint8)  # noqa: B023
            marks[tuple(np.array(sorted(points)).T)] = 1
            return triangulate(w, work, heights, place.ends, marks)  # noqa: B023

        def errors(points):
            marked(points)
            off = {}
            for a, b, c in corners_of(work.mesh)[0]:  # noqa: B023
                det = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
                p = ((x * w.step - a[0]) * (c - a)[1] - (y * w.step - a[1]) * (c - a)[0]) / det  # noqa: B023
                q = ((b - a)[0] * (y * w.step - a[1]) - (b - a)[1] * (x * w.step - a[0])) / det  # noqa: B023
                plane = a[2] + p * (b - a)[2] + q * (c - a)[2]
                for i, j in np.argwhere(np.minimum(np.minimum(p, q), 1 - p - q) >= -1e-9):
                    sparse = (w.first_i + i) % w.sparse == 0 and (w.first_j + j) % w.sparse == 0  # noqa: B023
                    if role[i, j] == "free" or (role[i, j] == "along" and sparse):  # noqa: B023
                        off[i, j] = max(off.get((i, j), 0.0), abs(plane[i, j] - heights[i, j]))  # noqa: B023
            return off

        points = {(int(i), int(j)) for i, j in np.argwhere(given)}
        size = marked(points)
        wanted = reference.simplified(size + 1, errors, points, marked)
        marks = given.copy()
        assert simplify(w, work, heights, place.ends, marks, size + 1, 1e-6)[0] == size + 2
        assert {(int(i), int(j)) for i, j in np.argwhere(marks)} == wanted


def test_what_is_missing_is_counted():
    z = ground((60, 50)).heights.copy()
    z[np.random.default_rng(2).random(z.shape) < 0.1] = np.nan
    rows, cols, s = np.array([8, 24, 48, 16, 64]), np.array([0, 16, 40, 56, 8]), 8
    count, squares = look(z, 0, rows, cols, s, np.full(5, -3.0), np.array([10.0, 0.0, 0.0, -7.0]))
    for d, (r, c) in enumerate(zip(rows, cols)):
        y, x = np.mgrid[:60, :50]
        here = abs(y - r) + abs(x - c) <= s
        there = here & ~np.isnan(z)
        assert count[d].tolist() == [there.sum(), (here & np.isnan(z)).sum()]
        i, j = min(r, 59), min(c, 49)
        height = -3.0 if np.isnan(z[i, j]) else z[i, j]
        away = (10.0 * (x - j)) ** 2 + (7.0 * (y - i)) ** 2 + (z - height) ** 2
        assert squares[d] == pytest.approx(away[there].max(initial=0.0), rel=1e-6)


def test_lattices():
    assert (SQUARE, EDGE) == (1, 2)
    for side in (2049, 4097):
        for octave in octaves((side, side), 16):
            k = lattice((side, side), octave, 16)
            assert (2 << octave) >> k <= 256 and (k == 0 or (2 << octave) >> k >= 16 << (FINER + 1))
