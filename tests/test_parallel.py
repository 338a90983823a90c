"""Threads: every item is worked on once; a crew is called again and again, survives errors, and goes."""

from __future__ import annotations

import gc
import threading
import time

import pytest

from orograph.parallel import Crew, for_each, for_groups


def until(condition) -> bool:
    for _ in range(2000):
        if condition():
            return True
        time.sleep(1e-3)
    return False


def test_each_thread_of_a_crew_is_called_once_with_its_number():
    crew, calls = Crew(3), []
    for turn in range(20):
        crew.call(lambda k, turn=turn: calls.append((turn, k, threading.get_ident())))
    assert until(lambda: len(calls) == 60)
    assert sorted(c[:2] for c in calls) == [(turn, k) for turn in range(20) for k in range(3)]
    assert len({c[2] for c in calls}) == 3  # the same threads all the time
    for k in range(3):
        assert [c[0] for c in calls if c[1] == k] == list(range(20))  # in order


def test_an_error_is_reported_and_the_thread_goes_on(monkeypatch):
    reported, calls = [], []
    monkeypatch.setattr(threading, "excepthook", lambda hook: reported.append(hook.exc_value))
    crew = Crew(1)

    def fail(number):
        raise ValueError(number)

    crew.call(fail)
    crew.call(calls.append)
    assert until(lambda: calls == [0])
    assert [str(e) for e in reported] == ["0"]


def test_a_crew_that_nobody_holds_ends_and_keeps_nothing():
    crew = Crew(2)
    crew.call(lambda k: None)
    threads = list(crew._threads)
    assert all(t.is_alive() and t.daemon for t in threads)
    del crew
    gc.collect()
    assert until(lambda: not any(t.is_alive() for t in threads))


@pytest.mark.parametrize("jobs", [1, 2, 5])
def test_each_item_is_worked_on_once(jobs):
    done = []
    for_each(done.append, range(500), jobs)
    assert sorted(done) == list(range(500))
    for_each(done.append, [], jobs)
    assert len(done) == 500


@pytest.mark.parametrize("jobs", [2, 3])
@pytest.mark.parametrize("fails", [ValueError, KeyboardInterrupt])
def test_an_error_stops_the_rest_and_is_raised_when_all_threads_are_done(jobs, fails):
    done = []

    def work(item):
        if item == 20:
            raise fails(item)
        time.sleep(1e-3)
        done.append(item)

    with pytest.raises(fails):
        for_each(work, range(1000), jobs)
    count = len(done)
    assert set(range(15)) <= set(done) and count < 100
    time.sleep(0.02)
    assert len(done) == count


def test_work_within_work_does_not_wait_for_itself():
    done = []
    for_each(lambda k: for_each(lambda j: done.append((k, j)), range(20), 3), range(20), 3)
    assert sorted(done) == [(k, j) for k in range(20) for j in range(20)]


@pytest.mark.parametrize("jobs", [1, 2, 4])
def test_a_group_begins_when_all_but_the_one_before_it_are_done(jobs):
    done, asked, overlapped = [], [], []

    def groups():
        for group in range(40):
            asked.append((group, sorted(done)))
            yield [(group, k) for k in range(group % 4)]  # some of them empty

    def work(item):
        group, k = item
        complete = sorted(done)
        assert [i for i in complete if i[0] < group - 1] == [(g, k) for g in range(group - 1) for k in range(g % 4)]
        overlapped.append(len([i for i in complete if i[0] == group - 1]) < (group - 1) % 4)
        time.sleep(2e-4 * (k + 1))
        done.append(item)

    for_groups(work, groups(), jobs)
    assert sorted(done) == [(g, k) for g in range(40) for k in range(g % 4)]
    for group, before in asked:  # two groups ahead of it are done when a group is asked for
        assert [i for i in before if i[0] < group - 1] == [(g, k) for g in range(group - 1) for k in range(g % 4)]
    assert any(overlapped) == (jobs > 1)


@pytest.mark.parametrize("jobs", [1, 3])
def test_an_error_of_who_makes_the_groups_is_raised(jobs):
    def groups():
        yield range(10)
        raise ValueError("no more")

    done = []
    with pytest.raises(ValueError, match="no more"):
        for_groups(done.append, groups(), jobs)
    assert sorted(done) == list(range(10))
