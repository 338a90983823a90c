"""numcodecs' Blosc, also where another library breaks the import of numcodecs as a whole.

numcodecs imports every codec that it has. One whose library does not fit (zfpy built for another NumPy) may end that
import with an error that is not an ImportError. Then numcodecs is imported as if that codec were absent.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

_OPTIONAL = ("numcodecs.zfpy", "numcodecs.msgpacks", "numcodecs.pcodec")
"""Codecs of libraries of their own, which no store of ours needs."""

broken: str | None = None
"""What kept numcodecs from being imported as a whole, if anything did."""


def _load() -> Any:
    global broken
    try:
        return importlib.import_module("numcodecs.blosc")
    except ImportError:
        raise
    except Exception as error:
        broken = f"{type(error).__name__}: {error}"
    for name in [m for m in sys.modules if m.partition(".")[0] == "numcodecs"]:
        del sys.modules[name]
    absent: dict[str, Any] = dict.fromkeys(_OPTIONAL)  # (None: "there is no such module")
    sys.modules.update(absent)
    try:
        return importlib.import_module("numcodecs.blosc")
    finally:
        for name in _OPTIONAL:
            del sys.modules[name]


blosc = _load()
zstandard = importlib.import_module("numcodecs.zstd").Zstd()
