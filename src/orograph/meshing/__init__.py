"""Meshes for other programs.

>>> from orograph.meshing import write
>>> write(tessellation, terrain.grid, "ground.glb")  # doctest: +SKIP
"""

from __future__ import annotations

from orograph.meshing.export import FORMATS, Origin, mesh_format, write
from orograph.meshing.solid import MODELS, Print, solid, write_solid, write_surface

__all__ = ["FORMATS", "MODELS", "Origin", "Print", "mesh_format", "solid", "write", "write_solid", "write_surface"]
