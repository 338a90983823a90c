"""The kernels that works need, told before they begin: read and written alike, there, in order, and really needed."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from numba import types

from orograph import _needed
from orograph._compilers import Compilers
from orograph._needed import Kernel, lacking, lines, needed, types_of, written

BENCH = Path(__file__).parents[1] / "bench"

WORKS = {"ao", "build", "compare", "errors", "mesh", "render", "tessellate", "tin", "viewshed"}


def array(dtype: Any, dimensions: int = 1, **more: Any) -> Any:
    return types.Array(dtype, dimensions, "C", **more)


def test_types_are_read_as_they_are_written() -> None:
    from orograph.triangulation.mesh import Mesh

    mesh = types.NamedTuple((array(types.int32), array(types.boolean)), Mesh)
    given = (
        mesh, array(types.float32, 2, readonly=True), array(types.uint8, aligned=False), types.boolean, types.none,
        types.UniTuple(types.float64, 2), types.Tuple((types.float64, types.int64)), types.UniTuple(types.int64, 1),
    )  # fmt: skip
    assert types_of(written(given)) == given
    for odd in (types.unicode_type, types.literal(3), types.Omitted(None)):
        with pytest.raises(ValueError, match="no text"):
            written([odd])


def test_every_kernel_that_is_named_is_there() -> None:
    found = [kernel for _, kernel in lines()]
    assert len(set(found)) == len(found) > 80
    assert set().union(*(works for works, _ in lines())) == WORKS
    for kernel in found:
        called = getattr(importlib.import_module(kernel.module), kernel.name.removesuffix(".alone"))
        assert hasattr(called, "alone") == kernel.name.endswith(".alone")
        assert written(types_of(kernel.types)) == kernel.types
        assert Kernel.read(str(kernel)) == kernel
        parameters = called.py_func.__code__.co_argcount
        assert len(types_of(kernel.types)) == parameters, kernel


@pytest.mark.cases(1)
@pytest.mark.parametrize("work", ["viewshed", "tin"])
def test_what_is_named_is_what_a_work_calls(work: str) -> None:
    done = subprocess.run(
        [sys.executable, BENCH / "kernels.py", "--check", work], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.stress
def test_what_is_named_is_what_all_works_call() -> None:
    done = subprocess.run([sys.executable, BENCH / "kernels.py", "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_cache_lacks_what_has_no_index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_needed, "PACKAGE", tmp_path)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    one, other = Kernel("orograph.a.b", "c", "()"), Kernel("orograph.a.b", "d.alone", "()")
    (tmp_path / "a").mkdir()
    assert lacking([one, other]) == [one, other]
    folder = tmp_path / "a" / "__pycache__"
    folder.mkdir()
    version = f"py{sys.version_info[0]}{sys.version_info[1]}"
    (folder / f"b.c-12.{version}.nbi").touch()
    (folder / "b.d.alone-30.py27.nbi").touch()
    assert lacking([one, other]) == [other]
    monkeypatch.setattr(os, "access", lambda *_: False)  # Numba keeps them elsewhere then
    assert lacking([one, other]) == []
    monkeypatch.undo()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert lacking(needed(["tin"])) == []


class Slow(Compilers):
    """Compilers that only note what they are given, once they are let go."""

    def __init__(self, most: int) -> None:
        super().__init__(most)
        self.begun: list[str] = []
        self.go = threading.Semaphore(0)


@pytest.mark.parametrize("most", [1, 2])
def test_what_is_waited_for_goes_first_and_nothing_twice(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    from orograph import _compilers

    slow = Slow(most)

    def compile(self: object, request: bytes) -> bool:
        import pickle

        module, name, _ = pickle.loads(request)
        slow.begun.append(f"{module}.{name}")
        assert slow.go.acquire(timeout=10)
        return True

    monkeypatch.setattr(_compilers._Compiler, "compile", compile)
    kernels = [Kernel("m", name, types) for name, types in (("a", "()"), ("a", "(int64)"), ("b", "()"), ("c", "()"))]
    slow.expect(kernels)
    slow.expect(kernels)
    slow.go.release()
    urgent, made = Kernel("m", "z", "()"), []
    waits = threading.Thread(
        target=lambda: made.append(
            slow.compile(urgent, b"\x80\x04\x95\x0c\x00\x00\x00\x00\x00\x00\x00\x8c\x01m\x94\x8c\x01z\x94)\x87\x94.")
        )
    )
    waits.start()
    for _ in range(4):
        slow.go.release()
    waits.join(10)
    assert made == [True]
    assert all(slow.compile(kernel, b"") for kernel in kernels)
    assert sorted(slow.begun) == ["m.a", "m.a", "m.b", "m.c", "m.z"]
