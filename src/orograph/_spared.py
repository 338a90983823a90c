"""Keeps libraries from loading what a process of Orograph's own does not use."""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any


def spare_imports(s3: bool = False) -> None:
    """Spare half a second of a two-second command; collect garbage rarely.

    Numba loads SciPy's linear algebra with its first kernel, for matrix products that no kernel here has, cffi for
    functions of C that none calls, and YAML for a settings file; rasterio loads boto3, if it is installed, to sign
    requests to S3. They cope with its absence. pyproj loads what downloads grids and reports versions (urllib, OpenSSL,
    email); here that is loaded when it is called. Only the command line and compilers do this, never the library: their
    processes are ours alone.
    """
    gc.set_threshold(250_000, 2, 5)  # modules and kernels are some 200,000 objects, nearly all of which stay
    hidden = ["scipy", "cffi"]
    if not Path(".numba_config.yaml").exists():
        hidden.append("yaml")
    if not s3:
        hidden.append("boto3")
    absent = [name for name in hidden if name not in sys.modules]

    class Spared:
        @staticmethod
        def find_spec(fullname: str, path: object, target: object = None) -> None:
            if fullname in absent and _asked_by("numba", "rasterio"):
                raise ImportError(f"{fullname} is not needed here")

    sys.meta_path.insert(0, Spared)
    if "pyproj" not in sys.modules:
        _load_when_called("pyproj.sync", "_download_resource_file")
        _load_when_called("pyproj._show_versions", "show_versions")


def _asked_by(*packages: str) -> bool:
    """Whether the current import statement is in one of ``packages``."""
    frame = sys._getframe(2)
    while frame is not None and frame.f_globals.get("__name__", "").startswith(("importlib", "_frozen_importlib")):
        frame = frame.f_back  # type: ignore[assignment]
    return frame is not None and frame.f_globals.get("__name__", "").split(".")[0] in packages


def _load_when_called(module: str, function: str) -> None:
    """Have a module loaded when this function of it is called, or when anything else of it is imported."""

    def real(name: str) -> Any:
        if name.startswith("__"):  # which the import system looks for
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        if sys.modules.get(module) is stand_in:
            del sys.modules[module]
        return getattr(importlib.import_module(module), name)

    def call(*args: Any, **options: Any) -> Any:
        called: Callable[..., Any] = real(function)
        return called(*args, **options)

    stand_in = ModuleType(module)
    stand_in.__dict__.update({function: call, "__getattr__": real})
    sys.modules[module] = stand_in
