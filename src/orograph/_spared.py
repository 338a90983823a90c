"""Keeps libraries from loading what a process of Orograph's own does not use."""

from __future__ import annotations

import importlib.abc
import sys
from pathlib import Path


def spare_imports(s3: bool = False) -> None:
    """Spare half a second of a two-second command.

    Numba loads SciPy's linear algebra with its first kernel, for matrix products that no kernel here has, and YAML for
    a settings file; rasterio loads boto3, if it is installed, to sign requests to S3. They cope with its absence. Only
    the command line and compilers do this, never the library: their processes are ours alone.
    """
    hidden = ["scipy"]
    if not Path(".numba_config.yaml").exists():
        hidden.append("yaml")
    if not s3:
        hidden.append("boto3")
    absent = [name for name in hidden if name not in sys.modules]

    class Spared(importlib.abc.MetaPathFinder):
        def find_spec(self, fullname: str, path: object, target: object = None) -> None:
            if fullname in absent and _asked_by("numba", "rasterio"):
                raise ImportError(f"{fullname} is not needed here")

    sys.meta_path.insert(0, Spared())


def _asked_by(*packages: str) -> bool:
    """Whether the current import statement is in one of ``packages``."""
    frame = sys._getframe(2)
    while frame is not None and frame.f_globals.get("__name__", "").startswith(("importlib", "_frozen_importlib")):
        frame = frame.f_back  # type: ignore[assignment]
    return frame is not None and frame.f_globals.get("__name__", "").split(".")[0] in packages
