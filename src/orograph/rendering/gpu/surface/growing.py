"""Methods that live on the GPU: their tree grows with the frames, and nothing is selected on the CPU.

A tree is planted in a thread, because the data it needs from a store may have to be made; until then patches stand in.
After that, every frame uploads new pages and updates the tree, until it has probably settled; then its counts are read,
and updates continue if it has not. For a picture that waits, the tree itself reports the pages that it lacked, and
updates continue until there are none and nothing changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from orograph.errors import OrographError
from orograph.gpu.background import BackgroundTask
from orograph.gpu.device import Device
from orograph.lod.cbt import Cbt
from orograph.lod.field import Vertices
from orograph.lod.method import Resources
from orograph.lod.needs import supply
from orograph.lod.registry import Choice
from orograph.lod.triangle_patches import Patches
from orograph.rendering.gpu.stream.diamonds import DiamondPages
from orograph.rendering.gpu.surface.tree import Counts, Tree, TreeFrame
from orograph.scene.methods import MEMORY, TOLERANCE, colored, mesh_choice
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.viewpoint import View

LIVING = (Cbt,)
"""Methods that live on the GPU."""

AT_ONCE = 8
"""Updates between two readings of a tree that a picture waits for."""


@dataclass(slots=True)
class Planted:
    """A tree and its pages."""

    tree: Tree
    pages: DiamondPages


def living(scene: Scene) -> Choice | None:
    """The method of a scene if it lives on the GPU and no budget of triangles is set.

    Raises:
        UsageError: there is no such method.
    """
    if scene.surface.triangles is not None:
        return None
    choice = mesh_choice(scene.surface.method, "gpu")
    return choice if choice is not None and choice.method in LIVING else None


class Growing:
    """The tree of one terrain on one device.

    Args:
        most: bytes of pages. jobs: threads that read.

    Attributes:
        selection: the current tree; None until it is planted. current: whether it has settled for the last view.
        failure: why there is none, or what of it could not be read, or "".
        counts: those last read; None: none were. came: bytes of pages that arrived for the last view.
    """

    def __init__(self, device: Device, terrain: Terrain, most: int, jobs: int | None = None) -> None:
        self.device, self.terrain, self.most, self.jobs = device, terrain, most, jobs
        self.selection: TreeFrame | None = None
        self.counts: Counts | None = None
        self.came = 0
        self._error = ""
        self._planting = BackgroundTask()
        self._planted: Planted | None = None
        self._choice: Choice | None = None
        self._asked: Any = None
        self._left = 0
        self._counted, self._changes = True, -1
        self._wanted = False

    @property
    def settling(self) -> int:
        """Updates after which a tree has probably settled: the number of levels, and some more."""
        return 2 * self.terrain.n + AT_ONCE

    @property
    def busy(self) -> bool:
        """Whether the tree will still change."""
        if not self._wanted or self._error:
            return False
        there = self._planted
        return there is None or self._left > 0 or not self._counted or there.pages.waiting > 0

    @property
    def current(self) -> bool:
        """Whether the tree is what the last scene asked for."""
        there = self._planted
        return there is not None and self._left == 0 and self._counted and not there.pages.lacking

    @property
    def lacking(self) -> int:
        """The number of pages that the last view wanted and did not have."""
        return 0 if self._planted is None else self._planted.pages.lacking

    @property
    def failure(self) -> str:
        return self._error or ("" if self._planted is None else self._planted.pages.failure)

    def at_once(self, scene: Scene, view: View, choice: Choice, patches: Patches) -> None:
        """Grow the tree for a view, with all its pages, as far as there is room.

        Args:
            patches: the view's, as fine as the tree is to be.

        Raises:
            UsageError: the method cannot do it. StoreError: the store was built without errors of diamonds, or a page
            cannot be read.
        """
        self._for(choice)
        if self._planted is None:
            self._planted = self._plant(choice)
        there, (tolerance, exaggeration) = self._planted, _goal(scene)
        moved = there.pages.moved
        there.pages.load(view, patches, tolerance, exaggeration)
        there.tree.take_asked()
        before, bound = -1, max(tolerance, there.pages.bound)
        while True:  # (as long as triangles change or pages arrive, which is finite)
            there.tree.update(view, tolerance, exaggeration, AT_ONCE)
            self.counts = there.tree.counts()
            if self.counts.changes == before:
                asked = there.tree.take_asked()
                if not there.pages.take_asked(asked):
                    break
            before = self.counts.changes
        if asked.any():  # there was no room for these pages
            bound = max(bound, math.inf)
        self.came = there.pages.moved - moved
        self._asked, self._left, self._counted = (view, tolerance, exaggeration), 0, True
        self._publish(choice, bound)

    def aside(self, scene: Scene, view: View, choice: Choice, patches: Patches) -> None:
        """Do one frame's share of growing the tree for a view; ``patches`` as for ``at_once``."""
        self._for(choice)
        made = self._planting.take()
        if isinstance(made, str):
            self._error = made
        elif made is not None:
            self._planted = made
        if self._planted is None:
            if self._planting.wants(str(choice)) and not self._error:
                self._planting.start(str(choice), lambda: self._try(choice))
            return
        there, asked = self._planted, (view, *_goal(scene))
        _, tolerance, exaggeration = asked
        moved = there.pages.moved
        beyond = 0.0 if there.tree.isotropic else tolerance  # (patches' metric is the anisotropic one)
        if there.pages.choose(view, patches, tolerance, exaggeration, beyond) or asked != self._asked:
            self._asked, self._left = asked, self.settling
        self.came = there.pages.moved - moved
        if self._left > 0:
            count = min(choice.options.updates, self._left)
            there.tree.aim(view, tolerance, exaggeration, count)
            self._left, self._counted = self._left - count, False
            self._publish(choice, max(tolerance, there.pages.bound))
        elif not self._counted:  # there is time to check whether it has settled
            self.counts = there.tree.counts()
            self._counted = self.counts.changes == self._changes
            if not self._counted:
                self._changes, self._left = self.counts.changes, AT_ONCE
            self._publish(choice, max(tolerance, there.pages.bound))

    def none(self) -> None:
        """Note that no tree is wanted; it stays on the GPU."""
        self.selection, self._wanted, self.came = None, False, 0

    def close(self) -> None:
        """Stop reading."""
        self._planting.close()
        if self._planted is not None:
            self._planted.pages.close()

    def _for(self, choice: Choice) -> None:
        if self._choice is None or str(self._choice) != str(choice):
            if self._planted is not None:
                self._planted.pages.close()
            self._choice, self._planted, self.selection, self._error, self.counts = choice, None, None, "", None
        self._wanted = True

    def _publish(self, choice: Choice, bound: float) -> None:
        """Publish the tree as a new selection."""
        assert self._planted is not None
        tree, counts = self._planted.tree, self.counts
        full = counts is not None and counts.triangles + counts.wanted > tree.slots
        stats: dict[str, Any] = {
            "method": choice.info.name, "tolerance": self._asked[1], "updates": tree.updates, "slots": tree.slots,
            "bytes": tree.bytes, "page_bytes": self._planted.pages.atlas.bytes,
        }  # fmt: skip
        reached = math.inf if full else bound
        promised = choice.conservative and math.isfinite(reached)
        self.selection = TreeFrame(
            method=choice.info.name, bound=reached if promised else None, stats=stats, tree=tree, reached=reached,
            full=full,
        )  # fmt: skip

    def _try(self, choice: Choice) -> Planted | str:
        try:
            return self._plant(choice)
        except OrographError as error:
            return str(error)

    def _plant(self, choice: Choice) -> Planted:
        resources, gamma = Resources(MEMORY, self.jobs), choice.options.color_tolerance
        supply(self.terrain, choice.method.needs(choice.options), resources)
        vertices = Vertices(self.terrain, choice.options.error, colored(choice, self.terrain, resources).color)
        pages = DiamondPages(self.device, vertices, self.most, self.jobs, math.inf if gamma is None else gamma)
        tree = Tree(
            self.device, self.terrain, vertices.corners, pages, choice.options.slots,
            isotropic=choice.options.metric_used.name == "isotropic", cull=choice.options.cull,
        )  # fmt: skip
        return Planted(tree, pages)


def _goal(scene: Scene) -> tuple[float, float]:
    """The tolerance in pixels, and the factor on heights."""
    return TOLERANCE if scene.surface.tolerance is None else scene.surface.tolerance, scene.surface.exaggeration
