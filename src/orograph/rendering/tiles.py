"""Large pictures drawn by the workers of a cluster, sort-first: each task is a tile of the picture.

After Goswami, Makhinya, Bösch & Pajarola 2010, "Scalable parallel out-of-core terrain rendering", sec. 4 (sort-first
decomposition with balanced loads): where in the picture drawing takes long is found by a coarse pass, a small picture
whose parts are timed, and tiles are cut so that each costs about as much, at multiples of the caster's blocks. What the
forecast misses is evened out by there being several tiles for each worker, which takes the next when it is done.

A tile is what the whole picture shows there, to the bit, so the file has the bytes of one that is drawn by one process.
Tiles lie compressed in a folder beside the picture, ``.NAME.tiles``, until it is complete: what is there is not drawn
again, and GDAL reads the picture from there.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from orograph.errors import UsageError
from orograph.progress import Progress
from orograph.rendering.assembly import Raster, piece
from orograph.rendering.backends import Session, session
from orograph.rendering.large import (
    COLUMNS,
    ROWS,
    Box,
    Seen,
    Sheet,
    draw_apart,
    draw_large,
    draw_tile,
    seen,
    temporary,
)
from orograph.rendering.memory import BYTES_PER_PIXEL, WORKER, worker_memory
from orograph.rendering.picture import Picture
from orograph.scene.scene import Scene
from orograph.store.clusters import Cluster, check_workers, threads_of
from orograph.store.digests import Spot, crc32c
from orograph.store.executing import Stage
from orograph.store.layout import dumps
from orograph.store.lock import alone
from orograph.store.parts import pack, unpack
from orograph.store.storage import FolderStorage
from orograph.store.worker_state import guarded
from orograph.store.workforce import workforce

EACH = 6
"""The fewest tiles per worker."""

COARSE, CELL = 512, (2 * COLUMNS, 4 * ROWS)
"""The most pixels per side of the coarse pass, and of its parts that are timed."""

LEAST, MOST = 1 << 14, 4 << 20
"""Pixels of a tile."""

PLAN = "plan.json"

Band = list[Box]
"""Tiles of the same rows, from left to right."""

Costs = NDArray[np.float64]

By = Callable[[Sheet, Progress], None]
"""What adds all tiles to a sheet."""

T = TypeVar("T")


class SheetRecipe(NamedTuple):
    """Everything that workers get once for a picture.

    Attributes:
        scene: that is drawn. backend: that draws. folder: of the tiles. plan: as it lies there. bands: of the tiles.
        depth: whether their depths are kept. memory, base: as of all recipes.
    """

    scene: Scene
    backend: str
    folder: str
    plan: bytes
    bands: list[Band]
    depth: bool
    memory: int
    base: int = WORKER

    def open(self) -> _SheetState:
        return _SheetState(self)


class _SheetState:
    """The state of one process for a picture."""

    def __init__(self, recipe: SheetRecipe) -> None:
        storage = FolderStorage(recipe.folder)
        guarded(storage, PLAN, recipe.plan)
        self._tiles = Tiles(recipe, storage, session(backend=recipe.backend))

    def stage(self, name: str, number: int) -> Tiles:
        return self._tiles


class Tiles(Stage[Seen]):
    """The tiles of a picture; a task is a band's number and its tile's. What it draws are pieces of ``sheet``'s files,
    and beside them lies what is remembered of the tile.

    Args:
        storage: of the tiles. draw: draws them; None: this process only adds them to ``sheet``.
    """

    name = "tiles"
    label = "Drawing"

    def __init__(
        self, recipe: SheetRecipe, storage: FolderStorage, draw: Session | None = None, sheet: Sheet | None = None
    ) -> None:  # fmt: skip
        self.recipe, self.storage, self.draw, self.sheet = recipe, storage, draw, sheet
        self._drawing = threading.Lock()  # a session draws one picture at a time, with all threads

    @property
    def place(self) -> str:
        return self.recipe.folder

    def tasks(self) -> list[Spot]:
        return [(b, k) for b, band in enumerate(self.recipe.bands) for k in range(len(band))]

    def box(self, spot: Spot) -> Box:
        return self.recipe.bands[spot[0]][spot[1]]

    def key(self, spot: Spot) -> str:
        return f"{spot[0]}.{spot[1]}.tile"

    def pieces(self, spot: Spot) -> list[str]:
        """The keys of a tile's pixels, and of its depth if that is kept."""
        return [f"{spot[0]}.{spot[1]}.{what}.tif" for what in ("pixels", "depth")[: 1 + self.recipe.depth]]

    def kept(self, spot: Spot) -> bool:
        return self.storage.exists(self.key(spot))

    def found(self, spot: Spot, proof: bool = True) -> Seen | None:
        data = self.storage.get(self.key(spot))
        try:
            kept = {} if data is None else unpack(data)
        except ValueError:
            return None
        if not kept:
            return None
        for key, check in zip(self.pieces(spot), kept["checks"], strict=True):
            if not self.storage.exists(key) or (proof and crc32c(self.storage.get(key) or b"") != check):
                return None
        return Seen(json.loads(kept["facts"].tobytes()), kept["cover"], kept["column"], kept["samples"])

    def make(self, spot: Spot) -> Seen:
        assert self.draw is not None
        with self._drawing:
            tile = draw_tile(self.recipe.scene, self.box(spot), self.draw)
        checks = []
        rasters: list[Raster] = [tile.pixels, tile.depth]
        for key, raster in zip(self.pieces(spot), rasters, strict=False):
            data = piece(raster)
            self.storage.put(key, [data])
            checks.append(crc32c(data))
        known = seen(self.recipe.scene, self.box(spot), tile)
        facts = np.frombuffer(json.dumps(known.facts).encode(), np.uint8)
        kept: dict[str, NDArray[Any]] = {
            "facts": facts, "cover": known.cover, "column": known.column, "samples": known.samples,
            "checks": np.array(checks, np.uint32),
        }  # fmt: skip
        self.storage.put(self.key(spot), [pack(kept)])
        return known

    def add(self, spot: Spot, found: Seen) -> None:
        assert self.sheet is not None
        for key, file in zip(self.pieces(spot), self.sheet.files, strict=True):
            file.refer(self.storage.path / key, *self.box(spot))
        self.sheet.add(self.box(spot), found)

    def finish(self) -> None:
        """The colours of heights, which furniture and a colour bar need, from any part of the picture."""
        if self.sheet is not None:
            left, top, wide, tall = self.recipe.bands[-1][-1]
            corner = (left, top, min(wide, COLUMNS), min(tall, ROWS))
            self.sheet.tint = draw_tile(self.recipe.scene, corner, self.sheet.session).tint


def draw_by_workers(
    scene: Scene, path: str | os.PathLike[str], *, workers: int | None = None, dask: Any = None,
    depth: str | os.PathLike[str] | None = None, backend: str = "cpu", jobs: int | None = None,
    max_memory: int = 1 << 30, dpi: float | None = None, progress: Progress,
) -> dict[str, Any]:  # fmt: skip
    """Draw a scene into a file, its tiles by workers.

    Args:
        workers: processes of ``jobs`` threads each (None: 1), which share ``max_memory`` and the scene's own budget; or
        dask: a ``distributed.Client``, or the address of a scheduler.
        depth, backend, dpi, progress: as for ``draw_large``.

    Returns:
        facts, as of ``draw_large``; ``imbalance`` is how much longer the busiest worker was at work than they were on
        average.

    Raises:
        StoreError: another process draws the same picture, or tiles were given up. As ``draw_large``.
    """
    out = Path(path)
    folder = out.absolute().with_name(f".{out.name}.tiles")

    def into(scene: Scene, by: By) -> dict[str, Any]:
        draw = session(progress, backend=backend)
        return draw_large(scene, out, depth=depth, draw=draw, progress=progress, dpi=dpi, by=by)

    facts, imbalance = _by_workers(scene, folder, into, workers, dask, depth is not None, backend, jobs, max_memory)
    return facts | imbalance


def picture_by_workers(
    scene: Scene, *, workers: int | None = None, dask: Any = None, backend: str = "cpu", jobs: int | None = None,
    max_memory: int = 1 << 30, progress: Progress,
) -> Picture:  # fmt: skip
    """Draw a scene into memory, its tiles by workers (``draw_by_workers``). Tiles lie in the cache folder meanwhile."""
    with temporary() as folder:

        def into(scene: Scene, by: By) -> Picture:
            return draw_apart(scene, folder, draw=session(progress, backend=backend), progress=progress, by=by)

        tiles = folder / "tiles"
        picture, imbalance = _by_workers(scene, tiles, into, workers, dask, True, backend, jobs, max_memory)
    return replace(picture, facts=picture.facts | imbalance)


def _by_workers(
    scene: Scene, place: Path, into: Callable[[Scene, By], T], workers: int | None, dask: Any, deep: bool,
    backend: str, jobs: int | None, max_memory: int,
) -> tuple[T, dict[str, Any]]:  # fmt: skip
    """What ``into`` makes of a scene whose tiles workers draw, and the fact of how evenly they were at work.

    Args:
        place: the folder of the tiles. deep: whether their depths are kept.
    """
    check_workers(workers, dask, "A picture")
    if scene.surface.wireframe and backend == "cpu":
        raise UsageError("A wireframe needs the whole picture in one process.", remedy="Omit the workers.")
    if workers is not None and scene.budget.max_memory is not None:
        # Each holds the heights of its tiles; all tiles, and what is seen of them here, are drawn from the same ones.
        scene = scene.but(max_memory=scene.budget.max_memory // workers)
    folder = FolderStorage(place, many=True)
    imbalance = 1.0

    def by(sheet: Sheet, progress: Progress) -> None:
        nonlocal imbalance
        each = max_memory // (workers or 1)
        most = min(MOST, max(each // 8 // BYTES_PER_PIXEL, LEAST))
        needed = worker_memory(most, scene.terrain, each)
        with workforce(workers, dask, 1, max_memory, WORKER + needed) as client:
            plan, bands = _planned(scene, folder, backend, deep, threads_of(client), most, progress)
            drawn = scene if workers is None else scene.but(jobs=jobs or 1)  # processes share the machine's processors
            recipe = SheetRecipe(drawn, backend, str(folder.path), plan, bands, deep, needed)
            with Cluster(client, recipe) as cluster:
                cluster.run(Tiles(recipe, folder, sheet=sheet), progress)
                imbalance = cluster.imbalance()

    with alone(folder, "drawing this picture"):
        made = into(scene, by)
        shutil.rmtree(folder.path, ignore_errors=True)
    return made, {"imbalance": round(imbalance, 3)}


def _planned(
    scene: Scene, folder: FolderStorage, backend: str, depth: bool, threads: int, most: int, progress: Progress
) -> tuple[bytes, list[Band]]:
    """The tiles of a picture: unfinished ones, or new ones."""
    asked = [scene.summary(), backend, depth]
    fingerprint = hashlib.sha256(json.dumps(asked, sort_keys=True, default=str).encode()).hexdigest()
    there = folder.get(PLAN)
    if there is not None:
        try:
            plan = json.loads(there)
            if plan["picture"] == fingerprint:
                return there, [[(a, b, c, d) for a, b, c, d in band] for band in plan["bands"]]
        except (ValueError, KeyError, TypeError):
            pass
        folder.remove()
    costs = coarse_costs(scene, session(backend=backend), progress)
    bands = cut(scene.view.width, scene.view.height, costs, EACH * threads, most)
    plan_now = dumps({"picture": fingerprint, "bands": bands})
    folder.put(PLAN, [plan_now])
    return plan_now, bands


def coarse_costs(scene: Scene, draw: Session, progress: Progress) -> Costs:
    """What the parts of a picture cost to draw, measured on a small one: (rows, cols) of seconds per cell."""
    view = scene.view
    shrink = max(1.0, max(view.width, view.height) / COARSE)
    small = scene.but(view=view.resized(max(1, round(view.width / shrink)), max(1, round(view.height / shrink))))
    wide, tall = small.view.width, small.view.height
    lefts, tops = range(0, wide, CELL[0]), range(0, tall, CELL[1])
    costs = np.zeros((len(tops), len(lefts)))
    with progress.task("Estimating the cost", total=costs.size) as task:
        draw_tile(small, (0, 0, wide, tall), draw)  # what is made once, is made now
        for i, top in enumerate(tops):
            for j, left in enumerate(lefts):
                began = time.process_time()
                draw_tile(small, (left, top, min(CELL[0], wide - left), min(CELL[1], tall - top)), draw)
                costs[i, j] = time.process_time() - began
                task.advance()
    return np.asarray(np.maximum(costs - 0.9 * costs.min(), 1e-6))  # without what each tile costs, however small it is


def cut(width: int, height: int, costs: Costs, count: int, most: int) -> list[Band]:
    """Cut a picture into tiles of about equal cost.

    Args:
        costs: (r, c) of the cells of a coarse picture; the last row and column may be cut off.
        count: of tiles, about, or more. most: pixels of one.

    Returns:
        bands of tiles at multiples of ``ROWS`` and ``COLUMNS``.
    """
    each = costs.sum() / count
    tall = max(ROWS, min(math.ceil(height / math.sqrt(count)), math.isqrt(most)) // ROWS * ROWS)
    found: list[Band] = []
    for top in range(0, height, tall):
        high = min(tall, height - top)
        across = _between(costs, top / height, (top + high) / height)
        share = max(1, math.ceil(across.sum() / each), math.ceil(width * high / most))
        found.append([(left, top, wide, high) for left, wide in _columns(width, across, share, most // high)])
    return found


def _between(costs: Costs, begin: float, end: float) -> Costs:
    """The costs of the columns between two heights of the picture, 0 at its top and 1 at its bottom."""
    edges = np.linspace(0.0, 1.0, len(costs) + 1)
    part = np.clip(np.minimum(edges[1:], end) - np.maximum(edges[:-1], begin), 0.0, None) * len(costs)
    return np.asarray(part @ costs)


def _columns(width: int, costs: Costs, count: int, most: int) -> Sequence[tuple[int, int]]:
    """Where tiles of about equal cost begin, and how wide they are."""
    sums = np.concatenate([[0.0], np.cumsum(costs)])
    places = np.interp(np.arange(1, count) / count * sums[-1], sums, np.linspace(0.0, width, len(sums)))
    most = max(COLUMNS, most // COLUMNS * COLUMNS)
    ends = sorted({round(place / COLUMNS) * COLUMNS for place in places} - {0} | {width})
    found, left = [], 0
    for end in (end for end in ends if end <= width):
        while left < end:
            wide = min(most, end - left)
            found.append((left, wide))
            left += wide
    return found


__all__ = ["Box", "coarse_costs", "cut", "draw_by_workers", "picture_by_workers"]
