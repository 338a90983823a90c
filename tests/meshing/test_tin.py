"""TINs: their parts against brute force, the whole against the referee."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from click.testing import CliRunner
from pyproj import CRS
from tin_truth import (
    can_be_filled,
    fewest,
    in_circle,
    referee,
    terrain_of,
    turn,
    worst_at_samples,
    worst_on_edge,
)

import orograph
from orograph.cli import cli
from orograph.errors import NothingInViewError, UsageError
from orograph.geo import Grid
from orograph.meshing import tin as tins
from orograph.meshing import tin_outline, tin_tile
from orograph.tessellation import Tessellation
from orograph.triangulation import deviation, mesh

MAPS = [Affine(10, 0, 0, 0, -10, 0), Affine(10, 0, 0, 0, 10, 0), Affine(6, 8, 500, 8, -6, 300)]


def hills(shape: tuple[int, int], seed: int, noise: float = 1.0) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]]
    rough = np.random.default_rng(seed).normal(0, noise, shape)
    return (20 * np.sin(x / 7) * np.cos(y / 9) + rough).astype(np.float32)


def with_holes(heights: np.ndarray, seed: int, part: float) -> np.ndarray:
    heights = heights.copy()
    heights[np.random.default_rng(seed).random(heights.shape) < part] = np.nan
    heights[9:24, 11:50] = np.nan
    return heights


def triangulated(heights: np.ndarray, points: list[tuple[int, int]]) -> mesh.Mesh:
    m = mesh.new_mesh(*heights.shape)
    mesh.begin(m, heights)
    tin_tile.insert_all(m, heights, np.array(points, np.int64).reshape(-1, 2))
    return m


def corners_of(m: mesh.Mesh) -> list[tuple[tuple[int, int], ...]]:
    found = m.corner[: 3 * m.counts[mesh.TRIANGLES]].reshape(-1, 3)
    return [tuple((int(m.x[v]), int(m.y[v])) for v in t) for t in found if t[0] >= 0]


@pytest.mark.parametrize("seed", range(6))
def test_insertion_is_delaunay_and_takes_the_surface_own_diagonals(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heights = hills((9, 12), seed)
    points = [(int(k % 12), int(k // 12)) for k in rng.permutation(108)[: (20, 60, 108)[seed % 3]]]
    found = corners_of(triangulated(heights, points))
    vertices = {p for t in found for p in t}
    assert vertices >= set(points)
    assert sum(turn(*t) for t in found) == 2 * 8 * 11 and min(turn(*t) for t in found) > 0
    assert all(in_circle(*t, p) <= 0 for t in found for p in vertices)
    units = [t for t in found if turn(*t) == 1]
    for t in units:
        odd = [p for p in t if sum(p) % 2]
        cell = {(x, y) for x in {p[0] for p in t} for y in {p[1] for p in t}}
        if len(cell) == 4 and cell <= vertices:
            assert len(odd) == 1, t  # the diagonal joins the two even ones


@pytest.mark.parametrize("seed", range(8))
def test_forced_edges_are_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heights = hills((40, 40), seed)
    points = [(int(x), int(y)) for x, y in rng.integers(0, 40, (80, 2))]
    m = triangulated(heights, points)
    vertices = sorted({p for t in corners_of(m) for p in t})
    forced: list[tuple[tuple[int, int], tuple[int, int]]] = []
    for i, j in rng.integers(0, len(vertices), (60, 2)):
        a, b = vertices[i], vertices[j]
        between = [p for p in vertices if turn(a, b, p) == 0 and p not in (a, b) and _within(a, b, p)]
        if a != b and not between and not any(_cross(a, b, *edge) for edge in forced):
            forced.append((a, b))
    assert len(forced) > 10
    assert tin_tile.fix_all(m, np.array([[*a, *b] for a, b in forced]))
    mesh.make_delaunay(m)
    found = corners_of(m)
    edges = {frozenset((t[k], t[(k + 1) % 3])) for t in found for k in range(3)}
    assert all(frozenset(edge) in edges for edge in forced)
    assert sum(turn(*t) for t in found) == 2 * 39 * 39 and min(turn(*t) for t in found) > 0
    apex: dict[frozenset, list] = {}
    for t in found:
        for k in range(3):
            apex.setdefault(frozenset((t[k], t[(k + 1) % 3])), []).append((t, t[(k + 2) % 3]))
    for edge, sides in apex.items():  # constrained Delaunay: all other edges locally
        if len(sides) == 2 and edge not in {frozenset(f) for f in forced}:
            assert in_circle(*sides[0][0], sides[1][1]) <= 0


def _within(a, b, p) -> bool:
    return min(a[0], b[0]) <= p[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= p[1] <= max(a[1], b[1])


def _cross(a, b, c, d) -> bool:
    if {a, b} & {c, d}:
        return {a, b} == {c, d} or (turn(a, b, c) == 0 == turn(a, b, d))
    return turn(a, b, c) * turn(a, b, d) <= 0 and turn(c, d, a) * turn(c, d, b) <= 0


@pytest.mark.parametrize("seed", range(25))
def test_the_worst_of_triangles_and_edges_is_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heights = hills((14, 17), seed, 5)
    points = [(int(x), int(y)) for x, y in zip(rng.integers(0, 17, 3), rng.integers(0, 14, 3))]
    if turn(*points) == 0:
        return
    m = mesh.new_mesh(14, 17)
    a, b, c = (mesh.new_vertex(m, x, y, float(heights[y, x])) for x, y in points)
    off, squares = worst_at_samples(heights, tuple(points))
    assert deviation.worst_sample(heights, m, a, b, c)[0] == pytest.approx(off, abs=1e-9)
    for limit, most in ((np.inf, np.inf), (1.01 * off, 1.01 * squares), (0.99 * off, np.inf), (np.inf, 0.99 * squares)):
        within = (off <= limit and squares < most) or off == 0
        found = deviation.squares_within(heights, m, a, b, c, limit, most)
        assert found == pytest.approx(squares if within else np.inf, abs=1e-9)
    off = deviation.worst_crossing(heights, m, a, b)[0]
    inner = [(x, y) for x in range(17) for y in range(14) if turn(points[0], points[1], (x, y)) == 0]
    truth = worst_on_edge(heights, points[0], points[1])
    on_it = [_off(heights, points[0], points[1], p) for p in inner if _within(*points[:2], p)]
    assert max(off, *on_it) == pytest.approx(truth, abs=1e-9)


def _off(heights, a, b, p) -> float:
    """How far an edge is from a sample on it."""
    t = (p[0] - a[0]) / (b[0] - a[0]) if a[0] != b[0] else (p[1] - a[1]) / (b[1] - a[1])
    za, zb = float(heights[a[1], a[0]]), float(heights[b[1], b[0]])
    return abs(za + t * (zb - za) - float(heights[p[1], p[0]]))


@pytest.mark.parametrize("part", [0.0, 0.1, 0.5])
def test_edges_are_counted_at_their_starts(part: float) -> None:
    heights = np.where(np.random.default_rng(7).random((12, 15)) < part, np.nan, 0).astype(np.float32)
    units = tin_outline.unit_triangles(heights)
    counts = np.zeros((12, 15, 4), np.int64)
    for i, j in np.ndindex(11, 14):
        nw, ne, sw, se = (i, j), (i, j + 1), (i + 1, j), (i + 1, j + 1)
        halves = ((nw, ne, se), (nw, se, sw)) if (i + j) % 2 == 0 else ((nw, ne, sw), (ne, se, sw))
        for half, exists in zip(halves, units[i, j]):
            assert exists == (not any(np.isnan(heights[p]) for p in half))
            for p, q in {tuple(sorted((a, b))) for a in half for b in half if a != b} if exists else ():
                way = q[0] - p[0], q[1] - p[1]
                counts[p][[(0, 1), (1, 0), (1, 1), (1, -1)].index(way)] += 1
    ground, outline = tin_outline.edges_of(units)
    assert (ground == (counts > 0) @ tin_outline.BITS).all() and (outline == (counts == 1) @ tin_outline.BITS).all()


@pytest.mark.parametrize("seed", range(20))
def test_a_run_keeps_the_fewest_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = int(rng.integers(2, 12))
    line, limit = rng.normal(0, 1, size).cumsum(), float(rng.uniform(0.05, 1.5))
    cost, origin = np.empty(size, np.int64), np.empty(size, np.int64)
    tin_outline.simplify(line, size, limit, cost, origin)
    kept = [size - 1]
    while kept[-1]:
        kept.append(int(origin[kept[-1]]))
    assert np.abs(np.interp(np.arange(size), kept[::-1], line[kept[::-1]]) - line).max() <= limit
    assert len(kept) == fewest(line, limit)


@pytest.mark.parametrize("bound", ["samples", "surface"])
@pytest.mark.parametrize("holes", [None, 0.0, 0.003, 0.05, 0.4])
def test_the_referee_finds_nothing_wrong(bound: tins.Bound, holes: float | None) -> None:
    for seed, (shape, limit) in enumerate([((75, 90), 0.5), ((70, 97), 3.0), ((66, 66), 1e9), ((35, 60), 0.0)]):
        heights = hills(shape, seed)
        heights = heights if holes is None else with_holes(heights, seed, holes)
        terrain = terrain_of(heights, MAPS[seed % 3])
        mesh = tins.tin(terrain, limit, bound=bound, side=32)
        report, largest, at_samples = referee(mesh, terrain)
        assert report.defects == {}
        assert (mesh.stats["largest"], mesh.stats["largest_at_samples"]) == pytest.approx(
            (largest, at_samples), abs=1e-4
        )
        assert (largest if bound == "surface" else at_samples) <= limit + 1e-4
        assert mesh.stats["largest" if bound == "surface" else "largest_at_samples"] <= max(limit, 1e-7)


def test_samples_alone_are_no_bound_on_the_surface() -> None:
    """What the bound on the surface is for: a city's walls."""
    heights = np.where(np.random.default_rng(3).random((64, 64)) < 0.3, 30, 0).astype(np.float32)
    mesh = tins.tin(terrain_of(heights), 1.0, bound="samples")
    assert mesh.stats["largest_at_samples"] <= 1 < 10 < mesh.stats["largest"]


@pytest.mark.cases(1)
@pytest.mark.parametrize("bound", ["samples", "surface"])
def test_no_vertex_can_be_spared(bound: tins.Bound) -> None:
    heights, limit = hills((24, 30), 5, 2.0), 4.0
    mesh = tins.tin(terrain_of(heights, MAPS[1]), limit, bound=bound)
    places = [(int(x), int(y)) for x, y in mesh.vertices[:, :2]]
    following: list[dict] = [{} for _ in places]
    for t in mesh.triangles:
        for k in range(3):
            following[t[k]][t[(k + 1) % 3]] = t[(k + 2) % 3]
    tried = 0
    for v, after in enumerate(following):
        x, y = places[v]
        if x in (0, 29) or y in (0, 23) or len(after) > 9:
            continue
        ring = [next(iter(after))]
        while after[ring[-1]] != ring[0]:
            ring.append(after[ring[-1]])
        tried += 1
        assert not can_be_filled(heights, [places[u] for u in ring], limit - 1e-9, bound == "surface")
    assert tried > 20


def test_tiles_do_not_depend_on_workers_or_memory() -> None:
    terrain = terrain_of(with_holes(hills((150, 170), 2), 2, 0.01))
    one = tins.tin(terrain, 1.0, jobs=1, side=32)
    for many in (tins.tin(terrain, 1.0, jobs=5, side=32), tins.tin(terrain, 1.0, jobs=3, max_memory=1 << 20, side=32)):
        assert (one.vertices == many.vertices).all() and (one.triangles == many.triangles).all()


def test_neighbours_know_the_same_border(monkeypatch: pytest.MonkeyPatch) -> None:
    """A border is refined where the bound on the surface needs it, and both sides come to know."""
    shared: list[int] = []
    plain = tins.share
    monkeypatch.setattr(tins, "share", lambda missed, *more: (shared.append(len(missed)), plain(missed, *more))[1])
    y, x = np.mgrid[:65, :65]
    heights = np.where((x % 32 == 1) | (y % 32 == 1), 100 * ((x + y) % 3), 0).astype(np.float32)
    terrain = terrain_of(heights)
    mesh = tins.tin(terrain, 1.0, side=32)
    report, largest, _ = referee(mesh, terrain)
    assert max(shared) > 0 and shared[-1] == 0
    assert report.defects == {} and largest <= 1 + 1e-4


@pytest.mark.parametrize("bound", ["samples", "surface"])
@pytest.mark.parametrize("seed", range(5))
def test_break_lines_are_edges(bound: tins.Bound, seed: int) -> None:
    rng = np.random.default_rng(seed)
    heights = hills((70, 97), seed)
    if seed >= 2:
        heights = with_holes(heights, seed, 0.002)
    terrain = terrain_of(heights, MAPS[seed % 3])
    lines = [rng.uniform(-8, 100, (int(rng.integers(1, 5)), 2)) for _ in range(9)]
    mesh = tins.tin(terrain, 4.0, bound=bound, lines=lines, side=32)
    report, largest, at_samples = referee(mesh, terrain)
    assert report.defects == {}
    assert (largest if bound == "surface" else at_samples) <= 4 + 1e-4
    assert (mesh.stats["largest"], mesh.stats["largest_at_samples"]) == pytest.approx((largest, at_samples), abs=1e-4)
    edges = {(int(a), int(b)) for t in mesh.triangles for a, b in zip(t, np.roll(t, -1))}
    ends = mesh.vertices[:, :2]
    middles = np.concatenate(
        [(ends[a] + t * (ends[b] - ends[a]))[None] for a, b in edges for t in np.linspace(0, 1, 9)]
    )
    exist = ~np.isnan(np.pad(heights, 3, mode="edge"))
    for line in lines:
        for a, b in pairwise(line) if len(line) > 1 else [(line[0], line[0])]:
            for t in np.linspace(0, 1, 60):
                x, y = a + t * (b - a)
                if not (0 <= x <= 96 and 0 <= y <= 69):
                    continue
                if exist[int(y) : int(y) + 7, int(x) : int(x) + 7].all():  # away from holes a line is followed closely
                    near = ends if len(line) == 1 else middles
                    assert np.hypot(*(near - [x, y]).T).min() < 1.6
    again = tins.tin(terrain, 4.0, bound=bound, lines=lines, side=32, jobs=1)
    assert (again.vertices == mesh.vertices).all() and (again.triangles == mesh.triangles).all()


CROWDED = 1250, 1954
"""A line whose part exceeded the bound, and lines that were split again and again at the same samples."""


@pytest.mark.parametrize("seeds", [[*range(40), *CROWDED], pytest.param(range(40, 1000), marks=pytest.mark.stress)])
def test_whatever_the_ground_the_lines_and_the_tiles(seeds: Sequence[int]) -> None:
    for seed in seeds:
        rng = np.random.default_rng(seed)
        shape = int(rng.integers(2, 90)), int(rng.integers(2, 90))
        heights = hills(shape, seed, float(rng.choice([0.1, 1, 5])))
        if seed % 2:
            heights = with_holes(heights, seed, float(rng.choice([0, 0.003, 0.03, 0.2])))
        places = int(rng.choice([0, 3]))
        lines = [rng.uniform(-3, 92, (rng.integers(1, 4), 2)).round(places) for _ in range(rng.choice([0, 3, 20, 60]))]
        limit, side = float(rng.choice([0, 0.5, 3, 20])), int(rng.choice([16, 32, 64]))
        terrain, bound = terrain_of(heights), ("samples", "surface")[int(rng.integers(2))]
        try:
            mesh = tins.tin(terrain, limit, bound=bound, lines=lines, side=side)
        except NothingInViewError:
            assert min(shape) < 60  # all of it may be a hole
            continue
        report, largest, at_samples = referee(mesh, terrain)
        assert report.defects == {}, seed
        assert (largest if bound == "surface" else at_samples) <= limit + 1e-4, seed
        assert (mesh.stats["largest"], mesh.stats["largest_at_samples"]) == pytest.approx(
            (largest, at_samples), abs=1e-4
        )


def test_a_break_line_alone_is_kept_to_the_sample() -> None:
    mesh = tins.tin(terrain_of(np.zeros((40, 40), np.float32)), 1.0, lines=[np.array([[3, 5], [30, 21.0]])])
    places = [tuple(v) for v in mesh.vertices[:, :2].astype(int)]
    edges = {frozenset((places[a], places[b])) for t in mesh.triangles for a, b in zip(t, np.roll(t, -1))}
    assert len(places) == 6 and frozenset({(3, 5), (30, 21)}) in edges


def test_a_plane_takes_two_triangles_a_tile() -> None:
    y, x = np.mgrid[:65, :129]
    mesh = tins.tin(terrain_of((3 * x - 2 * y + 7).astype(np.float32)), 0.0, side=64)
    assert len(mesh.triangles) == 4 and mesh.stats["largest"] < 1e-7


@pytest.mark.parametrize("triangles", [40, 700, 5000])
def test_a_budget_is_kept_and_used(triangles: int) -> None:
    terrain = terrain_of(hills((120, 120), 1))
    mesh = tins.tin_of_size(terrain, triangles)
    assert 0.9 * triangles <= len(mesh.triangles) <= triangles
    report, largest, _ = referee(mesh, terrain)
    assert report.defects == {} and largest <= mesh.stats["max_error"] * (1 + 1e-4)


def test_fewer_triangles_than_delatin(real_ground: tuple[np.ndarray, np.ndarray]) -> None:
    delatin = pytest.importorskip("pydelatin")
    heights = np.ascontiguousarray(real_ground[0])
    for limit in (2.0, 5.0, 15.0):
        mesh = tins.tin(terrain_of(heights), limit, bound="samples")
        assert len(mesh.triangles) <= 0.9 * len(delatin.Delatin(heights, max_error=limit).triangles)


def test_the_verb_and_the_function_are_the_same(tmp_path: Path) -> None:
    heights = with_holes(hills((80, 90), 4), 4, 0.0)
    dem = orograph.Dem(heights, terrain_of(heights).grid, name="hills")
    path = tmp_path / "hills.npy.tif"
    orograph.export(dem, path, progress=False)
    out = tmp_path / "a.npz"
    ran = CliRunner().invoke(
        cli, ["tin", str(path), "--max-error", "2", "-o", str(out), "--json"], obj={}, catch_exceptions=False
    )
    assert ran.exit_code == 0, ran.output
    told, mesh = json.loads(ran.stdout), orograph.tin(dem, max_error=2, output=tmp_path / "a.ply", progress=False)
    saved = Tessellation.load(out)
    assert (saved.vertices == mesh.vertices).all() and (saved.triangles == mesh.triangles).all()
    assert told["triangles"] == len(mesh.triangles) and told["largest"] == mesh.stats["largest"] <= 2
    assert (tmp_path / "a.ply").read_bytes()[:3] == b"ply"
    for wrong in ({}, {"max_error": 1, "triangles": 5}, {"max_error": -1}, {"max_error": 1, "bound": "x"}):
        with pytest.raises(UsageError):
            orograph.tin(dem, progress=False, **wrong)
    line = tmp_path / "line.geojson"
    x, y = dem.grid.xy(np.array([60.0, 85]), np.array([20.0, 70]))
    line.write_text(json.dumps({"type": "LineString", "coordinates": np.stack([x, y], -1).tolist(),
                                "crs": {"properties": {"name": "EPSG:32611"}}}), encoding="utf-8")  # fmt: skip
    placed = orograph.Dem(heights, Grid(heights.shape, dem.grid.transform, CRS.from_epsg(32611)), name="hills")
    of_file = orograph.tin(placed, max_error=2, breaklines=line, progress=False)
    of_array = orograph.tin(placed, max_error=2, breaklines=[np.stack([x, y], -1)], progress=False)
    assert (of_file.vertices == of_array.vertices).all() and len(of_file.vertices) != len(mesh.vertices)
    with pytest.raises(UsageError, match="cannot be written"):
        orograph.tin(dem, max_error=1, output="a.dwg", progress=False)
    with pytest.raises(NothingInViewError):
        orograph.tin(np.full((5, 5), np.nan, np.float32), spacing=1, max_error=1, progress=False)
