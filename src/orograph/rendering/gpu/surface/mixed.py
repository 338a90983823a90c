"""Patches and rays in one picture: each block of the screen is drawn by one of them (``surface.shares``).

Each way draws its blocks whole and includes all ground there, so no pixel is left out where they
meet: a border only shows the difference of two surfaces that are both within the tolerance. Blocks of rays are first
filled with a depth that keeps patches out; then patches are drawn, except those that lie only over such blocks; then
rays overwrite their blocks.

The thread that selects windows also counts the steps of some rays (``rays.RaySteps``); a frame uses the counts of
the last selection, and its own patches. The costs of a triangle, a pixel, a ray and a step are measured
once per device, by drawing the first such frame a few times (``Mixer.measure``). While rays would save nothing
anywhere, windows are selected only every ``RARELY`` frames. Rays draw nothing while they are coarser than
requested: if memory holds no finer windows, or the present ones are too coarse for the camera.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.recording import write
from orograph.lod.patches.footprints import Screen, footprints
from orograph.lod.selection import PatchesAndRays
from orograph.lod.triangle_patches import Patches
from orograph.raycast.select import rectangles
from orograph.rendering.gpu.camera import camera_of
from orograph.rendering.gpu.surface.left import DEPTH_ONLY, Left
from orograph.rendering.gpu.surface.patches import PatchPass
from orograph.rendering.gpu.surface.rays import SPACING, RayPass, RaySteps
from orograph.rendering.gpu.surface.shares import STATED, Costs, Frame, Labels, Shares, kept, share
from orograph.rendering.gpu.surface.windows import CastWindows, Windows
from orograph.rendering.gpu.targets import Targets, cleared
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

RARELY = 60
"""Frames after which windows are selected again if rays saved nothing."""

WORTH = 0.02
"""Fraction of a frame's cost that rays must be able to save for windows to be selected in every frame."""

ROUNDS, TIMES = 4, 8
"""How often each draw is timed (the fastest counts), and how many times a timed submission repeats it on hardware,
where one draw would take hardly longer than an empty submission."""

MOVED = 0.01
"""Fraction of the distance to its target by which a camera may move or turn before blocks are decided anew."""

SMALL = 4
"""Factor by which the picture is reduced to measure the cost of triangles alone."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MixableWindows(PatchesAndRays):
    """Windows on the GPU, and the cost of rays at them.

    Attributes:
        rays: the windows. steps: ``RaySteps.count`` for the camera's view.
    """

    rays: CastWindows
    steps: NDArray[np.uint32]


@dataclass(frozen=True, slots=True, eq=False)
class Cast:
    """Where rays are cast: the same object as long as windows and blocks stay the same.

    Attributes:
        windows: the windows. by_rays: the blocks, of ``side`` pixels.
    """

    windows: CastWindows
    by_rays: Labels
    side: int


@dataclass(frozen=True, slots=True, eq=False)
class Mixed:
    """What a frame draws.

    Attributes:
        instances: patches to draw. cast: where rays are cast.
    """

    instances: NDArray[Any]
    cast: Cast

    @property
    def rays(self) -> Cast | None:
        """Where rays are cast; None: nowhere."""
        return self.cast if self.cast.by_rays.any() else None


class _Decided(NamedTuple):
    """Who draws which blocks, the inputs (``key``), windows and view of this decision, and its reasons."""

    key: Any
    windows: MixableWindows
    view: View
    cast: Cast
    shares: Shares | None


class Mixing:
    """Prepares selections of patches and rays for mixing; may be called from any thread."""

    def __init__(self, device: Device, terrain: Terrain, windows: Windows) -> None:
        self.terrain, self.windows = terrain, windows
        self._steps = RaySteps(device)

    def ready(self, selection: PatchesAndRays, again: Callable[[float], PatchesAndRays]) -> MixableWindows:
        """See ``Windows.ready``."""
        rays = self.windows.ready(selection, again)
        camera = selection.camera
        steps = self._steps.count(rays, camera_of(camera.view, self.terrain, camera.exaggeration))
        return MixableWindows(
            method=selection.method, bound=rays.bound, lacking=rays.lacking, stats=rays.stats, windows=rays.windows,
            camera=camera, block=selection.block, shares=selection.shares, hysteresis=selection.hysteresis,
            select_patches=selection.select_patches, rays=rays, steps=steps,
        )  # fmt: skip


class MixedPass:
    """Draws patches and rays into depth and marks.

    Args:
        patches, rays: the passes for either.
    """

    def __init__(self, device: Device, patches: PatchPass, rays: RayPass) -> None:
        self.device, self.patches, self.rays = device, patches, rays

    def draw(self, encoder: Any, targets: Targets, selection: Mixed, left: Left) -> None:
        """Clear the targets and draw."""
        cast, slopes = selection.cast, bool(left.slopes)
        if cast.by_rays.all():
            self.rays.draw(encoder, targets, cast.windows, left)
            return
        side = cast.side
        self.patches.bring(selection.instances)
        blocks = self.rays.bring_blocks(cast.by_rays)
        if blocks:
            self.rays.bring(encoder, targets, cast.windows)
            self.rays.compute_blocks(encoder, blocks, side, slopes)
        pass_ = cleared(targets, self.device, slopes).begin(encoder)
        if blocks:
            self.rays.keep_free(pass_, blocks, side, slopes)
        self.patches.record(pass_, len(selection.instances), left)
        if blocks:
            self.rays.cast_blocks(pass_, blocks, side, slopes)
        pass_.end()


class Mixer:
    """Decides who draws what.

    Args:
        camera: the uniform buffer (``camera.CAMERA``). legs: segments along a patch's leg.
    """

    def __init__(self, device: Device, terrain: Terrain, camera: Any, legs: int, draws: MixedPass) -> None:
        self.device, self.terrain, self.legs, self.draws = device, terrain, legs, draws
        self._camera = camera
        self._last: _Decided | None = None
        self._drawn: tuple[View, int, Mixed, Patches] | None = None  # (patches: so that nothing else has their id)
        self._idle = 0

    def forget(self) -> None:
        """Another method draws."""
        self._last, self._drawn, self._idle = None, None, 0

    def look(self) -> bool:
        """Whether to select windows for another frame."""
        found = None if self._last is None else self._last.shares
        if found is None:
            self._idle = 0
            return True
        self._idle = 0 if found.gain > WORTH * found.patches or found.by_rays.any() else (self._idle + 1) % RARELY
        return self._idle == 0

    def mixed(
        self, patches: Patches, windows: MixableWindows, view: View, exaggeration: float, tolerance: float, *,
        wait: bool,
    ) -> Mixed:  # fmt: skip
        """Decide what a frame draws.

        Args:
            patches: in view. tolerance: of rays, pixels. wait: for a picture: decide anew, by ``STATED`` costs.
        """
        last = self._last
        key = exaggeration, tolerance, view.width, view.height, windows.block, wait
        holds = last is not None and last.key == key and not wait
        if last is not None and holds and (self._idle or _hardly_moved(last, view, windows)):
            if not last.cast.by_rays.any():
                return Mixed(patches.instances, last.cast)
            if last.cast.by_rays.all():
                return Mixed(patches.instances[:0], last.cast)
            before = self._drawn
            if before is not None and before[:2] == (view, id(patches)) and before[2].cast is last.cast:
                return before[2]
        screen = Screen.of(view, self.terrain.grid, exaggeration, windows.block)
        rows, cols = self.terrain.grid.shape
        boxes = footprints(patches.instances, patches.spans, self.legs, (rows - 1, cols - 1), screen)
        if last is None or not holds or not _hardly_moved(last, view, windows):
            last = self._decided(patches, boxes, windows, view, exaggeration, tolerance, screen, wait=wait)
            if self._last is not None and _same(self._last.cast, last.cast):
                last = last._replace(cast=self._last.cast)
            self._last = last._replace(key=key)
        cast = last.cast
        some = patches.instances[kept(boxes, cast.by_rays)] if cast.by_rays.any() else patches.instances
        drawn = Mixed(some, cast)
        self._drawn = view, id(patches), drawn, patches
        return drawn

    def _decided(
        self, patches: Patches, boxes: NDArray[np.int64], windows: MixableWindows, view: View, exaggeration: float,
        tolerance: float, screen: Screen, *, wait: bool,
    ) -> _Decided:  # fmt: skip
        """Decide who draws which blocks, with reasons."""
        by_rays, shares = np.zeros(screen.shape, bool), None
        if not self._fine(windows, view, exaggeration, tolerance):
            pass
        elif windows.shares == "turns":
            by_rays = np.add.outer(np.arange(screen.shape[0]), np.arange(screen.shape[1])) % 2 == 1
        else:
            left, top = (int(n) // SPACING for n in view.frame[:2])
            frame = _frame(boxes, self.legs**2, screen, windows.steps[top:, left:])
            costs = STATED if wait else self._measured(patches, windows.rays, frame, screen, view, exaggeration)
            last = None if wait or self._last is None else self._last.cast.by_rays
            before = last if last is not None and last.shape == screen.shape else None
            shares = share(frame, costs, windows.hysteresis, before)
            by_rays = shares.by_rays
        return _Decided((), windows, view, Cast(windows.rays, by_rays, windows.block), shares)

    def _fine(self, windows: MixableWindows, view: View, exaggeration: float, tolerance: float) -> bool:
        """Whether rays are within the tolerance: their windows contain those that this camera needs."""
        if windows.bound is None or windows.bound > tolerance * (1 + 1e-9):
            return False
        if windows.camera.view == view.whole and windows.camera.exaggeration == exaggeration:
            return True
        by = "spacing" if view.projection == "plan" else "error"
        wanted = rectangles(self.terrain, view.whole, exaggeration, tolerance, by=by)
        held = {one.level: one for one in windows.windows}
        return all(
            one.level in held and held[one.level].row0 <= one.row0 and held[one.level].row1 >= one.row1
            and held[one.level].col0 <= one.col0 and held[one.level].col1 >= one.col1
            for one in wanted
        )  # fmt: skip

    def _measured(
        self, patches: Patches, rays: CastWindows, frame: Frame, screen: Screen, view: View, exaggeration: float
    ) -> Costs:  # fmt: skip
        """The device's costs; measured by this frame if they are unknown."""
        known = _COSTS.get(id(self.device.handle))
        if known is not None:
            return known
        if not len(patches.instances) or not frame.steps.any():
            return STATED
        write(self.device, self._camera, camera_of(view, self.terrain, exaggeration))
        found = self.measure(patches, rays, frame, screen, (view.width, view.height))
        _COSTS[id(self.device.handle)] = found
        return found

    def measure(
        self, patches: Patches, rays: CastWindows, frame: Frame, screen: Screen, size: tuple[int, int]
    ) -> Costs:  # fmt: skip
        """Measure the costs, ns, by drawing the frame a few times.

        Patches are drawn in the whole picture, and in one that is ``SMALL`` times smaller, where the pixels are few.
        Rays are cast in a single block, in the blocks in which they take few steps, and in the others: on software in a
        third of these, which takes time enough. Then rays draw alone, which says what they cost besides, and every
        second block, which says what both ways cost besides.
        """
        numbers = np.add.outer(*(np.arange(n) for n in screen.shape))
        none, turns, single = numbers < 0, numbers % 2 == 1, numbers == numbers.max()
        many = frame.steps > np.median(frame.steps / frame.pixels) * frame.pixels
        some = numbers % (3 if self.device.adapter.software else 1) == 0
        halves = [half for half in (many & some, ~many & some) if half.any()]
        small = max(1, size[0] // SMALL), max(1, size[1] // SMALL)
        triangles, ground = len(patches.instances) * self.legs**2, float(frame.ground.sum())
        least = ground * small[0] * small[1] / (size[0] * size[1])

        def drawing(by_rays: Labels, count: int = 0) -> Mixed:
            return Mixed(patches.instances[:count], Cast(rays, by_rays, screen.side))

        def amounts(by_rays: Labels) -> tuple[float, float]:
            return float(frame.ground[by_rays].sum()), float(frame.steps[by_rays].sum())

        every = len(patches.instances)
        by_rays = [(drawing(labels), size) for labels in (~none, single, *halves)]
        by_patches = [(drawing(none, every), size), (drawing(none, every), small), (drawing(turns, every), size)]
        *took, idle = self._seconds([*by_patches, *by_rays, (drawing(none), small)])
        whole, tiny, both, alone, first, *parts = (max(seconds - idle, 0.1 * seconds) for seconds in took)
        triangle, pixel = _solved([(triangles, ground), (triangles, least)], [whole, tiny], STATED[:2])
        each = [max(seconds - first, 0.1 * seconds) for seconds in parts]
        ray, step = _solved([amounts(half) for half in halves], each, STATED[2:4])
        factor = min(1.0, 1e9 * alone / max(float(np.dot(amounts(~none), (ray, step))), 1.0))
        ray, step = factor * ray, factor * step
        begin = max(0.0, 1e9 * alone - float(np.dot(amounts(~none), (ray, step))))
        known = triangle * triangles + pixel * float(frame.ground[~turns].sum()) + begin
        besides = 1e9 * both - known - float(np.dot(amounts(turns), (ray, step)))
        return Costs(triangle, pixel, ray, step, begin, max(0.0, besides))

    def _seconds(self, draws: Sequence[tuple[Mixed, tuple[int, int]]]) -> list[float]:
        """The least that each of some draws takes once it is recorded; in turns, so that other programs hold up all.

        On software renderers this is processor time, if that is less: the clock also counts the work of others.
        """
        software = self.device.adapter.software
        times, rounds = (1, 2) if software else (TIMES, ROUNDS)
        took: list[list[float]] = [[] for _ in draws]
        targets = {size: Targets(self.device, *size) for _, size in draws}
        for _ in range(1 + rounds):
            for (what, size), found in zip(draws, took, strict=True):
                encoder = self.device.handle.create_command_encoder()
                for _ in range(times):
                    self.draws.draw(encoder, targets[size], what, DEPTH_ONLY)
                recorded = encoder.finish()
                self.device.wait()
                begun, worked = time.perf_counter(), time.process_time()
                self.device.queue.submit([recorded])
                self.device.wait()
                seconds = time.perf_counter() - begun
                found.append(min(seconds, time.process_time() - worked) if software else seconds / times)
        return [min(found[1:]) for found in took]  # (the first ones compile)


def _hardly_moved(last: _Decided, view: View, windows: MixableWindows) -> bool:
    """Whether the last decision still holds: other windows or another place need a new one."""
    if last.view == view:
        return last.windows is windows
    if last.windows.rays.held is not windows.rays.held or last.view.projection != view.projection:
        return False
    ways = np.subtract([last.view.target, view.target], [last.view.eye, view.eye])
    far = float(np.linalg.norm(ways, axis=1).min())
    moved = float(np.abs(np.subtract([last.view.target, last.view.eye], [view.target, view.eye])).max())
    return last.view.fov_y == view.fov_y and moved < MOVED * far


def _same(one: Cast, other: Cast) -> bool:
    alike = one.windows.held is other.windows.held and one.side == other.side
    return alike and np.array_equal(one.by_rays, other.by_rays)


_COSTS: dict[int, Costs] = {}
"""By device."""


def _frame(boxes: NDArray[np.int64], triangles: int, screen: Screen, counted: NDArray[np.uint32]) -> Frame:
    """What there is to draw, estimated from the steps of some rays."""
    down, across = screen.shape
    per = screen.side // SPACING
    here = np.zeros((2, down * per, across * per))
    rows, cols = (min(a, b) for a, b in zip(counted.shape, here.shape[1:], strict=True))
    here[:, :rows, :cols] = counted[:rows, :cols] >> 1, counted[:rows, :cols] & 1
    there = np.zeros(here.shape[1:])
    there[:rows, :cols] = 1
    sums = [a.reshape(down, per, across, per).sum((1, 3)) for a in (here[0], here[1], there)]
    steps, ground = (a / np.maximum(sums[2], 1) * screen.pixels for a in sums[:2])
    return Frame(boxes, triangles, screen.pixels, ground, steps)


def _solved(
    amounts: Sequence[tuple[float, float]], seconds: Sequence[float], stated: tuple[float, float]
) -> tuple[float, float]:
    """Solve for the cost of each of two kinds, ns, from two measurements; in the stated ratio if the result makes no
    sense."""
    a, b = np.asarray(amounts, np.float64), np.asarray(seconds) * 1e9
    if len(a) == 2 and abs(np.linalg.det(a)) > 1e-6 * np.abs(a).prod(1).sum():
        first, second = np.linalg.solve(a, b)
        if first > 0 and second > 0:
            return float(first), float(second)
    factor = b.sum() / max(float((a @ stated).sum()), 1.0)
    return float(stated[0] * factor), float(stated[1] * factor)
