"""Whether a picture's own arrays fit into memory: checked before any work, because a killed process reports nothing.

Units: bytes.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from orograph.errors import UsageError
from orograph.store.memory import MemoryTerrain
from orograph.store.terrain import Terrain

BYTES_PER_PIXEL = 50
"""Of a picture while it is drawn: depth, window, void fill, linear light, bytes and masks."""


ON_GPU = 100
"""Bytes per pixel where a GPU draws; a software driver's textures are among them."""
DRIVER = 320 << 20
"""Bytes that a software driver takes with its compiler."""
TILED = 704 << 20
"""Bytes that a tiled picture takes with a software driver, whatever is allowed."""


WORKER = 512 << 20
"""Bytes of a worker's process that draws: the interpreter, its libraries, compiled kernels, and what Dask has."""


def worker_memory(pixels: int, terrain: Terrain, allowed: int) -> int:
    """Bytes that a worker takes to draw ``pixels`` pixels of a terrain at a time, besides ``WORKER``.

    Args:
        allowed: bytes that it may take in all, if that is enough.
    """
    # Heights in memory, with what is made of them; or the cache of a store, and windows of its heights.
    held = 3 * terrain.heights.nbytes if isinstance(terrain, MemoryTerrain) else 64 << 20
    return max(BYTES_PER_PIXEL * pixels + held + (256 << 20), allowed - WORKER)


def band_pixels(max_memory: int | None, *, gpu: bool = False) -> int:
    """Pixels of a large picture that are drawn at a time, 4 million at most: those of an eighth of the memory allowed,
    on a GPU of a quarter of what a software driver leaves."""
    if max_memory is None:
        return 4 << 20
    if gpu:
        return max(min(4 << 20, (max_memory - DRIVER) // 4 // ON_GPU), 1 << 18)
    return min(4 << 20, max_memory // 8 // BYTES_PER_PIXEL)


def check_memory(size: tuple[int, int], max_memory: int | None = None) -> None:
    """Raise UsageError if a picture of this size cannot be drawn in the allowed or available memory.

    Args:
        size: (width, height).
        max_memory: bytes; None: whatever the machine has free.
    """
    needed = BYTES_PER_PIXEL * size[0] * size[1]
    free = available()
    if free is not None and needed > free:
        limit, whose, remedy = free, "are free on this machine", "Make it smaller."
    elif max_memory is not None and needed > max_memory:
        limit, whose = max_memory, "may be used (`max_memory`)"
        remedy = "Allow more, or make it smaller."
    else:
        return
    raise UsageError(
        f"A picture of {size[0]} × {size[1]} pixels takes {amount(needed)} of memory while it is drawn, and "
        f"{amount(limit)} {whose}.",
        remedy=remedy,
    )


def amount(size: int) -> str:
    """Human-readable bytes: "1.5 GiB"."""
    value = float(size)
    for unit in ("bytes", "KiB", "MiB", "GiB"):
        if value < 1024:
            return f"{value:.3g} {unit}"
        value /= 1024
    return f"{value:,.4g} TiB"


def available() -> int | None:
    """Bytes that a process may still take: free memory, or the limit of its control group; None if unknown."""
    found: list[int] = []
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                found.append(int(line.split()[1]) * 1024)
    with contextlib.suppress(OSError, ValueError):  # "max" is no number
        found.append(int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    if not found and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min(found, default=None)
