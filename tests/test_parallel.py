"""Threads: a crew is called again and again, survives errors, and goes when nobody holds it."""

from __future__ import annotations

import gc
import threading
import time

from orograph.parallel import Crew


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
