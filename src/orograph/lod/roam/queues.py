"""The queues of ROAM: splits and merges by priority, and the lists of triangles that are due at some time.

*Priority queues* (paper sec. 4.2). A bucket for every 1/64 of an octave of priority, doubly linked lists through the
nodes, a bit per bucket that is not empty: insertion, removal and a change of priority cost the same few nanoseconds
whatever the queue's length, and most changes of priority stay in their bucket and cost nothing. (An indexed binary heap
was measured beside it, ``bench/roam.py --queues``.) Priorities are relative to the tolerance: bucket ``UNITY`` and
those above hold exactly the priorities > 1. Within a bucket the order is last in, first out, so a greedy choice is
within 1.6 % of the best.

*Crossing lists* (paper sec. 5.3). A triangle's priority is computed again only when the camera has moved so far that it
can have crossed the threshold. Distances on the screen depend on how a point moves relative to the camera: a point at
distance D is moved by at most s + D·θ when the eye moves by s and the view turns by θ. Triangles are classed by D (four
classes an octave, Q_k = 2^(k/4) metres); the clock of class k advances by s + 1.125·Q_k·θ in each frame, and whatever
moves by at most Q_k/8 stays within 1.125·Q_k. Each class has a ring of lists by the clock's reading at which their
triangles are due.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf

SPLIT, MERGE = 0, 1
BUCKETS = 4096
UNITY = 2048
PER_OCTAVE = 64
HOLES = BUCKETS - 1
"""The bucket of the priority infinity, and of nothing else: ground that is part surface and part hole."""

CLASSES = 140
SLOTS = 256
SPREAD = 1.125
"""A triangle stays within this factor of its class's distance while it is not due."""


@leaf
def bucket_of(priority):
    """The bucket of a float32 priority ≥ 0; ≥ UNITY iff it is > 1."""
    if not priority > 0.0:
        return 0
    if priority == np.inf:
        return HOLES
    bits = np.int64(np.float32(priority).view(np.uint32)) - 1  # so that 1 itself lies below UNITY
    return min(max((bits >> 17) - (127 * 64 - 2048), 0), HOLES - 1)


def largest_in(bucket: int) -> float:
    """The largest priority in a bucket; infinite in the last two."""
    if bucket >= HOLES - 1:
        return float("inf")
    return float(np.uint32((bucket + 1 + 127 * 64 - UNITY) << 17).view(np.float32))


@leaf
def enqueue(nodes, heads, occupied, queue, i, priority):
    """Put node i into a queue, or move it to the bucket of its new priority."""
    bucket = bucket_of(priority)
    node = nodes[i]
    if node.bucket == bucket:
        return
    if node.bucket >= 0:
        dequeue(nodes, heads, occupied, queue, i)
    first = heads[queue, bucket]
    node.before, node.after = -1, first
    if first >= 0:
        nodes[first].before = i
    heads[queue, bucket] = i
    occupied[queue, bucket >> 6] |= np.uint64(1) << np.uint64(bucket & 63)
    node.bucket = bucket


@leaf
def dequeue(nodes, heads, occupied, queue, i):
    """Take node i out of a queue, if it is there."""
    node = nodes[i]
    bucket = node.bucket
    if bucket < 0:
        return
    if node.after >= 0:
        nodes[node.after].before = node.before
    if node.before >= 0:
        nodes[node.before].after = node.after
    else:
        heads[queue, bucket] = node.after
        if node.after < 0:
            occupied[queue, bucket >> 6] &= ~(np.uint64(1) << np.uint64(bucket & 63))
    node.bucket = -1


@leaf
def highest(occupied, queue):
    """The highest bucket that is not empty; −1 if the queue is."""
    for place in range(BUCKETS // 64 - 1, -1, -1):
        word = occupied[queue, place]
        if word:
            bit = 0
            for step in (32, 16, 8, 4, 2, 1):
                if word >> np.uint64(step):
                    word >>= np.uint64(step)
                    bit += step
            return place * 64 + bit
    return -1


@leaf
def lowest(occupied, queue):
    """The lowest bucket that is not empty; BUCKETS if the queue is."""
    for place in range(BUCKETS // 64):
        word = occupied[queue, place]
        if word:
            bit = 0
            for step in (32, 16, 8, 4, 2, 1):
                if not word & ((np.uint64(1) << np.uint64(step)) - np.uint64(1)):
                    word >>= np.uint64(step)
                    bit += step
            return place * 64 + bit
    return BUCKETS


# ---- crossing lists --------------------------------------------------------------------------------------------------


@leaf
def class_of(distance):
    """The class of triangles within that distance of the eye, metres; −1 if there is none."""
    k = 0 if distance <= 1.0 else int(np.ceil(4.0 * np.log2(distance)))
    return k if k < CLASSES else -1


@leaf
def reach_of(k):
    """Q_k, metres: (a hair more than) the distance of the farthest in class k."""
    return 2.0 ** (0.25 * k) * (1.0 + 1e-12)


@leaf
def slot_of(k, reading):
    """The slot of the ring, not wrapped, in which a clock's reading lies; a ring spans Q_k/8 and a little more."""
    return int(reading * (8.0 * (SLOTS - 4)) / reach_of(k))


@leaf
def schedule(nodes, lists, clock, i):
    """Put node i, in no list, into the list of its class and its ``due`` reading."""
    node = nodes[i]
    k = np.int64(node.reach)
    at = k * SLOTS + slot_of(k, max(node.due, clock[k])) % SLOTS
    first = lists[at]
    node.due_list, node.due_before, node.due_after = at, -1, first
    if first >= 0:
        nodes[first].due_before = i
    lists[at] = i


@leaf
def unschedule(nodes, lists, i):
    """Take node i out of its list, if it is in one."""
    node = nodes[i]
    if node.due_list < 0:
        return
    if node.due_after >= 0:
        nodes[node.due_after].due_before = node.due_before
    if node.due_before >= 0:
        nodes[node.due_before].due_after = node.due_after
    else:
        lists[node.due_list] = node.due_after
    node.due_list = -1


def advance(clock: np.ndarray, moved: float, turned: float) -> None:
    """Let the clocks run for a move of the eye (metres, stretched) and a turn of the view (radians)."""
    k = np.arange(CLASSES)
    clock += (moved + SPREAD * (2.0 ** (0.25 * k) * (1.0 + 1e-12)) * turned) * (1.0 + 1e-9)
