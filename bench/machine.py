"""What benchmarks ask of the operating system."""

from __future__ import annotations

import os


def before_all() -> None:
    """Give this process priority over all others."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except (AttributeError, PermissionError):
        raise SystemExit("--priority needs Linux and the right to set a real-time priority.") from None
