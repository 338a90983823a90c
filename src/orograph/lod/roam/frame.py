"""One frame of ROAM: what is due is computed again, then splits and merges in the order of the two queues.

Paper sec. 4 and 5. Work is proportional to what is due and to what changes; the mesh itself is never gone through. The
kernel stops where it needs something from outside: pages of the field, larger arrays, or the time; and goes on from
there when it is called again. Whenever it stops the mesh is conforming.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.lod.roam.mesh import (
    DRAWN,
    EMPTY,
    FREE,
    FREED,
    INNER,
    LEAF,
    LOADED,
    LOOSELY,
    MERGEABLE,
    MERGES,
    OUT,
    PENDING,
    QUEUED_MERGES,
    QUEUED_SPLITS,
    RELABELLED,
    RENEW,
    SPLITS,
    STAGE,
    TOP,
    WAITING,
    coarser_base,
    is_mergeable,
    rejoin,
    split_links,
)
from orograph.lod.roam.priorities import CULL, HIGH, LOW, load, priority_of
from orograph.lod.roam.queues import (
    CLASSES,
    HOLES,
    MERGE,
    SLOTS,
    SPLIT,
    UNITY,
    bucket_of,
    dequeue,
    enqueue,
    highest,
    lowest,
    schedule,
    slot_of,
    unschedule,
)
from orograph.lod.roam.strips import ABSENT, hide, lacks_room, show

DONE, PAGES, ROOM, LIMIT, DRIFT = range(5)
"""Why the kernel stopped: the goal is reached; pages are missing; the arrays are full; so many steps were made;
the crossing of the two queues is at priorities that were not computed again."""

RESERVE = 512
"""Nodes and strips that must be free before a split (a forced split makes at most four on each of its levels)."""


# ---- places in the queues --------------------------------------------------------------------------------------------


@leaf
def place(nodes, heads, occupied, counts, i):
    """Put leaf i into the split queue, or the mergeable diamond of node i into the merge queue, by priority."""
    node = nodes[i]
    if node.state == LEAF:
        if node.priority > 0.0 and node.flags & LOADED:
            counts[QUEUED_SPLITS] += node.bucket < 0
            enqueue(nodes, heads, occupied, SPLIT, i, node.priority)
        elif node.bucket >= 0:
            counts[QUEUED_SPLITS] -= 1
            dequeue(nodes, heads, occupied, SPLIT, i)
    elif node.flags & MERGEABLE:
        base = np.int64(node.base)
        priority = node.priority
        if base >= 0:
            priority = max(priority, nodes[base].priority)
            i = min(i, base)
        counts[QUEUED_MERGES] += nodes[i].bucket < 0
        enqueue(nodes, heads, occupied, MERGE, i, priority)


@leaf
def leave(nodes, heads, occupied, counts, i):
    """Take leaf i out of the split queue, or the diamond of node i out of the merge queue."""
    node = nodes[i]
    if node.state == LEAF:
        counts[QUEUED_SPLITS] -= node.bucket >= 0
        dequeue(nodes, heads, occupied, SPLIT, i)
    else:
        if node.base >= 0:
            i = min(i, np.int64(node.base))
        counts[QUEUED_MERGES] -= nodes[i].bucket >= 0
        dequeue(nodes, heads, occupied, MERGE, i)


@leaf
def assess(s, i):
    """Compute node i's priority and put it where it belongs: queue, crossing list, output."""
    unschedule(s.nodes, s.lists, i)
    priority_of(s.nodes, s.pages, s.lens, s.clock, s.counts, s.options, s.terms, s.stack, s.work, s.waiting, i)
    if s.nodes[i].due < np.inf:
        schedule(s.nodes, s.lists, s.clock, i)
    place(s.nodes, s.heads, s.occupied, s.counts, i)
    if s.nodes[i].state == LEAF:
        show(s, i)


# ---- splits and merges -----------------------------------------------------------------------------------------------


@leaf
def not_mergeable(s, i):
    """A child of node i has been split: its diamond cannot be merged for now."""
    if i >= 0 and s.nodes[i].flags & MERGEABLE:
        leave(s.nodes, s.heads, s.occupied, s.counts, i)
        base = np.int64(s.nodes[i].base)
        for j in (i, base):
            if j >= 0:
                s.nodes[j].flags &= ~np.uint8(MERGEABLE)
                unschedule(s.nodes, s.lists, j)


@leaf
def now_mergeable(s, i):
    """A child of node i is a leaf again: perhaps its diamond can be merged."""
    if i >= 0 and not s.nodes[i].flags & MERGEABLE and is_mergeable(s.nodes, i):
        base = np.int64(s.nodes[i].base)
        s.nodes[i].flags |= MERGEABLE
        if base >= 0:
            s.nodes[base].flags |= MERGEABLE
            assess(s, base)
        assess(s, i)


@leaf
def split_diamond(s, i):
    """Split the diamond of leaf i, whose base neighbour is of its level or absent; False if its page is absent."""
    nodes = s.nodes
    base = np.int64(nodes[i].base)
    for j in (i, base):
        if j >= 0 and not nodes[j].flags & LOADED and not load(nodes, s.pages, s.options, s.terms, j):
            return False
    for j in (i, base):
        if j >= 0:
            leave(nodes, s.heads, s.occupied, s.counts, j)
            hide(s, j)
            not_mergeable(s, np.int64(nodes[j].parent))
    node = nodes[i]
    missing = node.color < 0.0
    split_links(nodes, s.counts, i, np.float32(np.nan) if missing else node.height)
    s.counts[SPLITS] += 1
    for j in (i, base):
        if j >= 0:
            nodes[j].flags |= MERGEABLE
    for j in (i, base):
        if j >= 0:
            if nodes[j].flags & PENDING:
                nodes[j].flags &= ~np.uint8(PENDING)
                assess(s, j)
            child = np.int64(nodes[j].child)
            assess(s, child)
            assess(s, child + 1)
    place(nodes, s.heads, s.occupied, s.counts, i)
    return True


@leaf
def merge_diamond(s, i):
    """Merge the mergeable diamond of node i."""
    nodes = s.nodes
    base = np.int64(nodes[i].base)
    leave(nodes, s.heads, s.occupied, s.counts, i)
    for j in (i, base):
        if j >= 0:
            child = np.int64(nodes[j].child)
            for k in (child, child + 1):
                leave(nodes, s.heads, s.occupied, s.counts, k)
                unschedule(nodes, s.lists, k)
                hide(s, k)
                nodes[k].flags &= LOOSELY
    for j in (i, base):
        if j >= 0:
            rejoin(nodes, s.counts, j)
            nodes[j].flags &= ~np.uint8(MERGEABLE)
    s.counts[MERGES] += 1
    for j in (i, base):
        if j >= 0:
            place(nodes, s.heads, s.occupied, s.counts, j)
            show(s, j)
            now_mergeable(s, np.int64(nodes[j].parent))


@leaf
def force_split(s, i):
    """Split leaf i after all that must be split before (sec. 4.1); False if a page was absent on the way."""
    depth = 0
    stack = s.stack
    stack[128] = i
    while depth >= 0:
        j = np.int64(stack[128 + depth])
        base = coarser_base(s.nodes, j)
        if base >= 0:
            depth += 1
            stack[128 + depth] = base
        elif split_diamond(s, j):
            depth -= 1
        else:
            return False
    return True


@leaf
def wait(s, i):
    """Leaf i cannot be split before a page has come."""
    leave(s.nodes, s.heads, s.occupied, s.counts, i)
    unschedule(s.nodes, s.lists, i)
    if not s.nodes[i].flags & PENDING:
        s.nodes[i].flags |= PENDING
        s.waiting[s.counts[WAITING]] = i
        s.counts[WAITING] += 1


# ---- the frame -------------------------------------------------------------------------------------------------------


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
                assess(s, j)
    return True


@leaf
def assess_all(s, steps):
    """Compute everything again, at most so many: the tolerance or the lens is another one. As ``assess_due``."""
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
def assess_waiting(s):
    """Compute what waited for pages."""
    count = s.counts[WAITING]
    s.counts[WAITING] = 0
    for at in range(count):
        i = np.int64(s.waiting[at])
        if s.nodes[i].state != FREE and s.nodes[i].flags & PENDING:
            s.nodes[i].flags &= ~np.uint8(PENDING)
            assess(s, i)


@leaf
def is_full(s):
    """Whether nodes or strips may not suffice for a forced split and its cuts."""
    return (s.counts[FREED] < 0 and s.counts[TOP] + RESERVE > len(s.nodes)) or lacks_room(s, RESERVE)


@leaf
def by_tolerance(s, steps):
    """Split what exceeds the tolerance, then merge what need not be split, at most so many of each."""
    left = steps
    while True:
        bucket = highest(s.occupied, SPLIT)
        if bucket < UNITY or left == 0:
            break
        if is_full(s):
            return ROOM
        left -= 1
        i = np.int64(s.heads[SPLIT, bucket])
        if not force_split(s, i):
            wait(s, i)
    more = left == 0
    left = steps
    while True:
        bucket = lowest(s.occupied, MERGE)
        if bucket >= UNITY:
            break
        if left == 0:
            return LIMIT
        if is_full(s):
            return ROOM
        left -= 1
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

    It ends: a diamond is merged for the sake of one whose bucket is higher, so of those that were split and merged over
    and over the highest could not have been merged.
    """
    least = bucket_of(np.float32(s.options[LOW]))
    most = bucket_of(np.float32(s.options[HIGH]))
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
            if not force_split(s, i):
                wait(s, i)
            continue
        elif split <= merge:
            return DONE
        if merge > most:
            return DRIFT
        if is_full(s):
            return ROOM
        merge_diamond(s, np.int64(s.heads[MERGE, merge]))


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
        steps: how many priorities, splits and merges are allowed; −1 all that are needed.

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
