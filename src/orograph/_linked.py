"""Functions that are compiled only to be linked into the kernels that call them.

Numba compiles each function of a kernel as if Python called it: optimises it in full, writes its machine code and wraps
it for Python, and optimises it again within every kernel that it is linked into. A ``Linked`` function ends as
intermediate code, which takes less time and memory; the kernel is optimised as a whole.
"""

from __future__ import annotations

import functools
import types
from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher
from numba.core.types import unliteral

Function = Callable[..., Any]


class Library(JITCodeLibrary):
    """Intermediate code. What Numba takes for its machine code are the variables that every function's code has."""

    @classmethod
    def of(cls, state: Any) -> Library:
        """The library of a function that is to be compiled."""
        made = cls(state.targetctx.codegen(), state.func_id.func_qualname)
        made.enable_object_caching()
        return made

    def _optimize_final_module(self) -> None:
        """Left to the kernel."""

    def _finalize_final_module(self) -> None:
        self._finalized = True
        code = self._get_module_for_linking()
        head = [f'target triple = "{code.triple}"', f'target datalayout = "{code.data_layout}"']
        names = [variable.name for variable in code.global_variables if variable.name.startswith("_ZN08NumbaEnv")]
        body = [f'@"{name}" = common global i64 0' for name in names]  # pointers
        self._final_module = llvm.parse_assembly("\n".join(head + body))
        self._final_module.name = code.name
        super()._finalize_final_module()


class _Compiler(Compiler):
    """Numba's, that writes into such a library."""

    def define_pipelines(self) -> Any:
        self.state.library = Library.of(self.state)
        return super().define_pipelines()


class Linked(CPUDispatcher):
    """A function that kernels link in. What Python calls is ``alone``, a kernel of the same code."""

    def __init__(self, function: Function, options: dict[str, Any], kernel: Callable[[Function], Function]) -> None:
        self._inline = bool(options.get("forceinline"))
        own = {"nopython": True, "boundscheck": None, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(function, targetoptions=options | own, pipeline_class=_Compiler)
        self._kernel = kernel

    @functools.cached_property
    def alone(self) -> Any:
        """The kernel; its own name gives it its own files in Numba's cache."""
        code = self.py_func
        copy = types.FunctionType(code.__code__, code.__globals__, code.__name__, code.__defaults__, code.__closure__)
        copy.__module__, copy.__qualname__ = code.__module__, f"{code.__qualname__}.alone"
        return self._kernel(copy)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Inlined code knows constants among its arguments anyway: it is compiled once for all of them."""
        if self._inline:
            args, kws = tuple(map(unliteral, args)), {name: unliteral(type_) for name, type_ in kws.items()}
        return super().get_call_template(args, kws)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return self.alone(*arguments, **named)

    @property
    def signatures(self) -> list[Any]:
        """Of both."""
        return list(self.overloads) + list(self.alone.overloads)
