"""Ways to draw one scene: at once in this process, in bands, or by workers, each with tiles of the picture or with a
part of the terrain; into memory or a file. All show the same picture."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

from orograph.errors import UsageError
from orograph.progress import Progress
from orograph.rendering.backends import BACKENDS, check_sort_last, draw, session
from orograph.rendering.large import ACROSS, check_most, draw_large, is_large
from orograph.rendering.memory import band_pixels, check_memory
from orograph.rendering.picture import Picture
from orograph.scene.scene import Scene

MEMORY = 1 << 30
"""Bytes that drawing into a file may take if nothing is said."""


@dataclass(frozen=True, slots=True)
class Way:
    """Who draws.

    Attributes:
        backend: "cpu" or "gpu".
        workers: this many processes, of the scene's ``jobs`` threads each (None: 1), which share its ``max_memory``; or
        dask: the workers of a ``distributed.Client`` or a scheduler's address. Both None: this process.
        sort_last: each worker draws a part of the terrain, not tiles of the picture.

    Raises:
        UsageError: there is no such backend, or options exclude each other.
    """

    backend: str = "cpu"
    workers: int | None = None
    dask: Any = None
    sort_last: bool = False

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise UsageError(f"There is no backend {self.backend!r}; the backends are {', '.join(BACKENDS)}.")
        if self.together:
            from orograph.store.clusters import check_workers

            check_workers(self.workers, self.dask, "A picture")
        check_sort_last(self.sort_last, self.workers, self.dask, self.backend)

    @property
    def together(self) -> bool:
        """Whether workers draw."""
        return self.workers is not None or self.dask is not None

    def in_tiles(self, size: tuple[int, int], max_memory: int, wireframe: bool = False) -> bool:
        """Whether a file of this size is drawn in tiles, by workers or because it is large."""
        if self.together:
            check_most(size)
            return True
        gpu = self.backend == "gpu"
        return (gpu or not wireframe) and is_large(size, max_memory, gpu=gpu)

    def picture(self, scene: Scene, progress: Progress) -> Picture:
        """The picture of a scene.

        Raises: as ``draw``, ``draw_by_workers`` and ``draw_by_parts``.
        """
        if not self.together:
            return draw(scene, progress, backend=self.backend)
        from orograph.rendering.sort_last import picture_by_parts
        from orograph.rendering.tiles import picture_by_workers

        if self.sort_last:
            return picture_by_parts(scene, **self._budget(scene), progress=progress)
        return picture_by_workers(scene, backend=self.backend, **self._budget(scene), progress=progress)

    def into(
        self, scene: Scene, path: str | os.PathLike[str], progress: Progress, *,
        depth: str | os.PathLike[str] | None = None, dpi: float | None = None, max_memory: int | None = None,
    ) -> dict[str, Any]:  # fmt: skip
        """Draw a scene into a file; returns the picture's facts.

        Args:
            depth: where to write the depth as well. dpi: dots per inch in print.
            max_memory: bytes of the picture that the user allows; None: what the machine has.

        Raises: as ``picture`` and ``draw_large``.
        """
        view, limit = scene.view, scene.budget.max_memory or MEMORY
        if not self.in_tiles((view.width, view.height), limit, scene.surface.wireframe):
            check_memory((view.width, view.height), max_memory)
            picture = self.picture(scene, progress)
            picture.save(path, dpi=dpi)
            if depth is not None:
                picture.save_depth(depth)
            return picture.facts
        if self.sort_last:
            from orograph.rendering.sort_last import draw_by_parts

            return draw_by_parts(scene, path, depth=depth, dpi=dpi, **self._budget(scene), progress=progress)
        if self.together:
            from orograph.rendering.tiles import draw_by_workers

            return draw_by_workers(scene, path, backend=self.backend, depth=depth, dpi=dpi, **self._budget(scene),
                                   progress=progress)  # fmt: skip
        gpu = self.backend == "gpu"
        return draw_large(
            scene, path, depth=depth, draw=session(progress, backend=self.backend), across=ACROSS if gpu else None,
            pixels=band_pixels(limit, gpu=gpu), dpi=dpi, progress=progress,
        )  # fmt: skip

    def _budget(self, scene: Scene) -> dict[str, Any]:
        """What drawing by workers may use."""
        budget = scene.budget
        return {"workers": self.workers, "dask": self.dask, "jobs": budget.jobs,
                "max_memory": budget.max_memory or MEMORY}  # fmt: skip
