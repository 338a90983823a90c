"""What a surface leaves for later passes, besides depth and marks."""

from __future__ import annotations

from typing import Literal, NamedTuple

Slopes = Literal["", "stored", "sampled", "flat"]
"""Which slopes are left: none; those at vertices, interpolated; from heights half a pixel to every side; those of the
drawn triangles."""


class Left(NamedTuple):
    """The outputs that are wanted of a surface.

    Attributes:
        edges: marks of triangles' edges. slopes: of what is drawn. field: the terrain's own height in each pixel.
        at_breaks: cast rays only at pixels that ``RayPass.find_breaks`` found, and mark all others ``LEFT_OUT``.
    """

    edges: bool = False
    slopes: Slopes = ""
    field: bool = False
    at_breaks: bool = False


DEPTH_ONLY = Left()
