"""How many kernels were compiled, and how long that took: told by ``_numba``, shown by progress.

Compiling happens within whatever needs a kernel first, once on a machine: without this the time would be put down to
that work. It imports nothing, so that whoever only wants to show it need not load the compiler.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Compiling:
    """The kernels that this process has compiled so far; those read from the cache do not count.

    Attributes:
        count: kernels. seconds: that they took; what one kernel compiles for itself is part of it.
        changed: called, from any thread, when another one is begun.
    """

    def __init__(self) -> None:
        self.count = 0
        self.seconds = 0.0
        self.changed: list[Callable[[], None]] = []
        self._here = threading.local()

    def begin(self) -> None:
        """A kernel is being compiled."""
        self._here.depth = getattr(self._here, "depth", 0) + 1
        if self._here.depth == 1:
            self._here.began = time.perf_counter()
            self.count += 1
            for tell in self.changed:
                tell()

    def end(self) -> None:
        """It is compiled."""
        self._here.depth -= 1
        if self._here.depth == 0:
            self.seconds += time.perf_counter() - self._here.began  # (compilers take turns: no two times overlap)


COMPILING = Compiling()
"""Of this process."""
