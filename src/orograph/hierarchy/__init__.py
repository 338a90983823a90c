"""Pure index arithmetic of the hierarchies: trees, right triangles, diamonds, fronts (docs/hierarchy.md).

>>> from orograph.hierarchy import triangles
>>> triangles.child(*triangles.root(0, n=4), 0)  # left child of the north-eastern root: x, y, L, ω
(8, 0, 8, 6)

Inside compiled kernels: ``from orograph.hierarchy.kernels import triangles``. Nothing here imports Numba.
"""

from __future__ import annotations

from orograph.hierarchy import bits, diamonds, fronts, trees, triangles
from orograph.hierarchy.fronts import Front, front_of

__all__ = ["Front", "bits", "diamonds", "front_of", "fronts", "trees", "triangles"]
