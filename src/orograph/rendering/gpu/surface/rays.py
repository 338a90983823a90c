"""The ground by rays, cast from every pixel at windows that are on the GPU (``surface.windows``).

A coarse pass finds where the rays of 16 × 16 pixels come near to the ground (``Beams``), and one over all pixels
(``shaders/surface_rays.wgsl``) leaves depth and marks; or rays are cast through those of some blocks of the screen. A
pass of its own counts the steps that they take (``RaySteps``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.program import Program
from orograph.gpu.read_aside import read_aside
from orograph.gpu.recording import begin_compute, write
from orograph.lod.selection import RaySurface
from orograph.rendering.gpu.camera import CAMERA
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.surface.windows import STACK, CastWindows
from orograph.rendering.gpu.targets import GIVEN, MARKS, NEARER, Targets, cleared

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

    def compile(self) -> None:
        """Compile the pipeline, if that is not done; from any thread."""
        if self._pipeline is None:
            self._pipeline = self._program.compute()

    def encode(self, encoder: Any, camera: Any, stack: Any, pool: Any, size: tuple[int, int]) -> None:
        """Find the depths for the camera and the windows in those buffers."""
        starts = self.starts(size)
        self.compile()
        if self._held[0] is not pool or self._held[1] is not starts:
            seen = self._program.bind({"camera": camera})
            self._held = pool, starts, (
                seen, self._program.bind({"stack": stack, "pool": pool, "starts": starts}, 1)
            )  # fmt: skip
        pass_ = begin_compute(encoder)
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
        pass_ = begin_compute(encoder)
        pass_.set_pipeline(self._pipelines[plan])
        pass_.set_bind_group(0, program.bind(bound))
        pass_.dispatch_workgroups(*(-(-n // 8) for n in size))
        pass_.end()


Key = tuple[bool, str, int, RaySurface, bool]
"""Of a pipeline: whether it leaves slopes, what it draws, pixels along a block, and whether compute shaders cast."""


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
        self._pipelines: dict[Key, Any] = {}
        self._held: tuple[list[Any], Any] = ([], None)
        self._groups: tuple[Any, Any] = (None, None)
        self._surface: RaySurface = "exact"
        self._hits: tuple[tuple[int, int], Any] = ((0, 0), None)
        self._blocks: tuple[bytes, Any] = (b"", device.buffer(8, "VERTEX|STORAGE", "blocks"))

    def _program(
        self, side: int, surface: RaySurface, computes: bool, breaks: bool = False, slopes: bool = False
    ) -> Program:  # fmt: skip
        return Program(
            self.device, "surface_rays", SIDE=side, BEAM=BEAM, BILINEAR=int(surface == "bilinear"),
            CONSTANT=int(surface == "constant"), BREAKS=int(breaks), SLOPED=int(slopes), COMPUTED=int(computes),
        )  # fmt: skip

    def compile(self, surface: RaySurface, slopes: bool, side: int | None = None) -> None:
        """Compile the pipelines that cast all rays, so that the first frame need not; from any thread.

        Args:
            side: also those that cast the rays of blocks so many pixels large.
        """
        self._beams.compile()
        computes = self.device.computes
        ways = [("", BLOCK), ("all", BLOCK)] if computes else [("", BLOCK)]
        if side is not None:
            ways += [(what, side) for what in ("kept_free", "block", *(("blocks",) if computes else ()))]
        for what, size in ways:
            self._compiled((slopes, what, size, surface, computes))

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
            program = self._program(BLOCK, "exact", self._computes)
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
        pass_ = begin_compute(encoder)
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
        pass_.set_pipeline(self._compiled((slopes, what, side, self._surface, self._computes)))
        for number, group in enumerate(self._groups):
            pass_.set_bind_group(number, group)

    def _compiled(self, key: Key) -> Any:
        """The pipeline that draws all pixels (""), those at breaks ("breaks"), blocks ("block"), or keeps blocks free
        ("kept_free"); or that casts the rays of "all" pixels, those at breaks ("all breaks"), or of "blocks"."""
        slopes, what, side, surface, computes = key
        if key not in self._pipelines and what in ("all", "all breaks", "blocks"):
            program = self._program(side, surface, computes, what == "all breaks", slopes)
            self._pipelines[key] = program.compute("cast_blocks" if what == "blocks" else "cast_all")
        if key not in self._pipelines:
            entry = "kept_free" if what == "kept_free" else "fragment"
            sloped = "kept_free_with_slope" if what == "kept_free" else "with_slope"
            blocks = what in ("block", "kept_free")
            self._pipelines[key] = self._program(side, surface, computes, breaks=what == "breaks").draw(
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
        pass_ = begin_compute(encoder)
        pass_.set_pipeline(self._pipeline)
        pass_.set_bind_group(0, self._program.bind({"camera": self._camera}))
        pass_.set_bind_group(1, self._program.bind(bound, 1))
        pass_.dispatch_workgroups(-(-across // 8), -(-down // 8))
        pass_.end()
        self.device.queue.submit([encoder.finish()])
        return read_aside(self.device, found, np.uint32).reshape(down, across)
