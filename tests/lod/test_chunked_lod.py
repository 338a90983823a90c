"""Chunked LOD: meshes as the paper simplifies them, levels that fit, skirts that cover, the selection, stores."""

from __future__ import annotations

import shutil

import numpy as np
import plain
import pytest

from orograph import verify
from orograph.dem import Dem
from orograph.errors import StoreError, UsageError
from orograph.lod.method import Goal, Resources
from orograph.lod.reference import chunked_lod as reference
from orograph.lod.registry import chosen
from orograph.lod.squares import Squares
from orograph.scene.camera import whole
from orograph.store.build import build
from orograph.store.chunked import APART
from orograph.store.repair import repair
from orograph.store.stored import open as open_store
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera, View

SHAPES = [(65, 65), (100, 77), (33, 200), (129, 40), (3, 3), (2, 3)]


def make(t, cells=16, finest=0.0, skirts="yes", morph="yes", **resources):
    text = f"chunked-lod,cells={cells},finest={finest},skirts={skirts},morph={morph}"
    return chosen(text).make(t, Resources(**resources))


def plainly(t, chunks):
    """The reference over what the store has of the terrain's diamonds."""
    table = t.derived("diamonds", error="midpoint")
    tables = [table.read(k, 0, rows, 0, cols) for k in range(t.levels) for rows, cols in [t.diamond_shape(k)]]
    rows, cols = t.grid.shape

    def of(at, what):
        k = min(((at[0] | at[1]) & -(at[0] | at[1])).bit_length() - 1, t.levels - 1)
        i, j = at[0] >> k, at[1] >> k
        found = tables[k][what]
        return float(found[i, j]) if i < found.shape[0] and j < found.shape[1] else (0.0, -1.0)[what]

    return reference.Chunks(
        t.n, chunks.layout.p, chunks.error, lambda at: of(at, 0), lambda at: of(at, 1) >= 0,
        lambda at: float(t.heights[min(at[0], rows - 1), min(at[1], cols - 1)]),
    )  # fmt: skip


def names_of(layout, level):
    rows, cols = layout.chunks(level)
    return [(level, i, j) for i in range(rows) for j in range(cols)]


def on_the_ground(rng, t):
    """An eye within the boxes of chunks of all levels: those are split, whatever the tolerance."""
    row, col = (int(rng.integers(side)) for side in t.grid.shape)
    (x, y), z = t.grid.xy(col, row), float(t.heights[row, col])
    return View((x, y, z), (x + 100, y + 100, z))


def body(chunk):
    """Its triangles without the skirt."""
    return chunk.triangles[: len(chunk.triangles) - chunk.skirt]


@pytest.mark.cases(3)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("gaps", [0.0, 0.06])
def test_meshes_are_the_reference_s(shape, gaps):
    t = plain.terrain(plain.rough(np.random.default_rng(shape), shape, gaps=gaps))
    chunks = make(t).chunks
    told = plainly(t, chunks)
    last = np.array(t.grid.shape)[::-1] - 1
    for level in range(chunks.layout.top + 1):
        for name in names_of(chunks.layout, level):
            chunk = chunks.chunk(*name)
            got = {tuple(map(tuple, chunk.vertices[abc, :2].astype(int).tolist())) for abc in body(chunk)}
            wanted = set()
            for triangle in told.mesh(name):
                points = np.minimum(np.array(triangle)[:, ::-1], last)
                (x, y), (u, v) = points[1] - points[0], points[2] - points[0]
                if x * v != y * u and not np.isnan(t.heights[points[:, 1], points[:, 0]]).any():
                    wanted.add(tuple(map(tuple, points.tolist())))
            assert got == wanted


def test_errors_double_from_level_to_level_rounded_in_the_exponent():
    """A spike of 8 m at an odd sample of flat ground, 1 m at level 0: in the chunks of the levels 0 to 3, no others."""
    z = np.zeros((129, 129), np.float32)
    z[37, 51] = 8.0
    chunks = make(plain.terrain(z), finest=1.0).chunks
    for level in range(chunks.layout.top + 1):
        whole_level = [chunks.chunk(*name) for name in names_of(chunks.layout, level)]
        assert any((one.vertices[:, 2] == 8).any() for one in whole_level) == (level <= 3)
        if level > 3:
            assert all(len(body(one)) == 2 for one in whole_level)


@pytest.mark.parametrize("shape", [(129, 129), (100, 77), (129, 40)])
def test_vertices_move_to_the_parent_s_mesh(shape):
    t = plain.terrain(plain.rough(np.random.default_rng(9), shape))
    chunks = make(t).chunks
    told = plainly(t, chunks)
    for level in range(chunks.layout.top):
        for name in names_of(chunks.layout, level):
            chunk, parent = chunks.chunk(*name), chunks.chunk(level + 1, name[1] >> 1, name[2] >> 1)
            tops = np.unique(body(chunk))
            at, got = chunk.vertices[tops], chunk.targets[tops]
            if shape == (129, 129):
                mesh = Tessellation(parent.vertices, body(parent))
                np.testing.assert_allclose(got, plain.on_mesh(mesh, at[:, 0], at[:, 1]), atol=1e-3)
                wanted = [told.height_at(level + 1, (int(r), int(c))) for c, r, _ in at]
                np.testing.assert_allclose(got, wanted, atol=1e-4)
            kept = (at[:, :2, None] == parent.vertices[np.unique(body(parent)), :2].T).all(1).any(1)
            np.testing.assert_allclose(got[kept], at[kept, 2], atol=1e-4)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("gaps", [0.0, 0.06])
def test_chunks_of_a_level_fit(shape, gaps):
    t = plain.terrain(plain.rough(np.random.default_rng(shape), shape, gaps=gaps))
    chunks, view = make(t).chunks, whole(t, (640, 480))
    for level in range(chunks.layout.top + 1):
        parts = [chunks.chunk(*name) for name in names_of(chunks.layout, level)]
        corners = np.concatenate([p.vertices[body(p)].reshape(-1, 3) for p in parts])
        vertices, where = np.unique(corners, axis=0, return_inverse=True)
        mesh = Tessellation(vertices, where.reshape(-1, 3).astype(np.int32))
        assert not verify.judge_mesh(mesh, t, view).defects


def edge_of(chunk, axis, at, left):
    """Along a side at ``at`` on an axis: places, heights, and how low its skirt reaches, where its vertices moved."""
    moved = chunk.vertices.copy()
    moved[:, 2] = chunk.targets + left * (chunk.vertices[:, 2] - chunk.targets)
    skirt = chunk.triangles[len(chunk.triangles) - chunk.skirt :]
    own, hung = np.unique(body(chunk)), np.setdiff1d(np.unique(skirt), np.unique(body(chunk)))
    found = []
    for which in (own, hung):
        which = which[moved[which, axis] == at]
        which = which[np.argsort(moved[which, 1 - axis], kind="stable")]
        found.append((moved[which, 1 - axis], moved[which, 2]))
    return found


@pytest.mark.parametrize("shape", [(257, 257), (200, 157)])
def test_skirts_cover_what_opens_between_chunks(shape):
    """For every pair of chunks beside each other of levels within ``APART``, however far their vertices have moved."""
    rng, checked = np.random.default_rng(6), 0
    t = plain.terrain(plain.rough(rng, shape))
    chunks = make(t).chunks
    layout = chunks.layout
    every = [name for level in range(layout.top + 1) for name in names_of(layout, level)]
    held = {name: chunks.chunk(*name) for name in every}
    for level, i, j in every:
        side = layout.side(level)
        for axis, (r, c) in enumerate([(i * side, (j + 1) * side), ((i + 1) * side, j * side)]):
            for other in range(max(level - APART, 0), min(level + APART, layout.top) + 1):
                width = layout.side(other)
                if (c, r)[axis] % width or (other, r // width, c // width) not in held:
                    continue
                pair = held[level, i, j], held[other, r // width, c // width]
                at = (c, r)[axis]
                begin, end = max((r, c)[axis], (r, c)[axis] // width * width), None
                end = min((r, c)[axis] + side, (r, c)[axis] // width * width + width, t.grid.shape[axis] - 1)
                places = np.linspace(begin, end, 4 * (end - begin) + 1)
                one, two = (edge_of(chunk, axis, at, rng.choice([0, 1, rng.uniform()])) for chunk in pair)
                (height, low), (height_, low_) = (
                    [np.interp(places, *line) for line in edge] for edge in (one, two)
                )  # fmt: skip
                assert (np.where(height > height_, height_ - low, height - low_) >= 0).all()
                checked += 1
    assert checked > 100


def test_skirts_are_the_reference_s():
    t = plain.terrain(plain.rough(np.random.default_rng(2), (129, 129)))
    chunks = make(t).chunks
    told, layout = plainly(t, chunks), chunks.layout
    for level in range(layout.top):
        side = layout.side(level)
        for _, i, j in names_of(layout, level):
            (_, _), (places, low) = edge_of(chunks.chunk(level, i, j), 1, i * side, 1.0)
            if i == 0:
                assert set(places) <= {j * side, (j + 1) * side}  # (where other sides begin)
                continue
            line = [(i * side, c) for c in range(j * side, (j + 1) * side + 1)]
            octave = ((i * side) & -(i * side)).bit_length() - 1
            coarsest = min(min(octave - layout.p, level + APART) + 1, layout.top)
            wanted = told.skirt(level, line, coarsest)
            inner = slice(1, -1)  # (corners hang as low as the lower of two sides)
            assert [int(c) for c in places] == [c for _, c in wanted]
            np.testing.assert_allclose(low[inner], list(wanted.values())[inner], atol=1e-3)
            assert (low <= np.array(list(wanted.values())) + 1e-6).all()


@pytest.mark.parametrize("shape", [(257, 257), (300, 177), (65, 400), (3, 3), (2, 2)])
def test_the_selection_is_the_reference_s(shape):
    rng, forced = np.random.default_rng(shape), 0
    for k in range(12):
        t = plain.terrain(
            plain.rough(rng, shape, amplitude=float(rng.choice([80, 800]))), angle=float(rng.uniform(0, 360))
        )
        method = make(t)
        layout = method.layout
        view = on_the_ground(rng, t) if k % 3 == 0 else plain.random_view(rng, t)
        camera = Camera.over(t.grid, view, float(rng.choice([0.5, 1.0, 2.0])))
        tolerance = float(10 ** rng.uniform(-1, 2)) if k % 3 else 1000.0

        def one(name):
            return Squares(layout.p + name[0], np.array([name[1]]), np.array([name[2]]))  # noqa: B023

        def pixels(name):
            return float(method._pixels(camera, one(name), name[0])[0])  # noqa: B023

        tree = reference.Selection(
            layout.top,
            APART,
            pixels,
            lambda name: len(method._heights.on_ground(one(name))) > 0,  # noqa: B023
        )
        tree.divide((layout.top, 0, 0), tolerance)
        split, more = method.split(camera, tolerance)
        got = {(level, int(code >> 32), int(code & 0xFFFFFFFF)) for level, codes in split.items() for code in codes}
        assert got == tree.split
        forced += more
        found = method.chosen(camera, tolerance).names
        assert set(found) <= set(tree.drawn((layout.top, 0, 0)))
        for name, left in found.items():
            wanted = 1.0 if name[0] == layout.top else reference.morph(pixels(name), tolerance)
            assert left == pytest.approx(wanted)
    assert forced or min(shape) < 200


def test_chunks_side_by_side_are_within_two_levels():
    rng = np.random.default_rng(12)
    t = plain.terrain(plain.rough(rng, (513, 513), amplitude=5.0))
    method = make(t)
    most = 0
    for _ in range(10):
        camera = Camera.over(t.grid, on_the_ground(rng, t))
        levels = np.full((32, 32), -1)
        split, _ = method.split(camera, 1000.0)
        for name in names_of(method.layout, 0):
            levels[name[1:]] = next(
                (k - 1 for k in range(1, 6) if (name[1] >> k << 32 | name[2] >> k) in set(split[k].tolist())), 5
            )
        apart = max(np.abs(np.diff(levels, axis=axis)).max() for axis in (0, 1))
        assert apart <= APART
        most = max(most, apart)
    assert most == APART


def test_a_parent_that_is_split_looks_as_before():
    """At the distance where ρ is the tolerance: its children's vertices are where they are in its mesh."""
    t = plain.terrain(plain.rough(np.random.default_rng(3), (129, 129)))
    method = make(t)
    view = whole(t, (640, 480))
    camera = Camera.over(t.grid, view)
    root = Squares(7, np.zeros(1, np.int64), np.zeros(1, np.int64))
    tolerance = float(method._pixels(camera, root, 3)[0])
    before = method.chosen(camera, tolerance).names
    after = method.chosen(camera, tolerance * (1 - 1e-9)).names
    assert before == {(3, 0, 0): 1.0} and len(after) == 4 and max(after.values()) < 1e-6


def test_the_referee_counts_cracks_and_skirts():
    """Chunks of one level that have not moved fit; elsewhere the mesh is open, and each gap has a skirt before it."""
    t = plain.terrain(plain.rough(np.random.default_rng(5), (257, 257)))
    view = whole(t, (640, 480))
    camera = Camera.over(t.grid, view)
    assert not verify.judge_mesh(make(t, skirts="no").select(camera, Goal(0.0)).tessellation(), t, view).defects
    error = make(t).chunks.error
    pixels = float(make(t)._pixels(camera, Squares(8, np.zeros(1, np.int64), np.zeros(1, np.int64)), 4)[0])
    assert error > 0
    bare = make(t, skirts="no").select(camera, Goal(pixels / 3))
    hung = make(t).select(camera, Goal(pixels / 3))
    report = verify.judge_mesh(bare.tessellation(), t, view)
    assert report.defects.get("inner", 0) and not set(report.defects) & {"holes", "overlaps", "reversed", "flat"}
    assert hung.stats["triangles"] == bare.stats["triangles"] + hung.stats["skirt_triangles"]
    mesh = hung.tessellation()
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    assert (area <= 0).all() and (area == 0).sum() == hung.stats["skirt_triangles"]
    assert verify.judge_mesh(mesh, t, view).defects["flat"] == hung.stats["skirt_triangles"]


@pytest.mark.parametrize("turned", [0.0, 30.0])
def test_it_promises_nothing_and_keeps_budgets(turned):
    t = plain.terrain(plain.rough(np.random.default_rng(11), (513, 300), amplitude=500.0, gaps=0.02), angle=turned)
    camera = Camera.over(t.grid, whole(t, (640, 480)))
    for budget in (60_000, 200_000):
        selection = make(t).select(camera, Goal(triangles=budget))
        assert selection.bound is None and not selection.stats["conservative"]
        assert selection.stats["within_budget"] and selection.stats["triangles"] <= budget
        assert len(selection.tessellation().triangles) == selection.stats["triangles"]


def test_neither_threads_nor_memory_change_the_meshes():
    t = plain.terrain(plain.rough(np.random.default_rng(7), (300, 411), gaps=0.03))
    camera = Camera.over(t.grid, plain.random_view(np.random.default_rng(8), t))
    one = make(t, jobs=1).select(camera, Goal(1.0)).tessellation()
    small = make(t, jobs=3, max_memory=1 << 16)
    for _ in range(2):
        many = small.select(camera, Goal(1.0)).tessellation()
        np.testing.assert_array_equal(one.vertices, many.vertices)
        np.testing.assert_array_equal(one.triangles, many.triangles)
    assert len(small._kept) == 1


def test_from_straight_above_it_is_one_chunk():
    from dataclasses import replace

    t = plain.terrain(plain.rough(np.random.default_rng(7), (129, 129)))
    view = replace(whole(t, (640, 480)), projection="plan")
    assert make(t).select(Camera.over(t.grid, view), Goal(0.5)).stats["chunks"] == 1


def test_a_store_has_them(tmp_path):
    z = plain.rough(np.random.default_rng(7), (600, 411), gaps=0.03)
    t = plain.terrain(z)
    made = build(Dem(z, t.grid), tmp_path / "a.oro", chunked=(32, 0), progress=False)
    lacking = {"cells": 32, "finest": 1.0}
    assert made.has("chunked", cells=32, finest=0.0) and not made.has("chunked", **lacking) and made.check() == []
    with pytest.raises(StoreError, match="no chunks of 32 cells and 1 m"):
        made.derived("chunked", **lacking)
    camera = Camera.over(t.grid, plain.random_view(np.random.default_rng(8), t))
    wanted = make(t, cells=32).select(camera, Goal(2.0)).tessellation()
    without = build(Dem(z, t.grid), tmp_path / "b.oro", progress=False)
    for store in (made, without):
        method = make(store, cells=32)
        assert (type(method.chunks).__name__ == "StoredChunks") == (store is made)
        found = method.select(camera, Goal(2.0)).tessellation()
        np.testing.assert_array_equal(found.vertices, wanted.vertices)
        np.testing.assert_array_equal(found.triangles, wanted.triangles)


@pytest.mark.stress
def test_the_same_bytes_whatever_else_is_stored_and_damage_is_mended(tmp_path):
    z = plain.rough(np.random.default_rng(7), (300, 411))
    dem = Dem(z, plain.terrain(z).grid)
    build(dem, tmp_path / "a.oro", chunked=(16, 2.0), jobs=1, progress=False).close()
    build(dem, tmp_path / "b.oro", chunked=(16, 2.0), jobs=3, errors=("midpoint",), progress=False).close()
    shards = sorted(p.relative_to(tmp_path / "a.oro") for p in (tmp_path / "a.oro" / "chunked").rglob("c/*/*"))
    before = {shard: (tmp_path / "a.oro" / shard).read_bytes() for shard in shards}
    assert shards and all((tmp_path / "b.oro" / shard).read_bytes() == was for shard, was in before.items())
    shutil.rmtree(tmp_path / "a.oro" / "chunked" / "level-0")
    assert repair(tmp_path / "a.oro")
    assert all((tmp_path / "a.oro" / shard).read_bytes() == was for shard, was in before.items())
    assert open_store(tmp_path / "a.oro").check() == []


@pytest.mark.stress
def test_a_build_out_of_core_makes_the_same(tmp_path, monkeypatch):
    """With its table of vertices in a file, and hardly a corner remembered."""
    from orograph import folders
    from orograph.store import chunked_build

    z = plain.rough(np.random.default_rng(7), (400, 611), gaps=0.02)
    dem = Dem(z, plain.terrain(z).grid)
    build(dem, tmp_path / "a.oro", chunked=(16, 0), jobs=1, progress=False).close()
    monkeypatch.setattr(folders, "HELD", 0)
    monkeypatch.setattr(chunked_build, "CORNERS", 3)
    build(dem, tmp_path / "b.oro", chunked=(16, 0), jobs=3, progress=False).close()
    shards = sorted(p.relative_to(tmp_path / "a.oro") for p in (tmp_path / "a.oro" / "chunked").rglob("c/*/*"))
    assert shards and all(
        (tmp_path / "b.oro" / s).read_bytes() == (tmp_path / "a.oro" / s).read_bytes() for s in shards
    )
    told = open_store(tmp_path / "b.oro").derived("chunked", cells=16, finest=0.0)
    whole = make(plain.terrain(z)).chunks
    for level in range(told.layout.top + 1):
        for name in names_of(told.layout, level):
            one, other = told.chunk(*name), whole.chunk(*name)
            assert np.array_equal(one.vertices, other.vertices, equal_nan=True)
            assert np.array_equal(one.triangles, other.triangles)


@pytest.mark.stress
@pytest.mark.parametrize("name", plain.GROUND)
def test_what_the_referee_finds(shared_data, name):
    """42 views of each of five terrains: it promises nothing, but leaves no ground out and folds nothing."""
    t = plain.ground(shared_data, name)
    rng, method, ratios = np.random.default_rng(1), make(t, cells=32, skirts=False), []
    for _ in range(42):
        view = plain.random_view(rng, t, width=1280, height=720)
        tolerance = float(2 ** rng.uniform(-1, 3))
        mesh = method.select(Camera.over(t.grid, view), Goal(tolerance)).tessellation()
        report = verify.judge_mesh(mesh, t, view)
        assert not set(report.defects) & {"holes", "overlaps", "reversed", "flat"}, (view, tolerance, report)
        ratios.append(report.largest / tolerance)
    over = sum(ratio > 1 for ratio in ratios)
    print(
        f"{name}: {over} of 42 over; of the tolerance {np.median(ratios):.2f} in the median, {max(ratios):.2f} at most"
    )
    assert max(ratios) < 6


def test_sizes_that_make_no_sense_are_refused():
    t = plain.terrain(plain.rough(np.random.default_rng(7), (33, 33)))
    for sizes in ((7, 0), (32, -1.0), (32, float("nan")), 32, (32,)):
        with pytest.raises(UsageError, match="'chunked' must be cells"):
            build(Dem(t.heights, t.grid), "nowhere.oro", chunked=sizes, progress=False)
