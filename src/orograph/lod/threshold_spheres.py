"""Threshold spheres: what the camera's place decides is looked at again when it can have crossed a boundary.

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
texel. Turning the head changes nothing; mixed diamonds (e = ∞) are split when they come into view; what is out of view
stays refined and is skipped when triangles are put out.

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
from orograph.lod.criterion import NOTHING, Criterion
from orograph.lod.field import Field
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.radix_heap import AFTER, BEFORE, LISTS, WHERE, WORK, advance
from orograph.lod.right_triangles import Mesh, MeshOptions, RightTriangleMeshes, by_tolerance
from orograph.lod.threshold_spheres_pass import put_out, update
from orograph.lod.threshold_spheres_trees import (
    FREE,
    GROW,
    LEVEL,
    MERGES,
    MISSED,
    NOW,
    NUMBERS,
    RADIANS,
    TOP,
    VISITS,
    Frame,
    Lists,
    Nodes,
)
from orograph.viewpoint import Camera


class _State:
    """The trees, and what waits, for one λ."""

    def __init__(self, field: Field, capacity: int = 1 << 12) -> None:
        n = field.n
        self.corners, self.heights = np.zeros((capacity, 3), np.int64), np.zeros((capacity, 4), np.float32)
        self.numbers, self.due = np.full((capacity, NUMBERS), np.nan), np.zeros((capacity, 2), np.int64)
        self.shown, self.links = np.zeros(capacity, np.uint8), np.full((capacity, 6), -1, np.int32)
        self.turning = np.full((capacity, 3), -1, np.int32)
        self.free = np.arange(capacity - 2, -1, -2, dtype=np.int32)
        self.heads, self.turns = np.full(LISTS, -1, np.int32), np.full(LISTS, -1, np.int32)
        self.stack, self.counts = np.zeros(4 * n + 8, np.int32), np.zeros(7, np.int64)
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
    def nodes(self) -> Nodes:
        """The trees as kernels see them."""
        return Nodes(
            self.corners, self.heights, self.numbers, self.due, self.shown, self.links, self.turning, self.free
        )

    def grow(self) -> None:
        """Twice the room."""
        more = len(self.due)
        self.corners, self.heights, self.numbers, self.due, self.shown, self.links, self.turning = (
            np.concatenate([a, np.full_like(a, -1) if a.dtype == np.int32 else np.zeros_like(a)])
            for a in self.nodes[:-1]
        )
        count = int(self.counts[FREE])
        self.free = np.concatenate([self.free[:count], np.arange(2 * more - 2, more - 2, -2, dtype=np.int32)])
        self.free = np.concatenate([self.free, np.zeros(more - len(self.free), np.int32)])
        self.counts[FREE] += more // 2


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdSpheresOptions(MeshOptions):
    """Options of ``threshold-spheres``. See ``MeshOptions``."""


class ThresholdSpheres(RightTriangleMeshes):
    """Threshold spheres, looked at again when the eye can have crossed them. See ``RightTriangles`` for the arguments.

    The method remembers its trees from view to view; a view costs what changes by it, and putting out what is in view.
    Another tolerance, field of view or size of the picture changes all boundaries and starts anew. Budgets do that
    often.
    """

    info = MethodInfo(
        "threshold-spheres",
        "each error has a boundary in the space of cameras, at its simplest a sphere around its sample: within, split",
        "Blow 2000", "triangles", ThresholdSpheresOptions, lambda options: options.conservative, incremental=True,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        self._state: _State | None = None
        self._spheres: tuple[Any, ...] = ()
        self._capacity = 1 << 12

    def reset(self) -> None:
        """Forget the last view."""
        self._state = None

    def _lambda(self, camera: Camera, tolerance: float) -> float:
        """Radius of threshold spheres per metre of (unstretched) error; 0 in a plan, where nothing is displaced."""
        view = camera.view
        if view.projection == "plan":
            return 0.0
        focal = 1.0 / view.pixel_slope
        ratio = focal / tolerance if tolerance > 0 else math.inf
        if not self.metric.conservative:
            return camera.exaggeration * ratio
        cosine = 1.0 / math.hypot(1.0, *(view.pixel_slope * pixels / 2 for pixels in view.frame[2:]))
        return camera.exaggeration * (ratio / cosine**2 + 1.0 / cosine)

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        if goal.tolerance is None:
            return by_tolerance(lambda pixels: self._refine(camera, Goal(pixels)), goal, self._last)
        began = time.perf_counter()
        view, exaggeration, tolerance = camera.view, camera.exaggeration, goal.tolerance
        grid, lens = self.terrain.grid, self._lens(camera, tolerance)
        linear, first = grid.linear, grid.samples
        size = float(np.hypot(*(np.abs(linear) @ (grid.cols, grid.rows)))) * lens.stretch
        cosine = 1.0 / math.hypot(1.0, *(view.pixel_slope * pixels / 2 for pixels in view.frame[2:]))
        colored = math.inf if view.projection == "plan" else (1.0 + 1.0 / lens.texel) / cosine
        isotropic = self.spheres != ANISOTROPIC
        plan = view.projection == "plan"
        spheres: tuple[Any, ...] = (self._lambda(camera, tolerance), colored, view.part, exaggeration)
        if not isotropic:
            spheres = (tolerance, view.pixel_slope, view.near, view.far, *view.frame[2:], plan, view.part, exaggeration)
        if self._state is None or spheres != self._spheres or (plan and not isotropic):
            self._state, self._spheres = _State(self.field), spheres
        state = self._state
        eye, axes = np.array(view.eye) * [1.0, 1.0, exaggeration], np.stack(view.axes(exaggeration))
        unit = size * 2.0**-32
        moved = turned = 0.0
        if state.eye is not None and state.axes is not None:
            moved = float(np.linalg.norm(eye - state.eye)) * (1 + 1e-9)
            # The norm of the difference of two rotations by an angle φ of each other is √2 · 2 sin(φ/2).
            turned = float(np.linalg.norm(axes - state.axes)) / math.sqrt(2.0) * (1 + 1e-9)
            state.way += moved + (unit if moved else 0.0)
            state.turn += turned + (RADIANS if turned else 0.0)
        state.eye, state.axes = eye, axes
        around = Frame(
            eye=tuple(eye.tolist()), origin=(first.c, first.f), affine=(first.a, first.b, first.d, first.e),
            way=state.way, turn=state.turn, moved=moved, turned=turned, unit=unit,
            reach=spheres[0] if isotropic else 0.0, color_reach=colored, slack=1e-9 * size, secant=1.0 / cosine,
        )  # fmt: skip
        criterion = Criterion(lens, self.spheres, self.cull, NOTHING)
        lists = Lists(state.heads, state.turns)
        state.counts[VISITS : MERGES + 1] = 0
        for clock, (links, heads, now) in enumerate(
            ((state.links, state.heads, state.way / unit), (state.turning, state.turns, state.turn / RADIANS))
        ):
            advance(links, state.due[:, clock], heads, int(state.counts[NOW + clock]), int(now))
            state.counts[NOW + clock] = int(now)
        while True:
            state.stack[:2], state.counts[TOP] = (0, 1), 2 if isotropic else 0
            self.field.begin()
            why = update(
                self.field.pages, criterion, around, state.nodes, lists, state.stack, state.counts, 2 * self.field.n
            )
            if why == GROW:
                state.grow()
            elif why == MISSED:
                self.field.fetch(resumes=True)
            else:
                break
        updated = time.perf_counter()
        keys, zs = self._triangles(state, criterion._replace(pruned=self._pruned(lens)))
        visits, splits, merges = (int(v) for v in state.counts[VISITS : MERGES + 1])
        nodes = len(state.due) - 2 * int(state.counts[FREE])
        return Mesh(
            keys, zs, is_strip=False, clockwise=False, triangles=len(keys),
            stats={
                "visits": visits, "splits": splits, "merges": merges, "front": nodes // 2 + 1,
                "update_ms": round((updated - began) * 1e3, 3),
                "output_ms": round((time.perf_counter() - updated) * 1e3, 3),
            },
        )  # fmt: skip

    def _triangles(self, state: _State, criterion: Criterion) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        stack = np.empty((2 * self.field.n + 4, 2), np.int64)
        while True:
            keys, zs = np.empty((self._capacity, 3), np.int64), np.empty((self._capacity, 3), np.float32)
            count = put_out(self.field.pages, criterion, state.nodes, stack, keys, zs)
            if count >= 0:
                return keys[:count], zs[:count]
            self._capacity *= 2
