"""Give work to the workers of a Dask cluster: present ones and those that join later.

Imported only if Dask is installed.
"""

from __future__ import annotations

import contextlib
import ctypes
from typing import Any

from distributed import WorkerPlugin

from orograph.store.worker_state import Recipe, forget, learn

TRIM, MAP = -1, -3
"""Parameters of glibc's ``mallopt``: free memory at the end of the heap that is returned, and the size mapped from the
system."""


class Telling(WorkerPlugin):
    """Gives each worker a recipe when it joins, and removes it again.

    Args:
        ident: the recipe's name in tasks.
    """

    def __init__(self, ident: str, recipe: Recipe) -> None:
        self.ident, self.recipe = ident, recipe

    def setup(self, worker: Any) -> None:
        keep_memory()
        learn(self.ident, self.recipe, int(worker.memory_manager.memory_limit or 0))

    def teardown(self, worker: Any) -> None:
        forget(self.ident)


def keep_memory() -> None:
    """Let this process keep memory that it frees, for the next array.

    By default, Dask's workers return it all at once. Tasks that allocate arrays of a few megabytes then spend a third
    of their time on pages that the system clears.
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library
        allocator = ctypes.CDLL(None)
        allocator.mallopt(TRIM, 1 << 28)
        allocator.mallopt(MAP, 1 << 25)
