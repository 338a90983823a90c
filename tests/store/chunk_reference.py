"""A compressed chunk in plain Python, as ``store.chunk_code`` describes it; who is whose neighbour, places say.

``decode`` gives the vertices (row, column, height, height in the coarser mesh, lower end of the skirt) and the
triangles, in the order in which the words have them. Heights are in steps, None where there is none; the lower end of
the skirt at vertex v is ~v.
"""

from __future__ import annotations

BLOCK, PARTS, VOIDS = 16, 64, 1 << 16


class Words:
    """Parts of words, one after the other."""

    def __init__(self, words):
        self.number, self.at = 0, 0
        for k, word in enumerate(words):
            self.number |= int(word) << 32 * k

    def take(self, widths):
        """Numbers of so many bits each; then on to the next whole word."""
        found, bit = [], 32 * self.at
        for width in widths:
            found.append(self.number >> bit & (1 << width) - 1)
            bit += width
        self.at += -(-sum(widths) // 32)
        return found


def signed(word):
    return word - (1 << 32) if word >> 31 else word


def height(word):
    return None if word == 1 << 31 else signed(word)


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


def decode(words, shape, side, first, corners):
    """
    Args:
        shape: of the raster. side: cells of the chunk. first: its first row and column. corners: 4 (row, col).
    """
    count, _, _, _, owners, on_sides, flags = (int(w) for w in words[:7])
    drop, last = flags >> 8 & 255, (shape[0] - 1, shape[1] - 1)
    reader = Words(words)
    reader.at = 15
    splits, kept = reader.take([1] * owners), reader.take([1] * (count - 4))
    missing = reader.take([1] * count) if flags & VOIDS else [0] * count
    widths = reader.take([8] * (-(-(count - 4) // BLOCK)))
    drops = reader.take([drop] * on_sides)
    rests = reader.take([widths[k // BLOCK] for k in range(count - 4)])
    gone = reader.take([1] * (32 * (len(words) - reader.at))) if flags & VOIDS else None

    ends = ((0, first[0]), (1, first[1]), (0, first[0] + side), (1, first[1] + side))

    def beside(v):
        return {k for k, (axis, at) in enumerate(ends) if v[axis] == at}

    def with_low(v):
        if beside(v):
            down = drops.pop(0)
            return (*v, None if down == 0 else v[2] - down + 1)
        return (*v, None)

    own = [height(int(w)) for w in words[7:15]]
    vertices = [with_low((*corners[k], own[k], own[4 + k])) for k in range(4)]
    level, triangles, hung, seen = [(0, 1, 3), (2, 3, 1)], [], [], 0

    def lies(v):
        return min(vertices[v][0], last[0]), min(vertices[v][1], last[1])

    def area(t):
        (a, b), (c, d), (e, f) = map(lies, t)
        return (c - a) * (f - b) - (d - b) * (e - a)

    depth = 2 * (side.bit_length() - 1)
    for number in range(depth + 1):
        split = {}  # by the two ends of the hypotenuse: the vertex in its middle, or None
        made = {}
        for _, e, f in level:
            edge = frozenset((e, f))
            if edge not in split and number < depth:
                split[edge] = splits.pop(0)
                if split[edge]:
                    k, (a, b) = len(vertices) - 4, (vertices[e], vertices[f])
                    known = [h for h in (a[2], b[2]) if h is not None]
                    guess = sum(known) >> (len(known) == 2)
                    z = None if missing[k + 4] else guess + (rests[k] >> 1 ^ -(rests[k] & 1))
                    to = None if z is None else PARTS * z if kept[k] else target(a, b, PARTS * z, last)
                    made[edge] = len(vertices)
                    vertices.append(with_low(((a[0] + b[0]) >> 1, (a[1] + b[1]) >> 1, z, to)))
        below = []
        for k, (a, e, f) in enumerate(level):
            middle = made.get(frozenset((e, f)))
            if middle is not None:
                below += [(middle, a, e), (middle, f, a)]
                continue
            missed = any(vertices[v][2] is None for v in (a, e, f))
            if missed or area((a, e, f)) == 0 or (gone and gone[seen + k]):
                continue
            triangles.append((a, e, f))
            for p, q in ((a, e), (e, f), (f, a)):
                if beside(vertices[p]) & beside(vertices[q]) and None not in (vertices[p][4], vertices[q][4]):
                    hung += [(q, p, ~p), (q, ~p, ~q)]
        seen, level = seen + len(level), below
    return vertices, triangles + hung
