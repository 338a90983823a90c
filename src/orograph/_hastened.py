"""Makes Numba compile in 0.7 of the time, in a process that compiles kernels and ends.

Most of the time goes into Numba's own Python. Here a process leaves out what nobody looks at (events, machine code of
functions that are only linked into kernels) and remembers what Numba works out again and again. It compiles the same
kernels as any other process.
"""

from __future__ import annotations

import gc
import importlib.util
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from orograph._spared import spare_imports


def hasten() -> None:
    """Spare this process, which only compiles, a good quarter of Numba's time."""
    spare_imports()
    _load_packages_late()
    gc.set_threshold(100_000, 20, 20)  # a compiler's objects live long
    _compare_options_that_are_set()
    _tell_nobody()
    _remember_operators()
    _list_variables_quickly()
    _only_link_numbas_own()


class _LatePackage(ModuleType):
    """A package of ours whose ``__init__`` runs when something that it names is taken from the package."""

    def __getattr__(self, name: str) -> Any:
        loader = self.__spec__.loader if self.__spec__ else None
        assert isinstance(loader, SourceFileLoader)
        code = loader.get_code(self.__name__)
        if name.startswith("__") or "_begun" in vars(self) or code is None or name not in code.co_names:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")  # perhaps one of its modules
        self._begun = True
        loader.exec_module(self)
        return getattr(self, name)


def _load_packages_late() -> None:
    """A kernel needs its module, not all else that the module's package offers, like files and maps: 0.3 s."""
    root = Path(__file__).parent
    for init in root.glob("*/__init__.py"):
        name = f"{root.name}.{init.parent.name}"
        if name not in sys.modules:
            spec = importlib.util.spec_from_file_location(name, init, submodule_search_locations=[str(init.parent)])
            assert spec is not None
            sys.modules[name] = package = _LatePackage(name)
            package.__spec__, package.__path__, package.__file__ = spec, [str(init.parent)], str(init)
            package.__package__ = name
            setattr(sys.modules[root.name], init.parent.name, package)


def _compare_options_that_are_set() -> None:
    """Numba compares its options 500 times a kernel, and reads all 30 of them through properties."""
    from numba.core.targetconfig import TargetConfig

    def equal(self: Any, other: Any) -> bool:
        return isinstance(other, TargetConfig) and bool(self._values == other._values)

    def digest(self: Any) -> int:
        return hash(tuple(sorted(self._values)))

    cast(Any, TargetConfig).__eq__, cast(Any, TargetConfig).__hash__ = equal, digest


def _tell_nobody() -> None:
    """Numba reports each pass and each lock, but nobody listens."""
    from numba.core import event

    event.start_event = event.end_event = lambda *told, **more: None


def _remember_operators() -> None:
    """Remember which types an operator has for the types of its arguments.

    Numba tries one template after the other, those for text, sets and dates too, and words a message for each that does
    not match. Functions that it compiles for the arguments (``overload``) depend on options as well: these are left.
    """
    from numba.core.types.functions import BaseFunction

    resolve = BaseFunction.get_call_type

    def remembered(self: Any, context: Any, args: Any, kws: Any) -> Any:
        if kws:
            return resolve(self, context, args, kws)
        known: dict[Any, Any] = vars(self).setdefault("_known", {})
        types = tuple(args)
        if types in known:
            return known[types]
        found = resolve(self, context, args, kws)
        if found is not None and self._impl_keys.get(found.args) is self.typing_key:  # not compiled
            known[types] = found
        return found

    cast(Any, BaseFunction).get_call_type = remembered


def _list_variables_quickly() -> None:
    """Each pass asks each instruction for its variables, which lie among texts, numbers and places in the source."""
    from numba.core import ir

    others = {str, int, bool, float, type(None), ir.Loc}

    def listed(self: Any, held: Any) -> list[Any]:
        found: list[Any] = []
        for one in held.values() if isinstance(held, dict) else held:
            if type(one) in others:
                continue
            if isinstance(one, ir.Var):
                found.append(one)
            elif isinstance(one, ir.Inst):
                found += cast(Any, one).list_vars()
            elif isinstance(one, list | tuple | dict):
                found += listed(self, one)
        return found

    cast(Any, ir.Inst)._rec_list_vars = listed


def _only_link_numbas_own() -> None:
    """Only link the functions of NumPy that Numba writes in Python into kernels: neither Python nor C calls them."""
    from numba.core.compiler import Compiler

    from orograph._linked import Library

    define: Any = Compiler.define_pipelines

    def defined(self: Any) -> Any:
        state = self.state
        if state.library is None and state.func_id.modname.startswith("numba."):
            state.library = Library.of(state)
            state.flags.no_cfunc_wrapper = True
        return define(self)

    cast(Any, Compiler).define_pipelines = defined
