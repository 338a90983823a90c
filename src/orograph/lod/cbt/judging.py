"""The criterion for many diamonds at once (``lod.criterion``)."""

from __future__ import annotations

from orograph._numba import kernel
from orograph.lod.criterion import EVERYWHERE, first_bits, judge, look_up
from orograph.lod.pages import BEYOND

LACKING = 3
"""Where a page is absent, beside what ``lod.criterion`` says."""


@kernel
def judge_each(pages, criterion, keys, octaves, states, heights):
    """What becomes of the triangles over each of some diamonds, and the heights of their vertices.

    Args:
        pages: ``field.Pages``. criterion: ``Criterion``. keys, octaves: int64 (k,), the diamonds.
        states: uint8 (k,), heights: float32 (k,), for what is found.
    """
    bits = first_bits(criterion) if criterion.cull else EVERYWHERE
    for i in range(len(keys)):
        slot, z, e, r, c = look_up(pages, keys[i], octaves[i])
        states[i], heights[i], _ = judge(pages, criterion, keys[i], z, e, r, c, bits)
        if slot < 0 and slot != BEYOND:
            states[i] = LACKING
