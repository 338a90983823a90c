"""Terrain at all resolutions: in memory, or built once into a store and read tile by tile.

>>> from orograph import store
>>> terrain = store.build(["n36.tif", "n37.tif"], "area.oro")  # doctest: +SKIP
>>> terrain = store.open("s3://bucket/area.oro")               # doctest: +SKIP
>>> heights = terrain.read(3, 0, 257, 0, 257)                  # doctest: +SKIP
"""

from __future__ import annotations

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
