"""Which kernels which work needs: ``kernels.txt``, for compilers to begin before a kernel is called.

``python bench/kernels.py`` writes that file from what small hills really call. A line is a kernel with the types of its
arguments, and the works that need it (none: only now and then); the largest come first::

    build tessellate: orograph.error.octaves.overlap(float32[2, C], int64, orograph.geo.Some(bool, float64))

This module imports nothing of the package. Numba is loaded only where types are made of names, or names of types.
"""

from __future__ import annotations

import ast
import functools
import importlib
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

PACKAGE = Path(__file__).parent


class Kernel(NamedTuple):
    """A kernel for arguments of certain types.

    Attributes:
        module: its module. name: its qualified name. types: those of its arguments, as ``written`` writes them.
    """

    module: str
    name: str
    types: str

    @classmethod
    def read(cls, text: str) -> Kernel:
        """The kernel that a line names."""
        path, types = text.split("(", 1)
        module, name = path.rsplit(".", 2 if path.endswith(".alone") else 1)[0], path
        return cls(module, name[len(module) + 1 :], f"({types}")

    def __str__(self) -> str:
        return f"{self.module}.{self.name}{self.types}"


@functools.cache
def lines() -> tuple[tuple[frozenset[str], Kernel], ...]:
    """The file: works and the kernel that they need."""
    found = []
    for line in (PACKAGE / "kernels.txt").read_text().splitlines():
        works, kernel = line.split(":", 1)
        found.append((frozenset(works.split()), Kernel.read(kernel.strip())))
    return tuple(found)


def needed(works: Iterable[str]) -> list[Kernel]:
    """The kernels that any of these works needs, the largest first."""
    wanted = set(works)
    return [kernel for tags, kernel in lines() if tags & wanted]


def lacking(kernels: Iterable[Kernel]) -> list[Kernel]:
    """Those of these kernels that Numba's cache beside the package surely lacks.

    Where the cache may lie elsewhere, none: Numba itself has to look.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        return []
    found, folders = [], dict[Path, frozenset[str] | None]()
    for kernel in kernels:
        *way, stem = kernel.module.split(".")[1:]
        folder = PACKAGE.joinpath(*way, "__pycache__")
        if folder not in folders:
            folders[folder] = _indices(folder)
        indices = folders[folder]
        if indices is not None and f"{stem}.{kernel.name}" not in indices:
            found.append(kernel)
    return found


def _indices(folder: Path) -> frozenset[str] | None:
    """The functions that Numba has an index of in a folder; None where it may not write one."""
    end = f".py{sys.version_info[0]}{sys.version_info[1]}{sys.abiflags if hasattr(sys, 'abiflags') else ''}.nbi"
    try:
        names = [file.name for file in folder.iterdir()]
    except OSError:
        return frozenset() if os.access(folder.parent, os.W_OK) else None
    if not os.access(folder, os.W_OK):
        return None
    return frozenset(name.rsplit("-", 1)[0] for name in names if name.endswith(end))


def written(types: Iterable[Any]) -> str:
    """Numba's types of arguments as text.

    Raises:
        ValueError: one is of a kind that has no text.
    """
    return f"({', '.join(map(_written, types))})"


def _written(type_: Any) -> str:
    types = _numba_types()
    if isinstance(type_, types.Array) and isinstance(type_.dtype, types.Number | types.Boolean):
        remarks = ["r"] * (not type_.mutable) + ["u"] * (not type_.aligned)
        return f"{type_.dtype}[{', '.join([str(type_.ndim), type_.layout, *remarks])}]"
    if isinstance(type_, types.BaseNamedTuple):
        made = type_.instance_class
        return f"{made.__module__}.{made.__qualname__}{written(type_)}"
    if isinstance(type_, types.BaseTuple):
        return f"({''.join(f'{_written(one)}, ' for one in type_)})"
    if isinstance(type_, types.Number | types.Boolean | types.NoneType) and not isinstance(type_, types.Literal):
        return str(type_)
    raise ValueError(f"{type_} has no text.")


def types_of(text: str) -> tuple[Any, ...]:
    """The types that ``written`` wrote."""
    call = ast.parse(f"_{text}", mode="eval").body
    assert isinstance(call, ast.Call)
    return tuple(map(_read, call.args))


def _read(node: ast.expr) -> Any:
    types = _numba_types()
    match node:
        case ast.Name(name):
            return getattr(types, name)
        case ast.Subscript(value, ast.Tuple([ast.Constant(dimensions), ast.Name(layout), *remarks])):
            said = {remark.id for remark in remarks if isinstance(remark, ast.Name)}
            return types.Array(_read(value), dimensions, layout, readonly="r" in said, aligned="u" not in said)
        case ast.Call(ast.Attribute() as path, args):
            module, name = ast.unparse(path).rsplit(".", 1)
            made = getattr(importlib.import_module(module), name)
            return types.BaseTuple.from_types([_read(one) for one in args], made)
        case ast.Tuple(items):
            return types.BaseTuple.from_types([_read(one) for one in items])
    raise ValueError(f"{ast.unparse(node)} is no type.")


def _numba_types() -> Any:
    """Numba's module of types (most of it is untyped)."""
    return importlib.import_module("numba.core.types")
