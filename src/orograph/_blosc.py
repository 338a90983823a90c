"""Import numcodecs' Blosc even if another library breaks the import of numcodecs.

numcodecs imports all of its codecs. A codec whose library does not fit (such as zfpy built for another NumPy) may raise
an error that is not an ImportError. In that case numcodecs is imported as if that codec were absent.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

_OPTIONAL = ("numcodecs.zfpy", "numcodecs.msgpacks", "numcodecs.pcodec")
"""Codecs that need libraries of their own; no store uses them."""

broken: str | None = None
"""What broke the full import of numcodecs, if anything did."""


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
    absent: dict[str, Any] = dict.fromkeys(_OPTIONAL)  # (None means "no such module")
    sys.modules.update(absent)
    try:
        return importlib.import_module("numcodecs.blosc")
    finally:
        for name in _OPTIONAL:
            del sys.modules[name]


blosc = _load()
zstandard = importlib.import_module("numcodecs.zstd").Zstd()
