"""TINs made by tasks: a stage for each band of a level, whose tasks make some of its diamonds.

The building process makes levels of a single task itself. Input from the levels below is in ``parts/``: which diamonds
to make, and the marks on their legs. The building process writes it before a stage begins, and combines marks, errors
and spheres itself.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orograph.progress import Progress
from orograph.store.array_spec import ArraySpec
from orograph.store.arrays import ShardedArray
from orograph.store.cache import ChunkCache
from orograph.store.derived_stages import CACHE, TerrainStage
from orograph.store.digests import Digests, Spot
from orograph.store.executing import Executor, Threads
from orograph.store.layout import dumps
from orograph.store.parts import pack, unpack
from orograph.store.places import PARTS
from orograph.store.stored import StoredTerrain
from orograph.store.tin_build import Band, Building
from orograph.store.tin_diamonds import Integers, Made, Maker, MarksOf, below
from orograph.store.tins import marks_spec
from orograph.store.writer import ShardWriter

RUN = 1024
"""Diamonds per task."""


class Bands:
    """Makes bands by an executor, one after the other.

    Args:
        terrain: what is written so far. writer: writes the store. legs: of the finest patches. executor: runs tasks.
    """

    def __init__(self, terrain: StoredTerrain, writer: ShardWriter, legs: int, executor: Executor) -> None:
        self.terrain, self.writer, self.legs, self.executor = terrain, writer, legs, executor
        self._count = 0
        self._level = ShardWriter(writer.storage, writer.digests.keyed)

    def __call__(self, building: Building, band: Band, progress: Progress) -> None:
        if band.first:
            self._level = ShardWriter(self.writer.storage, self.writer.digests.keyed)
        given = Given(building, band, self._level)
        stage = TinStage(self.terrain, self.writer, self.legs, self._count, given)
        alone = building.bands(band.octave) == 1 and len(stage.tasks()) <= 1  # too small to hand over
        (Threads(1, True) if alone else self.executor).run(stage, progress)
        self._count += 1


class Given(NamedTuple):
    """A band's input, as the building process has it.

    Attributes:
        building: receives the TINs. band: of a level. level: writes the marks below it, for other processes.
    """

    building: Building
    band: Band
    level: ShardWriter


class TinStage(TerrainStage[Made]):
    """TINs of the diamonds of a band.

    Args:
        legs: segments along a leg of the finest patches. number: the band's, counted over all levels.
        given: the building process's input; None in other processes, which read it.
    """

    name, label = "tins", "Making TINs"

    def __init__(
        self, terrain: StoredTerrain, writer: ShardWriter, legs: int, number: int, given: Given | None = None
    ) -> None:
        super().__init__(terrain, writer)
        self.legs, self.number, self._given = legs, number, given
        if given is None:
            self._rows, self._cols, marks = self._read()
        else:
            self._rows, self._cols = given.band.wanted()
            marks = given.building.marks_of
        self._maker = Maker(terrain, legs, marks)

    def hand_over(self) -> None:
        super().hand_over()
        assert self._given is not None
        building, band, level = self._given
        source = below(band.octave, band.kind, self.legs)
        if source is not None and band.first:
            level.array(self._spec(source, band.kind), building.marks[source])
        facts = {"octave": band.octave, "kind": band.kind, "digests": level.digests.to_json()}
        arrays: dict[str, NDArray[Any]] = {
            "rows": self._rows,
            "cols": self._cols,
            "told": np.frombuffer(dumps(facts), np.uint8),
        }
        self.writer.keep(self._key(), pack(arrays))

    def _read(self) -> tuple[Integers, Integers, MarksOf]:
        """Read the diamonds and a reader of the marks below from the building process."""
        kept = unpack(self.writer.storage.get(self._key()) or b"")
        facts = json.loads(kept["told"].tobytes())
        octave, kind = facts["octave"], facts["kind"]
        source = below(octave, kind, self.legs)
        spec = self._spec(octave if source is None else source, kind)
        digests = Digests.from_json(facts["digests"], self.writer.digests.keyed)
        array = ShardedArray(spec, self.writer.storage, digests, ChunkCache(CACHE), 1)
        return kept["rows"], kept["cols"], lambda octave, *window: array.read(*window)

    def _key(self) -> str:
        return f"{PARTS}/tins/{self.number}.given"

    def _spec(self, octave: int, kind: int) -> ArraySpec:
        """The array of marks below diamonds of a kind, which other processes read."""
        record = self.terrain.record
        spec = marks_spec(record.grid.shape, octave, self.legs, record.shard, record.chunk)
        return replace(spec, path=f"{PARTS}/tins/marks-{octave}-{kind}")

    def tasks(self) -> list[Spot]:
        return [(0, run) for run in range(-(-len(self._rows) // RUN))]

    def make(self, spot: Spot) -> Made:
        part = _part(spot)
        found = self._maker.made(self._rows[part], self._cols[part])
        self.writer.keep(self.key(spot), pack(found._asdict()))
        return found

    def found(self, spot: Spot, proof: bool = True) -> Made | None:
        data = self.writer.storage.get(self.key(spot))
        try:
            return None if data is None else Made(**unpack(data))
        except ValueError:
            return None

    def add(self, spot: Spot, found: Made) -> None:
        assert self._given is not None
        self._given.building.take(self._given.band, _part(spot), found)


def _part(spot: Spot) -> slice:
    """The diamonds of a task."""
    return slice(spot[1] * RUN, (spot[1] + 1) * RUN)
