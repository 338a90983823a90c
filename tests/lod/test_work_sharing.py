"""Sharing of work among threads: everything is taken once, whoever comes when; nobody waits for who has not begun."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from orograph._numba import kernel
from orograph.lod import work_sharing as sharing


@kernel
def work(state, count, helps, done, spins):
    """Count what this thread takes in its row of ``done``; how many."""
    if helps and not sharing.enters(state):
        return -1
    taken = 0
    while sharing.left(state, count):
        done[sharing.last(state, count) if helps else taken] += 1
        taken += 1
        for _ in range(spins):
            sharing.add(state, sharing.SIZE - 1, 1)
    if helps:
        sharing.leave(state)
    return taken


@kernel
def late(state, found):
    found[0] = sharing.wait_for(state)


@kernel
def begin_with(state, number):
    sharing.ready(state, number)


@pytest.mark.parametrize("helpers", [0, 1, 3])
@pytest.mark.parametrize("count", [0, 1, 7, 3000])
def test_everything_is_taken_once(helpers, count):
    for spins in (0, 30):
        state = sharing.begin()
        done = np.zeros((helpers + 1, max(count, 1)), np.int64)
        taken = np.zeros(helpers + 1, np.int64)

        def run(k, state=state, done=done, taken=taken, spins=spins):
            taken[k] = work(state, count, k > 0, done[k], spins)

        threads = [threading.Thread(target=run, args=(k,)) for k in range(1, helpers + 1)]
        for thread in threads:
            thread.start()
        run(0)
        sharing.close(state)
        whole = done.sum(axis=0)  # who was inside has left, so this is final although threads may still be running
        assert (whole[:count] == 1).all()
        assert (done[0, : taken[0]] == 1).all() and not done[0, taken[0] :].any()  # its share is the front
        for thread in threads:
            thread.join()
        assert np.array_equal(whole, done.sum(axis=0))
        assert taken[taken > 0].sum() == count


def test_who_comes_late_does_nothing_and_nobody_waits():
    state, done = sharing.begin(), np.zeros(5, np.int64)
    assert work(state, 5, False, done, 0) == 5
    began = time.perf_counter()
    sharing.close(state)
    assert time.perf_counter() - began < 1.0
    assert work(state, 9, True, done, 0) == -1 and (done == 1).all()
    sharing.close(state)  # closed once more: the late one does not count as inside


def test_close_waits_for_who_is_inside():
    state, done, out = sharing.begin(), np.zeros((2, 1), np.int64), []
    work(sharing.begin(), 1, True, done[1], 0)  # compiled
    thread = threading.Thread(target=lambda: out.append(work(state, 1, True, done[0], 10_000_000)))
    thread.start()
    while state[sharing.GATE] == 0:
        time.sleep(1e-4)
    assert state[sharing.DONE] == 0
    sharing.close(state)
    assert state[sharing.DONE] == 1 and done[0, 0] == 1
    thread.join()


def test_helpers_wait_for_a_number_but_not_for_ever():
    state, found = sharing.begin(), np.zeros(1, np.int64)
    late(state, found)
    assert found[0] == -1
    begin_with(state, 0)
    late(state, found)
    assert found[0] == 0
