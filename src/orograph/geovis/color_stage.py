"""The work on a store's color errors, area by area: a stage of tasks, and what its colours are told by.

A task keeps the codes of its area and what larger diamonds need of it (``colors/.partial``); who adds up writes them.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.dem.handles import HANDLES, locate
from orograph.error.diamonds import BLOCK, SMALL, Part, Rest, Survey
from orograph.geovis.color import TINTS_VERSION
from orograph.geovis.color_errors import SUN, Colors, blank, codes_of
from orograph.store.colors import color_spec
from orograph.store.diamonds import blank_top, place
from orograph.store.digests import Spot
from orograph.store.executing import Stage
from orograph.store.layout import Record
from orograph.store.parts import pack, unpack
from orograph.store.pyramid import spans, tasks
from orograph.store.terrain import diamond_shape, level_count, level_shape
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


Coded = tuple[dict[int, Codes], list[list[Rest]]]
"""The codes of an area's diamonds by octave, and by block and channel what larger diamonds need of it."""


class ColorStage(Stage[Coded]):
    """Color errors, area by area.

    Args:
        colors: of the terrain. writer: of codes, and of what tasks keep. record: of the store.
    """

    name, label = "colors", "Color errors"
    again = "What was done is kept: run the same again, and it goes on."

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

    @property
    def place(self) -> str:
        return self.writer.storage.url

    def kept(self, spot: Spot) -> bool:
        return self.writer.storage.exists(self.key(spot))

    def tasks(self) -> list[Spot]:
        return tasks(self.shape, self.area)

    def key(self, spot: Spot) -> str:
        return f"{PARTIAL}/{spot[0]}.{spot[1]}.part"

    def add(self, spot: Spot, found: Coded) -> None:
        codes, rests = found
        for octave, values in codes.items():
            self._put(octave, spot[0] * self.area >> octave, spot[1] * self.area >> octave, values)
        for block in rests:
            for channel, rest in zip(self.channels, block, strict=True):
                channel.add(rest)

    def finish(self) -> None:
        for parts in zip(*(channel.finish() for channel in self.channels), strict=True):
            self._put(parts[0].octave, 0, 0, _coded(parts))
        self.writer.array(self._spec(self.top), self.whole)

    def _put(self, octave: int, i: int, j: int, values: Codes) -> None:
        if octave >= self.top:
            place(self.whole, values, octave, i, j, self.top)
        elif octave < SMALL:
            self.canvases[octave].add(i, j, values)
        else:
            self.writer.array(self._spec(octave), values)

    def make(self, spot: Spot) -> Coded:
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
        self.writer.keep(self.key(spot), pack(kept))
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

    def found(self, spot: Spot, proof: bool = True) -> Coded | None:
        data = self.writer.storage.get(self.key(spot))
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
