"""What a QuadTIN is made of, and its hierarchy as it is selected from.

The truth is the Delaunay surface of the points, where the terrain was gridded from points and has them, else the
raster's own surface: its samples, cells cut along the diagonal of even corners. Lattice units; samples; metres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.dem.delaunay import Surface, lattice_bits
from orograph.errors import UsageError
from orograph.geo.grid import Grid
from orograph.lod import quadtin_build as build
from orograph.lod.quadtin_build import Tree, Truth
from orograph.progress import SILENT, Progress
from orograph.store.terrain import Terrain

BYTES_PER_TRIANGLE = 120
"""Of the truth, while a hierarchy is made of it: about."""

ROUNDING = 1e-9
"""Deviations of this part of the largest height are none."""

Floats = NDArray[np.float64]


class Hierarchy(NamedTuple):
    """A QuadTIN.

    Attributes:
        vertices: (v, 3) float64: column, row, metres; the first four are the corners of the domain.
        error, radius: (v,) float64, metres: of the diamond that a vertex splits, with all that depends on it; of the
            sphere around the vertex that holds its ground.
        parents: (v, 2) int32, the vertices that it depends on, twice the same on the border.
        corners: (t, 3) int32; child, node: (t,) int32; state: (t,) uint8: as of ``Tree``.
        off, reach: (t,) float64, metres: how far a triangle is from the truth; from its apex to what it stands for.
        low, high: (t,) float64, metres: of the ground under a triangle, infinite where there is none.
        nodes: (v, 4) int32, the vertices that depend on it, −1: none.
        points: how many vertices are the truth's. steiner: how many are not. finest: metres.
        stuck: triangles that could not be split although they are further off.
        whole: whether there is ground everywhere.
    """

    vertices: Floats
    error: Floats
    radius: Floats
    parents: NDArray[np.int32]
    corners: NDArray[np.int32]
    child: NDArray[np.int32]
    node: NDArray[np.int32]
    state: NDArray[np.uint8]
    off: Floats
    reach: Floats
    low: Floats
    high: Floats
    nodes: NDArray[np.int32]
    points: int
    steiner: int
    finest: float
    stuck: int
    whole: bool


def has_points(terrain: Terrain) -> bool:
    """Whether a terrain was gridded from points and has them."""
    return terrain.has("points") or hasattr(terrain.samples, "surface")


def truth_of(terrain: Terrain) -> tuple[Truth, int]:
    """The surface that a QuadTIN is to be, and the lattice's bits."""
    if has_points(terrain):
        surface: Surface = terrain.derived("points")
        used, places = np.unique(surface.triangles, return_inverse=True)
        corners: NDArray[np.int32] = places.reshape(-1, 3).astype(np.int32)
        z = surface.z[used].astype(np.float64)
        return Truth(surface.x[used], surface.y[used], z, corners, build.rim_of(corners, len(used))), surface.bits
    rows, cols = terrain.grid.shape
    bits = lattice_bits(rows, cols)
    z = terrain.read(0, 0, rows, 0, cols).astype(np.float64).ravel()
    col, row = (v.ravel().astype(np.int64) for v in np.meshgrid(np.arange(cols), np.arange(rows)))
    nw = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
    ne, sw, se = nw + 1, nw + cols, nw + cols + 1
    even = ((row[nw] + col[nw]) & 1 == 0)[:, None]
    one = np.where(even, np.stack([nw, ne, se], -1), np.stack([nw, ne, sw], -1))
    two = np.where(even, np.stack([nw, se, sw], -1), np.stack([ne, se, sw], -1))
    triangles = np.stack([one, two], 1).reshape(-1, 3).astype(np.int32)
    triangles = np.ascontiguousarray(triangles[~np.isnan(z[triangles]).any(1)])
    return Truth(col << bits, row << bits, z, triangles, build.rim_of(triangles, len(z))), bits


def check_room(terrain: Terrain, max_memory: int) -> None:
    """Raise UsageError where the hierarchy of a terrain takes more memory than is allowed."""
    rows, cols = terrain.grid.shape
    count = len(terrain.derived("points").triangles) if has_points(terrain) else 2 * rows * cols
    needed = count * BYTES_PER_TRIANGLE
    if needed > max_memory:
        raise UsageError(
            f"The hierarchy of a QuadTIN is made in memory and takes some {needed >> 20} MiB here.", path=terrain.name,
            remedy="Allow more memory, give a coarser `resolution`, or take a smaller area (`bbox`).",
        )  # fmt: skip


def hierarchy_of(
    terrain: Terrain, finest: float, by_deviation: bool, progress: Progress = SILENT, max_memory: int = 1 << 30
) -> Hierarchy:  # fmt: skip
    """The QuadTIN of a terrain.

    Args:
        finest: metres within which the finest triangles are; they are split until they are.
        by_deviation: diamonds are split at the point furthest from them, not at that nearest to the middle.

    Raises:
        UsageError: there is no ground, or so many triangles are needed that they do not fit into ``max_memory``.
    """
    truth, bits = truth_of(terrain)
    if not len(truth.triangles):
        raise UsageError("There is no ground to triangulate.", path=terrain.name)
    finest = max(finest, ROUNDING * float(np.abs(truth.z[truth.triangles]).max()) + ROUNDING)
    with progress.task("Making the QuadTIN"):
        tree = grown(truth, terrain.grid.shape, bits, finest, by_deviation, max_memory)
    return finished(tree, terrain.grid, bits, finest)


def grown(
    truth: Truth, shape: tuple[int, int], bits: int, finest: float, by_deviation: bool, max_memory: int = 1 << 30
) -> Tree:  # fmt: skip
    """The triangles over a raster's rectangle of samples, split until they are within ``finest`` metres of the truth,
    and where ground and missing ground meet no longer than a sample."""
    width, height = (shape[1] - 1) << bits, (shape[0] - 1) << bits
    tree = _begun(truth, width, height)
    while True:
        full = build.grow(tree, truth, finest, float(1 << bits), by_deviation)
        if full == build.DONE:
            return tree
        if full == build.TRIANGLES_FULL:
            if 2 * sum(array.nbytes for array in tree) > max_memory:
                raise UsageError(
                    f"It takes more than {tree.counts[build.TRIANGLES]:,} triangles to be within {finest:.3g} m of the "
                    "ground everywhere, which do not fit into memory.",
                    remedy="Allow more metres (its option finest) or memory; leave long triangles out (`max_edge`).",
                )
            tree = _larger(tree)
            continue
        leaves = tree.child[: tree.counts[build.TRIANGLES]] < 0
        lists = tree.lists[: len(leaves)]
        live = int((lists[leaves, 1] - lists[leaves, 0]).sum())
        pool = np.empty(max(3 * live, len(tree.pool)) + (1 << 16), np.int32)
        build.gather_lists(tree, pool)
        tree = tree._replace(pool=pool)


def _begun(truth: Truth, width: int, height: int) -> Tree:
    """Two triangles."""
    room, ends = 1 << 12, 1 << 11
    count = len(truth.triangles)
    tree = Tree(
        np.zeros(ends, np.int64), np.zeros(ends, np.int64), np.zeros(ends), np.zeros(ends, np.uint8),
        np.full((ends, 2), -1, np.int32), np.zeros((room, 3), np.int32), np.full((room, 3), -1, np.int32),
        np.full(room, -1, np.int32), np.full(room, -1, np.int32), np.zeros(room, np.uint8), np.zeros(room),
        np.zeros(room), np.zeros(room), np.zeros((room, 2), np.int64), np.empty(9 * count + (1 << 16), np.int32),
        np.zeros(6, np.int64),
    )  # fmt: skip
    tree.x[:4], tree.y[:4] = (0, width, width, 0), (0, 0, height, height)
    tree.z[:4] = truth.z[truth.triangles].mean()
    places = {(int(x), int(y)): z for x, y, z in zip(tree.x[:4], tree.y[:4], range(4))}
    for s in np.flatnonzero(np.isin(truth.x, (0, width)) & np.isin(truth.y, (0, height))):
        if not np.isnan(truth.z[s]):
            tree.z[places[int(truth.x[s]), int(truth.y[s])]] = truth.z[s]
    tree.steiner[:4] = 1
    tree.corners[:2] = (2, 0, 1), (0, 2, 3)
    tree.beside[0, 0], tree.beside[1, 0] = 1, 0
    every = np.arange(count, dtype=np.int32)
    tree.counts[:2] = 2, 4
    at = 0
    for t in range(2):
        mine = _overlapping(tree, truth, t, every)
        tree.pool[at : at + len(mine)] = mine
        tree.lists[t] = at, at + len(mine)
        at += len(mine)
        build.measure(tree, truth, t)
    tree.counts[build.POOL] = at
    return tree


def _overlapping(tree: Tree, truth: Truth, t: int, which: NDArray[np.int32]) -> NDArray[np.int32]:
    """Those of the truth's triangles that may overlap one of the first two: on its side of the diagonal."""
    left, right = (int(v) for v in tree.corners[t, :2])
    ax, ay, bx, by = tree.x[left], tree.y[left], tree.x[right], tree.y[right]
    side = (bx - ax) * (truth.y - ay) - (by - ay) * (truth.x - ax)
    return np.asarray(which[(side[truth.triangles] > 0).any(1)], np.int32)


def _larger(tree: Tree) -> Tree:
    """Twice the room."""
    grown_ = {
        name: np.concatenate([array, np.full_like(array, -1 if name in ("owners", "beside", "child", "node") else 0)])
        for name, array in tree._asdict().items()
        if name not in ("pool", "counts")
    }
    return tree._replace(**grown_)


def finished(tree: Tree, grid: Grid, bits: int, finest: float) -> Hierarchy:
    """A tree as it is selected from."""
    count, v = int(tree.counts[build.TRIANGLES]), int(tree.counts[build.VERTICES])
    col, row = (np.ldexp(a[:v].astype(np.float64), -bits) for a in (tree.x, tree.y))
    (a, b), (d, e) = grid.linear
    east, north, z = a * col + b * row, d * col + e * row, tree.z[:v]
    error, radius = np.zeros((2, v))
    build.saturate(tree, east, north, error, radius)
    owners = tree.owners[:v]
    corners, node = tree.corners[:count].copy(), tree.node[:count].copy()
    parents = corners[owners, 2]
    parents[:, 1] = np.where(owners[:, 1] < 0, parents[:, 0], parents[:, 1])
    nodes = np.full((v, 4), -1, np.int32)
    split = np.flatnonzero(node >= 0)
    apex, child = corners[split, 2], node[split]
    order = np.lexsort((child, apex))
    apex, child = apex[order], child[order]
    new = np.r_[True, (apex[1:] != apex[:-1]) | (child[1:] != child[:-1])]
    apex, child = apex[new], child[new]
    slot = np.arange(len(apex)) - np.searchsorted(apex, apex)
    inner = apex > 3
    nodes[apex[inner], slot[inner]] = child[inner]
    state = tree.state[:count].copy()
    at = np.stack([east, north, z], -1)
    reach = np.linalg.norm(at[corners[:, :2]] - at[corners[:, 2:]], axis=-1).max(axis=1) + tree.error[:count]
    leaves = tree.child[:count] < 0
    steiner = int(tree.steiner[4:v].sum())
    return Hierarchy(
        np.stack([col, row, z], -1), error, radius, np.ascontiguousarray(parents, np.int32), corners,
        tree.child[:count].copy(), node, state, tree.error[:count].copy(), reach,
        tree.low[:count].copy(), tree.high[:count].copy(), nodes, v - 4 - steiner, steiner, finest,
        int(tree.counts[build.STUCK]), bool((state[leaves] == build.LIVE).all()),
    )  # fmt: skip
