"""What a surface leaves for those who come after, besides depth and marks."""

from __future__ import annotations

from typing import Literal, NamedTuple

Slopes = Literal["", "stored", "sampled", "flat"]
"""Which slopes are left: none; those at vertices, blended between; by heights half a pixel to every side; those of the
triangles that are drawn."""


class Left(NamedTuple):
    """What is wanted of a surface.

    Attributes:
        edges: marks of triangles' edges. slopes: of what is drawn. field: the terrain's own height in each pixel.
        at_breaks: by rays, only pixels that ``RayPass.find_breaks`` found; all others are marked ``LEFT_OUT``.
    """

    edges: bool = False
    slopes: Slopes = ""
    field: bool = False
    at_breaks: bool = False


DEPTH_ONLY = Left()
