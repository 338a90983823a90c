"""Identify the running process: its name in files, and whether it is still alive."""

from __future__ import annotations

import os
import platform


def host() -> str:
    """The name of this machine, without characters that do not belong in a file name."""
    return "".join(c if c.isalnum() or c in "-_" else "-" for c in platform.node()) or "localhost"


def running(pid: int) -> bool:
    """Whether a process of this machine may still be running. Always True on Windows, where asking could end it."""
    if os.name == "nt":
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's
        return True
    return True
