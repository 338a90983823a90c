"""Triangles that wait for a length of way: a radix heap of doubly linked lists.

A triangle is to be looked at again when the way travelled has grown to its number in ``due``. The way never shrinks, so
a radix heap serves (Ahuja, Mehlhorn, Orlin & Tarjan 1990, *Faster algorithms for the shortest path problem*): list b
holds what is due at a way whose highest bit that differs from the present one is its b-th; list 0 is due at once. When
the way grows and its highest bit to change is the h-th, all in the lists below h is due, and list h is sorted anew. A
triangle falls from list to list at most as often as there are bits; entering, leaving and becoming due take constant
time.

Two more lists hold triangles that lack a page and triangles to be looked at now. Each is in one list or in none, and
its links are its neighbours there and the list. Ways are integers, in units of the caller's.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, leaf
from orograph.hierarchy.kernels import bits

LISTS, PENDING, WORK = 67, 65, 66
"""How many lists there are: 0 … 64 by bits; those that lack a page; those to be looked at now."""

BEFORE, AFTER, WHERE = range(3)
"""Links of a triangle: its neighbours in its list, −1: none; which list, −1: none."""


@inlined
def list_of(due, now):
    """The list of what is due at ``due`` ≥ ``now``."""
    return (bits.floor_log2(due ^ now) + 1) if due != now else np.int64(0)


@inlined
def unlink(links, heads, v):
    """Take a triangle out of its list."""
    where = links[v, 2]
    if where >= 0:
        before, after = links[v, 0], links[v, 1]
        if before >= 0:
            links[before, 1] = after
        else:
            heads[where] = after
        if after >= 0:
            links[after, 0] = before
        links[v, 2] = -1


@inlined
def link(links, heads, v, where):
    """Put a triangle that is in no list into one."""
    after = heads[where]
    links[v, 0], links[v, 1], links[v, 2] = -1, after, where
    if after >= 0:
        links[after, 0] = v
    heads[where] = v


@leaf
def advance(links, due, heads, before, now):
    """Let the way grow from ``before`` to ``now``: what is due goes into the list of work."""
    if now <= before:
        return
    h = list_of(now, before)
    for where in range(h + 1):
        v = heads[where]
        heads[where] = -1
        while v >= 0:
            after = links[v, 1]
            to = np.int64(66)
            if where == h and due[v] > now:
                to = list_of(due[v], now)
            link(links, heads, v, to)
            v = after
