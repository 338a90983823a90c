"""A patch: a right triangle of the hierarchy, divided so often that each leg has L segments; and where one lies.

Its lattice points are (i, j), 0 ≤ i, j, i + j ≤ L: apex + i·e1 + j·e2, where e1 leads towards the left and e2 towards
the right end of the hypotenuse (seen with the apex on top), so that apex, e1, e2 turn counter-clockwise on the map.
Both have components 0 or ±2^s: along the axes (*even* patches) or diagonal (*odd* ones). The triangles are those of the
hierarchy 2·log2(L) levels down: every cell is cut between its two corners of even i + j.

The points with odd i + j are *new*: the coarser lattice of the parent patch lacks them. Each lies in the middle of an
edge of the parent's lattice, between its neighbours along the axis whose index is odd: (i ± 1, j) or (i, j ± 1). None
is on the hypotenuse. L is a power of two. Rows and columns are samples of the padded square.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orograph.store.patches import LEGS

Point = tuple[int, int]

ALL_LEGS = (1, 2, 4, 8, 16, 32, 64)
"""What L can be: segments along a leg."""

INSTANCE = np.dtype(
    [
        ("row", "<i4"), ("col", "<i4"), ("omega", "u1"), ("step", "u1"), ("level", "u1"), ("flags", "u1"),
        ("tile_row", "<u2"), ("tile_col", "<u2"), ("morph", "<f4"), ("slot", "<i4"), ("pixels", "<f4"), ("pad", "<u4"),
    ]
)  # fmt: skip
"""A patch, 32 bytes.

row, col: the apex, a sample of the padded square (beyond the raster's last row and column it is squeezed onto them).
omega: which way the apex points (``hierarchy.triangles``); ``STEPS[omega] << step`` are e1 and e2 as (row, col).
step: s. level: the store level its heights come from, min(s, the coarsest). flags: MAY_MISS.
tile_row, tile_col: the tile of 256 × 256 cells of that level in which the patch lies.
morph: m. A new point is drawn at the height mix(mean of its two neighbours', its own, m), but at its own if one of
    these two is missing or lies beyond the raster's last row or column. Points do not move sideways.
slot: −1, for the renderer's use. pixels: the bound of its error, with m as it is. pad: 0.
"""

MAY_MISS = 1
"""Flag: samples of the patch may be missing. Triangles with a missing corner are not drawn."""

STEPS: NDArray[np.int8] = np.array(
    [
        [[1, 1], [-1, 1]], [[1, 0], [0, 1]], [[1, -1], [1, 1]], [[0, -1], [1, 0]],
        [[-1, -1], [1, -1]], [[-1, 0], [0, -1]], [[-1, 1], [-1, -1]], [[0, 1], [-1, 0]],
    ],
    np.int8,
)  # fmt: skip
"""(8, 2, 2): by omega, e1 and e2 as (row, col), for s = 0."""


def patch_vertices(legs: int = LEGS) -> NDArray[np.uint8]:
    """The lattice points (i, j) of a patch, ((L + 1)(L + 2)/2, 2) uint8, by i and in it by j."""
    return np.array([(i, j) for i in range(legs + 1) for j in range(legs + 1 - i)], np.uint8)


def patch_indices(legs: int = LEGS) -> NDArray[np.uint16]:
    """The triangles of a patch, (L², 3) uint16 indices into ``patch_vertices``, counter-clockwise from above.

    They are in the order of the bisection (a Sierpinski curve), in which each shares an edge with the next.
    """

    def index(i: int, j: int) -> int:
        return i * (2 * legs + 3 - i) // 2 + j

    found: list[tuple[int, int, int]] = []

    def divide(apex: Point, begin: Point, end: Point, times: int) -> None:
        if times == 0:
            found.append((index(*apex), index(*begin), index(*end)))
            return
        middle = (begin[0] + end[0]) // 2, (begin[1] + end[1]) // 2
        divide(middle, begin, apex, times - 1)  # halves turn the other way, halves of halves as the whole
        divide(middle, apex, end, times - 1)

    divide((0, 0), (legs, 0), (0, legs), 2 * (legs.bit_length() - 1))
    return np.array(found, np.uint16)
