"""Caches of compiled kernels, from one version of a source to the next."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

SOURCE = """
from typing import NamedTuple
from orograph._numba import kernel

class NAME(NamedTuple):
    value: float

@kernel
def doubled(given):
    return 2.0 * given.value

print(doubled(NAME(21.0)))
"""


@pytest.mark.stress
def test_an_argument_may_have_another_type_in_the_next_version(tmp_path: Path) -> None:
    """The cache's index still names the class that there was: nobody should have to remove it."""
    for name in ("Before", "After"):
        (tmp_path / "kernels.py").write_text(SOURCE.replace("NAME", name))
        done = subprocess.run([sys.executable, "-c", "import kernels"], cwd=tmp_path, capture_output=True, text=True)
        assert done.stdout == "42.0\n", done.stderr
    assert list(tmp_path.glob("__pycache__/*.nbi"))


def test_a_full_disk_keeps_no_kernel_and_stops_none(tmp_path: Path) -> None:
    pytest.importorskip("resource")
    (tmp_path / "kernels.py").write_text(SOURCE.replace("NAME", "Given"))
    full = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)); import kernels"
    done = subprocess.run([sys.executable, "-c", full], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "42.0\n", done.stderr


def run(code: str, cache: Path, **environment: str) -> str:
    """What a program prints, with Numba's cache in a folder."""
    cache.mkdir(exist_ok=True)
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True,
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)} | environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


SUMS = """
    import numpy as np
    from orograph import _compilers, compiling
    from orograph.compiling import COMPILING
    from orograph.store.levels import box_sums

    heights, total, count = np.arange(16, dtype=np.float32).reshape(4, 4), np.zeros((2, 2)), np.zeros((2, 2), np.uint32)
    {before}
    box_sums(heights, total, count)
    assert total.tolist() == [[10, 18], [42, 50]] and (count == 4).all()
    compiled = next(iter(box_sums.overloads.values()))
    print(compiled.metadata is not None, COMPILING.count)
"""
"""(Numba keeps metadata of what this process compiled; a cache has none.)"""


def test_kernels_are_compiled_by_another_process(tmp_path: Path) -> None:
    code = SUMS.format(before="")
    assert run(code, tmp_path) == "False 1\n"
    assert run(code, tmp_path) == "False 0\n"
    assert run(code, tmp_path / "here", OROGRAPH_COMPILE_AHEAD="0") == "True 1\n"


@pytest.mark.stress
def test_a_compiler_that_was_ended_is_started_again(tmp_path: Path) -> None:
    ended = """
    processes, piped = [], _compilers.piped
    _compilers.piped = lambda program: processes.append(piped(program)) or processes[-1]
    assert not compiling.compiled_elsewhere("orograph.store.levels", "there_is_none", ())
    processes[0].kill()"""
    assert run(SUMS.format(before=ended), tmp_path) == "False 1\n"


@pytest.mark.parametrize(
    "before",
    ["_compilers._Compiler.compile = lambda self, request: False", "_compilers._Compiler._ask = lambda *request: b''"],
)
def test_what_no_other_process_compiles_is_compiled_here(tmp_path: Path, before: str) -> None:
    assert run(SUMS.format(before=before), tmp_path) == "True 1\n"


def test_a_compiler_that_does_not_start_is_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    from orograph import _compilers

    started = []
    piped = _compilers.piped
    monkeypatch.setattr(_compilers, "piped", lambda program: started.append(program) or piped("there.is.none"))
    compiler = _compilers._Compiler()
    assert not compiler.compile(b"") and not compiler.compile(b"")
    assert len(started) == 2


@pytest.mark.stress
def test_what_is_interrupted_is_compiled_all_the_same(tmp_path: Path) -> None:
    interrupted = """
    import signal, threading, time, os
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    try:
        box_sums(heights.astype(np.float64), total, count)
        time.sleep(9)
    except KeyboardInterrupt:
        pass
    total[:], count[:] = 0, 0"""
    assert run(SUMS.format(before=interrupted), tmp_path).startswith("False")


@pytest.mark.stress
def test_a_forked_process_has_compilers_of_its_own(tmp_path: Path) -> None:
    forked = """
    import os
    assert not compiling.compiled_elsewhere("orograph.store.levels", "there_is_none", ())
    child = os.fork()
    if child:
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        os._exit(0)
    """
    if hasattr(os, "fork"):
        assert run(SUMS.format(before=forked), tmp_path) == "False 1\n"


LINKED = """
    import numpy as np
    from numba import config
    from orograph._numba import inlined, kernel, leaf, paired

    @inlined
    def squared(x):
        return x * x

    @leaf
    def sum_of_squares(values, least=0.0):
        total = least
        for i in range(len(values)):
            total += squared(values[i])
        return total

    @kernel
    def rows(table):
        sums = np.empty(len(table))
        for i in range(len(table)):
            sums[i] = sum_of_squares(table[i], 1.0)
        return sums

    @paired
    def halved(values):
        for i in range(len(values)):
            values[i] /= 2.0

    table = np.arange(6.0).reshape(2, 3)
    halved(table[0])
    print(rows(table).tolist(), sum_of_squares(table[1]), sum_of_squares(values=table[1], least=2.0), squared(3.0))
"""
"""(halved: 0, 0.5, 1)"""


@pytest.mark.stress
def test_a_helper_gives_the_same_within_a_kernel_and_to_python(tmp_path: Path) -> None:
    """Compiled, read from the cache, and not compiled at all."""
    (tmp_path / "helpers.py").write_text(textwrap.dedent(LINKED))
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import helpers"
    expected = "[2.25, 51.0] 50.0 52.0 9.0\n"
    for environment in ({}, {}, {"NUMBA_DISABLE_JIT": "1"}):
        assert run(code, tmp_path / "cache", **environment) == expected


def test_a_helper_within_kernels_has_no_machine_code(tmp_path: Path) -> None:
    """That is what saves the time: its object file holds no function."""
    code = (
        LINKED
        + """
    linked = next(iter(sum_of_squares.overloads.values())).library
    assert not linked.get_pointer_to_function(linked.name)
    assert not [f for f in linked._final_module.functions if not f.is_declaration]
    assert [f for f in linked._get_module_for_linking().functions if not f.is_declaration]
    """
    )
    (tmp_path / "helpers.py").write_text(textwrap.dedent(code))
    run(f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import helpers", tmp_path / "cache")


def test_a_hastened_compiler_tells_numbas_options_apart(tmp_path: Path) -> None:
    code = """
    from numba.core.compiler import Flags
    from orograph._hastened import hasten
    hasten()
    one, other = Flags(), Flags()
    one.error_model, other.error_model = "numpy", "python"
    assert one == one.copy() and one != other and hash(one) == hash(one.copy()) and one != "numpy"
    """
    assert run(code, tmp_path) == ""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Each module is loaded by a copy of one process.")
def test_a_hastened_compiler_loads_the_module_of_any_kernel(tmp_path: Path) -> None:
    """Whichever is first, and all in turn. (What it could not load, the process that asked would compile silently.)"""
    code = """
    import importlib, os
    from orograph._hastened import hasten
    from orograph._needed import lines
    hasten()
    import numba
    modules = list(dict.fromkeys(kernel.module for _, kernel in lines()))
    for module in modules:
        if os.fork() == 0:
            importlib.import_module(module)
            os._exit(7)
        assert os.waitstatus_to_exitcode(os.wait()[1]) == 7, module
    for module in modules:
        importlib.import_module(module)
    import orograph.store
    assert orograph.store.build.__module__ == "orograph.store.build"
    """
    assert run(code, tmp_path) == ""


def test_a_hastened_compiler_finds_the_same_types_and_variables(tmp_path: Path) -> None:
    """Also the second time, when it remembers them."""
    code = """
    import itertools, operator
    from numba import types
    from numba.core import compiler
    from numba.core.registry import cpu_target
    from orograph._hastened import hasten

    def example(a, n):
        found = [0.0, float(n)]
        for i in range(n):
            if a[i, 0] > max(found[0], 1.0) and not a[0, i] < 0:
                found[0], a[i, 1] = a[i, 0], -found[1]
        return tuple(found), {"a": a[1:, 2]}

    scalars = [types.int64, types.uint8, types.float32, types.float64, types.boolean, types.literal(3), types.int32]
    array = types.Array(types.float32, 2, "C")
    given = [*itertools.product(scalars, scalars), (array, types.int64), (array, types.UniTuple(types.int64, 2))]
    operators = [getattr(operator, name) for name in (
        "add sub mul truediv floordiv mod pow lt le eq and_ or_ lshift rshift iadd neg not_ getitem").split()]

    def facts():
        context = cpu_target.typing_context
        context.refresh()
        for operator_, types_ in itertools.product(operators, given):
            types_ = types_[: 1 if operator_ in (operator.neg, operator.not_) else 2]
            try:
                found = context.resolve_function_type(operator_, types_, {})
            except Exception as error:
                found = type(error)
            yield operator_.__name__, types_, found
        for block in compiler.run_frontend(example).blocks.values():
            for step in block.body:
                yield str(step), [variable.name for variable in step.list_vars()]

    before = list(facts())
    hasten()
    assert len(before) > 400 and list(facts()) == before and list(facts()) == before
    """
    assert run(code, tmp_path) == ""


SLICES = """
    import numba, numpy as np, sys
    from orograph._hastened import hasten
    from orograph._numba import kernel, linked
    if len(sys.argv) > 1:
        hasten()

    @linked
    def halved(row, most):
        tail = row[1:]
        return np.sort(tail)[: len(tail) // most].sum()

    def work(a):
        found = np.zeros((2, len(a)))
        for i in range(len(a)):
            found[0, i] = halved(a[i], 2)
            found[1, i] = max(np.abs(a[i]).max(), a[i, 0], 0.5)
        return found

    a = np.random.default_rng(1).normal(size=(5, 9))
    code = kernel(work)
    assert (code(a) == work(a)).all() and len(halved.overloads) == 1
    assert halved(a[0], 3) == halved.py_func(a[0], 3)
    assert not any(list(one.library.get_defined_functions()) for one in halved.overloads.values())  # of machine code
"""


@pytest.mark.cases(1)
@pytest.mark.parametrize("more", ["", "import sys; sys.argv.append('hastened')"])
def test_what_is_only_linked_works_alone_too(tmp_path: Path, more: str) -> None:
    """And with NumPy's functions, of which a hastened compiler makes no machine code."""
    (tmp_path / "kernels.py").write_text(textwrap.dedent(SLICES))
    code = f"{more}\nimport sys; sys.path.insert(0, {str(tmp_path)!r}); import kernels"
    assert run(code, tmp_path / "cache", OROGRAPH_COMPILE_AHEAD="0") == ""


SORTED = """
import os, re, sys
import numpy as np
from orograph._numba import kernel

@kernel
def order(x):
    return np.argsort(x)

child = "fork" in sys.argv and os.fork()
if child:
    os.wait()
assert order(np.array([3.0, 1.0, 2.0], np.float32 if child else np.float64)).tolist() == [1, 2, 0]
code = next(iter(order.overloads.values())).library.get_llvm_str()
print(re.search(r"run_quicksort1B[0-9]*v([0-9]+)", code)[1], flush=True)
"""


@pytest.mark.cases(1)
@pytest.mark.parametrize("processes", [["alone", "alone"], ["fork"]][: 1 + hasattr(os, "fork")])
def test_no_two_processes_give_their_functions_the_same_names(tmp_path: Path, processes: list[str]) -> None:
    """Kernels of two processes are loaded side by side: one that asked for an order was given its values, sorted."""
    (tmp_path / "kernels.py").write_text(SORTED)
    names = []
    for k, process in enumerate(processes):
        code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); sys.argv.append({process!r}); import kernels"
        names += run(code, tmp_path / str(k)).split()
    assert len(names) == len(set(names)) == 2


KEPT = """
import pathlib, sys, time
from orograph._kernel_cache import _Files, keep_safely

folder, who, other = sys.argv[1:]
files = _Files(keep_safely, folder, "kernels.f-1.py311", "a stamp")
pathlib.Path(folder, who).touch()
while not pathlib.Path(folder, other).exists():
    time.sleep(0.001)
for k in range(100):
    files.save((who, k), (who, k))
"""


def test_processes_that_keep_kernels_at_once_keep_all(tmp_path: Path) -> None:
    """Each by its own name, though Numba counts files, and nothing that no index names."""
    from orograph._kernel_cache import _Files, keep_safely

    writers = [subprocess.Popen([sys.executable, "-c", KEPT, tmp_path, *both]) for both in ("ab", "ba")]
    assert [writer.wait() for writer in writers] == [0, 0]
    files = _Files(keep_safely, str(tmp_path), "kernels.f-1.py311", "a stamp")
    for key in [(who, k) for who in "ab" for k in range(100)]:
        assert files.load(key) == key
    assert len(list(tmp_path.glob("*.nbc"))) == 200
    _Files(keep_safely, str(tmp_path), "kernels.f-1.py311", "the next stamp").save("a", 1)
    assert len(list(tmp_path.glob("*.nbc"))) == 1


def test_a_kernel_is_compiled_by_one_process_at_a_time(tmp_path: Path) -> None:
    """The next one finds it in the cache."""
    code = """
    from orograph._compiler import compile_kernel
    from orograph.store.levels import box_sums
    compile_kernel("orograph.store.levels", "box_sums", "(float32[2, C], float64[2, C], uint32[2, C])")
    print(sum(box_sums.stats.cache_hits.values()))
    """
    with ThreadPoolExecutor() as pool:
        printed = pool.map(lambda _: run(code, tmp_path, OROGRAPH_COMPILE_AHEAD="0"), range(2))
        assert sorted(printed) == ["0\n", "1\n"]


PARTS = {
    "kernels": """
from orograph._numba import kernel
from parts import numbers
from parts.helpers import scaled

@kernel
def f(x):
    return scaled(x) + numbers.MORE

print(f(1.0), sum(f.stats.cache_hits.values()))
""",
    "helpers": """
from orograph._numba import leaf
from parts.numbers import TIMES

@leaf
def scaled(x):
    return x * TIMES
""",
    "numbers": "TIMES, MORE = 2.0, 1.0",
}


def test_a_kernel_is_compiled_anew_when_anything_that_it_is_made_of_changes(tmp_path: Path) -> None:
    """Numba looks at its own file alone."""
    (tmp_path / "parts").mkdir()
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import parts.kernels"

    def printed(**parts: str) -> str:
        for name, source in parts.items():
            (tmp_path / "parts" / f"{name}.py").write_text(source)
        return run(code, tmp_path / "cache", PYTHONDONTWRITEBYTECODE="1")

    assert printed(**PARTS) == "3.0 0\n"
    assert printed() == "3.0 1\n"
    assert printed(helpers=PARTS["helpers"].replace("x * TIMES", "x * TIMES * 2.0")) == "5.0 0\n"
    assert printed(numbers="TIMES, MORE = 3.0, 1.0") == "7.0 0\n"
    assert printed(numbers="TIMES, MORE = 3.0, 4.0") == "10.0 0\n"
    assert printed() == "10.0 1\n"
