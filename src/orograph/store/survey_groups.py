"""Errors in larger tasks, like heights (``groups``): squares of 2^s × 2^s areas that hand little on.

A group writes the codes of octave 0 and, since its shards of octaves 1 to s consist of its own areas alone, those too.
The building process only has to combine the codes of octaves s + 1 to 4 (if s is less than 4), and what larger diamonds
need, one window for a whole group (some 3 % of a byte per sample for each number). An interrupted group resumes
area by area, and the bytes do not depend on groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orograph.error.diamonds import SMALL
from orograph.error.holes import WHOLE
from orograph.error.parts import Floats, Part, Rest
from orograph.errors import DamagedChunkError
from orograph.store.array_spec import ArraySpec
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.diamonds import place
from orograph.store.digests import SIZE, Spot
from orograph.store.executing import ShardStage
from orograph.store.parts import pack, unpack
from orograph.store.places import PARTS
from orograph.store.pyramid import spans, tasks
from orograph.store.survey import Codes, Errors, Surveyed
from orograph.store.terrain import diamond_shape
from orograph.store.writer import Canvas


class ErrorGroups(ShardStage[Surveyed]):
    """The diamonds' arrays of a store under construction, group by group.

    Args:
        errors: makes areas, and combines the results.
        levels: s, at least 1.
    """

    name, label = Errors.name, Errors.label

    def __init__(self, errors: Errors, levels: int) -> None:
        self.errors, self.levels, self.writer = errors, levels, errors.writer
        self.shape, self.side = errors.shape, errors.area << levels
        coarse = range(1, min(SMALL, errors.top))
        self.own = [k for k in coarse if k <= levels]
        self.canvases = self._canvases([k for k in coarse if k > levels], self.side)

    def tasks(self) -> list[Spot]:
        return tasks(self.shape, self.side)

    def key(self, spot: Spot) -> str:
        return f"{PARTS}/errors/groups/{self.levels}.{spot[0]}.{spot[1]}.part"

    def make(self, spot: Spot) -> Surveyed:
        errors, canvases = self.errors, self._canvases(self.own, self.errors.area)
        left: Codes = {}
        rests: list[Rest] = []
        for area in self._areas(spot):
            codes, some = errors.found(area) or errors.make(area)
            rests += some
            for (k, name), values in codes.items():
                i, j = (at * errors.area >> k for at in area)
                if (k, name) in canvases:
                    canvases[k, name].add(i, j, values)
                elif k or not errors.top:
                    (i0, j0), shape = errors.window(spot, self.side, k)
                    whole = left.setdefault((k, name), np.zeros(shape, np.uint8))
                    whole[i - i0 : i - i0 + values.shape[0], j - j0 : j - j0 + values.shape[1]] = values
        whole_rests = [joined(rests)] if rests else []
        kept: dict[str, NDArray[Any]] = {f"codes.{k}.{name}": values for (k, name), values in left.items()}
        kept.update({f"rest.{name}": array for rest in whole_rests for name, array in rest.to_arrays().items()})
        listed = self.writer.digests
        digests = b"".join(listed.get(spec.path, spec.shards, shard) for spec, shard in self._shards(spot))
        kept["digests"] = np.frombuffer(digests, np.uint8)
        self.writer.keep(self.key(spot), pack(kept))
        return left, whole_rests

    def found(self, spot: Spot, proof: bool = True) -> Surveyed | None:
        data = self.writer.storage.get(self.key(spot))
        if data is None:
            return None
        try:
            kept = unpack(data)
            digests = kept["digests"].tobytes()
            for at, (spec, shard) in enumerate(self._shards(spot)):
                self.writer.take(spec, shard, digests[SIZE * at : SIZE * (at + 1)])
                ShardedArray(spec, self.writer.storage, self.writer.digests, ChunkCache(0), 1).prove(shard, proof)
        except (DamagedChunkError, ValueError, KeyError):
            return None
        codes: Codes = {}
        rest: dict[str, NDArray[Any]] = {}
        for key, array in kept.items():
            what, _, name = key.partition(".")
            if what == "codes":
                octave, _, name = name.partition(".")
                codes[int(octave), name] = array
            elif what == "rest":
                rest[name] = array
        return codes, [Rest.from_arrays(rest)] if rest else []

    def add(self, spot: Spot, found: Surveyed) -> None:
        codes, rests = found
        for (k, name), values in codes.items():
            i, j = (at * self.side >> k for at in spot)
            if (k, name) in self.canvases:
                self.canvases[k, name].add(i, j, values)
            else:
                place(self.errors.tops[name], values, k, i, j, self.errors.top)
        for rest in rests:
            self.errors.survey.add(rest)

    def finish(self) -> None:
        self.errors.finish()

    def _canvases(self, octaves: Sequence[int], side: int) -> dict[tuple[int, str], Canvas]:
        """Where the codes of octaves are assembled from parts of ``side`` samples."""
        return {
            (k, name): Canvas(
                self.errors.spec(k, name), self.writer, spans(self.shape, side, k, diamond_shape(self.shape, k))
            )
            for k in octaves
            for name in self.errors.names
        }

    def _areas(self, spot: Spot) -> list[Spot]:
        """Its areas, in Morton order."""
        count, area = 1 << self.levels, self.errors.area
        ends = [-(-side // area) for side in self.shape]
        inner = tasks((count * area, count * area), area)
        areas = [(spot[0] * count + i, spot[1] * count + j) for i, j in inner]
        return [at for at in areas if at[0] < ends[0] and at[1] < ends[1]]

    def _shards(self, spot: Spot) -> list[tuple[ArraySpec, Spot]]:
        """The shards that it writes, including those beyond its areas at the raster's end."""
        found = []
        for k in [0, *self.own] if self.errors.top else []:
            for name in self.errors.names:
                spec = self.errors.spec(k, name)
                rows, cols = (
                    range(at * each, count if (at + 1) * self.side >= side else (at + 1) * each)
                    for at, side, count in zip(spot, self.shape, spec.shards, strict=True)
                    for each in [(self.side >> k) // spec.shard]
                )
                found += [(spec, (i, j)) for i in rows for j in cols]
        return found


def joined(rests: Sequence[Rest]) -> Rest:
    """The results of blocks that fill a rectangle, as one."""
    kinds = list(rests[0].part.errors)
    places = [(rest.part.i, rest.part.j, *rest.part.errors[kinds[0]].shape) for rest in rests]
    window = _around(places)

    def put(pieces: Sequence[Floats], at: Sequence[tuple[int, ...]], around: tuple[int, ...]) -> Floats:
        whole = np.zeros((*pieces[0].shape[:-2], around[2], around[3]), pieces[0].dtype)
        for piece, (i, j, rows, cols) in zip(pieces, at, strict=True):
            i, j = i - around[0], j - around[1]
            whole[..., i : i + rows, j : j + cols] = piece
        return whole

    errors = {kind: put([rest.part.errors[kind] for rest in rests], places, window) for kind in kinds}
    radii = [rest.part.radii for rest in rests if rest.part.radii is not None]
    part = Part(rests[0].part.octave, window[0], window[1], errors, put(radii, places, window) if radii else None)
    halves = [(i >> 1, j >> 1, (i + rows >> 1) - (i >> 1), (j + cols >> 1) - (j >> 1)) for i, j, rows, cols in places]
    half = _around(halves)
    sums = [rest.sums for rest in rests if rest.sums is not None]
    states: NDArray[np.uint8] | None = None
    if any(rest.states is not None for rest in rests):
        states = np.full((2, half[2], half[3]), WHOLE, np.uint8)
        for rest, (i, j, rows, cols) in zip(rests, halves, strict=True):
            if rest.states is not None:
                states[:, i - half[0] : i - half[0] + rows, j - half[1] : j - half[1] + cols] = rest.states
    raw = []
    for k in sorted({k for rest in rests for k, *_ in rest.raw}):
        some = [(i, j, deviations) for rest in rests for octave, i, j, deviations in rest.raw if octave == k]
        i0, j0, rows, cols = _around([(i, j, *deviations.shape) for i, j, deviations in some])
        most = np.zeros((rows, cols), np.float32)
        for i, j, deviations in some:
            here = most[i - i0 : i - i0 + deviations.shape[0], j - j0 : j - j0 + deviations.shape[1]]
            np.maximum(here, deviations, out=here)
        raw.append((k, i0, j0, most))
    return Rest(part, put(sums, halves, half) if sums else None, states, raw)


def _around(windows: Sequence[tuple[int, ...]]) -> tuple[int, int, int, int]:
    """The window (row, column, rows, columns) around others."""
    row, col = min(w[0] for w in windows), min(w[1] for w in windows)
    return row, col, max(w[0] + w[2] for w in windows) - row, max(w[1] + w[3] for w in windows) - col
