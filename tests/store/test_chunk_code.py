"""Compressed chunks: the same meshes, within half a step, in few bytes; words as the description has them."""

from __future__ import annotations

from pathlib import Path

import chunk_reference as reference
import numpy as np
import plain
import pytest

from orograph.dem import Dem
from orograph.errors import StoreError, UsageError
from orograph.store.build import build
from orograph.store.chunk_code import HEADER, MOST, chunk_of, decoded, encoded, off_by, step_of
from orograph.store.chunked import MISSING, Kind
from orograph.store.chunked_build import MemoryChunks
from orograph.store.stored import open as open_store

SHAPES = [(65, 65), (100, 77), (33, 200), (129, 40), (3, 3), (2, 3)]


def chunks_of(z, cells=16):
    t = plain.terrain(z.astype(np.float32))
    return MemoryChunks(t, Kind(cells)), float(np.nanmax(np.abs(z)))


def names(layout):
    for level in range(layout.top + 1):
        rows, cols = layout.chunks(level)
        yield from ((level, i, j) for i in range(rows) for j in range(cols))


def corners(chunk, triangles, values):
    """Triangles as places and heights of their corners, in an order of their own, and what else vertices have."""
    rows = np.concatenate([chunk.vertices[triangles].reshape(len(triangles), 9), values[triangles]], 1)
    return rows[np.lexsort(rows[:, ::-1].T)]


def plainly(words, layout, level, i, j):
    return reference.decode(words, layout.shape, layout.side(level), (i * layout.side(level), j * layout.side(level)),
                            layout.corners(level, i, j).tolist())  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("gaps", [0.0, 0.06])
def test_heights_on_the_lattice_make_the_same_mesh(shape, gaps):
    """Of quarters of a metre nothing is lost; vertices move to within an eighth of a step, skirts reach as low."""
    z = np.rint(plain.rough(np.random.default_rng(shape), shape, gaps=gaps) * 4) / 4
    chunks, _ = chunks_of(z)
    for name in names(chunks.layout):
        before = chunks.chunk(*name)
        words = encoded(chunks.words(*name), chunks.layout, *name, 0.25)
        after = chunk_of(words, chunks.layout, *name)
        assert off_by(words) == 0 and after.skirt == before.skirt
        bodies = [c.triangles[: len(c.triangles) - c.skirt] for c in (before, after)]
        one, other = (corners(c, body, c.targets) for c, body in zip((before, after), bodies, strict=True))
        np.testing.assert_array_equal(one[:, :9], other[:, :9])
        step = 2.0 ** ((int(words[HEADER.index("flags")]) & 255) - 64)
        np.testing.assert_allclose(one[:, 9:], other[:, 9:], atol=step / 8)
        lows = [np.unique(c.vertices[c.triangles[len(c.triangles) - c.skirt :]].reshape(-1, 3), axis=0)
                for c in (before, after)]  # fmt: skip
        for (x, y), group in ((p, lows[0][(lows[0][:, :2] == p).all(1), 2]) for p in np.unique(lows[0][:, :2], axis=0)):
            there = lows[1][(lows[1][:, :2] == (x, y)).all(1), 2]
            assert group.min() - step <= there.min() <= group.min() + 1e-6


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("gaps", [0.0, 0.06])
def test_words_are_those_of_the_description(shape, gaps):
    chunks, highest = chunks_of(plain.rough(np.random.default_rng(shape), shape, gaps=gaps))
    step = step_of(chunks.error, highest)
    for name in names(chunks.layout):
        words = encoded(chunks.words(*name), chunks.layout, *name, step)
        vertices, triangles = plainly(words, chunks.layout, *name)
        mesh = decoded(words, chunks.layout, *name)
        wanted = [[MISSING if n is None else n for n in v] for v in vertices]
        got = np.column_stack([mesh.places, mesh.heights, mesh.targets, mesh.low])
        np.testing.assert_array_equal(got, wanted)
        made = int(words[HEADER.index("triangles")])
        np.testing.assert_array_equal(mesh.triangles, np.reshape(triangles[:made], (-1, 3)))
        assert len(triangles) == made + 2 * int(words[HEADER.index("hung")])


def test_heights_that_nothing_foretells_are_kept():
    """Noise as high as heights get: residuals are too long for Rice codes."""
    z = np.random.default_rng(2).integers(-MOST + 1, MOST, (33, 33)).astype(np.float64)
    chunks = MemoryChunks(plain.terrain(z.astype(np.float32)), Kind(16, 1e-3))
    for name in names(chunks.layout):
        before = chunks.chunk(*name)
        after = chunk_of(encoded(chunks.words(*name), chunks.layout, *name, 1.0), chunks.layout, *name)
        body, other = (c.triangles[: len(c.triangles) - c.skirt] for c in (before, after))
        np.testing.assert_array_equal(
            corners(before, body, before.targets)[:, :9], corners(after, other, after.targets)[:, :9]
        )


def test_heights_are_off_by_half_a_step_at_most_and_chunks_of_a_level_fit():
    shape = (129, 100)
    chunks, highest = chunks_of(plain.rough(np.random.default_rng(3), shape))
    step, worst = step_of(chunks.error, highest), 0.0
    for level in range(chunks.layout.top + 1):
        known: dict[tuple[float, float], float] = {}
        for name in (n for n in names(chunks.layout) if n[0] == level):
            words = encoded(chunks.words(*name), chunks.layout, *name, step)
            assert off_by(words) == step / 2 <= chunks.error / 8
            chunk = chunk_of(words, chunks.layout, *name)
            used = np.unique(chunk.triangles[: len(chunk.triangles) - chunk.skirt])
            for x, y, z in chunk.vertices[used].tolist():
                assert known.setdefault((x, y), z) == z
                worst = max(worst, abs(z - float(chunks.terrain.heights[int(y), int(x)])))
    assert 0.4 * step < worst <= step / 2 + 1e-6


def test_the_step_keeps_high_ground_within_whole_numbers_of_float32():
    assert step_of(1.0, 100.0) == 0.25 and step_of(0.9, 100.0) == 0.125
    for error, highest in ((1e-6, 8849.0), (0.01, 21_000.0), (0.0, 0.0)):
        assert highest / step_of(error, highest) * 64 < 1 << 24


def test_words_of_something_else_are_told(tmp_path):
    chunks, highest = chunks_of(plain.rough(np.random.default_rng(5), (65, 65)))
    words = encoded(chunks.words(0, 1, 1), chunks.layout, 0, 1, 1, step_of(chunks.error, highest))
    words[20:60] = 0
    with pytest.raises(ValueError, match="not the words of a chunk"):
        decoded(words, chunks.layout, 0, 1, 1)


@pytest.mark.parametrize(("name", "smaller"), [("oblong, 30 m", 21), ("city, 1 m", 15), ("voids, 90 m", 14)])
def test_few_bytes_a_triangle_on_real_ground(shared_data: Path, name, smaller):
    """Indexed triangles take 12 bytes each and 12 a vertex; of coded ones morphs and skirts count, too."""
    t = plain.ground(shared_data, name)
    chunks = MemoryChunks(t, Kind(32, 0.0, True))
    rng, sizes = np.random.default_rng(1), np.zeros(2)
    everything = list(names(chunks.layout))
    for k in rng.permutation(len(everything))[:60]:
        words = chunks.words(*everything[k])
        there = len(np.unique(decoded(words, chunks.layout, *everything[k]).places, axis=0))
        sizes += 4 * len(words), 12 * there + 12 * int(words[HEADER.index("triangles")])
    assert sizes[1] / sizes[0] > smaller


def test_a_store_keeps_them_and_says_what_it_has(tmp_path):
    z = plain.rough(np.random.default_rng(8), (200, 140), gaps=0.03)
    t = plain.terrain(z)
    build(Dem(t.heights, t.grid), tmp_path / "s", chunked=(16, 0, True), progress=False).close()
    stored, made = open_store(tmp_path / "s"), MemoryChunks(t, Kind(16, 0.0, True))
    chunks = stored.derived("chunked", cells=16, finest=0.0, compressed=True)
    assert chunks.compressed and chunks.error == made.error
    for name in names(chunks.layout):
        np.testing.assert_array_equal(chunks.words(*name), made.words(*name))
    with pytest.raises(StoreError, match=r"no chunks of 16 cells.*chunked=\(16, 0\)"):
        stored.derived("chunked", cells=16, finest=0.0, compressed=False)
    with pytest.raises(UsageError, match="whether they are compressed"):
        build(Dem(t.heights, t.grid), tmp_path / "t", chunked=(16, 0, "yes"), progress=False)
