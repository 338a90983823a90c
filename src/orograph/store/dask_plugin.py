"""How the workers of a Dask cluster are told of a build: those that are there, and those that come later.

It is imported only where Dask is installed.
"""

from __future__ import annotations

from typing import Any

from distributed import WorkerPlugin

from orograph.store.workshop import Recipe, forget, learn


class Telling(WorkerPlugin):
    """Tells each worker a recipe when it comes, and takes it away again.

    Args:
        ident: what tasks call the recipe.
    """

    def __init__(self, ident: str, recipe: Recipe) -> None:
        self.ident, self.recipe = ident, recipe

    def setup(self, worker: Any) -> None:
        learn(self.ident, self.recipe, int(worker.memory_manager.memory_limit or 0))

    def teardown(self, worker: Any) -> None:
        forget(self.ident)
