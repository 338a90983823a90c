"""The heap against sorting, codes against the diamond DAG, the radix heap of ways against looking at all."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from orograph._numba import kernel
from orograph.hierarchy import diamonds
from orograph.lod import radix_heap as waiting
from orograph.lod.queues import code_of, heap_pop, heap_push
from orograph.lod.radix_heap import LISTS, WHERE, WORK, link, list_of


@kernel
def drained(priorities, codes, pops):
    """Push all, popping one after each place marked in ``pops``; then pop the rest. The slots in the order popped."""
    count = len(codes)
    ps, cs, ss = np.empty(count), np.empty(count, np.int64), np.empty(count, np.int64)
    out = np.empty(count, np.int64)
    size = done = 0
    for i in range(count):
        heap_push(ps, cs, ss, size, priorities[i], codes[i], i)
        size += 1
        if pops[i]:
            out[done] = ss[0]
            heap_pop(ps, cs, ss, size)
            size, done = size - 1, done + 1
    while size > 0:
        out[done] = ss[0]
        heap_pop(ps, cs, ss, size)
        size, done = size - 1, done + 1
    return out


@settings(deadline=None)
@given(st.lists(st.tuples(st.sampled_from([0.0, 1.0, 2.5, np.inf]), st.integers(0, 6), st.booleans()), max_size=60))
def test_heap_takes_the_first_of_a_total_order(entries):
    priorities = np.array([p for p, _, _ in entries], float)
    codes = np.array([c for _, c, _ in entries], np.int64)
    pops = np.array([b for *_, b in entries], bool)
    inside, expected = [], []
    for i in range(len(entries)):
        inside.append((-priorities[i], codes[i], i))
        if pops[i]:
            expected.append(min(inside)[:2])
            inside.remove(min(inside))
    expected += [entry[:2] for entry in sorted(inside)]
    found = drained(priorities, codes, pops)
    assert sorted(found) == list(range(len(entries)))
    # (entries with equal priority and code may come in any order: compare those two)
    assert [(-priorities[i], codes[i]) for i in found] == expected


def test_codes_put_parents_first_and_name_each_diamond_once():
    n = 4
    seen = {}
    for level in range(2 * n):
        for row, col in zip(*diamonds.of_level(n, level)):
            code = code_of.py_func(int(row) << 32 | int(col), level, n)
            assert code not in seen.values()
            seen[int(row), int(col)] = code
            for k in (0, 1):
                parent = tuple(int(v) for v in diamonds.parent(row, col, k, n))
                assert parent == (-1, -1) or seen[parent] < code


@kernel
def enter(links, heads, v, due, now):
    link(links, heads, v, list_of(due, now))


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(0, 1 << 40), min_size=1, max_size=40),
    st.lists(st.one_of(st.integers(0, 50), st.integers(0, 1 << 39)), max_size=12),
)
def test_ways_are_due_when_they_are_due(ways, steps):
    due = np.array(ways, np.int64)
    links = np.full((len(due), 3), -1, np.int32)
    heads = np.full(LISTS, -1, np.int32)
    now = 0
    for v in range(len(due)):
        enter(links, heads, v, due[v], now)
    for step in steps:
        waiting.advance(links, due, heads, now, now + step)
        now += step
        # What is due at the very way it entered at may wait for the next growth.
        at_work = links[:, WHERE] == WORK
        assert (at_work[due < now]).all()
        assert not (at_work & (due > now)).any()
        if step:
            assert at_work[due <= now].all()
