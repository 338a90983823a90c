"""Meshes as other programs take them.

>>> from orograph.mesh import write
>>> write(tessellation, terrain.grid, "ground.glb")  # doctest: +SKIP
"""

from __future__ import annotations

from orograph.mesh.export import FORMATS, mesh_format, write

__all__ = ["FORMATS", "mesh_format", "write"]
