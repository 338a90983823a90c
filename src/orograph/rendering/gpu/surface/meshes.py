"""Meshes of any method, drawn instead of patches: selected on the CPU, drawn and lit as patches are.

A method selects in its own thread while the current mesh is drawn. (Its vertices lie on the ground, so it is correct
from everywhere, only finer or coarser than requested.) Methods are kept, so incremental ones continue
from frame to frame. Until the first mesh is ready, patches stand in.

Vertices reach the GPU as whole rows and columns, their remainders in 65536ths, and a height; differences to the
eye's cell are taken in integers (``shaders/mesh.wgsl``), so they are as precise as patches.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError, UsageError
from orograph.gpu.background import BackgroundTask
from orograph.gpu.device import Device
from orograph.lod.method import Goal, Method, Resources
from orograph.lod.options import described
from orograph.lod.registry import Choice
from orograph.lod.selection import Selection, TriangleMesh
from orograph.rendering.gpu.surface.faces import FacePass
from orograph.rendering.gpu.surface.left import Left
from orograph.rendering.gpu.targets import Targets
from orograph.scene.methods import MEMORY, goal_of, made, mesh_choice
from orograph.scene.scene import Scene
from orograph.store.terrain import Terrain
from orograph.tessellation import Tessellation
from orograph.viewpoint import Camera, View

SAMPLE = np.dtype([("row", "<i4"), ("col", "<i4"), ("height", "<f4"), ("between", "<u4")])
"""A vertex: ``Sample`` of ``shaders/mesh.wgsl``."""


def packed(mesh: Tessellation) -> tuple[NDArray[np.void], NDArray[np.uint32]]:
    """Pack a mesh as vertices (n,) of ``SAMPLE`` and corners (3 m,)."""
    points = np.zeros(len(mesh.vertices), SAMPLE)
    places = np.rint(mesh.vertices[:, :2] * 65536).astype(np.int64)
    (points["col"], points["row"]), points["height"] = (places >> 16).T, mesh.vertices[:, 2]
    points["between"] = places[:, 0] & 0xFFFF | (places[:, 1] & 0xFFFF) << 16
    return points, np.ascontiguousarray(mesh.triangles, np.uint32).reshape(-1)


APART = 0.012
"""Least seconds between the beginnings of two selections: a view of hundreds of frames a second, which shares the
interpreter with them, shows one in several frames."""

Ready = Callable[[Any, Callable[[float], Any]], Selection]
Have = Callable[[Selection, bool], bool]


class Selected:
    """The method of a scene, and its last selection.

    Args:
        own: what makes selections that have a surface of their own ready for it, by their type: a function of one and
            of a function that selects with another tolerance. Others are turned into their triangles.
        have: asks for the tiles that a selection is drawn from, in every frame, and waits for them if so told; whether
            all of them are there.

    Attributes:
        selection: to be drawn; None until there is one. current: whether it is what the last scene asked for.
        failure: why the method selected nothing, or "".
    """

    def __init__(self, terrain: Terrain, own: Mapping[type, Ready], have: Have) -> None:
        self.terrain, self.own, self.have = terrain, own, have
        self.selection: Selection | None = None
        self._coming: Selection | None = None
        self.current = False
        self.failure = ""
        self._aside = BackgroundTask()
        self._wish: Any = None
        self._method: tuple[Any, Method | None] = (None, None)
        self._began = -math.inf
        self._lock = threading.Lock()

    @property
    def busy(self) -> bool:
        """Whether another mesh is on its way, or is to be made."""
        making = self._aside.busy or self._aside.done != self._wish or self._coming is not None
        return self._wish is not None and not self.failure and making

    def at_once(self, scene: Scene, view: View, tolerance: float) -> None:
        """Select a scene's mesh for a camera, and wait for it.

        Args:
            tolerance: of rays, pixels, whose lines are those of the drawn ground; meshes have the scene's.

        Raises:
            UsageError: there is no such method. StoreError: the store was built without errors of diamonds.
        """
        key = self._asked(scene, view, tolerance)
        if self.selection is None or self._aside.done != key:
            self.selection = self._refined(scene, view, tolerance, smooth=False)
        self._coming = None
        self.have(self.selection, True)
        self._aside.done, self.current = key, True

    def aside(self, scene: Scene, view: View, tolerance: float) -> None:
        """Take over a mesh that is ready, and start another one if the scene needs it."""
        key = self._asked(scene, view, tolerance)
        made = self._aside.take()
        if isinstance(made, str):
            self.failure = made
        elif made is not None:
            self._coming = made
        try:
            if self.selection is not None:
                self.have(self.selection, False)
            if self._coming is not None and self.have(self._coming, False):
                self.selection, self._coming = self._coming, None
        except OrographError as error:
            self.failure, self._coming = str(error), None
        self.current = self.selection is not None and self._coming is None and self._aside.done == key
        now = time.monotonic()
        if self._aside.wants(key) and not self.failure and self._coming is None and now >= self._began + APART:
            self._began = now

            def make() -> Selection | str:
                try:
                    return self._refined(scene, view, tolerance, smooth=True)
                except OrographError as error:
                    return str(error)

            self._aside.start(key, make)

    def none(self) -> None:
        """No method is wanted: forget the mesh."""
        self.selection, self._coming, self._wish, self.failure = None, None, None, ""
        self._method = None, None

    def close(self) -> None:
        self._aside.close()

    def _asked(self, scene: Scene, view: View, tolerance: float) -> Any:
        surface = scene.surface
        key = surface.method, surface.exaggeration, surface.tolerance, surface.triangles, view, tolerance
        if self._wish is None or self._wish[:2] != key[:2]:
            self.failure, self.selection, self._coming = "", None, None
        self._wish = key
        return key

    def _refined(self, scene: Scene, view: View, tolerance: float, *, smooth: bool) -> Selection:
        choice = mesh_choice(scene.surface.method, "gpu", scene.surface.triangles)
        assert choice is not None
        if smooth:
            choice = _grown(choice)
        with self._lock:  # a method is not thread-safe
            memory = MEMORY if scene.budget.max_memory is None else scene.budget.max_memory // 2
            known, method = self._method
            if method is None or known != (str(choice), memory, scene.budget.jobs):
                method = made(choice, self.terrain, Resources(memory, scene.budget.jobs))
                self._method = (str(choice), memory, scene.budget.jobs), method
            camera = Camera.over(self.terrain.grid, view.whole, scene.surface.exaggeration)
            wanted = tolerance if choice.info.kind == "rays" else scene.surface.tolerance
            began = time.perf_counter()
            selection = method.select(camera, goal_of(wanted, scene.surface.triangles))
            took = round((time.perf_counter() - began) * 1e3, 3)
            ready = self.own.get(type(selection))
            if ready is not None:
                found = ready(selection, lambda tolerance: method.select(camera, Goal(tolerance)))
            else:
                mesh = selection.tessellation()
                found = TriangleMesh(method=selection.method, bound=selection.bound, stats=selection.stats, mesh=mesh)
            if isinstance(found, TriangleMesh):
                found.mesh.stats.setdefault("refine_ms", took)
            return found


def _grown(choice: Choice) -> Choice:
    """The same choice with geomorphing vertices, if the method has them and its metric allows it: that is smoother
    while the camera moves."""
    if choice.info.kind in ("triangles", "batches") and any(
        one.name == "geomorph" for one in described(choice.info.options)
    ):
        with contextlib.suppress(UsageError):
            return replace(choice, options=replace(choice.options, geomorph=True))
    return choice


class MeshPass(FacePass):
    """Draws a mesh into depth and marks. Args: as for ``FacePass``."""

    def __init__(self, device: Device, camera: Any, field: tuple[Any, Any, Any], missing: int) -> None:
        super().__init__(device, "mesh", camera, field, missing)
        self._held: tuple[Tessellation | None, Any, int] = (None, None, 0)

    def draw(self, encoder: Any, targets: Targets, selection: TriangleMesh, left: Left) -> None:
        """Clear the targets and draw."""
        mesh = selection.mesh
        if self._held[0] is not mesh:
            points, corners = packed(mesh)
            some = (a if a.size else np.zeros(4, np.uint32) for a in (points, corners))
            samples, numbers = (self.device.buffer(a, "STORAGE", "mesh") for a in some)
            self._held = mesh, self.bind(samples=samples, corners=numbers), len(corners)
        pass_ = self.begin(encoder, targets, left)
        if self._held[2]:
            pass_.set_bind_group(0, self._held[1])
            pass_.draw(self._held[2])
        pass_.end()
