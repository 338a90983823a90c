"""Making a QuadTIN's blocks by tasks: a stage for each round, with one task per block.

A block's input and its grown state are in ``parts/``. The building process writes inputs before a stage begins,
compares the sides of blocks between rounds, and concatenates their words at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from orograph.errors import StoreError
from orograph.progress import Progress
from orograph.store.derived_stages import TerrainStage
from orograph.store.digests import Spot
from orograph.store.executing import Executor
from orograph.store.parts import pack, unpack
from orograph.store.places import PARTS
from orograph.store.quadtin_grow import Making
from orograph.store.quadtin_make import GROW, LABELS, Arrays, done
from orograph.store.stored import StoredTerrain
from orograph.store.writer import ShardWriter


class Given(NamedTuple):
    """The inputs of a round, as the building process has them.

    Attributes:
        what: the step. todo: the blocks. arrays: the input of each. grown: for each, the number of the round in which
            it was last grown.
    """

    what: str
    todo: Sequence[int]
    arrays: Callable[[int], Arrays]
    grown: dict[int, int]


class QuadTinStage(TerrainStage[Arrays]):
    """A round of blocks.

    Args:
        making: the hierarchy. number: of the round. given: the building process's inputs; None in other processes.
    """

    name, label = "quadtin", LABELS[GROW]

    def __init__(
        self, terrain: StoredTerrain, writer: ShardWriter, making: Making, number: int, given: Given | None = None
    ) -> None:
        super().__init__(terrain, writer)
        self.making, self.number, self._given = making, number, given
        if given is not None:
            self.label = LABELS[given.what]

    def hand_over(self) -> None:
        super().hand_over()
        assert self._given is not None
        for block in self._given.todo:
            self.writer.keep(self._handed(block), pack(self._input(block)))

    def tasks(self) -> list[Spot]:
        assert self._given is not None
        return [(block, 0) for block in self._given.todo]

    def make(self, spot: Spot) -> Arrays:
        block = spot[0]
        given = self._input(block) if self._given is not None else self._read(self._handed(block))
        what, grown = given["what"].tobytes().decode(), int(given["grown"])
        waiting = {} if what == GROW else self._read(_key(grown, spot))
        found = done(self.making, what, block, given, waiting)
        self.writer.keep(self.key(spot), pack(found))
        return found

    def key(self, spot: Spot) -> str:
        return _key(self.number, spot)

    def found(self, spot: Spot, proof: bool = True) -> Arrays | None:
        data = self.writer.storage.get(self.key(spot))
        try:
            return None if data is None else unpack(data)
        except ValueError:
            return None

    def add(self, spot: Spot, found: Arrays) -> None:
        """Results are read again in order once all are there."""

    def _input(self, block: int) -> Arrays:
        """The input of a task."""
        assert self._given is not None
        what, _, arrays, grown = self._given
        return {
            "what": np.frombuffer(what.encode(), np.uint8), "grown": np.array(grown.get(block, -1)), **arrays(block)
        }  # fmt: skip

    def _handed(self, block: int) -> str:
        return f"{PARTS}/{self.name}/{self.number}.{block}.given"

    def _read(self, key: str) -> Arrays:
        try:
            return unpack(self.writer.storage.get(key) or b"")
        except ValueError as error:
            raise StoreError(
                f"A stored result of the build is damaged: {key}.",
                path=self.place,
                remedy="Build it again with overwrite.",
            ) from error


class Tasks:
    """Rounds run by an executor. See ``quadtin_make.Rounds``.

    Args:
        terrain: what is written so far. writer: writes the store. making: the hierarchy. executor: runs the tasks.
        progress: receives progress by rounds.
    """

    def __init__(
        self, terrain: StoredTerrain, writer: ShardWriter, making: Making, executor: Executor, progress: Progress
    ) -> None:
        self.terrain, self.writer, self.making = terrain, writer, making
        self.executor, self.progress = executor, progress
        self._count, self._grown = 0, dict[int, int]()

    def run(self, what: str, todo: Sequence[int], given: Callable[[int], Arrays]) -> Iterator[Arrays]:
        known = Given(what, todo, given, self._grown)
        stage = QuadTinStage(self.terrain, self.writer, self.making, self._count, known)
        self.executor.run(stage, self.progress)
        if what == GROW:
            self._grown.update(dict.fromkeys(todo, self._count))
        self._count += 1
        for spot in stage.tasks():
            found = stage.found(spot)
            if found is None:
                raise StoreError(
                    f"A stored result of the build is gone: {stage.key(spot)}.", path=stage.place, remedy=stage.again
                )
            yield found


def _key(number: int, spot: Spot) -> str:
    """The key of a block's result in a round."""
    return f"{PARTS}/{QuadTinStage.name}/{number}.{spot[0]}.{spot[1]}.part"
