"""BDAM in plain Python: which patches a view takes, and which vertices may move (Cignoni et al. 2003).

Diamonds are (row, col), patches their top triangles (x, y, L, ω) (``hierarchy``). What decides is given: ``wants``,
whether a diamond's error exceeds the tolerance, and ``has_ground``, whether there is anything to draw of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from orograph.hierarchy import diamonds, triangles

Diamond = tuple[int, int]
Patch = tuple[int, int, int, int]
Point = tuple[int, int]


def patches_of(diamond: Diamond, n: int) -> list[Patch]:
    """The top triangles of a diamond that lie in the square."""
    tops = (diamonds.top(*diamond, side) for side in (0, 1))
    return [top for top in tops if triangles.inside(*top, n)]


def halves(patch: Patch) -> list[Patch]:
    """The two patches below a patch."""
    left, right = (triangles.child(*patch, k) for k in (0, 1))
    return [left, right]


def parents(diamond: Diamond, n: int) -> list[Diamond]:
    """The diamonds that are split before this one is."""
    found = (diamonds.parent(*diamond, k, n) for k in (0, 1))
    return [parent for parent in found if parent[0] >= 0]


def children(diamond: Diamond, n: int) -> list[Diamond]:
    """Those that this one is split before."""
    found = (diamonds.child(*diamond, k, n) for k in range(4))
    return [child for child in found if child[0] >= 0]


def selected(
    n: int, legs: int, wants: Callable[[Diamond], bool], has_ground: Callable[[Diamond], bool]
) -> tuple[set[Diamond], set[Patch]]:
    """The diamonds that are split, and the patches that are drawn.

    Args:
        n: the square has 2^n cells a side. legs: cells along a finest patch's leg.
    """
    finest = 2 * (n - legs.bit_length() + 1)
    root = (1 << n >> 1, 1 << n >> 1)
    split: set[Diamond] = set()
    drawn: set[Patch] = set()
    if finest <= 0:
        return split, {triangles.root(k, n) for k in (0, 1)}
    level = [root]
    for number in range(finest):
        following: dict[Diamond, None] = {}
        for diamond in filter(has_ground, level):
            ready = all(parent in split for parent in parents(diamond, n) if has_ground(parent))
            if ready and wants(diamond):
                split.add(diamond)
                following |= dict.fromkeys(children(diamond, n))
                if number + 1 == finest:
                    drawn |= {half for patch in patches_of(diamond, n) for half in halves(patch)}
            else:
                drawn |= {patch for patch in patches_of(diamond, n) if left_by(patch, n) in split or diamond == root}
        level = list(following)
    return split, drawn


def left_by(patch: Patch, n: int) -> Diamond:
    """The diamond whose split leaves a patch: the one at the patch's apex."""
    x, y = triangles.apex(*patch)
    return (y, x) if diamonds.is_diamond(y, x, n) else (-1, -1)


def samples_between(a: Point, b: Point) -> Iterator[Point]:
    """The samples on an edge of the hierarchy, along an axis or a diagonal, from end to end."""
    long = max(abs(b[0] - a[0]), abs(b[1] - a[1]))
    for t in range(long + 1):
        yield a[0] + (b[0] - a[0]) * t // long, a[1] + (b[1] - a[1]) * t // long


def role(diamond: Diamond, row: int, col: int) -> str:
    """What a simplification may do with a vertex of the four patches below a diamond.

    Returns:
        "locked": on a leg, which is a hypotenuse of the patches below. "along": on the hypotenuse, which is made of
        their legs. "free": it may go, and others may come. "outside": it is another diamond's.
    """
    at = row, col
    a, b = (diamonds.end(*diamond, k) for k in (0, 1))
    p, q = (diamonds.apex(*diamond, k) for k in (0, 1))
    if any(at in samples_between(u, v) for u in (a, b) for v in (p, q)):
        return "locked"
    if at in samples_between(a, b):
        return "along"
    s, (dr, dc) = diamonds.spacing(*diamond), (abs(row - diamond[0]), abs(col - diamond[1]))
    inside = dr + dc < s if diamonds.kind(*diamond) == diamonds.EDGE else max(dr, dc) < s
    return "free" if inside else "outside"


def simplified(
    wanted: int,
    errors: Callable[[set[Point]], dict[Point, float]],
    given: set[Point],
    size: Callable[[set[Point]], int],
) -> set[Point]:
    """Greedy insertion: from the locked vertices on, always the sample that is farthest off, until there are enough.

    Args:
        wanted: triangles: half of those of the four patches below. errors: how far each sample is from the TIN of these
            vertices that may be inserted. given: the locked vertices. size: triangles of the TIN of these vertices.
    """
    vertices = set(given)
    while size(vertices) < wanted:
        off = errors(vertices)
        worst = max(off, key=lambda at: off[at], default=None)
        if worst is None or off[worst] <= 0:
            break
        vertices.add(worst)
    return vertices


def saturated(measured: dict[Diamond, float], n: int) -> dict[Diamond, float]:
    """Errors made no less than those of the diamonds below."""
    found = dict(measured)
    for diamond in sorted(measured, key=lambda at: -int(diamonds.level(at[0], at[1], n))):
        for parent in parents(diamond, n):
            found[parent] = max(found.get(parent, 0.0), found[diamond])
    return found
