"""Color errors kept with the terrain: made once, out of core, and used for the same colours only.

What ``color_errors`` computes in memory, a byte for each diamond, is put into a store beside the errors of heights, as
``colors/{k}/color``: one task per shard, which keeps what it found until all is complete, so that an interrupted run
goes on. The bytes are those of the computation in memory, whatever the shards and threads.

Color errors hold for one image, one light and one tint. The store says which (``made_with``): of an image a digest of
all its files (the raster, its world file, the parts of a mosaic), so that an image that was changed, or another one of
the same name, is never taken for it. An image whose files cannot be read as a whole (a URL) has no digest: its errors
are computed when they are wanted.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.dem.handles import HANDLES, locate
from orograph.error.diamonds import BLOCK, SMALL, Part, Rest, Survey
from orograph.errors import UsageError
from orograph.geovis.color import TINTS_VERSION
from orograph.geovis.color_errors import SUN, Colors, blank, codes_of, decoded
from orograph.parallel import threads_for
from orograph.progress import SILENT, Progress
from orograph.store.addresses import storage_at
from orograph.store.colors import COLORS, color_spec
from orograph.store.diamonds import blank_top, place
from orograph.store.digests import Spot
from orograph.store.layout import Record, dumps, publish
from orograph.store.lock import alone
from orograph.store.parts import pack, unpack
from orograph.store.pyramid import spans, tasks
from orograph.store.shards import go_through
from orograph.store.stored import StoredTerrain, open, read_record
from orograph.store.terrain import Terrain, diamond_shape, level_count, level_shape
from orograph.store.writer import Canvas, ShardWriter

PARTIAL = "colors/.partial"
"""Where the plan and the parts of a run are until it is complete."""
SAMPLE = 160
"""Bytes a task holds for each sample of its block."""

Floats = NDArray[np.float32]
Codes = NDArray[np.uint8]


def made_with(
    drape: str | os.PathLike[str] | None = None,
    *,
    colormap: str | None = None,
    sun: tuple[float, float] | None = SUN,
    relief: float = 1.0,
) -> dict[str, Any] | None:
    """What color errors depend on besides the terrain, as JSON; None if the image cannot be told from others.

    Raises:
        ReadError: the image cannot be read.
    """
    image: dict[str, Any] | None = None
    if drape is not None:
        with HANDLES.borrow(locate(drape)) as file:
            names = sorted(str(name) for name in file.files)
        paths = [Path(name) for name in names or [os.fspath(drape)]]
        if Path(drape).is_file():  # an archive's members are no files
            paths = [path for path in paths if path.is_file()] or [Path(drape)]
        if not all(path.is_file() for path in paths):
            return None
        digest = hashlib.blake2b(digest_size=16)
        for path in paths:
            with path.open("rb") as data:
                digest.update(f"{path.suffix}:{path.stat().st_size}:".encode())
                while piece := data.read(1 << 20):
                    digest.update(piece)
        image = {"name": Path(drape).name, "digest": digest.hexdigest()}
    return {
        "drape": image, "colormap": colormap, "sun": None if sun is None else [float(v) for v in sun],
        "relief": float(relief), "tints": TINTS_VERSION,
    }  # fmt: skip


def same(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two ``made_with`` mean the same colours (an image may have been moved or renamed)."""

    def of(told: Mapping[str, Any]) -> dict[str, Any]:
        image = told["drape"]
        return {**told, "drape": None if image is None else image["digest"]}

    return of(one) == of(other)


class StoredColorErrors:
    """Color errors of a store, called as methods want them: ``(level, row0, row1, col0, col1) → float32``, ΔE."""

    def __init__(self, terrain: StoredTerrain) -> None:
        self.terrain, self.codes = terrain, terrain.derived("colors")

    def __call__(self, level: int, row0: int, row1: int, col0: int, col1: int) -> Floats:
        return decoded(self.codes.read(level, row0, row1, col0, col1))


def stored(
    terrain: Terrain, drape: str | os.PathLike[str] | None = None, *, progress: Progress = SILENT, **options: Any
) -> StoredColorErrors | None:
    """The color errors a terrain's store has of these colours; None if it has none, or of other colours only.

    Args:
        terrain: any.
        drape, options: as for ``made_with``.
        progress: is told if there are some of other colours.
    """
    if not isinstance(terrain, StoredTerrain) or not COLORS.of(terrain.record):
        return None
    wanted = made_with(drape, **options)
    if wanted is not None and same(wanted, COLORS.of(terrain.record)):
        return StoredColorErrors(terrain)
    progress.note("The store has color errors of other colours; those of these are computed.")
    return None


def store_colors(
    store: str | Path,
    drape: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
    max_memory: int = 1 << 30,
    jobs: int | None = None,
    progress: Progress = SILENT,
    storage_options: dict[str, Any] | None = None,
    **options: Any,
) -> StoredTerrain:
    """Put color errors into a store, and open it again.

    Those of other colours are replaced; where the same are there already nothing is done. An interrupted run goes on
    when it is asked for again.

    Args:
        store: a folder, or a URL (``s3://``, ``gs://``, ``az://``…).
        drape: an image laid over the terrain; None: the tint of heights.
        overwrite: make them anew.
        max_memory: bytes the process should stay within.
        jobs: threads (default: all processors). The store's bytes do not depend on it.
        options: ``colormap``, ``sun``, ``relief``, as for ``Colors``.

    Raises:
        UsageError: the image cannot be told from others later.
        StoreError: there is no store, another process is at work there, or it cannot be written.
        ReadError: the image cannot be read, or lies elsewhere.
    """
    wanted = made_with(drape, **options)
    if wanted is None:
        raise UsageError(
            f"{os.fspath(drape or '')} is no file, so that it could not be told from another image later.",
            remedy="Fetch the image, and name the copy.",
        )
    storage = storage_at(store, storage_options)
    read_record(storage)  # a store that is not there is said before anything is written beside it
    with alone(storage, "putting color errors into this store"):
        before = read_record(storage)
        if overwrite or not COLORS.of(before) or not same(wanted, COLORS.of(before)):
            with open(store, jobs=1, storage_options=storage_options) as terrain:
                if COLORS.of(before):
                    publish(storage, COLORS.put(before, {}))
                    before = read_record(storage)
                colors = Colors(terrain, drape=drape, max_memory=max_memory, progress=progress, **options)
                plan = dumps({**wanted, "step": colors.step, "source": before.source, "shard": before.shard})
                if overwrite or storage.get(f"{PARTIAL}/plan.json") != plan:
                    storage.remove(PARTIAL)
                    storage.put(f"{PARTIAL}/plan.json", [plan])
                at_once = max(1, min(threads_for(jobs), max_memory // 2 // (SAMPLE * min(BLOCK, before.shard) ** 2)))
                writer = ShardWriter(storage)
                _Run(colors, writer, before).all(at_once, progress)
                after = replace(COLORS.put(before, wanted), digests=before.digests.joined(writer.digests))
                publish(storage, after)
                storage.remove(PARTIAL)
        storage.close()
        return open(store, storage_options=storage_options)


class _Run:
    """One run over the shards of a store."""

    def __init__(self, colors: Colors, writer: ShardWriter, record: Record) -> None:
        self.colors, self.writer, self.record = colors, writer, record
        self.shape = shape = record.grid.shape
        self.area = max(record.shard, 32)
        self.top = level_count(shape) - 1
        nested = colors.nested()
        self.channels = [
            Survey(np.ascontiguousarray(nested[..., k]), blank(colors.terrain), ("exact",), radii=False,
                   block=min(BLOCK, self.area))
            for k in range(3)
        ]  # fmt: skip
        self.whole = blank_top(shape, np.uint8, 0)
        self.canvases = {
            level: Canvas(self._spec(level), writer, spans(shape, self.area, level, diamond_shape(shape, level)))
            for level in range(min(SMALL, self.top))
        }

    def all(self, jobs: int, progress: Progress) -> None:
        """Do all tasks and what no task could make."""
        go_through("Color errors", tasks(self.shape, self.area), self.run, jobs, progress, self._finish)

    def _finish(self) -> None:
        for parts in zip(*(channel.finish() for channel in self.channels), strict=True):
            self._put(parts[0].octave, 0, 0, _coded(parts))
        self.writer.array(self._spec(self.top), self.whole)

    def run(self, spot: Spot) -> None:
        """Do one task, or take over what an interrupted run did of it."""
        codes, rests = self._kept(spot) or self._make(spot)
        for octave, values in codes.items():
            self._put(octave, spot[0] * self.area >> octave, spot[1] * self.area >> octave, values)
        for block in rests:
            for channel, rest in zip(self.channels, block, strict=True):
                channel.add(rest)

    def _put(self, octave: int, i: int, j: int, values: Codes) -> None:
        if octave >= self.top:
            place(self.whole, values, octave, i, j, self.top)
        elif octave < SMALL:
            self.canvases[octave].add(i, j, values)
        else:
            self.writer.array(self._spec(octave), values)

    def _make(self, spot: Spot) -> tuple[dict[int, Codes], list[list[Rest]]]:
        rows, cols = self.shape
        row, col = spot[0] * self.area, spot[1] * self.area
        codes: dict[int, Codes] = {}
        rests: list[list[Rest]] = []
        step = self.channels[0].size
        for i in range(row // step, -(-min(row + self.area, rows) // step)):
            for j in range(col // step, -(-min(col + self.area, cols) // step)):
                seen: dict[tuple[int, ...], Floats] = {}  # one window for all channels
                found = []
                for k, channel in enumerate(self.channels):

                    def read(*window: int, k: int = k, seen: dict[tuple[int, ...], Floats] = seen) -> Floats:
                        if window not in seen:
                            seen[window] = self.colors.colors(*window)
                        return np.ascontiguousarray(seen[window][..., k])

                    found.append(channel.block((i, j), read))
                for parts in zip(*(parts for parts, _ in found), strict=True):
                    self._gather(parts, row, col, codes)
                block = [rest for _, rest in found if rest is not None]
                if block:
                    rests.append(block)
        kept: dict[str, NDArray[Any]] = {f"codes.{octave}": values for octave, values in codes.items()}
        for number, block in enumerate(rests):
            for k, rest in enumerate(block):
                kept.update({f"rest.{number}.{k}.{name}": array for name, array in rest.to_arrays().items()})
        self.writer.keep(_part(spot), pack(kept))
        return codes, rests

    def _gather(self, parts: tuple[Part, ...], row: int, col: int, codes: dict[int, Codes]) -> None:
        """Put the codes of a block's parts into those of its area, which begins with sample (row, col)."""
        k = parts[0].octave
        if k not in codes:
            shape = level_shape(self.shape, k)
            area = (
                (whole if at + self.area >= side else (at + self.area) >> k) - (at >> k)
                for at, side, whole in zip((row, col), self.shape, shape, strict=True)
            )
            codes[k] = np.zeros(tuple(area), np.uint8)
        values, i, j = _coded(parts), parts[0].i - (row >> k), parts[0].j - (col >> k)
        codes[k][i : i + values.shape[0], j : j + values.shape[1]] = values

    def _kept(self, spot: Spot) -> tuple[dict[int, Codes], list[list[Rest]]] | None:
        """What an interrupted run found in an area; None if it did not, or that is damaged."""
        data = self.writer.storage.get(_part(spot))
        if data is None:
            return None
        codes: dict[int, Codes] = {}
        kept: dict[tuple[int, int], dict[str, NDArray[Any]]] = {}
        try:
            for key, array in unpack(data).items():
                what, number, *name = key.split(".", 3)
                if what == "codes":
                    codes[int(number)] = array
                else:
                    kept.setdefault((int(number), int(name[0])), {})[name[1]] = array
            count = len(kept) // 3
            rests = [[Rest.from_arrays(kept[number, k]) for k in range(3)] for number in range(count)]
        except (ValueError, KeyError):
            return None
        return codes, rests

    def _spec(self, level: int) -> Any:
        return color_spec(self.shape, level, self.record.shard, self.record.chunk)


def _coded(parts: tuple[Part, ...]) -> Codes:
    return codes_of([part.errors["exact"] for part in parts])


def _part(spot: Spot) -> str:
    return f"{PARTIAL}/{spot[0]}.{spot[1]}.part"


__all__ = ["StoredColorErrors", "made_with", "store_colors", "stored"]
