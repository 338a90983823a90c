"""Pictures and films drawn by the workers of a cluster, sort-last: each holds a part of the terrain (``composited``).

This process asks all parts for the depths of the pixels that it wants, keeps the nearest, and shades them as usual. A
part is asked only for the pixels that its box of heights may cover, and answers with the rows and columns that it does.
Parts are of the windows' heights, or of the mesh that the scene's method makes: every worker makes that for itself, the
same one, and keeps its share of triangles. A worker keeps the heights that it has loaded as long as the windows stay
what they are; when one dies, another takes its part over.

What light takes beyond the pixels is made here: means, maps of light, and where ground casts shadows, or is patched,
all windows' heights.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.errors import OrographError, StoreError, UsageError
from orograph.hierarchy.clip_stack import Rectangle
from orograph.memo import Memo
from orograph.processes import host
from orograph.progress import SILENT, Progress
from orograph.raycast.caster import Caster
from orograph.raycast.select import load
from orograph.rendering.backends import Session
from orograph.rendering.blending import blended
from orograph.rendering.composited import frame_of, put_nearer, split, split_triangles, windows_of
from orograph.rendering.gbuffer import Area, GBuffer, Surface
from orograph.rendering.large import draw_apart, draw_large, temporary
from orograph.rendering.memory import WORKER, band_pixels, worker_memory
from orograph.rendering.picture import Picture
from orograph.rendering.projection import Projection
from orograph.rendering.ray_surface import RaySurface
from orograph.scene.parts import Surface as Surfacing
from orograph.scene.scene import Scene
from orograph.store.clusters import TRIES, Cluster, check_workers, workers_of
from orograph.store.worker_state import opened
from orograph.store.workforce import workforce
from orograph.viewpoint import Camera, View

Array = NDArray[np.float64]

HELD = 2
"""Casters and meshes that a worker keeps: for its own part, and for one that it took over."""


class Part(NamedTuple):
    """The request to a part: which part, what, and from where.

    Attributes:
        view: the whole picture's. surface: how the scene's surface is drawn.
        windows: of heights. share: instead, of a mesh's triangles: the part's number, and how many there are.
    """

    view: View
    surface: Surfacing
    windows: tuple[Rectangle, ...]
    share: tuple[int, int] | None


class Answer(NamedTuple):
    """What a part shows.

    Attributes:
        depth: of the positions that were asked for; or of an area's rows and columns from ``first`` on, as many as
            show anything. who, seconds: the worker, and how long it took.
    """

    depth: Array
    first: tuple[int, int]
    who: str
    seconds: float


class Recipe(NamedTuple):
    """Everything that workers get once; ``memory`` and ``base`` as of all recipes."""

    scene: Scene
    memory: int
    base: int = WORKER

    def open(self) -> Any:
        return Parts(self.scene)


class Parts:
    """What a worker has of a terrain: the surfaces of its parts."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self._memo = scene, Memo(HELD)
        self._making = threading.Lock()

    def surface(self, part: Part) -> Surface:
        """What a part shows."""
        terrain, jobs = self.scene.terrain, self.scene.budget.jobs
        projection = Projection.of(Camera(part.view, terrain.chart, part.surface.exaggeration))
        with self._making:
            if part.share is None:
                shape = terrain.grid.shape
                caster = self._memo(
                    "caster", part.windows, lambda: Caster(load(terrain, part.windows, jobs), shape, jobs), terrain
                )
                return RaySurface(caster, projection)
            return self._memo("mesh", (part.view, part.surface, part.share), lambda: self._mesh(part, projection))

    def _mesh(self, part: Part, projection: Projection) -> Surface:
        from orograph.rendering.cpu.mesh_surface import refined
        from orograph.rendering.cpu.raster import MeshSurface

        assert part.share is not None
        scene = replace(self.scene.but(view=part.view), surface=part.surface)
        made = refined(scene, SILENT, self._memo)
        number, count = part.share
        shares = split_triangles(made.vertices, made.triangles, count)
        mine = made.triangles[shares[number]] if number < len(shares) else made.triangles[:0]
        used, triangles = np.unique(mine, return_inverse=True)
        return MeshSurface(
            made.vertices[used], triangles.reshape(-1, 3).astype(np.int32), projection, scene.budget.jobs
        )


def ask(ident: str, part: Part, area: Area | None, px: Array | None = None, py: Array | None = None) -> Answer:
    """What a part shows in an area, or at pixel positions; run by a worker."""
    state = opened(ident)
    assert isinstance(state, Parts)
    began = time.perf_counter()
    surface = state.surface(part)
    first = 0, 0
    if area is None:
        assert px is not None and py is not None
        depth = surface.at(px, py).depth
    else:
        depth = surface.draw(area).depth
        there = ~np.isnan(depth)
        rows, cols = np.flatnonzero(there.any(1)), np.flatnonzero(there.any(0))
        if len(rows):
            first = int(rows[0]), int(cols[0])
            depth = np.ascontiguousarray(depth[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1])
        else:
            depth = depth[:0, :0]
    return Answer(depth, first, f"{host()}.{os.getpid()}", time.perf_counter() - began)


class Asked:
    """A surface whose parts the workers have.

    Args:
        cluster: whose workers know ``Recipe``. parts: one for each worker. frames: pixels that each may cover.
    """

    side = 64

    def __init__(self, cluster: Cluster, parts: Sequence[Part], frames: Sequence[Area | None]) -> None:
        self.cluster, self.parts, self.frames = cluster, parts, frames

    def draw(self, area: Area) -> GBuffer:
        out = GBuffer.empty((area[1] - area[0], area[3] - area[2]))
        wanted: dict[int, tuple[Any, ...]] = {}
        for number, frame in enumerate(self.frames):
            if frame is None:
                continue
            inner = tuple(f(a, b) for f, a, b in zip((max, min, max, min), area, frame))
            if inner[0] < inner[1] and inner[2] < inner[3]:
                wanted[number] = (inner,)
        for number, answer in self._answers(wanted):
            inner = wanted[number][0]
            top, left = (inner[k] - area[k] + answer.first[k // 2] for k in (0, 2))
            rows, cols = answer.depth.shape
            put_nearer(out, np.s_[top : top + rows, left : left + cols], answer.depth, number)
        return out

    def at(self, px: Array, py: Array) -> GBuffer:
        out = GBuffer.empty(px.shape)
        which: dict[int, NDArray[np.intp]] = {}
        for number, frame in enumerate(self.frames):
            if frame is not None:
                top, bottom, left, right = frame
                found = np.flatnonzero((px >= left) & (px < right) & (py >= top) & (py < bottom))
                if len(found):
                    which[number] = found
        for number, answer in self._answers({n: (None, px[i], py[i]) for n, i in which.items()}):
            put_nearer(out, which[number], answer.depth, number)
        return out

    def _answers(self, wanted: dict[int, tuple[Any, ...]]) -> Iterator[tuple[int, Answer]]:
        """The parts' replies, all requested at once; if a part's worker dies, another one is asked."""
        futures = {number: self._begin(number, args, 0) for number, args in wanted.items()}
        for number, args in wanted.items():
            for tries in range(1, TRIES + 1):
                try:
                    answer: Answer = futures[number].result()
                    break
                except OrographError:
                    raise
                except (Exception, CancelledError) as error:  # the worker died, or the scheduler did
                    if tries == TRIES or self.cluster.client.status == "closed":
                        raise StoreError(
                            f"Part {number + 1} of {len(self.parts)} of the terrain was given up: "
                            f"{type(error).__name__}: {' '.join(str(error).split())[:300]}.",
                            remedy="Check that the workers and the scheduler are running.",
                        ) from error  # fmt: skip
                    futures[number] = self._begin(number, args, tries)
            self.cluster.count(answer.who, answer.seconds, answer.depth.nbytes)
            yield number, answer

    def _begin(self, number: int, args: tuple[Any, ...], tries: int) -> Any:
        """Ask the worker that holds a part, if it still exists."""
        workers = sorted(workers_of(self.cluster.client))
        own = [workers[(number + tries) % len(workers)]] if workers else None
        return self.cluster.client.submit(
            ask, self.cluster.ident, self.parts[number], *args, pure=False, workers=own, allow_other_workers=True
        )


class Casting:
    """Makes the surfaces of scenes for ``cpu.draw``."""

    def __init__(self, cluster: Cluster, count: int) -> None:
        self.cluster, self.count = cluster, count

    def __call__(self, scene: Scene, windows: Sequence[Rectangle] | None, projection: Projection) -> Surface:
        view, terrain = scene.view.whole, scene.terrain
        if windows is None:
            parts = [Part(view, scene.surface, (), (k, self.count)) for k in range(self.count)]
            frames: list[Area | None] = [(0, projection.height, 0, projection.width)] * self.count
            return Asked(self.cluster, parts, frames)
        boxes = split(windows, terrain.grid.shape, self.count)
        parts = [Part(view, scene.surface, tuple(windows_of(windows, box)), None) for box in boxes]
        return Asked(self.cluster, parts, [frame_of(box, terrain.height_range, projection) for box in boxes])


@contextmanager
def by_parts(
    scene: Scene, *, workers: int | None, dask: Any, jobs: int | None, max_memory: int, what: str
) -> Iterator[tuple[Session, Cluster]]:
    """The cluster, and the drawing of scenes of one terrain by its workers, each of which has a part.

    Args:
        scene: whose terrain and method it is.
        workers: processes of ``jobs`` threads each (None: 1), which share ``max_memory``; or
        dask: a ``distributed.Client``, or the address of a scheduler.
        what: is drawn, for messages: "A picture".

    Raises:
        UsageError: there is no cluster, or the scene has what only one process draws.
    """
    from orograph.rendering.cpu import draw

    check_workers(workers, dask, what)
    if workers is None and dask is None:
        raise UsageError("Sort-last needs workers.", remedy="Give their number (`workers`) or address (`dask`).")
    for name, there in (("wireframe", scene.surface.wireframe), ("detail", scene.surface.detail is not None)):
        if there:
            raise UsageError(f"`{name}` is drawn by one process, not sort-last.", remedy="Omit one of the two.")
    jobs = (jobs or 1) if workers is not None else jobs
    needed = worker_memory(band_pixels(max_memory // (workers or 1)), scene.terrain, max_memory // (workers or 1))
    with workforce(workers, dask, 1, max_memory, WORKER + needed) as client:
        recipe = Recipe(scene.but(jobs=jobs), needed)
        with Cluster(client, recipe) as cluster:
            casting = Casting(cluster, max(1, len(workers_of(client))))
            sessions: dict[int, Session] = {}

            def session(number: int = -1) -> Session:
                if number not in sessions:
                    sessions[number] = draw.session(casting)
                return sessions[number]

            yield (lambda one: blended(one, session(), session) if one.variants else session()(one)), cluster


def draw_by_parts(
    scene: Scene, path: str | os.PathLike[str], *, workers: int | None = None, dask: Any = None,
    depth: str | os.PathLike[str] | None = None, jobs: int | None = None, max_memory: int = 1 << 30,
    dpi: float | None = None, progress: Progress = SILENT,
) -> dict[str, Any]:  # fmt: skip
    """Draw a scene into a file, sort-last. Arguments, facts and errors as of ``tiles.draw_by_workers``; of the facts
    ``moved_bytes`` is what the workers sent."""
    with by_parts(scene, workers=workers, dask=dask, jobs=jobs, max_memory=max_memory, what="A picture") as found:
        draw, cluster = found
        facts = draw_large(
            scene, Path(path), depth=depth, draw=draw, progress=progress, dpi=dpi, pixels=band_pixels(max_memory)
        )
        return facts | _shares(cluster)


def picture_by_parts(
    scene: Scene, *, workers: int | None = None, dask: Any = None, jobs: int | None = None, max_memory: int = 1 << 30,
    progress: Progress = SILENT,
) -> Picture:  # fmt: skip
    """Draw a scene into memory, sort-last (``draw_by_parts``)."""
    with by_parts(scene, workers=workers, dask=dask, jobs=jobs, max_memory=max_memory, what="A picture") as found:
        draw, cluster = found
        with temporary() as folder:
            picture = draw_apart(scene, folder, draw=draw, progress=progress, pixels=band_pixels(max_memory))
        return replace(picture, facts=picture.facts | _shares(cluster))


def _shares(cluster: Cluster) -> dict[str, Any]:
    """Facts on how the work was shared."""
    return {"imbalance": round(cluster.imbalance(), 3), "moved_bytes": cluster.moved}
