"""Terrain at all resolutions: in memory, or built once into a store and read tile by tile.

>>> from orograph import store
>>> terrain = store.build(["n36.tif", "n37.tif"], "area.oro")  # doctest: +SKIP
>>> terrain = store.open("s3://bucket/area.oro")               # doctest: +SKIP
>>> heights = terrain.read(3, 0, 257, 0, 257)                  # doctest: +SKIP

Names are imported when they are first used.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orograph.store.build import build
    from orograph.store.memory import MemoryTerrain
    from orograph.store.opening import terrain
    from orograph.store.source import ArraySource, HeightSource
    from orograph.store.stored import StoredTerrain, open
    from orograph.store.terrain import TILE, Terrain, TileTable

__all__ = [
    "TILE",
    "ArraySource",
    "HeightSource",
    "MemoryTerrain",
    "StoredTerrain",
    "Terrain",
    "TileTable",
    "build",
    "open",
    "terrain",
]

_HOMES = {
    "ArraySource": "source",
    "HeightSource": "source",
    "MemoryTerrain": "memory",
    "StoredTerrain": "stored",
    "TILE": "terrain",
    "Terrain": "terrain",
    "TileTable": "terrain",
    "build": "build",
    "open": "stored",
    "terrain": "opening",
}


if not TYPE_CHECKING:  # (type checkers look for names themselves)

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module 'orograph.store' has no attribute {name!r}")
        return getattr(importlib.import_module(f"orograph.store.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


class _Package(ModuleType):
    """A package in which modules do not hide functions of the same name (``build``, ``terrain``)."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, ModuleType) and name in _HOMES):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
