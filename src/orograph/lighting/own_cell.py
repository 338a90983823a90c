"""What a sample sees of its own cell towards the light: the horizon within one step, from the surface's triangles.

Lines of a sweep pass beside a sample, and near it they are wrong by as much as the ground is rough. Beyond one step
this evens out. Slopes are tangents of elevation angles; heights are metres, NaN where missing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orograph._numba import inlined


class OwnCell(NamedTuple):
    """How to find the other three corners of a sample's own cell, on the side of the light.

    Attributes:
        reach: steps to the end of the cell: 1, or 0 where lines run through the samples and are exact.
        toward: 1 or −1, from a step to the next one towards the light. edge: the step that has none.
        side: 1, −1 or 0, lanes to the sample on that side. part: lanes that a line moves by in a step, from 0 to 1.
        odd: 1 if row + column of the sample in lane 0 at step 0 is odd.
        points: of a line in a step: 1, or 2 where lines run along the cells' diagonals. On a line through samples of
            odd row + column, all cells are cut the other way, and the middle of each is a separate point.
        scale: steps per metre. sag: how much a round body lowers the slope to a point one step away.
    """

    reach: np.float64
    toward: int
    edge: int
    side: int
    part: np.float32
    odd: int
    points: int
    scale: np.float32
    sag: np.float32


@inlined
def cell_slope(z, major, both, minor, odd, cell):  # type: ignore[no-untyped-def]
    """The slope of a sample's own triangle towards the light, up to one step away. NaN: nothing.

    The cell's diagonal runs through samples of even row + column. For those, the triangle's far side is one step away;
    for the others it is the diagonal. A missing sample of the far side is replaced by the other one.

    Args:
        z: height of the sample. major, both, minor: those of the samples one step towards the light, towards the light
            and to the side, and to the side.
    """
    m = major if major == major else both
    d = both if both == both else m
    slope = (m + cell.part * (d - m) - z) * cell.scale - cell.sag
    own = ((major - z) + cell.part * (minor - z)) * cell.scale - cell.sag / (np.float32(1.0) + cell.part)
    return own if odd & 1 and own > slope else slope
