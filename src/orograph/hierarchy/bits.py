"""Two things every index formula needs of an integer: its logarithm and its lowest bit, by operators alone.

The formulas of this package are plain functions of integers without branches: operators, ``abs``, and comparisons used
as 0 and 1. So one definition serves a Python ``int``, a NumPy array (elementwise, with broadcasting) and, registered by
``orograph.hierarchy.kernels``, a compiled kernel. Integers are signed, 64 bits wide where large; no units.
"""

from __future__ import annotations

from typing import Any, TypeAlias

Integers: TypeAlias = Any
"""An ``int``, or an array of signed integers (int64 unless everything is small); arrays broadcast as in NumPy.

``Any`` to the type checker: each formula is applied to scalars, to arrays and to both at once.
"""


def floor_log2(v: Integers) -> Integers:
    """⌊log2 v⌋ for 1 ≤ v < 2^63 (0 for v < 1): binary search for the highest bit (Warren, *Hacker's Delight*, §5–3)."""
    a = (v > 0xFFFFFFFF) * 32
    v = v >> a
    b = (v > 0xFFFF) * 16
    v = v >> b
    c = (v > 0xFF) * 8
    v = v >> c
    d = (v > 0xF) * 4
    v = v >> d
    e = (v > 3) * 2
    v = v >> e
    return a + b + c + d + e + (v > 1)


def lowest_bit(v: Integers) -> Integers:
    """The largest power of two that divides v; 0 for v = 0."""
    return v & -v


FORMULAS = (floor_log2, lowest_bit)
"""What kernels may call (see ``orograph.hierarchy.kernels``)."""
