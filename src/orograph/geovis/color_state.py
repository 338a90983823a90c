"""What a worker of a cluster needs for color errors (``store.worker_state``): the store, the image, and which colours.

It opens both itself, and does nothing if its image is another, or if the run was given up or begun anew meanwhile.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, NamedTuple

from orograph.error.diamonds import BLOCK
from orograph.errors import StoreError
from orograph.geovis.color_errors import Colors
from orograph.geovis.color_stage import PARTIAL, SAMPLE, ColorStage, made_with
from orograph.lighting.context import BASE
from orograph.store.addresses import storage_at
from orograph.store.storage import Storage
from orograph.store.stored import open as open_store
from orograph.store.worker_state import guarded
from orograph.store.writer import ShardWriter

PLAN = f"{PARTIAL}/plan.json"


class ColorRecipe(NamedTuple):
    """Everything that workers get once.

    Attributes:
        named: the store (``Storage.named``). drape: the image's path. options: of ``Colors``.
        plan: as it lies in the store. max_memory: of ``Colors``, from which the width of texels follows.
        memory, base: as of all recipes.
    """

    named: tuple[str, dict[str, Any] | None]
    drape: str | None
    options: dict[str, Any]
    plan: bytes
    max_memory: int
    memory: int
    base: int

    def open(self) -> ColorState:
        return ColorState(self)


def recipe_of(
    storage: Storage, drape: str | os.PathLike[str] | None, options: dict[str, Any], plan: bytes, max_memory: int
) -> ColorRecipe:
    """The recipe of a run whose plan lies in its store."""
    path = None if drape is None else os.fspath(drape)
    if path is not None and Path(path).exists():
        path = str(Path(path).absolute())
    return ColorRecipe(storage.named(), path, options, plan, max_memory, 2 * SAMPLE * BLOCK**2, BASE)


class ColorState:
    """What one process needs for color errors."""

    def __init__(self, recipe: ColorRecipe) -> None:
        url, said = recipe.named
        terrain = open_store(url, jobs=1, storage_options=said)
        colors = Colors(terrain, drape=recipe.drape, max_memory=recipe.max_memory, **recipe.options)
        told, made = json.loads(recipe.plan), made_with(recipe.drape, **recipe.options) or {}
        if colors.step != told["step"] or made.get("drape") != told["drape"]:
            raise StoreError(
                "A worker finds another image under its name than the process that makes color errors.",
                path=recipe.drape, remedy="Check that all of them share one file system.",
            )  # fmt: skip
        writer = ShardWriter(guarded(storage_at(url, said), PLAN, recipe.plan))
        self._stage = ColorStage(colors, writer, terrain.record)

    def stage(self, name: str, number: int) -> ColorStage:
        return self._stage
