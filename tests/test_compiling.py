"""Kernels that are compiled are counted and timed apart from the work that needs them."""

from __future__ import annotations

import sys
import time

import pytest

from orograph import compiling
from orograph._needed import Kernel, needed
from orograph.cli.progress import COMPILING_KERNELS, LineProgress
from orograph.compiling import COMPILING


def compile_one(seconds: float = 0.0) -> None:
    """What Numba does when a kernel is called first."""
    import numba

    import orograph._numba  # noqa: F401 (it tells what is compiled)

    @numba.njit
    def inner(x: float) -> float:
        return x + 1.0

    @numba.njit
    def outer(x: float) -> float:
        return inner(x) * 2.0

    assert outer(3.0) == 8.0
    time.sleep(seconds)


def test_kernels_are_counted_with_what_they_compile_for_themselves() -> None:
    import numba

    import orograph._numba  # noqa: F401

    count, seconds = COMPILING.count, COMPILING.seconds
    begun = time.perf_counter()
    compile_one()
    assert COMPILING.count == count + 1
    assert 0.0 < COMPILING.seconds - seconds <= time.perf_counter() - begun

    @numba.njit
    def broken(x: float) -> float:
        return x.no_such_thing  # type: ignore[attr-defined]

    with pytest.raises(numba.TypingError):
        broken(1.0)
    assert COMPILING.count == count + 2 and COMPILING._here.depth == 0


def test_compiling_has_a_line_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    progress = LineProgress(least=0.01)
    with progress.task("All of it"), progress.task("Casting"):
        compile_one(0.05)
    first, casting, whole = capsys.readouterr().err.splitlines()
    assert first.startswith(COMPILING_KERNELS) and first.endswith(" kernel")
    assert casting.startswith("Casting") and whole.startswith("All of it")
    times = dict(progress.timings)
    assert times[COMPILING_KERNELS] > 0.01
    assert times["Casting"] == pytest.approx(0.05, abs=0.04) and times["All of it"] == pytest.approx(0.05, abs=0.04)
    with progress.task("Again"):
        time.sleep(0.02)
    assert capsys.readouterr().err.startswith("Again")


class Recorder:
    """What compilers are asked for, without any."""

    def __init__(self) -> None:
        self.expected: list[Kernel] = []

    def expect(self, kernels) -> None:
        self.expected += kernels

    def compile(self, kernel, request) -> bool:
        self.expected.append(kernel)
        return True


@pytest.fixture
def asked(monkeypatch):
    recorder = Recorder()
    monkeypatch.setattr(compiling, "_compilers", lambda: recorder)
    monkeypatch.setattr(compiling, "_worthwhile", lambda: True)
    monkeypatch.setattr(compiling, "_allowed", lambda: True)
    monkeypatch.setattr(compiling, "_TOLD", set())
    monkeypatch.setattr(compiling, "_EXPECTED", {})
    return recorder.expected


def test_what_the_cache_lacks_is_begun_with_the_work(asked, monkeypatch):
    monkeypatch.setattr(compiling, "lacking", lambda kernels: kernels[:2])
    compiling.expect("tin", "tin")
    compiling.expect("tin")
    assert asked == needed(["tin"])[:2]


def test_otherwise_the_first_kernel_that_is_missed_brings_the_others(asked, monkeypatch):
    from numba import types

    monkeypatch.setattr(compiling, "lacking", lambda kernels: [])
    compiling.expect("tin")
    assert asked == []
    for name in ("first", "second"):
        assert compiling.compiled_elsewhere("orograph.store.levels", name, (types.int64, types.unicode_type))
    kernels = [Kernel("orograph.store.levels", name, "(int64, unicode_type)") for name in ("first", "second")]
    assert asked == [*needed(["tin"]), *kernels]


@pytest.mark.parametrize(
    ("executable", "wanted", "expected"),
    [("/a/python3.12", "1", True), ("/a/python3.12", "0", False), ("/a/qgis", "1", False), (None, "1", False)],
)
def test_only_python_itself_is_started(monkeypatch, executable, wanted, expected):
    monkeypatch.setattr(sys, "executable", executable)
    monkeypatch.setenv("OROGRAPH_COMPILE_AHEAD", wanted)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1}, raising=False)
    assert compiling._worthwhile() is expected
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0}, raising=False)
    assert not compiling._worthwhile()


@pytest.mark.parametrize(("seconds", "starts"), [(0.5, False), (30.0, True)])
def test_a_long_first_run_has_the_rest_compiled(monkeypatch, seconds, starts):
    found = []
    monkeypatch.setattr(compiling, "run", lambda *command, **how: found.append((command, how)) or found)
    monkeypatch.setattr(compiling, "_worthwhile", lambda: True)
    monkeypatch.setattr(COMPILING, "seconds", seconds)
    assert compiling.compile_rest() is starts
    assert found == [(("orograph._compiler", "--rest", "0"), {"start_new_session": True})] * starts


def test_nothing_is_left_behind_where_nobody_sits(monkeypatch, capsys):
    from orograph import cli

    monkeypatch.setattr(compiling, "compile_rest", lambda: pytest.fail("started"))
    cli._compile_rest(quiet=False)  # (pytest's standard error is no terminal)
    assert capsys.readouterr().err == ""
