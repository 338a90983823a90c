"""The ground by rays: the windows that a method selects, read, brought to the GPU, and cast at from every pixel.

Reading windows and their pyramids takes long, so the thread that selects does it (``Windows.ready``): what is drawn
meanwhile is what was there before, whose outermost window holds the whole terrain, coarsely. Windows that the next
selection has, too, are read once. One pass over all pixels (``shaders/surface_rays.wgsl``) leaves depth and marks.

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
from orograph.gpu.recording import Attachments, write
from orograph.hierarchy.clip_stack import Rectangle
from orograph.lod.selection import RayWindows
from orograph.raycast.mips import Mips, build_mips
from orograph.raycast.select import load
from orograph.raycast.stack import HeightWindow
from orograph.rendering.gpu.pool import NODES, WINDOWS, Pool
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.targets import EMPTY, GIVEN, MARKS, NEARER, Targets
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
    """Casts a ray through every pixel into depth and marks.

    Args:
        camera: the uniform buffer (``camera.CAMERA``).
    """

    def __init__(self, device: Device, camera: Any) -> None:
        self.device = device
        self._program = Program(device, "surface_rays")
        self._camera = self._program.bind({"camera": camera})
        self._stack = device.buffer(STACK.itemsize, "UNIFORM", "windows")
        self._pipelines: dict[bool, Any] = {}
        self._held: tuple[Any, Any] = (None, None)

    def pipeline(self, slopes: bool) -> Any:
        """The pipeline, with or without the slopes of the triangles that rays hit."""
        if slopes not in self._pipelines:
            self._pipelines[slopes] = self._program.draw(
                [{"format": format} for format in ((MARKS, GIVEN) if slopes else (MARKS,))],
                fragment="with_slope" if slopes else "fragment", depth=NEARER,
            )  # fmt: skip
        return self._pipelines[slopes]

    def draw(self, encoder: Any, targets: Targets, selection: CastWindows, left: Left) -> None:
        """Clear the targets and draw; it has no edges, and what lines are of the terrain is what is drawn."""
        if self._held[0] is not selection.pool:
            write(self.device, self._stack, selection.stack.tobytes())
            self._held = selection.pool, self._program.bind({"stack": self._stack, "pool": selection.pool}, 1)
        slopes = bool(left.slopes)
        pass_ = targets.attached(
            "rays with slopes" if slopes else "rays", lambda: self._attachments(targets, slopes)
        ).begin(encoder)
        pass_.set_pipeline(self.pipeline(slopes))
        pass_.set_bind_group(0, self._camera)
        pass_.set_bind_group(1, self._held[1])
        pass_.draw(3)
        pass_.end()

    def _attachments(self, targets: Targets, slopes: bool) -> Attachments:
        """Empty marks and depth, and slopes if they are to be left."""
        views = [targets.marks_view, *([targets.given_view(self.device)] if slopes else [])]
        return Attachments([(view, EMPTY) for view in views], (targets.depth_view, 0.0))
