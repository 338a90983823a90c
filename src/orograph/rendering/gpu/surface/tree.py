"""A concurrent binary tree that lives on the GPU (``lod.cbt``): updated by dispatches, drawn by one indirect draw.

The pool of triangles, the bits of its slots in use, and their sums are buffers that nothing on the CPU reads. A
frame judges all triangles for its camera, then updates the tree several times: *mark*, *plan*, *apply*, two dispatches
of the sum reduction, and *judge* again (``shaders/cbt.wgsl``). These are 1 + 6 · updates dispatches; all but those of
the sums get their size from the GPU, as does the draw. What is drawn is read back only on request
(``Tree.pool``).

Memory: 96 bytes a slot for the triangles before and after an update, 8 for lists and marks, and 3/8 for bits and sums.
Whatever is computed from positions, in float32, is rounded towards a split, so that the promise holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import camera_parameters
from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.gpu.recording import begin_compute, write
from orograph.hierarchy import triangles
from orograph.lod.cbt.pool import Pool
from orograph.lod.selection import Selection
from orograph.rendering.gpu.camera import CAMERA, camera_of
from orograph.rendering.gpu.surface.faces import FacePass
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.targets import Targets
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera, View

NODE = np.dtype(
    [("l", "<i4", 2), ("shape", "<u4"), ("spare", "<u4"), ("heights", "<f4", 4), ("links", "<u4", 4)]
)  # fmt: skip
"""A triangle: ``Node`` of ``shaders/cbt_node.wgsl``."""

TUNING = np.dtype(
    [
        ("planes", "<f4", (6, 4)), ("focal", "<f4"), ("tolerance", "<f4"), ("lean", "<f4"), ("stretch", "<f4"),
        ("isotropic", "<u4"), ("cull", "<u4"), ("n", "<u4"), ("top", "<u4"), ("near", "<f4"), ("slots", "<u4"),
        ("texel", "<f4"), ("pad", "<u4"), ("levels", "<u4", (32, 4)),
    ]
)  # fmt: skip
"""The uniform ``Tuning`` of ``shaders/cbt.wgsl``."""

NONE, MISSING = 0xFFFFFFFF, np.float32(1e30)
SHOWN = 16
"""Shaders' values for no slot, for no height, and for the mark of a drawn triangle."""

LEAST = 1 << 14
"""Slots that a workgroup of the sum reduction adds up."""


class Paged(Protocol):
    """Pages of diamonds (``stream.diamonds.DiamondPages``)."""

    atlas: Any
    levels: NDArray[np.uint32]


@dataclass(frozen=True, slots=True)
class Counts:
    """A tree's counts, as read from the GPU.

    Attributes:
        triangles: in the pool. wanted: slots that the last update asked for. changes: triangles split or
            merged so far.
    """

    triangles: int
    wanted: int
    changes: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TreeFrame(Selection):
    """A tree after some update; the next update changes it.

    Attributes:
        tree: on the GPU. reached: its error in pixels, given the pages that are there. full: whether it wanted
            more triangles than there is room for.
    """

    tree: Tree
    reached: float
    full: bool

    def tessellation(self) -> Tessellation:
        """The drawn triangles, read back."""
        return self.tree.tessellation(dict(self.stats))


class Tree:
    """A tree on a device.

    Args:
        corners: (2, 2) heights of the square's corners. pages: of the diamonds.
        slots: capacity in triangles; rounded up to a power of two.
        isotropic: whether the metric is isotropic. cull: leave out what is out of view.

    Attributes:
        slots: as rounded. bytes: of its buffers. updates: their number so far.
    """

    def __init__(
        self, device: Device, terrain: Terrain, corners: NDArray[np.float32], pages: Paged, slots: int, *,
        isotropic: bool = False, cull: bool = True,
    ) -> None:  # fmt: skip
        self.device, self.terrain, self.pages = device, terrain, pages
        self.isotropic, self.cull = isotropic, cull
        self.slots = max(LEAST, 1 << (slots - 1).bit_length())
        self.updates = 0
        words = self.slots // 32
        nodes = np.zeros(self.slots, NODE)
        nodes[:2] = _roots(terrain.n, corners)
        bits = np.zeros(words, np.uint32)
        bits[0] = 3
        made = device.buffer
        self.nodes = [made(nodes, "STORAGE|COPY_SRC", "triangles"), made(nodes.nbytes, "STORAGE|COPY_SRC", "triangles")]
        self.state = made(4 * self.slots + 8, "STORAGE|COPY_SRC", "marks of triangles")
        self.list = made(4 * self.slots, "STORAGE|COPY_SRC", "slots of triangles")
        self.bits = made(bits, "STORAGE|COPY_SRC", "bits")
        self.sums = made(8 * words, "STORAGE|COPY_SRC", "sums")
        self.arguments = made(32, "STORAGE|INDIRECT", "counts")
        self.asked = made(
            np.zeros(-(-pages.atlas.tables.total // 32), np.uint32), "STORAGE|COPY_SRC", "pages asked for"
        )
        self.bytes = 2 * nodes.nbytes + 8 * self.slots + 12 * words
        self._camera = made(CAMERA.itemsize, "UNIFORM", "camera of a tree")
        self._tuning = made(TUNING.itemsize, "UNIFORM", "tuning of a tree")
        self._turn = self._due = 0
        self._aimed: tuple[View, float, float] | None = None
        program, sums = Program(device, "cbt"), Program(device, "cbt_sums", WORDS=words)
        self._groups = [program.bind(self._bound(k)) for k in range(2)]
        self._adding = sums.bind({"bits": self.bits, "sums": self.sums, "arguments": self.arguments})
        self._steps = {name: program.compute(name) for name in ("judge", "mark", "plan", "apply")}
        self._add = [sums.compute(name) for name in ("blocks", "top")]
        self._blocks = words // 512
        encoder = device.handle.create_command_encoder()
        pass_ = begin_compute(encoder)
        self._sum(pass_)
        pass_.end()
        device.queue.submit([encoder.finish()])

    def _bound(self, turn: int) -> dict[str, Any]:
        return {
            "camera": self._camera, "tuning": self._tuning, "nodes": self.nodes[turn], "after": self.nodes[1 - turn],
            "state": self.state, "list": self.list, "bits": self.bits, "sums": self.sums,
            "pages": self.pages.atlas.page_buffer, "asked": self.asked,
            "diamonds": self.pages.atlas.texture.create_view(dimension="2d-array"),
        }  # fmt: skip

    def update(self, view: View, tolerance: float, exaggeration: float, count: int) -> None:
        """Judge for a camera and update ``count`` times, now, without waiting. Arguments as for ``aim``."""
        self.aim(view, tolerance, exaggeration, count)
        encoder = self.device.handle.create_command_encoder()
        self.encode(encoder)
        self.device.queue.submit([encoder.finish()])

    def aim(self, view: View, tolerance: float, exaggeration: float, count: int) -> None:
        """Schedule the tree to be judged for a camera and updated ``count`` times before it is drawn.

        Args:
            tolerance: pixels.
        """
        if self._aimed != (view, tolerance, exaggeration):
            write(self.device, self._camera, camera_of(view, self.terrain, exaggeration))
            write(self.device, self._tuning, self._tuned(view, tolerance, exaggeration))
            self._aimed = view, tolerance, exaggeration
        self._due = count

    def encode(self, encoder: Any) -> None:
        """Record what ``aim`` scheduled, once."""
        count, self._due = self._due, 0
        if not count:
            return
        pass_ = begin_compute(encoder)
        self._step(pass_, "judge")
        for _ in range(count):
            for name in ("mark", "plan", "apply"):
                self._step(pass_, name)
            self._sum(pass_)
            self._turn = 1 - self._turn
            self._step(pass_, "judge")
        pass_.end()
        self.updates += count

    def _step(self, pass_: Any, name: str) -> None:
        pass_.set_pipeline(self._steps[name])
        pass_.set_bind_group(0, self._groups[self._turn])
        pass_.dispatch_workgroups_indirect(self.arguments, 0)

    def _sum(self, pass_: Any) -> None:
        for pipeline, groups in zip(self._add, (self._blocks, 1), strict=True):
            pass_.set_pipeline(pipeline)
            pass_.set_bind_group(0, self._adding)
            pass_.dispatch_workgroups(groups)

    def _tuned(self, view: View, tolerance: float, exaggeration: float) -> NDArray[np.void]:
        u = np.zeros((), TUNING)
        lens = camera_parameters(Camera.over(self.terrain.grid, view, exaggeration), tolerance=tolerance)
        plan = view.projection == "plan"
        eye = np.array([*(view.target if plan else view.eye)[:2], view.eye[2] * exaggeration])
        u["planes"][:] = 0, 0, 0, MISSING
        for k, plane in enumerate(view.frustum(exaggeration)):
            u["planes"][k] = *plane[:3], plane[:3] @ eye + plane[3]
        u["focal"], u["tolerance"], u["lean"] = lens.focal, tolerance, lens.largest_lean
        u["stretch"], u["near"], u["texel"] = lens.stretch, lens.near, lens.texel
        u["isotropic"], u["cull"] = self.isotropic, self.cull
        u["n"], u["top"], u["slots"] = self.terrain.n, self.terrain.levels - 1, self.slots
        u["levels"] = self.pages.levels
        return u

    @property
    def current(self) -> Any:
        """The buffer of triangles."""
        return self.nodes[self._turn]

    def counts(self) -> Counts:
        """Wait for the GPU, and read the counts."""
        queue = self.device.queue
        wanted, changes = np.frombuffer(queue.read_buffer(self.state, 4 * self.slots, 8), np.uint32)
        (count,) = np.frombuffer(queue.read_buffer(self.sums, 4, 4), np.uint32)
        return Counts(int(count), int(wanted), int(changes))

    def take_asked(self) -> NDArray[np.uint32]:
        """Wait for the GPU, and read which pages were missing since the last call: a bit each."""
        found = self.device.read_buffer(self.asked, np.uint32).copy()
        self.device.queue.write_buffer(self.asked, 0, np.zeros_like(found))
        return found

    def pool(self) -> tuple[Pool, NDArray[np.bool_]]:
        """Wait for the GPU, and read the tree, and which of its slots are drawn."""
        nodes = self.device.read_buffer(self.current, NODE)
        bits = self.device.read_buffer(self.bits, np.uint8)
        used = np.unpackbits(bits, bitorder="little").astype(bool)
        shown = self.device.read_buffer(self.state, np.uint32)[: self.slots] & SHOWN > 0
        level, omega = nodes["shape"].astype(np.int64) >> 3, nodes["shape"].astype(np.int64) & 7
        side = 1 << (self.terrain.n - np.minimum((level + 1) // 2, self.terrain.n))
        shape = np.stack([nodes["l"][:, 0], nodes["l"][:, 1], side, omega], -1).astype(np.int64)
        heights = np.where(nodes["heights"] < 0.5 * MISSING, nodes["heights"], np.float32(np.nan))
        links = nodes["links"][:, :3].astype(np.int64)
        links[links == NONE] = -1
        return Pool(shape, level, heights, links, used), used & shown

    def tessellation(self, stats: dict[str, Any]) -> Tessellation:
        """Wait for the GPU, and read what is drawn."""
        pool, shown = self.pool()
        slots = np.flatnonzero(shown)
        keys = pool.corners(slots)
        heights = pool.heights[slots, :3]
        made = Tessellation.from_triangles(self.terrain.grid, keys, heights, clockwise=False, stats=stats)
        stats["triangles"] = len(made.triangles)
        return made


def _roots(n: int, corners: NDArray[np.float32]) -> NDArray[Any]:
    """The two triangles of the square."""
    out = np.zeros(2, NODE)
    (nw, ne), (sw, se) = np.where(np.isnan(corners), MISSING, corners)
    for k, (x, y, _, omega) in enumerate(triangles.root(k, n) for k in range(2)):
        heights = (nw, se, ne, MISSING) if k == 0 else (se, nw, sw, MISSING)
        out[k] = (x, y), omega, 0, heights, (NONE, NONE, 1 - k, NONE)
    return out


class TreePass(FacePass):
    """Draws trees into depth and marks. Args: as for ``FacePass``; n: the square has 2^n cells a side."""

    def __init__(
        self, device: Device, camera: Any, field: tuple[Any, Any, Any], missing: int, n: int
    ) -> None:  # fmt: skip
        super().__init__(device, "cbt_draw", camera, field, missing, N=n)
        self._groups: tuple[Tree | None, list[Any]] = (None, [])

    def draw(self, encoder: Any, targets: Targets, selection: TreeFrame, left: Left) -> None:
        """Update the tree if that is scheduled, clear the targets and draw."""
        tree = selection.tree
        tree.encode(encoder)
        if self._groups[0] is not tree:
            self._groups = tree, [self.bind(nodes=nodes, list=tree.list, state=tree.state) for nodes in tree.nodes]
        pass_ = self.begin(encoder, targets, left)
        pass_.set_bind_group(0, self._groups[1][tree.nodes.index(tree.current)])
        pass_.draw_indirect(tree.arguments, 12)
        pass_.end()
