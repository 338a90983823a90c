"""The ground by rays: the windows that a method selects, read, brought to the GPU, and cast at from every pixel.

Reading windows and their pyramids takes long, so the thread that selects does it (``Windows.ready``): what is drawn
meanwhile is what was there before, whose outermost window holds the whole terrain, coarsely. Windows that the next
selection has, too, are read once. One pass over all pixels (``shaders/surface_rays.wgsl``) leaves depth and marks; or
rays are cast through those of some blocks of the screen, of which a pass of its own counts the steps.

Heights take 4 bytes a sample, their pyramids half as many more (``rendering.gpu.pool``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.gpu.recording import write
from orograph.hierarchy.clip_stack import Rectangle
from orograph.lod.selection import RayWindows
from orograph.raycast.mips import Mips, build_mips
from orograph.raycast.select import load
from orograph.raycast.stack import HeightWindow
from orograph.rendering.gpu.camera import CAMERA
from orograph.rendering.gpu.pool import NODES, WINDOWS, Pool
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.targets import GIVEN, MARKS, NEARER, Targets, cleared
from orograph.store.terrain import Terrain

WINDOW = np.dtype(
    [
        ("first", "<i4", 2), ("last", "<i4", 2), ("cells", "<i4", 2), ("offset", "<i4"), ("stride", "<i4"),
        ("level", "<u4"), ("node", "<i4"), ("top", "<i4"), ("pad", "<i4"),
    ]
)  # fmt: skip
STACK = np.dtype(
    [
        ("low", "<f4"), ("high", "<f4"), ("count", "<i4"), ("pad", "<i4"), ("windows", WINDOW, WINDOWS),
        ("nodes", "<i4", (NODES, 4)),
    ]
)  # fmt: skip
"""The uniform ``Stack`` of ``shaders/surface_rays.wgsl``."""

BLOCKS = {
    "array_stride": 8,
    "step_mode": "instance",
    "attributes": [{"format": "uint32x2", "offset": 0, "shader_location": 0}],
}
"""The buffer of blocks: column and row of each."""

BLOCK, SPACING = 64, 16
"""Pixels along a block, unless it is said, and between the rays whose steps are counted."""

COARSER = 1.25
"""By how much a tolerance grows until its windows fit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CastWindows(RayWindows):
    """Windows that are on the GPU.

    Attributes:
        stack: ``STACK``. pool: the buffer of heights and pyramids. held: what the buffer was made of.
    """

    stack: NDArray[np.void]
    pool: Any
    held: dict[Rectangle, tuple[HeightWindow, Mips]]


class Windows:
    """Brings windows to the GPU.

    Args:
        most: bytes that there are for them.
    """

    def __init__(self, device: Device, terrain: Terrain, most: int, jobs: int | None = None) -> None:
        self.device, self.terrain, self.jobs = device, terrain, jobs
        self.most = most // 6  # samples: heights, and half of that for pyramids, 4 bytes each
        self._last: CastWindows | None = None

    def ready(self, selection: RayWindows, again: Callable[[float], RayWindows]) -> CastWindows:
        """A selection, read and on the GPU; coarser, as its bound says, where memory holds no more.

        Args:
            again: selects with another tolerance, pixels.

        Raises:
            StoreError: a tile cannot be read. DeviceLimitError: the device's memory is full.
        """
        bound, top = selection.bound or 1.0, self.terrain.levels - 1
        while selection.windows[-1].level < top and not self._fits(selection):
            bound *= COARSER
            selection = again(bound)
        last = self._last
        if last is None or last.windows != selection.windows:
            last = self._made(selection, {} if last is None else last.held)
        self._last = (
            last
            if (last.bound, last.stats) == (selection.bound, selection.stats)
            else replace(last, bound=selection.bound, stats=selection.stats)
        )
        return self._last

    def _fits(self, selection: RayWindows) -> bool:
        return selection.windows.samples <= self.most and len(selection.windows) <= WINDOWS

    def _made(self, selection: RayWindows, held: dict[Rectangle, tuple[HeightWindow, Mips]]) -> CastWindows:
        wanted = [where for where in selection.windows if where not in held]
        read = load(self.terrain, wanted, self.jobs)
        new = {where: (w, build_mips(w.heights, self.jobs)) for where, w in zip(wanted, read, strict=True)}
        there = {where: held[where] if where in held else new[where] for where in selection.windows}
        pool = Pool.of([w for w, _ in there.values()], [m for _, m in there.values()], self.terrain.grid.shape,
                       minima=True)  # fmt: skip
        return CastWindows(
            method=selection.method, bound=selection.bound, lacking=selection.lacking, stats=selection.stats,
            windows=selection.windows, stack=_stack(pool), pool=self.device.buffer(pool.values, "STORAGE", "heights"),
            held=there,
        )  # fmt: skip


def _stack(pool: Pool) -> NDArray[np.void]:
    out = np.zeros((), STACK)
    out["low"], out["high"], out["count"] = pool.low, pool.high, len(pool.windows)
    for k, w in enumerate(pool.windows):
        out["windows"][k] = w.first, w.last, w.cells, w.offset, w.stride, w.level, w.node, w.top, 0
    out["nodes"][: len(pool.nodes)] = pool.nodes
    return out


class RayPass:
    """Casts rays through pixels into depth and marks.

    Args:
        camera: the uniform buffer (``camera.CAMERA``).
    """

    def __init__(self, device: Device, camera: Any) -> None:
        self.device = device
        self.stack = device.buffer(STACK.itemsize, "UNIFORM", "windows")
        self._camera = self._program(BLOCK).bind({"camera": camera})
        self._pipelines: dict[tuple[bool, str, int], Any] = {}
        self._held: tuple[Any, Any] = (None, None)
        self._blocks: tuple[bytes, Any] = (b"", None)

    def _program(self, side: int) -> Program:
        return Program(self.device, "surface_rays", SIDE=side)

    def draw(self, encoder: Any, targets: Targets, selection: CastWindows, left: Left) -> None:
        """Clear the targets and draw; it has no edges, and what lines are of the terrain is what is drawn."""
        slopes = bool(left.slopes)
        self.bring(selection)
        pass_ = cleared(targets, self.device, slopes).begin(encoder)
        self._record(pass_, slopes, "")
        pass_.draw(3)
        pass_.end()

    def bring(self, selection: CastWindows) -> None:
        """Have the windows at which rays are cast next."""
        if self._held[0] is not selection.pool:
            write(self.device, self.stack, selection.stack.tobytes())
            self._held = selection.pool, self._program(BLOCK).bind({"stack": self.stack, "pool": selection.pool}, 1)

    def bring_blocks(self, by_rays: NDArray[np.bool_]) -> int:
        """Have the blocks of the screen (down, across) that rays draw; how many there are."""
        places = np.argwhere(by_rays)[:, ::-1].astype(np.uint32)
        data = places.tobytes()
        if len(places) and self._blocks[0] != data:
            self._blocks = data, self.device.buffer(np.ascontiguousarray(places), "VERTEX", "blocks")
        return len(places)

    def keep_free(self, pass_: Any, count: int, side: int, slopes: bool) -> None:
        """Keep what lies behind out of the blocks, until rays are cast there."""
        self._record(pass_, slopes, "kept_free", side)
        pass_.set_vertex_buffer(0, self._blocks[1])
        pass_.draw(6, count)

    def cast_blocks(self, pass_: Any, count: int, side: int, slopes: bool) -> None:
        """Cast rays through the pixels of the blocks, whatever is there."""
        self._record(pass_, slopes, "block", side)
        pass_.set_vertex_buffer(0, self._blocks[1])
        pass_.draw(6, count)

    def _record(self, pass_: Any, slopes: bool, what: str, side: int = BLOCK) -> None:
        pass_.set_pipeline(self._pipeline(slopes, what, side))
        pass_.set_bind_group(0, self._camera)
        pass_.set_bind_group(1, self._held[1])

    def _pipeline(self, slopes: bool, what: str, side: int) -> Any:
        """The pipeline that draws all pixels (""), blocks ("block"), or keeps them free ("kept_free")."""
        key = slopes, what, side
        if key not in self._pipelines:
            entry = "kept_free" if what == "kept_free" else "fragment"
            sloped = "kept_free_with_slope" if what == "kept_free" else "with_slope"
            self._pipelines[key] = self._program(side).draw(
                [{"format": format} for format in ((MARKS, GIVEN) if slopes else (MARKS,))],
                vertex="block" if what else "vertex", fragment=sloped if slopes else entry,
                buffers=[BLOCKS] if what else [], depth={**NEARER, "depth_compare": "always"} if what else NEARER,
            )  # fmt: skip
        return self._pipelines[key]


class RaySteps:
    """Counts the steps of rays, for those who decide by what rays cost; from any thread."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._program = Program(device, "ray_steps", COUNTED=1, SPACING=SPACING)
        self._camera = device.buffer(CAMERA.itemsize, "UNIFORM", "camera")
        self._stack = device.buffer(STACK.itemsize, "UNIFORM", "windows")
        self._pipeline: Any = None

    def count(self, windows: CastWindows, camera: NDArray[np.void]) -> NDArray[np.uint32]:
        """Of the middle pixel of every cell of ``SPACING`` pixels: twice its ray's steps, plus 1 if it meets ground."""
        width, height = (int(n) for n in camera["size"])
        down, across = -(-height // SPACING), -(-width // SPACING)
        found = self.device.buffer(4 * down * across, "STORAGE|COPY_SRC", "steps")
        write(self.device, self._camera, camera.tobytes())
        write(self.device, self._stack, windows.stack.tobytes())
        if self._pipeline is None:
            self._pipeline = self._program.compute()
        encoder = self.device.handle.create_command_encoder()
        pass_ = encoder.begin_compute_pass()
        pass_.set_pipeline(self._pipeline)
        pass_.set_bind_group(0, self._program.bind({"camera": self._camera}))
        pass_.set_bind_group(
            1, self._program.bind({"stack": self._stack, "pool": windows.pool, "found": found}, 1)
        )  # fmt: skip
        pass_.dispatch_workgroups(-(-across // 8), -(-down // 8))
        pass_.end()
        self.device.queue.submit([encoder.finish()])
        return self.device.read_buffer(found, np.uint32).reshape(down, across)
