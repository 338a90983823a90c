"""Splits and merges of ROAM's diamonds, with all that hangs on them: queues, lists of what is due, the output.

Paper sec. 4.1 and 5. Who changes a node's state or priority puts it where it belongs at once; whenever one of these
functions returns, every leaf that wants to be split is in the split queue, every diamond that could be merged in the
merge queue, and the mesh is conforming.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf
from orograph.lod.roam.mesh import (
    LEAF,
    LOADED,
    LOOSELY,
    MERGEABLE,
    MERGES,
    PENDING,
    QUEUED_MERGES,
    QUEUED_SPLITS,
    SPLITS,
    coarser_base,
    is_mergeable,
    rejoin,
    split_links,
)
from orograph.lod.roam.priorities import pend, priority_of
from orograph.lod.roam.queues import MERGE, SPLIT, dequeue, enqueue, schedule, unschedule
from orograph.lod.roam.strips import hide, show
from orograph.lod.roam.volumes import load

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


@inlined
def assess(s, i):
    """Compute node i's priority and put it where it belongs: queue, crossing list, output.

    (Inlined: the state is some 300 words, and every call that passes it copies them.)
    """
    unschedule(s.nodes, s.lists, i)
    priority_of(s.nodes, s.pages, s.cameras[0], s.clock, s.counts, s.options, s.terms, s.waiting, s.scratch, i)
    if s.nodes[i].due < np.inf:
        schedule(s.nodes, s.lists, s.clock, i)
    place(s.nodes, s.heads, s.occupied, s.counts, i)
    if s.nodes[i].state == LEAF:
        show(s, i)


@leaf
def assess_seldom(s, i):
    """``assess``, for where little comes by: each inlined copy takes two seconds to compile."""
    assess(s, i)


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
            assess_seldom(s, base)
        assess_seldom(s, i)


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
                assess_seldom(s, j)
            child = np.int64(nodes[j].child)
            for k in range(child, child + 2):
                assess(s, k)
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
    stack = s.scratch.stack
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
    pend(s.nodes[i], s.counts, s.waiting, i)
