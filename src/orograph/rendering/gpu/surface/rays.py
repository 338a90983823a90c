"""The ground by rays: the windows that a method selects are read and uploaded, and every pixel casts a ray at them.

Reading windows and their pyramids takes long, so the thread that selects does it (``Windows.ready``). Meanwhile the
previous windows are drawn, whose outermost one holds the whole terrain, coarsely. Windows that the next
selection shares are read once. A coarse pass finds where the rays of 16 × 16 pixels come near to the ground
(``Beams``), and one over all pixels (``shaders/surface_rays.wgsl``) leaves depth and marks; or rays are cast only in
some blocks of the screen. A separate pass counts the steps that they take (``RaySteps``).

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
from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.lod.selection import LEVELS_SHARE, RaySurface, RayWindows
from orograph.raycast.mips import Mips, build_mips
from orograph.raycast.select import load
from orograph.raycast.stack import HeightWindow
from orograph.rendering.gpu.camera import CAMERA
from orograph.rendering.gpu.pool import MISSING, NODES, WINDOWS, Pool
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.targets import GIVEN, MARKS, NEARER, Targets, cleared
from orograph.store.terrain import Terrain

WINDOW = np.dtype(
    [
        ("first", "<i4", 2), ("last", "<i4", 2), ("cells", "<i4", 2), ("offset", "<i4"), ("stride", "<i4"),
        ("level", "<u4"), ("node", "<i4"), ("top", "<i4"), ("allowed", "<f4"),
    ]
)  # fmt: skip
STACK = np.dtype(
    [
        ("low", "<f4"), ("high", "<f4"), ("count", "<i4"), ("whole", "<i4"), ("windows", WINDOW, WINDOWS),
        ("nodes", "<i4", (NODES, 4)),
    ]
)  # fmt: skip
"""The uniform ``Stack`` of ``shaders/window_rays.wgsl``."""

BLOCKS = {
    "array_stride": 8,
    "step_mode": "instance",
    "attributes": [{"format": "uint32x2", "offset": 0, "shader_location": 0}],
}
"""The buffer of blocks: column and row of each."""

BLOCK, SPACING, BEAM = 64, 16, 16
"""Pixels along a block (by default), between the rays whose steps are counted, and along a beam."""

HIT = 16
"""Bytes of a pixel's hit, if compute shaders cast rays."""

BREAK = 0.01
"""Fraction of its depth by which a pixel's neighbours must be off a plane to make a break."""

BRIGHT = 0.1
"""Fraction of the brightest channel by which light must differ from the mean of its neighbours to make a break."""

COARSER = 1.25
"""Factor by which a tolerance grows until its windows fit."""

WORST = 1e4
"""The tolerance, in pixels, at which it stops growing: if the eye is closer to the ground than a level's error,
no tolerance is large enough, and the finest windows are left out."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CastWindows(RayWindows):
    """Windows on the GPU.

    Attributes:
        stack: ``STACK``. pool: the buffer of heights and pyramids. held: what the buffer was made from.
    """

    stack: NDArray[np.void]
    pool: Any
    held: dict[Rectangle, tuple[HeightWindow, Mips]]


class Windows:
    """Uploads windows to the GPU.

    Args:
        most: bytes available for them.
    """

    def __init__(self, device: Device, terrain: Terrain, most: int, jobs: int | None = None) -> None:
        self.device, self.terrain, self.jobs = device, terrain, jobs
        self.most = most // 6  # samples: heights, and half of that for pyramids, 4 bytes each
        self._last: CastWindows | None = None

    def ready(self, selection: RayWindows, again: Callable[[float], RayWindows]) -> CastWindows:
        """Return a selection, read and on the GPU; coarser, as its bound says, if memory does not hold it.

        Args:
            again: selects with another tolerance, pixels.

        Raises:
            StoreError: a tile cannot be read. DeviceLimitError: the device's memory is full.
        """
        bound, top = selection.bound or 1.0, self.terrain.levels - 1
        while selection.windows[-1].level < top and not self._fits(selection):
            if bound < WORST:
                bound *= COARSER
                selection = again(bound)
            elif len(selection.windows) > 1:
                selection = replace(selection, windows=ClipStack(selection.windows[:-1]), bound=np.inf)
            else:
                break
        last = self._last
        if last is None or last.windows != selection.windows:
            last = self._made(selection, {} if last is None else last.held)
        told = selection.bound, selection.stats, selection.surface, selection.at_breaks
        if (last.bound, last.stats, last.surface, last.at_breaks) != told:
            stack = last.stack
            if (last.bound, last.surface) != (selection.bound, selection.surface):
                stack = stack.copy()
                stack["windows"]["allowed"] = _allowed(selection)
            last = replace(last, bound=told[0], stats=told[1], surface=told[2], at_breaks=told[3], stack=stack)
        self._last = last
        return last

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
            windows=selection.windows, surface=selection.surface, at_breaks=selection.at_breaks,
            stack=_stack(pool, selection), pool=self.device.buffer(pool.values, "STORAGE", "heights"), held=there,
        )  # fmt: skip


def _allowed(selection: RayWindows) -> NDArray[np.float64]:
    """Pixels (``WINDOWS``,) by which a surface may differ from the exact one in each window: the bound minus the error
    of its level."""
    out = np.zeros(WINDOWS)
    for k, where in enumerate(selection.windows):
        out[k] = (selection.bound or 0.0) * (1.0 if where.level == 0 else 1.0 - LEVELS_SHARE)
    return out


def _stack(pool: Pool, selection: RayWindows) -> NDArray[np.void]:
    out = np.zeros((), STACK)
    out["low"], out["high"], out["count"] = pool.low, pool.high, len(pool.windows)
    out["whole"] = not (pool.values == MISSING).any()
    for k, w in enumerate(pool.windows):
        out["windows"][k] = w.first, w.last, w.cells, w.offset, w.stride, w.level, w.node, w.top, 0.0
    out["windows"]["allowed"] = _allowed(selection)
    out["nodes"][: len(pool.nodes)] = pool.nodes
    return out


class Beams:
    """Finds how far the rays of ``BEAM`` × ``BEAM`` pixels go above all ground (``shaders/ray_beams.wgsl``)."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._program = Program(device, "ray_beams", SIDE=BEAM)
        self._pipeline: Any = None
        self._room: tuple[tuple[int, int], Any] = ((0, 0), None)
        self._held: tuple[Any, Any, Any] = (None, None, None)

    def starts(self, size: tuple[int, int]) -> Any:
        """The buffer of depths for a picture of this size; the same buffer for the same size."""
        if self._room[0] != size:
            across, down = (-(-n // BEAM) for n in size)
            self._room = size, self.device.buffer(4 * across * down, "STORAGE|COPY_SRC", "starts of rays")
        return self._room[1]

    def encode(self, encoder: Any, camera: Any, stack: Any, pool: Any, size: tuple[int, int]) -> None:
        """Find the depths for the camera and the windows in those buffers."""
        starts = self.starts(size)
        if self._pipeline is None:
            self._pipeline = self._program.compute()
        if self._held[0] is not pool or self._held[1] is not starts:
            seen = self._program.bind({"camera": camera})
            self._held = pool, starts, (
                seen, self._program.bind({"stack": stack, "pool": pool, "starts": starts}, 1)
            )  # fmt: skip
        pass_ = encoder.begin_compute_pass()
        pass_.set_pipeline(self._pipeline)
        for k, group in enumerate(self._held[2]):
            pass_.set_bind_group(k, group)
        pass_.dispatch_workgroups(*(-(-n // (8 * BEAM)) for n in size))
        pass_.end()


class Breaks:
    """Finds where depth, light or colour breaks off (``shaders/ray_breaks.wgsl``)."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.found: Any = device.buffer(4, "STORAGE", "breaks")
        self._size = (0, 0)
        self._pipelines: dict[bool, Any] = {}

    def encode(self, encoder: Any, targets: Targets, plan: bool) -> None:
        """Find the breaks in the targets."""
        program = Program(self.device, "ray_breaks", PART=BREAK, BRIGHT=BRIGHT, PLAN=int(plan))
        if plan not in self._pipelines:
            self._pipelines[plan] = program.compute()
        size = targets.width, targets.height
        if self._size != size:
            self._size, self.found = size, self.device.buffer(4 * size[0] * size[1], "STORAGE|COPY_SRC", "breaks")
        bound = {
            "depths": targets.depth_view, "marks": targets.marks_view, "light": targets.light_view,
            "breaks": self.found,
        }  # fmt: skip
        pass_ = encoder.begin_compute_pass()
        pass_.set_pipeline(self._pipelines[plan])
        pass_.set_bind_group(0, program.bind(bound))
        pass_.dispatch_workgroups(*(-(-n // 8) for n in size))
        pass_.end()


class RayPass:
    """Casts rays through pixels into depth and marks.

    Args:
        camera: the uniform buffer (``camera.CAMERA``).
    """

    def __init__(self, device: Device, camera: Any) -> None:
        self.device = device
        self.stack = device.buffer(STACK.itemsize, "UNIFORM", "windows")
        self._buffer, self._beams, self._breaks = camera, Beams(device), Breaks(device)
        self._computes = device.computes
        self._pipelines: dict[tuple[bool, str, int, RaySurface, bool], Any] = {}
        self._held: tuple[list[Any], Any] = ([], None)
        self._groups: tuple[Any, Any] = (None, None)
        self._surface: RaySurface = "exact"
        self._hits: tuple[tuple[int, int], Any] = ((0, 0), None)
        self._blocks: tuple[bytes, Any] = (b"", device.buffer(8, "VERTEX|STORAGE", "blocks"))

    def _program(self, side: int, surface: RaySurface, breaks: bool = False, slopes: bool = False) -> Program:
        return Program(
            self.device, "surface_rays", SIDE=side, BEAM=BEAM, BILINEAR=int(surface == "bilinear"),
            CONSTANT=int(surface == "constant"), BREAKS=int(breaks), SLOPED=int(slopes), COMPUTED=int(self._computes),
        )  # fmt: skip

    def draw(self, encoder: Any, targets: Targets, selection: CastWindows, left: Left) -> None:
        """Clear the targets and draw; there are no edges, and lines follow the drawn ground."""
        slopes = bool(left.slopes)
        self.bring(encoder, targets, selection)
        if self._computes:
            across, down = (-(-n // 8) for n in (targets.width, targets.height))
            self._compute(encoder, slopes, "all breaks" if left.at_breaks else "all", BLOCK, (across, down))
        pass_ = cleared(targets, self.device, slopes).begin(encoder)
        self._record(pass_, slopes, "breaks" if left.at_breaks else "")
        pass_.draw(3)
        pass_.end()

    def find_breaks(self, encoder: Any, targets: Targets, plan: bool) -> None:
        """Find where depth breaks off in the targets, for draws at breaks only (``Left``)."""
        self._breaks.encode(encoder, targets, plan)

    def bring(self, encoder: Any, targets: Targets, selection: CastWindows) -> None:
        """Upload the windows for the next rays, and find where rays begin."""
        self._surface = selection.surface
        size = targets.width, targets.height
        room = HIT * size[0] * size[1]
        self._computes = self.device.computes and room <= self.device.largest  # (otherwise fragments cast rays)
        starts = self._beams.starts(size)
        if self._held[1] is not selection.stack:
            write(self.device, self.stack, selection.stack.tobytes())
        bound = {"stack": self.stack, "pool": selection.pool, "starts": starts, "breaks": self._breaks.found}
        if self._computes:
            if self._hits[0] != size:
                self._hits = size, self.device.buffer(room, "STORAGE", "hits of rays")
            bound |= {"hits": self._hits[1], "blocks": self._blocks[1]}
        asked = list(bound.values())
        if len(asked) != len(self._held[0]) or any(a is not b for a, b in zip(asked, self._held[0], strict=True)):
            program = self._program(BLOCK, "exact")
            self._groups = program.bind({"camera": self._buffer}), program.bind(bound, 1)
        self._held = asked, selection.stack
        self._beams.encode(encoder, self._buffer, self.stack, selection.pool, size)

    def bring_blocks(self, by_rays: NDArray[np.bool_]) -> int:
        """Upload the blocks of the screen (down, across) that rays draw; return their number."""
        places = np.argwhere(by_rays)[:, ::-1].astype(np.uint32)
        data = places.tobytes()
        if len(places) and self._blocks[0] != data:
            self._blocks = data, self.device.buffer(np.ascontiguousarray(places), "VERTEX|STORAGE", "blocks")
        return len(places)

    def compute_blocks(self, encoder: Any, count: int, side: int, slopes: bool) -> None:
        """If compute shaders cast rays, cast those of the blocks, before the pass that copies the hits."""
        if self._computes:
            self._compute(encoder, slopes, "blocks", side, (count, side // 8, side // 8))

    def _compute(self, encoder: Any, slopes: bool, what: str, side: int, groups: tuple[int, ...]) -> None:
        pass_ = encoder.begin_compute_pass()
        self._record(pass_, slopes, what, side)
        pass_.dispatch_workgroups(*groups)
        pass_.end()

    def keep_free(self, pass_: Any, count: int, side: int, slopes: bool) -> None:
        """Fill the blocks with a depth that keeps other ground out, until rays are cast there."""
        self._record(pass_, slopes, "kept_free", side)
        pass_.set_vertex_buffer(0, self._blocks[1])
        pass_.draw(6, count)

    def cast_blocks(self, pass_: Any, count: int, side: int, slopes: bool) -> None:
        """Cast rays through the pixels of the blocks, overwriting what is there."""
        self._record(pass_, slopes, "block", side)
        pass_.set_vertex_buffer(0, self._blocks[1])
        pass_.draw(6, count)

    def _record(self, pass_: Any, slopes: bool, what: str, side: int = BLOCK) -> None:
        pass_.set_pipeline(self._pipeline(slopes, what, side))
        for number, group in enumerate(self._groups):
            pass_.set_bind_group(number, group)

    def _pipeline(self, slopes: bool, what: str, side: int) -> Any:
        """The pipeline that draws all pixels (""), those at breaks ("breaks"), blocks ("block"), or keeps blocks free
        ("kept_free"); or that casts the rays of "all" pixels, those at breaks ("all breaks"), or of "blocks"."""
        key = slopes, what, side, self._surface, self._computes
        if key not in self._pipelines and what in ("all", "all breaks", "blocks"):
            program = self._program(side, self._surface, what == "all breaks", slopes)
            self._pipelines[key] = program.compute("cast_blocks" if what == "blocks" else "cast_all")
        if key not in self._pipelines:
            entry = "kept_free" if what == "kept_free" else "fragment"
            sloped = "kept_free_with_slope" if what == "kept_free" else "with_slope"
            blocks = what in ("block", "kept_free")
            self._pipelines[key] = self._program(side, self._surface, breaks=what == "breaks").draw(
                [{"format": format} for format in ((MARKS, GIVEN) if slopes else (MARKS,))],
                vertex="block" if blocks else "vertex", fragment=sloped if slopes else entry,
                buffers=[BLOCKS] if blocks else [], depth={**NEARER, "depth_compare": "always"} if blocks else NEARER,
            )  # fmt: skip
        return self._pipelines[key]


class RaySteps:
    """Counts the steps of rays, to estimate their cost; from any thread."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._program = Program(device, "ray_steps", COUNTED=1, SPACING=SPACING, BEAM=BEAM)
        self._beams = Beams(device)
        self._camera = device.buffer(CAMERA.itemsize, "UNIFORM", "camera")
        self._stack = device.buffer(STACK.itemsize, "UNIFORM", "windows")
        self._pipeline: Any = None

    def count(self, windows: CastWindows, camera: NDArray[np.void]) -> NDArray[np.uint32]:
        """For the middle pixel of every cell of ``SPACING`` pixels: twice its ray's steps, plus 1 if it hits ground."""
        width, height = (int(n) for n in camera["size"])
        down, across = -(-height // SPACING), -(-width // SPACING)
        found = self.device.buffer(4 * down * across, "STORAGE|COPY_SRC", "steps")
        write(self.device, self._camera, camera.tobytes())
        write(self.device, self._stack, windows.stack.tobytes())
        if self._pipeline is None:
            self._pipeline = self._program.compute()
        encoder = self.device.handle.create_command_encoder()
        self._beams.encode(encoder, self._camera, self._stack, windows.pool, (width, height))
        starts = self._beams.starts((width, height))
        bound = {"stack": self._stack, "pool": windows.pool, "starts": starts, "found": found}
        pass_ = encoder.begin_compute_pass()
        pass_.set_pipeline(self._pipeline)
        pass_.set_bind_group(0, self._program.bind({"camera": self._camera}))
        pass_.set_bind_group(1, self._program.bind(bound, 1))
        pass_.dispatch_workgroups(-(-across // 8), -(-down // 8))
        pass_.end()
        self.device.queue.submit([encoder.finish()])
        return self.device.read_buffer(found, np.uint32).reshape(down, across)
