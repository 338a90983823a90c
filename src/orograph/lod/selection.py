"""What a method selects for a camera: one of a few kinds, each of which a surface can draw.

Every selection says its bound in pixels, which tiles would make it better, its statistics, and, unless it is for rays,
its triangles. Positions are sample coordinates: column, row and height in true metres, on samples or between them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.store.chunked import Layout
from orograph.store.terrain import Heights
from orograph.tessellation import Tessellation, welded
from orograph.viewpoint import Camera

Kind = Literal["triangles", "patches", "batches", "rings", "rays"]
"""The kinds of selections, by their name in ``MethodInfo.kind``."""

WANTED = np.dtype([("level", "<i4"), ("row", "<i4"), ("col", "<i4"), ("pixels", "<f4")])
"""A tile that a selection lacks: its position, and the largest error in pixels that it would remove."""

NOTHING_WANTED: NDArray[Any] = np.zeros(0, WANTED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection(ABC):
    """What a camera sees of a terrain.

    Attributes:
        method: the name of the method that selected it.
        bound: pixels within which every point of the full-resolution surface in view is drawn; None: no promise.
        lacking: (w,) of ``WANTED``, largest error first: tiles that the method wanted and did not have.
        stats: what the method says of it, as JSON has it.
    """

    method: str
    bound: float | None
    lacking: NDArray[Any] = field(default_factory=lambda: NOTHING_WANTED)
    stats: dict[str, Any] = field(default_factory=dict)

    @abstractmethod
    def tessellation(self) -> Tessellation:
        """Its triangles.

        Raises:
            UsageError: it has none.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class TriangleMesh(Selection):
    """A mesh of single triangles.

    Attributes:
        mesh: vertices anywhere, triangles, and the strip where the method makes one. Its own ``stats`` are completed by
            those of the selection.
    """

    mesh: Tessellation

    def __post_init__(self) -> None:
        for name, value in {"method": self.method, **self.stats}.items():
            self.mesh.stats.setdefault(name, value)

    def tessellation(self) -> Tessellation:
        """The mesh."""
        return self.mesh


@dataclass(frozen=True, slots=True)
class Topology:
    """The triangles that instances of a patch share.

    Attributes:
        points: (v, 2) int32, lattice points (i, j).
        triangles: (t, 3) int32, indices into ``points``.
    """

    points: NDArray[np.int32]
    triangles: NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchSet(Selection):
    """Instances of a few topologies, each with a place of its own.

    Attributes:
        topologies: the shapes there are.
        instances: structured array (k,), one patch each (``lod.patches.shape.INSTANCE``).
        shapes: (k,) uint8, the topology of each instance.
        expand: makes the triangles of the instances.
    """

    topologies: Sequence[Topology]
    instances: NDArray[Any]
    shapes: NDArray[np.uint8]
    expand: Any

    def tessellation(self) -> Tessellation:
        """The triangles of all instances."""
        made: Tessellation = self.expand(self)
        return made


@dataclass(frozen=True, slots=True, kw_only=True)
class PieceSet(PatchSet):
    """Instances (``PIECE``) of pieces of square patches, whose heights are the terrain's samples of their levels.

    Attributes:
        side: lattice points from one side of a patch to the other.
        clockwise: whether the triangles of topologies have to be turned over to turn as a ``Tessellation``'s do.
    """

    side: int
    clockwise: bool


PIECE = np.dtype([("row", "<i4"), ("col", "<i4"), ("p", "<i4"), ("turns", "<i4"), ("level", "<i4")])
"""A piece of a patch: its patch's upper left sample, the exponent of the patch's side, quarters by which it is turned
clockwise, and the level that its finest vertices are on."""


@dataclass(frozen=True, slots=True)
class TinBatch:
    """A small mesh of its own, which may be between two others.

    Attributes:
        vertices: (n, 3) float64, column, row, height. triangles: (m, 3) int32.
        coarse: (n,) float64, heights that vertices grow from; None: they do not. share: how far they have, 0 to 1.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    coarse: NDArray[np.float64] | None = None
    share: float = 1.0

    @property
    def drawn(self) -> NDArray[np.float64]:
        """The vertices where they are drawn."""
        if self.coarse is None or self.share == 1:
            return self.vertices
        found = self.vertices.copy()
        found[:, 2] = self.coarse + self.share * (self.vertices[:, 2] - self.coarse)
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class TinBatches(Selection):
    """Batches, each with vertices and triangles of its own; batches that touch list the same vertices along their edge.

    Attributes:
        batches: the meshes.
    """

    batches: Sequence[TinBatch]

    def tessellation(self) -> Tessellation:
        """All batches in one mesh, with shared vertices welded."""
        corners = np.concatenate([np.zeros((0, 3)), *(b.drawn for b in self.batches)])
        bases = np.cumsum([0, *(len(b.vertices) for b in self.batches)])
        faces = [b.triangles + base for b, base in zip(self.batches, bases)]
        triangles = np.concatenate([np.zeros((0, 3), np.int32), *faces]).astype(np.int32)
        vertices, where = welded(corners)
        return Tessellation(vertices, where[triangles], stats=dict(self.stats))


@dataclass(frozen=True, slots=True, kw_only=True)
class CodedChunks(Selection):
    """Compressed chunks, decoded by whatever draws them (``store.chunk_code``).

    Attributes:
        layout: of all chunks. source: whose they are; the chunks of one source and one name are the same.
        names: level, row and column of each. words: of each, uint32. left: float32, how far its vertices have left the
            coarser mesh, 0 to 1. skirts: whether they are drawn.
        expand: makes the triangles of all.
    """

    layout: Layout
    source: Any
    names: Sequence[tuple[int, int, int]]
    words: Sequence[NDArray[np.uint32]]
    left: NDArray[np.float32]
    skirts: bool
    expand: Any

    def tessellation(self) -> Tessellation:
        """The triangles of all chunks."""
        made: Tessellation = self.expand(self)
        return made


@dataclass(frozen=True, slots=True)
class Blend:
    """Where the heights of a ring become those of the next coarser one, in the ring's own samples.

    Attributes:
        north, south, west, east: rows and columns from which on they begin to; infinite where they do not.
        width: samples after which they have become so.
    """

    north: float
    south: float
    west: float
    east: float
    width: float

    def at(self, row: NDArray[Any], col: NDArray[Any]) -> NDArray[np.float64]:
        """The share of the coarser heights, 0 to 1, at rows and columns that broadcast against each other."""
        down = np.maximum(self.north - row, row - self.south)
        across = np.maximum(self.west - col, col - self.east)
        return np.asarray(np.clip(np.maximum(down, across) / self.width, 0.0, 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipRings(Selection):
    """Nested rings, each twice as coarse as the one within it.

    Attributes:
        stack: the windows, outermost first. They begin and end at even samples, and so may reach a sample beyond their
            level's last one, which stands for the raster's last.
        blends: of each. seen: of each, (block rows, block cols) bool: which of its blocks of ``block`` × ``block``
            cells, counted from the one with its first sample, are in view.
        block: cells along a side.
        read: heights of a part of a window, metres, of the moment when it was selected; None: the triangles are not
            those of whole cells alone, for some are split along missing ground.
        expand: makes the triangles of the rings.
    """

    stack: ClipStack
    blends: Sequence[Blend]
    seen: Sequence[NDArray[np.bool_]]
    block: int
    read: Callable[[Rectangle], Heights] | None
    expand: Any

    def tessellation(self) -> Tessellation:
        """The triangles of all rings."""
        made: Tessellation = self.expand(self)
        return made


RaySurface = Literal["exact", "bilinear", "constant"]
"""What lies between samples: both triangles of a cell; what is bilinear; the middle height of a cell, or of many."""

LEVELS_SHARE = 0.5
"""Of the bound, what the levels of windows may take where the surface is not the exact one; it has the rest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RayWindows(Selection):
    """Nested windows of levels at which rays are cast; it makes no triangles.

    Attributes:
        windows: outermost first. surface: what rays meet between their samples, where that keeps the bound.
        at_breaks: of a picture, only pixels where depth or colour breaks off have more samples than one.
    """

    windows: ClipStack
    surface: RaySurface = "exact"
    at_breaks: bool = False

    def tessellation(self) -> Tessellation:
        raise UsageError(
            f"The method {self.method} casts rays: it makes no triangles.",
            remedy="Choose another method, such as soar.",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchesAndRays(RayWindows):
    """Patches, and windows for rays, of which each block of the screen takes one.

    Attributes:
        camera: whose. block: pixels along a block's side. shares: who draws a block, as ``hybrid``'s option has it.
        hysteresis: how much cheaper than what drew a block the other has to be, a part.
        select_patches: makes the patches, for those who do not have them already.
    """

    camera: Camera
    block: int
    shares: str
    hysteresis: float
    select_patches: Callable[[], PatchSet]
