"""Putting together what SOAR's threads made: where each strip goes, and the way there."""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.lod.work_sharing import enters, last, leave, left, ready, wait_for


@leaf
def lay_out(keys, zs, length, part_keys, part_zs, places, first, count, shares):
    """Say where the strips that helpers made go, behind the strip so far, and join them to it; the new length.

    What comes out is what one thread would have made: degenerate triangles between the strips, each at an even place.

    Args:
        keys, zs, length: the strip so far; there is room.
        part_keys, part_zs: (helpers, capacity), what helpers wrote.
        places: as ``refine_subtrees`` left it, of the subtrees [first, count); their fourth column is filled here.
        shares: ``work_sharing.begin``, for those who ``put`` them there.
    """
    key, z = keys[max(length - 1, 0)], zs[max(length - 1, 0)]
    for subtree in range(first, count):
        size = places[subtree, 2]
        if size == 0:
            continue
        helper, start = np.uint64(places[subtree, 0]), np.uint64(places[subtree, 1])
        if length:
            keys[length], zs[length] = key, z
            for _ in range(1 + (length & 1)):
                length += 1
                keys[length], zs[length] = part_keys[helper, start], part_zs[helper, start]
            length += 1
        places[subtree, 3] = length
        length += size
        end = start + np.uint64(size - 1)
        key, z = part_keys[helper, end], part_zs[helper, end]
    ready(shares, first)
    return length


@leaf
def put(keys, zs, part_keys, part_zs, places, count, shares, helps):
    """Move strips to where ``lay_out`` said, as many as this thread takes. Arguments as there.

    Args:
        helps: whether this thread is a helper, and waits for ``lay_out``.
    """
    first = wait_for(shares)
    if first < 0 or (helps and not enters(shares)):
        return
    while left(shares, count - first):
        subtree = first + last(shares, count - first)
        helper = np.uint64(places[subtree, 0])
        source, target = np.uint64(places[subtree, 1]), np.uint64(places[subtree, 3])
        for k in range(np.uint64(places[subtree, 2])):
            keys[target + k] = part_keys[helper, source + k]
        for k in range(np.uint64(places[subtree, 2])):
            zs[target + k] = part_zs[helper, source + k]
    if helps:
        leave(shares)
