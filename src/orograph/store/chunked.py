"""Chunks of a terrain's quadtree, each a separate mesh simplified to its level's error, with skirts.

Ulrich, *Rendering Massive Terrains using Chunked Level of Detail Control* (SIGGRAPH 2002 course notes). Chunks of level
l are squares of ``cells`` · 2^l cells. Their meshes consist of the vertices whose error (that of the middle of their
hypotenuse) reaches the level's, and of those that these depend on. A level's error is ``error`` at level 0 and doubles
from level to level. Each vertex and level is decided once for the whole terrain, so chunks of one level fit. A *skirt*
hangs from a chunk's sides, below any edge of a neighbour that is up to ``APART`` levels coarser.

Stored of a chunk are the splits of triangles (``chunked_kernels``), the heights of the vertices in the order in which
the walk meets them, the depth of its skirt, and the heights of its corners in the mesh of the next coarser level. The
rest follows: positions, triangles, and the height of each vertex in that mesh, to which it can move.

*Words* (uint32) of a chunk, unless it is compressed (``chunk_code``): numbers of codes and of vertices; codes, 16 per
word; heights (float32) of the corners and of the vertices; the skirt's lowest heights (float32) at the vertices on its
sides, NaN where there is no skirt; those of the corners in the coarser mesh (float32). A level stores them chunk after
chunk, row by row; ``lengths`` has the number of words of each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.hierarchy import diamonds
from orograph.store.array_spec import ArraySpec
from orograph.store.terrain import Shape, exponent

CELLS = 32
"""Default number of cells along a finest chunk's side."""

ALL_CELLS = (16, 32, 64, 128)
"""The allowed numbers."""

APART = 2
"""Adjacent chunks differ by at most this many levels."""

PER_WORD = 16
"""Codes per word."""

MISSING = -(1 << 31)
"""A quantised height (``chunk_code``) that is missing."""

PARTS = 64
"""Heights of the coarser mesh are stored in this fraction of a step."""

DEPTH, MET, WORDS = 48, 192, 320
"""Limits of a compressed chunk: depth of its tree; vertices, and words, of a run."""

ONES, RAW = 8, 20
"""In a compressed chunk, a residual with this many leading ones is written in RAW bits."""

Words = NDArray[np.uint32]
Corners = NDArray[np.int64]


class Kind(NamedTuple):
    """The kind of chunks to make.

    Attributes:
        cells, finest: cells along a side of the finest chunks, and their error in metres, 0: derived from the terrain.
        compressed: whether they are encoded by ``chunk_code``, which a GPU decodes.
    """

    cells: int = CELLS
    finest: float = 0.0
    compressed: bool = False

    def __str__(self) -> str:
        """Return the kind in the form of an argument of `orograph.build`."""
        return f"({self.cells}, {self.finest:g}{', True' if self.compressed else ''})"


def checked_kind(chunked: Any) -> Kind:
    """Return the requested kind of chunks.

    Raises:
        UsageError: the request is invalid.
    """
    kind = Kind(*chunked) if isinstance(chunked, (tuple, list)) and 2 <= len(chunked) <= 3 else None
    if (
        kind is None
        or kind.cells not in ALL_CELLS
        or not isinstance(kind.finest, (int, float))
        or not 0 <= kind.finest < math.inf
        or not isinstance(kind.compressed, bool)
    ):
        raise UsageError(
            f"'chunked' must be cells along a side, one of {', '.join(map(str, ALL_CELLS))}, metres, 0 or more, and "
            f"optionally whether they are compressed, not {chunked!r}.",
            remedy="The default of chunked-lod is (32, 0).",
        )  # fmt: skip
    return kind._replace(cells=int(kind.cells), finest=float(kind.finest))


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk's mesh.

    Attributes:
        vertices: (v, 3) float64, column, row, metres; those of the skirt's lower edge last.
        targets: (v,), metres in the next coarser level's mesh.
        triangles: (t, 3) int32, wound as the hierarchy's are: counter-clockwise on the map where rows run southwards.
        skirt: the number of skirt triangles, which are the last ones.
    """

    vertices: NDArray[np.float64]
    targets: NDArray[np.float64]
    triangles: NDArray[np.int32]
    skirt: int

    @property
    def nbytes(self) -> int:
        """Bytes that the mesh takes in memory."""
        return self.vertices.nbytes + self.targets.nbytes + self.triangles.nbytes


@dataclass(frozen=True, slots=True)
class Layout:
    """The layout of chunks.

    Attributes:
        shape: the raster's. cells: along a side of the finest chunks, as requested.
    """

    shape: Shape
    cells: int

    @property
    def p(self) -> int:
        """The exponent of a finest chunk's side; smaller than requested if the raster is."""
        return min(self.cells.bit_length() - 1, max(exponent(self.shape), 1))

    @property
    def top(self) -> int:
        """The coarsest level, of one chunk."""
        return max(exponent(self.shape), 1) - self.p

    def side(self, level: int) -> int:
        """Return the samples along a side."""
        return 1 << (self.p + level)

    def levels(self, level: int) -> int:
        """How many times the two triangles of a chunk may be halved."""
        return 2 * (self.p + level)

    def chunks(self, level: int) -> Shape:
        """Return the rows and columns of a level's chunks that contain a cell of the raster."""
        rows, cols = (-((1 - size) >> (self.p + level)) for size in self.shape)
        return max(rows, 1), max(cols, 1)

    def corners(self, level: int, i: int, j: int) -> Corners:
        """Return the rows and columns of a chunk's corners, (4, 2), as ``chunked_kernels`` takes them."""
        half = self.side(level) // 2
        row, col = (2 * i + 1) * half, (2 * j + 1) * half
        (p, q), (a, b) = ([way(row, col, k) for k in (0, 1)] for way in (diamonds.apex, diamonds.end))
        return np.array([p, a, q, b], np.int64)


def lengths_spec(layout: Layout, level: int, shard: int, chunk: int) -> ArraySpec:
    """Describe the array of word counts of a level's chunks."""
    return ArraySpec(f"chunked/level-{level}/lengths", layout.chunks(level), shard, chunk, "uint32", 0.0)


def words_spec(level: int, rows: int, shard: int, chunk: int) -> ArraySpec:
    """Describe the array of the words of a level's chunks, ``chunk`` per row."""
    return ArraySpec(f"chunked/level-{level}/words", (rows, chunk), shard, chunk, "uint32", 0.0)


def unpacked(words: Words, layout: Layout, level: int, i: int, j: int) -> Chunk:
    """Return the mesh of chunk (i, j) of a level from its words."""
    codes, count = int(words[0]), int(words[1]) + 4
    at = 2 - (-codes // PER_WORD)
    bits = words[2:at, None] >> np.arange(0, 2 * PER_WORD, 2, dtype=np.uint32) & 3
    numbers = words[at:].view(np.float32)
    heights, hanging, coarse = numbers[:count], numbers[count:-4], numbers[-4:].astype(np.float64)
    slots = np.full((1 << max(2 * count, 16).bit_length(), 2), -1, np.int64)
    places, triangles = np.empty((count, 2), np.int64), np.empty((codes, 3), np.int32)
    vertices, targets = np.empty((count, 3)), np.empty(count)
    last_row, last_col = layout.shape[0] - 1, layout.shape[1] - 1
    from orograph.store.chunked_kernels import read_walk  # a store can be read without Numba

    made = read_walk(
        bits.reshape(-1)[:codes].astype(np.uint8), heights, layout.corners(level, i, j), coarse, last_row, last_col,
        places, vertices, targets, triangles, slots,
    )  # fmt: skip
    sides = np.flatnonzero(on_sides(places, layout.side(level), i, j).any(0))
    low = np.full(count, np.nan)
    low[sides] = hanging
    return with_skirt(vertices, targets, triangles[:made], places, low, layout.side(level), i, j)


def on_sides(places: Corners, side: int, i: int, j: int) -> NDArray[np.bool_]:
    """Return which vertices lie on the north, west, south and east side of chunk (i, j), (4, v)."""
    row, col = places.T
    return np.stack([row == i * side, col == j * side, row == (i + 1) * side, col == (j + 1) * side])


def with_skirt(
    vertices: NDArray[np.float64], targets: NDArray[np.float64], triangles: NDArray[np.int32], places: Corners,
    low: NDArray[np.float64], side: int, i: int, j: int,
) -> Chunk:  # fmt: skip
    """Add the skirt to a chunk's mesh: two triangles below each edge on a side whose two ends have a lower height."""
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    on = on_sides(places, side, i, j)
    hangs = ~np.isnan(low[edges]).any(1) & np.any([one[edges].all(1) for one in on], axis=0)
    edges = edges[hangs]
    tops, below = np.unique(edges, return_inverse=True)
    a, b = edges.T
    a_, b_ = len(vertices) + below.reshape(-1, 2).T
    hung = np.concatenate([np.stack([b, a, a_], 1), np.stack([b, a_, b_], 1)]).astype(np.int32)
    down = vertices[tops].copy()
    down[:, 2] = low[tops]
    return Chunk(
        np.concatenate([vertices, down]), np.append(targets, low[tops]), np.concatenate([triangles, hung]), len(hung)
    )
