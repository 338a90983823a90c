"""A compressed chunk in plain Python, as ``store.chunk_code`` describes it; which vertex is met again, places say.

``decode`` gives the vertices (row, column, height, height in the coarser mesh, lower end of the skirt) and the
triangles, in the order in which the words have them. Heights are in steps, None where there is none; the lower end of
the skirt at vertex v is ~v.
"""

from __future__ import annotations

PARTS, VOIDS, ONES, RAW = 64, 1 << 16, 8, 20


class Bits:
    """The bits of words, one after the other."""

    def __init__(self, words):
        self.number, self.at = 0, 0
        for k, word in enumerate(words):
            self.number |= int(word) << 32 * k

    def take(self, width):
        found = self.number >> self.at & (1 << width) - 1
        self.at += width
        return found

    def rice(self, k):
        ones = 0
        while ones < ONES and self.take(1):
            ones += 1
        return self.take(RAW) if ones == ONES else ones << k | self.take(k)


def signed(zigzag):
    return zigzag >> 1 ^ -(zigzag & 1)


def between(ends, left, right, own, last):
    """Where the line from one end to the other is at what lies between them; ends beyond the raster lie on its last."""
    a, b = ends
    if a > b:
        a, b, left, right = b, a, right, left
    low, high, at = min(a, last), min(b, last), min((a + b) >> 1, last)
    if low == high:
        return own
    whole, done = high - low, at - low
    while whole > 1 << 15:
        whole, done = whole >> 1, done >> 1
    size = abs(right - left)
    rise = size // whole * done + size % whole * done // whole
    return left + rise if right >= left else left - rise


def target(a, b, own, last):
    """The height in the coarser mesh of a vertex that it lacks: of the edge between a and b."""
    if a[3] is None or b[3] is None:
        return own
    if max(a[0], b[0]) <= last[0] and max(a[1], b[1]) <= last[1]:
        return (a[3] + b[3]) >> 1
    for fixed, along in ((0, 1), (1, 0)):
        if a[fixed] == b[fixed]:
            return between((a[along], b[along]), a[3], b[3], own, last[along])
    return own


class Chunk:
    """What is the same for all runs. Args: as of ``decode``."""

    def __init__(self, words, shape, side, first, corners):
        _, self.triangles, _, runs, self.leaves, flags, base, bits = (int(w) for w in words[:8])
        self.drop, self.voids = flags >> 8 & 255, bool(flags & VOIDS)
        self.base, self.high, self.moved = base - (base >> 31 << 32), bits & 255, bits >> 8
        self.last, self.depth, self.corners = (shape[0] - 1, shape[1] - 1), 2 * (side.bit_length() - 1), corners
        self.sides = ((0, first[0]), (1, first[1]), (0, first[0] + side), (1, first[1] + side))
        told = Bits(words[8:])
        self.rices = [told.take(8) for _ in range(-(-self.depth // 4) * 4)]
        self.runs = [[told.take(16) for _ in range(4)] for _ in range(runs)]
        self.begin = 8 + told.at // 32

    def beside(self, v):
        return {k for k, (axis, at) in enumerate(self.sides) if v[axis] == at}

    def area(self, *corners):
        (a, b), (c, d), (e, f) = ((min(v[0], self.last[0]), min(v[1], self.last[1])) for v in corners)
        return (c - a) * (f - b) - (d - b) * (e - a)


class Run:
    """A run: its vertices, triangles and skirt, numbers of vertices from 0."""

    def __init__(self, chunk, words):
        self.chunk, self.bits = chunk, Bits(words)
        self.vertices, self.triangles, self.hung, self.left = [], [], [], chunk.leaves
        self.known = {}  # vertices by place
        self.shift = self.bits.take(3) - 4
        root = self.bits.take(1)
        places = [chunk.corners[k] for k in ((0, 1, 3), (2, 3, 1))[root]]
        depth = self.bits.take(6)
        for _ in range(depth):
            a, e, f = places
            middle = tuple((p + q) >> 1 for p, q in zip(e, f, strict=True))
            places = [middle, a, f] if self.bits.take(1) else [middle, e, a]
        self.path = [self.bits.take(1) for _ in range(self.bits.take(6))]
        for place in places:
            self.corner(place)
        self.node(0, 1, 2, depth)

    def add(self, place, height, to):
        low = None
        if height is not None and self.chunk.beside(place):
            down = self.bits.take(self.chunk.drop)
            low = None if down == 0 else height - down + 1
        self.known[tuple(place)] = len(self.vertices)
        self.vertices.append((*place, height, to, low))

    def missing(self):
        return self.chunk.voids and self.bits.take(1)

    def corner(self, place):
        height = to = None
        if not self.missing():
            height = self.chunk.base + self.bits.take(self.chunk.high)
            code = 1 if self.bits.take(1) else self.bits.take(self.chunk.moved)
            to = PARTS * height + signed(code - 1) if code else None
        self.add(place, height, to)

    def middle(self, e, f, depth):
        """The vertex between two others."""
        a, b = self.vertices[e], self.vertices[f]
        place = (a[0] + b[0]) >> 1, (a[1] + b[1]) >> 1
        if place not in self.known:
            height = to = None
            if not self.missing():
                kept = self.bits.take(1)
                known = [h for h in (a[2], b[2]) if h is not None]
                k = max(self.chunk.rices[depth] + self.shift, 0)
                height = (sum(known) >> (len(known) == 2)) + signed(self.bits.rice(k))
                to = PARTS * height if kept else target(a, b, PARTS * height, self.chunk.last)
            self.add(place, height, to)
        return self.known[place]

    def node(self, a, e, f, depth):
        on_path = bool(self.path)
        over = self.path.pop(0) if on_path else 0
        if on_path or (depth < self.chunk.depth and self.bits.take(1)):
            b = self.middle(e, f, depth)
            if not over:
                self.node(b, e, a, depth + 1)
            if self.left:
                self.node(b, a, f, depth + 1)
            return
        self.left -= 1
        gone = self.chunk.voids and self.bits.take(1)
        corners = (a, f, e) if depth & 1 else (a, e, f)
        at = [self.vertices[v] for v in corners]
        if gone or None in [v[2] for v in at] or self.chunk.area(*at) == 0:
            return
        self.triangles.append(corners)
        for k in range(3):
            p, q = corners[k], corners[(k + 1) % 3]
            u, v = self.vertices[p], self.vertices[q]
            if self.chunk.beside(u) & self.chunk.beside(v) and None not in (u[4], v[4]):
                self.hung += [(q, p, ~p), (q, ~p, ~q)]


def decode(words, shape, side, first, corners):
    """
    Args:
        shape: of the raster. side: cells of the chunk. first: its first row and column. corners: 4 (row, col).
    """
    chunk = Chunk(words, shape, side, first, corners)
    vertices, triangles, hung, at = [], [], [], chunk.begin
    for size, *counts in chunk.runs:
        run = Run(chunk, words[at : at + size])
        assert counts == [len(run.vertices), len(run.triangles), len(run.hung) // 2]
        n = len(vertices)
        for into, some in ((triangles, run.triangles), (hung, run.hung)):
            into += [tuple(v + n if v >= 0 else v - n for v in t) for t in some]
        vertices += run.vertices
        at += size
    assert at == len(words)
    return vertices, triangles + hung
