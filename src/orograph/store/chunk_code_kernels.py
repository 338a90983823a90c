"""The triangles of a chunk in runs, as ``chunk_code`` writes them: written down, and read again.

The *walk* goes through the binary tree of right triangles in the order of the Sierpinski curve. A *node* is a triangle:
its apex, and the ends of its hypotenuse where the curve enters and leaves. The vertex b in the middle of that splits
(a, e, f) into (b, e, a) and (b, a, f); so the hypotenuses of nodes of even depth lie on one side of the curve, those of
odd depth on the other. What lies on one side is met again in reverse order: a vertex is met twice, at the two nodes
whose hypotenuse it splits, so a stack for each side knows the number of each that is met again (Bader & Zenger). The
first time it is put there once its node is done; the second time it is on top. Of each edge of a node one bit says
whether it is *new*, to be met again within the walk. If an edge is not and the vertex is not on its stack, it lies
between two runs and each has its own. (Only where a triangle beyond the raster is not split as its neighbour is do
vertices remain on a stack; then the one looked for is below them.)

Numbers of vertices are those of a run, from 0, its three corners first.
"""

from __future__ import annotations

import numpy as np

from orograph._numba import inlined, kernel
from orograph.store.chunk_code import DEPTH, MET, ONES, RAW
from orograph.store.chunked import MISSING, PARTS
from orograph.store.chunked_kernels import DROPPED, KEPT, SPLIT, slot

ABOUT = 11
ROW, COL, SIDE, LAST_ROW, LAST_COL, LEVELS, HOLES, DROP, BASE, HIGH, MOVED = range(ABOUT)
"""What there is to know about a chunk: its first row and column, its side, the raster's last row and column, how often
its triangles may be halved, whether heights may be missing; bits of the skirt's depths, the lowest height, bits of
heights above it and of targets' differences."""

APEX, ENTRY, EXIT, NEW, NEW_FIRST, NEW_SECOND, DEEP = range(7)
"""Of a node: its corners; which edges are new: the hypotenuse, the leg at the entry and that at the exit; its depth."""

MISSED, HEIGHT, KEPT_, DELTA, REST, AT, BESIDE, DOWN = range(8)
"""Of a vertex to be written: whether it is missing, its height above ``BASE``, whether its target is its height, 1 +
how its target differs (zigzag), its residual (zigzag), the depth of the nodes that it splits, whether it lies on a side
of the chunk, how low the skirt hangs."""


@kernel
def replay(codes, corners, places, kept, slots):
    """Find the vertices of a walk (``chunked_kernels.write_walk``).

    Args:
        codes, corners: as written. places: (v, 2) int64, written: rows and columns, the corners' first. kept: (v,)
            uint8, written: whether the next coarser level has it. slots: (s, 2) int64, all −1; written: by place, the
            number of the vertex there, or −2 for a triangle without ground whose hypotenuse has its middle there.
    """
    stack = np.empty((128, 6), np.int64)
    for k in range(2):
        a, b, c = (0, 1, 3) if k == 1 else (2, 3, 1)
        stack[k, 0], stack[k, 1], stack[k, 2] = corners[a, 0], corners[a, 1], corners[b, 0]
        stack[k, 3], stack[k, 4], stack[k, 5] = corners[b, 1], corners[c, 0], corners[c, 1]
    for k in range(4):
        places[k, 0], places[k, 1], kept[k] = corners[k, 0], corners[k, 1], 1
    top, count = 2, 4
    for n in range(len(codes)):
        top -= 1
        ar, ac, lr, lc, rr, rc = stack[top]
        br, bc = (lr + rr) >> 1, (lc + rc) >> 1
        key = br << 32 | bc
        if codes[n] >= SPLIT:
            at = slot(slots, key)
            if slots[at, 0] == -1:
                slots[at, 0], slots[at, 1] = key, count
                places[count, 0], places[count, 1], kept[count] = br, bc, codes[n] == KEPT
                count += 1
            stack[top, 0], stack[top, 1], stack[top, 2] = br, bc, rr
            stack[top, 3], stack[top, 4], stack[top, 5] = rc, ar, ac
            stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = br, bc, ar
            stack[top + 1, 3], stack[top + 1, 4], stack[top + 1, 5] = ac, lr, lc
            top += 2
        elif codes[n] == DROPPED:
            at = slot(slots, key)
            slots[at, 0], slots[at, 1] = key, -2


# ---- the walk -------------------------------------------------------------------------------------------------------


@inlined
def begin(node, a, e, f, depth):
    """Begin a walk at a node, of whose edges none is new."""
    node[APEX], node[ENTRY], node[EXIT], node[DEEP] = a, e, f, depth
    node[NEW] = node[NEW_FIRST] = node[NEW_SECOND] = 0


@inlined
def met(node, waiting, counts, places, names, first, row, col):
    """The vertex on the node's hypotenuse, if the run has it, or −1.

    Args:
        places, names, first: vertex v of the run is at ``places[names[v] + first]``. row, col: the hypotenuse's middle.
    """
    side = node[DEEP] & 1
    if not node[NEW]:
        for k in range(counts[side] - 1, -1, -1):
            v = waiting[side, k]
            at = names[v] + first
            if places[at, 0] == row and places[at, 1] == col:
                counts[side] = k
                return v
    return np.int64(-1)


@inlined
def halve(node, b, over, stack, top):
    """Go on to the first half of a node, or over it to the second.

    Returns: the top of the stack: of the halves that follow (b, a, f, whether its hypotenuse and its second leg are
        new, depth), and of vertices (b, b, …) whose node is then done.
    """
    a, e, f, new, first, second = node[0], node[1], node[2], node[3], node[4], node[5]
    node[APEX] = b
    node[DEEP] += 1
    if over:
        if new:
            stack[top] = pending(b, b, 0, 0, 0, node[DEEP])
            top += 1
        node[ENTRY], node[EXIT] = a, f
        node[NEW], node[NEW_FIRST], node[NEW_SECOND] = second, 0, new
        return top
    stack[top] = pending(b, a, f, second, new, node[DEEP])
    node[ENTRY], node[EXIT] = e, a
    node[NEW], node[NEW_FIRST], node[NEW_SECOND] = first, new, 1
    return top + 1


@inlined
def pending(b, a, f, new, second, depth):
    return b | a << 8 | f << 16 | new << 24 | second << 25 | depth << 26


@inlined
def onward(node, stack, top, waiting, counts):
    """Go on from a leaf to the node that follows it.

    Returns: the top of the stack, −1 where none follows.
    """
    while top > 0:
        entry = stack[top - 1]
        b, a, depth, new = entry & 255, entry >> 8 & 255, entry >> 26, entry >> 25 & 1
        if a != b:
            if new:
                stack[top - 1] = pending(b, b, 0, 0, 0, depth)
            else:
                top -= 1
            node[APEX], node[ENTRY], node[EXIT], node[DEEP] = b, a, entry >> 16 & 255, depth
            node[NEW], node[NEW_FIRST], node[NEW_SECOND] = entry >> 24 & 1, 0, new
            return top
        side = (depth - 1) & 1
        waiting[side, counts[side]] = b
        counts[side] += 1
        top -= 1
    return -1


@inlined
def drawn(places, heights, a, e, f, about):
    """Whether a triangle has three heights and, if vertices beyond the raster lie on its border, an area."""
    if heights[a] == MISSING or heights[e] == MISSING or heights[f] == MISSING:
        return False
    row, col = min(places[a, 0], about[LAST_ROW]), min(places[a, 1], about[LAST_COL])
    u, v = min(places[e, 0], about[LAST_ROW]) - row, min(places[e, 1], about[LAST_COL]) - col
    x, y = min(places[f, 0], about[LAST_ROW]) - row, min(places[f, 1], about[LAST_COL]) - col
    return u * y != v * x


@inlined
def beside(places, v, about):
    """On which of the chunk's sides a vertex lies: a bit each."""
    row, col = places[v, 0] - about[ROW], places[v, 1] - about[COL]
    side = about[SIDE]
    return (row == 0) | (col == 0) << 1 | (row == side) << 2 | (col == side) << 3


@inlined
def hangs(places, low, p, q, about):
    """Whether a skirt hangs from an edge."""
    return low[p] != MISSING and low[q] != MISSING and (beside(places, p, about) & beside(places, q, about)) != 0


# ---- written --------------------------------------------------------------------------------------------------------


@kernel
def survey(slots, places, levels, ends, told, paths):
    """Walk over a whole chunk.

    Args:
        slots, places: of ``replay``. levels: how many times triangles may be halved. ends: (v, 2) int64, between which
            two vertices each lies. told: (v, 8) int64; of each ``AT``. paths: (t, 2) int64: of each leaf which root
            and then which halves lead to it, the first in the lowest bit; its depth. All are written to.

    Returns: how many leaves each of the two roots has.
    """
    stack = np.empty((DEPTH + 2, 5), np.int64)
    count, before = 0, 0
    for root in range(2):
        before = count
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3], stack[0, 4] = 2 * root, 1 + 2 * root, 3 - 2 * root, root, 0
        top = 1
        while top:
            top -= 1
            a, e, f, path, depth = stack[top]
            row, col = (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1
            b = found(slots, row, col) if depth < levels else -1
            if b < 0:
                paths[count, 0], paths[count, 1] = path, depth
                count += 1
                continue
            ends[b, 0], ends[b, 1], told[b, AT] = e, f, depth
            stack[top, 0], stack[top, 1], stack[top, 2] = b, a, f
            stack[top, 3], stack[top, 4] = path | 2 << depth, depth + 1
            stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = b, e, a
            stack[top + 1, 3], stack[top + 1, 4] = path, depth + 1
            top += 2
    return before, count - before


@inlined
def found(slots, row, col):
    """The number of the vertex at a place; −1: none, −2: none, and no ground."""
    key = row << 32 | col
    at = slot(slots, key)
    return slots[at, 1] if slots[at, 0] == key else np.int64(-1)


@inlined
def cost(rest, k):
    """The bits of a residual."""
    return (rest >> k) + 1 + k if rest >> k < ONES else ONES + RAW


@kernel
def choose_rices(told, rices):
    """The best Rice parameter for each depth. ``told``: (v, 8), the corners' first; ``rices``: uint8, written to."""
    costs = np.zeros((len(rices), RAW), np.int64)
    for v in range(4, len(told)):
        if not told[v, MISSED]:
            for k in range(RAW):
                costs[told[v, AT], k] += cost(told[v, REST], k)
    for depth in range(len(rices)):
        rices[depth] = np.argmin(costs[depth])


@inlined
def write(words, at, number, width):
    """Write bits; returns where the next go."""
    if width:
        shift = at & 31
        words[at >> 5] |= np.uint32(number << shift & 0xFFFFFFFF)
        if shift + width > 32:
            words[(at >> 5) + 1] |= np.uint32(number >> (32 - shift))
    return at + width


@inlined
def write_path(words, at, path, count):
    """Write how many halves follow and which."""
    at = write(words, at, count, 6)
    for k in range(count):
        at = write(words, at, path >> k & 1, 1)
    return at


@inlined
def trace(slots, places, heights, low, about, paths, span, node, stack, waiting, counts, names, steps, table):
    """Walk over a run.

    Args:
        span: its first leaf and the one after its last. names: numbers of its vertices in the chunk, written to.
        steps: written to: ~0 and ~1 for bits, numbers for vertices. table: as in ``write_runs``.

    Returns: how many steps and vertices there are, and the depth of the node that the run lies in.
    """
    first, last = span[0], span[1]
    path, depth = paths[first, 0], paths[first, 1]
    other, common = path ^ paths[last - 1, 0], min(depth, paths[last - 1, 1])
    for k in range(common, -1, -1):
        if other >> k & 1:
            common = k - 1
    root = path & 1
    names[0], names[1], names[2] = 2 * root, 1 + 2 * root, 3 - 2 * root
    for k in range(common):
        a, e, f = names[0], names[1], names[2]
        b = found(slots, (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1)
        names[0] = b
        names[1], names[2] = (a, f) if path >> (k + 1) & 1 else (e, a)
    begin(node, 0, 1, 2, common)
    counts[0] = counts[1] = 0
    made, count, top, left = 3, 0, 0, depth - common
    while True:
        a, e, f = names[node[APEX]], names[node[ENTRY]], names[node[EXIT]]
        b = np.int64(-1)
        row, col = (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1
        if node[DEEP] < about[LEVELS]:
            b = found(slots, row, col)
            if left == 0:
                steps[count] = ~np.int64(b >= 0)
                count += 1
        if b >= 0:
            over = left > 0 and path >> (node[DEEP] + 1) & 1
            left = max(left - 1, 0)
            mid = met(node, waiting, counts, places, names, 0, row, col)
            if mid < 0:
                mid, names[made] = made, b
                steps[count] = b
                made, count = made + 1, count + 1
            top = halve(node, mid, over, stack, top)
            continue
        if about[HOLES]:
            steps[count] = ~np.int64(b == -2)
            count += 1
        if b != -2 and drawn(places, heights, a, e, f, about):
            table[2] += 1
            table[3] += hangs(places, low, a, e, about) + hangs(places, low, e, f, about)
            table[3] += hangs(places, low, f, a, about)
        first += 1
        if first == last:
            return count, made, common
        top = onward(node, stack, top, waiting, counts)


@inlined
def spell(told, about, rices, path, depth, common, names, steps, words, at):
    """Write a run down. Args: as of ``trace``; ``words``, ``at``: where, as of ``write``. Returns where it ends."""
    least, shift = 1 << 62, 0
    for some in range(-4, 4):
        whole = 0
        for step in steps:
            if step >= 0 and not told[step, MISSED]:
                whole += cost(told[step, REST], parameter(rices, told[step, AT], some))
        if whole < least:
            least, shift = whole, some
    at = write(words, at, shift + 4, 3)
    at = write(words, at, path & 1, 1)
    at = write_path(words, at, path >> 1, common)
    at = write_path(words, at, path >> (common + 1), depth - common)
    for k in range(3):
        v = names[k]
        if about[HOLES]:
            at = write(words, at, told[v, MISSED], 1)
        if not told[v, MISSED]:
            at = write(words, at, told[v, HEIGHT], about[HIGH])
            kept = told[v, DELTA] == 1
            at = write(words, at, kept, 1)
            at = write(words, at, told[v, DELTA], 0 if kept else about[MOVED])
            at = write(words, at, told[v, DOWN], about[DROP] if told[v, BESIDE] else 0)
    for step in steps:
        if step < 0:
            at = write(words, at, ~step, 1)
            continue
        if about[HOLES]:
            at = write(words, at, told[step, MISSED], 1)
        if not told[step, MISSED]:
            at = write(words, at, told[step, KEPT_], 1)
            rest, k = told[step, REST], parameter(rices, told[step, AT], shift)
            ones = min(rest >> k, ONES)
            at = write(words, at, (1 << ones) - 1, min(ones + 1, ONES))
            at = write(words, at, rest if ones == ONES else rest & ((1 << k) - 1), RAW if ones == ONES else k)
            at = write(words, at, told[step, DOWN], about[DROP] if told[step, BESIDE] else 0)
    return at


@inlined
def parameter(rices, depth, shift):
    """The Rice parameter of a run at a depth."""
    return max(np.int64(rices[depth]) + shift, 0)


@kernel
def write_runs(slots, places, heights, low, told, about, rices, paths, spans, words, table):
    """Write runs down.

    Args:
        slots, places: of ``replay``. heights, low: (v,) int32, steps. told: (v, 8) int64, of each vertex (see above).
            about: (11,) int64, of the chunk (see above). rices: of ``choose_rices``. paths: of ``survey``. spans: (r,
            2) int64, the first leaf of each run and the one after its last.
        words: (w,) uint32, zeros. table: (r, 4) int64, zeros: words, vertices, triangles, edges that a skirt hangs
            from. Both are written to.

    Returns: how many words there are.
    """
    node, stack, counts = np.empty(7, np.int64), np.empty(DEPTH, np.int64), np.empty(2, np.int64)
    waiting, names, steps = np.empty((2, MET), np.int64), np.empty(MET, np.int64), np.empty(8 * MET, np.int64)
    at = 0
    for run in range(len(spans)):
        count, made, common = trace(
            slots, places, heights, low, about, paths, spans[run], node, stack, waiting, counts, names, steps,
            table[run],
        )  # fmt: skip
        first = spans[run, 0]
        end = spell(told, about, rices, paths[first, 0], paths[first, 1], common, names, steps[:count], words, at)
        table[run, 0], table[run, 1] = (end - at + 31) >> 5, made
        at += 32 * table[run, 0]
    return at >> 5


# ---- read -----------------------------------------------------------------------------------------------------------


@inlined
def take(words, cursor, width):
    """The next bits, at most 32; 0 beyond the words."""
    at, shift = cursor[0] >> 5, cursor[0] & 31
    cursor[0] += width
    if at + 1 >= len(words):
        return np.int64(0)
    both = np.uint64(words[at]) | np.uint64(words[at + 1]) << np.uint64(32)
    return np.int64(both >> np.uint64(shift) & ((np.uint64(1) << np.uint64(width)) - np.uint64(1)))


@inlined
def signed(zigzag):
    return zigzag >> 1 ^ -(zigzag & 1)


@inlined
def hang(words, cursor, about, places, heights, low, v):
    """Read how low the skirt hangs below a vertex."""
    low[v] = MISSING
    if heights[v] != MISSING and beside(places, v, about):
        down = take(words, cursor, about[DROP])
        low[v] = heights[v] - down + 1 if down else MISSING


@inlined
def read_corner(words, cursor, about, places, heights, targets, low, v):
    """Read a corner of the node that a run lies in."""
    heights[v] = targets[v] = MISSING
    if not about[HOLES] or not take(words, cursor, 1):
        heights[v] = about[BASE] + take(words, cursor, about[HIGH])
        delta = np.int64(1) if take(words, cursor, 1) else take(words, cursor, about[MOVED])
        if delta:
            targets[v] = PARTS * heights[v] + signed(delta - 1)
    hang(words, cursor, about, places, heights, low, v)


@inlined
def read_vertex(words, cursor, about, k, places, heights, targets, low, v, e, f):
    """Read the vertex between two others; ``k``: the Rice parameter."""
    places[v, 0], places[v, 1] = (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1
    heights[v] = targets[v] = MISSING
    if not about[HOLES] or not take(words, cursor, 1):
        kept, ahead, ones = take(words, cursor, 1), take(words, cursor, ONES), 0
        while ahead >> ones & 1:
            ones += 1
        cursor[0] -= max(ONES - 1 - ones, 0)
        rest = take(words, cursor, RAW) if ones == ONES else ones << k | take(words, cursor, k)
        heights[v] = guess(heights[e], heights[f]) + signed(rest)
        targets[v] = PARTS * heights[v]
        if not kept:
            targets[v] = halfway(places, targets, e, f, targets[v], about)
    hang(words, cursor, about, places, heights, low, v)


@inlined
def read_root(words, cursor, about, corners, places, first):
    """Read where the node is that a run lies in; returns its depth."""
    root = take(words, cursor, 1)
    for k in range(2):
        places[first, k], places[first + 1, k] = corners[2 * root, k], corners[1 + 2 * root, k]
        places[first + 2, k] = corners[3 - 2 * root, k]
    depth = take(words, cursor, 6)
    for _ in range(depth):
        which = take(words, cursor, 1)
        for k in range(2):
            a, e, f = places[first, k], places[first + 1, k], places[first + 2, k]
            places[first, k] = (e + f) >> 1
            places[first + 1, k], places[first + 2, k] = (a, f) if which else (e, a)
    return depth


@kernel
def read_runs(words, starts, leaves, about, rices, corners, places, heights, targets, low, triangles):
    """The mesh of a chunk.

    Args:
        words: of the chunk, two more after them. starts: (r,) int64, the words where runs begin. leaves: of a run.
            about, rices: as written. corners: (4, 2) rows and columns.
        places: (v, 2) int64. heights, targets, low: (v,) int32, steps, targets in ``PARTS``. triangles: (t, 3) int32.
            All are written to.

    Returns: how many vertices and triangles there are; the first is −1 if there is no room.
    """
    node, stack, counts = np.empty(7, np.int64), np.empty(DEPTH, np.int64), np.empty(2, np.int64)
    waiting, cursor, own = np.empty((2, MET), np.int64), np.empty(1, np.int64), np.arange(MET)
    made = first = 0
    for start in starts:
        cursor[0], counts[0], counts[1] = 32 * start, 0, 0
        shift, top, met_leaves, v = take(words, cursor, 3) - 4, 0, 0, first + 3
        if v > len(places):
            return -1, 0
        begin(node, 0, 1, 2, read_root(words, cursor, about, corners, places, first))
        left = take(words, cursor, 6)
        path = cursor[0]
        cursor[0] += left
        end = cursor[0]
        for k in range(3):
            read_corner(words, cursor, about, places, heights, targets, low, first + k)
        while top >= 0:
            a, e, f = first + node[APEX], first + node[ENTRY], first + node[EXIT]
            over = 0
            if path < end:
                here, cursor[0] = cursor[0], path
                over, split = take(words, cursor, 1), np.int64(1)
                path, cursor[0] = path + 1, here
            else:
                split = take(words, cursor, 1) if node[DEEP] < about[LEVELS] else np.int64(0)
            if split:
                row, col = (places[e, 0] + places[f, 0]) >> 1, (places[e, 1] + places[f, 1]) >> 1
                b = met(node, waiting, counts, places, own, first, row, col)
                if node[DEEP] >= about[LEVELS] or (b < 0 and v == min(len(places), first + MET)):
                    return -1, 0
                if b < 0:
                    k = parameter(rices, node[DEEP], shift)
                    read_vertex(words, cursor, about, k, places, heights, targets, low, v, e, f)
                    b = v - first
                    v += 1
                top = halve(node, b, over, stack, top)
                continue
            gone = about[HOLES] and take(words, cursor, 1)
            if not gone and drawn(places, heights, a, e, f, about):
                if made == len(triangles):
                    return -1, 0
                odd = node[DEEP] & 1
                triangles[made, 0], triangles[made, 1 + odd], triangles[made, 2 - odd] = a, e, f
                made += 1
            met_leaves += 1
            if met_leaves == leaves:
                break
            top = onward(node, stack, top, waiting, counts)
        first = v
    return first, made


# ---- heights --------------------------------------------------------------------------------------------------------


@kernel
def settle(places, ends, heights, kept, about, targets):
    """The heights of vertices in the next coarser mesh.

    Args:
        places, ends: (v, 2) int64, of ``survey``. heights: (v,) int32, steps. kept: (v,) uint8, whether that mesh has
            them. about: as written. targets: (v,) int32, ``PARTS`` of a step, the corners' as they are; written to.
    """
    for v in range(4, len(heights)):
        targets[v] = MISSING if heights[v] == MISSING else PARTS * heights[v]
        if not kept[v] and heights[v] != MISSING:
            targets[v] = halfway(places, targets, ends[v, 0], ends[v, 1], targets[v], about)


@inlined
def guess(a, b):
    """The height of a vertex that is expected between two others, steps."""
    if a == MISSING and b == MISSING:
        return 0
    if a == MISSING:
        return b
    return a if b == MISSING else (a + b) >> 1


@inlined
def halfway(places, targets, e, f, own, about):
    """``chunked_kernels.middle`` of two vertices in whole numbers."""
    lr, lc, rr, rc = places[e, 0], places[e, 1], places[f, 0], places[f, 1]
    left, right = np.int64(targets[e]), np.int64(targets[f])
    if left == MISSING or right == MISSING:
        return own
    if max(lr, rr) <= about[LAST_ROW] and max(lc, rc) <= about[LAST_COL]:
        return (left + right) >> 1
    if lr == rr:
        return part(lc, rc, left, right, own, about[LAST_COL])
    if lc == rc:
        return part(lr, rr, left, right, own, about[LAST_ROW])
    return own


@inlined
def part(a, b, left, right, own, last):
    """How high the line between two ends is above what lies between them on the raster; of an end beyond it, on its
    last sample. Numbers stay within 32 bits."""
    low, high = min(a, b), max(a, b)
    under, over = (left, right) if a < b else (right, left)
    whole, done = min(high, last) - min(low, last), min((a + b) >> 1, last) - min(low, last)
    if whole == 0:
        return own
    while whole > 1 << 15:
        whole, done = whole >> 1, done >> 1
    rise = over - under
    sign = -1 if rise < 0 else 1
    size = sign * rise
    return under + sign * (size // whole * done + size % whole * done // whole)
