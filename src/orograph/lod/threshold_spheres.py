"""Threshold spheres: decisions by the camera's position are repeated only when it may have crossed a boundary.

Blow, *Terrain Rendering at High Levels of Detail* (GDC 2000). With an isotropic error the tolerance is a distance:
around each diamond lies a sphere, and the diamond is split while the eye is inside. The spheres nest, so the meshes are
conforming, and an eye that has come s metres since a sphere was looked at cannot have crossed a boundary farther away
than that. Each triangle on the front therefore waits for a length of way: its distance to the boundary.

*Anisotropic* (default). The set of eyes from which a diamond must be split is no sphere: a height seen from above
hardly shows, and what is out of view does not count. It depends on the axis of view, too. So a triangle waits for two
numbers, a way of the eye and a turn of the axis, such that no motion within both can cross the boundary
(``stays``). The mesh is that of ``soar`` and ``stateless`` for the same tolerance, to the triangle.

*Isotropic.* A sample in view at distance d has depth w ≥ d·cos θ, θ being the angle between the axis of view and the
picture's corner. A vertical displacement of up to e moves it by at most f·e·d / (w·(w − e)) pixels (``error.screen``;
the numerator is the length of a cross product), so by at most τ if

    d ≥ λ·e,    λ = f / (τ·cos²θ) + 1 / cos θ,

and for all samples under diamond i, which its nested sphere of radius r_i holds, if the eye is R_i = λ·e_i + r_i from
its vertex. Errors are monotonic and spheres nested: R_i ≥ |p_i − p_j| + R_j for each child j, for every λ and without a
pass over the terrain; Blow closes λ·e_i bottom-up for one λ instead (docs/methods/threshold-spheres.md compares).
10⁻⁹ of the terrain's size per level makes the nesting strict, so that roundings cannot undo it. ``isotropic-published``
has λ = f / τ. A diamond whose colours are off by more than γ is also split while its sphere can look larger than a
pixel. Turning the head changes nothing; mixed diamonds (e = ∞) are split when they come into view, and in a plan so are
those whose colours count; what is out of view stays refined and is skipped when triangles are put out.

*Waiting.* The front is kept as two binary trees of triangles. A leaf waits to be split, a node with two leaves below it
to be merged; radix heaps of ways and of turns (``radix_heap``) say when.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import ANISOTROPIC
from orograph.lod.budget import COARSEST, FINEST, GROWTH, LEAP, PART, by_tolerance
from orograph.lod.criterion import NOTHING, Criterion
from orograph.lod.field import Field
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.pace import EASE, Deadline, Pace
from orograph.lod.radix_heap import AFTER, BEFORE, LISTS, WHERE, WORK, advance
from orograph.lod.right_triangles import Mesh, MeshOptions, RightTriangleMeshes
from orograph.lod.threshold_spheres_pass import put_out, update
from orograph.lod.threshold_spheres_trees import (
    DONE,
    FREE,
    GROW,
    LEVEL,
    MERGES,
    MISSED,
    NOW,
    NUMBERS,
    RADIANS,
    STEPS,
    TOP,
    VISITS,
    Frame,
    Lists,
    Nodes,
)
from orograph.viewpoint import Camera

NO_LIMIT = 1 << 62
"""Steps of an update that runs to completion."""

USED = 0.8, 0.99
"""The tolerance stays while frames take a share of their time between these."""

ROOM = 1.5
"""Room for nodes in new trees, as a multiple of the expected number."""

FINER = 4.0
"""The largest factor by which new trees are finer: small meshes say little about large ones."""

SPARE = 0.15
"""The least share of a frame's time that trees of another tolerance get while they grow."""


def _corner(camera: Camera) -> float:
    """Cosine of the angle between the axis of view and the picture's corner."""
    view = camera.view
    return 1.0 / math.hypot(1.0, *(view.pixel_slope * pixels / 2 for pixels in view.frame[2:]))


class _State:
    """The trees, and what waits, for one tolerance.

    Attributes:
        boundaries: what the boundaries of all diamonds depend on. tolerance: pixels.
        towards: the camera of an update that has paused.
    """

    def __init__(self, field: Field, boundaries: tuple[Any, ...], tolerance: float, capacity: int = 1 << 12) -> None:
        n = field.n
        self.boundaries, self.tolerance = boundaries, tolerance
        self.towards: Camera | None = None
        # (Zeros take no memory before they are written to.)
        self.corners, self.heights = np.zeros((capacity, 3), np.int64), np.zeros((capacity, 4), np.float32)
        self.numbers, self.due = np.zeros((capacity, NUMBERS)), np.zeros((capacity, 2), np.int64)
        self.shown, self.links = np.zeros(capacity, np.uint8), np.zeros((capacity, 6), np.int32)
        self.turning = np.zeros((capacity, 3), np.int32)
        self.numbers[:2], self.links[:2], self.turning[:2] = np.nan, -1, -1
        self.free = np.arange(capacity - 2, -1, -2, dtype=np.int32)
        self.heads, self.turns = np.full(LISTS, -1, np.int32), np.full(LISTS, -1, np.int32)
        self.stack, self.counts = np.zeros(4 * n + 8, np.int32), np.zeros(8, np.int64)
        self.counts[FREE] = len(self.free) - 1  # the pair (0, 1) is the roots
        size = 1 << n
        nw, ne, sw, se = 0, size, size << 32, size << 32 | size
        z = field.corners
        self.corners[:2] = (nw, se, ne), (se, nw, sw)
        self.heights[:2, :3] = (z[0, 0], z[1, 1], z[0, 1]), (z[1, 1], z[0, 0], z[1, 0])
        self.links[:2, LEVEL] = 0
        self.links[0, AFTER], self.links[1, BEFORE], self.links[:2, WHERE] = 1, 0, WORK
        self.heads[WORK] = 0
        self.way = self.turn = 0.0
        self.eye: NDArray[np.float64] | None = None
        self.axes: NDArray[np.float64] | None = None

    @property
    def used(self) -> int:
        """Places in use."""
        return len(self.due) - 2 * int(self.counts[FREE])

    @property
    def nodes(self) -> Nodes:
        """The trees as kernels see them."""
        return Nodes(
            self.corners, self.heights, self.numbers, self.due, self.shown, self.links, self.turning, self.free
        )

    def grow(self) -> None:
        """Twice the room."""
        more = len(self.due)
        self.corners, self.heights, self.numbers, self.due, self.shown, self.links, self.turning = (
            np.concatenate([a, np.zeros_like(a)]) for a in self.nodes[:-1]
        )
        count = int(self.counts[FREE])
        self.free = np.concatenate([self.free[:count], np.arange(2 * more - 2, more - 2, -2, dtype=np.int32)])
        self.free = np.concatenate([self.free, np.zeros(more - len(self.free), np.int32)])
        self.counts[FREE] += more // 2


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdSpheresOptions(MeshOptions):
    """Options of ``threshold-spheres``. See ``MeshOptions``."""


class ThresholdSpheres(RightTriangleMeshes):
    """Threshold spheres, tested again when the eye may have crossed them. See ``RightTriangles`` for the arguments.

    The method remembers its trees from view to view; a view costs what changes by it, and putting out what is in view.
    Another tolerance, field of view or size of the picture changes all boundaries and starts anew. With a budget of
    time the trees of a better tolerance grow beside those that are shown, in the time that frames leave.
    """

    info = MethodInfo(
        "threshold-spheres",
        "each error has a boundary in the space of cameras, at its simplest a sphere around its sample: within, split",
        "Blow 2000", "triangles", ThresholdSpheresOptions, lambda options: options.conservative, incremental=True,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self._state: _State | None = None
        self._coming: _State | None = None
        self._taking = 0.0  # seconds of a frame at the present tolerance
        self._pace = Pace()
        self._capacity = 1 << 12

    def reset(self) -> None:
        """Forget the last view."""
        self._state = self._coming = None

    def _lambda(self, camera: Camera, tolerance: float) -> float:
        """Radius of threshold spheres per metre of (unstretched) error; 0 in a plan, where nothing is displaced."""
        view = camera.view
        if view.projection == "plan":
            return 0.0
        focal = 1.0 / view.pixel_slope
        ratio = focal / tolerance if tolerance > 0 else math.inf
        if not self.metric.conservative:
            return camera.exaggeration * ratio
        cosine = _corner(camera)
        return camera.exaggeration * (ratio / cosine**2 + 1.0 / cosine)

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        if goal.seconds is not None:
            return self._in_time(camera, goal)
        self._coming = None
        if goal.tolerance is None:
            return by_tolerance(lambda pixels: self._at(camera, pixels), goal, self._last)
        return self._at(camera, goal.tolerance)

    def _in_time(self, camera: Camera, goal: Goal) -> Mesh:
        """Keep the tolerance while frames take about their allowed time; otherwise grow the trees of a better one in
        the time left over, and show them when complete."""
        assert goal.seconds is not None
        deadline = Deadline(goal.seconds)
        if self._state is None or self._state.boundaries != self._boundaries(camera, self._state.tolerance):
            self._coming = None
            self._taking = 0.0
            return by_tolerance(lambda pixels: self._at(camera, pixels), goal, self._last)
        tolerance = self._state.tolerance
        mesh = self._at(camera, tolerance)
        mesh.tolerance = tolerance
        took = goal.seconds - deadline.left()
        self._taking += (took - self._taking) * (EASE if self._taking else 1.0)
        if self._coming is None:
            part = self._taking / goal.seconds
            if not USED[0] <= part <= USED[1]:
                better = tolerance * min(max((part / PART) ** (1 / GROWTH), 1 / FINER), LEAP)
                better = min(max(better, FINEST), COARSEST)
                if better != tolerance:
                    # Room for what is expected: copies of large trees would not fit into a frame.
                    room = ROOM * self._state.used * max((tolerance / better) ** GROWTH, 1.0)
                    boundaries = self._boundaries(camera, better)
                    self._coming = _State(self.field, boundaries, better, 1 << math.ceil(math.log2(room)))
        if self._coming is not None and self._grow(self._coming, camera, max(deadline.left(), SPARE * goal.seconds)):
            self._state, self._coming, self._taking = self._coming, None, 0.0
        return mesh

    def _grow(self, state: _State, camera: Camera, seconds: float) -> bool:
        """Work for some seconds on trees that are not shown yet; return whether they are complete.

        They are completed for one camera before they follow it, or those of a fast flight would never be.
        """
        if state.boundaries != self._boundaries(camera, state.tolerance):
            self._coming = None
            return False
        deadline = Deadline(seconds)
        while not deadline.is_near():
            began, steps = time.perf_counter(), self._pace.fitting(deadline.left() / 2.0)
            towards = state.towards or camera
            complete = self._update(state, towards, steps)
            state.towards = None if complete else towards
            self._pace.learn(time.perf_counter() - began, int(state.counts[STEPS]))
            if complete and towards is camera:
                return True
        return False

    def _boundaries(self, camera: Camera, tolerance: float) -> tuple[Any, ...]:
        """What all boundaries depend on, except the camera's position and direction."""
        view = camera.view
        plan = view.projection == "plan"
        if self.spheres != ANISOTROPIC:
            pixel = view.pixel_metres if plan else 0.0
            return (self._lambda(camera, tolerance), self._color_reach(camera), view.part, camera.exaggeration, pixel)
        return (
            tolerance, view.pixel_slope, view.near, view.far, *view.frame[2:], plan, view.part, camera.exaggeration
        )  # fmt: skip

    @staticmethod
    def _color_reach(camera: Camera) -> float:
        """Radius of the spheres of colored diamonds, in radii of their nested spheres; 0 in a plan, where distance
        does not count."""
        if camera.view.projection == "plan":
            return 0.0
        return (1.0 + 1.0 / camera.view.pixel_slope) / _corner(camera)

    def _at(self, camera: Camera, tolerance: float) -> Mesh:
        """The mesh of a tolerance."""
        began = time.perf_counter()
        boundaries = self._boundaries(camera, tolerance)
        fresh = camera.view.projection == "plan" and self.spheres == ANISOTROPIC
        if self._state is None or fresh or boundaries != self._state.boundaries:
            self._state = _State(self.field, boundaries, tolerance)
        state = self._state
        self._update(state, camera, NO_LIMIT)
        updated = time.perf_counter()
        lens = self._lens(camera, tolerance)
        keys, zs = self._triangles(state, Criterion(lens, self.spheres, self.cull, self._pruned(lens)))
        visits, splits, merges = (int(v) for v in state.counts[VISITS : MERGES + 1])
        return Mesh(
            keys, zs, is_strip=False, clockwise=False, triangles=len(keys),
            stats={
                "visits": visits, "splits": splits, "merges": merges, "front": state.used // 2 + 1,
                "update_ms": round((updated - began) * 1e3, 3),
                "output_ms": round((time.perf_counter() - updated) * 1e3, 3),
            },
        )  # fmt: skip

    def _update(self, state: _State, camera: Camera, steps: int) -> bool:
        """Update trees to a camera in at most about ``steps`` steps; return whether they are complete."""
        frame = self._moved(state, camera)
        lists = Lists(state.heads, state.turns)
        criterion = Criterion(self._lens(camera, state.tolerance), self.spheres, self.cull, NOTHING)
        state.counts[VISITS : STEPS + 1] = 0
        for clock, (links, heads, now) in enumerate(
            ((state.links, state.heads, state.way / frame.unit), (state.turning, state.turns, state.turn / RADIANS))
        ):
            advance(links, state.due[:, clock], heads, int(state.counts[NOW + clock]), int(now))
            state.counts[NOW + clock] = int(now)
        while True:
            state.stack[:2], state.counts[TOP] = (0, 1), 0 if self.spheres == ANISOTROPIC else 2
            self.field.begin()
            why = update(
                self.field.pages, criterion, frame, state.nodes, lists, state.stack, state.counts, 2 * self.field.n,
                steps,
            )  # fmt: skip
            if why == GROW:
                state.grow()
            elif why == MISSED:
                self.field.fetch(resumes=True)
            else:
                return bool(why == DONE)

    def _moved(self, state: _State, camera: Camera) -> Frame:
        """Move the camera of trees; return the frame's motion."""
        view, exaggeration, grid = camera.view, camera.exaggeration, self.terrain.grid
        first = grid.samples
        size = float(np.hypot(*(np.abs(grid.linear) @ (grid.cols, grid.rows)))) * max(1.0, exaggeration)
        unit = size * 2.0**-32
        eye, axes = np.array(view.eye) * [1.0, 1.0, exaggeration], np.stack(view.axes(exaggeration))
        moved = turned = 0.0
        if state.eye is not None and state.axes is not None:
            moved = float(np.linalg.norm(eye - state.eye)) * (1 + 1e-9)
            # The norm of the difference of two rotations by an angle φ of each other is √2 · 2 sin(φ/2).
            turned = float(np.linalg.norm(axes - state.axes)) / math.sqrt(2.0) * (1 + 1e-9)
            state.way += moved + (unit if moved else 0.0)
            state.turn += turned + (RADIANS if turned else 0.0)
        state.eye, state.axes = eye, axes
        return Frame(
            eye=tuple(eye.tolist()), origin=(first.c, first.f), affine=(first.a, first.b, first.d, first.e),
            way=state.way, turn=state.turn, moved=moved, turned=turned, unit=unit,
            reach=0.0 if self.spheres == ANISOTROPIC else self._lambda(camera, state.tolerance),
            color_reach=self._color_reach(camera), slack=1e-9 * size, secant=1.0 / _corner(camera),
        )  # fmt: skip

    def _triangles(self, state: _State, criterion: Criterion) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        stack = np.empty((2 * self.field.n + 4, 2), np.int64)
        while True:
            keys, zs = np.empty((self._capacity, 3), np.int64), np.empty((self._capacity, 3), np.float32)
            count = put_out(self.field.pages, criterion, state.nodes, stack, keys, zs)
            if count >= 0:
                return keys[:count], zs[:count]
            self._capacity *= 2
