"""The one place that says how kernels are compiled (see docs/architecture.md, *Kernels*).

``@kernel`` releases the GIL and caches its machine code, so that a thread pool can run it on blocks of work;
``@inlined`` is for small helpers inside kernels. ``fastmath`` stays off: a tie or a floor may decide an index.
"""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Callable
from typing import Any, cast

import numba
import numba.core.event
import numba.extending
from numba.core.compiler_lock import global_compiler_lock

from orograph.compiling import COMPILING

Function = Callable[..., Any]


class _Listener(numba.core.event.Listener):
    """Reports what is compiled; kernels read from Numba's cache raise no event."""

    def on_start(self, event: object) -> None:
        COMPILING.begin()

    def on_end(self, event: object) -> None:
        COMPILING.end()


numba.core.event.register("numba:compile", _Listener())  # type: ignore[no-untyped-call]


def kernel(function: Function) -> Function:
    """Compile ``function`` on first call (nopython, no GIL, cached on disk, NumPy's rules for division)."""
    return _cached(numba.njit(nogil=True, cache=True, error_model="numpy")(function))


def inlined(function: Function) -> Function:
    """Compile a helper that is always inlined into the kernels that call it.

    LLVM inlines it. Numba's own inlining copies the helper's code into each caller before types are inferred, which
    takes ten times as long to compile and runs no faster. It makes no arrays, slices included.
    """
    options: Any = {"nogil": True, "error_model": "numpy", "forceinline": True, "no_cfunc_wrapper": True, "_nrt": False}
    return cast(Function, numba.njit(**options)(function))


def leaf(function: Function) -> Function:
    """Compile a kernel that makes no arrays, slices included, without counting references to those it is given.

    A small kernel that others call millions of times would spend most of its time on that.
    """
    options: dict[str, Any] = {"nogil": True, "cache": True, "error_model": "numpy", "_nrt": False}
    return _cached(numba.njit(**options)(function))


def _cached(dispatcher: Any) -> Function:
    """Make a dispatcher's cache start afresh if its index cannot be read, and ignore a full disk.

    Numba reads the whole index before it notices that the source has changed. An index that names a class that no
    longer exists (an argument's type in an older version) would make every call fail.
    """
    cache = getattr(dispatcher, "_cache", None)
    if cache is None:  # NUMBA_DISABLE_JIT leaves the function as it is
        return cast(Function, dispatcher)
    file = cache._cache_file
    load = file._load_index

    def load_index() -> Any:
        try:
            return load()
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError):
            return {}

    file._load_index = load_index
    save = cache.save_overload

    def save_overload(signature: object, data: object) -> None:
        with contextlib.suppress(OSError):  # what cannot be cached is compiled again next time
            save(signature, data)

    cache.save_overload = save_overload
    return cast(Function, dispatcher)


def paired(function: Function) -> Function:
    """Compile a ``leaf`` that does the same work on two things with vector instructions where possible (LLVM's SLP
    vectoriser). Numba turns it off because it has miscompiled before: use it only for kernels whose tests compare every
    bit."""
    dispatcher: Any = leaf(function)
    compile_plainly = dispatcher.compile

    def compile_paired(signature: object) -> object:
        config: Any = numba.config
        with global_compiler_lock:
            before = config.SLP_VECTORIZE
            config.SLP_VECTORIZE = 1
            try:
                return compile_plainly(signature)
            finally:
                config.SLP_VECTORIZE = before

    dispatcher.compile = compile_paired
    return cast(Function, dispatcher)


def shared(function: Function) -> Function:
    """Let kernels call a plain function; outside kernels it stays a plain function.

    LLVM does the inlining, which works as well as ``inlined`` for small functions and compiles in half the time.
    """
    numba.extending.register_jitable(error_model="numpy")(function)
    return function
