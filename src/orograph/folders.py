"""Where what was made of a user's files is kept from one run to the next, and how much of it. Units: bytes."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from orograph.errors import UsageError

CACHE_SIZE = "20GiB"
"""Of the cache folder, unless ``$OROGRAPH_CACHE_SIZE`` says otherwise."""

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}


def cache_folder() -> Path:
    """Stores of large DEMs, coarse levels of images: ``$OROGRAPH_CACHE``, else the platform's cache folder."""
    if chosen := os.environ.get("OROGRAPH_CACHE"):
        return Path(chosen)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "orograph"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "orograph" / "cache"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "orograph"


def cache_limit() -> int:
    """How many bytes the cache folder may hold.

    Raises:
        UsageError: ``$OROGRAPH_CACHE_SIZE`` is no size.
    """
    text = os.environ.get("OROGRAPH_CACHE_SIZE") or CACHE_SIZE
    try:
        return parse_bytes(text)
    except ValueError:
        raise UsageError(
            f"OROGRAPH_CACHE_SIZE is {text!r}, which is no size.", remedy="Write it like 20GiB, 512MiB or 2G."
        ) from None


def parse_bytes(text: str) -> int:
    """Bytes in "1GiB", "512 MiB", "1.5G" (10^9) or "4096".

    Raises:
        ValueError: not a number with one of these units, or less than one byte.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([kmgt]i?)?b?\s*", text, re.IGNORECASE)
    size = int(float(found[1]) * _UNITS[(found[2] or "").lower()]) if found else 0
    if size < 1:
        raise ValueError(f"{text!r} is not an amount of memory (write it like 1GiB, 512MiB or 2G)")
    return size
