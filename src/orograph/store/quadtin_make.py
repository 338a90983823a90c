"""Make a QuadTIN's hierarchy block by block: splits until blocks agree at their sides; then errors likewise.

A vertex on a side between two blocks splits a triangle of each. So each block is grown separately, then again with the
vertices that its neighbours have on its sides, until no block lacks a vertex of its neighbours. This ends with the
smallest hierarchy that is within ``finest`` metres everywhere, whatever the order. Errors and spheres are closed over
the hierarchy in the same way: blocks exchange the larger of both along their sides. Memory holds only blocks in
progress and the vertices on sides. Lattice units; metres.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.parallel import map_ordered
from orograph.progress import SILENT, Progress
from orograph.store import quadtin_build as build
from orograph.store.chunked_kind import spooled
from orograph.store.parts import pack, unpack
from orograph.store.quadtin_grow import EAST, SOUTH, Grown, Making, rounded_up
from orograph.store.quadtin_kernels import expand, saturate
from orograph.store.quadtin_layout import (
    DEPTHS,
    FIRST,
    SIDE,
    Facts,
    Layout,
    MemoryQuadTin,
    Part,
    Summary,
    Words,
    cut,
    packed,
    summary_shapes,
    top_of,
    unpacked,
)
from orograph.store.terrain import Terrain

Arrays = dict[str, NDArray[Any]]

GROW, CLOSE, FINISH = "grow", "close", "finish"
LABELS = {GROW: "Making the QuadTIN", CLOSE: "Closing errors", FINISH: "Writing the QuadTIN"}
"""The steps done to blocks, and their names in progress reports."""


class Rounds(Protocol):
    """Runs a step on blocks, which are independent within a round."""

    def run(self, what: str, todo: Sequence[int], given: Callable[[int], Arrays]) -> Iterator[Arrays]:
        """Yield the result of each block (``done``), in the order of ``todo``; ``given`` is called once for each
        block's input."""


class Here:
    """Rounds in this process; grown blocks wait in a scratch file.

    Args:
        making: the hierarchy. file: where blocks wait. jobs: threads. progress: receives progress by rounds.
    """

    def __init__(self, making: Making, file: IO[bytes], jobs: int | None, progress: Progress) -> None:
        self.making, self.jobs, self.progress = making, jobs, progress
        self._file, self._at = file, [(0, 0)] * making.layout.blocks

    def run(self, what: str, todo: Sequence[int], given: Callable[[int], Arrays]) -> Iterator[Arrays]:
        def do(item: tuple[int, Arrays, Arrays]) -> Arrays:
            return done(self.making, what, *item)

        items = ((block, given(block), {} if what == GROW else self._get(block)) for block in todo)
        with self.progress.task(LABELS[what], len(todo)) as task:
            for block, found in zip(todo, map_ordered(do, items, self.jobs)):
                if what == GROW:
                    data = pack(found)
                    self._at[block] = self._file.seek(0, 2), len(data)
                    self._file.write(data)
                task.advance()
                yield found

    def _get(self, block: int) -> Arrays:
        at, size = self._at[block]
        self._file.seek(at)
        return unpack(self._file.read(size))


def done(making: Making, what: str, block: int, given: Arrays, waiting: Arrays) -> Arrays:
    """Run a step on a block.

    Args:
        given: to grow, places of vertices on each side (``forced.0`` …); else errors and radii of the vertices on each
            (``bounds.0`` …, (2, n)). waiting: the block as it was grown.
    """
    if what == GROW:
        part, grown = making.grow(block, [given[f"forced.{side}"] for side in range(4)])
        return {"words": packed(part), **grown.to_arrays()}
    part, grown = unpacked(np.array(waiting["words"])), Grown.from_arrays(waiting)
    part, corners = making.closed(block, _with_sides(part, grown, [given[f"bounds.{side}"] for side in range(4)]))
    if what == CLOSE:
        return {f"bounds.{k}": np.stack([part.error[on], part.radius[on]]) for k, (_, on) in enumerate(grown.sides)}
    west, _, north, _ = making.bounds(block)
    c = min(4, len(part.x) - 1)
    found: Arrays = {
        "corners": corners, "roots": np.stack([part.off[:2], part.state[:2]], 1).astype(np.float64),
        "centre": np.array([part.x[c] + west, part.y[c] + north]), "sphere": np.array([part.z[c], part.radius[c]]),
        "errors": np.zeros(len(DEPTHS)),
    }  # fmt: skip
    v0, t0 = 4, 0
    for p, (v, t) in enumerate(grown.cuts.tolist()):
        found["errors"][p] = part.error[v0:v].max(initial=0.0)
        found[f"words.{p}"] = packed(cut(part, v0, v, t0, t))
        v0, t0 = v, t
    return found


def make_quadtin(
    terrain: Terrain, finest: float, split: str, *, jobs: int | None = None, progress: Progress = SILENT,
    side: int = SIDE, max_memory: int = 1 << 30,
) -> MemoryQuadTin:  # fmt: skip
    """Make the hierarchy of a terrain in memory.

    Args:
        terrain: the ground; if it was gridded from points and has them, the points are used.
        finest: error of the finest triangles in metres, 0: a fraction of the sample spacing. split: which point splits
            a triangle.
        jobs: threads (default: all processors); the result does not depend on them.
        side: approximate samples along a block's side. max_memory: bytes for a block.

    Raises:
        UsageError: there is no ground, or a block does not fit. DamagedChunkError: as ``terrain.read``.
    """
    words: list[list[Words]] = [[] for _ in DEPTHS]
    making = Making(terrain, finest, split == "deviation", side, max_memory)
    with spooled() as file:
        found = made(making, Here(making, file, jobs, progress), lambda part, one: words[part].append(one))
    return MemoryQuadTin(*found, words)


def made(
    making: Making, rounds: Rounds, keep: Callable[[int, Words], object]
) -> tuple[Layout, Facts, Summary]:  # fmt: skip
    """Make a hierarchy.

    Args:
        rounds: runs the steps on blocks. keep: receives parts of blocks, block by block: which part, and its words.

    Raises:
        UsageError: a block does not fit. DamagedChunkError: as ``terrain.read``.
    """
    grown = _agreed(making, rounds)
    return _finished(making, rounds, grown, _closed_sides(making, rounds, grown), keep)


def _agreed(making: Making, rounds: Rounds) -> list[Grown]:
    """Grow all blocks until they agree at their sides; returns the facts about them."""
    count = making.layout.blocks
    nothing = [np.zeros(0, np.int32)] * 4
    forced = [nothing] * count
    grown: list[Grown | None] = [None] * count
    todo = list(range(count))
    while todo:
        for found, block in zip(rounds.run(GROW, todo, lambda block: _each("forced", forced[block])), todo):
            grown[block] = Grown.from_arrays(found)
        todo = []
        for block in range(count):
            required, lacking = [], False
            for side in range(4):
                other = making.beyond(block, side)
                theirs = nothing[0] if other is None else _of(grown[other[0]]).sides[other[1]][0]
                required.append(theirs)
                lacking = lacking or bool(len(np.setdiff1d(theirs, _of(grown[block]).sides[side][0])))
            if lacking and any(not np.array_equal(a, b) for a, b in zip(required, forced[block])):
                forced[block] = required
                todo.append(block)
    return [_of(one) for one in grown]


def _each(name: str, arrays: Sequence[NDArray[Any]]) -> Arrays:
    """Arrays of the four sides, by name."""
    return {f"{name}.{side}": array for side, array in enumerate(arrays)}


def _of(grown: Grown | None) -> Grown:
    assert grown is not None
    return grown


Bounds = list[list[NDArray[np.float32]]]
"""For each block and side (2, n): errors and radii of its vertices."""


def _with_sides(part: Part, grown: Grown, bounds: Sequence[NDArray[np.float32]]) -> Part:
    """A block whose vertices on sides have at least these errors and radii."""
    error, radius = part.error.copy(), part.radius.copy()
    for (_, on), (e, r) in zip(grown.sides, bounds):
        error[on], radius[on] = np.maximum(error[on], e), np.maximum(radius[on], r)
    return part._replace(error=error, radius=radius)


def _closed_sides(making: Making, rounds: Rounds, grown: list[Grown]) -> Bounds:
    """The errors and radii of vertices on sides once everything is closed."""
    bounds: Bounds = [[np.zeros((2, len(on)), np.float32) for _, on in one.sides] for one in grown]
    todo = list(range(len(grown))) if len(grown) > 1 else []
    while todo:
        for found, block in zip(rounds.run(CLOSE, todo, lambda block: _each("bounds", bounds[block])), todo):
            bounds[block] = [found[f"bounds.{side}"].copy() for side in range(4)]
        again = set()
        for block in range(len(grown)):
            for side in (EAST, SOUTH):
                other = making.beyond(block, side)
                if other is None:
                    continue
                (places, _), (theirs, _) = grown[block].sides[side], grown[other[0]].sides[other[1]]
                _, i, j = np.intersect1d(places, theirs, assume_unique=True, return_indices=True)
                most = np.maximum(bounds[block][side][:, i], bounds[other[0]][other[1]][:, j])
                for b, s, at in ((block, side, i), (*other, j)):
                    if (bounds[b][s][:, at] < most).any():
                        bounds[b][s][:, at] = most
                        again.add(b)
        todo = sorted(again)
    return bounds


def _finished(
    making: Making, rounds: Rounds, grown: list[Grown], sides: Bounds, keep: Callable[[int, Words], object]
) -> tuple[Layout, Facts, Summary]:  # fmt: skip
    """The hierarchy, its blocks cut in parts."""
    layout, across = making.layout, making.layout.across
    summary = Summary(*(np.zeros(shape) for shape in summary_shapes(across).values()))
    by_corners = np.zeros((across + 1, across + 1, 2))
    roots = np.zeros((layout.blocks, 2, 2))  # off, state
    every = range(layout.blocks)
    for found, block in zip(rounds.run(FINISH, every, lambda block: _each("bounds", sides[block])), every):
        row, col = divmod(block, across)
        for k, (i, j) in enumerate(((0, 0), (0, 1), (1, 1), (1, 0))):
            at = by_corners[row + i, col + j]
            np.maximum(at, found["corners"][k], out=at)
        summary.errors[block] = found["errors"]
        ends = np.concatenate([[[4, 0]], grown[block].cuts])
        summary.vertices[block], summary.triangles[block] = np.diff(ends, axis=0).T
        for p in range(len(DEPTHS)):
            keep(p, found[f"words.{p}"])
        at = np.ldexp(found["centre"].astype(np.float64), -layout.bits)
        height, summary.radius[block] = found["sphere"]
        summary.centre[block] = (*at, height)
        roots[block] = found["roots"]
    _put_top(making, grown, by_corners, roots, summary)
    facts = Facts(
        sum(one.own[0] for one in grown), sum(one.own[1] for one in grown), making.finest,
        sum(one.stuck for one in grown), all(one.whole for one in grown),
    )  # fmt: skip
    return layout, facts, summary


def _put_top(
    making: Making, grown: list[Grown], by_corners: NDArray[np.float64], roots: NDArray[np.float64], summary: Summary
) -> None:  # fmt: skip
    """Fill in the summary of the top.

    The error of a triangle there is at most the height range of the ground relative to its corners, which are on the
    ground.
    """
    layout = making.layout
    top = top_of(layout.across)
    row, col = top.order.T
    summary.z[:] = making.corners[row, col]
    triangles, v = len(top.node), len(summary.z)
    off, state = np.zeros(triangles), np.zeros(triangles)
    low, high = np.full(triangles, np.inf), np.full(triangles, -np.inf)
    corners = np.zeros((triangles, 3), np.int32)
    corners[:2] = FIRST[0]
    child, nodes_of = np.empty((2, triangles), np.int32)
    parents, nodes = np.full((v, 2), -1, np.int32), np.full((v, 4), -1, np.int32)
    ids = np.arange(v, dtype=np.int32)
    expand(top.node, ids, np.arange(2, dtype=np.int32), 2, corners, child, nodes_of, parents, nodes)
    off[top.roots], state[top.roots] = roots[:, :, 0], roots[:, :, 1]
    ground = np.array([one.ground for one in grown])
    low[top.roots], high[top.roots] = ground[:, :, 0], ground[:, :, 1]
    error, radius = np.zeros((2, v), np.float32)
    places = np.column_stack([making.metres(layout.xs[col], layout.ys[row]), summary.z])
    z = summary.z[corners]
    for first in reversed([(2 << d) - 2 for d in range(2 * (layout.across.bit_length() - 1))]):
        here = np.arange(first, 2 * first + 2)  # the triangles of a depth
        m, below = nodes_of[here], child[here]
        lowest, highest = np.full(v, np.inf), np.full(v, -np.inf)  # of diamonds: both triangles have all four children
        least, most = np.full(v, np.inf), np.full(v, -np.inf)
        for one in (below, below + 1):
            np.minimum.at(lowest, m, low[one])
            np.maximum.at(highest, m, high[one])
            np.minimum.at(least, m, state[one])
            np.maximum.at(most, m, state[one])
        low[here], high[here] = lowest[m], highest[m]
        state[here] = np.where(least[m] == most[m], most[m], build.MIXED)
        live, dead = state[here] == build.LIVE, state[here] == build.DEAD
        above = np.maximum(high[here] - z[here].min(1), z[here].max(1) - low[here])
        off[here] = np.where(live, np.maximum(above, 0.0) * (1 + build.RIM), 0.0)
        np.maximum.at(error, m, rounded_up(np.where(live | dead, off[here], np.inf)))
        far = np.linalg.norm(places[corners[here], :2] - places[m, None, :2], axis=2).max(1)
        rise = np.maximum(np.abs(high[here] - summary.z[m]), np.abs(low[here] - summary.z[m]))
        np.maximum.at(radius, m, rounded_up(np.where(dead, 0.0, np.hypot(far, rise) * (1 + build.RIM))))
    error, radius = np.maximum(error, by_corners[row, col, 0]), np.maximum(radius, by_corners[row, col, 1])
    error, radius = error.astype(np.float32), radius.astype(np.float32)
    saturate(places, parents, error, radius)
    summary.error[:], summary.sphere[:] = error, radius
    summary.off[:], summary.state[:] = off, state
