"""ROAM: real-time optimally adapting meshes (Duchaineau et al., Visualization 1997).

The mesh of the last frame is carried to the next: what the camera's motion can have pushed over the threshold is
computed again (``priorities``, ``queues``), then the worst triangles are split and the diamonds that are least needed
merged, in the order of two queues that persist (``frame``), on a bintree with explicit neighbours (``mesh``).

With a tolerance the result depends on the view alone: priorities are monotonic, so the smallest conforming mesh whose
every triangle keeps the tolerance is unique, and splits and merges end there from wherever they begin.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.screen import CAMERA, LOCALISED, WEDGIE
from orograph.lod import look_ahead as ahead
from orograph.lod.localise import STACK
from orograph.lod.method import Goal, MethodInfo
from orograph.lod.pace import EASE, Deadline, Pace
from orograph.lod.right_triangles import BOUNDS, Mesh, RightTriangleMeshes
from orograph.lod.roam import bounds, frame, mesh, queues, terms
from orograph.lod.roam import strips as stripping
from orograph.lod.roam.blocks import NO_BLOCKS, blocks_of
from orograph.lod.roam.horizon import find_hidden
from orograph.lod.roam.options import RoamOptions
from orograph.viewpoint import Camera

FINEST = 0.25
"""Pixels to which a budget of time refines at most: finer is not seen, and would fill the memory of a still camera."""

BAND = 1.1
"""With a budget of triangles, priorities within this factor of the last crossing of the queues are kept up to date, to
the width of a bucket (``bounds.STALE``)."""

PARTS = 4.0
"""Splits may take the time left divided by this before the clock is checked again."""

CAPACITY = 1 << 20
"""Nodes there is room for at first, where the raster has as many: memory that is not used takes none."""


UP = 1e12
"""Metres: the height of the eye in a plan, from where nothing is turned away or hidden."""

SHARE = 16
"""The share of the memory allowed that what lies under blocks may take: one in so many."""


class Roam(RightTriangleMeshes):
    """ROAM. See ``RightTriangles`` for the arguments; ``select`` continues from the mesh of the last view.

    The arrays in the ``Mesh`` that ``mesh`` returns are the method's own: they change with the next view.
    """

    info = MethodInfo(
        "roam", "two queues, of splits and of merges, that meet at the tolerance or the budget",
        "Duchaineau et al. 1997", "triangles", RoamOptions, lambda options: options.conservative, incremental=True,
    )  # fmt: skip

    def __init__(self, *args: Any, **given: Any) -> None:
        super().__init__(*args, **given)
        o: RoamOptions = self.options
        self.deferral, self.strips = o.deferral, o.strips
        outside = o.outside
        if outside is None:
            outside = 0.0 if self.cull else 1.0
        demands = [[terms.OBJECT, *place, o.object_tolerance, 0.0, 0.0] for place in o.objects]
        demands += [[terms.LINE, *p, *q] for p, q in o.line_of_sight]
        linear = self.terrain.chart.linear
        inverse = np.linalg.inv(linear)
        self._terms = terms.Terms(
            np.array(demands, np.float64).reshape(-1, 7), NO_BLOCKS,
            np.zeros((terms.SECTORS, terms.RINGS) if o.occluded < 1 else (1, 1), np.float32), np.zeros(5),
            np.array([o.back_facing, o.silhouette, o.occluded, outside]),
            np.array([0, 0, 0, np.abs(inverse).max() * math.sqrt(2), 1.0]), linear.ravel(),
        )  # fmt: skip
        if o.back_facing < 1 or o.silhouette > 1 or o.occluded < 1:
            self._terms = self._terms._replace(blocks=blocks_of(self.terrain, self.resources.max_memory // SHARE))
        self.restart()

    def restart(self) -> None:
        """Forget the mesh: the next view begins from two triangles."""
        low, high = self.terrain.height_range
        low, high = (0.0, 0.0) if math.isnan(low) else (low, high)
        capacity = max(1 << 10, min(CAPACITY, 4 << 2 * self.field.n))
        counts = np.zeros(mesh.COUNTS, np.int64)
        counts[[mesh.TOP, mesh.FREED, mesh.LEAVES, mesh.UNUSED]] = 2, -1, 2, -1
        options = np.zeros(mesh.OPTIONS)
        options[mesh.CULL] = self.cull
        options[mesh.BOUND] = self.error in BOUNDS
        options[mesh.METRIC] = WEDGIE if self.metric.number == LOCALISED else self.metric.number
        options[mesh.N] = self.field.n
        options[mesh.EVERY] = not self.deferral
        keys, zs, members, blocks, dirty, loose = self._output(capacity)
        scratch = mesh.Scratch(
            np.zeros(256, np.int32), np.zeros(16), np.zeros(mesh.FAMILY, mesh.NODE),
            np.zeros((ahead.DEPTH + 2, STACK)),
        )  # fmt: skip
        self._state = mesh.State(
            nodes=mesh.plant(self.field.n, self.field.corners, low, high, capacity),
            heads=np.full((2, queues.BUCKETS), -1, np.int32),
            occupied=np.zeros((2, queues.BUCKETS // 64), np.uint64),
            lists=np.full(queues.CLASSES * queues.SLOTS, -1, np.int32),
            clock=np.zeros(queues.CLASSES),
            passed=np.zeros(queues.CLASSES, np.int64),
            waiting=np.zeros(capacity, np.int32),
            keys=keys,
            zs=zs,
            members=members,
            strips=blocks,
            dirty=dirty,
            loose=loose,
            scratch=scratch,
            counts=counts,
            cameras=np.zeros(1, CAMERA),
            options=options,
            pages=self.field.pages,
            terms=self._terms,
        )
        self._crossing = 0.0
        self._blind = False  # memory is too small to look ahead
        self._pace, self._stripping, self._reading = Pace(), Pace(5e-7), Pace(2e-3)
        self._seen: tuple[Any, ...] | None = None
        self._pose: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    # ---- a frame -----------------------------------------------------------------------------------------------------

    def _refine(self, camera: Camera, goal: Goal) -> Mesh:
        deadline = Deadline(goal.seconds)
        triangles = goal.triangles
        self._look(camera, goal)
        c = self._state.counts
        c[[mesh.SPLITS, mesh.MERGES, mesh.COMPUTED, mesh.SHOWN, mesh.LABELS]] = 0
        c[mesh.FRAME] = (c[mesh.FRAME] + 1) % (1 << 31)
        budget = -1 if triangles is None else triangles
        reason, drifts, settled = frame.ROOM, 0, False
        most = self.field.tiles_read + ahead.PATIENCE * len(self.field.pages.used)
        while reason != frame.DONE:
            self.field.begin()
            reason = self._go_on(budget, deadline)
            if reason == frame.ROOM:
                self._grow()
            elif reason == frame.DRIFT:
                drifts += 1
                self._drift(triangles, wide=drifts > 3)
            elif reason == frame.DONE and triangles is not None and not settled:
                settled = True
                if self._settle(triangles):
                    reason = frame.DRIFT
            elif reason == frame.PAGES and self.field.tiles_read > most and not self._blind:
                self._blind = True
                self._state.options[mesh.NEARNESS] = 0.0
                self._renew()
            if deadline.is_near(self._strips()) and c[mesh.RELABELLED]:
                self._split_mixed()
                break
            self._fetch(deadline)
        return self._result(goal, reason == frame.DONE)

    def _strips(self) -> float:
        """Seconds that the strips of what has come in this frame will take."""
        return self._stripping.unit * int(self._state.counts[mesh.SHOWN]) if self.strips else 0.0

    def _go_on(self, budget: int, deadline: Deadline) -> int:
        """``run_frame``, with as many steps as fit."""
        c = self._state.counts
        left, done = deadline.left(self._strips()), int(c[mesh.COMPUTED])
        # (What is due, splits, and merges may each take so many.)
        steps = -1 if deadline.seconds is None else self._pace.fitting(left / PARTS)
        reason = int(frame.run_frame(self._state, budget, steps))
        if deadline.seconds is not None:
            self._pace.learn(left - deadline.left(self._strips()), int(c[mesh.COMPUTED]) - done)
        return reason

    def _fetch(self, deadline: Deadline) -> None:
        """Read the pages that are missed, of which nodes keep what they need; with a deadline those that fit."""
        left, read = deadline.left(self._strips()), self.field.tiles_read
        most = None if deadline.seconds is None else max(1, int(left / self._reading.unit))
        self.field.fetch(resumes=True, most=most)
        if deadline.seconds is not None and (count := self.field.tiles_read - read):
            self._reading.unit += EASE * ((left - deadline.left(self._strips())) / count - self._reading.unit)

    def _split_mixed(self) -> None:
        """Split what is part surface and part hole, late or not: a mesh that bridges or leaves out ground is none."""
        reason = frame.ROOM
        while reason != frame.DONE:
            self.field.begin()
            reason = int(frame.split_mixed(self._state))
            if reason == frame.ROOM:
                self._grow()
            self.field.fetch(resumes=True)

    def _look(self, camera: Camera, wanted: Goal) -> None:
        """Set the lens and the thresholds, and let the clocks run by what the camera has moved since the last view."""
        s, view, triangles = self._state, camera.view, wanted.triangles
        goal = wanted.tolerance if wanted.tolerance is not None else 1.0 if triangles is not None else FINEST
        lens = self._lens(camera, goal)
        axes = np.stack(view.axes(camera.exaggeration))
        eye = np.array(view.eye) * [1.0, 1.0, camera.exaggeration]
        mode = "triangles" if triangles is not None else "tolerance"
        seen = (
            mode, goal, lens.focal, lens.near, view.far, view.width, view.height, view.part, view.projection,
            camera.exaggeration,
        )  # fmt: skip
        renew = seen != self._seen or self._pose is None or view.projection == "plan"
        moved = turned = 0.0
        if self._pose is not None and not renew:
            moved = float(np.linalg.norm(eye - self._pose[1]))
            # The norm of the difference of two rotations by an angle θ of each other is 2 sin(θ/2) ≤ θ.
            turned = float(np.linalg.norm(axes - self._pose[0])) / math.sqrt(2.0)
        self._seen, self._pose = seen, (axes, eye)
        s.cameras[0] = lens
        s.terms.eye[:2] = np.ravel(self.terrain.grid.index(*view.eye[:2]))
        height = view.eye[2] if view.projection == "perspective" else UP
        s.terms.eye[terms.HEIGHT], s.terms.eye[terms.STEEPNESS] = height, 1.0 / camera.exaggeration
        if s.terms.factors[terms.OCCLUDED] < 1 and (renew or moved or turned):
            find_hidden(s.terms, camera, s.pages.edge, s.terms.factors[terms.OUTSIDE] > 0)
        s.options[mesh.TOLERANCE] = s.options[mesh.RATE] = goal
        if goal == 0:
            s.options[mesh.RATE] = 1.0
        if triangles is None:
            self._know(goal, goal)
        elif renew:
            self._know(0.0, math.inf)
        else:
            self._follow()
        queues.advance(s.clock, moved, turned)
        if renew:
            s.counts[mesh.RENEW] = 1
            self._blind = False
            s.options[mesh.NEARNESS] = self._nearness(goal if triangles is None else 0.0)
        s.counts[mesh.STAGE] = not (s.counts[mesh.RENEW] or moved or turned or self._is_behind)
        s.counts[mesh.RELABELLED] = s.counts[mesh.STAGE]

    def _nearness(self, tolerance: float) -> float:
        """From which ratio on spheres are near enough to look ahead (``lod.look_ahead``); 0: it is not done.

        It is a matter of a tolerance; and where factors weigh what is seen, the bounds over volumes decide alone.
        """
        plainly = self._terms.factors[[terms.SILHOUETTE, terms.OUTSIDE]].tolist() == [1.0, 0.0]
        looks = self.metric.number == LOCALISED and plainly and tolerance > 0.0
        return ahead.nearness(tolerance) if looks else 0.0

    def _know(self, low: float, high: float) -> None:
        """Let these be the thresholds: what is computed from now on is computed for them, and nothing else is left."""
        s = self._state
        s.options[[mesh.LOW, mesh.HIGH]] = s.options[[mesh.LEAST, mesh.MOST]] = low, high
        s.counts[mesh.SWEPT] = 0

    def _follow(self) -> None:
        """Keep the thresholds around the crossing of the queues, little by little.

        What was computed for the old ones holds between both until all has been computed for the new ones.
        """
        s, crossing = self._state, self._crossing
        low, high = s.options[[mesh.LOW, mesh.HIGH]]
        near = math.sqrt(BAND)
        if high == math.inf:  # everything is known to a bucket's width
            self._know(crossing / BAND, crossing * BAND)
        elif not s.counts[mesh.SWEPT] and not low * near <= crossing <= high / near:
            s.options[[mesh.LOW, mesh.HIGH]] = crossing / BAND, crossing * BAND
            s.options[mesh.LEAST] = max(low, crossing / BAND)
            s.options[mesh.MOST] = min(high, crossing * BAND)
            s.counts[mesh.SWEPT] = 1

    def _drift(self, triangles: int | None, wide: bool) -> None:
        """The queues cross outside of the band: compute everything for a band around where they do, or for all."""
        s = self._state
        split = int(queues.highest(s.occupied, queues.SPLIT))
        merge = int(queues.lowest(s.occupied, queues.MERGE))
        over = triangles is not None and s.counts[mesh.DRAWN] > triangles
        self._crossing = queues.largest_in(merge if over or split < 0 else split)
        self._know(*((0.0, math.inf) if wide else (self._crossing / BAND, self._crossing * BAND)))
        self._renew()

    def _settle(self, triangles: int) -> bool:
        """Once the queues have met, with everything known to a bucket: let it be known for where they did from now on.

        So the next frame is like any other; else all would be due in it. Returns whether there is something to do.
        """
        s = self._state
        worst = int(queues.highest(s.occupied, queues.SPLIT))
        if s.options[mesh.HIGH] < math.inf or not 0 <= worst < queues.HOLES - 1:
            return False
        self._drift(triangles, wide=False)
        return True

    def _renew(self) -> None:
        """Have everything computed again."""
        self._state.counts[[mesh.RENEW, mesh.STAGE, mesh.RELABELLED]] = 1, 0, 0

    def _output(self, capacity: int) -> list[NDArray[Any]]:
        """The output's arrays (``mesh.State``: keys to loose) for so many nodes, or so many blocks of strips."""
        blocks = capacity // 16 if self.strips else 1
        places = blocks * stripping.LENGTH if self.strips else capacity // 2 + 2
        corners = places if self.strips else 3 * places
        return [
            np.zeros(corners, np.int64), np.zeros(corners, np.float32), np.zeros(places, np.int32),
            np.zeros((blocks, 4), np.int32), np.zeros(blocks, np.int32), np.zeros(capacity, np.int32),
        ]  # fmt: skip

    def _grow(self) -> None:
        """Twice the room for nodes and strips."""
        s = self._state
        capacity = 2 * len(s.nodes)
        fresh = np.zeros(capacity, mesh.NODE), np.zeros(capacity, np.int32), *self._output(capacity)
        names = "nodes", "waiting", "keys", "zs", "members", "strips", "dirty", "loose"
        larger: dict[str, Any] = dict(zip(names, fresh))
        for name, array in larger.items():
            old = getattr(s, name).reshape(-1).view(np.uint8)  # (as bytes: NumPy copies records field by field)
            array.reshape(-1).view(np.uint8)[: len(old)] = old
        self._state = s._replace(**larger)

    # ---- what came of it ---------------------------------------------------------------------------------------------

    @property
    def _is_behind(self) -> bool:
        """Whether the last frame ran out of time before all that was due was computed."""
        return bool(self._state.counts[mesh.STAGE] == 0)

    def _result(self, goal: Goal, done: bool) -> Mesh:
        self._restrip()
        s = self._state
        c = s.counts
        worst = int(queues.highest(s.occupied, queues.SPLIT))
        reached, within = goal.tolerance, True
        if goal.triangles is not None:
            self._crossing = queues.largest_in(worst) if worst >= 0 else 0.0
            reached = max(self._crossing, float(s.options[mesh.LEAST])) * (1.0 + bounds.STALE)
            within = int(c[mesh.DRAWN]) <= goal.triangles
        elif goal.seconds is not None:
            # Of what was not computed again, or waits for a page, nothing is known.
            known = done or not (self._is_behind or c[mesh.WAITING])
            reached = FINEST * max(1.0, queues.largest_in(worst)) if known else None
        if reached is None or not math.isfinite(reached):
            reached, within = None, False
        stats = {
            "splits": int(c[mesh.SPLITS]), "merges": int(c[mesh.MERGES]), "changed": int(c[mesh.SHOWN]),
            "recomputed": int(c[mesh.COMPUTED]), "labels": int(c[mesh.LABELS]), "leaves": int(c[mesh.LEAVES]),
            "split_queue": int(c[mesh.QUEUED_SPLITS]), "merge_queue": int(c[mesh.QUEUED_MERGES]),
        }  # fmt: skip
        drawn = int(c[mesh.DRAWN])
        length = stripping.LENGTH * int(c[mesh.BLOCKS]) if self.strips else 3 * drawn
        keys, zs = s.keys[:length], s.zs[:length]
        if not self.strips:
            keys, zs = keys.reshape(-1, 3), zs.reshape(-1, 3)
        return Mesh(
            keys, zs, is_strip=bool(self.strips), clockwise=False, triangles=drawn, within=within, tolerance=reached,
            stats=stats,
        )  # fmt: skip

    def _restrip(self) -> None:
        """Bring the strips up to date, or build them anew."""
        if not self.strips:
            return
        began = time.perf_counter()
        if self.strips == "rebuilt":
            stripping.unravel(self._state)
        while not stripping.restrip(self._state):
            self._grow()
            began = time.perf_counter()
        self._stripping.learn(time.perf_counter() - began, int(self._state.counts[mesh.SHOWN]))
