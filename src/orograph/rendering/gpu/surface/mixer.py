"""Who draws which blocks of the screen: patches or rays (``surface.mixed``).

A frame uses the steps of rays of the last selection of windows, and its own patches. The costs of a triangle, a pixel,
a ray and a step are measured once per device, by drawing the first such frame a few times (``Mixer.measure``). While
rays would save nothing anywhere, windows are selected only every ``RARELY`` frames. Rays draw nothing while they are
coarser than requested: if memory holds no finer windows, or the present ones are too coarse for the camera.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.gpu.device import Device
from orograph.gpu.recording import write
from orograph.lod.patches.footprints import Screen, footprints
from orograph.lod.triangle_patches import Patches
from orograph.raycast.select import rectangles
from orograph.rendering.gpu.camera import camera_of
from orograph.rendering.gpu.surface.left import DEPTH_ONLY
from orograph.rendering.gpu.surface.mixed import Cast, MixableWindows, Mixed, MixedPass
from orograph.rendering.gpu.surface.rays import SPACING
from orograph.rendering.gpu.surface.shares import STATED, Array, Costs, Frame, Labels, Shares, kept, share
from orograph.rendering.gpu.surface.windows import CastWindows
from orograph.rendering.gpu.targets import Targets
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

RARELY = 60
"""Frames after which windows are selected again if rays saved nothing."""

WORTH = 0.02
"""Fraction of a frame's cost that rays must be able to save for windows to be selected in every frame."""

ROUNDS, TIMES = 4, 8
"""How often each draw is timed (the fastest counts), and how many times a timed submission repeats it on hardware,
where one draw would take hardly longer than an empty submission."""

SOME = 1 << 19
"""Triangles that are drawn on software to measure what they cost, at most: of more patches, every so many-th."""

MOVED = 0.01
"""Fraction of the distance to its target by which a camera may move or turn before windows are checked again, …"""

FAR = 0.04
"""… and before blocks are decided anew."""

SMALL = 4
"""Factor by which the picture is reduced to measure what rays cost whatever their number."""


_Seen = tuple[View, float, int]
"""A view, its exaggeration, and pixels along a block."""


class _Decided(NamedTuple):
    """Who draws which blocks.

    Attributes:
        key, view: of the frame that decided it. cast, shares: the decision and its reasons.
        windows, checked: the windows and the view that were checked last. fine: whether those were fine enough.
    """

    key: Any
    view: View
    cast: Cast
    shares: Shares | None
    windows: MixableWindows
    checked: View
    fine: bool


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
        self._screen: tuple[_Seen | None, Screen | None] = None, None
        self._seen: tuple[Patches | None, Screen | None, NDArray[np.int64]] = None, None, np.empty((0, 4), np.int64)
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
        key = exaggeration, tolerance, view.width, view.height, windows.block, wait
        last = None if wait or self._last is None or self._last.key != key else self._last
        checked = last is not None and (self._idle or _within(MOVED, last.windows, last.checked, windows, view))
        if last is not None and checked and self._drawn is not None:
            *drawn, before, _ = self._drawn
            if drawn == [view, id(patches)] and before.cast is last.cast:
                return before
        seen = view, exaggeration, windows.block
        if last is None or not checked:
            fine = self._fine(windows, view, exaggeration, tolerance)
            if last is not None and last.fine == fine and _within(FAR, last.windows, last.view, windows, view):
                last = last._replace(windows=windows, checked=view)
            else:
                by_rays, shares = self._decided(patches, windows, seen, last, fine, wait=wait)
                cast = Cast(windows.rays, by_rays, windows.block)
                if self._last is not None and _same(self._last.cast, cast):
                    cast = self._last.cast
                last = _Decided(key, view, cast, shares, windows, view, fine)
            self._last = last
        found = Mixed(self._left(patches, last.cast.by_rays, seen), last.cast)
        self._drawn = view, id(patches), found, patches
        return found

    def _left(self, patches: Patches, by_rays: Labels, seen: _Seen) -> NDArray[Any]:
        """The patches that lie over blocks that rays do not draw."""
        if by_rays.all():
            return patches.instances[:0]
        if not by_rays.any():
            return patches.instances
        return patches.instances[kept(self._boxes(patches, self._screen_of(seen)), by_rays)]

    def _screen_of(self, seen: _Seen) -> Screen:
        """The picture in blocks; the same object as long as the view stays."""
        found = self._screen[1] if self._screen[0] == seen else None
        if found is None:
            view, exaggeration, side = seen
            found = Screen.of(view, self.terrain.grid, exaggeration, side)
            self._screen = seen, found
        return found

    def _boxes(self, patches: Patches, screen: Screen) -> NDArray[np.int64]:
        """The blocks under the patches of a frame."""
        if self._seen[0] is not patches or self._seen[1] is not screen:
            rows, cols = self.terrain.grid.shape
            found = footprints(patches.instances, patches.spans, self.legs, (rows - 1, cols - 1), screen)
            self._seen = patches, screen, found
        return self._seen[2]

    def _decided(
        self, patches: Patches, windows: MixableWindows, seen: _Seen, last: _Decided | None, fine: bool, *, wait: bool
    ) -> tuple[Labels, Shares | None]:
        """Decide which blocks rays draw, with reasons."""
        (view, exaggeration, _), screen = seen, self._screen_of(seen)
        if not fine:
            return np.zeros(screen.shape, bool), None
        if windows.shares == "turns":
            return np.add.outer(np.arange(screen.shape[0]), np.arange(screen.shape[1])) % 2 == 1, None
        left, top = (int(n) // SPACING for n in view.frame[:2])
        frame = _frame(self._boxes(patches, screen), self.legs**2, screen, windows.steps[top:, left:])
        costs = STATED if wait else self._measured(patches, windows.rays, frame, screen, view, exaggeration)
        shares = share(frame, costs, windows.hysteresis, None if last is None else last.cast.by_rays)
        return shares.by_rays, shares

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
        found = self.measure(patches, rays, frame, screen, view, exaggeration)
        _COSTS[id(self.device.handle)] = found
        return found

    def measure(
        self, patches: Patches, rays: CastWindows, frame: Frame, screen: Screen, view: View, exaggeration: float
    ) -> Costs:  # fmt: skip
        """Measure the costs, ns, by drawing the frame a few times.

        Patches are drawn once, and twice, where the second ones are hidden and cost their triangles only. (In a small
        picture triangles without pixels cost less.) On software, where triangles take long, these are some of the
        patches, spread over the picture. Rays are cast in the whole picture and in one that is ``SMALL``
        times smaller, which takes what precedes them, and the longest of them, all the same. Blocks in which they take
        many steps, and the others, tell rays from steps: on software a third of these, which takes time enough. Every
        second block by rays says what both ways cost besides. What a picture of nothing takes does not count.
        """
        numbers = np.add.outer(*(np.arange(n) for n in screen.shape))
        none, turns = numbers < 0, numbers % 2 == 1
        many = frame.steps > np.median(frame.steps / frame.pixels) * frame.pixels
        some = numbers % (3 if self.device.adapter.software else 1) == 0
        halves = many & some, ~many & some
        size = view.width, view.height
        small = max(1, size[0] // SMALL), max(1, size[1] // SMALL)
        cameras = {
            small: camera_of(view.resized(*small), self.terrain, exaggeration),
            size: camera_of(view, self.terrain, exaggeration),
        }
        apart = -(-len(patches.instances) * self.legs**2 // SOME) if self.device.adapter.software else 1
        sample = np.ascontiguousarray(patches.instances[::apart])
        twice = np.concatenate([sample, sample])

        def drawing(by_rays: Labels, instances: NDArray[Any] = patches.instances[:0]) -> Mixed:
            return Mixed(instances, Cast(rays, by_rays, screen.side))

        def amounts(by_rays: Labels) -> Array:
            return np.array([frame.ground[by_rays].sum(), frame.steps[by_rays].sum()])

        by_patches = [drawing(none), drawing(none, sample), drawing(none, twice), drawing(turns, sample)]
        by_rays = [drawing(~none), *(drawing(half) for half in halves)]
        draws = [*((draw, size) for draw in (*by_patches, *by_rays)), (drawing(none), small), (drawing(~none), small)]
        took = 1e9 * np.array(self._seconds(draws, cameras))
        idle, once, again, both, alone, long, short, least, tiny = took
        ground = frame.ground * len(sample) / len(patches.instances)
        triangles = len(sample) * self.legs**2
        triangle = max(again - once, 0.05 * once) / triangles
        pixel = max(once - idle - triangle * triangles, 0.05 * once) / max(float(ground.sum()), 1.0)
        fewer = 1.0 - small[0] * small[1] / (size[0] * size[1])
        all_rays = max((alone - idle - (tiny - least)) / (fewer or 1.0), 0.05 * alone)
        more = amounts(halves[0]) - amounts(halves[1])
        ray, step = _costs_of_rays(np.stack([amounts(~none), more]), all_rays, long - short)
        begin = max(0.0, alone - idle - all_rays)
        known = triangle * triangles + pixel * float(ground[~turns].sum()) + begin
        besides = both - idle - known - float(amounts(turns) @ (ray, step))
        return Costs(triangle, pixel, ray, step, begin, max(0.0, besides))

    def _seconds(
        self, draws: Sequence[tuple[Mixed, tuple[int, int]]], cameras: Mapping[tuple[int, int], NDArray[np.void]]
    ) -> list[float]:  # fmt: skip
        """The least that each of some draws takes once it is recorded; in turns, so that other programs hold up all.

        On software renderers this is processor time, if that is less: the clock also counts the work of others.
        """
        software = self.device.adapter.software
        times, rounds = (1, 3) if software else (TIMES, ROUNDS)
        took: list[list[float]] = [[] for _ in draws]
        targets = {size: Targets(self.device, *size) for size in cameras}
        for _ in range(1 + rounds):
            for (what, size), found in zip(draws, took, strict=True):
                write(self.device, self._camera, cameras[size])
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


def _within(part: float, before: MixableWindows, then: View, windows: MixableWindows, view: View) -> bool:
    """Whether windows stay the same, and the camera moved or turned by no more than a part of its distance."""
    if then == view:
        return before is windows
    if before.rays.held is not windows.rays.held or then.projection != view.projection:
        return False
    ways = np.subtract([then.target, view.target], [then.eye, view.eye])
    far = float(np.linalg.norm(ways, axis=1).min())
    moved = float(np.abs(np.subtract([then.target, then.eye], [view.target, view.eye])).max())
    return then.fov_y == view.fov_y and moved < part * far


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


def _costs_of_rays(amounts: Array, whole: float, more: float) -> tuple[float, float]:
    """The cost of a ray and of a step, ns, from what all take and what one half takes more than the other.

    Args:
        amounts: (2, 2), rays that meet ground and steps: of all, and how many more the one half has.
            whole, more: ns. If no positive costs explain both, their ratio is the stated one.
    """
    if abs(np.linalg.det(amounts)) > 1e-6 * np.abs(amounts).prod(1).sum():
        ray, step = np.linalg.solve(amounts, [whole, more])
        if ray > 0 and step > 0:
            return float(ray), float(step)
    factor = whole / max(float(amounts[0] @ STATED[2:4]), 1.0)
    return STATED.ray * factor, STATED.step * factor
