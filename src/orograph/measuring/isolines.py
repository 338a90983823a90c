"""Contour lines of the surface as vectors: traced tile by tile, joined across tiles.

The lines are the isolines of Orograph's own surface, which is linear in triangles: in every triangle that a level
passes through a line runs straight from one edge to another, so lines need no rule for saddles. Ground is above a level
only if it is higher: a lake at exactly that height is below, and its shore is the line. Each sample is classified by
the number of levels below it, so that all triangles that share it agree, and a line can end only at the border or at
missing ground; all others are rings. The place on an edge depends only on the heights at its two ends, and lines are
ordered by their level and the first edge that they cross, where a ring also begins: the division into tiles makes no
difference. Source: Lorensen & Cline 1987 (*Marching cubes*), in two dimensions and on simplices.

Memory is bounded by levels: pieces are counted first, then as many levels as fit are traced at a time.

Units: metres; columns and rows of samples, then the terrain's CRS.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from orograph.lighting.raster import rectangles
from orograph.measuring.isoline_kernels import EDGES, follow, march, thin
from orograph.parallel import aside, map_ordered
from orograph.progress import SILENT, Progress
from orograph.store.terrain import Terrain

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Window = tuple[int, int, int, int]

SIDE = 512
"""Cells along the side of a tile."""
PER_PIECE = 160
"""Bytes per piece of a level's lines while they are joined and written."""
_NOTHING = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines one after the other, ordered by level and by the first edge that each crosses.

    Attributes:
        points: (n, 2) columns and rows, or easting and northing. Higher ground is on a line's left on the map.
        offsets: (m + 1,) int64: line i is points[offsets[i]:offsets[i + 1]]; a ring's last point is its first.
        level: (m,) int64: the index of each line's level.
    """

    points: Array
    offsets: Integers
    level: Integers

    def __len__(self) -> int:
        return len(self.level)


@dataclass(frozen=True, slots=True)
class _Pieces:
    """Lines of one tile, or of all; lines that end at a tile's border continue in another.

    Attributes:
        first, last: (m,) the edges where each begins and ends, level · edges + edge. ring: (m,) bool.
        least, at: (m,) the smallest edge that it crosses, and the position of that in the line.
        points: (n, 2). offsets: (m + 1,).
    """

    first: Integers
    last: Integers
    ring: NDArray[np.bool_]
    least: Integers
    at: Integers
    points: Array
    offsets: Integers


def isolines(
    terrain: Terrain, levels: Array, *, max_memory: int | None = None, simplify: float = 0.0, jobs: int | None = None,
    progress: Progress = SILENT, side: int = SIDE,
) -> Iterator[Lines]:  # fmt: skip
    """The isolines of a terrain in its CRS, some levels at a time, in the order of the levels.

    Args:
        levels: (k,) heights, ascending.
        max_memory: bytes that lines may take at a time; a single level may take more. None: all at once.
        simplify: how far a line may be off, metres on the grid: points not needed for that are left out.
        side: cells along a tile; does not affect the lines.
    """
    if not len(levels) or min(terrain.grid.shape) < 2:
        return
    yield from _groups(terrain, levels, max_memory, simplify, jobs, progress, side)


def _groups(
    terrain: Terrain, levels: Array, max_memory: int | None, simplify: float, jobs: int | None, progress: Progress,
    side: int,
) -> Iterator[Lines]:  # fmt: skip
    groups = [(0, len(levels))]
    if max_memory is not None:
        groups = _share(_count(terrain, levels, jobs, progress, side), max_memory // PER_PIECE)
    mirrored = terrain.grid.transform.determinant > 0
    for low, high in groups:
        lines = aside(partial(_trace, terrain, levels, low, high, jobs, progress, side))
        points = np.stack(terrain.grid.xy(lines.points[:, 0], lines.points[:, 1]), -1)
        if mirrored:  # rows go north: left is right
            points = _turned(points, lines.offsets)
        lines = Lines(points, lines.offsets, lines.level)
        if simplify > 0:
            keep = np.zeros(len(points), np.bool_)
            thin(points, lines.offsets, float(simplify), keep)
            lines = _kept(lines, keep)
        if len(lines):
            yield lines


def _windows(terrain: Terrain, side: int) -> list[Window]:
    rows, cols = terrain.grid.shape
    return list(rectangles((rows - 1, cols - 1), side, side))


def _ranks(terrain: Terrain, window: Window, levels: Array) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Heights of a window of cells, and how many levels lie below each; −1 where it is missing."""
    row0, row1, col0, col1 = window
    heights = terrain.read(0, row0, row1 + 1, col0, col1 + 1)
    ranks = np.searchsorted(levels, heights.astype(np.float64), "left").astype(np.int32)
    ranks[np.isnan(heights)] = -1
    return heights, ranks


def _size(terrain: Terrain) -> int:
    rows, cols = terrain.grid.shape
    return rows * cols * EDGES


def _count(terrain: Terrain, levels: Array, jobs: int | None, progress: Progress, side: int) -> Integers:
    """(k,) the number of pieces of each level's lines."""

    def work(window: Window) -> Integers:
        counts = np.zeros(len(levels), np.int64)
        _, ranks = _ranks(terrain, window, levels)
        march(
            ranks, window[0], window[2], terrain.grid.cols, _size(terrain), 0, len(levels), _NOTHING, _NOTHING, counts
        )
        return counts

    total, windows = np.zeros(len(levels), np.int64), _windows(terrain, side)
    with progress.task("Counting lines", total=len(windows)) as task:
        for counts in map_ordered(work, windows, jobs):
            total += counts
            task.advance()
    return total


def _share(counts: Integers, most: int) -> list[tuple[int, int]]:
    """Ranges of levels with at most ``most`` pieces together, or of a single level."""
    groups, first, held = [], 0, 0
    for k, count in enumerate(counts.tolist()):
        if k > first and held + count > most:
            groups.append((first, k))
            first, held = k, 0
        held += count
    return [*groups, (first, len(counts))]


def _trace(
    terrain: Terrain, levels: Array, low: int, high: int, jobs: int | None, progress: Progress, side: int
) -> Lines:  # fmt: skip
    """The lines of levels [low, high), in columns and rows."""
    windows, parts = _windows(terrain, side), []
    with progress.task("Tracing lines", total=len(windows)) as task:
        for part in map_ordered(lambda window: _tile(terrain, window, levels, low, high), windows, jobs):
            if part is not None:
                parts.append(part)
            task.advance()
    if not parts:
        return Lines(np.empty((0, 2)), np.zeros(1, np.int64), np.empty(0, np.int64))
    return _joined(parts, _size(terrain))


def _tile(terrain: Terrain, window: Window, levels: Array, low: int, high: int) -> _Pieces | None:
    heights, ranks = _ranks(terrain, window, levels)
    size, cols = _size(terrain), terrain.grid.cols
    counts = np.zeros(len(levels), np.int64)
    n = march(ranks, window[0], window[2], cols, size, low, high, _NOTHING, _NOTHING, counts)
    if n == 0:
        return None
    starts, ends = np.empty(n, np.int64), np.empty(n, np.int64)
    march(ranks, window[0], window[2], cols, size, low, high, starts, ends, counts)
    order, offsets, ring = _linked(starts, ends)
    # The edges that each line crosses: where its pieces start, and where its last one ends.
    lengths = np.diff(offsets) + 1
    stops = np.cumsum(lengths)
    edges = np.empty(stops[-1], np.int64)
    inner = np.ones(len(edges), np.bool_)
    inner[stops - 1] = False
    edges[inner], edges[stops - 1] = starts[order], ends[order[offsets[1:] - 1]]
    offsets = np.concatenate([[0], stops])
    least = np.minimum.reduceat(edges, offsets[:-1])
    at = _firsts(edges == np.repeat(least, lengths), offsets)
    points = _places(edges, size, cols, heights, window, levels)
    return _Pieces(edges[offsets[:-1]], edges[stops - 1], ring, least, at, points, offsets)


def _linked(starts: Integers, ends: Integers) -> tuple[Integers, Integers, NDArray[np.bool_]]:
    """Pieces in the order of the lines that they form; offsets (m + 1,) of lines in that; which of them are rings."""
    by = np.argsort(starts, kind="stable")
    spot = np.minimum(np.searchsorted(starts[by], ends), len(by) - 1)
    following = np.where(starts[by[spot]] == ends, by[spot], -1)
    begins = np.ones(len(starts), np.bool_)
    begins[following[following >= 0]] = False
    order, stops = np.empty(len(starts), np.int64), np.empty(len(starts), np.int64)
    stops = stops[: follow(following, begins, order, stops)]
    ring = stops < 0
    return order, np.concatenate([[0], np.where(ring, ~stops, stops)]), ring


def _firsts(hit: NDArray[np.bool_], offsets: Integers) -> Integers:
    """The position of the first hit in each stretch; each has one."""
    where = np.flatnonzero(hit)
    return np.asarray(where[np.searchsorted(where, offsets[:-1])] - offsets[:-1])


def _places(
    edges: Integers, size: int, cols: int, heights: NDArray[np.float32], window: Window, levels: Array
) -> Array:
    """(n, 2) columns and rows where edges cross their level, the same from whatever tile an edge is seen."""
    level, edge = np.divmod(edges, size)
    sample, kind = np.divmod(edge, EDGES)
    row, col = np.divmod(sample, cols)
    anti = (kind == 2) & ((row + col) % 2 == 1)  # from the upper right to the lower left
    col0 = col + anti
    down, right = (kind > 0).astype(np.int64), np.where(kind == 1, 0, np.where(anti, -1, 1))
    i, j = row - window[0], col0 - window[2]
    h0, h1 = heights[i, j].astype(np.float64), heights[i + down, j + right].astype(np.float64)
    t = (levels[level] - h0) / (h1 - h0)
    return np.stack([col0 + t * right, row + t * down], -1)


def _joined(parts: list[_Pieces], size: int) -> Lines:
    """The lines of all tiles: those that end at a border continue where another begins at the same edge."""
    sizes = np.array([len(p.first) for p in parts])
    shift = np.cumsum([0, *(len(p.points) for p in parts[:-1])])
    first, last, least, at, ring = (
        np.concatenate([getattr(p, name) for p in parts]) for name in ("first", "last", "least", "at", "ring")
    )
    begin = np.concatenate([p.offsets[:-1] for p in parts]) + np.repeat(shift, sizes)
    length = np.concatenate([np.diff(p.offsets) for p in parts])
    points = np.concatenate([p.points for p in parts])
    del parts
    opened = np.flatnonzero(~ring)
    closed = np.flatnonzero(ring)
    order, stops, rings = opened, np.zeros(1, np.int64), np.empty(0, np.bool_)
    if len(opened):
        order, stops, rings = _linked(first[opened], last[opened])
        order = opened[order]
    # Lines as pieces: those of one ring in one tile come after those that were joined.
    pieces = np.concatenate([order, closed])
    offsets = np.concatenate([stops, stops[-1] + 1 + np.arange(len(closed))])
    rings = np.concatenate([rings, np.ones(len(closed), np.bool_)])
    name = np.minimum.reduceat(least[pieces], offsets[:-1])
    ranked = np.argsort(name, kind="stable")
    chosen = _firsts(least[pieces] == np.repeat(name, np.diff(offsets)), offsets)
    index = _route(pieces, offsets, rings, ranked, begin, length, at, chosen)
    stop = np.concatenate([[0], np.cumsum(_lengths(pieces, offsets, rings, ranked, length))])
    lines = Lines(points[index], stop, name[ranked] // size)
    return _kept(lines, _different(lines))


def _lengths(
    pieces: Integers, offsets: Integers, rings: NDArray[np.bool_], ranked: Integers, length: Integers
) -> Integers:
    """Points of each line: those of its pieces, each of which begins at the last point of the previous one."""
    own = np.add.reduceat(length[pieces] - 1, offsets[:-1]) + 1
    return np.asarray(own[ranked])


def _route(
    pieces: Integers, offsets: Integers, rings: NDArray[np.bool_], ranked: Integers, begin: Integers,
    length: Integers, at: Integers, chosen: Integers,
) -> Integers:  # fmt: skip
    """The points of the lines, one line after the other; a ring begins at its smallest edge."""
    routes = []
    for line in ranked.tolist():
        own = pieces[offsets[line] : offsets[line + 1]]
        if not rings[line]:
            routes.append(_run(own, begin, length))
            continue
        own = np.roll(own, -int(chosen[line]))
        run = _run(own, begin, length)[:-1]
        run = np.roll(run, -int(at[own[0]]))
        routes.append(np.append(run, run[0]))
    return np.concatenate(routes)


def _run(own: Integers, begin: Integers, length: Integers) -> Integers:
    """The points of consecutive pieces; the last of each is the first of the next."""
    if len(own) == 1:
        return np.arange(begin[own[0]], begin[own[0]] + length[own[0]])
    inner = [np.arange(begin[p], begin[p] + length[p] - 1) for p in own.tolist()]
    return np.concatenate([*inner, [begin[own[-1]] + length[own[-1]] - 1]])


def _different(lines: Lines) -> NDArray[np.bool_]:
    """(n,): points that differ from the previous one, of lines that are not a single point, or rings of two."""
    points, offsets = lines.points, lines.offsets
    keep = np.ones(len(points), np.bool_)
    keep[1:] = (points[1:] != points[:-1]).any(1)
    keep[offsets[:-1]] = True
    number = np.add.reduceat(keep.astype(np.int64), offsets[:-1])
    ends = offsets[1:] - 1
    ring = (points[offsets[:-1]] == points[ends]).all(1)
    return keep & np.repeat(number > np.where(ring, 3, 1), np.diff(offsets))


def _kept(lines: Lines, keep: NDArray[np.bool_]) -> Lines:
    """Only the points to keep; lines without any are left out."""
    number = np.add.reduceat(keep.astype(np.int64), lines.offsets[:-1]) if len(lines) else np.empty(0, np.int64)
    some = number > 0
    return Lines(lines.points[keep], np.concatenate([[0], np.cumsum(number[some])]), lines.level[some])


def _turned(points: Array, offsets: Integers) -> Array:
    """Reverse lines."""
    line = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    return np.asarray(points[offsets[line] + offsets[line + 1] - 1 - np.arange(len(points))])
