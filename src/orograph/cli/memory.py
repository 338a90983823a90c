"""Memory use of a verb, and sizes for people."""

from __future__ import annotations

import sys
from pathlib import Path


def peak_memory() -> int | None:
    """The process's peak resident memory, bytes; None if the system does not report it."""
    try:  # Linux: unlike getrusage, this does not count the process that started this one
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def megabytes(size: int | None) -> str:
    """A size for people."""
    if size is None:
        return "unknown size"
    if size < 1e6:
        return f"{size / 1e3:.1f} kB"
    return f"{size / 1e6:.1f} MB" if size < 1e9 else f"{size / 1e9:.2f} GB"
