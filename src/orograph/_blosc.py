"""numcodecs' Blosc, also where another library breaks the import of numcodecs as a whole.

numcodecs imports every codec that it has, and one built against another NumPy (zfpy 1.0.1 and numcodecs 0.16) ends that
import with an error which is not an ImportError. Then it is imported as if that library were absent.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

_OPTIONAL = ("zfpy", "msgpack", "pcodec")
"""Libraries that numcodecs uses if they are there, and no store of ours needs."""

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
    kept = {name: sys.modules.pop(name) for name in _OPTIONAL if name in sys.modules}
    absent: dict[str, Any] = dict.fromkeys(_OPTIONAL)  # (None: "there is no such module")
    sys.modules.update(absent)
    try:
        return importlib.import_module("numcodecs.blosc")
    finally:
        for name in _OPTIONAL:
            del sys.modules[name]
        sys.modules.update(kept)


blosc = _load()
