"""One frame of ROAM: what is due is computed again, then splits and merges in the order of the two queues.

Paper sec. 4 and 5. Work is proportional to what is due and to what changes; the mesh itself is never gone through. The
kernel stops where it needs something from outside: pages of the field, larger arrays, or the time; and goes on from
there when it is called again. Whenever it stops the mesh is conforming.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.lod.roam.changes import assess, assess_seldom, force_split, merge_diamond, wait
from orograph.lod.roam.mesh import (
    COMPUTED,
    CULL,
    DRAWN,
    EMPTY,
    FRAME,
    FREE,
    FREED,
    HIGH,
    INNER,
    LEAF,
    LEAST,
    LOADED,
    LOW,
    MERGEABLE,
    MOST,
    OUT,
    PENDING,
    RELABELLED,
    RENEW,
    STAGE,
    SWEPT,
    TOP,
    WAITING,
    coarser_base,
    touch,
)
from orograph.lod.roam.queues import CLASSES, HOLES, MERGE, SLOTS, SPLIT, UNITY, bucket_of, highest, lowest, slot_of
from orograph.lod.roam.strips import ABSENT, lacks_room

DONE, PAGES, ROOM, LIMIT, DRIFT = range(5)
"""Why the kernel stopped: the goal is reached; pages are missing; the arrays are full; so many steps were made;
the crossing of the two queues is at priorities that were not computed again."""

RESERVE = 512
"""Nodes and strips that must be free before a split (a forced split makes at most four on each of its levels)."""

SHARE = 16
"""Frames in which all priorities are computed again when thresholds move."""


@leaf
def assess_due(s, steps):
    """Compute again what is due by the clocks, at most so many; how many more were allowed (0: perhaps not all)."""
    nodes, lists = s.nodes, s.lists
    for k in range(CLASSES):
        now = slot_of(k, s.clock[k])
        for slot in range(max(s.passed[k], now - SLOTS + 1), now + 1):
            i = np.int64(lists[k * SLOTS + slot % SLOTS])
            while i >= 0 and steps != 0:
                if is_full(s):
                    return 0
                following = np.int64(nodes[i].due_after)
                if following >= 0:
                    # Called into the cache while this one is computed: the parent of the next, and the one after it.
                    touch(nodes, max(np.int64(nodes[following].parent), np.int64(0)))
                    touch(nodes, max(np.int64(nodes[following].due_after), np.int64(0)))
                if slot < now or nodes[i].due <= s.clock[k]:
                    # It may come back into this very list, at its head.
                    assess(s, i)
                    steps -= 1
                i = following
            if steps == 0:
                return 0
            s.passed[k] = slot
    return steps


@leaf
def is_left_out(nodes, i):
    """Whether node i is left out of what is drawn, or would be if its diamond were merged."""
    node = nodes[i]
    return node.flags & OUT or (node.state == LEAF and node.slot == ABSENT and not node.flags & EMPTY)


@leaf
def relabel(s):
    """Compute again, of what is due, all that is left out of what is drawn; False if the arrays are full.

    The rest of what is due is drawn, whatever became of it, so it may wait for the next frame.
    """
    nodes, lists = s.nodes, s.lists
    for k in range(CLASSES):
        now = slot_of(k, s.clock[k])
        for slot in range(max(s.passed[k], now - SLOTS + 1), now + 1):
            i = np.int64(lists[k * SLOTS + slot % SLOTS])
            while i >= 0:
                following = np.int64(nodes[i].due_after)
                if is_left_out(nodes, i) and (slot < now or nodes[i].due <= s.clock[k]):
                    if is_full(s):
                        return False
                    assess(s, i)
                i = following
    if s.counts[RENEW] == 1:
        for j in range(s.counts[TOP]):
            node = nodes[j]
            if (
                (node.state == LEAF and not node.flags & PENDING) or (node.state == INNER and node.flags & MERGEABLE)
            ) and is_left_out(nodes, j):
                if is_full(s):
                    return False
                assess_seldom(s, j)
    return True


@leaf
def assess_all(s, steps):
    """Compute everything again, at most so many: the tolerance or the camera is another one. As ``assess_due``."""
    nodes = s.nodes
    while s.counts[RENEW] <= s.counts[TOP]:
        if steps == 0 or is_full(s):
            return 0
        i = s.counts[RENEW] - 1
        s.counts[RENEW] += 1
        node = nodes[i]
        if (node.state == LEAF and not node.flags & PENDING) or (node.state == INNER and node.flags & MERGEABLE):
            assess(s, i)
            steps -= 1
    s.counts[RENEW] = 0
    return steps


@leaf
def refresh(s, i):
    """Compute node i's priority again if it is of an earlier frame; whether it was."""
    if i < 0 or s.nodes[i].frame == s.counts[FRAME]:
        return False
    assess(s, i)
    return True


@leaf
def sweep(s):
    """Compute a share of all priorities again, of those of earlier frames: the thresholds are moving to other ones."""
    nodes = s.nodes
    first = s.counts[SWEPT] - 1
    last = min(first + s.counts[TOP] // SHARE + 1, s.counts[TOP])
    for i in range(first, last):
        if is_full(s):
            return
        s.counts[SWEPT] = i + 2
        node = nodes[i]
        if (node.state == LEAF and not node.flags & PENDING) or (node.state == INNER and node.flags & MERGEABLE):
            refresh(s, i)
    if last == s.counts[TOP]:
        s.counts[SWEPT] = 0
        s.options[LEAST], s.options[MOST] = s.options[LOW], s.options[HIGH]


@leaf
def assess_waiting(s):
    """Compute what waited for pages."""
    count = s.counts[WAITING]
    s.counts[WAITING] = 0
    for at in range(count):
        i = np.int64(s.waiting[at])
        node = s.nodes[i]
        if node.state != FREE and node.flags & PENDING:
            node.flags &= ~np.uint8(PENDING)
            if node.state == LEAF or node.flags & MERGEABLE:
                assess_seldom(s, i)


@leaf
def is_full(s):
    """Whether nodes or strips may not suffice for a forced split and its cuts."""
    return (s.counts[FREED] < 0 and s.counts[TOP] + RESERVE > len(s.nodes)) or lacks_room(s, RESERVE)


@leaf
def by_tolerance(s, steps):
    """Split what exceeds the tolerance, then merge what need not be split, for at most so many steps each.

    Each is a step, and so is every priority that has to be computed for it.
    """
    taken, begun = 0, s.counts[COMPUTED]
    while True:
        bucket = highest(s.occupied, SPLIT)
        more = bucket >= UNITY
        if not more or 0 <= steps <= taken + s.counts[COMPUTED] - begun:
            break
        if is_full(s):
            return ROOM
        taken += 1
        i = np.int64(s.heads[SPLIT, bucket])
        if not force_split(s, i):
            wait(s, i)
    taken, begun = 0, s.counts[COMPUTED]
    while True:
        bucket = lowest(s.occupied, MERGE)
        if bucket >= UNITY:
            break
        if 0 <= steps <= taken + s.counts[COMPUTED] - begun:
            return LIMIT
        if is_full(s):
            return ROOM
        taken += 1
        merge_diamond(s, np.int64(s.heads[MERGE, bucket]))
    return LIMIT if more else DONE


@leaf
def price(nodes, i):
    """At most how many triangles a split of leaf i adds, forced splits included."""
    more = 0
    while i >= 0:
        more += 1 if nodes[i].base < 0 else 2
        i = coarser_base(nodes, i)
    return more


@leaf
def by_budget(s, budget):
    """The paper's greedy loop: the mesh of at most ``budget`` drawn triangles with the smallest largest priority.

    What is part surface and part hole is split, and stays split, whatever the budget.

    Priorities may be stale by as much as a bucket's width, so that of a child may exceed that of its parent: those that
    would be split or merged are computed first. So it ends: a diamond is merged for the sake of one whose bucket is
    higher, and of those that were split and merged over and over the highest could not have been merged.
    """
    least = bucket_of(np.float32(s.options[LEAST]))
    most = bucket_of(np.float32(s.options[MOST]))
    while True:
        split = highest(s.occupied, SPLIT)
        merge = lowest(s.occupied, MERGE)
        i = np.int64(s.heads[SPLIT, split]) if split >= 0 else -1
        if split == HOLES:
            if is_full(s):
                return ROOM
            if not force_split(s, i):
                wait(s, i)
            continue
        if s.counts[DRAWN] > budget:
            if merge >= HOLES:
                return DONE
        elif split < 0:
            return DONE
        elif s.counts[DRAWN] + price(s.nodes, i) <= budget:
            if split < least:
                return DRIFT
            if is_full(s):
                return ROOM
            if not refresh(s, i) and not force_split(s, i):
                wait(s, i)
            continue
        elif split <= merge:
            return DONE
        if merge > most:
            return DRIFT
        if is_full(s):
            return ROOM
        i = np.int64(s.heads[MERGE, merge])
        one, two = refresh(s, i), refresh(s, np.int64(s.nodes[i].base))
        if not one and not two:
            merge_diamond(s, i)


@leaf
def may_be_mixed(nodes, i):
    """Whether leaf i, which waits for a page, may be part surface and part hole."""
    node = nodes[i]
    if node.flags & LOADED:
        return node.error == np.inf and not node.flags & EMPTY
    parent = np.int64(node.parent)
    return parent < 0 or nodes[parent].error == np.inf or nodes[parent].flags & EMPTY


@leaf
def split_mixed(s):
    """Split what is drawn, part surface and part hole, and nothing else: DONE, PAGES or ROOM."""
    if s.counts[WAITING]:
        assess_waiting(s)
    while highest(s.occupied, SPLIT) == HOLES:
        if is_full(s):
            return ROOM
        i = np.int64(s.heads[SPLIT, HOLES])
        if not force_split(s, i):
            wait(s, i)
    for at in range(s.counts[WAITING]):
        j = np.int64(s.waiting[at])
        if s.nodes[j].state == LEAF and s.nodes[j].flags & PENDING and may_be_mixed(s.nodes, j):
            return PAGES
    return DONE


@leaf
def run_frame(s, budget, steps):
    """Bring the mesh to the goal, or go on with it.

    Args:
        s: the state; ``counts[STAGE]`` is 0 until all that is due has been computed, ``counts[RENEW]`` the number of
            the next node to compute, from 1, if all are; ``counts[RELABELLED]`` is 0 until nothing in view is left out.
        budget: drawn triangles, or −1: the tolerance is the goal.
        steps: how many are allowed, of what is due, for splits and for merges; −1 all that are needed.

    Returns:
        DONE, PAGES, ROOM, LIMIT or DRIFT.
    """
    if s.counts[STAGE] == 0:
        if s.counts[RELABELLED] == 0:
            if s.counts[RENEW] == 1:
                for i in range(s.counts[TOP]):
                    s.nodes[i].label_until = -1.0
            if steps >= 0 and s.options[CULL] > 0.0 and not relabel(s):
                return ROOM
            s.counts[RELABELLED] = 1
        left = assess_due(s, steps)
        if s.counts[RENEW]:
            left = assess_all(s, left)
        if s.counts[SWEPT] and left != 0:
            sweep(s)
        if left != 0:
            s.counts[STAGE] = 1
        elif is_full(s):
            return ROOM
    if s.counts[WAITING]:
        assess_waiting(s)
    reason = by_tolerance(s, steps) if budget < 0 else by_budget(s, budget)
    if s.counts[STAGE] == 0 and reason == DONE:
        return LIMIT
    if reason == DONE and s.counts[WAITING]:
        return PAGES
    return reason
