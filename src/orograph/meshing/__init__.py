"""Meshes as other programs take them.

>>> from orograph.meshing import write
>>> write(tessellation, terrain.grid, "ground.glb")  # doctest: +SKIP
"""

from __future__ import annotations

from orograph.meshing.export import FORMATS, mesh_format, write

__all__ = ["FORMATS", "mesh_format", "write"]
