"""Triangulated irregular networks: few triangles on samples of a terrain, within a bound in metres.

The terrain is cut into tiles whose borders are simplified first, each separately (``tin_outline``), so that neighbours
fit to the bit whatever the order and number of workers, and only the tiles in progress are in memory. In a tile samples
are inserted greedily (``tin_refine``), and then unnecessary vertices are removed (``tin_reduce``). Missing samples are
respected: outlines of holes are edges of the TIN.

The bound applies on the surface or at samples. A TIN's edges cross cells, so on the surface it may be off by more than
at any sample; therefore the crossings of its edges with grid lines and diagonals of cells are checked as well
(``triangulation.deviation``). If a border is too coarse for that, the tile requests samples on it, and the tiles on
both sides are made again with them, starting from their vertices. This proceeds in rounds, so the result
stays deterministic.

Source: Garland & Heckbert 1995 (*Fast polygonal approximation of terrains and height fields*).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orograph.errors import NothingInViewError, UsageError
from orograph.meshing.tin_lines import edges_by_tile, edges_of_tile
from orograph.meshing.tin_outline import Window, unit_triangles
from orograph.meshing.tin_tile import LEAST_ERROR, NO_LINES, NONE, Tile, tin_of_tile
from orograph.parallel import aside, map_ordered, threads_for
from orograph.progress import SILENT, Progress
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation, turn

Bound = Literal["surface", "samples"]

SIDE = 512
"""Cells along the side of a tile; even, so that the surface's diagonals are the same in all tiles."""

PER_SAMPLE = 300
"""Bytes per sample of a tile in progress, if all of them become vertices."""

CLOSE = 0.98
"""The search for the bound aims at this part of the allowed triangles."""

TRIALS = 16
"""Maximum steps of that search."""

Key = tuple[int, int]

Lines = Sequence[NDArray[np.float64]]


def tin(
    terrain: Terrain, max_error: float, *, bound: Bound = "surface", lines: Lines = (),
    max_memory: int | None = None, jobs: int | None = None, progress: Progress = SILENT, side: int = SIDE,
) -> Tessellation:  # fmt: skip
    """The TIN of a terrain within a bound.

    Args:
        terrain: read tile by tile.
        max_error: how far the TIN may be off vertically, metres; less than 1e-7 counts as 1e-7.
        bound: "surface": everywhere; "samples": only at samples.
        lines: break lines, (n, 2) columns and rows each, which become edges between the nearest samples
            (``tin_lines``); a line of one place is a point, which becomes a vertex.
        max_memory: bytes; low values reduce the number of tiles in progress. jobs: threads; None: all processors. The
            result depends on neither.
        side: cells along the side of a tile; the mesh depends on it.

    Returns:
        the mesh; all its vertices are samples. Its ``stats``: method, max_error, bound, largest (its error on the
        surface, metres), largest_at_samples, side.

    Raises:
        UsageError: an option makes no sense. NothingInViewError: the terrain has no surface. DamagedChunkError: as
            ``terrain.read``.
    """
    check_bound(bound)
    if not (math.isfinite(max_error) and max_error >= 0):
        raise UsageError(f"`max_error` must be a number of metres, not {max_error:g}.")
    if side < 2 or side % 2:
        raise UsageError(f"The side of a tile must be an even number of cells, not {side}.")
    return aside(partial(_tin, terrain, max_error, bound, lines, max_memory, jobs, progress, side))


def tin_of_size(
    terrain: Terrain, triangles: int, *, bound: Bound = "surface", lines: Lines = (),
    max_memory: int | None = None, jobs: int | None = None, progress: Progress = SILENT, side: int = SIDE,
) -> Tessellation:  # fmt: skip
    """The TIN of at most ``triangles`` triangles with nearly the lowest possible bound, found by a search.

    Args and raises: as ``tin``. If even the coarsest TIN has more triangles, it is returned.
    """
    check_bound(bound)
    if triangles < 2:
        raise UsageError(f"`triangles` must be 2 or more, not {triangles}.")
    low, high = terrain.height_range
    if not high >= low:
        raise no_surface(terrain)
    relief = max(high - low, LEAST_ERROR)
    make = partial(
        tin, terrain, bound=bound, lines=lines, max_memory=max_memory, jobs=jobs, progress=progress, side=side
    )
    best = make(relief)
    coarse, fine = (math.log(relief), math.log(len(best.triangles))), None
    goal = math.log(triangles * (1 + CLOSE) / 2)
    for _ in range(TRIALS):
        if len(best.triangles) >= CLOSE * triangles or coarse[0] <= math.log(LEAST_ERROR):
            break
        error = guess(coarse, fine, goal)
        trial = make(math.exp(error))
        if len(trial.triangles) <= triangles:
            best, coarse = trial, (error, math.log(len(trial.triangles)))
        else:
            fine = error, math.log(len(trial.triangles))
        if fine is not None and coarse[0] - fine[0] < 1e-3:
            break
    return best


Trial = tuple[float, float]
"""Logarithms of a bound and of the number of triangles for it."""


def guess(coarse: Trial, fine: Trial | None, goal: float) -> float:
    """The bound to try next: the number of triangles is about a power of the bound; not too close to earlier tries."""
    if fine is None:
        return max(min(coarse[0] + coarse[1] - goal, coarse[0] - 0.1), math.log(LEAST_ERROR))
    part = (goal - coarse[1]) / (fine[1] - coarse[1])
    return coarse[0] + (fine[0] - coarse[0]) * min(max(part, 0.1), 0.9)


def check_bound(bound: str) -> None:
    """Raise UsageError unless it is a bound."""
    if bound not in ("surface", "samples"):
        raise UsageError(f"`bound` must be surface or samples, not {bound!r}.")


def no_surface(terrain: Terrain) -> NothingInViewError:
    """The error when there is nothing to triangulate."""
    return NothingInViewError("The terrain has no surface to triangulate.", path=terrain.name)


def _tin(
    terrain: Terrain, max_error: float, bound: Bound, lines: Lines, max_memory: int | None, jobs: int | None,
    progress: Progress, side: int,
) -> Tessellation:  # fmt: skip
    rows, cols = terrain.grid.shape
    if min(rows, cols) < 2:
        raise no_surface(terrain)
    keys = list(product(range(-(-(rows - 1) // side)), range(-(-(cols - 1) // side))))
    workers = workers_for(min(side, max(rows, cols)), max_memory, jobs)
    required: dict[Key, list[NDArray[np.int64]]] = {}
    made: dict[Key, Tile] = {}
    edges = lines_of(terrain, lines, side, (max_error, bound == "surface"), workers)
    share(ends_of(edges, side), side, set(keys), required)

    def make(key: Key) -> Tile:
        heights, inner = read_tile(terrain, key, side)
        extra = np.concatenate([NONE, *required.get(key, [])])
        start = made[key].places.astype(np.int64) if key in made else NONE
        return tin_of_tile(heights, inner, max_error, bound == "surface", extra, start, edges.get(key, NO_LINES))

    again: Iterable[Key] = keys
    with progress.task("Triangulating", total=len(keys)) as task:
        while todo := sorted(again):
            for key, tile in zip(todo, map_ordered(make, todo, workers, ahead=1)):
                task.advance(0 if key in made else 1)
                made[key] = tile
            missed = {(key[1] * side + int(x), key[0] * side + int(y)) for key in todo for x, y in made[key].missed}
            blocked = {key: made[key].blocked for key in todo if len(made[key].blocked)}
            more = more_lines(terrain, edges, blocked, side, (max_error, bound == "surface"))
            new = set(ends_of(more, side)) - set(ends_of({key: edges.get(key, NO_LINES) for key in more}, side))
            missed |= {(x, y) for x, y in new if x % side == 0 or y % side == 0}
            edges |= more
            again = share(sorted(missed), side, set(keys), required) | set(more)
    return assemble(terrain, made, side, {"method": "tin", "max_error": max_error, "bound": bound, "side": side})


def lines_of(
    terrain: Terrain, lines: Lines, side: int, limit: tuple[float, bool], workers: int
) -> dict[Key, NDArray[np.int64]]:  # fmt: skip
    """The edges that break lines give each tile."""
    found = edges_by_tile(lines, terrain.grid.shape, side)
    todo = sorted(found)

    def one(key: Key) -> NDArray[np.int64]:
        return possible(terrain, key, found[key], side, limit)

    return dict(zip(todo, map_ordered(one, todo, workers, ahead=1)))


def more_lines(
    terrain: Terrain, edges: dict[Key, NDArray[np.int64]], blocked: dict[Key, NDArray[np.int64]], side: int,
    limit: tuple[float, bool],
) -> dict[Key, NDArray[np.int64]]:  # fmt: skip
    """The edges of the tiles whose break lines block others: these are added as edges and are split."""
    more = {}
    for key, wanted in blocked.items():
        before = edges.get(key, NO_LINES)
        both = np.concatenate([before, wanted]).tolist()
        more[key] = possible(terrain, key, both, side, limit)
        if np.array_equal(more[key], before):  # they were split again where they had been, which was not enough
            more[key] = possible(terrain, key, both, side, limit, elsewhere=True)
    return more


def possible(
    terrain: Terrain, key: Key, edges: Sequence[Sequence[int]], side: int, limit: tuple[float, bool],
    elsewhere: bool = False,
) -> NDArray[np.int64]:  # fmt: skip
    """The edges that a tile can have (``tin_lines.edges_of_tile``)."""
    heights, (row0, row1, col0, col1) = read_tile(terrain, key, side)
    window = np.ascontiguousarray(heights[row0 : row1 + 1, col0 : col1 + 1])
    units = np.ascontiguousarray(unit_triangles(heights)[row0:row1, col0:col1])
    return edges_of_tile(edges, window, units, max(limit[0], LEAST_ERROR), limit[1], elsewhere)


def ends_of(edges: dict[Key, NDArray[np.int64]], side: int) -> list[tuple[int, int]]:
    """Columns and rows of the ends of all edges, on the raster."""
    ends = [e.reshape(-1, 2) + np.array([key[1], key[0]]) * side for key, e in edges.items()]
    return sorted({(int(x), int(y)) for x, y in np.concatenate([NONE, *ends])})


def workers_for(side: int, max_memory: int | None, jobs: int | None) -> int:
    """How many tiles may be in progress at once."""
    most = (max_memory or 1 << 30) // 2 // (PER_SAMPLE * (side + 3) ** 2)
    return max(1, min(threads_for(jobs), most))


def read_tile(terrain: Terrain, key: Key, side: int) -> tuple[NDArray[np.float32], Window]:
    """A tile with a margin of one sample, NaN beyond the raster, and the tile's place in that."""
    rows, cols = terrain.grid.shape
    row0, col0 = key[0] * side, key[1] * side
    row1, col1 = min(row0 + side, rows - 1), min(col0 + side, cols - 1)
    top, left, bottom, right = max(row0 - 1, 0), max(col0 - 1, 0), min(row1 + 2, rows), min(col1 + 2, cols)
    heights = np.full((row1 - row0 + 3, col1 - col0 + 3), np.nan, np.float32)
    heights[top - row0 + 1 : bottom - row0 + 1, left - col0 + 1 : right - col0 + 1] = terrain.read(
        0, top, bottom, left, right
    )
    return heights, (1, row1 - row0 + 1, 1, col1 - col0 + 1)


def share(
    missed: list[tuple[int, int]], side: int, keys: set[Key], required: dict[Key, list[NDArray[np.int64]]]
) -> set[Key]:
    """Pass required vertices to the tiles that share them. Returns these tiles."""
    again: set[Key] = set()
    for x, y in missed:
        for key in product({y // side, (y - 1) // side}, {x // side, (x - 1) // side}):
            if key in keys:
                again.add(key)
                required.setdefault(key, []).append(np.array([[x - key[1] * side, y - key[0] * side]]))
    return again


def assemble(terrain: Terrain, made: dict[Key, Tile], side: int, stats: dict[str, object]) -> Tessellation:
    """One mesh of all tiles, which are released; vertices on their borders are merged and come first."""
    size = sum(len(tile.triangles) for tile in made.values())
    if not size:
        raise no_surface(terrain)
    figures = {
        "largest": max(tile.largest for tile in made.values()),
        "largest_at_samples": max(tile.at_samples for tile in made.values()),
    }
    rims = {key: np.flatnonzero((tile.places % side == 0).any(-1)) for key, tile in made.items()}
    shared = np.unique(np.concatenate([numbers(key, made[key], rims[key], side) for key in made]))
    count = len(shared) + sum(len(made[key].places) - len(rims[key]) for key in made)
    if count >= 1 << 31:
        raise UsageError(f"{count:,} vertices are too many for a mesh.", remedy="Allow a larger error.")
    vertices, triangles = np.empty((count, 3)), np.empty((size, 3), np.int32)
    first, done = len(shared), 0
    for key in sorted(made):
        rim = rims[key]
        at = np.searchsorted(shared, numbers(key, made[key], rim, side))
        tile = made.pop(key)
        number = np.empty(len(tile.places), np.int32)
        inner = np.ones(len(number), bool)
        inner[rim] = False
        following = first + len(number) - len(rim)
        number[rim], number[inner] = at, np.arange(first, following)
        vertices[number, :2] = tile.places + np.array([key[1], key[0]]) * side
        vertices[number, 2] = tile.heights
        corners = number[tile.triangles]
        triangles[done : done + len(corners)] = corners if turn(terrain.grid) > 0 else corners[:, ::-1]
        first, done = following, done + len(corners)
    return Tessellation(vertices, triangles, None, {**stats, **figures}, terrain.grid)


def numbers(key: Key, tile: Tile, some: NDArray[np.intp], side: int) -> NDArray[np.int64]:
    """The numbers, on the whole raster, of a tile's own vertices."""
    places = tile.places[some].astype(np.int64)
    return (places[:, 1] + key[0] * side) << 32 | (places[:, 0] + key[1] * side)
