"""The same index arithmetic inside compiled kernels.

A kernel's module takes the modules of formulas from here instead of from the package, and calls them by the same names:

>>> from orograph._numba import kernel
>>> from orograph.hierarchy.kernels import diamonds
>>> @kernel
... def square_count(rows, cols):
...     count = 0
...     for i in range(len(rows)):
...         count += diamonds.kind(rows[i], cols[i]) == diamonds.SQUARE
...     return count

They are the very same functions; importing this module tells Numba that it may compile them into the kernels that call
them. (Numba's cache does not notice when a formula changes: see docs/architecture.md, *Kernels*.)
"""

from __future__ import annotations

from orograph._numba import shared
from orograph.hierarchy import bits, diamonds, trees, triangles

__all__ = ["bits", "diamonds", "trees", "triangles"]

for _module in (bits, trees, triangles, diamonds):
    for _formula in _module.FORMULAS:
        shared(_formula)
