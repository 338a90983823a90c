"""The priority of a triangle, monotonic down the tree, and for how long it stays on its side of the threshold.

ROAM, sec. 6.1 and 6.2: 0 if the volume (``volumes``) is wholly outside a plane of the frustum; infinite if part of it
is surface and part hole, or a demand wants it split (``terms``); else the bound in pixels over the volume (``bounds``)
beside the tolerance. Volumes nest and bounds can only grow with them, so priorities can only fall from a triangle to
its children: the mesh in which no triangle exceeds the tolerance, and no merge is left that would not make one, is
unique. With the metric ``localised``, a triangle close to the eye whose bound exceeds the tolerance is looked at more
closely (``lookahead``), and has priority 1 if no sample in or below it asks for a split.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.lod.roam.bounds import around, screen
from orograph.lod.roam.facing import factor_of
from orograph.lod.roam.horizon import is_hidden
from orograph.lod.roam.lookahead import ABSENT, ACTIVE, foresee
from orograph.lod.roam.mesh import (
    COMPUTED,
    CULL,
    EMPTY,
    EVERY,
    EXCEEDS,
    FRAME,
    HIGH,
    LEAF,
    LOADED,
    LOW,
    NEARNESS,
    OUT,
    PENDING,
    PINNED,
    TOLERANCE,
    WAITING,
)
from orograph.lod.roam.queues import class_of, reach_of
from orograph.lod.roam.terms import OCCLUDED, OUTSIDE, is_pinned
from orograph.lod.roam.volumes import GAP, LABEL, ROOM, distance, frustum, inherited, load

LARGEST = float(np.finfo(np.float32).max)
"""The largest priority of what is no hole."""


@leaf
def pend(node, counts, waiting, i):
    """Let node i wait for a page; it is computed when it has come."""
    if not node.flags & PENDING:
        node.flags |= PENDING
        waiting[counts[WAITING]] = i
        counts[WAITING] += 1
    node.due = np.inf


@leaf
def priority_of(nodes, pages, camera, clock, counts, options, terms, waiting, scratch, i):
    """Compute node i's priority, whether it is in view and over the tolerance, and when it is due again.

    A triangle out of view does not need its diamond; one in view whose page is absent waits for it.
    """
    node, work = nodes[i], scratch.work
    counts[COMPUTED] += 1
    node.frame = counts[FRAME]
    edge = pages.edge
    node.flags &= ~np.uint8(OUT | EXCEEDS)
    node.priority = 0.0
    known, lasts = inherited(nodes, pages, camera, clock, counts, scratch, i)
    inside = frustum(node, edge, camera, known, work)
    if not node.flags & LOADED and (
        work[GAP] < 0.0
        or options[CULL] == 0.0
        or terms.factors[OUTSIDE] > 0.0
        or (len(terms.demands) > 0 and is_pinned(node, edge, terms, np.inf))
    ):
        if not load(nodes, pages, options, terms, i):
            pend(node, counts, waiting, i)
            return
        inside = frustum(node, edge, camera, known, work)
    gap, room, label = work[GAP], work[ROOM], work[LABEL]
    if gap < 0.0 and lasts < 0.25 * room:
        # What is inherited lasts too briefly to wait for.
        inside = frustum(node, edge, camera, 0, work)
        gap, room, label, lasts = work[GAP], work[ROOM], work[LABEL], np.inf
    room = min(room, lasts)
    far = distance(node, edge, camera)
    k = class_of(far)
    if k >= 0:
        node.inside, node.label_class = inside, k
        node.label_until = clock[k] + min(min(label, lasts), reach_of(k) / 8.0) * 0.999
    factor, lasting = factor_of(node, edge, terms)
    if gap >= 0.0:
        node.flags |= OUT
        factor *= terms.factors[OUTSIDE]
        room = gap
    if factor > 0.0:
        if gap < 0.0:
            bound, slack = screen(node, edge, camera, options, options[LOW] / factor, options[HIGH] / factor)
            if terms.factors[OUTSIDE] > 0.0:
                # It counts for no less than it would out of view: else a child that is could count for more.
                share = factor * terms.factors[OUTSIDE]
                low, high = options[LOW] / share, options[HIGH] / share
                aside, lasting_aside = around(node, edge, terms, camera, options, low, high)
                if bound <= options[HIGH] / factor:
                    slack = lasting_aside if aside > high else min(slack, lasting_aside)
                bound = max(bound, aside * terms.factors[OUTSIDE])
        else:
            bound, slack = around(node, edge, terms, camera, options, options[LOW] / factor, options[HIGH] / factor)
        bound *= factor
        if terms.factors[OCCLUDED] < 1.0 and bound > options[LOW]:
            lasting = 0.0
            if is_hidden(node, edge, terms):
                bound *= terms.factors[OCCLUDED]
    else:
        bound, slack = 0.0, np.inf
    slack = min(slack, lasting)
    absent = False
    if options[NEARNESS] > 0.0 and gap < 0.0 and bound > options[LOW] and not node.flags & PINNED and k >= 0:
        verdict, holds = foresee(
            node, pages, camera, options, terms, scratch, options[LOW], inside, min(label, lasts), slack, k
        )
        absent = verdict == ABSENT
        if not absent:
            slack = min(holds, lasting) if verdict == ACTIVE else holds
            if verdict != ACTIVE:
                bound = options[LOW]
    slack = min(slack, room)
    if node.flags & PINNED:
        bound, slack = np.inf, room
    drawn = node.flags & LOADED and (options[CULL] == 0.0 or gap < 0.0)
    is_mixed = drawn and node.error == np.inf and not node.flags & EMPTY
    if is_mixed:
        bound = np.inf  # whatever the factors: a hole's edge is kept in what is drawn
    if node.flags & EMPTY:
        bound = 0.0
    tolerance = options[TOLERANCE]
    if bound > tolerance:
        node.flags |= EXCEEDS
        node.priority = max(
            np.float32(min(bound / tolerance if tolerance > 0.0 else LARGEST, LARGEST)),
            np.nextafter(np.float32(1.0), np.float32(2.0)),
        )
        if is_mixed:
            node.priority = np.float32(np.inf)
    else:
        node.priority = min(np.float32(bound / tolerance if tolerance > 0.0 else 0.0), np.float32(1.0))
    if absent:
        pend(node, counts, waiting, i)
        if node.state == LEAF:
            node.priority = 0.0
    elif k < 0 or options[EVERY] > 0.0:
        node.reach, node.due = max(k, 0), -1.0
    else:
        node.reach, node.due = k, clock[k] + min(slack, reach_of(k) / 8.0) * 0.999
