"""The one place that says how kernels are compiled (see docs/architecture.md, *Kernels*).

``@kernel`` releases the GIL and caches its machine code, so that a thread pool may run it on blocks of the work;
``@inlined`` is for the small helpers inside kernels. ``fastmath`` stays off: a tie or a floor may decide an index.

What Python calls is compiled by a process of its own (``compiling.compiled_elsewhere``) and loaded from Numba's cache:
compiling takes hundreds of MiB, which the work's process would keep.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numba.core.event
import numba.extending
from numba.core.bytecode import FunctionIdentity
from numpy.typing import NDArray

from orograph._kernel_cache import keep_safely
from orograph._linked import Linked
from orograph.compiling import COMPILING, compiled_elsewhere

Function = Callable[..., Any]
Array = TypeVar("Array", bound=NDArray[Any])


class _Listener(numba.core.event.Listener):
    """Reports what is compiled; kernels read from Numba's cache raise no event."""

    def on_start(self, event: object) -> None:
        COMPILING.begin()

    def on_end(self, event: object) -> None:
        COMPILING.end()


numba.core.event.register("numba:compile", _Listener())  # type: ignore[no-untyped-call]


def _name_apart() -> None:
    """Number the functions that this process compiles from a random number on.

    Numba tells functions of one name apart by counting them, and the number is part of their symbols: "run_quicksort1,
    the tenth" sorts in one process and finds the order in another. Loaded from the cache side by side, the kernels of
    both would call the one that is loaded first.
    """
    FunctionIdentity._unique_ids = itertools.count(int.from_bytes(os.urandom(6), "big"))


_name_apart()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_name_apart)


_PLAIN: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_BARE = _PLAIN | {"_nrt": False}


def kernel(function: Function) -> Function:
    """Compile ``function`` on first call (nopython, no GIL, cached on disk, NumPy's rules for division)."""
    return _called(function, _PLAIN)


def inlined(function: Function) -> Function:
    """Compile a helper that is always inlined into the kernels that call it.

    LLVM inlines it. Numba's own inlining copies the helper's code into each caller before types are inferred, which
    takes ten times as long to compile and runs no faster. It makes no arrays, slices included.
    """
    return _linked(function, _BARE | {"forceinline": True})


def leaf(function: Function) -> Function:
    """Compile a kernel that makes no arrays, slices included, without counting references to those it is given.

    A small kernel that others call millions of times would spend most of its time on that.
    """
    return _linked_and_kept(function, _BARE)


def linked(function: Function) -> Function:
    """Compile a part of kernels that makes arrays or slices, or is given some that they made."""
    return _linked_and_kept(function, _PLAIN)


def _linked_and_kept(function: Function, options: dict[str, Any]) -> Function:
    made: Any = _linked(function, options)
    if made is not function:
        made.enable_caching()
        keep_safely(made._cache)
    return cast(Function, made)


def _linked(function: Function, options: dict[str, Any]) -> Function:
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    return cast(Function, Linked(function, options, lambda code: _called(code, options)))


def _called(function: Function, options: dict[str, Any]) -> Function:
    """The dispatcher of a function that Python calls."""
    options = options | {"cache": True, "no_cfunc_wrapper": True}
    dispatcher: Any = numba.njit(**options)(function)
    if hasattr(dispatcher, "_cache"):  # NUMBA_DISABLE_JIT leaves the function as it is
        keep_safely(dispatcher._cache)
        _compile_elsewhere(dispatcher)
    return cast(Function, dispatcher)


def _compile_elsewhere(dispatcher: Any) -> None:
    """Have another process compile what is not in the cache; this one does if it cannot."""
    function, context = dispatcher.py_func, dispatcher.targetctx
    compile_here = dispatcher._compiler.compile

    def compile(types: tuple[Any, ...], returned: object) -> Any:
        if returned is None and compiled_elsewhere(function.__module__, function.__qualname__, types):
            found = dispatcher._cache.load_overload(types, context)
            if found is not None:
                context.insert_user_function(found.entry_point, found.fndesc, [found.library])
                return found
        return compile_here(types, returned)

    dispatcher._compiler.compile = compile


def paired(function: Function) -> Function:
    """Compile a ``leaf`` that Python calls, whose work on two like things is done by vector instructions where that can
    be (LLVM's SLP vectoriser). Numba leaves it off, for it has miscompiled before: only for kernels whose tests compare
    every bit.
    """
    dispatcher: Any = _called(function, _BARE)
    if not hasattr(dispatcher, "_compiler"):
        return cast(Function, dispatcher)
    compile_plainly = dispatcher._compiler.compile

    def compile_paired(types: tuple[Any, ...], returned: object) -> object:
        config: Any = numba.config
        before, config.SLP_VECTORIZE = config.SLP_VECTORIZE, 1
        try:
            return compile_plainly(types, returned)
        finally:
            config.SLP_VECTORIZE = before

    dispatcher._compiler.compile = compile_paired
    return cast(Function, dispatcher)


def read_only(array: Array) -> Array:
    """A view that may not be written to. Numba compiles a kernel anew for such arrays, and heights are some of them:
    what kernels only read is always given to them so.
    """
    view = array.view()
    view.flags.writeable = False
    return view


def shared(function: Function) -> Function:
    """Let kernels call a plain function; outside kernels it stays a plain function.

    LLVM does the inlining, which works as well as ``inlined`` for small functions and compiles in half the time.
    """
    numba.extending.register_jitable(error_model="numpy")(function)
    return function
