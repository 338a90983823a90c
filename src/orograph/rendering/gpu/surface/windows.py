"""The windows that rays are cast at, read and brought to the GPU, beside the frames.

Reading windows and their pyramids takes long, so the thread that selects does it (``Windows.ready``): what is drawn
meanwhile is what was there before, whose outermost window holds the whole terrain, coarsely. All windows lie in one
buffer, with room for some more. One stays where it is as long as selections have it; a new one is written where neither
of the last two selections has any, for frames still draw these. Where there is no room, another buffer takes its place,
and what stays is copied on the GPU. So only what is new is read and moved, and in the calls that copy it the
interpreter is free for frames.

Heights take 4 bytes a sample, their pyramids half as many more (``rendering.gpu.pool``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.hierarchy.clip_stack import ClipStack, Rectangle
from orograph.lod.selection import LEVELS_SHARE, RayWindows
from orograph.raycast.mips import build_mips
from orograph.raycast.select import load
from orograph.raycast.stack import check_diagonals
from orograph.rendering.gpu.pool import NODES, WINDOWS, Lying, Table, Values, lay, size_of
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

COARSER = 1.25
"""By how much a tolerance grows until its windows fit."""

WORST = 1e4
"""The tolerance, in pixels, at which it grows no more: around an eye that is closer to the ground than a level's error
no tolerance is large enough, and the finest windows are left out."""

ROOM = 3
"""How many selections like the first one a buffer has room for, if there is so much memory."""

Held = dict[Rectangle, tuple[Lying, int]]
"""Windows, and where in the buffer they begin (numbers)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CastWindows(RayWindows):
    """Windows that are on the GPU.

    Attributes:
        stack: ``STACK``. pool: the buffer of heights and pyramids. held: where in it the windows are; the same object
            as long as they are the same ones, in the same places.
    """

    stack: NDArray[np.void]
    pool: Any
    held: Held


class Windows:
    """Brings windows to the GPU.

    Args:
        most: bytes that there are for them.
    """

    def __init__(self, device: Device, terrain: Terrain, most: int, jobs: int | None = None) -> None:
        self.device, self.terrain, self.jobs = device, terrain, jobs
        self.most = most // 6  # samples: heights, and half of that for pyramids, 4 bytes each
        self._last: CastWindows | None = None
        self._before: CastWindows | None = None
        self._pool: Any = None
        self._room: Values = np.empty(0, np.float32)

    def ready(self, selection: RayWindows, again: Callable[[float], RayWindows]) -> CastWindows:
        """A selection, read and on the GPU; coarser, as its bound says, where memory holds no more.

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
            self._before, last = last, self._made(selection)
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

    def _made(self, selection: RayWindows) -> CastWindows:
        held = self._brought(selection.windows)
        return CastWindows(
            method=selection.method, bound=selection.bound, lacking=selection.lacking, stats=selection.stats,
            windows=selection.windows, surface=selection.surface, at_breaks=selection.at_breaks,
            stack=_stack(Table.of(list(held.values()), self.terrain.grid.shape), selection), pool=self._pool, held=held,
        )  # fmt: skip

    def _brought(self, windows: ClipStack) -> Held:
        """All of these in the buffer; those that the last selection lacks are read."""
        there: Held = {} if self._last is None else self._last.held
        read = load(self.terrain, [where for where in windows if where not in there], self.jobs)
        check_diagonals(read)
        new = {w.where: (w, build_mips(w.heights, 1)) for w in read}
        sizes = {where: size_of(w.heights, mips, minima=True) for where, (w, mips) in new.items()}
        stays = {where: there[where] for where in windows if where in there}
        places = None if self._pool is None else gaps(self._taken(), self._pool.size // 4, list(sizes.values()))
        if places is None:
            stays, places = self._moved(stays, list(sizes.values()))
        for (where, (w, mips)), begin in zip(new.items(), places, strict=True):
            values = self._scratch(sizes[where])
            stays[where] = lay(w, mips, values, minima=True), begin
            self.device.queue.write_buffer(self._pool, 4 * begin, values)
        return {where: stays[where] for where in windows}

    def _taken(self) -> list[tuple[int, int]]:
        """What frames may still be drawn by, of the buffer: where it begins and ends."""
        found = [one for one in (self._last, self._before) if one is not None and one.pool is self._pool]
        return [(at, at + lying.size) for one in found for lying, at in one.held.values()]

    def _moved(self, stays: Held, sizes: Sequence[int]) -> tuple[Held, list[int]]:
        """Have another buffer with what stays; where that is in it, and where new ones of these sizes go."""
        total = sum(lying.size for lying, _ in stays.values()) + sum(sizes)
        room = min(ROOM * total, max(total, 6 * self.most // 4))
        pool = self.device.buffer(4 * room, "STORAGE|COPY_SRC", "heights")
        encoder, at, held = self.device.handle.create_command_encoder(), 0, Held()
        for where, (lying, begin) in stays.items():
            encoder.copy_buffer_to_buffer(self._pool, 4 * begin, pool, 4 * at, 4 * lying.size)
            held[where] = lying, at
            at += lying.size
        if stays:
            self.device.queue.submit([encoder.finish()])
        self._pool = pool
        return held, [at + int(n) for n in np.cumsum([0, *sizes])[:-1]]

    def _scratch(self, size: int) -> Values:
        """So many numbers to fill; memory that was touched before costs nothing."""
        if len(self._room) < size:
            self._room = np.empty(size, np.float32)
        return self._room[:size]


def gaps(taken: Sequence[tuple[int, int]], end: int, sizes: Sequence[int]) -> list[int] | None:
    """Where so many numbers fit between those taken, before the end, the first place for each; None: nowhere."""
    free, at = [], 0
    for begin, after in [*sorted(taken), (end, end)]:
        if begin > at:
            free.append([at, begin])
        at = max(at, after)
    found = []
    for size in sizes:
        gap = next((gap for gap in free if gap[1] - gap[0] >= size), None)
        if gap is None:
            return None
        found.append(gap[0])
        gap[0] += size
    return found


def _allowed(selection: RayWindows) -> NDArray[np.float64]:
    """Pixels (``WINDOWS``,) by which another surface than the exact one may be off in each window: what the error of
    its level leaves of the bound."""
    out = np.zeros(WINDOWS)
    for k, where in enumerate(selection.windows):
        out[k] = (selection.bound or 0.0) * (1.0 if where.level == 0 else 1.0 - LEVELS_SHARE)
    return out


def _stack(table: Table, selection: RayWindows) -> NDArray[np.void]:
    out = np.zeros((), STACK)
    out["low"], out["high"], out["count"], out["whole"] = table.low, table.high, len(table.windows), table.whole
    for k, w in enumerate(table.windows):
        out["windows"][k] = w.first, w.last, w.cells, w.offset, w.stride, w.level, w.node, w.top, 0.0
    out["windows"]["allowed"] = _allowed(selection)
    out["nodes"][: len(table.nodes)] = table.nodes
    return out
