"""The output of ROAM, kept from frame to frame: generalised triangle strips, or a plain list of triangles.

Paper sec. 5.2. A strip is a sequence of drawn triangles of which each shares an edge with the next; every strip has a
*block* of ``LENGTH`` vertices in one array that is never built anew. A triangle that goes (split, merged, out of view)
cuts its strip in two. At the end of the frame those that came are put, with their neighbours that came too, at the ends
of neighbouring strips or into strips of their own; strips that were touched are joined end to end where a block holds
both; and only their blocks are written again. All else stays.

The array as a whole is one generalised strip: a block begins with a vertex twice and ends with one at least twice, so
that the triangles that straddle blocks have no area, and blocks have even length, so that winding does not depend on
what comes before. Blocks in use come first: the last ones move into those that have become free. In a block (Lindstrom
& Pascucci 2001, sec. 3.4): with p, q written and v the newest vertex, not written yet, the next triangle shares q, v
(write v) or p, v (write p, which turns the strip, then v).
"""

from __future__ import annotations

import numpy as np

from orograph._numba import leaf
from orograph.lod.roam.mesh import BLOCKS, CULL, DIRTY, DRAWN, EMPTY, LEAF, LOOSE, LOOSELY, OUT, SHOWN, UNUSED

LENGTH = 24
"""Vertices of a block."""

FULL = LENGTH - 1
SIZE, USED, TOUCHED, NEXT = 0, 1, 2, 3
"""Of each strip: triangles; (at most) vertices written; whether its block has to be written; next unused block."""

ABSENT, NEW = -1, -2
"""``slot`` of a node that is not drawn, and of one that is in no strip yet."""


@leaf
def show(s, i):
    """Put leaf i into the output, or take it out, as its flags say."""
    node = s.nodes[i]
    drawn = node.state == LEAF and not node.flags & EMPTY and not (node.flags & OUT and s.options[CULL] > 0.0)
    if not (drawn and node.z0 + node.z1 + node.z2 < np.inf and has_area(node, s.pages.edge)):
        hide(s, i)
    elif node.slot == ABSENT:
        s.counts[SHOWN] += 1
        at = s.counts[DRAWN]
        s.counts[DRAWN] = at + 1
        if len(s.strips) > 1:
            node.slot = NEW
            if not node.flags & LOOSELY:
                node.flags |= LOOSELY
                s.loose[s.counts[LOOSE]] = i
                s.counts[LOOSE] += 1
        else:
            node.slot = at
            s.members[at] = i
            for k in range(3):
                key, z = vertex(node, k)
                s.keys[3 * at + k], s.zs[3 * at + k] = key, z


@leaf
def has_area(node, edge):
    """Whether a triangle has an area once it is squeezed onto the raster."""
    r0, r1, r2 = min(node.r0, edge[0]), min(node.r1, edge[0]), min(node.r2, edge[0])
    c0, c1, c2 = min(node.c0, edge[1]), min(node.c1, edge[1]), min(node.c2, edge[1])
    return (r1 - r0) * (c2 - c0) != (c1 - c0) * (r2 - r0)


@leaf
def hide(s, i):
    """Take node i out of the output, if it is in."""
    at = np.int64(s.nodes[i].slot)
    if at == ABSENT:
        return
    last = s.counts[DRAWN] - 1
    s.counts[DRAWN] = last
    if len(s.strips) > 1:
        if at >= 0:
            cut(s, i)
    elif last != at:  # the last of the list takes its place
        j = s.members[last]
        s.members[at] = j
        s.nodes[j].slot = at
        for k in range(3):
            s.keys[3 * at + k], s.zs[3 * at + k] = s.keys[3 * last + k], s.zs[3 * last + k]
    s.nodes[i].slot = ABSENT


@leaf
def vertex(node, k):
    """Key and height of a node's corner."""
    if k == 0:
        return np.int64(node.r0) << 32 | node.c0, node.z0
    if k == 1:
        return np.int64(node.r1) << 32 | node.c1, node.z1
    return np.int64(node.r2) << 32 | node.c2, node.z2


@leaf
def has(node, key):
    """Whether one of a node's corners has that key."""
    return vertex(node, 0)[0] == key or vertex(node, 1)[0] == key or vertex(node, 2)[0] == key


@leaf
def lacks_room(s, reserve):
    """Whether so many strips more may not fit."""
    return len(s.strips) > 1 and s.counts[BLOCKS] + reserve > len(s.strips)


@leaf
def touch(s, b):
    """Strip b's block has to be written again."""
    if not s.strips[b, TOUCHED]:
        s.strips[b, TOUCHED] = 1
        s.dirty[s.counts[DIRTY]] = b
        s.counts[DIRTY] += 1


@leaf
def new_strip(s):
    """An unused block; there must be room."""
    b = s.counts[UNUSED]
    if b >= 0:
        s.counts[UNUSED] = s.strips[b, NEXT]
    else:
        b = s.counts[BLOCKS]
        s.counts[BLOCKS] = b + 1
    s.strips[b, SIZE] = 0
    s.strips[b, USED] = 2
    touch(s, b)
    return b


@leaf
def drop_strip(s, b):
    """Strip b has no triangles any more."""
    s.strips[b, SIZE] = 0
    s.strips[b, NEXT] = s.counts[UNUSED]
    s.counts[UNUSED] = b
    touch(s, b)


@leaf
def append(s, b, i):
    """Put node i at the end of strip b."""
    k = np.int64(s.strips[b, SIZE])
    s.members[b * LENGTH + k] = i
    s.nodes[i].slot, s.nodes[i].strip = b, k
    s.strips[b, SIZE] = k + 1
    s.strips[b, USED] += 2  # or 1, if it does not turn


@leaf
def reverse(s, b):
    """Turn a strip's order round."""
    size = np.int64(s.strips[b, SIZE])
    for k in range(size // 2):
        i, j = s.members[b * LENGTH + k], s.members[b * LENGTH + size - 1 - k]
        s.members[b * LENGTH + k], s.members[b * LENGTH + size - 1 - k] = j, i
    for k in range(size):
        s.nodes[s.members[b * LENGTH + k]].strip = k


@leaf
def cut(s, i):
    """Take node i out of its strip; what came after it becomes a strip of its own."""
    b, k = np.int64(s.nodes[i].slot), np.int64(s.nodes[i].strip)
    size = np.int64(s.strips[b, SIZE])
    touch(s, b)
    if k == 0 and size > 1:
        reverse(s, b)
        k = size - 1
    s.strips[b, SIZE] = k
    used = np.int64(s.strips[b, USED])
    s.strips[b, USED] = min(used, 2 + 2 * k)
    if k == 0:
        drop_strip(s, b)
    elif k + 1 < size:
        rest = new_strip(s)
        for at in range(k + 1, size):
            append(s, rest, np.int64(s.members[b * LENGTH + at]))
        s.strips[rest, USED] = min(used, np.int64(s.strips[rest, USED]))


@leaf
def neighbour(node, k):
    """Left, right, base."""
    return np.int64(node.left if k == 0 else node.right if k == 1 else node.base)


@leaf
def thread(s, i):
    """Put the loose node i at the end of a neighbour's strip, or begin one; go on with loose neighbours of it."""
    nodes = s.nodes
    b = np.int64(-1)
    for k in range(3):
        j = neighbour(nodes[i], k)
        if b < 0 and j >= 0 and nodes[j].slot >= 0:
            other = np.int64(nodes[j].slot)
            last = np.int64(s.strips[other, SIZE]) - 1
            if s.strips[other, USED] + 2 <= FULL and (nodes[j].strip == last or nodes[j].strip == 0):
                if nodes[j].strip != last:
                    reverse(s, other)
                b = other
    if b < 0:
        b = new_strip(s)
    touch(s, b)
    alone = s.strips[b, SIZE] == 0
    extend(s, b, i)
    if alone:  # on from its other end, too
        reverse(s, b)
        extend(s, b, loosest(s, np.int64(s.members[b * LENGTH + s.strips[b, SIZE] - 1])))


@leaf
def extend(s, b, i):
    """Put the loose node i (or −1) at the end of strip b, then a loose neighbour of it, and so on."""
    while i >= 0 and s.strips[b, USED] + 2 <= FULL:
        append(s, b, i)
        i = loosest(s, i)


@leaf
def loosest(s, i):
    """The neighbour of node i that is in no strip yet and has the fewest neighbours like that itself, or −1."""
    nodes = s.nodes
    best, fewest = np.int64(-1), 4
    for k in range(3):
        j = neighbour(nodes[i], k)
        if j >= 0 and nodes[j].slot == NEW:
            count = 0
            for m in range(3):
                other = neighbour(nodes[j], m)
                count += other >= 0 and nodes[other].slot == NEW
            if count < fewest:
                best, fewest = j, count
    return best


@leaf
def join(s, b):
    """Join strip b at its ends to strips that fit."""
    nodes = s.nodes
    for end in range(2):
        size = np.int64(s.strips[b, SIZE])
        if size == 0:
            return
        if end:
            reverse(s, b)
        i = s.members[b * LENGTH + size - 1]
        for k in range(3):
            j = neighbour(nodes[i], k)
            if j < 0 or nodes[j].slot < 0 or nodes[j].slot == b:
                continue
            other = np.int64(nodes[j].slot)
            count = np.int64(s.strips[other, SIZE])
            if s.strips[b, USED] + s.strips[other, USED] > FULL or (
                nodes[j].strip != 0 and nodes[j].strip != count - 1
            ):
                continue
            if nodes[j].strip != 0:
                reverse(s, other)
            used = np.int64(s.strips[b, USED]) + np.int64(s.strips[other, USED])
            for at in range(count):
                append(s, b, np.int64(s.members[other * LENGTH + at]))
            s.strips[b, USED] = used
            drop_strip(s, other)
            touch(s, b)
            break


@leaf
def write(s, b):
    """Write the vertices of strip b's block."""
    begin = b * LENGTH
    keys, zs = s.keys, s.zs
    size = np.int64(s.strips[b, SIZE])
    if size == 0:
        return
    node = s.nodes[s.members[begin]]
    k = 0
    if size > 1:
        following = s.nodes[s.members[begin + 1]]
        while has(following, vertex(node, k)[0]):  # the corner that the second triangle has not
            k += 1
    p, pz = vertex(node, k)
    v, vz = vertex(node, (k + 1) % 3)
    q, qz = vertex(node, (k + 2) % 3)
    keys[begin], zs[begin], keys[begin + 1], zs[begin + 1] = p, pz, p, pz
    keys[begin + 2], zs[begin + 2] = q, qz
    at = begin + 3
    for t in range(1, size):
        node = s.nodes[s.members[begin + t]]
        if not has(node, q):
            keys[at], zs[at] = p, pz
            at += 1
            q, qz = p, pz
        keys[at], zs[at] = v, vz
        at += 1
        p, pz, q, qz = q, qz, v, vz
        k = 0
        while vertex(node, k)[0] == p or vertex(node, k)[0] == q:
            k += 1
        v, vz = vertex(node, k)
    s.strips[b, USED] = at + 1 - begin
    while at < begin + LENGTH:
        keys[at], zs[at] = v, vz
        at += 1


@leaf
def restrip(s):
    """Bring the strips up to date; False if there may be too few blocks (call again when there are more)."""
    while s.counts[LOOSE]:
        if lacks_room(s, 2):
            return False
        s.counts[LOOSE] -= 1
        i = np.int64(s.loose[s.counts[LOOSE]])
        node = s.nodes[i]
        node.flags &= ~np.uint8(LOOSELY)
        if node.state == LEAF and node.slot == NEW:
            thread(s, i)
    count = s.counts[DIRTY]
    for at in range(count):
        join(s, np.int64(s.dirty[at]))
    for at in range(s.counts[DIRTY]):
        b = np.int64(s.dirty[at])
        write(s, b)
        s.strips[b, TOUCHED] = 0
    s.counts[DIRTY] = 0
    close_ranks(s)
    return True


@leaf
def close_ranks(s):
    """Move the last blocks into unused ones."""
    b = s.counts[UNUSED]
    while True:
        while s.counts[BLOCKS] > 0 and s.strips[s.counts[BLOCKS] - 1, SIZE] == 0:
            s.counts[BLOCKS] -= 1
        if b < 0:
            break
        following = np.int64(s.strips[b, NEXT])
        last = s.counts[BLOCKS] - 1
        if b < last:
            for at in range(LENGTH):
                s.keys[b * LENGTH + at], s.zs[b * LENGTH + at] = s.keys[last * LENGTH + at], s.zs[last * LENGTH + at]
                s.members[b * LENGTH + at] = s.members[last * LENGTH + at]
            s.strips[b, SIZE], s.strips[b, USED] = s.strips[last, SIZE], s.strips[last, USED]
            s.strips[last, SIZE] = 0
            for k in range(s.strips[b, SIZE]):
                s.nodes[s.members[b * LENGTH + k]].slot = b
        b = following
    s.counts[UNUSED] = -1


@leaf
def unravel(s):
    """Take all strips apart: every drawn triangle is loose again."""
    for b in range(s.counts[BLOCKS]):
        for k in range(s.strips[b, SIZE]):
            i = s.members[b * LENGTH + k]
            s.nodes[i].slot = NEW
            if not s.nodes[i].flags & LOOSELY:
                s.nodes[i].flags |= LOOSELY
                s.loose[s.counts[LOOSE]] = i
                s.counts[LOOSE] += 1
        s.strips[b, SIZE] = s.strips[b, TOUCHED] = 0
    s.counts[BLOCKS] = s.counts[DIRTY] = 0
    s.counts[UNUSED] = -1
