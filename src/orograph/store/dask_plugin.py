"""How the workers of a Dask cluster are told of work: those that are there, and those that come later.

It is imported only where Dask is installed.
"""

from __future__ import annotations

import contextlib
import ctypes
from typing import Any

from distributed import WorkerPlugin

from orograph.store.worker_state import Recipe, forget, learn

TRIM, MAP = -1, -3
"""Of glibc's ``mallopt``: free memory at the end of the heap that is given back, and what is mapped from the system."""


class Telling(WorkerPlugin):
    """Tells each worker a recipe when it comes, and takes it away again.

    Args:
        ident: what tasks call the recipe.
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

    Dask has its workers give all of it back at once. Tasks that make arrays of some megabytes then spend a third of
    their time on pages that the system clears.
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library
        allocator = ctypes.CDLL(None)
        allocator.mallopt(TRIM, 1 << 28)
        allocator.mallopt(MAP, 1 << 25)
