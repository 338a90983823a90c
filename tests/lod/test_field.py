"""Pages: what they hold is the terrain's heights and diamonds; where; and which leave when memory is short."""

from __future__ import annotations

import threading

import numpy as np
import plain
import pytest

from orograph._numba import kernel
from orograph.errors import UsageError
from orograph.hierarchy import diamonds
from orograph.lod.field import Field
from orograph.lod.pages import BEYOND, PAGE_BYTES, find, locate


@kernel
def look_up(pages, rows, cols, octaves, slots, numbers):
    for k in range(len(rows)):
        slot, i, j = find(pages, rows[k], cols[k], octaves[k])
        again, at = locate(pages, rows[k], cols[k], octaves[k])
        slots[k] = slot if slot == again else -99
        if slot >= 0:
            numbers[k] = pages.data[slot, i, j]
            if not (pages.flat[at + 1] == numbers[k, 1] and pages.flat[at + 2] == numbers[k, 2]):
                slots[k] = -99


def looked_up(field, rows, cols):
    octaves = np.array([diamonds.octave(int(r), int(c)) for r, c in zip(rows, cols)])
    slots, numbers = np.empty(len(rows), np.int64), np.zeros((len(rows), 4), np.float32)
    look_up(field.pages, rows, cols, octaves, slots, numbers)
    return slots, numbers


@pytest.mark.cases(1)
@pytest.mark.parametrize("shape", [(33, 33), (700, 520)])
def test_pages_hold_heights_and_diamonds(shape):
    rng = np.random.default_rng(shape)
    t = plain.terrain(plain.rough(rng, shape, gaps=0.1))
    field = Field(t, color=lambda level, r0, r1, c0, c1: np.full((r1 - r0, c1 - c0), 2.5, np.float32), jobs=2)
    side = 1 << t.n
    rows, cols = rng.integers(0, side + 1, (2, 4000))
    some = ((rows % side != 0) | (cols % side != 0)) & (rows < shape[0]) & (cols < shape[1])
    rows, cols = rows[some], cols[some]
    field.begin()
    slots, _ = looked_up(field, rows, cols)
    assert (slots < 0).all() and field.fetch()
    field.begin()
    slots, numbers = looked_up(field, rows, cols)
    assert (slots >= 0).all() and not field.fetch()
    if shape == (33, 33):
        p = plain.Plain(t)
        assert np.array_equal(numbers[:, 1], p.e[rows, cols].astype(np.float32))
        full = p.r[rows, cols] >= 0
        assert np.array_equal(numbers[full, 2], p.r[rows, cols][full].astype(np.float32))
        assert (numbers[~full, 2] < 0).all()
        np.testing.assert_array_equal(numbers[:, 0], p.filled[rows, cols].astype(np.float32))
    z = t.heights[rows, cols]
    assert np.array_equal(numbers[:, 3] < 0, np.isnan(z))
    assert np.array_equal(np.where(numbers[:, 3] < 0, -1 - numbers[:, 3], numbers[:, 3]), np.full(len(rows), 2.5))
    assert np.array_equal(numbers[~np.isnan(z), 0], z[~np.isnan(z)])


def test_every_entry_of_a_page_has_a_place_of_its_own_and_lines_hold_neighbours():
    field = Field(plain.terrain(np.zeros((600, 600), np.float32)))
    place = field.pages.down[:, None] + field.pages.across
    assert np.array_equal(np.sort(place.ravel()), np.arange(0, 4 << 16, 4))
    lines = (place // 16).reshape(128, 2, 128, 2)
    assert (lines == lines[:, :1, :, :1]).all()
    blocks = (place // 1024).reshape(16, 16, 16, 16)
    assert (blocks == blocks[:, :1, :, :1]).all()
    assert field.pages.flat.ctypes.data % 4096 == 0


def test_beyond_the_raster_there_are_no_pages_or_empty_entries():
    field = Field(plain.terrain(np.zeros((300, 40), np.float32)))
    rows, cols = np.array([5, 257, 301, 511]), np.array([45, 300, 41, 511])
    for _ in range(2):
        field.begin()
        slots, numbers = looked_up(field, rows, cols)
        field.fetch()
    assert slots[[1, 3]].tolist() == [BEYOND, BEYOND]
    assert (numbers[[0, 2], 2] < 0).all()


def test_pages_not_used_last_leave_first():
    t = plain.terrain(np.zeros((1500, 1500), np.float32))
    field = Field(t, max_memory=8 * PAGE_BYTES)

    def use(*pages):
        row = np.array([257 + 256 * i for i, _ in pages]) | 1
        col = np.array([257 + 256 * j for _, j in pages]) | 1
        field.begin()
        looked_up(field, row, col)
        while field.fetch():
            looked_up(field, row, col)
        return field.tiles_read

    first = [(0, 0), (0, 1), (0, 2), (0, 3)]
    assert use(*first) == 4
    assert use((1, 0), (1, 1), (1, 2), (1, 3)) == 8
    assert use((0, 0), (0, 1)) == 8  # still there, and now younger than (0, 2), (0, 3)
    assert use((2, 0), (2, 1)) == 10
    assert use((0, 0), (0, 1), (1, 0), (1, 1)) == 10
    assert use((0, 2)) == 11
    with pytest.raises(UsageError, match="8 tiles"):
        use(*[(i, j) for i in range(3) for j in range(3)])


def test_threads_lose_no_page_that_they_ask_for():
    t = plain.terrain(np.zeros((4000, 4000), np.float32))
    rng = np.random.default_rng(0)
    field = Field(t)
    for _ in range(15):
        rows, cols = rng.integers(0, 3999, (2, 64)) | 1
        field.begin()
        threads = [threading.Thread(target=looked_up, args=(field, rows, cols)) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        field.fetch()
        assert (looked_up(field, rows, cols)[0] >= 0).all()
        assert not (field.pages.table == -2).any()


def test_a_single_row_is_no_surface():
    with pytest.raises(UsageError, match="at least two"):
        Field(plain.terrain(np.zeros((1, 9), np.float32)))
    with pytest.raises(UsageError, match="MiB"):
        Field(plain.terrain(np.zeros((513, 513), np.float32)), max_memory=1 << 20)
