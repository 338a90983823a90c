"""Seamless patches: a patch for each square of a quadtree; resolution changes inside patches, never across an edge.

Livny, Kogan & El-Sana, *Seamless patches for GPU-based terrain rendering* (The Visual Computer 25, 2009). A patch is
four triangular tiles, each as fine as the patch's edge that it stands on, and four strips between them
(``seamless_pieces``). A selection is nothing but where patches are and how fine their edges are (``seamless_layout``);
tiles and strips are made once and drawn as instances, whose vertices take their heights from the terrain.

How fine an edge is, is a function of that edge alone, so patches that touch agree about it without asking each other.
In print it follows from the camera; here it is the spacing whose surface keeps the tolerance around the edge
(``seamless_errors``). Tiles are the surface of such a level. A fan of a strip lies within one triangle of it, and its
corners on the terrain: it is off by twice the level's error at most. So an edge keeps the tolerance with twice that
error, and so does all that is drawn. Metres, samples, pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.lod.method import EVERYTHING, Goal, MethodInfo, Need, Ready
from orograph.lod.options import check, option
from orograph.lod.quadtree_patches import Pieces, QuadtreePatches
from orograph.lod.seamless_errors import BlockErrors
from orograph.lod.seamless_layout import Layout, Patches
from orograph.lod.seamless_pieces import SeamlessPieces, turned
from orograph.lod.selection import PIECE, PatchSet, PieceSet
from orograph.lod.squares import Index
from orograph.store.terrain import TILE
from orograph.tessellation import Tessellation, turn
from orograph.viewpoint import Camera


@dataclass(frozen=True, slots=True, kw_only=True)
class SeamlessPatchesOptions:
    """Options of ``seamless-patches``."""

    segments: int = option(
        64, "The most segments along a patch's edge, and samples along a smallest patch's; fewer where the raster is "
            "smaller.", choices=(8, 16, 32, 64, 128),
    )  # fmt: skip
    strips: str = option(
        "kept", "Whether strips keep the tolerance too: kept (edges allow for twice a level's error) or free (for "
                "the error itself: where resolution changes, the error may be twice as large, without a promise).",
        choices=("kept", "free"),
    )  # fmt: skip

    def __post_init__(self) -> None:
        check(self)


class SeamlessPatches(QuadtreePatches):
    """Seamless patches. See ``Method`` for the arguments.

    Raises:
        UsageError: the terrain has no surface.
        StoreError: the store lacks the errors of diamonds.
    """

    info = MethodInfo(
        "seamless-patches", "squares of a quadtree, of four tiles as fine as their edges and four strips between them",
        "Livny, Kogan & El-Sana 2009", "patches", SeamlessPatchesOptions,
        lambda options: options.strips == "kept",
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self.big = max(min(self.options.segments.bit_length() - 1, self.terrain.n), 1)
        self._errors = BlockErrors(self.terrain, "exact", self.big, self.resources)
        self._made = SeamlessPieces.of(self.big)
        self.topologies = self._made.topologies
        self._sizes = np.array([len(t.triangles) for t in self.topologies])

    @classmethod
    def needs(cls, options: Any) -> tuple[Need, ...]:
        """The exact errors of diamonds."""
        return (Need("diamonds", {"error": "exact"}),)

    def select(self, camera: Camera, goal: Goal, ready: Ready = EVERYTHING) -> PieceSet:
        """The pieces of a view."""
        found = super().select(camera, goal, ready)
        return PieceSet(
            **{one.name: getattr(found, one.name) for one in fields(found)},
            side=1 << self.big, clockwise=turn(self.terrain.grid) < 0,
        )  # fmt: skip

    def _pieces(self, camera: Camera, tolerance: float) -> Pieces:
        times = 2.0 if self.conservative else 1.0
        patches = Layout(camera, tolerance, self._errors, times=times).patches()
        made = [self._pieces_of(one) for one in patches]
        shapes = np.concatenate([np.zeros(0, np.uint8), *(shape for shape, _ in made)])
        pieces = np.concatenate([np.zeros(0, PIECE), *(piece for _, piece in made)])
        return Pieces(pieces, shapes, sum(len(p.squares) for p in patches), int(self._sizes[shapes].sum()))

    def _pieces_of(self, patches: Patches) -> tuple[NDArray[np.uint8], NDArray[Any]]:
        """The pieces of patches of one size: which they are, and where."""
        squares, p = patches.squares, patches.squares.p
        fine = p - patches.spacing
        shapes, found = [], []
        for side in range(4):
            own, last = fine[:, side], fine[:, side - 1]
            for shape, q in ((self._made.tile(own), own), (self._made.strip(own, last), np.maximum(own, last))):
                here = self._sizes[shape] > 0
                piece = np.zeros(int(here.sum()), PIECE)
                piece["row"], piece["col"] = squares.row[here] << p, squares.col[here] << p
                piece["p"], piece["turns"], piece["level"] = p, side, np.maximum(p - q[here], 0)
                shapes.append(shape[here].astype(np.uint8))
                found.append(piece)
        return np.concatenate(shapes), np.concatenate(found)

    def _expand(self, selection: PatchSet, camera: Camera, tolerance: float) -> Tessellation:
        keys, heights = [np.zeros((0, 3), np.int64)], [np.zeros((0, 3), np.float32)]
        for shape in np.unique(selection.shapes).tolist():
            key, height = self._points(selection.instances[selection.shapes == shape], shape)
            triangles = self.topologies[shape].triangles
            keys.append(key[:, triangles].reshape(-1, 3))
            heights.append(height[:, triangles].reshape(-1, 3))
        corners, up = np.concatenate(keys), np.concatenate(heights)
        there = ~np.isnan(up).any(1)
        stats = dict(selection.stats)
        made = Tessellation.from_triangles(self.terrain.grid, corners[there], up[there], clockwise=True, stats=stats)
        stats["triangles"] = len(made.triangles)
        return made

    def _points(self, pieces: NDArray[Any], shape: int) -> tuple[Index, NDArray[np.float32]]:
        """The keys and the heights (m, v) of the vertices of pieces of one topology."""
        points = self.topologies[shape].points.astype(np.int64)
        side = 1 << self.big
        turns = np.stack([turned(points, times, side) for times in range(4)])
        at = (turns[pieces["turns"]] << pieces["p"].astype(np.int64)[:, None, None]) >> self.big
        rows, cols = pieces["row"].astype(np.int64)[:, None] + at[..., 0], pieces["col"][:, None] + at[..., 1]
        keys = rows << 32 | cols
        levels = np.broadcast_to(pieces["level"].astype(np.int64)[:, None], keys.shape)
        return keys, self._heights(keys.ravel(), levels.ravel()).reshape(keys.shape)

    def _heights(self, keys: Index, levels: Index) -> NDArray[np.float32]:
        """The heights (n,) of vertices by their keys, read from levels that have them, tile by tile."""
        level = np.minimum(levels, self.terrain.levels - 1)
        row, col = (keys >> 32) >> level, (keys & 0xFFFFFFFF) >> level
        high, wide = (np.array(sides) for sides in zip(*map(self.terrain.shape, range(self.terrain.levels))))
        row, col = np.minimum(row, high[level] - 1), np.minimum(col, wide[level] - 1)
        tiles = level << 48 | (row // TILE) << 24 | col // TILE
        order = np.argsort(tiles, kind="stable")
        names, begins = np.unique(tiles[order], return_index=True)
        found = np.empty(len(keys), np.float32)
        for name, here in zip(names.tolist(), np.split(order, begins[1:])):
            k, row0, col0 = name >> 48, (name >> 24 & 0xFFFFFF) * TILE, (name & 0xFFFFFF) * TILE
            row1, col1 = min(row0 + TILE, int(high[k])), min(col0 + TILE, int(wide[k]))
            found[here] = self.terrain.read(k, row0, row1, col0, col1)[row[here] - row0, col[here] - col0]
        return found
