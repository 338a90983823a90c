"""Kernels that are compiled are counted and timed apart from the work that needs them."""

from __future__ import annotations

import time

import pytest

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
