"""Meshes for other programs.

>>> from orograph.meshing import write
>>> write(tessellation, terrain.grid, "ground.glb")  # doctest: +SKIP
"""

from __future__ import annotations

from orograph.meshing.export import FORMATS, mesh_format, write
from orograph.meshing.solid import MODELS, Print, solid, write_solid

__all__ = ["FORMATS", "MODELS", "Print", "mesh_format", "solid", "write", "write_solid"]
