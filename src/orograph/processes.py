"""Which process is at work: how its files name it, and whether it still runs."""

from __future__ import annotations

import os
import platform


def host() -> str:
    """The name of this machine, without what has no place in a file's name."""
    return "".join(c if c.isalnum() or c in "-_" else "-" for c in platform.node()) or "localhost"


def running(pid: int) -> bool:
    """Whether a process of this machine may still run. On Windows, where asking could end it: always True."""
    if os.name == "nt":
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's
        return True
    return True
