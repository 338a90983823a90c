"""One block of a QuadTIN's hierarchy, grown separately, with the vertices that its neighbours have on its sides.

The truth is the Delaunay surface of the points if the terrain was gridded from points and has them, else the raster's
own surface: its samples, cells cut along the diagonal of even corners. Lattice units; samples; metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.dem.delaunay import Surface
from orograph.errors import UsageError
from orograph.store import quadtin_build as build
from orograph.store.quadtin_geometry import Outline, Tree, Truth, rim_of
from orograph.store.quadtin_kernels import expand, own_bounds, saturate
from orograph.store.quadtin_layout import (
    DEPTHS,
    FIRST,
    SIDE,
    Layout,
    Part,
    layout_of,
)
from orograph.store.terrain import Terrain

PART = 16
"""Default error of the finest triangles: the sample spacing divided by this."""

ROUNDING = 1e-9
"""Deviations below this fraction of the largest height count as none."""

WEST, EAST, NORTH, SOUTH = range(4)

BEYOND = {WEST: (0, -1, EAST), EAST: (0, 1, WEST), NORTH: (-1, 0, SOUTH), SOUTH: (1, 0, NORTH)}
"""For each side, the block beyond it (offsets in rows and columns), and which of that block's sides it is."""

Ints = NDArray[np.int64]
Singles = NDArray[np.float32]


def rounded_up(values: NDArray[np.float64]) -> Singles:
    """Numbers as float32, rounded up."""
    found = values.astype(np.float32)
    return np.where(found < values, np.nextafter(found, np.float32(np.inf)), found)


def has_points(terrain: Terrain) -> bool:
    """Whether a terrain was gridded from points and has them."""
    return terrain.has("points") or hasattr(terrain.samples, "surface")


def finest_of(terrain: Terrain, finest: float) -> float:
    """The error in metres; 0 means a fraction of the sample spacing. Rounding of heights does not count."""
    low, high = terrain.height_range
    least = ROUNDING * max(abs(low), abs(high)) + ROUNDING
    return max(finest or min(terrain.grid.spacing) / PART, least)


class Grown(NamedTuple):
    """Facts about a block's triangles.

    Attributes:
        cuts: (parts, 2) number of vertices and triangles up to the end of each part.
        sides: for each side the places of its vertices, ascending, and their numbers.
        ground: (2, 2) lowest and highest of the first two triangles. own: the number of the truth's vertices, and of
            others, without those of the eastern and southern sides.
        stuck: the number of triangles that cannot be split. whole: whether all is ground.
    """

    cuts: Ints
    sides: list[tuple[NDArray[np.int32], NDArray[np.int32]]]
    ground: NDArray[np.float64]
    own: tuple[int, int]
    stuck: int
    whole: bool

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Convert to arrays for storage."""
        sides = {f"sides.{k}.{m}": array for k, side in enumerate(self.sides) for m, array in enumerate(side)}
        counts = np.array([*self.own, self.stuck, self.whole], np.int64)
        return {"cuts": self.cuts, "ground": self.ground, "counts": counts, **sides}

    @classmethod
    def from_arrays(cls, kept: dict[str, NDArray[Any]]) -> Grown:
        """Convert from stored arrays."""
        own, steiner, stuck, whole = kept["counts"].tolist()
        sides = [(kept[f"sides.{k}.0"], kept[f"sides.{k}.1"]) for k in range(4)]
        return cls(kept["cuts"], sides, kept["ground"], (own, steiner), stuck, bool(whole))


class Making:
    """A hierarchy under construction.

    Args:
        terrain: the ground. finest: metres, as requested. by_deviation: split diamonds at the point furthest from
            them, instead of the point nearest to the middle. side: approximate samples along a block's side.
        max_memory: bytes for a block in progress.
    """

    def __init__(
        self, terrain: Terrain, finest: float, by_deviation: bool, side: int = SIDE, max_memory: int = 1 << 30
    ) -> None:  # fmt: skip
        self.terrain, self.by_deviation, self.max_memory = terrain, by_deviation, max_memory
        self.finest = finest_of(terrain, finest)
        self.layout: Layout = layout_of(terrain.grid.shape, side)
        self.surface: Surface | None = terrain.derived("points") if has_points(terrain) else None
        low, high = terrain.height_range
        if np.isnan(low):
            raise UsageError("There is no ground to triangulate.", path=terrain.name)
        self._blank = 0.5 * (low + high)
        self._metric = np.array(terrain.grid.linear)
        across = self.layout.across
        self.corners = np.array(
            [
                [self._corner(int(y), int(x)) for x in self.layout.xs >> self.layout.bits]
                for y in self.layout.ys >> self.layout.bits
            ]
        )
        self._places = [np.zeros((0, 2), np.int64)] * across**2

    def _corner(self, row: int, col: int) -> float:
        z = float(self.terrain.read(0, row, row + 1, col, col + 1)[0, 0])
        return self._blank if np.isnan(z) else z

    def metres(self, x: Ints, y: Ints) -> NDArray[np.float64]:
        """Places (n, 2) on the lattice as metres."""
        places = np.stack([np.ldexp(v.astype(np.float64), -self.layout.bits) for v in (x, y)], -1)
        return np.asarray(places @ self._metric.T)

    def bounds(self, block: int) -> tuple[int, int, int, int]:
        """A block's western, eastern, northern and southern side."""
        row, col = divmod(block, self.layout.across)
        xs, ys = self.layout.xs, self.layout.ys
        return int(xs[col]), int(xs[col + 1]), int(ys[row]), int(ys[row + 1])

    def beyond(self, block: int, side: int) -> tuple[int, int] | None:
        """The block beyond a side, and which of its sides that is."""
        row, col = divmod(block, self.layout.across)
        down, right, other = BEYOND[side]
        row, col = row + down, col + right
        across = self.layout.across
        return (row * across + col, other) if 0 <= row < across and 0 <= col < across else None

    def _truth(self, block: int) -> tuple[Truth, tuple[int, int, int, int]]:
        """The truth within a block; the sample spacing, and its window's row length, first column and first row."""
        west, east, north, south = self.bounds(block)
        if self.surface is not None:
            s = self.surface
            x, y = s.x[s.triangles], s.y[s.triangles]
            here = (x.max(1) >= west) & (x.min(1) <= east) & (y.max(1) >= north) & (y.min(1) <= south)
            used, places = np.unique(s.triangles[here], return_inverse=True)
            corners = places.reshape(-1, 3).astype(np.int32)
            z = s.z[used].astype(np.float64)
            return Truth(s.x[used], s.y[used], z, corners, rim_of(corners, len(used))), (0, 0, 0, 0)
        bits = self.layout.bits
        c0, c1, r0, r1 = west >> bits, east >> bits, north >> bits, south >> bits
        z = self.terrain.read(0, r0, r1 + 1, c0, c1 + 1).astype(np.float64)
        rows, cols = z.shape
        col, row = (v.ravel().astype(np.int64) for v in np.meshgrid(np.arange(c0, c1 + 1), np.arange(r0, r1 + 1)))
        nw = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
        ne, sw, se = nw + 1, nw + cols, nw + cols + 1
        even = ((row[nw] + col[nw]) & 1 == 0)[:, None]
        one = np.where(even, np.stack([nw, ne, se], -1), np.stack([nw, ne, sw], -1))
        two = np.where(even, np.stack([nw, se, sw], -1), np.stack([ne, se, sw], -1))
        triangles = np.stack([one, two], 1).reshape(-1, 3).astype(np.int32)
        z = z.ravel()
        triangles = np.ascontiguousarray(triangles[~np.isnan(z[triangles]).any(1)])
        truth = Truth(col << bits, row << bits, z, triangles, rim_of(triangles, len(z)))
        return truth, (1 << bits, cols, c0, r0)

    def grow(self, block: int, forced: Sequence[NDArray[np.int32]]) -> tuple[Part, Grown]:
        """Grow a block with at least these vertices on its sides; errors and radii are those of its own splits.

        Raises:
            UsageError: it takes more memory than allowed. DamagedChunkError: as ``terrain.read``.
        """
        truth, raster = self._truth(block)
        outline = self._outline(block, forced, truth, raster)
        row, col = divmod(block, self.layout.across)
        corners = self.corners[[row, row, row + 1, row + 1], [col, col + 1, col + 1, col]]
        tree = _begun(truth, outline.bounds, corners, (row + col) & 1)
        while True:
            full = build.grow(tree, truth, outline, self.finest, float(1 << self.layout.bits), self.by_deviation)
            if full == build.DONE:
                return self._grown(tree, outline)
            if full == build.TRIANGLES_FULL:
                if 2 * sum(array.nbytes for array in tree) > self.max_memory:
                    raise UsageError(
                        f"More than {tree.counts[build.TRIANGLES]:,} triangles are needed to be within "
                        f"{self.finest:.3g} m of the ground, too many for memory.", path=self.terrain.name,
                        remedy="Allow a larger error (its option finest) or more memory, or leave out long triangles "
                               "(`max_edge`).",
                    )  # fmt: skip
                tree = _larger(tree)
                continue
            leaves = tree.child[: tree.counts[build.TRIANGLES]] < 0
            lists = tree.lists[: len(leaves)]
            live = int((lists[leaves, 1] - lists[leaves, 0]).sum())
            pool = np.empty(max(3 * live, len(tree.pool)) + (1 << 16), np.int32)
            build.gather_lists(tree, pool)
            tree = tree._replace(pool=pool)

    def _outline(
        self, block: int, forced: Sequence[NDArray[np.int32]], truth: Truth, raster: tuple[int, int, int, int]
    ) -> Outline:  # fmt: skip
        bounds = np.array(self.bounds(block), np.int64)
        inner = np.array([self.beyond(block, side) is not None for side in range(4)], np.uint8)
        near = [np.zeros(0, np.int32)] * 4
        if self.surface is not None:
            x, y = truth.x[truth.triangles], truth.y[truth.triangles]
            for side, v in enumerate((x, x, y, y)):
                if inner[side]:
                    met = (v.min(1) <= bounds[side]) & (v.max(1) >= bounds[side])
                    near[side] = np.flatnonzero(met).astype(np.int32)
        unit, width, col0, row0 = (np.int64(v) for v in raster)
        starts = [np.append(0, np.cumsum([len(one) for one in of])).astype(np.int64) for of in (forced, near)]
        return Outline(
            bounds, inner, unit, width, col0, row0, np.concatenate(forced).astype(np.int64), starts[0],
            np.concatenate(near), starts[1],
        )  # fmt: skip

    def _grown(self, tree: Tree, outline: Outline) -> tuple[Part, Grown]:
        """The stored form of a tree."""
        count, v = int(tree.counts[build.TRIANGLES]), int(tree.counts[build.VERTICES])
        error, radius = np.zeros((2, v), np.float32)
        at = self.metres(tree.x[:v], tree.y[:v])
        own_bounds(tree, np.ascontiguousarray(at[:, 0]), np.ascontiguousarray(at[:, 1]), error, radius)
        child, node = tree.child[:count], tree.node[:count]
        fronts, front = [], np.array([0, 1], np.int32)
        while len(front):
            fronts.append(front)
            below = child[front]
            below = below[below >= 0]
            front = np.stack([below, below + 1], 1).ravel()
        order = np.concatenate(fronts)
        splits = node[order]
        _, first = np.unique(splits[splits >= 0], return_index=True)
        vertices = np.append(np.arange(4), splits[splits >= 0][np.sort(first)])
        number = np.full(v + 1, -1, np.int32)
        number[vertices] = np.arange(v)
        depth = np.repeat(np.arange(len(fronts)), [len(one) for one in fronts])
        within = [splits[(depth < d - 1) & (splits >= 0)] for d in DEPTHS]
        cuts = np.array([(4 + len(np.unique(one)), (depth < d).sum()) for one, d in zip(within, DEPTHS)])
        x, y = tree.x[:v][vertices], tree.y[:v][vertices]
        west, east, north, south = outline.bounds
        sides = []
        for side, (across, along, line) in enumerate(((x, y, west), (x, y, east), (y, x, north), (y, x, south))):
            on = np.flatnonzero((across[4:] == line) if outline.inner[side] else np.zeros(v - 4, bool)) + 4
            on = on[np.argsort(along[on], kind="stable")]
            sides.append((along[on].astype(np.int32), on.astype(np.int32)))
        mine = np.ones(v, bool)
        mine[:4] = mine[sides[EAST][1]] = mine[sides[SOUTH][1]] = False
        steiner = tree.steiner[:v][vertices] == 1
        leaves = child < 0
        part = Part(
            x - west, y - north, tree.z[:v][vertices], error[vertices], radius[vertices], number[splits],
            rounded_up(tree.error[:count][order]),
            tree.state[:count][order],
        )  # fmt: skip
        ground = np.stack([tree.low[:2], tree.high[:2]], 1)
        return part, Grown(
            cuts, sides, ground, (int((mine & ~steiner).sum()), int((mine & steiner).sum())),
            int(tree.counts[build.STUCK]), bool((tree.state[:count][leaves] == build.LIVE).all()),
        )  # fmt: skip

    def closed(self, block: int, part: Part) -> tuple[Part, NDArray[np.float64]]:
        """Close errors and spheres over a block; return it with the (4, 2) errors and radii of its corners."""
        west, _, north, _ = self.bounds(block)
        v, t = len(part.x), len(part.node)
        row, col = divmod(block, self.layout.across)
        corners = np.zeros((max(t, 2), 3), np.int32)
        corners[:2] = FIRST[(row + col) & 1]
        child, nodes_of = np.empty((2, max(t, 2)), np.int32)
        parents, nodes = np.full((v, 2), -1, np.int32), np.full((v, 4), -1, np.int32)
        ids = np.arange(v, dtype=np.int32)
        expand(part.node, ids, np.arange(2, dtype=np.int32), 2, corners, child, nodes_of, parents, nodes)
        places = np.column_stack([self.metres(part.x + west, part.y + north), part.z])
        error, radius = part.error.copy(), part.radius.copy()
        saturate(places, parents, error, radius)
        of_corners = np.stack([error[:4], radius[:4]], 1).astype(np.float64)
        error[:4] = radius[:4] = 0.0
        return part._replace(error=error, radius=radius), of_corners


def _begun(truth: Truth, bounds: Ints, heights: NDArray[np.float64], parity: int) -> Tree:
    """The two triangles of a block."""
    room, ends = 1 << 12, 1 << 11
    count = len(truth.triangles)
    tree = Tree(
        np.zeros(ends, np.int64), np.zeros(ends, np.int64), np.zeros(ends), np.zeros(ends, np.uint8),
        np.full((ends, 2), -1, np.int32), np.zeros((room, 3), np.int32), np.full((room, 3), -1, np.int32),
        np.full(room, -1, np.int32), np.full(room, -1, np.int32), np.zeros(room, np.uint8), np.zeros(room),
        np.zeros(room), np.zeros(room), np.zeros((room, 2), np.int64), np.empty(9 * count + (1 << 16), np.int32),
        np.zeros(6, np.int64),
    )  # fmt: skip
    west, east, north, south = bounds
    tree.x[:4], tree.y[:4] = (west, east, east, west), (north, north, south, south)
    tree.z[:4], tree.steiner[:4] = heights, 1
    tree.corners[:2] = FIRST[parity]
    tree.beside[0, 0], tree.beside[1, 0] = 1, 0
    tree.counts[:2] = 2, 4
    at = 0
    for t in range(2):
        mine = _overlapping(tree, truth, t)
        tree.pool[at : at + len(mine)] = mine
        tree.lists[t] = at, at + len(mine)
        at += len(mine)
        build.measure(tree, truth, t)
    tree.counts[build.POOL] = at
    return tree


def _overlapping(tree: Tree, truth: Truth, t: int) -> NDArray[np.int32]:
    """The truth's triangles that may overlap one of the first two: inside all its sides."""
    inside = np.ones(len(truth.triangles), bool)
    for k in range(3):
        p, q = (int(v) for v in tree.corners[t, [k, (k + 1) % 3]])
        ax, ay, bx, by = tree.x[p], tree.y[p], tree.x[q], tree.y[q]
        side = (bx - ax) * (truth.y - ay) - (by - ay) * (truth.x - ax)
        inside &= (side[truth.triangles] > 0).any(1)
    return np.flatnonzero(inside).astype(np.int32)


def _larger(tree: Tree) -> Tree:
    """Arrays with twice the room."""
    grown_ = {
        name: np.concatenate([array, np.full_like(array, -1 if name in ("owners", "beside", "child", "node") else 0)])
        for name, array in tree._asdict().items()
        if name not in ("pool", "counts")
    }
    return tree._replace(**grown_)
