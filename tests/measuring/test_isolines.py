"""Contour lines as vectors, against matplotlib's on the same triangles, a plain march, and known surfaces."""

from __future__ import annotations

import itertools
from collections import Counter

import numpy as np
import pytest
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st

import orograph
from orograph.geo.grid import Grid
from orograph.measuring.isolines import Lines, isolines

UTM = "EPSG:32611"


def ground(heights, transform=None, crs=UTM):
    heights = np.asarray(heights, np.float32)
    return orograph.terrain(
        orograph.Dem(heights, Grid(heights.shape, transform or Affine(1, 0, -0.5, 0, -1, 0.5), crs))
    )


def traced(terrain, levels, **options) -> Lines:
    (found,) = isolines(terrain, np.asarray(levels, np.float64), **options)
    return found


def split(lines: Lines):
    return np.split(lines.points, lines.offsets[1:-1])


def triangles(shape):
    """Corners (row, col) of the surface's triangles, cells are cut from (even, even) to (odd, odd)."""
    for r in range(shape[0] - 1):
        for c in range(shape[1] - 1):
            if (r + c) % 2 == 0:
                yield (r, c), (r, c + 1), (r + 1, c + 1)
                yield (r, c), (r + 1, c + 1), (r + 1, c)
            else:
                yield (r, c), (r, c + 1), (r + 1, c)
                yield (r, c + 1), (r + 1, c + 1), (r + 1, c)


def plain(heights, level):
    """All pieces of a level's lines, triangle by triangle: pairs of places (col, row) that differ."""
    found = Counter()
    for corners in triangles(heights.shape):
        h = [float(heights[p]) for p in corners]
        if any(np.isnan(h)):
            continue
        ends = []
        for (p, a), (q, b) in ((x, y) for i, x in enumerate(zip(corners, h)) for y in list(zip(corners, h))[i + 1 :]):
            if (a > level) != (b > level):
                t = (level - a) / (b - a)
                ends.append((round(p[1] + t * (q[1] - p[1]), 9) + 0.0, round(p[0] + t * (q[0] - p[0]), 9) + 0.0))
        if len(ends) == 2 and ends[0] != ends[1]:
            found[frozenset(ends)] += 1
    return found


def pieces(lines):
    """The same of lines."""
    found = Counter()
    for line in lines:
        places = [(round(x, 9) + 0.0, round(-y, 9) + 0.0) for x, y in line.tolist()]
        found.update(map(frozenset, itertools.pairwise(places)))
    return found


def same(a: Lines, b: Lines) -> bool:
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in ("points", "offsets", "level"))


@pytest.mark.stress
@settings(max_examples=60, deadline=None)
@given(st.integers(2, 9), st.integers(2, 9), st.integers(0, 2**32 - 1), st.sampled_from([2, 3, 4, 5]))
def test_pieces_are_those_of_a_plain_march(rows, cols, seed, side):
    rng = np.random.default_rng(seed)
    heights = rng.integers(0, 5, (rows, cols)).astype(np.float32) + rng.choice([0.0, 0.25], (rows, cols))
    heights[rng.random((rows, cols)) < 0.1] = np.nan
    if np.isnan(heights).all():
        return
    terrain = ground(heights)
    every = list(isolines(terrain, np.array([1.0, 2.25, 3.5])))
    for k, level in enumerate((1.0, 2.25, 3.5)):
        expected = plain(heights.astype(np.float64), level)
        found = pieces([one for batch in every for one, own in zip(split(batch), batch.level) if own == k])
        # What lies at just that height may be a ring of two places, out and back on one piece: it is no line.
        assert expected - found == Counter({piece: 2 for piece in expected if piece not in found})
        assert not found - expected
    again = list(isolines(terrain, np.array([1.0, 2.25, 3.5]), side=side, jobs=2))
    assert len(again) == len(every) and all(same(a, b) for a, b in zip(every, again))


def test_lines_are_matplotlibs_on_the_same_triangles():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.tri import Triangulation

    rng = np.random.default_rng(3)
    y, x = np.mgrid[:41, :57]
    heights = (100 + 30 * np.sin(x / 6) * np.cos(y / 5) + rng.normal(0, 2, x.shape)).astype(np.float32)
    levels = [80.0, 95.5, 100.0, 120.25]
    index = {(r, c): r * 57 + c for r in range(41) for c in range(57)}
    faces = [[index[p] for p in corners] for corners in triangles(heights.shape)]
    tri = Triangulation(x.ravel(), -y.ravel(), faces)
    peer = pyplot.figure().add_subplot().tricontour(tri, heights.ravel().astype(np.float64), levels=levels)
    found = traced(ground(heights), levels)

    def length(line):
        return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())

    for k in range(len(levels)):
        theirs = sorted(length(line) for line in peer.allsegs[k])
        ours = sorted(length(line) for line, own in zip(split(found), found.level) if own == k)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)


@pytest.mark.parametrize(
    "transform", [Affine(10, 0, 500_000, 0, -10, 4e6), Affine(20, 0, 5e5, 0, 10, 4e6), Affine(8, 6, 5e5, 6, -8, 4e6)]
)
def test_a_cone_has_circles_with_higher_ground_on_their_left(transform):
    """Circles of a cone's heights, in true metres whatever the cells: radius and turn are known."""
    grid = Grid((121, 131), transform, UTM)
    row, col = np.mgrid[:121, :131]
    x, y = grid.xy(col, row)
    x0, y0 = grid.xy(65.3, 60.2)
    heights = (1000 - np.hypot(x - x0, y - y0)).astype(np.float32)
    lines = traced(orograph.terrain(orograph.Dem(heights, grid)), [600.0, 700.0, 900.0])
    assert len(lines) == 3 and list(lines.level) == [0, 1, 2]
    for line, level in zip(split(lines), (600, 700, 900)):
        assert np.array_equal(line[0], line[-1])
        radius = np.hypot(line[:, 0] - x0, line[:, 1] - y0)
        assert np.abs(radius - (1000 - level)).max() < 3.0  # chords of a cone over cells of up to 20 m
        u, v = line[:-1] - [x0, y0], line[1:] - [x0, y0]
        area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()
        assert area == pytest.approx(np.pi * (1000 - level) ** 2, rel=0.02)  # positive: counter-clockwise


def test_a_lake_at_just_a_level_has_its_shore():
    y, x = np.mgrid[:21, :21]
    heights = np.maximum(np.hypot(x - 10, y - 10), 5.0)
    lines = traced(ground(heights), [5.0])
    assert len(lines) == 1 and np.array_equal(lines.points[0], lines.points[-1])
    assert traced(ground(20 - heights), [14.0]).level.size == 1
    assert not list(isolines(ground(np.full((9, 9), 5.0)), np.array([5.0])))


def test_missing_ground_ends_lines():
    heights = np.repeat(np.arange(9.0)[None], 12, 0)
    heights[5:7, 4] = np.nan
    lines = split(traced(ground(heights), [3.5]))
    assert len(lines) == 2 and all(not np.array_equal(one[0], one[-1]) for one in lines)
    rows = sorted(tuple(sorted((-one[0][1], -one[-1][1]))) for one in lines)
    assert rows[0][0] == 0 and rows[1][1] == 11 and rows[0][1] <= 5 and rows[1][0] >= 6


def test_one_row_has_no_lines():
    assert not list(isolines(ground(np.arange(9.0)[None]), np.array([3.5])))


def distance(points, line):
    """Of points (n, 2) from the nearest stretch of a line (k, 2)."""
    a, b = line[:-1], line[1:]
    step = b - a
    t = np.clip(((points[:, None] - a) * step).sum(-1) / np.maximum((step**2).sum(-1), 1e-300), 0, 1)
    return np.linalg.norm(points[:, None] - (a + t[..., None] * step), axis=-1).min(1)


@pytest.mark.stress
def test_simplified_lines_keep_the_bound_and_their_rings():
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:90, :90]
    heights = 50 * np.sin(x / 9) * np.cos(y / 7) + rng.normal(0, 3, x.shape)
    terrain = ground(heights)
    whole, simple = traced(terrain, [-10.0, 0.0, 20.0]), traced(terrain, [-10.0, 0.0, 20.0], simplify=1.5, side=16)
    assert len(whole) == len(simple) and len(simple.points) < 0.5 * len(whole.points)
    for long, short in zip(split(whole), split(simple)):
        assert distance(long, short).max() <= 1.5 + 1e-9
        assert np.array_equal(long[0], short[0]) and np.array_equal(long[-1], short[-1])
        if np.array_equal(long[0], long[-1]):
            assert len({tuple(p) for p in short.tolist()}) >= 3


def test_levels_that_do_not_fit_are_traced_one_after_the_other():
    y, x = np.mgrid[:70, :80]
    terrain = ground(40 * np.sin(x / 9) * np.cos(y / 7))
    levels = np.arange(-35.0, 40.0, 5.0)
    whole = traced(terrain, levels)
    parts = list(isolines(terrain, levels, max_memory=100_000, side=32, jobs=2))
    assert len(parts) > 3
    assert np.array_equal(np.concatenate([p.points for p in parts]), whole.points)
    assert np.array_equal(np.concatenate([p.level for p in parts]), whole.level)
    assert np.array_equal(np.concatenate([np.diff(p.offsets) for p in parts]), np.diff(whole.offsets))
