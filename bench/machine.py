"""What benches ask of the machine."""

from __future__ import annotations

import os


def before_all() -> None:
    """Threads of this process run as soon as they can, whatever else wants to."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except (AttributeError, PermissionError):
        raise SystemExit("--priority needs Linux and the right to set a real-time priority.") from None
