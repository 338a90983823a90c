"""The terrain at all its resolutions: in memory, or built once into a store and read tile by tile.

>>> from orograph import store
>>> terrain = store.build(mosaic, "area.oro")   # doctest: +SKIP
>>> terrain = store.open("s3://bucket/area.oro")  # doctest: +SKIP
>>> terrain.read(3, 0, 257, 0, 257)             # doctest: +SKIP
"""

from __future__ import annotations

from orograph.store.memory import MemoryTerrain
from orograph.store.terrain import TILE, Terrain, TileTable

__all__ = ["TILE", "MemoryTerrain", "Terrain", "TileTable"]
