"""Exact quantiles of float32 numbers of any count, in a few passes and bounded memory.

Floats read as integers keep their order once the signs are flipped (Herf 2001). A first pass counts the upper 16 bits
of all numbers; a second counts the lower 16 bits of those whose upper bits contain a wanted rank. The result is exactly
the number at that rank, whatever the blocks.

M. Herf, Radix tricks, 2001, https://stereopsis.com/radix.html.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from orograph.parallel import map_ordered

HALF = 1 << 16
"""Number of values of half a float's bits."""

Floats = NDArray[np.float32]
Counts = NDArray[np.int64]


def ordered(values: Floats) -> NDArray[np.uint32]:
    """Integers in the same order as floats, none of which is NaN or −0."""
    bits = np.ascontiguousarray(values).view(np.uint32)
    return np.where(bits >> 31 == 1, ~bits, bits | np.uint32(1 << 31))


def floats(keys: NDArray[np.uint32]) -> Floats:
    """The floats that have such numbers: the inverse of ``ordered``."""
    bits = np.where(keys >> 31 == 1, keys & np.uint32(0x7FFFFFFF), ~keys)
    return bits.astype(np.uint32).view(np.float32)


def upper_counts(values: Floats) -> Counts:
    """How many of the values (n,) have each upper half, (65536,)."""
    return np.bincount(ordered(values) >> 16, minlength=HALF)


def quantiles(
    blocks: Sequence[object], read: Callable[[object], Floats], upper: Counts, wanted: Iterable[float],
    jobs: int | None = None,
) -> list[float]:  # fmt: skip
    """Quantiles, linear between the two numbers around them (Hyndman & Fan 1996, type 7, as NumPy).

    Args:
        blocks: ``read`` converts each to numbers (n,), none NaN or −0.
        upper: the sum of all blocks' ``upper_counts``, (65536,).
        wanted: 0 to 1.

    Returns:
        as many numbers as wanted; NaN if there are no numbers at all.
    """
    wanted = list(wanted)
    count = int(upper.sum())
    if not count:
        return [math.nan] * len(wanted)
    places = [(count - 1) * q for q in wanted]
    ranks = sorted({rank for place in places for rank in (math.floor(place), math.ceil(place))})
    above = np.cumsum(upper)
    bins = np.searchsorted(above, ranks, side="right")
    some = np.unique(bins)
    slot = np.full(HALF, -1, np.int64)
    slot[some] = np.arange(len(some))

    def lower(block: object) -> Counts:
        keys = ordered(read(block))
        which = slot[keys >> 16]
        known = which >= 0
        return np.bincount(which[known] * HALF + (keys[known] & 0xFFFF), minlength=len(some) * HALF)

    total = np.zeros(len(some) * HALF, np.int64)
    for found in map_ordered(lower, blocks, jobs):
        total += found
    inner = np.cumsum(total.reshape(len(some), HALF), axis=1)
    at: dict[int, float] = {}
    for rank, high in zip(ranks, bins.tolist(), strict=True):
        k = int(slot[high])
        low = int(np.searchsorted(inner[k], rank - int(above[high] - upper[high]), side="right"))
        at[rank] = float(floats(np.array([high << 16 | low], np.uint32))[0])
    return [_between(at[math.floor(p)], at[math.ceil(p)], p - math.floor(p)) for p in places]


def _between(low: float, high: float, part: float) -> float:
    return low + (high - low) * part
